// The UTC of what was recorded while clocks were wrong, set, and told by others.
#include <doctest/doctest.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <sstream>

#include "app/core/recording_commands.hpp"
#include "recording/deleted_runs.hpp"
#include "rtdata/recording/verify.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace recordings;

namespace {

constexpr Time noon{1'800'000'000s};

RecordedClock pair(Duration monotonic, Time realtime, std::optional<Duration> accuracy, std::string source = "system") {
  return {MonotonicTime{monotonic}, realtime, std::move(source), accuracy, "regular"};
}

/// A recording under way, by a clock that the test sets: a row a second.
struct Recorder {
  Recorder(const std::string& path, ManualClock& clock)
      : runtime({.clock = &clock}),
        loop(quiet(runtime), {}),
        sink(loop, {.path = path}),
        room(loop, {.name = "room", .rate = 1_Hz}, [] {
          return Climate{1, 2};
        }) {}
  ~Recorder() {
    room.close();
    loop.close();
  }
  static Runtime& quiet(Runtime& runtime) {
    runtime.on_log([](const LogRecord&) {});
    return runtime;
  }
  Runtime runtime;
  Loop loop;
  SqliteSink sink;
  Sensor<Climate> room;
};

/// The UTC of all rows by the view, which is that of the export; the recording is balanced.
std::vector<Time> utc_of(const std::string& path) {
  const auto recording = Recording::open(path).or_throw();
  const auto report = verify(recording).or_throw();
  CHECK_MESSAGE(report.verdict() == Verdict::balanced, report.text());
  const auto database = sqlite::Database::open(path, sqlite::Database::Mode::read);
  auto view = database.prepare("SELECT utc_ns, utc, time FROM \"room~utc\" ORDER BY run, time");
  auto rows = recording.rows({.topic = "room"}).or_throw();
  std::vector<Time> all;
  while (view.step()) {
    const Time utc = from_nanoseconds(view.integer(0));
    CHECK(view.text(1) == to_iso8601(utc));
    const RecordedRow* row = rows.next().or_throw();
    REQUIRE(row != nullptr);
    CHECK(to_nanoseconds(row->header().time) == view.integer(2));
    CHECK(recording.utc_line(row->run()).or_throw().utc(row->header().time) == utc);
    all.push_back(utc);
  }
  CHECK(rows.next().or_throw() == nullptr);
  std::ostringstream out, err;
  CHECK(app::export_recording({.database = path, .times = app::ExportOptions::Times::utc}, out, err) == 0);
  std::istringstream lines(out.str());
  std::string line;
  std::getline(lines, line);  // the header
  for (const Time utc : all) {
    REQUIRE(std::getline(lines, line));
    CHECK(line.starts_with(to_iso8601(utc) + ","));
  }
  return all;
}

/// Times a second apart from `first` on.
std::vector<Time> seconds_from(Time first, std::size_t count) {
  std::vector<Time> times;
  for (std::size_t i = 0; i < count; ++i) times.push_back(first + static_cast<std::int64_t>(i) * Duration{1s});
  return times;
}

bool rises(const std::vector<Time>& times) {
  return std::adjacent_find(times.begin(), times.end(), std::greater_equal<>()) == times.end();
}

}  // namespace

TEST_SUITE_BEGIN("sinks");

TEST_CASE("US-34 a clock that nobody keeps right is set by an hour: the last setting holds for all rows") {
  for (const Duration hour : {Duration{1h}, Duration{-1h}}) {
    const Folder folder;
    ManualClock clock(noon);
    {
      Recorder recorder(folder / "run.db", clock);
      recorder.loop.advance(20s);
      clock.set_realtime(clock.realtime() + hour);
      recorder.loop.advance(20s);
    }
    CHECK(utc_of(folder / "run.db") == seconds_from(noon + hour, 41));
    CHECK(number(folder / "run.db", "SELECT max(time) FROM room") == to_nanoseconds(noon + 40s));  // as stored: no jump
  }
}

TEST_CASE("US-34 an hour's step of a clock that was right overrules it only once somebody keeps the new time right") {
  const Folder folder;
  ManualClock clock(noon);
  clock.set_accuracy(5ms);
  {
    Recorder recorder(folder / "run.db", clock);
    recorder.loop.advance(20s);
    clock.set_realtime(clock.realtime() - 1h);  // by hand: the kernel takes it for not right any more
    clock.set_accuracy({});
    recorder.loop.advance(20s);
  }
  CHECK(utc_of(folder / "run.db") == seconds_from(noon, 41));
}

TEST_CASE("US-34 a start in 1970 that is set right later: the rows from before get the right UTC") {
  const Folder folder;
  ManualClock clock(Time{});  // at the epoch exactly
  {
    Recorder recorder(folder / "run.db", clock);
    recorder.loop.advance(30s);
    clock.set_realtime(noon);
    recorder.loop.advance(30s);
    clock.set_realtime(clock.realtime() + 40ms);  // the first setting was only nearly right
    clock.set_accuracy(2ms);
    recorder.loop.advance(30s);
  }
  CHECK(number(folder / "run.db", "SELECT min(time) FROM room") == 0);
  CHECK(utc_of(folder / "run.db") == seconds_from(noon - 30s + 40ms, 91));
  CHECK(number(folder / "run.db", "SELECT started_ns FROM rtdata_run_utc") == to_nanoseconds(noon - 30s + 40ms));
  CHECK(number(folder / "run.db", "SELECT ended = '2027-01-15T08:01:00.040000000Z' FROM rtdata_run_utc") == 1);
}

TEST_CASE("US-34 a leap second: UTC is right before and after it, and goes back nowhere") {
  const Folder folder;
  ManualClock clock(noon);
  clock.set_accuracy(2ms);
  {
    Recorder recorder(folder / "run.db", clock);
    recorder.loop.advance(25min + 500ms);
    clock.set_realtime(clock.realtime() - 1s);
    recorder.loop.advance(25min + 500ms);
  }
  const auto utc = utc_of(folder / "run.db");
  REQUIRE(utc.size() == 3002);
  CHECK(rises(utc));
  CHECK(utc[1200] == noon + 1200s);
  CHECK(utc[2101] == noon + 2100s);
  CHECK(utc.back() == noon + 3000s);
}

TEST_CASE("US-34 a machine that slept while its clock was right: both sides keep their UTC") {
  const Folder folder;
  ManualClock clock(noon);
  clock.set_accuracy(2ms);
  {
    Recorder recorder(folder / "run.db", clock);
    recorder.loop.advance(100500ms);
    clock.set_realtime(clock.realtime() + 1h);
    recorder.loop.advance(100s);
  }
  const auto utc = utc_of(folder / "run.db");
  REQUIRE(utc.size() == 201);
  CHECK(rises(utc));
  CHECK(utc[99] == noon + 99s);
  CHECK(utc[102] == noon + 1h + 102s);
}

TEST_CASE("US-34 a plugged clock that is better than the machine's binds the rows, and its drift is followed") {
  const Folder folder;
  ManualClock clock(noon);
  {
    Recorder recorder(folder / "run.db", clock);
    // The machine is 7 s slow and loses 20 ms in 1000 s.
    const auto right = [&] {
      return noon + 7s + recorder.loop.now().time_since_epoch() + recorder.loop.now().time_since_epoch() / 50'000;
    };
    recorder.loop.advance(100s);
    Ticker gps(recorder.loop, 1s, [&](const Tick&) {
      (void)recorder.runtime.note_wall_clock(
          {.monotonic = recorder.loop.now(), .realtime = right(), .source = "gps", .accuracy = 1us});
    });
    recorder.loop.advance(2000s);
  }
  const auto utc = utc_of(folder / "run.db");
  REQUIRE(utc.size() == 2101);
  CHECK(rises(utc));
  CHECK(utc[0] == noon + 7s + 2ms);  // parallel before the first
  for (const std::int64_t i : {100, 333, 1000, 2100}) {
    CHECK(std::chrono::abs(utc[static_cast<std::size_t>(i)] - (noon + 7s + i * Duration{1s} + i * Duration{20us})) <=
          1ns);
  }
  CHECK(number(folder / "run.db", "SELECT count(*) FROM rtdata_clock WHERE source = 'gps'") == 5);
  CHECK(number(folder / "run.db", "SELECT accuracy FROM rtdata_clock WHERE source = 'gps'") == 1000);
  CHECK(number(folder / "run.db", "SELECT count(*) FROM rtdata_clock WHERE source = 'system' AND accuracy IS NULL") ==
        2);
}

TEST_CASE("US-34 a suspension between runs or within one moves no row, whether or not the clock is synchronised") {
  for (const bool is_known : {false, true}) {
    CAPTURE(is_known);
    const Folder folder;
    ManualClock clock(noon);
    if (is_known) clock.set_accuracy(3ms);
    { Recorder(folder / "run.db", clock).loop.advance(10s); }
    clock.pass(1s);
    clock.suspend(8h);
    clock.set_accuracy(std::nullopt);
    {
      Recorder recorder(folder / "run.db", clock);
      recorder.loop.advance(10'500ms);
      clock.suspend(1h);
      recorder.loop.advance(10s);
    }
    auto expected = seconds_from(noon, 11);
    const auto append = [&](Time from, std::size_t count) {
      const auto more = seconds_from(from, count);
      expected.insert(expected.end(), more.begin(), more.end());
    };
    append(noon + 11s + 8h, 11);
    append(noon + 22s + 9h, 10);
    CHECK(utc_of(folder / "run.db") == expected);
    CHECK(number(folder / "run.db", "SELECT count(*) FROM rtdata_clock WHERE occasion = 'suspended'") == 1);
    CHECK(number(folder / "run.db", "SELECT max(suspended) FROM rtdata_clock") == Duration{9h}.count());
  }
}

TEST_CASE("US-34 a clock that is set after a suspension moves the rows before it by that, and by nothing else") {
  const Folder folder;
  ManualClock clock(noon);
  { Recorder(folder / "run.db", clock).loop.advance(10s); }
  clock.pass(1s);
  clock.suspend(8h);
  clock.set_realtime(clock.realtime() + 5s);
  { Recorder(folder / "run.db", clock).loop.advance(10s); }
  auto expected = seconds_from(noon + 5s, 11);
  const auto second = seconds_from(noon + 16s + 8h, 11);
  expected.insert(expected.end(), second.begin(), second.end());
  CHECK(utc_of(folder / "run.db") == expected);
}

TEST_CASE("US-34 two runs of one boot: what the second learns binds the first, which ended before") {
  const Folder folder;
  ManualClock clock(Time{5s});
  { Recorder(folder / "run.db", clock).loop.advance(10s); }
  CHECK(utc_of(folder / "run.db") == seconds_from(Time{5s}, 11));
  clock.pass(10s);
  clock.set_realtime(noon);
  clock.set_accuracy(3ms);
  { Recorder(folder / "run.db", clock).loop.advance(10s); }
  auto expected = seconds_from(noon - 20s, 11);
  const auto second = seconds_from(noon, 11);
  expected.insert(expected.end(), second.begin(), second.end());
  CHECK(utc_of(folder / "run.db") == expected);
  ManualClock other(noon + 24h);  // another boot changes nothing of it
  { Recorder(folder / "run.db", other).loop.advance(2s); }
  const auto third = seconds_from(noon + 24h, 3);
  expected.insert(expected.end(), third.begin(), third.end());
  CHECK(utc_of(folder / "run.db") == expected);
  CHECK(number(folder / "run.db",
               "SELECT count(*) FROM rtdata_run_utc WHERE started = '2027-01-15T07:59:40.000000000Z'") == 1);
}

TEST_CASE("US-34 info, verify, gaps, errors, health, views and exports of a run show one and the same UTC") {
  const Folder folder;
  const std::string path = folder / "run.db";
  ManualClock clock(noon + 24h * 1100);  // 2030
  {
    Recorder recorder(path, clock);
    recorder.loop.on_error([](const ErrorReport&) {});
    int reads = 0;
    Sensor<Climate> bad(recorder.loop, {.name = "bad", .rate = 1_Hz}, [&]() -> Result<Climate> {
      if (++reads > 3 && reads < 8) return Error{Errc::io_failed, "no answer", "", "", ""};
      return Climate{1, 2};
    });
    recorder.loop.advance(10s);
    clock.set_realtime(noon + 10s);
    clock.set_accuracy(3ms);
    recorder.loop.advance(10s);
    bad.close();
  }
  CHECK(number(path, "SELECT min(time) FROM room") == to_nanoseconds(noon + 24h * 1100));  // as recorded
  std::ostringstream info, info_json, rows, err;
  CHECK(app::info({.database = path, .gaps = app::InfoOptions::Gaps::listed}, info, err) == 0);
  CHECK(app::info({.database = path, .show_as = app::ShowAs::json, .gaps = app::InfoOptions::Gaps::listed}, info_json,
                  err) == 0);
  CHECK(app::export_recording({.database = path, .topic = "bad", .times = app::ExportOptions::Times::utc}, rows, err) ==
        0);
  const VerifyReport report = verified(path);
  CHECK(report.verdict() == Verdict::balanced);
  const std::string span = "2027-01-15T08:00:00Z to 2027-01-15T08:00:20Z";
  for (const std::string& text : {info.str(), report.text(), rows.str()}) {
    CAPTURE(text);
    CHECK(text.find("2030") == std::string::npos);
    CHECK((text.find(span) != std::string::npos || text.find(",bad,") != std::string::npos));
  }
  CHECK(info.str().find("2027-01-15T08:00:03.000000000Z to 2027-01-15T08:00:06.000000000Z bad on") !=
        std::string::npos);
  CHECK(info.str().find("  2027-01-15T08:00:03Z sensor bad") != std::string::npos);
  const auto shown = nlohmann::json::parse(info_json.str());
  const auto told = nlohmann::json::parse(report.to_json());
  for (const auto& run : {shown["runs"][0], told["runs"][0]}) {
    CHECK(run["started_utc"] == "2027-01-15T08:00:00.000000000Z");
    CHECK(run["ended_utc"] == "2027-01-15T08:00:20.000000000Z");
  }
  CHECK(shown["errors"][0]["utc"] == "2027-01-15T08:00:03.000000000Z");
  CHECK(shown["gaps"][0]["first_utc"] == "2027-01-15T08:00:03.000000000Z");
  CHECK(number(path, "SELECT count(*) FROM rtdata_run_utc WHERE started = '2027-01-15T08:00:00.000000000Z'") == 1);
  // What verify complains of, too.
  sql(path,
      "UPDATE room SET time = time - 8000000000 WHERE sequence = 15; UPDATE rtdata_gap SET last = last + 30000000000");
  const std::string problems = problems_of(verified(path));
  CAPTURE(problems);
  CHECK(problems.find("the time of sequence 15, 2027-01-15T08:00:06.000000000Z") != std::string::npos);
  CHECK(problems.find("the gap of 2027-01-15T08:00:03.000000000Z") != std::string::npos);
  CHECK(problems.find("2030") == std::string::npos);
  // And what is left of a run that was deleted.
  {
    auto database = sqlite::Database::open(path, sqlite::Database::Mode::write);
    sqlite::delete_run(database, 1);
  }
  CHECK(number(path, "SELECT min(started) FROM rtdata_deleted") == to_nanoseconds(noon));
  CHECK(number(path, "SELECT max(ended) FROM rtdata_deleted") == to_nanoseconds(noon + 20s));
}

TEST_CASE("US-34 the UTC line: who counts, and between whom") {
  const auto at = [](double s) {
    return noon + std::chrono::duration_cast<Duration>(std::chrono::duration<double>(s));
  };
  const auto utc = [](const std::vector<RecordedClock>& pairs, Duration monotonic) {
    return UtcLine(pairs).utc(Time{monotonic});
  };
  SUBCASE("the unknown give way to the known, whenever") {
    CHECK(utc({pair(10s, at(0), {}), pair(20s, at(500), 1s), pair(30s, at(900), {})}, 25s) == at(505));
  }
  SUBCASE("the less accurate count only far from the better: 1 ppm") {
    const std::vector<RecordedClock> pairs{pair(0s, at(0), 1us, "gps"), pair(100s, at(100.1), 10ms),
                                           pair(20'000s, at(20'000.5), 10ms)};
    CHECK(utc(pairs, 100s) == at(100) + 2500us);  // on the straight line, not on the second pair
    CHECK(utc(pairs, 20'000s) == at(20'000.5));
    CHECK(utc(pairs, 30'000s) == at(30'000.5));
  }
  SUBCASE("two that say different at one instant: the better one") {
    CHECK(utc({pair(10s, at(0), 5ms), pair(10s, at(1), 4ms, "gps")}, 12s) == at(3));
    CHECK(utc({pair(10s, at(1), 4ms, "gps"), pair(10s, at(0), 5ms)}, 12s) == at(3));
    CHECK(utc({pair(10s, at(1), 4ms), pair(10s, at(0), 4ms)}, 12s) == at(2));  // the later one
  }
  SUBCASE("whatever they say, it does not go back") {
    const std::vector<RecordedClock> pairs{pair(0s, at(0), 1ms), pair(10s, at(10), 1ms), pair(11s, at(9.5), 1ms),
                                           pair(30s, at(2), 2us), pair(40s, at(50), 1ms)};
    const UtcLine line(pairs);
    bool goes_back = false;
    for (std::int64_t ns = 0; ns < 50'000'000'000; ns += 9'999'991) {
      goes_back = goes_back || line.utc(from_nanoseconds(ns + 1)) < line.utc(from_nanoseconds(ns)) ||
                  line.utc(from_nanoseconds(ns + 9'999'991)) < line.utc(from_nanoseconds(ns));
    }
    CHECK_FALSE(goes_back);
  }
  SUBCASE("a run that starts after a suspension begins a little before its first pair") {
    std::vector<RecordedClock> pairs{pair(10s, at(0), {}), pair(11s, at(1), {}), pair(12s, at(3602), {})};
    pairs[0].occasion = pairs[2].occasion = "start";
    pairs[1].occasion = "end";
    pairs[2].suspended = 1h;
    CHECK(utc(pairs, 11s) == at(1));
    CHECK(utc(pairs, 12s - 1ms) == at(3602) - 1ms);
    CHECK(utc(pairs, 12s) == at(3602));
  }
  SUBCASE("a time from before the boot has a clock of its own, and stays") {
    CHECK(UtcLine(std::vector{pair(10s, at(0), 1ms)}, 100s).utc(Time{99s}) == Time{99s});
    CHECK(UtcLine(std::vector{pair(10s, at(0), 1ms)}, 100s).utc(Time{110s}) == at(0));
  }
  SUBCASE("pairs from before the beginning, which a copy has of earlier runs: the same line, in order") {
    const auto all_at = [&](Duration moved) {
      std::vector<RecordedClock> pairs;
      for (const auto& [when, realtime] : {std::pair{10s, at(10)}, {20s, at(20)}, {30s, at(31)}, {40s, at(41)}})
        pairs.push_back(pair(when - moved, realtime, 1ms));
      return pairs;
    };
    for (const Duration moved : {Duration{15s}, Duration{25s}, Duration{30s}, Duration{35s}, Duration{50s}}) {
      CAPTURE(to_string(moved));
      const UtcLine line(all_at(moved));
      CHECK(std::is_sorted(line.stretches().begin(), line.stretches().end(),
                           [](const auto& a, const auto& b) { return a.since < b.since; }));
      for (const Duration when : {Duration{25s}, Duration{30s}, Duration{36s}, Duration{51s}}) {
        if (when >= moved) CHECK(line.utc(Time{when - moved}) == UtcLine(all_at(0s)).utc(Time{when}));
      }
    }
    // A line that does not bend there begins at 0, as those that are written in files do.
    REQUIRE(UtcLine(all_at(15s)).stretches().size() == 3);
    CHECK(UtcLine(all_at(15s)).stretches()[0].since == MonotonicTime{});
    CHECK(UtcLine(std::vector{pair(-5s, at(0), 1ms)}).stretches()[0].since == MonotonicTime{});
  }
}

namespace {

struct Odd {
  double utc = 0;
  std::int64_t utc_ns = 0;
  friend constexpr auto describe(type_tag<Odd>) {
    return rtdata::record("odd", field("UTC", &Odd::utc, "s"), field("utc_ns", &Odd::utc_ns));
  }
};
struct OddAndMore {
  double utc = 0;
  std::int64_t utc_ns = 0;
  double more = 0;
  friend constexpr auto describe(type_tag<OddAndMore>) {
    return rtdata::record("odd", field("UTC", &OddAndMore::utc, "s"), field("utc_ns", &OddAndMore::utc_ns),
                          field("more", &OddAndMore::more));
  }
};
struct OddInOtherUnits {
  double utc = 0;
  friend constexpr auto describe(type_tag<OddInOtherUnits>) {
    return rtdata::record("odd", field("UTC", &OddInOtherUnits::utc, "h"));
  }
};

}  // namespace

TEST_CASE("US-34 the views follow added fields and changed units, and fields called utc keep a column") {
  const Folder folder;
  const std::string path = folder / "run.db";
  const auto publish = [&](auto payload, const char* topic = "rtdata_odd") {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    loop.topic<decltype(payload)>(topic).publish(payload);
    loop.close();
  };
  publish(Odd{1, 2});
  CHECK(number(path, "SELECT \"utc_ns~\" FROM \"topic~rtdata_odd~utc\" WHERE \"UTC~\" = 1") == 2);
  publish(OddAndMore{3, 4, 5});
  CHECK(number(path,
               "SELECT more FROM \"topic~rtdata_odd~utc\" WHERE utc = '2023-11-14T22:13:20.000000000Z' AND run = 2") ==
        5);
  publish(OddInOtherUnits{6});
  CHECK(number(path, "SELECT \"UTC~\" FROM \"topic~rtdata_odd~2~utc\" WHERE utc_ns = time") == 6);
  publish(Odd{7, 8}, "topic/utc");  // a topic of any name has its own
  CHECK(number(path, "SELECT count(*) FROM \"topic/utc~utc\"") == 1);
  CHECK(verified(path).verdict() == Verdict::balanced);
}

TEST_CASE("US-34 verify complains when times of an origin go back, or the UTC line is not that of the clock pairs") {
  const Folder folder;
  const std::string path = make(folder);
  const auto problems = [&] {
    const auto report = verified(path);
    CHECK(report.verdict() == Verdict::not_balanced);
    return report.text();
  };
  sql(path, "UPDATE rtdata_utc SET \"offset\" = \"offset\" + 1");
  CHECK(problems().find("rtdata_utc") != std::string::npos);
  sql(path,
      "UPDATE rtdata_utc SET \"offset\" = \"offset\" - 1; UPDATE \"room/climate\" SET time = time - 20000000 WHERE "
      "sequence = 7");
  CHECK(problems().find("is not after that of the row before") != std::string::npos);
}

TEST_SUITE_END();
