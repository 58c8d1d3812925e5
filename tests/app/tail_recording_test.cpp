// rtdata tail of recordings: events in order of time, with what else was recorded among them.
#include <doctest/doctest.h>

#include <nlohmann/json.hpp>
#include <sstream>

#include "app/core/recording_commands.hpp"
#include "app/process.hpp"
#include "has.hpp"
#include "paths.hpp"
#include "rtdata/sensors/limit.hpp"
#include "sinks/recordings.hpp"

using namespace recordings;
using rtdata::app::RecordedTailOptions;
using rtdata::test::has;
using Json = nlohmann::json;

namespace {

struct InPascal {
  double value = 0;
  RTDATA_FIELDS(InPascal, (value, "Pa"))
};
struct InBar {
  double value = 0;
  RTDATA_FIELDS(InBar, (value, "bar"))
};
struct WithoutUnit {
  double value = 0;
  RTDATA_FIELDS(WithoutUnit, (value, ""))
};

struct Shown {
  int status;
  std::string out, err;
};
Shown listed(const RecordedTailOptions& options) {
  std::ostringstream out, err;
  const int status = tail_recording(options, out, err);
  return {status, out.str(), err.str()};
}

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

std::vector<Json> objects_of(RecordedTailOptions options) {
  options.show_as = rtdata::app::ShowAs::json;
  std::vector<Json> objects;
  for (const std::string& line : lines_of(listed(options).out)) objects.push_back(Json::parse(line));
  return objects;
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("FW-5 tail: the newest events of a recording, or those of a part of it") {
    const Folder folder;
    const std::string path = make(folder);
    const Shown newest = listed({.database = path});
    CHECK(newest.status == 0);
    std::vector<std::string> lines = lines_of(newest.out);
    REQUIRE(lines.size() == 21);
    CHECK(lines[0].ends_with(" UTC"));
    CHECK(lines[1].ends_with(" room/climate (room) temperature=982 Cel humidity=40 %RH"));
    CHECK(lines[20].ends_with(" room/climate (room) temperature=1001 Cel humidity=40 %RH"));
    CHECK(lines_of(listed({.database = path, .topics = {"every/thing"}, .lines = 1}).out).size() == 2);
    lines = lines_of(listed({.database = path, .topics = {"room/climate"}, .part = {.from = "0"}}).out);
    for (std::size_t i = 2; i < lines.size(); ++i) CHECK(lines[i - 1].substr(0, 12) <= lines[i].substr(0, 12));
    const Shown wrong = listed({.database = path, .topics = {"room/climat"}});
    CHECK(wrong.status == 1);
    CHECK(has(wrong.err, "did you mean room/climate?"));
    CHECK(listed({.database = path, .part = {.run = "7"}}).status == 1);
    CHECK(has(listed({.database = path, .step = "0 s"}).err, "it is not above 0"));
    CHECK(listed({.database = folder / "none.db"}).status == 2);
  }

  TEST_CASE("FW-5 tail: lines of JSON, with each event once, gaps, changes of health and units") {
    const Folder folder;
    const std::string path = make(folder);
    // Patterns may overlap.
    const auto all = objects_of({.database = path, .topics = {"room/#", "room/climate"}, .part = {.from = "0"}});
    std::uint64_t events = 0, lost = 0, units = 0;
    std::int64_t last = 0;
    std::string health;
    for (const Json& one : all) {
      if (one.contains("units")) {
        CHECK(events == 0);
        CHECK(one == Json{{"units", {{"temperature", "Cel"}, {"humidity", "%RH"}}}, {"of", "room/climate"}});
        ++units;
        continue;
      }
      CHECK(one.at("time").get<std::int64_t>() >= last);
      last = one.at("time").get<std::int64_t>();
      const Json& data = one.at("data");
      if (one.at("topic") == "$rtdata/gaps") {
        CHECK(data.at("topic") == "room/climate");
        CHECK(data.at("first") == last);
        lost += data.at("count").get<std::uint64_t>();
      } else if (one.at("topic") == "$rtdata/health") {
        health += data.at("name").get<std::string>() + " " + data.at("state").get<std::string>() + "\n";
      } else {
        CHECK(one.at("sequence") == ++events);
      }
    }
    CHECK(units == 1);
    CHECK(events == 999);
    CHECK(lost == 6);
    CHECK(health == "room degraded\nroom ok\nmain degraded\n");
  }

  TEST_CASE("FW-5 tail: values have the units of their run") {
    const Folder folder;
    const std::string path = folder / "run.db";
    const auto record = [&]<class Payload>(const Payload& value) {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = path});
      Feed<Payload>(loop, {.name = "air"}).publish(value);
      CHECK(loop.close() == 0);
    };
    record(InPascal{100'000});
    record(InBar{1});
    record(WithoutUnit{1});
    CHECK(listed({.database = path, .part = {.run = "1"}}).out.ends_with(" air value=100000 Pa\n"));
    CHECK(listed({.database = path, .part = {.run = "1"}, .step = "1s"}).out.ends_with(" (100000 to 100000) Pa\n"));
    CHECK(listed({.database = path, .part = {.run = "2"}}).out.ends_with(" air value=1 bar\n"));
    CHECK(listed({.database = path, .part = {.run = "3"}}).out.ends_with(" air value=1\n"));
  }

  TEST_CASE("FW-5 tail: steps of a recording have all of its events") {
    const Folder folder;
    const std::string path = make(folder);
    std::uint64_t events = 0, next = 1;
    double sum = 0;
    for (const Json& one :
         objects_of({.database = path, .topics = {"room/climate"}, .part = {.from = "0"}, .step = "700 ms"})) {
      if (!one.contains("until")) continue;
      CHECK(one.at("time").get<std::int64_t>() % 700'000'000 == 0);
      CHECK(one.at("until").get<std::int64_t>() - one.at("time").get<std::int64_t>() == 700'000'000);
      CHECK(one.at("sequence").at(0) == next);
      next = one.at("sequence").at(1).get<std::uint64_t>() + 1;
      const std::uint64_t count = one.at("count").get<std::uint64_t>();
      events += count;
      const Json& field = one.at("data").at("temperature");
      CHECK(field.at("count") == count);
      CHECK(field.at("least") <= field.at("most"));
      sum += field.at("mean").get<double>() * static_cast<double>(count);
    }
    CHECK(events == 999);
    CHECK(next == 1000);
    CHECK(sum == doctest::Approx(number(path, "SELECT sum(temperature) FROM \"room/climate\"")));
    const Shown text = listed({.database = path, .topics = {"room/climate"}, .part = {.from = "0"}, .step = "1 h"});
    CHECK_MESSAGE(has(text.out, "room/climate (room) 999 events: temperature=501.8 (1 to 1001) Cel"), text.out);
  }

  TEST_CASE("FW-5 tail: alarms are among the events, whatever the topics") {
    const Folder folder;
    const std::string path = folder / "alarm.db";
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Feed<Climate> room(loop, {.name = "room", .topic = "room/climate"});
      LimitSensor alarm(loop, {.name = "too_hot"}, {.on = "room/climate", .field = "temperature", .high = 30});
      for (int i = 0; i < 6; ++i) {
        room.publish({20.0 + 5 * i, 40});
        loop.advance(500ms);
      }
      CHECK(loop.close() == 0);
    }
    std::string order;
    for (const Json& one : objects_of({.database = path, .topics = {"room/climate"}, .part = {.from = "0"}}))
      if (one.contains("origin"))
        order += one.at("topic") == "too_hot" ? one.at("data").at("alarm").get<std::string>() + " " : ".";
    CHECK(order == ".normal ...high ..");
    CHECK(has(listed({.database = path, .topics = {"room/climate"}}).out, " ! too_hot "));
  }

  TEST_CASE("FW-5 tail: the program takes a recording for an instance") {
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
    const auto ended = [&](std::vector<std::string> arguments, int status) {
      arguments.insert(arguments.begin(), "tail");
      Process process(folder, rtdata::test::program, arguments);
      CHECK(process.end() == status);
      return process.out + process.err;
    };
    CHECK(lines_of(ended({"run.db", "t", "--lines", "3"}, 0)).size() == 4);
    CHECK(lines_of(ended({"run.db", "--last", "450ms"}, 0)).size() == 1 + 4);
    CHECK(lines_of(ended({"./run.db", "--from", "0", "--json"}, 0)).size() == 1 + 10);
    CHECK(has(ended({"none.db", "--last", "450ms"}, 2), "No such file"));
    CHECK(has(ended({"none", "--last", "450ms"}, 1), "--last works only with recordings"));
  }
}
