/// Any bytes as the lines that come to the control socket of a running instance. Each is answered with a line of JSON;
/// what is a command is recorded once, and nothing but the right commands changes an output, of which a model knows
/// what it should have.
///
///     tests/fuzz/run.sh 60
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>

#include "app/control/commands.hpp"
#include "app/control/request.hpp"
#include "outputs/memory_actuator.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/config/registry.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata;
using namespace std::chrono_literals;

namespace {

struct Number {
  double value = 0;
  RTDATA_FIELDS(Number, (value))
};
struct Nothing {
  friend constexpr auto parameters(type_tag<Nothing>) { return parameter_list(); }
};

void require(bool is_so) {
  if (!is_so) std::abort();
}

/// A running instance, in virtual time.
struct Instance {
  Instance() {
    registry.add_sensor<Nothing>(
        "number", "a number", [](const Nothing&) { return Result(description_of<Number>()); },
        [](Loop& its_loop, const SensorConfig& common, const Nothing&) {
          return Sensor<Number>(its_loop, common, [] { return Number{1}; });
        });
    registry.add_output<Nothing>("memory", "a device of memory", [this](const Nothing&) { return device.make()(); });
    loop.runtime().on_log([](const LogRecord&) {});
    loop.on_error([](const ErrorReport&) {});
    system.emplace(loop, registry,
                   plan_system(registry, parse_config(R"({
        "sensors": [{"name": "s", "type": "number", "rate": "10 Hz"}],
        "outputs": [{"name": "o", "type": "memory", "armed": "by command"}]})",
                                                      "f.json")));
    seen = loop.subscribe(app::command_topic, [this](const EventView&) { ++recorded; });
  }

  outputs_test::Device device;
  Registry registry;
  Loop loop{Loop::Manual{}};
  std::optional<System> system;
  Subscription seen;
  std::uint64_t recorded = 0, logged = 0;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  Instance instance;
  app::Tares tares("/no/such/folder/f.tare", "f.json");
  app::CommandDesk desk(instance.loop, *instance.system, tares, [&](const std::string&, bool) { ++instance.logged; });
  bool is_armed = false;
  double value = 0;
  std::uint64_t commands = 0;
  std::string_view rest(reinterpret_cast<const char*>(data), size);
  while (!rest.empty() && commands < 200) {
    const std::size_t end = std::min(rest.find('\n'), rest.size());
    const std::vector<std::string> words = app::command_words(rest.substr(0, end));
    rest.remove_prefix(std::min(end + 1, rest.size()));
    if (words.empty() || words[0] == "reload") continue;  // the program does that one
    std::optional<app::CommandOutcome> told;
    desk.run(words, "uid 0, pid 1", [&](const app::CommandOutcome& outcome) { told = outcome; });
    for (int i = 0; i < 4 && !told; ++i) instance.loop.advance(1s);  // what arming and disarming wait for
    require(told.has_value());
    const app::CommandOutcome& outcome = *told;
    ++commands;
    require(!outcome.text.empty());
    const auto answer = nlohmann::json::parse(app::command_answer(outcome));
    require(answer.size() == 1 && answer.contains(outcome.done ? "done" : "refused"));
    const bool is_of_output = words.size() > 1 && words[1] == "o";
    if (is_of_output && words[0] == "arm" && words.size() == 2) require(outcome.done), is_armed = true;
    if (is_of_output && words[0] == "disarm" && words.size() == 2) require(outcome.done), is_armed = false, value = 0;
    if (is_of_output && words[0] == "set" && outcome.done) {
      require(is_armed && words.size() == 3);
      value = words[2] == "on" ? 1 : words[2] == "off" ? 0 : std::stod(words[2]);
      require(std::isfinite(value));
    }
    instance.loop.advance(1ms);
    auto& output = instance.system->parts().get<Output>("output", "o");
    require(output.is_armed() == is_armed);
    require(instance.device.value == value);
  }
  instance.loop.advance(1ms);
  require(instance.recorded == commands && instance.logged == commands);
  require(instance.loop.runtime().balances());
  instance.system.reset();
  require(instance.device.value == 0.0);
  return 0;
}
