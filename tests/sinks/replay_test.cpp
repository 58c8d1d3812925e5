// What was recorded is given to handlers and sinks again.
#include "rtdata/recording/replay.hpp"

#include <doctest/doctest.h>

#include <cstring>
#include <limits>
#include <map>

#include "rtdata/loop/runtime.hpp"
#include "rtdata/sinks/file.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace recordings;
using namespace std::chrono_literals;

namespace {

struct Kelvin {
  double temperature = 0;
  RTDATA_FIELDS(Kelvin, (temperature, "K"))
};

/// A loop in virtual time whose times are those of a run.
struct Again {
  explicit Again(Time start) : clock(start), runtime({.clock = &clock}), loop(runtime, {.name = "again"}) {
    runtime.on_log([this](const LogRecord& record) { log += std::string(record.text) + "\n"; });
    loop.on_error([this](const ErrorReport& report) { errors += report.error.text() + "\n"; });
  }
  explicit Again(const std::string& path) : Again(Recording::open(path).or_throw().runs().or_throw().back().started) {}
  void finish(Replay& replay) {
    for (int i = 0; i < 100 && !replay.is_done(); ++i) loop.advance(1min);
    CHECK(replay.is_done());
  }
  ManualClock clock;
  Runtime runtime;
  Loop loop;
  std::string log, errors;
};

/// Everything that a handler of all topics gets, with the loop's time.
std::string deliveries(const std::string& path, ReplayConfig config = {}) {
  config.file = path;
  Again again(path);
  std::string all;
  auto heard = again.loop.subscribe("#", [&](const EventView& event) {
    all += std::string(event.topic()) + " " + std::string(event.origin()) + " " + std::to_string(event.sequence()) +
           " " + std::to_string(to_nanoseconds(event.time())) + " " +
           std::to_string(to_nanoseconds(again.loop.time())) + " ";
    for (const std::byte byte : event.payload()) all += static_cast<char>('a' + (std::to_integer<int>(byte) & 15));
    all += "\n";
  });
  Replay replay(again.loop, config);
  again.finish(replay);
  CHECK(again.errors == "");
  return all;
}

/// Records a replay; returns the copy.
std::string copied(const Folder& folder, const std::string& path, ReplayConfig config = {},
                   const std::string& name = "copy.db") {
  config.file = path;
  Again again(path);
  SqliteSink sink(again.loop, {.path = folder / name});
  Replay replay(again.loop, config);
  again.finish(replay);
  CHECK(again.loop.close() == 0);
  CHECK(again.runtime.balances());
  CHECK(again.errors == "");
  return folder / name;
}

/// The rows of a query, a line each.
std::string listed(const std::string& path, const std::string& query) {
  const auto database = sqlite::Database::open(path, sqlite::Database::Mode::read);
  auto statement = database.prepare(query);
  std::string all;
  while (statement.step()) {
    for (int column = 0; column < sqlite3_column_count(statement.raw()); ++column)
      all += (statement.is_null(column) ? "NULL" : std::string(statement.text(column))) + "|";
    all += "\n";
  }
  return all;
}

constexpr const char* account =
    "SELECT topic, origin, has_schedule, scheduled, taken, missed, failed, in_flight, late, received, published, "
    "repeated, filtered, lost, offered, stored, first_sequence, last_sequence, carried, unreadable, one_a_read, "
    "lateness "
    "FROM rtdata_ledger ORDER BY run, topic, origin";
constexpr const char* schedule = "SELECT * FROM rtdata_schedule ORDER BY run, origin, first_due";
constexpr const char* gaps = "SELECT * FROM rtdata_gap ORDER BY run, first, origin";

}  // namespace

TEST_SUITE_BEGIN("sinks");

TEST_CASE("FW-5 a replay gives the recorded events again, the same each time") {
  const Folder folder;
  const std::string path = make(folder);
  Again again(path);
  std::uint64_t count = 0;
  std::string order;
  auto climate = again.loop.subscribe<Climate>("room/climate", [&](const Event<Climate>& event) {
    ++count;
    CHECK(event.sequence == count);
    CHECK(event.origin == "room");
    CHECK(event.time == again.loop.time());
    if (order.empty() || order.back() != 'c') order += 'c';
  });
  auto other = again.loop.subscribe<Everything>("every/thing", [&](const Event<Everything>& event) {
    if (event.sequence == 1) CHECK(event.data == full());
    order += 'e';
  });
  Replay replay(again.loop, {.file = path});
  int ends = 0;
  replay.on_done([&](const Result<void>& how) {
    CHECK(how);
    ++ends;
  });
  CHECK(replay.run() == 1);
  again.loop.advance(1s);
  CHECK(count == 100);  // 1 s of 100 Hz, up to the failures
  again.finish(replay);
  CHECK(count == 999);
  CHECK(order == "cecec");  // in the order of time, of topics at one
  CHECK(ends == 1);
  CHECK(replay.counts().events == 1001);
  CHECK(replay.counts().gaps == 2);
  CHECK(replay.counts().refused == 0);
  CHECK(again.log.find("has ended: 1001 events and 2 gaps") != std::string::npos);

  const std::string first = deliveries(path);
  CHECK(std::count(first.begin(), first.end(), '\n') == 1001);
  CHECK(deliveries(path) == first);
}

TEST_CASE("FW-5 what is replayed is recorded as a copy: events, account, schedule, gaps and health") {
  const Folder folder;
  const std::string path = make(folder);
  const std::string copy = copied(folder, path);
  check_balanced(copy);
  for (const char* query : {"SELECT * FROM \"room/climate~utc\" ORDER BY run, sequence",
                            "SELECT * FROM \"every/thing~utc\" ORDER BY run, sequence", account, schedule, gaps})
    CHECK(listed(copy, query) == listed(path, query));
  const char* const health = "SELECT time, kind, name, state, reason FROM rtdata_health WHERE kind = 'sensor'";
  CHECK(listed(copy, health) == listed(path, health));
  CHECK(listed(copy, health) != "");
  // A copy of the copy, too.
  const std::string second = copied(folder, copy, {}, "second.db");
  check_balanced(second);
  CHECK(listed(second, account) == listed(path, account));
  CHECK(deliveries(second) == deliveries(path));
}

TEST_CASE("FW-5 a part of the time, and a run that was not closed, are replayed without a schedule") {
  const Folder folder;
  const std::string path = make(folder);
  const Time start = Recording::open(path).or_throw().runs().or_throw()[0].started;
  const std::string part = copied(
      folder, path,
      {.from = std::to_string(to_nanoseconds(start + 500ms)), .until = std::to_string(to_nanoseconds(start + 2s))},
      "part.db");
  check_balanced(part);
  CHECK(number(part, "SELECT count(*) FROM \"room/climate\"") == 148);
  CHECK(number(part, "SELECT min(sequence) FROM \"room/climate\"") == 51);
  CHECK(listed(part, "SELECT kind, count FROM rtdata_gap") == "silent|NULL|\n");
  CHECK(listed(part, "SELECT has_schedule, first_sequence, last_sequence FROM rtdata_ledger WHERE origin = 'room'") ==
        "0|51|198|\n");
  const std::string in_utc = copied(folder, path, {.from = to_iso8601(start + 9s)}, "utc.db");
  CHECK(number(in_utc, "SELECT count(*) FROM \"room/climate\"") ==
        number(path,
               "SELECT count(*) FROM \"room/climate\" WHERE time >= " + std::to_string(to_nanoseconds(start + 9s))));
  check_balanced(in_utc);

  sql(path, "UPDATE rtdata_run SET state = 'sealed', lost = 0");
  const std::string sealed = copied(folder, path, {}, "sealed.db");
  check_balanced(sealed);
  CHECK(number(sealed, "SELECT count(*) FROM \"room/climate\"") == 999);
  CHECK(number(sealed, "SELECT sum(has_schedule) FROM rtdata_ledger") == 0);
}

namespace {

struct First {
  double a = 0;
  RTDATA_FIELDS(First, (a))
};
struct Second {
  double a = 0, b = 0;
  RTDATA_FIELDS(Second, (a), (b))
};

}  // namespace

TEST_CASE("a replay of topics that are not there names those that are, each once") {
  const Folder folder;
  const std::string path = folder / "changed.db";
  for (const bool is_first : {true, false}) {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    if (is_first)
      loop.topic<First>("x").publish({1});
    else
      loop.topic<Second>("x").publish({1, 2});
    loop.advance(2s);
    CHECK(loop.close() == 0);
  }
  Again again(path);
  CHECK_THROWS_WITH_AS(Replay(again.loop, {.file = path, .run = 2, .topics = {"none"}}),
                       doctest::Contains("its topics are x"), SetupError);
  try {
    Replay(again.loop, {.file = path, .run = 2, .topics = {"none"}});
  } catch (const SetupError& error) {
    CHECK(std::string(error.what()).find("x, x") == std::string::npos);
  }
}

TEST_CASE("FW-5 a replay chooses topics, renames them and the origins, and is as fast as it is told to be") {
  const Folder folder;
  const std::string path = make(folder);
  Again again(path);
  SqliteSink sink(again.loop, {.path = folder / "copy.db"});
  Sensor<Climate> live(again.loop, {.name = "room", .topic = "room/climate", .rate = 1_Hz}, [] {
    return Climate{1, 2};
  });
  Replay replay(again.loop,
                {.file = path, .topics = {"room/#"}, .rename = {"room=old/room"}, .prefix = "old ", .speed = 10});
  again.loop.advance(900ms);
  CHECK_FALSE(replay.is_done());
  again.loop.advance(150ms);
  CHECK(replay.is_done());
  replay.close();
  live.close();
  CHECK(again.loop.close() == 0);
  check_balanced(folder / "copy.db");
  CHECK(listed(folder / "copy.db", "SELECT topic, origin, offered FROM rtdata_ledger ORDER BY topic") ==
        "old/room/climate|old room|999|\nroom/climate|room|2|\n");
  CHECK(number(folder / "copy.db", "SELECT count(*) FROM \"old/room/climate\"") == 999);
}

TEST_CASE("FW-5 several topics are replayed by their names, and those beside them are left out") {
  const Folder folder;
  const std::string path = folder / "three.db";
  {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    Feed<Climate> one(loop, {.name = "one", .topic = "room/one"}), two(loop, {.name = "two", .topic = "room/two"}),
        three(loop, {.name = "three", .topic = "yard"});
    for (int i = 0; i < 10; ++i) {
      for (Feed<Climate>* feed : {&one, &two, &three}) feed->publish({1.0 * i, 2});
      loop.advance(100ms);
    }
    two.fault({Errc::disconnected, "it is gone", "", "", ""});
    loop.advance(1s);
    two.publish({11, 2});
    loop.close();
  }
  for (const std::vector<std::string>& topics :
       std::vector<std::vector<std::string>>{{"room/two", "yard"}, {"yard", "room/two"}, {"room/+", "yard"}}) {
    Again again(path);
    std::map<std::string, int> events;
    const auto heard = again.loop.subscribe("#", [&](const EventView& event) { ++events[std::string(event.topic())]; });
    Replay replay(again.loop, {.file = path, .topics = topics});
    again.finish(replay);
    CHECK(again.errors == "");
    CHECK(replay.counts().refused == 0);
    CHECK(events["room/two"] == 11);
    CHECK(events["yard"] == 10);
    CHECK(events["room/one"] == (topics.front() == "room/+" ? 10 : 0));
  }
}

TEST_CASE("FW-5 what a recording dropped is dropped again, and counted") {
  const Folder folder;
  const std::string path = make(folder);
  written_as(path,
             "DELETE FROM \"room/climate\" WHERE sequence IN (1, 2, 50, 51, 52, 999);"
             "UPDATE rtdata_ledger SET stored = stored - 6, dropped_oldest = 6 WHERE origin = 'room';" +
                 drop_steps);
  check_balanced(path);
  const std::string copy = copied(folder, path);
  check_balanced(copy);
  CHECK(listed(copy,
               "SELECT stored, dropped_newest, first_sequence, last_sequence FROM rtdata_ledger"
               " WHERE origin = 'room'") == "993|6|1|999|\n");
  CHECK(listed(copy, gaps) == listed(path, gaps));
}

TEST_CASE(
    "FW-5 a replay of a whole run has the account of topics without rows: of those that are chosen, said if not") {
  const Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    const SqliteSink sink(loop, {.path = path});
    const auto fails = []() -> Result<Climate> { return Error{Errc::io_failed, "no answer", "", "", ""}; };
    const Sensor<Climate> mute(loop, {.name = "mute", .rate = 10_Hz}, fails),
        old(loop, {.name = "probe", .topic = "old/probe", .rate = 10_Hz}, fails);
    Feed<Kelvin> feed(loop, {.name = "feed"}), line(loop, {.name = "line"}), dropped(loop, {.name = "dropped"});
    line.fault({Errc::disconnected, "cannot hear", "", "it is gone", ""});
    for (int i = 0; i < 20; ++i) {
      feed.publish({1.0 * i});
      dropped.publish({1.0 * i});
      loop.advance(100ms);
    }
    loop.close();
  }
  written_as(path,
             "DELETE FROM dropped; DROP TABLE IF EXISTS \"dropped~1s\"; DROP TABLE IF EXISTS \"dropped~1min\";"
             "UPDATE rtdata_ledger SET stored = 0, dropped_oldest = 20, seconds_from = 0, minutes_from = 0"
             " WHERE origin = 'dropped';");
  const auto lines_of = [](const std::string& recording) {
    const RunReport run = check_balanced(recording).runs.at(0);
    std::string lines;
    for (const std::string& line : run.lines) lines += line + "\n";
    return lines;
  };
  const std::string lost = lines_of(path);
  CHECK_MESSAGE(lost.find("21 ticks of mute (failed 21)") != std::string::npos, lost);
  const std::string copy = copied(folder, path);
  CHECK(lines_of(copy) == lost);
  for (const char* query : {account, schedule, gaps}) CHECK(listed(copy, query) == listed(path, query));
  CHECK(listed(copy, "SELECT dropped_newest FROM rtdata_ledger WHERE origin = 'dropped'") == "20|\n");
  const std::string second = copied(folder, copy, {}, "second.db");
  CHECK(lines_of(second) == lost);

  const std::string part = copied(folder, path, {.topics = {"feed", "old/#"}, .rename = {"old=new"}}, "part.db");
  check_balanced(part);
  CHECK(listed(part, "SELECT topic, failed FROM rtdata_ledger ORDER BY topic") == "feed|0|\nnew/probe|21|\n");

  {  // a file sink has no account, and so does not take them
    Again again(path);
    FileSink sink(again.loop, {.path = folder / "all.csv", .format = "csv", .sink = {.topics = {"#"}}});
    Replay replay(again.loop, {.file = path});
    again.finish(replay);
    CHECK(sink.health() == Health::ok);
    CHECK(again.loop.close() == 0);
    CHECK(again.errors == "");
  }
  {  // one that cannot be given is told
    Again again(path);
    const Feed<Climate> taken(again.loop, {.name = "mute"});
    Replay replay(again.loop, {.file = path});
    again.finish(replay);
    CHECK_MESSAGE(again.log.find("the account of mute is not replayed: ") != std::string::npos, again.log);
  }
  written_as(path, "UPDATE rtdata_ledger SET offered = 19, dropped_oldest = 19 WHERE origin = 'dropped'");
  Again again(path);
  Replay replay(again.loop, {.file = path});
  again.finish(replay);
  CHECK_MESSAGE(again.log.find("it is not replayed as a whole") != std::string::npos, again.log);
}

TEST_CASE("FW-5 a replay that is stopped early says so, and what it gave is recorded") {
  const Folder folder;
  const std::string path = make(folder);
  // In the middle of it, after nothing, within and after gaps.
  for (const Duration after : {Duration{0}, Duration{300ms}, Duration{1s}, Duration{1010ms}, Duration{1030ms},
                               Duration{5s}, Duration{5020ms}, Duration{8s}}) {
    CAPTURE(after.count());
    const std::string early = folder / ("early" + std::to_string(after.count()) + ".db");
    Again again(path);
    SqliteSink sink(again.loop, {.path = early});
    std::uint64_t count = 0;
    auto heard = again.loop.subscribe("room/#", [&](const EventView&) { ++count; });
    Replay replay(again.loop, {.file = path});
    again.loop.advance(after);
    CHECK(again.loop.close() == 0);
    CHECK(replay.is_done());
    const std::uint64_t before = count;
    again.loop.advance(10s);
    CHECK(count == before);
    CHECK(again.log.find("was ended early") != std::string::npos);
    CHECK(again.runtime.balances());
    check_balanced(early);
  }
  {  // closed by its own handler, and in a handler of its events
    Again again(path);
    Replay replay;
    auto heard = again.loop.subscribe("room/#", [&](const EventView& event) {
      CHECK(event.sequence() <= 10);
      if (event.sequence() == 10) replay.close();
    });
    replay = Replay(again.loop, {.file = path});
    again.loop.advance(20s);
    CHECK(replay.is_done());
    CHECK(replay.counts().events == 0);
    auto rest = again.loop.subscribe("every/thing", [&](const EventView&) {});
    Replay second(again.loop, {.file = path, .topics = {"every/thing"}});
    second.on_done([&](const Result<void>&) { second.close(); });
    again.loop.advance(20s);
    CHECK_FALSE(second.is_open());
  }
}

TEST_CASE("FW-5 what cannot be replayed is refused, with the reason") {
  const Folder folder;
  const std::string path = make(folder);
  Again again(path);
  const auto refusal = [&](ReplayConfig config) {
    if (config.file.empty()) config.file = path;
    try {
      const Replay replay(again.loop, std::move(config));
    } catch (const SetupError& error) {
      return std::string(error.error().id()) + ": " + error.error().text();
    }
    return std::string("none");
  };
  const auto has = [](const std::string& text, const std::string& part) {
    CAPTURE(text);
    return text.find(part) != std::string::npos;
  };
  CHECK(refusal({.file = folder / "none.db"}).starts_with("not-found: "));
  CHECK(has(refusal({.run = 7}), "it has no run 7: its runs are 1"));
  CHECK(has(refusal({.topics = {"nothing/#"}}), "its topics are every/thing, room/climate"));
  CHECK(refusal({.topics = {"a/#/b"}}).starts_with("bad-name: "));
  CHECK(has(refusal({.rename = {"room"}}), "write room=lab/room"));
  CHECK(has(refusal({.from = "yesterday"}), "it is not a time"));
  CHECK(has(refusal({.from = "2", .until = "1"}), "it ends before it begins"));
  CHECK(refusal({.speed = 0}).starts_with("bad-argument: "));
  CHECK(refusal({.speed = std::numeric_limits<double>::quiet_NaN()}).starts_with("bad-argument: "));
  std::ofstream(folder / "text.db") << "no recording";
  CHECK(refusal({.file = folder / "text.db"}).starts_with("not-a-recording: "));
  {
    (void)again.loop.topic<Kelvin>("lab/climate");
    CHECK(has(refusal({.rename = {"room=lab"}}), "field temperature: unit"));
  }
  {
    Feed<Climate> feed(again.loop, {.name = "room", .topic = "room/climate"});
    CHECK(has(refusal({}), "there is one of that name already"));
  }
  CHECK(refusal({}) == "none");
  // Into itself: it would never end.
  SqliteSink sink(again.loop, {.path = path});
  CHECK(has(refusal({}), "this program records into it"));
  CHECK(again.loop.close() == 0);
  check_balanced(path);
}

TEST_CASE("FW-5 damage that a replay meets is told, and the replay ends there") {
  const Folder folder;
  SUBCASE("a value that does not fit") {
    const std::string path = make(folder);
    sql(path, "UPDATE \"room/climate\" SET humidity = 'wet' WHERE sequence = 300");
    Again again(path);
    SqliteSink sink(again.loop, {.path = folder / "copy.db"});
    Replay replay(again.loop, {.file = path});
    std::string told;
    replay.on_done([&](const Result<void>& how) { told = how.error().text(); });
    again.finish(replay);
    CHECK(told.find("sequence 300, field humidity") != std::string::npos);
    CHECK(again.errors.find("sequence 300, field humidity") != std::string::npos);
    CHECK(replay.counts().events == 299);
    CHECK(again.runtime.has_loss());  // what would have followed
    CHECK(again.loop.close() == 0);
    CHECK(number(folder / "copy.db", "SELECT count(*) FROM \"room/climate\"") == 299);
  }
  SUBCASE("times that go back") {
    const std::string path = make(folder);
    sql(path, "UPDATE \"room/climate\" SET time = time - 1000000000 WHERE sequence = 300");
    Again again(path);
    Replay replay(again.loop, {.file = path});
    again.finish(replay);
    CHECK(again.errors.find("sequence 300, time") != std::string::npos);
    CHECK(replay.counts().events == 299);
  }
  SUBCASE("an event after the end of its run") {
    const std::string path = make(folder);
    sql(path, "UPDATE \"room/climate\" SET time = time + 2305843009213693952 WHERE sequence = 300");
    Again again(path);
    Replay replay(again.loop, {.file = path});
    again.finish(replay);
    CHECK_MESSAGE(again.errors.find("sequence 300, time 20") != std::string::npos, again.errors);
    CHECK(again.errors.find("it is after the end of the run, 20") != std::string::npos);
    CHECK(replay.counts().refused == 0);
  }
  SUBCASE("sequences that go back") {
    const std::string path = make(folder);
    sql(path, "UPDATE \"room/climate\" SET sequence = 5 WHERE sequence IN (300, 301)");
    Again again(path);
    SqliteSink sink(again.loop, {.path = folder / "copy.db"});
    Replay replay(again.loop, {.file = path});
    again.finish(replay);
    CHECK(replay.counts().refused == 2);
    CHECK(again.errors.find("sequence 5, ") != std::string::npos);
    CHECK(again.log.find("2 refused") != std::string::npos);
    CHECK(again.loop.close() == 0);
    CHECK(again.runtime.balances());
  }
  SUBCASE("a file that was cut off") {
    const std::string path = make(folder);
    std::filesystem::resize_file(path, std::filesystem::file_size(path) / 2);
    Again again(Time{1'700'000'000s});
    try {
      Replay replay(again.loop, {.file = path});
      again.finish(replay);
      CHECK(again.errors != "");
    } catch (const SetupError& error) {
      CHECK(error.error().code != std::error_code{});
    }
  }
}

TEST_CASE("FW-5 a recording that is still being written is replayed as it is now, which is told") {
  const Folder folder;
  const std::string path = make(folder);
  sql(path, "UPDATE rtdata_run SET state = 'recording', pid = 1");
  Again again(path);
  Replay replay(again.loop, {.file = path});
  CHECK(again.log.find("it is still being recorded, or was not sealed") != std::string::npos);
  again.finish(replay);
  CHECK(replay.counts().events == 1001);
}

TEST_CASE("FW-5 a replay in real time reads on its lane, and loses nothing however fast") {
  const Folder folder;
  const std::string path = make(folder);
  Runtime runtime;
  runtime.on_log([](const LogRecord&) {});
  Loop loop(runtime, {});
  std::uint64_t count = 0;
  auto heard = loop.subscribe("#", [&](const EventView&) { ++count; });
  Replay replay(loop, {.file = path, .speed = 1e6});
  replay.on_done([&](const Result<void>&) { loop.stop(); });
  loop.run();
  CHECK(count == 1001);
  CHECK(heard.counts().dropped == 0);
  CHECK(replay.is_done());
}

TEST_SUITE_END();
