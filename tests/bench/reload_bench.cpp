// reload: what it takes to go on with another configuration of 1000 sensors, of which one has changed: reading,
// checking, and applying it, beside reading and checking that file. A remark says how many ticks the other sensors
// missed when they are read 10 times a second.
#include <string>

#include "harness.hpp"
#include "rtdata/config/change.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/config/registry.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace bench {
namespace {

using namespace rtdata;
using namespace std::chrono_literals;

constexpr int sensors = 1000;

struct Value {
  double value = 0;
  RTDATA_FIELDS(Value, (value))
};
struct CountingConfig {
  double step = 1;
  friend constexpr auto parameters(type_tag<CountingConfig>) {
    return parameter_list(parameter("step", &CountingConfig::step, "what is added with each reading"));
  }
};

Registry made_registry() {
  Registry registry;
  registry.add_sensor<CountingConfig>(
      "counting", "a counter", [](const CountingConfig&) { return Result(description_of<Value>()); },
      [](Loop& loop, const SensorConfig& common, const CountingConfig& config) {
        return Sensor<Value>(loop, common,
                             [value = 0.0, step = config.step]() mutable { return Value{value += step}; });
      });
  return registry;
}

/// The step of one of the sensors is this.
std::string text_of(int step) {
  std::string text = "{\"sensors\": [";
  for (int i = 0; i < sensors; ++i)
    text += std::string(i == 0 ? "" : ",\n") + R"({"name": "s)" + std::to_string(i) +
            R"(", "type": "counting", "rate": "10 Hz", "step": )" + std::to_string(i == sensors / 2 ? step : 1) + "}";
  return text + "]}";
}

struct Running {
  Registry registry = made_registry();
  Loop loop;
  System system{loop, registry, plan_system(registry, parse_config(text_of(0), "f.json"))};
  int step = 0;

  SystemPlan read() { return plan_system(registry, parse_config(text_of(++step), "f.json")); }
  double reload() {
    const std::int64_t begin = thread_cpu_ns();
    if (system.apply(read()).refused() != 0) return -1;
    return static_cast<double>(thread_cpu_ns() - begin) / 1e6;
  }
  double only_read() {
    const std::int64_t begin = thread_cpu_ns();
    keep(read().good());
    return static_cast<double>(thread_cpu_ns() - begin) / 1e6;
  }
};

}  // namespace

void bench_reload(Report& report) {
  if (!report.wants("reload")) return;
  Running running;
  report.add(measure_pair(
      {.name = "reload", .unit = "ms", .reach = 1.5}, [&] { return running.reload(); },
      [&] { return running.only_read(); }, 15));
  // The file is read elsewhere, as `rtdata run` does.
  Running live;
  const SystemPlan next = live.read();
  const Timer later(live.loop, 1050ms, [&] { live.system.apply(next); });
  live.loop.run_for(2s);
  std::uint64_t missed = 0, late = 0;
  for (const SensorStatus& sensor : live.loop.runtime().sensors()) {
    missed += sensor.counts.missed;
    late += sensor.counts.late;
  }
  report.remark("reload: while one of " + std::to_string(sensors) + " sensors changed, the others missed " +
                std::to_string(missed) + " ticks, and " + std::to_string(late) + " began late");
}

}  // namespace bench
