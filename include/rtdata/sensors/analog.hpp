/// AnalogSensor: a sensor behind an analog-to-digital converter of the kernel.
///
///     rtdata::AnalogSensor chamber(loop, {.name = "chamber", .topic = "pressure/chamber", .rate = 100_Hz},
///                                  {.file = "/sys/bus/iio/devices/iio:device0/in_voltage0_raw",
///                                   .scale = 100, .quantization_bits = 12, .unit = "bar"});
///
/// The file holds one whole number, the converter's code; each tick reads it and converts it to the user's unit.
/// Instead of the file you can give `device` and `channel`: the device is then found by its name, whatever its number,
/// each time it is opened.
///
///
///     zero  = 2^bits * (zero_value_voltage - zero_voltage) / span_voltage
///     span  = 2^bits * span_value_voltage / span_voltage
///     value = (adc - zero) * scale / span
///
/// This default takes `span_value_voltage` as the width of the sensor's range. `AnalogConversion::two_point` takes it
/// as the voltage at which the value is exactly `scale`:
///
///     span  = 2^bits * (span_value_voltage - zero_value_voltage) / span_voltage
///
/// The two differ whenever `zero_value_voltage` is not 0, by the factor span_value_voltage / (span_value_voltage -
/// zero_value_voltage): a pressure sensor of 0.5 V at 0 bar and 4.5 V at 10 bar needs `two_point` (or, with the
/// default, span_value_voltage = 4). A converter whose range does not begin at 0 V (`zero_voltage`) moves `zero` in
/// both alike.
///
/// Events: a record "analog" of `value` (double, in `unit`) and `raw` (int64, the code); `analog_reading` reads them. A
/// reading that is missing, empty, not a number or out of the converter's range is an error and a gap, never a value.
/// Ids: not-found, not-permitted, io-failed, disconnected, not-a-number, out-of-range, bad-data (too long), timed-out.
///
/// A lane opens and reads the file, one for each physical device: a converter that hangs loses only its own readings.
/// Below /sys and on local disks the file stays open between readings; on local disks the sensor checks every 100 ms if
/// the path names another file. Anything else (a FIFO, a file of another machine) is opened for each reading.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "rtdata/data/event.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace rtdata {

enum class AnalogConversion { standard, two_point };
constexpr auto describe(type_tag<AnalogConversion>) {
  return enumeration("conversion", value("default", AnalogConversion::standard),
                     value("two_point", AnalogConversion::two_point));
}

struct AnalogConfig {
  std::string file = {};                          ///< the kernel's file, as it is (relative: to the working directory)
  std::string device = {};                        ///< instead: an IIO device's name, label, number or path (iio.hpp)
  std::string channel = {};                       ///< of that device: "voltage0"
  double zero_value_voltage = 0;                  ///< V at which the value is 0
  std::optional<double> span_value_voltage = {};  ///< V of the full value, see above; unset: span_voltage
  double scale = 1;                               ///< the full value, in `unit`
  unsigned quantization_bits = 12;                ///< resolution of the converter, 1 to 62
  double zero_voltage = 0;                        ///< V at which the converter gives 0
  double span_voltage = 3.3;                      ///< V between code 0 and code 2^bits
  std::string unit = {};                          ///< of the value, UCUM
  AnalogConversion conversion = AnalogConversion::standard;
  bool signed_adc = false;                     ///< the code is -2^(bits-1) to 2^(bits-1)-1 instead of 0 to 2^bits-1
  Duration timeout = std::chrono::seconds{1};  ///< a read that takes longer is given up

  friend constexpr auto parameters(type_tag<AnalogConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("file", &AnalogConfig::file, "file of the kernel with the converter's code", TextIs::device),
        parameter("device", &AnalogConfig::device,
                  "instead of a file: name, label, number or path of the IIO device of the converter", TextIs::device),
        parameter("channel", &AnalogConfig::channel, "channel of that device, such as voltage0", TextIs::recorded),
        parameter("zero_value_voltage", &AnalogConfig::zero_value_voltage, "voltage at which the value is 0",
                  rtdata::unit("V")),
        parameter("span_value_voltage", &AnalogConfig::span_value_voltage,
                  "voltage of the full value; default span_voltage", rtdata::unit("V")),
        parameter("scale", &AnalogConfig::scale, "the full value, in the sensor's unit", not_zero),
        parameter("quantization_bits", &AnalogConfig::quantization_bits, "resolution of the converter",
                  rtdata::unit("bit"), range(1, 62)),
        parameter("zero_voltage", &AnalogConfig::zero_voltage, "voltage at which the converter gives 0",
                  rtdata::unit("V")),
        parameter("span_voltage", &AnalogConfig::span_voltage, "range of the converter", rtdata::unit("V"), not_zero),
        parameter("unit", &AnalogConfig::unit, "unit of the value (UCUM)", TextIs::unit),
        parameter("conversion", &AnalogConfig::conversion,
                  "two_point: the value at span_value_voltage is exactly scale, also when zero_value_voltage is not 0"),
        parameter("signed_adc", &AnalogConfig::signed_adc, "the converter gives negative codes too"),
        parameter("timeout", &AnalogConfig::timeout, "a read that takes longer is given up",
                  range(Duration{1ms}, Duration{1h})));
  }
};

/// Checks that the sensor's range has a width, and that there is a file or a channel.
void check_config(const AnalogConfig& config, const ConfigItem& item, Problems& problems);

/// The payload of an analog sensor's events.
struct AnalogReading {
  double value = 0;      ///< in the sensor's unit
  std::int64_t raw = 0;  ///< the converter's code
};

/// The time on the loop; the time on the lane depends on the converter and is unknown.
ReadTime read_time(const AnalogConfig& config);
/// The value of a code. Pure; the code is not checked against the range.
double convert(const AnalogConfig& config, std::int64_t adc) noexcept;
/// The code in the text of an ADC file. Errors: bad-data (empty, too long), not-a-number, out-of-range.
Result<std::int64_t> parse_adc(const AnalogConfig& config, std::string_view text);
/// The description of the events of a sensor with this unit. Errors: bad-description.
Result<std::shared_ptr<const Description>> analog_description(const std::string& unit);
/// The reading in an analog sensor's event; empty for another event.
std::optional<AnalogReading> analog_reading(const EventView& event) noexcept;

class AnalogSensor : public AnySensor {
 public:
  AnalogSensor() noexcept = default;
  /// SetupError: as `Sensor`; bad-argument for an invalid configuration (no file or channel, a span of 0 V).
  AnalogSensor(Loop& loop, SensorConfig sensor, AnalogConfig config);

 private:
  explicit AnalogSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
