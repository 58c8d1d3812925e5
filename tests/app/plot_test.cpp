// rtdata plot of recordings: what it shows of what is there, and of what is not.
#include <doctest/doctest.h>
#include <stdlib.h>

#include <optional>
#include <sstream>

#include "app/core/recording_commands.hpp"
#include "app/process.hpp"
#include "has.hpp"
#include "paths.hpp"
#include "rtdata/sensors/derived.hpp"
#include "rtdata/sensors/limit.hpp"
#include "sinks/recordings.hpp"

using namespace recordings;
using rtdata::app::plot;
using rtdata::app::PlotOptions;
using rtdata::test::has;

namespace {

struct Shown {
  int status;
  std::string out, err;
};

/// In ASCII, whatever the locale of this machine.
Shown plotted(const PlotOptions& options) {
  ::setenv("LC_ALL", "C", 1);
  std::ostringstream out, err;
  const int status = plot(options, out, err);
  ::unsetenv("LC_ALL");
  return {status, out.str(), err.str()};
}
Shown plotted(const std::string& path, std::vector<std::string> fields, rtdata::app::PartOptions part = {}) {
  return plotted({.database = path, .fields = std::move(fields), .part = std::move(part)});
}

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

struct Real {
  double x = 0;
  RTDATA_FIELDS(Real, (x, "m"))
};
struct Whole {
  std::int32_t x = 0;
  RTDATA_FIELDS(Whole, (x, "m"))
};

/// `path` is not part of what is compared.
std::string without(std::string text, const std::string& path) {
  for (std::size_t at; (at = text.find(path)) != std::string::npos;) text.replace(at, path.size(), "run.db");
  return text;
}

/// Sensors of two names on one topic, and an alarm: 3 s.
std::string make_alarm(const Folder& folder) {
  const std::string path = folder / "alarm.db";
  Loop loop{Loop::Manual{}};
  SqliteSink sink(loop, {.path = path});
  Feed<Climate> inside(loop, {.name = "inside", .topic = "room/climate"});
  Feed<Climate> outside(loop, {.name = "outside", .topic = "room/climate"});
  LimitSensor alarm(loop, {.name = "too_hot"}, {.on = "room/climate", .field = "temperature", .high = 30});
  for (int i = 0; i < 6; ++i) {
    inside.publish({20.0 + 5 * i, 40});
    outside.publish({-1.0 * i, 80});
    loop.advance(500ms);
  }
  CHECK(loop.close() == 0);
  return path;
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("FW-5 plot: of a recording, with its gaps and the verdict of its account") {
    const Folder folder;
    const std::string path = make(folder);
    const Shown all = plotted(path, {"room/climate.temperature"});
    CHECK(all.err == "");
    CHECK(all.status == 0);
    CHECK("\n" + without(all.out, path) == R"(
run.db, run 1: 2023-11-14 22:13:20.000 to 22:13:30.045 UTC,
  160 ms a column
room/climate.temperature [Cel]  1 to 1001, mean 501.8                     6 lost
       1001 +                                                           .:-'
            |                                                      .:-:'
            |                                                 ..::''
            |                                             .:-:'
            |                                        ..::''
            |                                    .:-:'
        501 +                               ..::''
            |                          ..::''
            |                      .:-:'
            |                 ..::''
            |             .:-:'
            |        .:-:'
            |   ..::''
          1 +:-:'
                   a                        b
            ++-----------+------------+-----------+------------+-----------+----
             22:13:20    22:13:22     22:13:24    22:13:26     22:13:28
a  22:13:21.000 to 22:13:21.010 failed: io-failed, 2 lost
b  22:13:25.000 to 22:13:25.030 missed: loop held, 4 lost
lost of room/climate in run 1: missed 4, failed 2
)");
    // Of a part: what of all that was lost is in it.
    const Time begin = Recording::open(path).or_throw().runs().or_throw()[0].started;
    const auto part = [&](Duration from, Duration until) {
      return plotted(path, {"room/climate.temperature"},
                     {.from = to_iso8601(begin + from), .until = to_iso8601(begin + until)})
          .out;
    };
    CHECK(has(part(2s, 4s), "0 of 6 lost here"));
    CHECK(has(part(4s, 6s), "4 of 6 lost here"));
    CHECK(has(part(0s, 1020ms), "2 of 6 lost here"));
    const Shown last = plotted(path, {"room/climate"}, {.last = "5.5 s"});
    CHECK(has(last.out, "room/climate.humidity [%RH]  always 40"));
    CHECK(has(last.out, "4 of 6 lost here"));
    CHECK(plotted(path, {"room/climate.temperature"}, {.last = "1 h"}).out == all.out);
  }

  TEST_CASE("FW-5 plot: what is unreadable at a failed tick is lost once, and is missing in what is made of it") {
    const Folder folder;
    const std::string path = folder / "all.db", only = folder / "only.db";
    {
      Loop loop{Loop::Manual{}};
      loop.on_error([](const ErrorReport&) {});
      const SqliteSink sink(loop, {.path = path});
      const SqliteSink made(loop, {.path = only, .sink = {.topics = {"twice"}}});
      int reads = 0;
      Sensor<Climate> room(loop,
                           {.name = "room",
                            .rate = 20_Hz,
                            .faulted_after = 1000,
                            .process = {{"temperature", {.calibration = Calibration{.most = 50}}}}},
                           [&]() -> Result<Climate> {
                             ++reads;
                             return Climate{reads > 40 && reads <= 60 ? 100.0 : 20.0 + reads % 5, 40};
                           });
      const DerivedSensor twice(loop, {.name = "twice"}, {.on = "room", .expression = "temperature * 2"});
      loop.advance(5s);
      CHECK(loop.close() == 0);
    }
    REQUIRE(number(path, "SELECT count(*) FROM rtdata_ledger WHERE failed = 20 AND unreadable = 20") == 1);
    CHECK(has(verified(path).text(), "LOST: 20 ticks of room (failed 20, 20 of them unreadable)\n"));
    const Shown room = plotted(path, {"room.temperature"});
    CHECK(has(room.out, " 20 lost\n"));
    CHECK(has(room.out, "lost of room in run 1: failed 20, of them unreadable 20\n"));
    for (const std::string& one : {path, only}) {
      CAPTURE(one);
      const Shown twice = plotted(one, {"twice"});
      CHECK_MESSAGE(has(twice.out, " 20 lost\n"), twice.out);
      CHECK(has(twice.out, "of room, 20 lost\n"));
      CHECK(has(twice.out, "twice is made of room: what these lost is missing in it, too\n"));
      std::ostringstream page, err;
      CHECK(rtdata::app::report({.database = one, .file = "-"}, page, err) == 0);
      CHECK(has(page.str(), " of what is there</span>"));
      // The place is empty: no line leads across it.
      const std::vector<std::string> lines = lines_of(twice.out);
      const auto marks = std::find_if(lines.begin(), lines.end(), [](const std::string& line) {
        return has(line, "aaaaa") && line.find_first_not_of(" a") == std::string::npos;
      });
      REQUIRE(marks != lines.end());
      const std::size_t first = marks->find('a') + 1, end = marks->rfind('a');
      for (const std::string& line : lines)
        if (has(line, " |") || has(line, " +")) {
          if (line.size() > first && !has(line, "--")) {
            CHECK(line.substr(first, end - first).find_first_not_of(' ') == std::string::npos);
          }
        }
    }
  }

  TEST_CASE("FW-5 plot: rows that were not stored leave a place empty, also where no gap tells of it") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path, .sink = {.queue_bytes = 64 << 10}});
      loop.script_lane_duration(40ms);
      Feed<Climate> feed(loop, {.name = "a", .topic = "t"});
      for (int i = 0; i < 40; ++i) {
        // Of a burst in one turn, what finds no room is dropped.
        for (int j = 0; j < (i == 20 ? 30'000 : 1); ++j) feed.publish({1.0 * i, 1.0 * j});
        loop.advance(50ms);
      }
      CHECK(loop.close() == 0);
    }
    const std::uint64_t stored = static_cast<std::uint64_t>(number(path, "SELECT count(*) FROM t"));
    const std::uint64_t lost = 30'039 - stored;
    REQUIRE(lost > 100);
    const Shown shown = plotted(path, {"t.temperature"});
    CHECK(has(shown.out, std::to_string(lost) + " lost\n"));
    CHECK(has(shown.out, "not stored: dropped by the recording, " + std::to_string(lost) + " lost\n"));
    CHECK(has(shown.out, "lost of t in run 1: dropped by the queue " + std::to_string(lost)));
    // Rows that are missing between two steps: 21 of them, where the account says that they were stored.
    const std::string cut = make(folder, {}, "cut.db");
    sql(cut, "DELETE FROM \"room/climate\" WHERE sequence BETWEEN 300 AND 320");
    CHECK(has(plotted(cut, {"room/climate.temperature"}).out, "not stored: dropped by the recording, 21 lost"));
  }

  TEST_CASE("FW-5 plot: a field whose type changed within the run has a panel for each") {
    const Folder folder;
    const std::string path = folder / "run.db";
    const auto record = [&](auto sample) {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = path});
      Feed<decltype(sample)> feed(loop, {.name = "a", .topic = "t"});
      for (int i = 0; i < 10; ++i) {
        sample.x = static_cast<decltype(sample.x)>(i);
        feed.publish(sample);
        loop.advance(100ms);
      }
      loop.advance(2s);
      CHECK(loop.close() == 0);
    };
    record(Real{});
    record(Whole{});
    sql(path, "UPDATE \"t~2\" SET run = 1, time = time + 1500000000");
    const Shown shown = plotted(path, {"t.x"}, {.run = "1"});
    CHECK(shown.err == "");
    CHECK(has(shown.out, "\nt.x [m]  0 to 9, mean 4.5  "));
    CHECK(has(shown.out, "\nt.x as int32 [m]  0 to 9, mean 4.5  "));
  }

  TEST_CASE("FW-5 plot: while it is recorded, after a kill, and after the next start") {
    const Folder folder;
    const std::string path = folder / "run.db", copy = folder / "copy.db";
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Feed<Climate> feed(loop, {.name = "a", .topic = "t"});
      for (int i = 0; i < 30; ++i) {
        feed.publish({1.0 * i, 0});
        loop.advance(100ms);
      }
      const Shown shown = plotted(path, {"t.temperature"});
      CHECK(shown.status == 0);
      CHECK(has(shown.out, "all there so far\n"));
      CHECK(has(shown.out, "not known: what it loses after its last account: it is being recorded"));
      sql(path, "VACUUM INTO '" + copy + "'");
      CHECK(loop.close() == 0);
    }
    CHECK(has(plotted(path, {"t.temperature"}).out, "t.temperature [Cel]  0 to 29, mean 14.5"));
    CHECK(has(plotted(path, {"t.temperature"}).out, "all there\n"));
    sql(copy, "UPDATE rtdata_run SET pid = 0");
    write_checksums(copy);
    CHECK(has(plotted(copy, {"t.temperature"}).out, "all there as far as is known\n"));
    start_again(copy);
    CHECK(has(plotted(copy, {"t.temperature"}, {.run = "1"}).out, "all there as far as is known\n"));
  }

  TEST_CASE("FW-5 plot: origins of one topic have a panel each") {
    const Folder folder;
    const std::string path = make_alarm(folder);
    const Shown both = plotted(path, {"room/climate.temperature"});
    CHECK(has(both.out, "room/climate.temperature of inside [Cel]  20 to 45, mean 32.5"));
    CHECK(has(both.out, "room/climate.temperature of outside [Cel]  -5 to 0, mean -2.5"));
    const Shown one = plotted({.database = path, .fields = {"room/climate.temperature"}, .origin = "inside"});
    CHECK(has(one.out, "room/climate.temperature [Cel]  20 to 45"));
    CHECK_FALSE(has(one.out, "outside"));
    const Shown none = plotted({.database = path, .fields = {"room/climate"}, .origin = "insde"});
    CHECK(none.status == 1);
    CHECK(has(none.err, "run 1 has none of origin insde"));
    CHECK(has(none.err, "inside, outside"));
  }

  TEST_CASE("FW-5 plot: records, arrays and numbers of every kind; what is no number is refused with words") {
    const Folder folder;
    const std::string path = make(folder);
    const auto titles = [&](const std::string& field) {
      std::string found;
      for (const std::string& line : lines_of(plotted(path, {field}).out))
        if (line.starts_with("every/thing")) found += line.substr(0, line.find("  ")) + "\n";
      return found;
    };
    CHECK(titles("every/thing.points[1]") == "every/thing.points[1].x [m]\nevery/thing.points[1].label\n");
    CHECK(titles("every/thing.numbers") ==
          "every/thing.numbers[0] [m/s2]\nevery/thing.numbers[1] [m/s2]\nevery/thing.numbers[2] [m/s2]\n");
    CHECK(titles("every/thing.flag") == "every/thing.flag\n");
    CHECK(has(plotted(path, {"every/thing.u64"}).out, "every/thing.u64  0 to 18446744073709551615"));
    CHECK(has(plotted(path, {"every/thing.i64"}).out, "every/thing.i64  -9223372036854775808 to 0"));
    const auto refused = [&](const std::string& field) {
      const Shown shown = plotted(path, {field});
      CHECK(shown.status == 1);
      CHECK(shown.out == "");
      return shown.err;
    };
    CHECK(has(refused("every/thing.state"), "it is an enum (broken, idle, running), and only numbers have a curve"));
    CHECK(has(refused("every/thing.name"), "it is a text, and only numbers have a curve"));
    CHECK(has(refused("every/thing.names"), "it holds no number"));
    CHECK(has(refused("every/thing.f46"), "did you mean f64?"));
    CHECK(has(refused("room/climate.temprature"), "did you mean temperature?"));
    CHECK(has(refused("room/climat.temperature"), "did you mean room/climate.temperature?"));
    CHECK(has(refused("room/climat"), "did you mean room/climate?"));
    CHECK(has(refused("nowhere"), "available: every/thing, room/climate"));
    const Shown all = plotted(path, {});
    CHECK(all.status == 0);
    CHECK(all.err == "");
    CHECK(has(all.out, "every/thing: "));
    CHECK_FALSE(has(all.out, "name"));  // which is a text
    CHECK(has(all.out, "\nroom/climate: temperature, humidity\nsuch as: rtdata plot " + path + " every/thing."));
  }

  TEST_CASE("FW-5 plot: runs and times that are not there") {
    const Folder folder;
    const std::string path = make(folder);
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Feed<Climate> feed(loop, {.name = "a", .topic = "other"});
      feed.publish({1, 1});
      loop.advance(1s);
      CHECK(loop.close() == 0);
    }
    const auto refused = [&](rtdata::app::PartOptions part, const char* why) {
      const Shown curve = plotted(path, {"room/climate.temperature"}, part);
      CHECK(curve.status == 1);
      CHECK_MESSAGE(has(curve.err, why), curve.err);
    };
    refused({.run = "7"}, "there is no run 7; its runs are 1, 2");
    refused({.run = "1", .from = "noon"}, "noon");
    refused({.run = "1", .from = "2026-03-01T12:00:00"}, "its time zone is missing");
    refused({.run = "1", .last = "3 apples"}, "3 apples");
    refused({.run = "1", .last = "0 s"}, "it is not above 0");
    refused({.run = "1", .from = "2026-03-01T12:00:00Z", .last = "3 s"}, "--from says where it begins, too");
    refused({.run = "1", .from = "2026-03-01T12:00:00Z", .until = "2026-03-01T11:00:00Z"}, "it ends before it begins");
    refused({.run = "1", .from = "1700-03-01T12:00:00Z", .until = "2200-03-01T11:00:00Z"}, "longer than 100 years");
    const Shown other = plotted(path, {"room/climate.temperature"});
    CHECK(other.status == 1);
    CHECK(has(other.err, "run 2 has nothing of it: see --run: 1"));
    CHECK(plotted(path, {"room/climate.temperature"}, {.run = "1"}).status == 0);
    CHECK(plotted(folder / "none.db", {"t"}).status == 2);
  }

  TEST_CASE("FW-5 plot: the program, on a terminal and into a file") {
    const rtdata::test::Folder folder;
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = folder.path() + "/run.db"});
      Feed<Climate> feed(loop, {.name = "a", .topic = "t"});
      for (int i = 0; i < 10; ++i) {
        feed.publish({1.0 * i, 0});
        loop.advance(100ms);
      }
      CHECK(loop.close() == 0);
    }
    using rtdata::test::Process;
    const auto run_with = [&](std::map<std::string, std::string> environment, Process::Output output) {
      for (const auto& [name, value] : environment) ::setenv(name.c_str(), value.c_str(), 1);
      Process process(folder, rtdata::test::program, {"plot", "run.db", "t.temperature"}, output);
      CHECK(process.end() == 0);
      for (const auto& [name, value] : environment) ::unsetenv(name.c_str());
      return process.out;
    };
    const std::string file = run_with({{"LC_ALL", "C.UTF-8"}}, Process::Output::pipes);
    CHECK(lines_of(file).size() == 23);
    CHECK(has(file, "┤"));
    CHECK_FALSE(has(file, "\x1b"));
    const std::string colours = run_with({{"LC_ALL", "C.UTF-8"}, {"TERM", "xterm"}}, Process::Output::terminal);
    CHECK(has(colours, "\x1b[32mall there\x1b[0m"));
    const std::string plain = run_with({{"LC_ALL", "C.UTF-8"}, {"TERM", "xterm"}, {"NO_COLOR", "1"}},
                                       Process::Output::terminal);
    CHECK_FALSE(has(plain, "\x1b"));
    CHECK(has(plain, "┤"));
    const std::string ascii = run_with({{"LC_ALL", "C"}}, Process::Output::pipes);
    CHECK(std::all_of(ascii.begin(), ascii.end(), [](char c) { return (c & 0x80) == 0; }));
  }
}
