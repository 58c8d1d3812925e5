#include <doctest/doctest.h>

#include <sstream>

#include "app/core/recording_commands.hpp"
#include "loop/virtual_time.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/recording/verify.hpp"
#include "sinks/recordings.hpp"

using namespace recordings;
using namespace std::chrono_literals;

TEST_SUITE_BEGIN("sinks");

TEST_CASE("US-26 every change of health is in the recording, with its time and reason, and info shows it") {
  const Folder folder;
  const std::string path = make(folder);
  {
    const auto recording = Recording::open(path).or_throw();
    const auto health = recording.health(1).or_throw();
    REQUIRE(health.size() == 3);  // two failed reads, one that is well, the loop held
    CHECK(health[0].kind == "sensor");
    CHECK(health[0].name == "room");
    CHECK(health[0].state == "degraded");
    CHECK(health[0].reason == "no answer");
    CHECK(health[1].state == "ok");
    CHECK(health[1].reason.empty());
    CHECK(health[1].time - health[0].time == 20ms);
    CHECK(health[2].kind == "loop");
    CHECK(health[2].name == "main");
    CHECK(health[2].state == "degraded");
    CHECK(health[2].reason.find("sensor room held the loop for 55 ms") == 0);
    CHECK(recording.health(2).or_throw().empty());
    for (const RecordedTopic& topic : recording.topics().or_throw()) CHECK(topic.topic[0] != '$');
    CHECK(verify(recording).or_throw().verdict() == Verdict::balanced);
  }
  std::ostringstream out, err, json;
  CHECK(app::info({.database = path}, out, err) == 0);
  CHECK(out.str().find("sensor room: degraded: no answer") != std::string::npos);
  CHECK(out.str().find("sensor room: ok") != std::string::npos);
  CHECK(app::info({.database = path, .show_as = app::ShowAs::json}, json, err) == 0);
  CHECK(json.str().find("\"state\": \"degraded\"") != std::string::npos);
}

TEST_CASE("US-26 a sink that names $rtdata/health records the events too, those of tiers with them") {
  const Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop{virtual_time()};
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([](const LogRecord&) {});
    Tier fast(loop, {.name = "fast"});
    SqliteSink sink(loop, {.path = path, .sink = {.topics = {"#", health_topic}}});
    int reads = 0;
    Sensor<Climate> room(fast.loop(), {.name = "room", .rate = 100_Hz, .faulted_after = 1000},
                         [&]() -> Result<Climate> {
                           if (++reads < 5) return Error{Errc::io_failed, "no answer", "", "", ""};
                           return Climate{20, 40};
                         });
    unsigned looks = 0;
    Ticker look(loop, 5ms, [&](const Tick&) {
      if (reads >= 10 || ++looks == 10'000) loop.stop();
    });
    loop.run();
    look.close();
    loop.close();
  }
  CHECK(number(path,
               "SELECT count(*) FROM rtdata_health WHERE kind = 'sensor' AND name = 'room' AND state = 'degraded'") ==
        1);
  CHECK(number(path, "SELECT count(*) FROM rtdata_health WHERE kind = 'sensor' AND name = 'room' AND state = 'ok'") ==
        1);
  CHECK(
      number(
          path,
          "SELECT count(*) FROM \"$rtdata/health\" WHERE kind = 'sensor' AND name = 'room' AND reason = 'no answer'") ==
      1);
  CHECK(number(path,
               "SELECT count(*) FROM \"$rtdata/health\" WHERE origin = 'program:$rtdata/health@fast' AND state = 'ok' "
               "AND kind = 'sensor'") == 1);
  CHECK(verified(path).verdict() == Verdict::balanced);
}

TEST_SUITE_END();
