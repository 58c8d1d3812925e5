/// SerialLineSensor: a device that sends lines of text over a serial line, CSV or JSON: the usual Arduino or Teensy.
///
///     rtdata::SerialLineSensor imu(loop, {.name = "imu", .topic = "board/imu"},
///                                  {.device = "/dev/ttyACM0", .serial = {.baud_rate = 115200},
///                                   .fields = {{.name = "ax", .unit = "m/s2"}, {.name = "count", .type = Kind::u32}},
///                                   .sequence_field = "count"});
///
/// Each line becomes one event, whose fields are the configured ones; its time is that of the read which brought its
/// end.
///
/// - CSV as in RFC 4180, a row a line: one column a field, in order; a field without a name is a column that is not
///   kept. Blanks around a column do not count, nor do double quotes around it; in them a separator belongs to the
///   column and a quote is written twice. JSON: an object a line, keys in any order, others ignored; "imu.ax" as a
///   field's `key` reaches into nested objects.
/// - An empty column (JSON: null, or no such key) is no value in a field that is `optional`, and else a mistake, but
///   for a text, which it leaves empty. Numbers become the nearest that there is: 1e-400 is 0. A bool is true, false, 1
///   or 0, in upper or lower case. A byte order mark at the beginning does not count.
/// - A line ends with a newline, a carriage return before it does not count. Empty lines and those that begin with
///   `comment` are skipped, as are the first `skip_lines` lines after opening.
/// - What comes up to the first newline after opening is thrown away, since it may be half a line, and counted
///   (`SensorCounts::first_lines`), unless `first_line` is `keep`, or no byte came for 100 ms after the opening.
/// - A line that cannot be used (columns missing, no number, out of its type's range, longer than `max_line`) is
///   counted as unreadable and reported, and costs no other line anything.
/// - `sequence_field` names an integer by which the device numbers its lines: jumps are counted as lost, less the lines
///   in between that came and could not be used; equal numbers as repeated (and not published). A number that goes back
///   is a restart of the device, unless it is the wrap of the field's type.
///   A line whose number makes a jump is held until the next one, for `silence` or a second at most: when that takes
///   the jump back, as after a wrong digit, the line is unreadable; else both are published with their own times.
/// - A device that goes away makes the sensor faulted; it is opened again after `retry_first`, doubling to
///   `retry_longest`, by its path: /dev/serial/by-id/... finds it wherever it is plugged in again. Absent at the start:
///   the same, unless it is `required`. The time without it is a gap (disconnected).
/// - A line that is silent for longer than `silence` is degraded until a good line comes, and has a gap (silent).
/// - Without the end of a line for max(4 KiB, `max_line`), as at the wrong speed, it is degraded, which counts as one
///   unreadable; also while it waits for the end of what may be half a line.
/// - The line is taken for this program alone.
///
/// `format` nmea: a receiver of GPS or other satellites without gpsd, which sends sentences of NMEA 0183. `fields` is
/// not used: events are `GpsFix` (gps.hpp), as of GpsSensor.
///
///     rtdata::SerialLineSensor gps(loop, {.name = "gps"}, {.device = "/dev/ttyACM0", .format = LineFormat::nmea});
///
/// - The sentences of one instant become one event: GGA, RMC, VTG and GSA; the number of visible satellites is that of
///   the GSV sentences before. It is published with the last of them, which is learned from the instant before, or when
///   the first of the next instant comes; its time is that of the read which brought the last. Sentences without a time
///   (VTG, GSA) belong to the last with one; RMC's velocity is used before VTG's.
/// - What a sentence does not say is no value, never 0; without a fix (GGA 0, RMC V) there is no position and no
///   velocity.
/// - A sentence with a wrong checksum, without one, or with what cannot be read, is counted as unreadable; what it
///   would have said is absent. Received are fixes and unreadable sentences; sentences of other kinds are not counted.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "rtdata/io/serial.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata {

/// One field of a line.
struct LineField {
  std::string name = {};    ///< of the payload's field; empty (CSV only): the column is not kept
  Kind type = Kind::f64;    ///< any but enumeration and record
  std::string unit = {};    ///< UCUM
  double scale = 1;         ///< a float or double is multiplied by it
  std::string key = {};     ///< JSON: where it is in the object, levels separated by dots; empty: as the name
  std::size_t length = 32;  ///< of a text: the most bytes it may have
  bool optional = false;    ///< an empty column, null or a missing key is no value; else the line cannot be used

  friend constexpr auto parameters(type_tag<LineField>) {
    return parameter_list(
        parameter("name", &LineField::name, "name of the field; without one the column is not kept", TextIs::field),
        parameter("type", &LineField::type, "type of the value",
                  choices(value("bool", Kind::boolean), value("char", Kind::character), value("int8", Kind::i8),
                          value("int16", Kind::i16), value("int32", Kind::i32), value("int64", Kind::i64),
                          value("uint8", Kind::u8), value("uint16", Kind::u16), value("uint32", Kind::u32),
                          value("uint64", Kind::u64), value("float", Kind::f32), value("double", Kind::f64),
                          value("text", Kind::text))),
        parameter("unit", &LineField::unit, "unit of the value (UCUM)", TextIs::unit),
        parameter("scale", &LineField::scale, "factor, for float and double", not_zero,
                  only_with("type", "float", "double")),
        parameter("key", &LineField::key, "JSON: where it is, levels separated by dots; empty: as the name"),
        parameter("length", &LineField::length, "of a text: the most bytes it may have", range(1, 255),
                  only_with("type", "text")),
        parameter("optional", &LineField::optional, "an empty column, null or a missing key is no value"));
  }
};

enum class LineFormat { csv, json, nmea };
constexpr auto describe(type_tag<LineFormat>) {
  return enumeration("format", value("csv", LineFormat::csv), value("json", LineFormat::json),
                     value("nmea", LineFormat::nmea));
}
enum class FirstLine { discard, keep };
constexpr auto describe(type_tag<FirstLine>) {
  return enumeration("first_line", value("discard", FirstLine::discard), value("keep", FirstLine::keep));
}

struct SerialConfig {
  std::string device = {};  ///< "/dev/serial/by-id/...", "/dev/ttyUSB0"
  SerialSettings serial = {};
  LineFormat format = LineFormat::csv;
  std::vector<LineField> fields = {};
  char separator = ',';       ///< between the columns of CSV; a blank stands for any number of blanks
  std::string comment = "#";  ///< lines that begin with it are skipped; empty: none
  unsigned skip_lines = 0;    ///< lines skipped after each opening, such as a heading
  FirstLine first_line = FirstLine::discard;
  std::size_t max_line = 4096;                            ///< bytes; a longer line is unreadable
  std::string sequence_field = {};                        ///< the field that numbers the lines; empty: none
  Duration silence{0};                                    ///< silent for longer, it has a gap; 0: it may be silent
  Duration retry_first = std::chrono::milliseconds{100};  ///< wait before a lost device is opened again
  Duration retry_longest = std::chrono::seconds{10};      ///< the wait doubles up to this
  bool required = false;                                  ///< a device that cannot be opened at the start throws
  bool start = true;                                      ///< start when made

  friend constexpr auto parameters(type_tag<SerialConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("device", &SerialConfig::device, "the serial device", rtdata::required, TextIs::device),
        include_member(&SerialConfig::serial), parameter("format", &SerialConfig::format, "how a line is written"),
        parameter("fields", &SerialConfig::fields, "what is in a line; not with `format` nmea",
                  only_with("format", "csv", "json")),
        parameter("separator", &SerialConfig::separator, "between the columns of CSV", only_with("format", "csv")),
        parameter("comment", &SerialConfig::comment, "lines that begin with it are skipped",
                  only_with("format", "csv", "json")),
        parameter("skip_lines", &SerialConfig::skip_lines, "lines skipped after each opening, such as a heading",
                  range(0, 1000000)),
        parameter("first_line", &SerialConfig::first_line,
                  "what comes first after opening may be half a line: discard or keep it"),
        parameter("max_line", &SerialConfig::max_line, "a longer line is unreadable", rtdata::unit("By"),
                  range(16, 65536)),
        parameter("sequence_field", &SerialConfig::sequence_field, "the field by which the device numbers its lines",
                  TextIs::field, only_with("format", "csv", "json")),
        parameter("silence", &SerialConfig::silence, "silent for longer, it is degraded and has a gap; 0: never",
                  range(Duration{0}, Duration{24h})),
        parameter("retry_first", &SerialConfig::retry_first, "wait before a lost device is opened again",
                  range(Duration{1ms}, Duration{1h})),
        parameter("retry_longest", &SerialConfig::retry_longest, "the wait doubles up to this",
                  range(Duration{1ms}, Duration{24h})),
        parameter("required", &SerialConfig::required, "a device that cannot be opened at the start ends the program"),
        parameter("start", &SerialConfig::start, "start it with the system"));
  }
};

/// The description of what such a line publishes: by its fields, or that of a fix. Errors: as `line_description`.
Result<std::shared_ptr<const Description>> serial_description(const SerialConfig& config);
/// The description ("line") of the events that lines with these fields make. Errors: bad-description, bad-argument.
Result<std::shared_ptr<const Description>> line_description(const std::vector<LineField>& fields);

/// What no parameter says by itself: that `fields` and `sequence_field` go together, and that `separator` and `comment`
/// are none of what columns hold.
void check_config(const SerialConfig& config, const ConfigItem& item, Problems& problems);
/// How long the longest read takes: 1 KiB of short lines.
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
