// Random configurations, one after the other, on a running system in virtual time, against a model of what there is:
// what did not change misses no tick and loses no event, each tick of what is made anew is in the account, what is gone
// is safe, a change that fails changes nothing, and the recording of it all verifies.
#include <doctest/doctest.h>

#include <cstdlib>
#include <map>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "outputs/memory_actuator.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/change.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/process/expression.hpp"
#include "sensors/fixture.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace std::chrono_literals;

namespace {

struct Number {
  double value = 0;
  RTDATA_FIELDS(Number, (value))
};
struct CountingConfig {
  double step = 1;
  bool breaks = false;
  friend constexpr auto parameters(type_tag<CountingConfig>) {
    return parameter_list(parameter("step", &CountingConfig::step, "what is added with each reading"),
                          parameter("breaks", &CountingConfig::breaks, "it cannot be made"));
  }
};
struct DeviceConfig {
  std::string device;
  friend constexpr auto parameters(type_tag<DeviceConfig>) {
    return parameter_list(parameter("device", &DeviceConfig::device, "its name", required, TextIs::recorded));
  }
};

/// An item as it stands in the file.
struct Part {
  std::string kind, item;
  unsigned per_second = 0;  // of a counting sensor
};
using Model = std::map<std::string, Part>;  // by name

struct Run {
  explicit Run(unsigned seed) : random(seed) {
    be_quiet(loop);
    registry.add_sensor<CountingConfig>(
        "counting", "a counter", [](const CountingConfig&) { return Result(description_of<Number>()); },
        [](Loop& its_loop, const SensorConfig& common, const CountingConfig& config) {
          if (config.breaks) throw SetupError({Errc::io_failed, "cannot make it", "the device", "it breaks", ""});
          return Sensor<Number>(its_loop, common,
                                [value = 0.0, step = config.step]() mutable { return Number{value += step}; });
        });
    registry.add_output<DeviceConfig>("memory", "a device of memory",
                                      [this](const DeviceConfig& config) { return devices[config.device].make()(); });
  }

  unsigned below(unsigned limit) { return std::uniform_int_distribution<unsigned>(0, limit - 1)(random); }
  std::string text(const Model& model) const {
    std::map<std::string, std::string> lists;
    for (const auto& [name, part] : model) lists[part.kind] += (lists[part.kind].empty() ? "" : ",\n") + part.item;
    std::string all;
    for (const auto& [kind, items] : lists) all += "\"" + kind + "s\": [" + items + "],\n";
    return "{" + all + R"("sinks": [{"type": "sqlite", "name": "all", "path": ")" + path + "\"}]}";
  }

  Part counting(const std::string& name, bool breaks = false) {
    const unsigned rates[] = {10, 20, 50};
    const unsigned rate = rates[below(3)];
    return {"sensor",
            R"({"name": ")" + name + R"(", "type": "counting", "rate": ")" + std::to_string(rate) +
                R"( Hz", "step": )" + std::to_string(1 + below(3)) + (breaks ? R"(, "breaks": true})" : "}"),
            rate};
  }
  /// One of the counting sensors: it may not be there.
  std::string source() { return "c" + std::to_string(below(5)); }
  Part any(const std::string& name) {
    const std::string head = R"({"name": ")" + name + "\", ", on = R"("on": ")" + source() + "\", ";
    switch (name[0]) {
      case 'd':
        return {"sensor", head + R"("type": "derived", )" + on + R"j("expression": "value * 2 + highest(value)"})j"};
      case 'l':
        return {"sensor", head + R"("type": "limit", )" + on + R"("high": )" + std::to_string(10 + below(50)) + "}"};
      case 't':
        return {"sensor", head + R"("type": "trigger", )" + on + R"("when": "value > )" + std::to_string(below(200)) +
                              R"(", "before": ")" + std::to_string(below(4)) + R"( s", "events": 40})"};
      case 'm':
        return {"machine", head + R"("inputs": [")" + source() + R"("], "start": "low",
            "states": [{"name": "low"}, {"name": "high"}],
            "transitions": [{"from": "low", "to": "high", "when": "value > )" +
                               std::to_string(below(100)) + R"("}, {"from": "high", "to": "low", "after": "2 s"}]})"};
      case 'o':
        return {"output",
                head + R"("type": "memory", "device": ")" + name + "\", " +
                    (below(2) == 0 ? on + R"("expression": "value > 5"})" : R"("on": "m0", "expression": "high"})")};
      default:
        return counting(name);
    }
  }
  Model changed(Model model) {
    for (unsigned count = below(4); count-- > 0;) {
      constexpr const char* names[] = {"c0", "c1", "c2", "c3", "c4", "d0", "d1", "l0", "t0", "t1", "m0", "o0", "o1"};
      const std::string name = names[below(std::size(names))];
      if (below(3) == 0)
        model.erase(name);
      else
        model[name] = any(name);
    }
    return model;
  }
  SensorCounts counts(const std::string& name) {
    return system->parts().get<AnySensor>("sensor", name).status().counts;
  }
  std::map<std::string, SensorCounts> counts_of(const Model& model) {
    std::map<std::string, SensorCounts> all;
    for (const auto& [name, part] : model)
      if (part.per_second != 0) all[name] = counts(name);
    return all;
  }
  /// At once, or with turns of the loop in between.
  void apply(const SystemPlan& plan) {
    StepwiseChange change(*system, plan);
    const Duration budget = below(2) == 0 ? Duration::max() : Duration{0};
    while (change.step(budget)) loop.advance(5ms);
  }
  /// What is there is what the model has.
  void compare(const Model& model) {
    std::map<std::string, std::vector<std::string>> names;
    for (const auto& [name, part] : model) names[part.kind].push_back(name);
    for (const char* kind : {"sensor", "machine", "output"}) {
      std::vector<std::string> there = system->parts().names(kind);
      std::sort(there.begin(), there.end());
      CHECK(there == names[kind]);
    }
    for (const auto& [name, device] : devices) {
      if (model.contains(name) || device.did.empty()) continue;  // one that was planned alone was not opened
      CHECK(device.value == 0.0);
      CHECK(device.did.back() == "gone");
    }
    CHECK(loop.runtime().balances());
  }
  /// All its sensors go on.
  void advance(const Model& model, Duration time) {
    const auto all = counts_of(model);
    loop.advance(time);
    for (const auto& entry : all) {
      const std::string& name = entry.first;
      CAPTURE(name);
      const auto due = static_cast<std::uint64_t>(time / 100ms) * model.at(name).per_second / 10;
      CHECK(counts(name).published - entry.second.published == due);
      CHECK(counts(name).missed == entry.second.missed);
    }
  }

  void go(int steps) {
    Model now{{"c0", counting("c0")}};
    system.emplace(loop, registry, plan_system(registry, parse_config(text(now), "f.json")));
    loop.advance(0ms);
    for (int step = 0; step < steps; ++step) {
      CAPTURE(step);
      advance(now, 100ms * (1 + below(20)));
      Model next = changed(now);
      const bool breaks = below(6) == 0;
      if (breaks) next["broken"] = counting("broken", true);
      const std::string written = text(next);
      CAPTURE(written);
      const SystemPlan plan = plan_system(registry, parse_config(written, "f.json"));
      const auto before = counts_of(now);
      const MonotonicTime began = loop.now();
      bool is_applied = false;
      if (!plan.good()) {
        CHECK_THROWS_AS(system->apply(plan), ConfigError);
        ++mistakes;
      } else if (system->change_to(plan).refused() != 0) {
        CHECK(system->apply(plan).refused() != 0);
        ++refused;
      } else if (breaks) {
        CHECK_THROWS_AS(apply(plan), SetupError);
        ++failed;
      } else {
        apply(plan);
        is_applied = true;
        ++applied;
      }
      loop.advance(0ms);
      const double seconds = std::chrono::duration<double>(loop.now() - began).count();
      for (const auto& entry : before) {
        const std::string& name = entry.first;
        CAPTURE(name);
        if (is_applied && !next.contains(name)) continue;
        const SensorCounts after = counts(name);
        const double ticks = static_cast<double>(after.scheduled - entry.second.scheduled);
        const bool is_same = next.contains(name) && next[name].item == now[name].item;
        const unsigned other = next.contains(name) ? next[name].per_second : now[name].per_second;
        CHECK(ticks + 2 >= seconds * std::min(now[name].per_second, other));
        CHECK(ticks <= 2 + seconds * std::max(now[name].per_second, other));
        if (is_same) CHECK(after.missed == entry.second.missed);
        if (seconds == 0 && is_same) CHECK(after.published == entry.second.published);
      }
      if (is_applied) now = next;
      compare(now);
    }
    system.reset();
    loop.close();
    for (const auto& [name, device] : devices) CHECK((device.did.empty() || device.value == 0.0));
    CHECK(recordings::verified(path).verdict() == Verdict::balanced);
  }

  std::mt19937 random;
  ScratchDirectory directory;
  std::string path = directory.path() + "/all.db";
  std::map<std::string, outputs_test::Device> devices;
  Registry registry = standard_registry();
  Loop loop{Loop::Manual{}};
  std::optional<System> system;
  int applied = 0, mistakes = 0, refused = 0, failed = 0;
};

}  // namespace

TEST_SUITE("config") {
  TEST_CASE("random reloads: what is there is what the file says, and nothing is lost of what did not change") {
    unsigned first = 1, count = 10;
    if (const char* const wanted = std::getenv("RTDATA_TEST_SEEDS"); wanted != nullptr)  // "FIRST COUNT"
      std::istringstream(wanted) >> first >> count;
    int applied = 0, mistakes = 0, failed = 0;
    for (unsigned seed = first; seed < first + count; ++seed) {
      CAPTURE(seed);
      Run run(seed);
      run.go(40);
      applied += run.applied;
      mistakes += run.mistakes;
      failed += run.failed;
    }
    CHECK(applied > 5 * static_cast<int>(count));
    CHECK(mistakes > 0);
    CHECK(failed > 0);
  }
}
