/// SerialLineSensor: a device that sends lines of text over a serial line, CSV or JSON: the usual Arduino or Teensy.
///
///     rtdata::SerialLineSensor imu(loop, {.name = "imu", .topic = "board/imu"},
///                                  {.device = "/dev/ttyACM0", .serial = {.baud_rate = 115200},
///                                   .fields = {{.name = "ax", .unit = "m/s2"}, {.name = "count", .type = Kind::u32}},
///                                   .sequence_field = "count"});
///
/// Each line becomes one event with the configured fields; its time is the time of the read that completed the line.
///
/// - CSV as in RFC 4180, one row a line: one column for each field, in order; a field without a name skips its column.
///   Blanks and double quotes around a column are removed; within quotes a separator belongs to the column and a quote
///   is written twice. JSON: one object a line, keys in any order, other keys ignored; "imu.ax" as a field's `key`
///   selects from nested objects.
/// - An empty column (JSON: null, or no such key) makes an `optional` field absent and a text empty; for other fields
///   it is an error. Numbers are rounded to the nearest representable one: 1e-400 is 0. A bool is true, false, 1 or 0,
///   in upper or lower case. A byte order mark at the beginning is ignored.
/// - Text around a number is taken off by a field's `prefix`, `suffix`, `decimal`, `thousands`, `base` and
///   `sign_blanks`; `no_value` and `words` name texts that stand for no value, and for numbers. In JSON, such a field
///   may be a text.
/// - A line ends with a newline; a carriage return before it is ignored. The sensor skips empty lines, lines that begin
///   with `comment`, and the first `skip_lines` lines after opening.
/// - The bytes up to the first newline after opening may be half a line: they are discarded and counted
///   (`SensorCounts::first_lines`), unless `first_line` is `keep` or no byte came for 100 ms after opening.
/// - An unusable line (a missing column, not a number, out of its type's range, longer than `max_line`) is counted as
///   unreadable and reported; other lines are not affected.
/// - `sequence_field` names an integer with which the device numbers its lines: a jump counts as lost, minus the
///   unusable lines in between; an equal number counts as repeated and is not published. A number that goes back is a
///   restart of the device, unless the field's type wraps around. A line whose number makes a jump is held until the
///   next one, for `silence` or a second at most: when that takes the jump back, as after a wrong digit, the line is
///   unreadable; else both are published with their own times.
/// - If the device disappears, the sensor is faulted and opens it again after `retry_first`, doubling to
///   `retry_longest`, by its path: /dev/serial/by-id/... finds it on any port. The same at the start, unless it is
///   `required`. The time without the device is a gap (disconnected).
/// - Without a line for longer than `silence` the sensor is degraded until a good line comes, with a gap (silent).
/// - Without a line end for max(4 KiB, `max_line`), for example at the wrong speed, the sensor is degraded, and this
///   counts as one unreadable line.
/// - The serial line is locked for this program.
///
/// `format` nmea: a satellite receiver (GPS or others) without gpsd, which sends NMEA 0183 sentences. `fields` is not
/// used: events are `GpsFix` (gps.hpp), as of GpsSensor.
///
///     rtdata::SerialLineSensor gps(loop, {.name = "gps"}, {.device = "/dev/ttyACM0", .format = LineFormat::nmea});
///
/// - The sentences of one instant become one event: GGA, RMC, VTG and GSA; the number of visible satellites is that of
///   the GSV sentences before. It is published with the last of them, which is learned from the instant before, or when
///   the first of the next instant comes; its time is that of the read which brought the last. Sentences without a time
///   (VTG, GSA) belong to the last with one; RMC's velocity is used before VTG's.
/// - A value that a sentence does not give is absent, never 0; without a fix (GGA 0, RMC V) there is no position and no
///   velocity.
/// - A sentence with a wrong or missing checksum, or with unreadable content, is counted as unreadable; its values are
///   absent. `received` counts fixes and unreadable sentences; sentences of other kinds are not counted.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include "rtdata/io/serial.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata {

/// One field of a line.
struct LineField {
  std::string name = {};       ///< of the payload's field; empty (CSV only): skip the column
  Kind type = Kind::f64;       ///< any but enumeration and record
  std::string unit = {};       ///< UCUM
  double scale = 1;            ///< a float or double is multiplied by it
  std::string key = {};        ///< JSON: where it is in the object, levels separated by dots; empty: as the name
  std::size_t length = 32;     ///< of a text: the most bytes it may have
  bool optional = false;       ///< an empty column, null or a missing key makes the field absent; otherwise an error
  std::string prefix = {};     ///< what a value begins with, such as "T="; without it the line is unreadable
  std::string suffix = {};     ///< what it ends with, such as " kg"
  char decimal = '.';          ///< the decimal mark: a point or a comma
  std::string thousands = {};  ///< one character that may stand between digits; empty: none
  unsigned base = 10;          ///< of whole numbers, 2 to 16: 16 reads "0x1f" and "1F"
  bool sign_blanks = false;    ///< blanks may stand between sign and digits: "-  12.5"
  std::vector<std::string> no_value = {};    ///< texts or numbers that stand for no value; makes the field optional
  std::map<std::string, double> words = {};  ///< words that stand for numbers, which are not scaled

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
        parameter("optional", &LineField::optional, "an empty column, null or a missing key is no value"),
        parameter("prefix", &LineField::prefix, "what the value begins with, such as \"T=\""),
        parameter("suffix", &LineField::suffix, "what the value ends with, such as \" kg\""),
        parameter("decimal", &LineField::decimal, "the decimal mark: a point or a comma"),
        parameter("thousands", &LineField::thousands, "a character that may stand between the digits of a number"),
        parameter("base", &LineField::base, "of whole numbers: 16 for \"1F\" and \"0x1f\"", range(2, 16)),
        parameter("sign_blanks", &LineField::sign_blanks, "blanks may stand between sign and digits"),
        parameter(
            "no_value", &LineField::no_value,
            "texts, also of numbers, that stand for no value, such as [\"-9999\", \"OL\"]; the field is optional"),
        parameter("words", &LineField::words, "numbers for words: {\"ON\": 1, \"OFF\": 0}; they are not scaled"));
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
  Duration silence{0};                                    ///< without a line for longer, it has a gap; 0: no limit
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

/// The description of the events: from the fields, or of a fix. Errors: as `line_description`.
Result<std::shared_ptr<const Description>> serial_description(const SerialConfig& config);
/// The description ("line") of the events that lines with these fields make. Errors: bad-description, bad-argument.
Result<std::shared_ptr<const Description>> line_description(const std::vector<LineField>& fields);

/// Checks that `fields` and `sequence_field` go together, and that `separator` and `comment`
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
