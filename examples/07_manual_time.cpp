// Testing without waiting: on a manual loop time is virtual, and an hour takes no time.
#include <cstdio>

#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata::literals;

struct Pressure {
  double pressure = 0;
  RTDATA_FIELDS(Pressure, (pressure, "bar"))
};

int main() {
  rtdata::Loop loop{rtdata::Loop::Manual{}};
  bool is_unplugged = false;
  rtdata::Sensor<Pressure> tank(loop, {.name = "tank", .rate = 10_Hz}, [&]() -> rtdata::Result<Pressure> {
    if (is_unplugged) return rtdata::Error{rtdata::Errc::disconnected, "cannot read", "tank", "unplugged", ""};
    return Pressure{2.5};
  });
  int errors = 0;
  tank.on_error([&](const rtdata::ErrorReport&) { ++errors; });
  rtdata::Timer unplug(loop, 30min + 50ms, [&] { is_unplugged = true; });
  rtdata::Timer plug(loop, 40min + 50ms, [&] { is_unplugged = false; });

  loop.advance(30min);
  const bool good_at_first = tank.counts().published == 30 * 60 * 10 + 1;  // the first at the start
  loop.advance(5min);
  const bool noticed = tank.health() == rtdata::Health::faulted && errors > 0;
  loop.advance(25min);
  const rtdata::SensorCounts counts = tank.counts();
  std::printf("scheduled %d, taken %d, failed %d\n", static_cast<int>(counts.scheduled), static_cast<int>(counts.taken),
              static_cast<int>(counts.failed));
  const bool accounted = counts.scheduled == 60 * 60 * 10 + 1 && counts.failed >= 10 * 60 * 10 && counts.balances();
  return good_at_first && noticed && accounted && tank.health() == rtdata::Health::ok ? 0 : 1;
}
