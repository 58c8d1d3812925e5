#include "rtdata/recording/recording.hpp"

#include <doctest/doctest.h>
#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <nlohmann/json.hpp>
#include <sstream>

#include "app/core/recording_commands.hpp"
#include "has.hpp"
#include "rtdata/recording/export.hpp"
#include "rtdata/recording/verify.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace recordings;
using rtdata::test::has;

TEST_SUITE_BEGIN("sinks");

namespace {

template <class T>
std::vector<T> payloads_of(const std::string& path, const std::string& topic) {
  auto recording = Recording::open(path).or_throw();
  auto rows = recording.rows({.topic = topic}).or_throw();
  std::vector<T> found;
  while (const RecordedRow* row = rows.next().or_throw()) {
    REQUIRE(row->event().as<T>() != nullptr);
    found.push_back(*row->event().as<T>());
  }
  return found;
}

std::vector<std::uint64_t> sequences(const Recording& recording, const RowFilter& filter) {
  auto rows = recording.rows(filter).or_throw();
  std::vector<std::uint64_t> found;
  while (const RecordedRow* row = rows.next().or_throw()) found.push_back(row->header().sequence);
  return found;
}

Error refusal(const std::string& path) {
  auto opened = Recording::open(path);
  if (!opened) return opened.error();
  auto report = verify(*opened);
  REQUIRE_FALSE(report);
  return report.error();
}

void write_file(const std::string& path, const std::string& content) {
  std::ofstream(path, std::ios::binary) << content;
}

}  // namespace

TEST_CASE("FW-5 every kind comes back equal") {
  const Folder folder;
  Everything nan = full();
  nan.f64 = nan.maybe.emplace(std::numeric_limits<double>::quiet_NaN());
  nan.f32 = std::numeric_limits<float>::quiet_NaN();
  const std::string path = make(folder, [&](Feed<Everything>& feed) {
    feed.publish(full());
    feed.publish(Everything{});
    feed.publish(nan);
  });
  const auto found = payloads_of<Everything>(path, "every/thing");
  REQUIRE(found.size() == 3);
  CHECK(found[0] == full());
  CHECK(found[0].u64 == std::numeric_limits<std::uint64_t>::max());
  CHECK(found[1] == Everything{});
  CHECK(std::isnan(found[2].f64));
  CHECK(std::isnan(found[2].f32));
  REQUIRE(found[2].maybe.has_value());
  CHECK(std::isnan(*found[2].maybe));
  CHECK_FALSE(found[1].maybe.has_value());
}

TEST_CASE("FW-5 NFR-2 a char is a number from 0 to 255 in a recording, on every processor") {
  const Folder folder;
  const std::string path = make(folder, [&](Feed<Everything>& feed) {
    for (int code = 0; code < 256; ++code) {
      Everything e;
      e.letter = static_cast<char>(code);
      e.i64 = code;
      feed.publish(e);
    }
  });
  CHECK(number(path,
               "SELECT count(*) FROM \"every/thing\" WHERE letter IS "
               "CASE WHEN i64 BETWEEN 32 AND 126 THEN char(i64) ELSE i64 END") == 256);
  const auto found = payloads_of<Everything>(path, "every/thing");
  REQUIRE(found.size() == 256);
  for (std::size_t i = 0; i < 256; ++i) CHECK(static_cast<unsigned char>(found[i].letter) == i);
}

TEST_CASE("FW-5 a recording says what it holds") {
  const Folder folder;
  const auto recording = Recording::open(make(folder)).or_throw();
  const auto runs = recording.runs().or_throw();
  REQUIRE(runs.size() == 1);
  CHECK(runs[0].state == RunState::closed);
  CHECK(runs[0].pid == ::getpid());
  REQUIRE(runs[0].ended);
  CHECK(*runs[0].ended - runs[0].started == 10s + 45ms);
  const auto topics = recording.topics().or_throw();
  REQUIRE(topics.size() == 2);
  CHECK(topics[0].topic == "every/thing");
  CHECK(topics[1].topic == "room/climate");
  CHECK(topics[1].description->same_meaning(*description_of<Climate>()));
  const auto ledger = recording.ledger(1).or_throw();
  REQUIRE(ledger.size() == 2);
  CHECK(ledger[1].origin == "room");
  CHECK(ledger[1].sensor.balances());
  CHECK(ledger[1].sensor.failed == 2);
  CHECK(ledger[1].stored == 999);
  const auto gaps = recording.gaps(1).or_throw();
  REQUIRE(gaps.size() == 2);
  CHECK(gaps[0].kind == "failed");
  CHECK(gaps[1].kind == "missed");
  CHECK(gaps[0].count == 2);
  CHECK(gaps[0].last - gaps[0].first == 10ms);
  const auto schedule = recording.schedule(1).or_throw();
  REQUIRE(schedule.size() == 1);
  CHECK(schedule[0].segment.period == 10ms);
  CHECK(schedule[0].segment.computed() == schedule[0].segment.scheduled);
  CHECK(recording.clock(1).or_throw().size() >= 2);
  CHECK(recording.errors(1).or_throw().size() >= 1);
}

TEST_CASE("FW-5 rows come in order of time across topics, and can be chosen") {
  const Folder folder;
  const auto recording = Recording::open(make(folder)).or_throw();
  auto rows = recording.rows({}).or_throw();
  Time last{};
  std::size_t count = 0, others = 0;
  while (const RecordedRow* row = rows.next().or_throw()) {
    CHECK(row->header().time >= last);
    last = row->header().time;
    ++count;
    others += row->topic().topic == "every/thing";
    CHECK(row->run() == 1);
  }
  CHECK(count == 1001);
  CHECK(others == 2);
  CHECK(rows.next().or_throw() == nullptr);
  CHECK(sequences(recording, {.topic = "every/+"}) == std::vector<std::uint64_t>{1, 2});
  CHECK(sequences(recording, {.topic = "room/#", .limit = 3}) == std::vector<std::uint64_t>{1, 2, 3});
  CHECK(sequences(recording, {.topic = "room/#", .every = 300}) == std::vector<std::uint64_t>{1, 301, 601, 901});
  CHECK(sequences(recording, {.run = 2}).empty());
  CHECK(sequences(recording, {.origin = "program feed"}).size() == 2);
  const Time start = recording.runs().or_throw()[0].started;
  CHECK(sequences(recording, {.topic = "room/#", .from = start + 10ms, .until = start + 40ms}) ==
        std::vector<std::uint64_t>{2, 3, 4});
  CHECK(recording.rows({.topic = "room/#/x"}).error().id() == "bad-name");
  CHECK(recording.rows({.every = 0}).error().id() == "bad-argument");
}

TEST_CASE("FW-5 rows that were written out of order come in order") {
  const Folder folder;
  const std::string path = make(folder);
  sql(path,
      "UPDATE \"room/climate\" SET origin = 'slow', time = time - 35000000 WHERE sequence % 3 = 0;"
      "CREATE TEMP TABLE slow AS SELECT * FROM rtdata_ledger WHERE origin = 'room'; UPDATE slow SET origin = 'slow';"
      "INSERT INTO rtdata_ledger SELECT * FROM slow");
  const auto recording = Recording::open(path).or_throw();
  auto rows = recording.rows({}).or_throw();
  Time last{};
  std::size_t count = 0;
  while (const RecordedRow* row = rows.next().or_throw()) {
    CHECK(row->header().time >= last);
    last = row->header().time;
    ++count;
  }
  CHECK(count == 1001);
}

TEST_CASE("FW-5 a recording is read while it is being written, each reading in one state") {
  const Folder folder;
  const std::string path = folder / "run.db";
  Loop loop{Loop::Manual{}};
  SqliteSink sink(loop, {.path = path});
  Sensor<Climate> room(loop, {.name = "room", .rate = 100_Hz}, [] { return Climate{1, 2}; });
  loop.advance(5s);
  const auto recording = Recording::open(path).or_throw();
  CHECK(verify(recording).or_throw().runs.at(0).problems.empty());
  std::size_t count = 0;
  {
    auto rows = recording.rows({}).or_throw();
    REQUIRE(rows.next().or_throw() != nullptr);
    const auto before = static_cast<std::size_t>(number(path, "SELECT count(*) FROM room"));
    loop.advance(5s);
    for (count = 1; rows.next().or_throw() != nullptr;) ++count;
    CHECK(count == before);
  }
  CHECK(sequences(recording, {}).size() > count);
  room.close();
  loop.close();
  CHECK(verify(recording).or_throw().verdict() == Verdict::balanced);
}

TEST_CASE("FW-5 what cannot be read is refused with a clear error") {
  const Folder folder;
  CHECK(refusal(folder / "nothing.db").id() == "not-found");
  CHECK(refusal(folder / "").id() != "ok");
  write_file(folder / "empty.db", "");
  CHECK(refusal(folder / "empty.db").id() == "not-a-recording");
  CHECK(refusal(folder / "empty.db").why == "the file is empty");
  write_file(folder / "text.txt", "time,temperature\n1,2\n");
  CHECK(refusal(folder / "text.txt").id() == "not-a-recording");
  write_file(folder / "long.txt", std::string(10000, 'x'));
  CHECK(refusal(folder / "long.txt").id() == "not-a-recording");
  sql(folder / "other.db", "CREATE TABLE bookmarks(url TEXT)");
  CHECK(refusal(folder / "other.db").why == "it is another program's SQLite file");
  const std::string newer = make(folder, {}, "newer.db");
  sql(newer, "PRAGMA user_version = 99");
  CHECK(refusal(newer).id() == "newer-version");
  for (const int version : {1, 5}) {
    const std::string before = make(folder, {}, "before.db");
    sql(before, "PRAGMA application_id = 0x52544441; PRAGMA user_version = " + std::to_string(version));
    CHECK(refusal(before).id() == "not-a-recording");
    CHECK(refusal(before).why.starts_with(
        "it is a recording of a version before 0.1.0, which had another format (\"rtdata "));
    CHECK(refusal(before).advice == "export it with the rtdata that recorded it, or record into another file");
    std::filesystem::remove(before);
  }
  const std::string unaware = make(folder, {}, "unaware.db");
  sql(unaware, "ALTER TABLE rtdata_clock DROP COLUMN suspended");
  CHECK(refusal(unaware).why.starts_with("it is a recording of a version before 0.1.0, which had another format"));
  const std::string missing = make(folder, {}, "missing.db");
  sql(missing, "DROP TABLE rtdata_gap");
  CHECK(refusal(missing).id() == "damaged");
  for (const double part : {0.05, 0.5, 0.95}) {
    const std::string cut = make(folder, {}, "cut" + std::to_string(part) + ".db");
    std::filesystem::resize_file(
        cut, static_cast<std::uintmax_t>(static_cast<double>(std::filesystem::file_size(cut)) * part));
    CHECK(refusal(cut).id() == "damaged");
  }
  const std::string scribbled = make(folder, {}, "scribbled.db");
  {
    std::fstream file(scribbled, std::ios::binary | std::ios::in | std::ios::out);
    const auto size = std::filesystem::file_size(scribbled);
    for (std::uintmax_t at = 8192; at + 4096 < size; at += 4096) {
      file.seekp(static_cast<std::streamoff>(at));
      file.write("scribbled over", 14);
    }
  }
  CHECK(refusal(scribbled).id() == "damaged");
}

TEST_CASE("FW-5 a file whose program was ended while it made it is not read as it lies there") {
  const Folder folder;
  {
    auto database = sqlite::Database::open(folder / "a.db", sqlite::Database::Mode::write);
    const auto set = [&](const char* sql) { database.execute(sql); };
    set("PRAGMA cache_size = 2; CREATE TABLE t(x); BEGIN");
    set("WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 500) INSERT INTO t SELECT "
        "hex(randomblob(500)) FROM n");
    for (const char* part : {"", "-journal"})
      std::filesystem::copy_file(folder / "a.db" + part, folder / "killed.db" + part);
    set("COMMIT");
  }
  const Error error = refusal(folder / "killed.db");
  CHECK(error.id() == "not-a-recording");
  CHECK_MESSAGE(error.why.find("its program ended while it made the file") != std::string::npos, error.text());
}

TEST_CASE("FW-5 a file that may not be read says so") {
  const Folder folder;
  const std::string path = make(folder);
  ::chmod((folder / "").c_str(), 0755);
  ::chmod(path.c_str(), 0);
  const uid_t user = ::geteuid();
  if (user == 0) REQUIRE(::seteuid(65534) == 0);
  const auto opened = Recording::open(path);
  if (user == 0) REQUIRE(::seteuid(user) == 0);
  REQUIRE_FALSE(opened);
  CHECK(opened.error().id() == "not-permitted");
  // Read-only in a folder that cannot be written: it is at rest, so that is enough.
  ::chmod(path.c_str(), 0444);
  ::chmod((folder / "").c_str(), 0555);
  if (user == 0) REQUIRE(::seteuid(65534) == 0);
  const auto at_rest = Recording::open(path);
  const bool is_read = at_rest && at_rest->runs().or_throw().size() == 1;
  if (user == 0) REQUIRE(::seteuid(user) == 0);
  CHECK(is_read);
  ::chmod((folder / "").c_str(), 0755);
}

TEST_CASE("FW-5 a killed recording in a folder that cannot be written: the error says what to copy") {
  const Folder folder;
  const std::string path = folder / "run.db";
  const Folder read_only;
  const std::string there = read_only / "run.db";
  {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    Feed<Climate> feed(loop, {.name = "a", .topic = "a"});
    feed.publish({});
    loop.advance(2s);
    for (const char* part : {"", "-wal"}) std::filesystem::copy_file(path + part, there + part);
    loop.close();
  }
  for (const char* part : {"", "-wal"}) ::chmod((there + part).c_str(), 0444);
  ::chmod((read_only / "").c_str(), 0555);
  const uid_t user = ::geteuid();
  if (user == 0) REQUIRE(::seteuid(65534) == 0);
  const auto opened = Recording::open(there);
  if (user == 0) REQUIRE(::seteuid(user) == 0);
  ::chmod((read_only / "").c_str(), 0755);
  REQUIRE_FALSE(opened);
  CHECK_MESSAGE(has(opened.error().why, "its newest data is in " + there + "-wal"), opened.error().text());
  CHECK(has(opened.error().advice, "copy both files into a folder that can be written"));
}

TEST_CASE("FW-5 a value that does not fit its field is damage, named with its place") {
  const Folder folder;
  const std::string path = make(folder);
  sql(path, "UPDATE \"every/thing\" SET u8 = 300 WHERE sequence = 2");
  auto recording = Recording::open(path).or_throw();
  auto rows = recording.rows({.topic = "every/thing"}).or_throw();
  CHECK(rows.next());
  const auto bad = rows.next();
  REQUIRE_FALSE(bad);
  CHECK(bad.error().id() == "damaged");
  CHECK(bad.error().where.find("topic every/thing, run 1, origin program feed, sequence 2, field u8") !=
        std::string::npos);
}

TEST_CASE("FW-5 a damaged row among many is named, and those before and after it come") {
  const Folder folder;
  const std::string path = make(folder);
  bool is_sorted = false;
  SUBCASE("as they lie") {}
  SUBCASE("sorted") { is_sorted = true; }
  if (is_sorted) {  // those of one origin lie behind later ones of the other
    sql(path,
        "UPDATE \"room/climate\" SET origin = 'slow', time = time - 35000000 WHERE sequence % 3 = 0;"
        "CREATE TEMP TABLE slow AS SELECT * FROM rtdata_ledger WHERE origin = 'room'; UPDATE slow SET origin = 'slow';"
        "INSERT INTO rtdata_ledger SELECT * FROM slow");
  }
  sql(path, "UPDATE \"room/climate\" SET temperature = 'warm' WHERE sequence IN (1, 500, 501, 999)");
  auto recording = Recording::open(path).or_throw();
  auto rows = recording.rows({.topic = "room/climate"}).or_throw();
  std::vector<std::uint64_t> found;
  std::string damaged;
  Time last{};
  for (;;) {
    auto row = rows.next();
    if (!row) {
      const std::string& where = row.error().where;
      damaged += where.substr(where.rfind("sequence ")) + "; ";
      continue;
    }
    if (*row == nullptr) break;
    CHECK((*row)->header().time >= last);
    last = (*row)->header().time;
    found.push_back((*row)->header().sequence);
  }
  std::sort(found.begin(), found.end());
  CHECK(found.size() == 995);
  CHECK(std::adjacent_find(found.begin(), found.end()) == found.end());
  for (const std::uint64_t bad : {1, 500, 501, 999}) {
    CHECK(!std::binary_search(found.begin(), found.end(), bad));
    CHECK(damaged.find("sequence " + std::to_string(bad) + ", field temperature; ") != std::string::npos);
  }
}

namespace {

/// Cuts off what follows the first part of the row that ends in this value: a page that cannot be read.
void break_end_of_row(const std::string& path, double last) {
  sql(path, "PRAGMA wal_checkpoint(TRUNCATE)");
  const auto page_size = static_cast<std::size_t>(number(path, "PRAGMA page_size"));
  std::ifstream file(path, std::ios::binary);
  std::string bytes{std::istreambuf_iterator<char>(file), {}};
  const auto big_endian = [](auto number) {
    std::string text;
    for (std::size_t i = sizeof number; i-- > 0;) text += static_cast<char>(number >> (8 * i));
    return text;
  };
  const std::size_t at = bytes.find(big_endian(std::bit_cast<std::uint64_t>(last)));
  REQUIRE(at != std::string::npos);
  const std::string page = big_endian(static_cast<std::uint32_t>(at / page_size + 1));
  // The page before it in the row's chain begins with its number.
  for (std::size_t begin = 0; begin < bytes.size(); begin += page_size) {
    if (bytes.compare(begin, page.size(), page) != 0) continue;
    bytes.replace(begin, page.size(), big_endian(std::uint32_t{0x7fffffff}));
    std::ofstream(path, std::ios::binary) << bytes;
    return;
  }
  FAIL("the row has no second page");
}

/// Of more fields than SQLite passes to a function.
struct Wide {
  std::array<double, 250> values{};
  rtdata::text<8> name;
  RTDATA_FIELDS(Wide, (values), (name))
};

}  // namespace

TEST_CASE("FW-5 rows of hundreds of fields come back equal") {
  const Folder folder;
  const std::string path = folder / "wide.db";
  constexpr std::size_t count = 150;
  {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    Feed<Wide> feed(loop, {.name = "many", .topic = "many"});
    for (std::size_t i = 0; i < count; ++i) {
      Wide wide;
      for (std::size_t k = 0; k < wide.values.size(); ++k) wide.values[k] = static_cast<double>(1000 * i + k);
      wide.name = rtdata::text<8>("row" + std::to_string(i));
      feed.publish(wide);
      loop.advance(10ms);
    }
    feed.close();
    loop.close();
  }
  const auto found = payloads_of<Wide>(path, "many");
  REQUIRE(found.size() == count);
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t k = 0; k < found[i].values.size(); ++k)
      REQUIRE(found[i].values[k] == static_cast<double>(1000 * i + k));
    CHECK(found[i].name == "row" + std::to_string(i));
  }
  sql(path, "UPDATE many SET name = x'41' WHERE sequence = 70");
  auto recording = Recording::open(path).or_throw();
  auto rows = recording.rows({.topic = "many"}).or_throw();
  for (std::uint64_t sequence = 1; sequence < 70; ++sequence)
    CHECK(rows.next().or_throw()->header().sequence == sequence);
  const auto bad = rows.next();
  REQUIRE_FALSE(bad);
  CHECK(bad.error().where.find("sequence 70, field name") != std::string::npos);
  CHECK(rows.next().or_throw()->header().sequence == 71);
}

TEST_CASE("FW-5 a row whose end cannot be read is no row, and what lies before it comes in every format") {
  const Folder folder;
  const std::string path = folder / "wide.db";
  {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path, .profile = SqliteProfile::card});
    Feed<Wide> feed(loop, {.name = "many", .topic = "many"});
    for (std::size_t i = 0; i < 100; ++i) {
      Wide wide;
      for (std::size_t k = 0; k < wide.values.size(); ++k) wide.values[k] = static_cast<double>(1000 * i + k) + 0.25;
      feed.publish(wide);
      loop.advance(10ms);
    }
    feed.close();
    loop.close();
  }
  break_end_of_row(path, 49'000 + 249 + 0.25);  // the last value of row 50
  const auto check_error = [](const Error& error) {
    CHECK(error.id() == "damaged");
    CHECK_MESSAGE(error.where.find("topic many, after run 1, sequence 49") != std::string::npos, error.where);
  };
  const auto recording = Recording::open(path).or_throw();
  auto rows = recording.rows({.topic = "many"}).or_throw();
  for (std::uint64_t sequence = 1; sequence < 50; ++sequence)
    REQUIRE(rows.next().or_throw()->header().sequence == sequence);
  const auto bad = rows.next();
  REQUIRE_FALSE(bad);
  check_error(bad.error());
  for (const char* format : {"csv", "jsonl"}) {
    CAPTURE(format);
    std::ostringstream out;
    const auto count = export_rows(recording, {.format = format, .filter = {.topic = "many"}}, out);
    REQUIRE_FALSE(count);
    check_error(count.error());
    const std::string text = out.str();
    CHECK(std::count(text.begin(), text.end(), '\n') == (std::string_view(format) == "csv" ? 50 : 49));
    CHECK(text.find("48249.25") != std::string::npos);
    CHECK(text.find('\0') == std::string::npos);
  }
}

TEST_CASE("FW-5 recorded times get the UTC of the last clock of the run") {
  const auto at = [](std::int64_t s) { return Time{std::chrono::seconds{s}}; };
  const auto pair = [&](std::int64_t monotonic, std::int64_t realtime, const char* source) {
    return RecordedClock{MonotonicTime{std::chrono::seconds{monotonic}}, at(realtime), "system", {}, source};
  };
  constexpr std::int64_t now = 1'800'000'000;
  SUBCASE("never set") {
    const std::vector<RecordedClock> clock{pair(100, now, "start"), pair(200, now + 100, "end")};
    CHECK(UtcLine(clock, std::chrono::seconds{now - 100}).utc(at(now + 50)) == at(now + 50));
    CHECK(UtcLine({}, std::chrono::seconds{now - 100}).utc(at(now + 50)) == at(now + 50));
  }
  SUBCASE("started in 1970 and set right later: before and after the step") {
    const std::vector<RecordedClock> clock{pair(10, 15, "start"), pair(60, now + 50, "step"),
                                           pair(100, now + 90, "end")};
    CHECK(UtcLine(clock, 5s).utc(at(15)) == at(now));
    CHECK(UtcLine(clock, 5s).utc(at(64)) == at(now + 49));
    CHECK(UtcLine(clock, 5s).utc(at(105)) == at(now + 90));
  }
  SUBCASE("set by an hour forwards or backwards: no hole and no hour twice") {
    for (const std::int64_t hour : {3600, -3600}) {
      const std::vector<RecordedClock> clock{pair(0, now, "start"), pair(60, now + 60 + hour, "step")};
      CHECK(UtcLine(clock, std::chrono::seconds{now}).utc(at(now + 59)) == at(now + 59 + hour));
      CHECK(UtcLine(clock, std::chrono::seconds{now}).utc(at(now + 61)) == at(now + 61 + hour));
    }
  }
  SUBCASE("a clock that fell back to 1970 overrules none that was set") {
    const std::vector<RecordedClock> clock{pair(0, now, "start"), pair(60, 0, "step"), pair(90, 30, "end")};
    CHECK(UtcLine(clock, std::chrono::seconds{now}).utc(at(now + 70)) == at(now + 70));
  }
  SUBCASE("the noise of reading two clocks moves nothing") {
    std::vector<RecordedClock> clock{pair(0, now, "start"), pair(60, now + 60, "end")};
    clock[1].realtime += 900us;
    CHECK(UtcLine(clock, std::chrono::seconds{now}).utc(at(now + 61)) == at(now + 61));
  }
}

TEST_CASE("FW-5 the summary tells rows, rates, lateness and losses of each topic") {
  const Folder folder;
  const std::string path = make(folder);
  sql(path, "UPDATE \"room/climate\" SET time = time + 2000000 WHERE sequence = 7");
  const auto topics = summary(Recording::open(path).or_throw(), 1).or_throw();
  REQUIRE(topics.size() == 2);
  CHECK(topics[0].topic == "every/thing");
  CHECK(topics[0].rows == 2);
  CHECK(topics[0].wanted_hertz == 0);
  CHECK_FALSE(topics[0].has_lateness);
  const TopicSummary& room = topics[1];
  CHECK(room.rows == 999);
  CHECK(room.wanted_hertz == doctest::Approx(100));
  CHECK(room.reached_hertz == doctest::Approx(100.0 * 999 / 1005).epsilon(0.001));
  CHECK(room.missed == 4);
  CHECK(room.failed == 2);
  CHECK(room.dropped == 0);
  REQUIRE(room.has_lateness);
  CHECK(room.lateness_p50 == Duration{0});
  CHECK(room.lateness_max >= 2ms);
  CHECK(room.is_complete);
  REQUIRE(room.first);
  CHECK(*room.last - *room.first >= 9990ms);
}

TEST_CASE("FW-5 of a run that was not closed the summary tells what is known, and rates of the accounted time") {
  const Folder folder;
  const std::string path = make(folder);
  sql(path, "UPDATE rtdata_run SET state = 'recording'");
  // Its last account was of the first 300 ticks.
  sql(path, "UPDATE rtdata_schedule SET scheduled = 300, end = first_due + 299 * period");
  sql(path,
      "UPDATE rtdata_ledger SET missed = 0, rows_up_to = (SELECT max(rowid) FROM \"room/climate\" WHERE time < "
      "(SELECT first_due + 299 * period FROM rtdata_schedule)) WHERE topic = 'room/climate'");
  const auto room = [&] { return summary(Recording::open(path).or_throw(), 1).or_throw().at(1); };
  CHECK_FALSE(room().is_complete);
  CHECK(room().rows == 999);
  CHECK(room().wanted_hertz == doctest::Approx(100));
  CHECK(room().reached_hertz == doctest::Approx(100).epsilon(0.03));
  std::ostringstream out, err;
  CHECK(app::info({.database = path}, out, err) == 0);
  CHECK(out.str().find(" 0+") != std::string::npos);
  CHECK(out.str().find("+: up to the last account; the run was not closed") != std::string::npos);
  // It never wrote one of its schedule.
  sql(path, "DELETE FROM rtdata_schedule");
  CHECK(room().wanted_hertz == 0);
  CHECK(room().reached_hertz == doctest::Approx(100).epsilon(0.03));
  out.str("");
  CHECK(app::info({.database = path, .show_as = app::ShowAs::json}, out, err) == 0);
  const auto json = nlohmann::json::parse(out.str());
  CHECK(json["topics"][1]["wanted_hz"].is_null());
  CHECK(json["topics"][1]["is_complete"] == false);
}

TEST_CASE("FW-5 the subcommand info shows runs, topics and fields") {
  const Folder folder;
  const std::string path = make(folder);
  std::ostringstream out, err;
  CHECK(app::info({.database = path}, out, err) == 0);
  CHECK(out.str().find("room/climate") != std::string::npos);
  CHECK(out.str().find("temperature [Cel]") != std::string::npos);
  std::istringstream lines(out.str());
  for (std::string line; std::getline(lines, line);) CHECK_MESSAGE((line.size() <= 80 || line == path), line);
  out.str("");
  CHECK(app::info({.database = path, .run = "5"}, out, err) == 1);
  CHECK(app::info({.database = folder / "none"}, out, err) == 2);
  CHECK(out.str() == "");
  CHECK(app::info({.database = path, .show_as = app::ShowAs::json}, out, err) == 0);
  const auto json = nlohmann::json::parse(out.str());
  CHECK(json["topics"][1]["rows"] == 999);
  CHECK(json["topics"][1]["name"] == "room/climate");  // the keys of a status
  CHECK(json["topics"][1]["lateness_ns"]["p50"] <= json["topics"][1]["lateness_ns"]["max"]);
  CHECK(json["topics"][1]["outage_time_s"] == 0.0);
  CHECK(json["descriptions"][1]["description"]["fields"][0]["unit"] == "Cel");
}

TEST_SUITE_END();
