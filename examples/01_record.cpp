// Records a sensor for a second into run.db. Then: rtdata verify run.db
#include <cstdio>

#include "rtdata/loop/loop.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata::literals;

struct Climate {
  double temperature = 0, humidity = 0;
  RTDATA_FIELDS(Climate, (temperature, "Cel"), (humidity, "%"))
};

int main() {
  rtdata::Loop loop;
  rtdata::SqliteSink recording(loop, {.path = "run.db"});
  rtdata::Sensor<Climate> room(loop, {.name = "room", .topic = "room/climate", .rate = 10_Hz}, [t = 20.0]() mutable {
    return Climate{t += 0.1, 40};
  });
  auto print = loop.topic<Climate>("room/climate").subscribe(loop, [](const rtdata::Event<Climate>& e) {
    std::printf("%s  %.1f Cel\n", rtdata::to_iso8601(e.time).c_str(), e->temperature);
  });
  loop.run_for(1s);
  return loop.close() == 0 && loop.runtime().balances() ? 0 : 1;
}
