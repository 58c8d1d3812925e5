// Topics that a sink wants and cannot take.
#include <doctest/doctest.h>
#include <sqlite3.h>

#include <array>
#include <filesystem>
#include <fstream>

#include "has.hpp"
#include "recording/database.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/recording/runs.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/recording/verify.hpp"
#include "rtdata/sinks/file.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

struct Word {
  text<8> word;
  RTDATA_FIELDS(Word, (word))
};

std::uint64_t refused(const Sink& sink) { return sink.counts().dropped[static_cast<std::size_t>(DropReason::refused)]; }

void publish(Loop& loop, const char* topic, int count) {
  for (int i = 0; i < count; ++i) loop.topic<Number>(topic).publish({static_cast<double>(i)});
}

std::string problems_of(const std::string& text) {
  return plan_system(standard_registry(), parse_config(text, "f.json")).problems.text();
}

using rtdata::test::has;

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("a topic that comes later and that the writer refuses is counted, told, and faults the sink") {
    const Directory directory;
    Loop loop{Loop::Manual{}};
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    std::vector<std::string> health;
    const Subscription changes = loop.subscribe<HealthChange>("$rtdata/health", [&](const Event<HealthChange>& event) {
      health.push_back(std::string(event->name.view()) + " " + std::string(name_of(event->state)));
    });
    FileSink sink(loop, {.path = directory / "one.csv", .format = "csv"});
    publish(loop, "a", 3);
    publish(loop, "b", 4);
    loop.advance(2s);
    publish(loop, "b", 1);
    publish(loop, "a", 2);
    loop.advance(2s);
    CHECK(sink.counts().offered == 10);
    CHECK(sink.counts().stored == 5);
    CHECK(refused(sink) == 5);
    CHECK(sink.counts().queued == 0);
    CHECK(sink.counts().balances());
    CHECK(sink.health() == Health::faulted);
    CHECK(has(sink.status().reason, "cannot record topic b: "));
    REQUIRE(sink.status().dropped.size() == 1);
    CHECK(sink.status().dropped[0].topic == "b");
    CHECK(sink.status().dropped[0].count == 5);
    REQUIRE(errors.size() == 1);
    CHECK(has(errors[0], "write {topic} into the path: a file each"));
    CHECK(health == std::vector<std::string>{"one.csv faulted"});
    CHECK(loop.close(1s) == 0);
    CHECK(loop.runtime().has_loss());
    CHECK(loop.runtime().balances());
    CHECK(loop.runtime().sinks().front().health == Health::faulted);
  }

  TEST_CASE("a file with another header, found while running, costs its own topic only") {
    const Directory directory;
    std::ofstream(directory / "b.csv") << "time,origin,sequence,speed\n";
    Loop loop{Loop::Manual{}};
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    FileSink sink(loop, {.path = directory / "{topic}.csv", .format = "csv", .rotate = {.time = 24h * 360}});
    publish(loop, "a", 3);
    publish(loop, "b", 4);
    loop.advance(2s);
    publish(loop, "a", 1);
    publish(loop, "b", 1);
    loop.advance(2s);
    CHECK(sink.counts().stored == 4);
    CHECK(refused(sink) == 5);
    CHECK(sink.counts().balances());
    CHECK(sink.health() == Health::faulted);
    CHECK(has(sink.status().reason, "its header is \"time,origin,sequence,speed\""));
    CHECK_FALSE(errors.empty());
    CHECK(content(directory / "b.csv") == "time,origin,sequence,speed\n");
  }

  TEST_CASE("a table that cannot be made costs its own topic only, and the recording says so") {
    const Directory directory;
    const std::string path = directory / "run.db";
    {
      Loop loop{Loop::Manual{}};
      const SqliteSink made(loop, {.path = path});
    }
    sqlite3* database = nullptr;
    REQUIRE(sqlite3_open(path.c_str(), &database) == SQLITE_OK);
    std::string statement = R"(CREATE VIEW "b" AS SELECT 1 AS x)";
    SUBCASE("there is something else of its name") {}
    SUBCASE("there is a table of its view's name") { statement = R"(CREATE TABLE "B~utc"(x))"; }
    SUBCASE("there is an index of its view's name") { statement = R"(CREATE INDEX "B~utc" ON rtdata_run(run))"; }
    REQUIRE(sqlite3_exec(database, statement.c_str(), nullptr, nullptr, nullptr) == SQLITE_OK);
    sqlite3_close(database);
    {
      Loop loop{Loop::Manual{}};
      std::vector<std::string> errors;
      loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
      SqliteSink sink(loop, {.path = path});
      publish(loop, "a", 3);
      publish(loop, "b", 4);
      publish(loop, "c", 2);
      loop.advance(2s);
      publish(loop, "b", 1);
      publish(loop, "a", 1);
      loop.advance(2s);
      CHECK(sink.counts().stored == 6);
      CHECK(refused(sink) == 5);
      CHECK(sink.counts().queued == 0);
      CHECK(sink.health() == Health::faulted);
      REQUIRE_FALSE(errors.empty());
      CHECK(has(errors[0], "cannot make a table for topic b"));
      CHECK(loop.close(1s) == 0);
      CHECK(loop.runtime().has_loss());
    }
    const Recording recording = Recording::open(path).or_throw();
    const VerifyReport report = verify(recording).or_throw();
    CHECK_MESSAGE(report.exit_code() == 0, report.text());
    CHECK(report.runs.back().rows == 6);
    CHECK(report.runs.back().dropped == 5);
  }

  TEST_CASE("topics called as tables of a recording or of SQLite are recorded, in whatever case their letters are") {
    const Directory directory;
    const std::string path = directory / "run.db";
    constexpr std::array topics{"RTDATA_GAP", "RTDATA_RUN",    "Rtdata_run_utc",
                                "SQLITE_foo", "Sqlite_schema", "rtdata_topic"};
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      for (const char* topic : topics) publish(loop, topic, 3);
      loop.advance(2s);
      CHECK(sink.counts().stored == 3 * topics.size());
      CHECK(refused(sink) == 0);
      CHECK(sink.health() == Health::ok);
      CHECK(loop.close(1s) == 0);
    }
    const Recording recording = Recording::open(path).or_throw();
    const VerifyReport report = verify(recording).or_throw();
    CHECK_MESSAGE(report.exit_code() == 0, report.text());
    CHECK(report.runs.back().rows == 3 * topics.size());
  }

  TEST_CASE("topics that differ in case only are recorded into one file, each with its own fields and versions") {
    const Directory directory;
    const std::string path = directory / "run.db";
    for (const std::vector<std::string>& topics : {std::vector<std::string>{"room"}, {"Room", "room"}, {"ROOM"}}) {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      for (const std::string& topic : topics) publish(loop, topic.c_str(), 3);
      loop.advance(2s);
      CHECK(sink.health() == Health::ok);
      CHECK(refused(sink) == 0);
      CHECK(loop.close(1s) == 0);
    }
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Feed<Word> feed(loop, {.name = "feed", .topic = "room"});  // which has other fields now
      feed.publish({});
      CHECK(loop.close(1s) == 0);
    }
    const Recording recording = Recording::open(path).or_throw();
    const VerifyReport report = verify(recording).or_throw();
    CHECK_MESSAGE(report.exit_code() == 0, report.text());
    std::string all;
    for (const RecordedTopic& topic : recording.topics().or_throw())
      all += topic.topic + " " + std::to_string(topic.version) + " " + topic.table + "\n";
    CHECK(all == "ROOM 1 ROOM~3\nRoom 1 Room~2\nroom 1 room\nroom 2 room~4\n");
    for (const auto& [topic, rows] : {std::pair("room", 7), {"Room", 3}, {"ROOM", 3}}) {
      Rows of = recording.rows({.topic = topic}).or_throw();
      int count = 0;
      for (; const RecordedRow* const row = of.next().or_throw(); ++count) CHECK(row->event().topic() == topic);
      CHECK(count == rows);
    }
  }

  TEST_CASE(
      "a recording that is deleted or moved while it is written is told at the next commit, and what comes is "
      "refused") {
    for (const bool is_moved : {false, true}) {
      CAPTURE(is_moved);
      const Directory directory;
      const std::string path = directory / "run.db";
      const std::string other = directory / "moved.db";
      Loop loop{Loop::Manual{}};
      std::vector<std::string> errors;
      loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
      SqliteSink sink(loop, {.path = path});
      publish(loop, "a", 3);
      loop.advance(2s);
      CHECK(sink.counts().stored == 3);
      if (is_moved) {
        std::filesystem::rename(path, other);
      } else {
        std::filesystem::remove(path);
      }
      publish(loop, "a", 4);
      loop.advance(2s);
      CHECK(sink.health() == Health::faulted);
      CHECK(refused(sink) == 4);
      publish(loop, "a", 1);
      loop.advance(2s);
      CHECK(sink.counts().stored == 3);
      CHECK(refused(sink) == 5);
      CHECK(sink.counts().balances());
      REQUIRE(errors.size() == 1);
      CHECK(has(errors[0], "recording has ended: " + path + ": the file was deleted or moved"));
      CHECK(loop.close(1s) == 0);
      CHECK(loop.runtime().has_loss());
      CHECK_FALSE(std::filesystem::exists(path));
      if (!is_moved) continue;
      const Recording recording = Recording::open(other).or_throw();  // with what was in the log
      Rows rows = recording.rows({}).or_throw();
      int count = 0;
      while (rows.next().or_throw() != nullptr) ++count;
      CHECK(count == 3);
    }
  }

  TEST_CASE("US-26 a log that is cut off while it is recorded ends the recording, which stays whole and is sealed") {
    for (const std::uintmax_t part : {std::uintmax_t{0}, std::uintmax_t{2}, std::uintmax_t{3}}) {
      CAPTURE(part);
      sinks::Directory directory;
      const std::string path = directory / "run.db";
      {
        Loop loop{Loop::Manual{}};
        SqliteSink sink(loop, {.path = path});
        publish(loop, "a", 2);
        loop.advance(2s);
      }
      {
        Loop loop{Loop::Manual{}};
        std::vector<std::string> errors;
        loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
        SqliteSink sink(loop, {.path = path});
        for (int i = 0; i < 5; ++i) {
          publish(loop, "a", 3);
          loop.advance(2s);
        }
        CHECK(sink.counts().stored == 15);
        const std::string log = path + "-wal";
        std::filesystem::resize_file(log, part == 0 ? 0 : std::filesystem::file_size(log) / part);
        publish(loop, "a", 4);
        loop.advance(2s);
        CHECK(sink.health() == Health::faulted);
        CHECK(refused(sink) == 4);
        CHECK(sink.counts().balances());
        REQUIRE(errors.size() == 1);
        CHECK(has(errors[0], "recording has ended: " + path + ": its WAL file, " + log + ", was cut off"));
        loop.close(1s);
        CHECK(loop.runtime().has_loss());
      }
      {
        Loop loop{Loop::Manual{}};
        loop.runtime().on_log([](const LogRecord&) {});
        SqliteSink sink(loop, {.path = path});
        publish(loop, "a", 1);
        loop.advance(2s);
      }
      const Recording recording = Recording::open(path).or_throw();
      const VerifyReport report = verify(recording).or_throw();
      CAPTURE(report.text());
      CHECK(report.exit_code() == 0);
      CHECK(report.runs.front().rows == 2);
      CHECK(report.runs.back().rows == 1);
      REQUIRE(report.runs.size() == 3);
      CHECK(report.runs[1].info.state == RunState::sealed);
      CHECK(report.runs[1].info.lost == 19);
    }
  }

  TEST_CASE(
      "US-26 a WAL file that is deleted or replaced while it is recorded ends the recording, which loses no row") {
    for (const bool is_replaced : {false, true}) {
      CAPTURE(is_replaced);
      sinks::Directory directory;
      const std::string path = directory / "run.db";
      {
        Loop loop{Loop::Manual{}};
        std::vector<std::string> errors;
        loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
        SqliteSink sink(loop, {.path = path});
        publish(loop, "a", 3);
        loop.advance(2s);
        CHECK(sink.counts().stored == 3);
        const std::string log = path + "-wal";
        std::filesystem::rename(log, log + "-away");
        if (is_replaced) std::ofstream{log};
        publish(loop, "a", 4);
        loop.advance(2s);
        CHECK(sink.health() == Health::faulted);
        CHECK(refused(sink) == 4);
        REQUIRE(errors.size() == 1);
        CHECK(has(errors[0],
                  "recording has ended: " + path + ": its WAL file, " + log + ", was deleted, moved or replaced"));
        loop.close(1s);
        CHECK(loop.runtime().has_loss());
      }
      CHECK(seal(path).or_throw().size() == 1);
      const VerifyReport report = verify(Recording::open(path).or_throw()).or_throw();
      CAPTURE(report.text());
      CHECK(report.exit_code() == 0);
      REQUIRE(report.runs.size() == 1);
      CHECK(report.runs[0].rows == 3);
      CHECK(report.runs[0].info.lost == 4);
    }
  }

  TEST_CASE("US-26 another program that brings the log into the file and empties it costs nothing") {
    sinks::Directory directory;
    const std::string path = directory / "run.db";
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      for (int i = 0; i < 3; ++i) {
        publish(loop, "a", 3);
        loop.advance(2s);
        auto other = sqlite::Database::open(path, sqlite::Database::Mode::write);
        other.execute("PRAGMA wal_checkpoint(TRUNCATE)");
        CHECK(std::filesystem::file_size(path + "-wal") == 0);
      }
      publish(loop, "a", 3);
      loop.advance(2s);
      CHECK(sink.counts().stored == 12);
    }
    CHECK(verify(Recording::open(path).or_throw()).or_throw().verdict() == Verdict::balanced);
  }

  TEST_CASE("what a sink cannot take is a mistake in the configuration") {
    const Directory directory;
    const auto configured = [&](const std::string& sensors, const std::string& sinks) {
      return problems_of(R"({"sensors": [)" + sensors + R"(], "sinks": [)" + sinks + "]}");
    };
    const std::string two = R"({"name": "a", "type": "host", "quantity": "load", "rate": "1 Hz"},
                               {"name": "b", "type": "host", "quantity": "load", "rate": "1 Hz"})";
    const auto csv = [&](const std::string& path, const std::string& more = "") {
      return R"({"type": "file", "format": "csv", "path": ")" + (directory / path) + "\"" + more + "}";
    };
    SUBCASE("two topics in one CSV file") {
      const std::string problems = configured(two, csv("x.csv"));
      CHECK(has(problems, "write {topic} into the path"));
      CHECK(configured(two, csv("x.csv", R"(, "topics": ["a"])")).empty());
      CHECK(configured(two, csv("{topic}.csv")).empty());
    }
    SUBCASE("two topics whose files have one name") {
      const std::string problems = configured(
          R"({"name": "a", "topic": "x/y", "type": "host", "quantity": "load", "rate": "1 Hz"},
             {"name": "b", "topic": "x-y", "type": "host", "quantity": "load", "rate": "1 Hz"})",
          csv("{topic}.csv"));
      CHECK(has(problems, "the file holds topic x/y"));
    }
    SUBCASE("a CSV file that is there with another header") {
      std::ofstream(directory / "x.csv") << "time,origin,sequence,speed\n";
      const std::string goes_on = R"(, "topics": ["a"], "rotate": {"time": "1 d"})";
      const std::string problems = configured(two, csv("x.csv", goes_on));
      CHECK(has(problems, "its header is \"time,origin,sequence,speed\""));
      CHECK(configured(two, csv("x.csv", R"(, "topics": ["a"])")).empty());  // it gets a number
      std::ofstream(directory / "x.csv") << "time,origin";                   // half a header is repaired
      CHECK(configured(two, csv("x.csv", goes_on)).empty());
    }
    SUBCASE("more values than a table has columns") {
      std::string fields;
      for (int i = 0; i < 1991; ++i)
        fields += (i == 0 ? "" : ",") + (R"({"name": "f)" + std::to_string(i) + R"(", "type": "int8"})");
      const std::string line = R"({"name": "wide", "type": "serial", "device": "/dev/ttyUSB0", "fields": [)" + fields +
                               "]}";
      const std::string sqlite = R"({"type": "sqlite", "path": ")" + (directory / "x.db") + "\"}";
      CHECK(has(configured(line, sqlite), "it has 1991 values an event"));
      CHECK(configured(line, R"({"type": "file", "path": ")" + (directory / "x.jsonl") + "\"}").empty());
    }
  }

  TEST_CASE("US-17 check finds files of two sinks that are one, where {topic} makes their names") {
    const Directory directory;
    const auto problems = [&](const std::string& sinks, const std::string& log = "x.log") {
      return problems_of(
          R"({"sensors": [{"name": "a", "type": "analog", "file": "adc", "rate": "1 Hz", "topic": "room/a"},
        {"name": "b", "type": "analog", "file": "adc", "rate": "1 Hz", "topic": "b"}], "sinks": [)" +
          sinks + R"(], "log": {"file": ")" + directory / log + R"("}})");
    };
    const auto sink = [&](const std::string& path, const std::string& topics = "#") {
      return R"({"type": "file", "path": ")" + directory / path + R"(", "topics": [")" + topics + R"("], "name": ")" +
             path + topics + R"("})";
    };
    CHECK(problems(sink("run-{topic}.jsonl") + "," + sink("run-c.jsonl")) == "");
    const std::string told = problems(sink("run-room-a.jsonl") + "," + sink("run-{topic}.jsonl"));
    CHECK(has(told, "sinks[1].path: the events of topic \"room/a\" go to \"" + directory / "run-room-a.jsonl"));
    CHECK(has(told, ": the sink at f.json:2:"));
    CHECK(has(told, " already; two writers on one file destroy it"));
    CHECK_FALSE(has(told, "topic \"b\""));
    CHECK(has(problems(sink("run-{topic}.jsonl") + "," + sink("run-b.jsonl")), "the events of topic \"b\" go to "));
    CHECK(problems(sink("run-{topic}.jsonl", "room/#") + "," + sink("run-b.jsonl")) == "");
    CHECK(has(problems(sink("{topic}-b", "room/a") + "," + sink("room-a-{topic}", "b")), "go to "));
    CHECK(has(problems(sink("run-{topic}.log"), "run-b.log"), "log.file: the sink at "));
  }
}
