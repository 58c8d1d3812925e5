// Records this computer's load for a second into run.db. Then: rtdata verify run.db
#include <cstdio>
#include <cstdlib>

#include "rtdata/loop/loop.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata::literals;

struct Load {
  double minute = 0, five_minutes = 0;
  RTDATA_FIELDS(Load, (minute, "1"), (five_minutes, "1"))
};

int main() {
  rtdata::Loop loop;
  rtdata::SqliteSink recording(loop, {.path = "run.db"});
  rtdata::Sensor<Load> sensor(loop, {.name = "load", .rate = 10_Hz}, [] {
    double means[2] = {};
    ::getloadavg(means, 2);
    return Load{means[0], means[1]};
  });
  auto print = loop.subscribe<Load>("load", [](const rtdata::Event<Load>& event) {
    std::printf("%s  %.2f\n", rtdata::to_iso8601(event.time).c_str(), event->minute);
  });
  loop.run_for(1s);
}
