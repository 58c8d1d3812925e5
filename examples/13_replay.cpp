// An analysis that replays: what a recording holds goes through the same handler as it did live, as fast as it goes.
// Without an argument it makes a recording of its own first.
#include <cstdio>
#include <string>

#include "rtdata/loop/loop.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/replay.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata::literals;

struct Pressure {
  double pressure = 0;
  RTDATA_FIELDS(Pressure, (pressure, "bar"))
};

// A minute of a tank that is filled, with 2 s without a reading.
void record(const std::string& path) {
  rtdata::Loop loop{rtdata::Loop::Manual{}};
  rtdata::SqliteSink sink(loop, {.path = path});
  int reading = 0;
  const rtdata::SensorConfig config{.name = "tank", .rate = 10_Hz, .retry_longest = 100ms};
  rtdata::Sensor<Pressure> tank(loop, config, [&]() -> rtdata::Result<Pressure> {
    if (++reading > 200 && reading <= 220) return rtdata::Error{rtdata::Errc::timed_out, "no answer", "tank", "", ""};
    return Pressure{1 + reading * 0.005};
  });
  tank.on_error([](const rtdata::ErrorReport&) {});
  loop.advance(1min);
  tank.close();
  loop.close();
}

int main(int argc, char** argv) {
  const std::string path = argc > 1 ? argv[1] : "replay_example.db";
  if (argc < 2) std::remove(path.c_str());
  if (argc < 2) record(path);

  rtdata::Loop loop{rtdata::Loop::Manual{}};
  int readings = 0, high = 0;
  auto watch = loop.subscribe<Pressure>("tank", [&](const rtdata::Event<Pressure>& event) {
    ++readings;
    if (event->pressure > 3 && ++high == 1) std::printf("above 3 bar at %s\n", rtdata::to_iso8601(event.time).c_str());
  });
  rtdata::Replay replay(loop, {.file = path, .topics = {"tank"}});
  while (!replay.is_done()) loop.advance(1h);
  std::printf("%d readings, %d of them above 3 bar, %d gaps\n", readings, high, static_cast<int>(replay.counts().gaps));

  // The same recording for a picture: a row for each 10 s.
  const auto recording = rtdata::Recording::open(path).or_throw();
  auto steps = recording.steps({.topic = "tank"}, 10s).or_throw();
  while (const rtdata::RecordedRow* row = steps.next().or_throw())
    std::printf("%s  %s bar\n", rtdata::to_iso8601(row->header().time).c_str(),
                rtdata::to_string(row->event().value("pressure.mean").or_throw()).c_str());
  return argc > 1 || (readings == 581 && replay.counts().gaps >= 1) ? 0 : 1;
}
