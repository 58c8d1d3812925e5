// Values that an output can never have: what refuses them, and that nothing else happens.
#include <doctest/doctest.h>
#include <signal.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <limits>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "app/process.hpp"
#include "app/runtime_folder.hpp"
#include "outputs/memory_actuator.hpp"
#include "outputs/output_log.hpp"
#include "paths.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/outputs/gpio.hpp"
#include "rtdata/outputs/pwm.hpp"
#include "rtdata/process/expression.hpp"
#include "rtdata/sensors/feed.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace std::chrono_literals;
using outputs_test::Device;
using outputs_test::OutputLog;

namespace {

using Lines = std::vector<std::string>;
constexpr double infinite = std::numeric_limits<double>::infinity();

struct Air {
  double temperature = 0;
  friend constexpr auto describe(type_tag<Air>) { return record("air", field("temperature", &Air::temperature)); }
};

/// A kind of one's own, which says what it takes: by its settings, whole numbers or fractions up to `most`.
struct StepsConfig {
  double most = 8;
  bool is_whole = true;
  friend constexpr auto parameters(type_tag<StepsConfig>) {
    return parameter_list(parameter("steps", &StepsConfig::most, "how many it has"),
                          parameter("whole", &StepsConfig::is_whole, "it takes no fractions"));
  }
};
class Steps final : public Actuator {
 public:
  explicit Steps(StepsConfig config) : config_(config) {}
  OutputRange range() const override { return {2, config_.most, config_.is_whole}; }
  Result<void> open(std::optional<double>) override { return {}; }
  Result<void> set(double) override { return {}; }

 private:
  StepsConfig config_;
};

/// The problems of a file, each as a line "line:column message". Line 2 begins with the outputs.
std::string problems_of(const std::string& outputs, const std::string& more = "") {
  Registry registry = standard_registry();
  registry.add_output<StepsConfig>("steps", "a motor", [](const StepsConfig& c) { return std::make_unique<Steps>(c); });
  const std::string text = R"({"sensors": [{"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"}],)"
                           "\n" +
                           outputs + more + "}";
  std::string lines;
  for (const Problem& problem : plan_system(registry, parse_config(text, "f.json")).problems)
    lines += (lines.empty() ? "" : "\n") + std::to_string(problem.place.line) + ":" +
             std::to_string(problem.place.column) + " " + problem.message;
  return lines;
}

long count_of(const std::string& lines) { return lines.empty() ? 0 : 1 + std::count(lines.begin(), lines.end(), '\n'); }

std::string text_of(const std::string& path) {
  std::string text;
  std::getline(std::ifstream(path), text);
  return text;
}

}  // namespace

TEST_SUITE("outputs") {
  TEST_CASE("US-35 a range says what is not in it, and why") {
    const OutputRange any, line{0, 1, true}, duty{0, 1}, steps{2, 8, true};
    for (const double value : {0.0, -1e300, 1e300, 0.5}) CHECK(any.refusal(value).empty());
    for (const OutputRange& range : {any, line, duty, steps})
      for (const double value : {std::nan(""), infinite, -infinite})
        CHECK(range.refusal(value) == "the value is not a finite number");
    CHECK(line.refusal(0).empty());
    CHECK(line.refusal(1).empty());
    CHECK(line.refusal(0.5) == "0.5 is not a value for the device: 0 or 1");
    CHECK(line.refusal(-1) == "-1 is not a value for the device: 0 or 1");
    CHECK(duty.refusal(0.5).empty());
    CHECK(duty.refusal(2) == "2 is not a value for the device: from 0 to 1");
    CHECK(steps.refusal(8).empty());
    CHECK(steps.refusal(2.5) == "2.5 is not a value for the device: whole numbers from 2 to 8");
    CHECK(OutputRange{.least = 3}.refusal(2) == "2 is not a value for the device: 3 or more");
    CHECK(OutputRange{.most = 3}.refusal(4) == "4 is not a value for the device: 3 or less");
    CHECK(OutputRange{.is_whole = true}.refusal(0.5) == "0.5 is not a value for the device: whole numbers");
    CHECK(range_of({}).refusal(1e9).empty());
    CHECK(range_of([]() -> std::unique_ptr<Actuator> { throw std::runtime_error("no"); }).refusal(1e9).empty());
  }

  TEST_CASE("US-35 check refuses what an output can never have, at its place: safe values, states, rules") {
    const std::string pwm = R"("outputs": [{"name": "fan", "type": "pwm", )";
    CHECK(problems_of(pwm + R"("safe": 1}])").empty());
    CHECK(problems_of(pwm + R"("safe": 2}])") == "2:52 2 is not a value for the device: from 0 to 1");
    CHECK(problems_of(pwm + R"("safe": -0.1}])") == "2:52 -0.1 is not a value for the device: from 0 to 1");
    CHECK(count_of(problems_of(pwm + R"("safe": 1e999}])")) == 1);
    const std::string steps = R"("outputs": [{"name": "fan", "type": "steps")";
    CHECK(problems_of(steps + "}]") ==
          "2:13 `safe` is 0 by default: 0 is not a value for the device: whole numbers from 2 to 8");
    CHECK(problems_of(steps + R"(, "safe": 8}])").empty());
    CHECK(count_of(problems_of(steps + R"(, "safe": 8, "steps": 7}])")) == 1);
    if (standard_registry().outputs().find("gpio"))
      CHECK(problems_of(R"("outputs": [{"name": "fan", "type": "gpio", "line": 3, "safe": 0.5}])") ==
            "2:64 0.5 is not a value for the device: 0 or 1");
    const std::string rule = pwm + R"("on": "load", )";
    CHECK(problems_of(rule + R"("expression": "minutes_1"}])").empty());
    CHECK(problems_of(rule + R"("expression": "minutes_1 > 2 ? 1 : 0.5"}])").empty());
    CHECK(problems_of(rule + R"("expression": "minutes_1 > 2 ? 5 : minutes_1 > 1 ? -3 : 0"}])") ==
          "2:89 5 is not a value for the device: from 0 to 1 (column 17 of the expression)\n2:109 -3 is not a value "
          "for the device: from 0 to 1 (column 37 of the expression)");
    CHECK(problems_of(rule + R"("expression": "minutes_1", "pid": {"setpoint": 1, "kp": 1, "most": 100}}])") ==
          "2:125 100 is not a value for the device: from 0 to 1");
    CHECK(problems_of(rule + R"("expression": "1000 * minutes_1", "hysteresis": {"on": 1000, "off": 900}}])").empty());
    const std::string own = steps + R"(, "safe": 2, "on": "load", "expression": "minutes_1)";
    CHECK(count_of(problems_of(own + R"( > 2"}])")) == 2);  // of a condition 0 and 1
    CHECK(count_of(problems_of(own + R"(", "hysteresis": {"on": 2, "off": 1}}])")) == 2);
    // `most` is 1.
    CHECK(count_of(problems_of(own + R"(", "whole": false, "pid": {"setpoint": 1, "kp": 1, "least": 0.5}}])")) == 2);
    const std::string
        fractions = " a `pid` gives fractions, but the device accepts only whole numbers: use `hysteresis`";
    CHECK(problems_of(own + R"(", "pid": {"setpoint": 1, "kp": 1, "least": 2, "most": 8}}])") == "2:105" + fractions);
    CHECK(problems_of(own + R"(", "pid": {"setpoint": 1, "kp": 1, "least": 0.5}}])") == "2:105" + fractions);
    if (standard_registry().outputs().find("gpio")) {
      const std::string line = R"("outputs": [{"name": "fan", "type": "gpio", "line": 3, "on": "load", )";
      CHECK(problems_of(line + R"("expression": "minutes_1", "pid": {"setpoint": 1, "kp": 1}}])") ==
            "2:104" + fractions);
      CHECK(problems_of(line + R"("expression": "minutes_1", "hysteresis": {"on": 2, "off": 1}}])").empty());
    }
    const auto machine = [](const std::string& values) {
      return R"(,"machines": [{"name": "m", "start": "a", "states": [{"name": "a", "final": true, "set": [)" + values +
             "]}]}]";
    };
    CHECK(problems_of(pwm + R"("safe": 1}])", machine(R"({"output": "fan", "value": 0.5})")).empty());
    CHECK(problems_of(pwm + R"("safe": 1}])", "\n" + machine(R"({"output": "fan", "value": 2})")) ==
          "3:118 2 is not a value for the device: from 0 to 1");
    CHECK(count_of(problems_of(steps + R"(, "safe": 2}])", machine(R"({"output": "fan"})"))) == 1);
  }

  TEST_CASE("US-35 a value that the device does not take is refused and recorded; the output keeps what it has") {
    Device device;
    device.range = {0, 1, true};
    Loop loop{Loop::Manual{}};
    loop.runtime().on_log([](const LogRecord&) {});
    OutputLog log(loop, "o");
    Output output(loop, {.name = "o", .lease = 1s}, device.make());
    output.set(1).or_throw();
    loop.advance(900ms);
    for (const double value : {0.5, 2.0, -1.0}) CHECK(output.set(value, "me").error().code == Errc::out_of_range);
    CHECK(output.set(0.5).error().why == "0.5 is not a value for the device: 0 or 1");
    for (const double value : {std::nan(""), infinite}) CHECK(output.set(value).error().code == Errc::bad_argument);
    loop.advance(50ms);
    CHECK(output.value() == 1);
    CHECK(output.health() == Health::ok);
    CHECK(device.did == Lines{"open 0", "set 1"});
    const std::string why = " is not a value for the device: 0 or 1";
    CHECK(log.lines == Lines{"start 0 done", "set 1 done", "set 0.5 failed: 0.5" + why, "set 2 failed: 2" + why,
                             "set -1 failed: -1" + why, "set 0.5 failed: 0.5" + why});
    loop.advance(100ms);  // what was refused does not extend the lease
    CHECK(output.value() == 0);
    output.close();
    CHECK_THROWS_AS(Output(loop, {.name = "o", .safe = 0.5}, device.make()), SetupError);
    CHECK(device.did == Lines{"open 0", "set 1", "set 0", "set 0", "gone"});
  }

  TEST_CASE(
      "US-35 an expression that gives what the device does not take makes its output safe, and is followed again") {
    Device device;
    device.range = {0, 1};
    Loop loop{Loop::Manual{}};
    loop.runtime().on_log([](const LogRecord&) {});
    Lines errors;
    loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.why); });
    Feed<Air> air(loop, {.name = "air"});
    Output output(loop, {.name = "o", .on = "air", .expression = "temperature"}, device.make());
    for (const double value : {0.25, 1.5, 3.0, 0.75}) {
      air.publish({value});
      loop.advance(1ms);
    }
    CHECK(device.did == Lines{"open 0", "set 0.25", "set 0", "set 0.75"});
    CHECK(errors == Lines{"1.5 is not a value for the device: from 0 to 1"});
    CHECK(output.health() == Health::ok);
  }

  TEST_CASE("US-35 US-41 ctl set refuses a value that the output cannot have, with the reason") {
    const test::RuntimeFolder runtime;
    const test::Folder folder;
    ScratchDirectory chips;
    chips.file("pwmchip0/npwm", "1\n");
    for (const char* name : {"period", "duty_cycle", "enable"}) chips.file(std::string("pwmchip0/pwm0/") + name, "0\n");
    chips.file("pwmchip0/pwm0/polarity", "normal\n");
    folder.write("rig.json", R"({"name": "rig", "sinks": [{"type": "sqlite", "path": "run.db"}],
      "outputs": [{"name": "fan", "type": "pwm", "frequency": "1 kHz", "root": ")" +
                                 chips.path() + "\"}]}");
    test::Process run(folder, test::built("rtdata"), {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    const auto ctl = [&](const std::string& value, int status) {
      test::Process one(folder, test::built("rtdata"), {"ctl", "set", "fan", value});
      CHECK(one.end() == status);
      return one.out + one.err;
    };
    const std::string duty = chips.path() + "/pwmchip0/pwm0/duty_cycle";
    CHECK(ctl("0.5", 0) == "output fan is being set to 0.5\n");
    for (int i = 0; i < 6000 && text_of(duty) != "500000"; ++i) std::this_thread::sleep_for(10ms);
    const auto refuses = [&](const std::string& value, const std::string& why) {
      const std::string answer = ctl(value, 1);
      CAPTURE(answer);
      CHECK(answer.find(why) != std::string::npos);
      CHECK(text_of(duty) == "500000");
    };
    refuses("2", "2 is not a value for the device: from 0 to 1");
    refuses("nan", "the value is not a finite number");
    refuses("inf", "the value is not a finite number");
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    CHECK(text_of(duty) == "0");
  }
}
