/// W1Sensor: a DS18B20 or another thermometer on 1-Wire, through the kernel's driver w1_therm.
///
///     rtdata::W1Sensor boiler(loop, {.name = "boiler", .rate = 0.5_Hz}, {.device = "28-000000c0ffee"});
///     auto s = loop.topic<rtdata::W1Temperature>("boiler").subscribe(loop, [](const auto& e) { use(*e); });
///
/// A conversion takes up to 750 ms at 12 bits: each thermometer has its own lane, so it delays nothing else, and
/// thermometers with their own supply convert at the same time. A rate above 1 Hz misses ticks. On a bus with parasitic
/// power the kernel allows one conversion at a time: `timeout` must cover the conversions of all thermometers.
///
/// A reading is unreadable with a wrong checksum; at 85 °C after the thermometer has lost its supply (byte 6
/// distinguishes this from a measured 85 °C: kernel, w1_therm.c, W1_THERM_CHECK_RESULT); with all bytes 0, from a
/// shorted bus, although the checksum is right; and outside -55 to 125 °C (DS18B20 data sheet, "Operation - measuring
/// temperature"). If a thermometer disappears, the sensor is faulted until it is back; the kernel finds a plugged-in
/// thermometer within 10 s.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/parameter.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace rtdata {

struct W1Temperature {
  double temperature = 0;
  friend constexpr auto describe(type_tag<W1Temperature>) {
    return record("temperature", field("temperature", &W1Temperature::temperature, "Cel"));
  }
};

struct W1Config {
  std::string device = {};                     ///< "28-000000c0ffee"; empty: the only one
  std::string root = {};                       ///< prefix of /sys, such as the host's root folder in a container
  Duration timeout = std::chrono::seconds{3};  ///< a read that takes longer is given up

  friend constexpr auto parameters(type_tag<W1Config>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("device", &W1Config::device, "name of the thermometer, such as 28-000000c0ffee; empty: the only one",
                  TextIs::recorded),
        parameter("root", &W1Config::root, "prefix of /sys, such as the host's root folder in a container",
                  TextIs::device),
        parameter("timeout", &W1Config::timeout, "a read that takes longer is given up",
                  range(Duration{1ms}, Duration{1h})));
  }
};

/// Checks that the device is a name, not a path.
void check_config(const W1Config& config, const ConfigItem& item, Problems& problems);
/// The time on the lane is a conversion of 12 bits.
ReadTime read_time(const W1Config& config);
/// Degrees Celsius in the text of a file w1_slave. Errors: disconnected (no answer), bad-data, out-of-range.
Result<double> parse_w1(std::string_view text);
/// The thermometers below `root`, sorted: names of folders. Blocks for as long as listing a directory takes.
std::vector<std::string> available_w1(const std::string& root = {});

class W1Sensor : public AnySensor {
 public:
  W1Sensor() noexcept = default;
  /// SetupError: as `Sensor`; bad-argument for a device that is a path.
  W1Sensor(Loop& loop, SensorConfig sensor, W1Config config);

 private:
  explicit W1Sensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
