/// SerialLineSensor: a device that sends lines of text over a serial line, CSV or JSON: the usual Arduino or Teensy.
///
///     rtdata::SerialLineSensor imu(loop, {.name = "imu", .topic = "board/imu"},
///                                  {.device = "/dev/ttyACM0", .serial = {.baud_rate = 115200},
///                                   .lines = {.fields = {{.name = "ax", .unit = "m/s2"},
///                                                        {.name = "count", .type = rtdata::Kind::u32}},
///                                             .sequence_field = "count"}});
///
/// Each line becomes one event with the configured fields; lines.hpp says how lines are read.
///
/// - If the device disappears, the sensor is faulted and opens it again after `retry_first`, doubling to
///   `retry_longest`, by its path: /dev/serial/by-id/... finds it on any port. The same at the start, unless it is
///   `required`. The time without the device is a gap (disconnected).
/// - `at_open` and `at_open_hex` are sent after each opening, for devices that send only after a request.
/// - The serial line is locked for this program. Sensors of one loop with the same `device` and settings share it: each
///   takes the lines that its `only` selects.
///
/// Its `format` nmea is a satellite receiver (GPS or others) without gpsd:
///
///     rtdata::SerialLineSensor gps(loop, {.name = "gps"},
///                                  {.device = "/dev/ttyACM0", .lines = {.format = rtdata::LineFormat::nmea}});
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <string>
#include <vector>

#include "rtdata/io/serial.hpp"
#include "rtdata/sensors/lines.hpp"

namespace rtdata {

struct SerialConfig {
  std::string device = {};  ///< "/dev/serial/by-id/...", "/dev/ttyUSB0"
  SerialSettings serial = {};
  std::vector<std::string> at_open = {};      ///< sent after each opening, in order, with their ends
  std::vector<std::string> at_open_hex = {};  ///< bytes, sent after them
  LineConfig lines = {};
  bool required = false;  ///< a device that cannot be opened at the start throws

  friend constexpr auto parameters(type_tag<SerialConfig>) {
    return parameter_list(
        parameter("device", &SerialConfig::device, "the serial device", rtdata::required, TextIs::device),
        include_member(&SerialConfig::serial),
        parameter("at_open", &SerialConfig::at_open,
                  "what is sent after each opening, such as a command that starts the device"),
        parameter("at_open_hex", &SerialConfig::at_open_hex, "bytes that are sent after `at_open`"),
        include_member(&SerialConfig::lines),
        parameter("required", &SerialConfig::required,
                  "true: the program ends if the device cannot be opened at the start"));
  }
};

void check_config(const SerialConfig& config, const ConfigItem& item, Problems& problems);
ReadTime read_time(const SerialConfig& config);

class SerialLineSensor : public AnySensor {
 public:
  SerialLineSensor() noexcept = default;
  /// SetupError: as `Feed`; bad-argument for a configuration that cannot work; the error of opening a required device.
  SerialLineSensor(Loop& loop, FeedConfig feed, SerialConfig config);

 private:
  explicit SerialLineSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
