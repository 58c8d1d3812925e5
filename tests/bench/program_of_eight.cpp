// The program rtdata with a sensor of eight numbers that costs nothing, for what is measured of a whole program.
#include "payloads.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/sensors/sensor.hpp"

int main(int count, char** arguments) {
  using namespace rtdata;
  Registry registry = standard_registry();
  registry.add_sensor<NoParameters>(
      "eight", "eight numbers", [](const NoParameters&) { return description_of<bench::Eight>(); },
      [](Loop& loop, const SensorConfig& common, const NoParameters&) {
        return Sensor<bench::Eight>(loop, common, [i = 0U]() mutable { return bench::reading(i++); });
      });
  return run_program(registry, count, arguments);
}
