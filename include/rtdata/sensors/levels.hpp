/// LevelsSensor: the levels of one or several GPIO lines, sampled at a rate.
///
///     rtdata::LevelsSensor doors(loop, {.name = "doors", .rate = 10_Hz},
///                                {.lines = {{.name = "front", .line = "GPIO17", .bias = rtdata::GpioBias::pull_up},
///                                           {.name = "back", .line = "GPIO27"}}});
///
/// Each event has a boolean for each line, in order, under its `name`; true is active. They are read one after the
/// other. It does not see changes between two readings; use an EdgeSensor for that (edge.hpp).
///
/// A lane opens, reads and releases the lines, so that an expander on a slow bus does not hold the loop. If one line
/// cannot be read, the reading fails; a faulted sensor opens all lines again.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/io/gpio.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace rtdata {

struct GpioLevel {
  std::string name = {};  ///< of the field
  GpioLineName line = {};
  std::string chip = {};
  GpioBias bias = GpioBias::as_is;
  bool active_low = false;

  friend constexpr auto parameters(type_tag<GpioLevel>) {
    return parameter_list(
        parameter("name", &GpioLevel::name, "name of the field", required, TextIs::field),
        parameter(
            "line", &GpioLevel::line,
            "name of the line (\"GPIO17\"), its number on the chip (17), or both chip and number (\"gpiochip0:17\")",
            required),
        parameter("chip", &GpioLevel::chip, "chip of the line, such as gpiochip0; empty: the chip that has the line"),
        parameter("bias", &GpioLevel::bias, "pull-up or pull-down resistor in the chip"),
        parameter("active_low", &GpioLevel::active_low, "the line is active when it is low"));
  }
};

struct LevelsConfig {
  std::vector<GpioLevel> lines = {};
  Duration timeout = std::chrono::seconds{1};  ///< a reading that takes longer is given up

  friend constexpr auto parameters(type_tag<LevelsConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(parameter("lines", &LevelsConfig::lines, "the lines, each a field", required),
                          parameter("timeout", &LevelsConfig::timeout, "a reading that takes longer is given up",
                                    range(Duration{1ms}, Duration{1h})));
  }
};

/// Errors: bad-description (no lines, a name twice).
Result<std::shared_ptr<const Description>> levels_description(const LevelsConfig& config);
/// Checks that there are lines and no line is listed twice.
void check_config(const LevelsConfig& config, const ConfigItem& item, Problems& problems);
ReadTime read_time(const LevelsConfig& config);

class LevelsSensor : public AnySensor {
 public:
  LevelsSensor() noexcept = default;
  /// SetupError: as `Sensor`; bad-argument for a configuration that cannot work.
  LevelsSensor(Loop& loop, SensorConfig sensor, LevelsConfig config)
      : LevelsSensor(loop, std::move(sensor), std::move(config), make_kernel_gpio()) {}
  LevelsSensor(Loop& loop, SensorConfig sensor, LevelsConfig config, std::shared_ptr<GpioBackend> backend);

 private:
  explicit LevelsSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
