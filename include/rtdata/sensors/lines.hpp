/// LineConfig: what devices that send lines of text have in common, whatever the lines come through (serial_line.hpp).
/// Query (query.hpp) and MqttSensor (mqtt.hpp) decode with the same fields.
///
/// Each line becomes one event with the configured fields; its time is the time of the read that completed the line.
///
/// - CSV as in RFC 4180, one row a line: one column for each field, in order; a field without a name skips its column.
///   Blanks and double quotes around a column are removed; within quotes a separator belongs to the column and a quote
///   is written twice. JSON: one object or array a line, keys in any order, other keys ignored; "imu.ax" as a field's
///   `key` selects from nested objects, "emeters.0.power" from arrays, "values[type=P1].value" from the first object of
///   an array whose member `type` is P1. A number may be in quotes.
/// - An empty column (JSON: null, or no such key) makes an `optional` field absent and a text empty; for other fields
///   it is an error. Numbers are rounded to the nearest representable one: 1e-400 is 0. A bool is true, false, 1 or 0,
///   in upper or lower case. A byte order mark at the beginning is ignored.
/// - Text around a number is removed by a field's `prefix`, `suffix`, `decimal`, `thousands`, `base` and `sign_blanks`;
///   `no_value` and `words` name texts that mean no value, or a number. In JSON, such a field may be a text.
/// - `only` chooses lines by a column, a key or their text, frames by bytes at a place: others count as filtered,
///   unless their checksum is wrong. Lines that match `unreadable_if`, and those with a wrong `checksum`, are
///   unreadable.
/// - A line ends with a newline, or with `line_end`; a carriage return before it is ignored. The sensor skips empty
///   lines, lines that begin with `comment`, and the first `skip_lines` lines after opening.
/// - The bytes up to the first newline after opening may be an incomplete line: they are discarded and counted
///   (`SensorCounts::first_lines`), unless `first_line` is `keep` or no byte came for 100 ms after opening.
/// - An unusable line (a missing column, not a number, out of its type's range, longer than `max_line`) is counted as
///   unreadable and reported; other lines are not affected.
/// - `sequence_field` names an integer with which the device numbers its lines: a jump counts as lost, minus the
///   unusable lines in between; an equal number counts as repeated and is not published. A number that goes back is a
///   restart of the device, unless the field's type wraps around. A line whose number makes a jump is held until the
///   next one, for `silence` or a second at most: if that one continues the old sequence, as after a wrong digit, the
///   line is unreadable; otherwise both are published with their own times.
/// - `format` pattern: `pattern` is a regular expression of Perl's kind (PCRE2), searched for in the line; each of its
///   named groups is the text of the field with this name, or `key`: "T:(?<temp>[-0-9.]+)C". A group that takes part in
///   no match is an empty column. The line is unreadable without a match, or if the search takes more than 20 000 steps
///   plus 8 for each byte. `only` and `unreadable_if` may have a `pattern` as well.
/// - `device_time` names the field that is the device's clock. The time of an event is then the device's, shifted by
///   the shortest delay of a line between device and read so far, and never later than the read. A clock that wraps
///   around continues; a clock that goes back, or suddenly differs (a second ahead, a minute behind), has restarted.
/// - With `frame`, events are frames of bytes instead of lines, of CSV or JSON, of rows with labels (`format` labels: a
///   field's `key` is the label, `column` counts what follows), or of binary fields by their place (`format` binary:
///   `at`, `wire`, `bytes`, `bit`, `mask`, `bcd`). With `stuffing`, frames are unescaped before they are decoded. A
///   `pattern` may be of bytes, too ("\\x07\\x01(?<energy>.{8})"): the group of a field that has a `wire` is bytes.
///   Bytes outside of frames are unreadable, once for each stretch of them. After an unusable frame the next start is
///   searched inside it, up to 16 times.
/// - Without a byte for longer than `silence` the sensor is degraded until a good line comes, with a gap (silent).
/// - Without a line end for max(4 KiB, `max_line`), for example at the wrong speed, the sensor is degraded, and this
///   counts as one unreadable line.
///
/// `format` nmea: a satellite receiver (GPS or others) without gpsd, which sends NMEA 0183 sentences. `fields` is not
/// used: events are `GpsFix` (gps.hpp), as of GpsSensor.
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
/// Values.
#pragma once

#include <cstddef>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/data/error.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata {

/// One field of a line.
struct LineField {
  std::string name = {};       ///< of the payload's field; empty (CSV only): skip the column
  Kind type = Kind::f64;       ///< any but enumeration and record
  std::string unit = {};       ///< UCUM
  double scale = 1;            ///< a float or double is multiplied by it
  std::string key = {};        ///< JSON: path of the value, with dots between levels; empty: the name
  std::size_t length = 32;     ///< of a text: the most bytes that it may have
  bool optional = false;       ///< an empty column, null or a missing key makes the field absent; otherwise an error
  std::string prefix = {};     ///< text before the value, such as "T="; without it the line is unreadable
  std::string suffix = {};     ///< text after the value, such as " kg"
  char decimal = '.';          ///< the decimal mark: a point or a comma
  std::string thousands = {};  ///< one character that is allowed between digits; empty: none
  unsigned base = 10;          ///< of whole numbers, 2 to 16: 16 reads "0x1f" and "1F", and as int16 "FFFF" as -1
  bool sign_blanks = false;    ///< blanks are allowed between sign and digits: "-  12.5"
  std::size_t column = 1;      ///< labels: number of the column after the label
  std::optional<std::size_t> at = {};      ///< binary: position of the first byte in the frame, from 0
  std::optional<Kind> wire = {};           ///< binary: the type in the frame; pattern: of the raw bytes; empty: `type`
  std::size_t bytes = 0;                   ///< binary: number of bytes of a whole number; 0: as many as `wire` has
  std::optional<unsigned> bit = {};        ///< binary: the value is this bit, 0 is the lowest
  std::optional<std::uint64_t> mask = {};  ///< binary: the value is these bits, moved down to bit 0
  bool bcd = false;                        ///< binary: each byte is two decimal digits
  std::vector<std::string> no_value = {};  ///< texts or numbers that mean no value; makes the field optional
  std::map<std::string, double> words = {};  ///< words that mean numbers, which are not scaled

  friend constexpr auto parameters(type_tag<LineField>) {
    return parameter_list(
        parameter("name", &LineField::name, "name of the field; without a name the column is skipped", TextIs::field),
        parameter("type", &LineField::type, "type of the value",
                  choices(value("bool", Kind::boolean), value("char", Kind::character), value("int8", Kind::i8),
                          value("int16", Kind::i16), value("int32", Kind::i32), value("int64", Kind::i64),
                          value("uint8", Kind::u8), value("uint16", Kind::u16), value("uint32", Kind::u32),
                          value("uint64", Kind::u64), value("float", Kind::f32), value("double", Kind::f64),
                          value("text", Kind::text))),
        parameter("unit", &LineField::unit, "unit of the value (UCUM)", TextIs::unit),
        parameter("scale", &LineField::scale, "factor, for float and double", not_zero,
                  only_with("type", "float", "double")),
        parameter("key", &LineField::key,
                  "JSON: path of the value, with dots between levels; labels: the label; empty: the name"),
        parameter("column", &LineField::column, "labels: number of the column after the label", range(1, 64)),
        parameter("at", &LineField::at, "binary: position of the first byte in the frame, from 0", range(0, 65535)),
        parameter("wire", &LineField::wire,
                  "binary: the type in the frame, if it differs from `type`; pattern: the group contains raw bytes of "
                  "this type",
                  choices(value("int8", Kind::i8), value("int16", Kind::i16), value("int32", Kind::i32),
                          value("int64", Kind::i64), value("uint8", Kind::u8), value("uint16", Kind::u16),
                          value("uint32", Kind::u32), value("uint64", Kind::u64), value("float", Kind::f32),
                          value("double", Kind::f64))),
        parameter("bytes", &LineField::bytes,
                  "binary: number of bytes of a whole number, such as 3; 0: as many as its type has", range(0, 8)),
        parameter("bit", &LineField::bit, "binary: the value is this bit of the bytes; 0 is the lowest", range(0, 63)),
        parameter("mask", &LineField::mask,
                  "binary: the value is these bits of the bytes, moved down to bit 0; default: all"),
        parameter("bcd", &LineField::bcd, "binary: each byte is two decimal digits"),
        parameter("length", &LineField::length, "longest text, in bytes", range(1, 255), only_with("type", "text")),
        parameter("optional", &LineField::optional, "true: an empty column, null or a missing key means no value"),
        parameter("prefix", &LineField::prefix, "what the value begins with, such as \"T=\""),
        parameter("suffix", &LineField::suffix, "what the value ends with, such as \" kg\""),
        parameter("decimal", &LineField::decimal, "the decimal mark: a point or a comma"),
        parameter("thousands", &LineField::thousands, "character that is allowed between groups of digits of a number"),
        parameter("base", &LineField::base, "base of whole numbers: 16 for \"1F\" and \"0x1f\"", range(2, 16)),
        parameter("sign_blanks", &LineField::sign_blanks, "true: blanks are allowed between sign and digits"),
        parameter("no_value", &LineField::no_value,
                  "texts, also numbers, that mean no value, such as [\"-9999\", \"OL\"]; the field is optional"),
        parameter("words", &LineField::words, "numbers for words: {\"ON\": 1, \"OFF\": 0}; they are not scaled"));
  }
};

enum class LineFormat { csv, json, nmea, labels, binary, pattern };
constexpr auto describe(type_tag<LineFormat>) {
  return enumeration("format", value("csv", LineFormat::csv), value("json", LineFormat::json),
                     value("nmea", LineFormat::nmea), value("labels", LineFormat::labels),
                     value("binary", LineFormat::binary), value("pattern", LineFormat::pattern));
}
enum class FirstLine { discard, keep };
constexpr auto describe(type_tag<FirstLine>) {
  return enumeration("first_line", value("discard", FirstLine::discard), value("keep", FirstLine::keep));
}

/// How the byte that ends a frame is kept out of it: SLIP (RFC 1055), HDLC (RFC 1662, also SHDLC of Sensirion),
/// Consistent Overhead Byte Stuffing (Cheshire and Baker 1999).
enum class Stuffing { none, slip, hdlc, cobs };
constexpr auto describe(type_tag<Stuffing>) {
  return enumeration("stuffing", value("none", Stuffing::none), value("slip", Stuffing::slip),
                     value("hdlc", Stuffing::hdlc), value("cobs", Stuffing::cobs));
}

enum class WireOrder { little, big };
constexpr auto describe(type_tag<WireOrder>) {
  return enumeration("byte_order", value("little", WireOrder::little), value("big", WireOrder::big));
}

/// Chooses lines by their content.
struct LineMatch {
  unsigned column = 0;                   ///< CSV: number of the column, from 1; 0: the whole line
  std::string key = {};                  ///< JSON: path of the value; labels: the first column after this label
  std::vector<std::string> is = {};      ///< the whole text is one of these
  std::string begins = {};               ///< the text begins with this
  std::string contains = {};             ///< the text contains this
  std::string pattern = {};              ///< this regular expression (PCRE2) matches in the text
  std::size_t at = 0;                    ///< binary: position of the first byte to compare, from 0
  std::vector<std::string> is_hex = {};  ///< binary: the bytes there are one of these

  friend constexpr auto parameters(type_tag<LineMatch>) {
    return parameter_list(
        parameter("column", &LineMatch::column, "CSV: number of the column to compare, from 1; 0: the whole line",
                  range(0, 1000)),
        parameter("key", &LineMatch::key, "JSON: path of the value to compare; labels: the label"),
        parameter("is", &LineMatch::is, "the text is one of these"),
        parameter("begins", &LineMatch::begins, "the text begins with this"),
        parameter("contains", &LineMatch::contains, "the text contains this"),
        parameter("pattern", &LineMatch::pattern, "this regular expression matches in the text"),
        parameter("at", &LineMatch::at, "binary: position of the first byte to compare, from 0", range(0, 65535)),
        parameter("is_hex", &LineMatch::is_hex, "binary: the bytes there are one of these, such as [\"01 07\"]"));
  }
};

/// The names of CRCs are those of Greg Cook's catalogue; `sum6` is that of Teleinfo (EDF, Enedis-NOI-CPT_02E): the sum
/// of the bytes, its lowest 6 bits, plus 0x20. `lrc`: with it all bytes make 0 (the two's complement of their sum).
enum class ChecksumType {
  xor8,
  sum8,
  sum16,
  sum6,
  lrc,
  crc8,
  crc8_maxim,
  crc8_nrsc5,   ///< 0x31, begun with 0xff: that of Sensirion
  crc8_dvb_s2,  ///< 0xd5: that of CRSF
  crc8_4d,      ///< 0x4d, begun with 0: that of the lidars LD06 and LD19
  crc16_arc,
  crc16_modbus,
  crc16_ccitt,  ///< CRC-16/IBM-3740: 0x1021, begun with 0xffff
  crc16_xmodem,
  crc16_x25,      ///< CRC-16/IBM-SDLC: that of SML
  crc16_mcrf4xx,  ///< that of MAVLink
  fletcher16,     ///< two sums of 8 bits, the plain one first in `big`: that of UBX
  crc32
};
constexpr auto describe(type_tag<ChecksumType>) {
  return enumeration("checksum", value("xor8", ChecksumType::xor8), value("sum8", ChecksumType::sum8),
                     value("sum16", ChecksumType::sum16), value("sum6", ChecksumType::sum6),
                     value("lrc", ChecksumType::lrc), value("crc8", ChecksumType::crc8),
                     value("crc8_maxim", ChecksumType::crc8_maxim), value("crc8_nrsc5", ChecksumType::crc8_nrsc5),
                     value("crc8_dvb_s2", ChecksumType::crc8_dvb_s2), value("crc8_4d", ChecksumType::crc8_4d),
                     value("crc16_arc", ChecksumType::crc16_arc), value("crc16_modbus", ChecksumType::crc16_modbus),
                     value("crc16_ccitt", ChecksumType::crc16_ccitt), value("crc16_xmodem", ChecksumType::crc16_xmodem),
                     value("crc16_x25", ChecksumType::crc16_x25), value("crc16_mcrf4xx", ChecksumType::crc16_mcrf4xx),
                     value("fletcher16", ChecksumType::fletcher16), value("crc32", ChecksumType::crc32));
}
enum class ChecksumForm { hex, big, little, character };
constexpr auto describe(type_tag<ChecksumForm>) {
  return enumeration("form", value("hex", ChecksumForm::hex), value("big", ChecksumForm::big),
                     value("little", ChecksumForm::little), value("character", ChecksumForm::character));
}
enum class Complement { none, ones, twos };
constexpr auto describe(type_tag<Complement>) {
  return enumeration("complement", value("none", Complement::none), value("ones", Complement::ones),
                     value("twos", Complement::twos));
}
enum class ChecksumOf { all, row };
constexpr auto describe(type_tag<ChecksumOf>) {
  return enumeration("of", value("all", ChecksumOf::all), value("row", ChecksumOf::row));
}

/// The checksum of a line or a frame. It is at the end, or after the last `after`.
struct LineChecksum {
  ChecksumType type = ChecksumType::xor8;
  ChecksumForm form = ChecksumForm::hex;     ///< hexadecimal digits; bytes, the high one first or last; a character
  std::string after = {};                    ///< text before the checksum, such as "*"; empty: none
  bool covers_after = false;                 ///< it also covers `after`
  std::size_t from = 0;                      ///< number of bytes at the beginning that it does not cover
  std::size_t before = 0;                    ///< number of bytes before it (and `after`) that it does not cover
  std::size_t behind = 0;                    ///< number of bytes of the frame after it
  Complement complement = Complement::none;  ///< sum8, sum16: all bits inverted (ones), or the negative (twos)
  std::string append_hex = {};               ///< bytes that it also covers, after the others, and that are not sent
  bool optional = false;                     ///< a line without `after` has no checksum
  ChecksumOf of = ChecksumOf::all;           ///< labels: each row has a checksum

  friend constexpr auto parameters(type_tag<LineChecksum>) {
    return parameter_list(
        parameter("type", &LineChecksum::type, "how the checksum is computed", rtdata::required),
        parameter("form", &LineChecksum::form,
                  "how the checksum is written: as hexadecimal digits, as bytes with the high one first (big) or last "
                  "(little), or as one character"),
        parameter("after", &LineChecksum::after, "text before the checksum, such as \"*\""),
        parameter("covers_after", &LineChecksum::covers_after, "true: the checksum also covers `after`"),
        parameter("from", &LineChecksum::from, "number of bytes at the beginning that the checksum does not cover",
                  range(0, 65535)),
        parameter("before", &LineChecksum::before, "number of bytes before the checksum that it does not cover",
                  range(0, 65535)),
        parameter("behind", &LineChecksum::behind, "number of bytes of the frame after the checksum", range(0, 64)),
        parameter("complement", &LineChecksum::complement,
                  "sum8, sum16: the sum with all bits inverted (ones), or its negative (twos)"),
        parameter("append_hex", &LineChecksum::append_hex,
                  "bytes that the checksum also covers, although they are not sent, such as MAVLink's extra byte"),
        parameter("optional", &LineChecksum::optional, "true: a line without `after` has no checksum"),
        parameter("of", &LineChecksum::of, "what the checksum protects: the whole line, or each row of labels"));
  }
};

/// How frames are found in a stream of bytes that are not lines. A frame has a start or an end, or both, or a start and
/// a length. Bytes between frames are discarded and, except line ends, counted as unreadable.
struct LineFrame {
  std::string start = {}, start_hex = {};  ///< text or bytes that it begins with
  std::string end = {}, end_hex = {};      ///< and ends with
  std::size_t after_end = 0;               ///< number of bytes after `end` that belong to it, such as a checksum
  std::size_t length = 0;                  ///< length of the whole frame in bytes; 0: not always the same
  std::size_t length_at = 0;               ///< position of the length in the frame; 0: it has none
  std::size_t length_bytes = 1;
  std::size_t length_adds = 0;         ///< number of its bytes that the length does not count
  Stuffing stuffing = Stuffing::none;  ///< if set, the settings above are not used
  WireOrder byte_order = WireOrder::big;

  friend constexpr auto parameters(type_tag<LineFrame>) {
    return parameter_list(
        parameter("start", &LineFrame::start, "what a frame begins with"),
        parameter("start_hex", &LineFrame::start_hex, "the start as bytes, such as \"42 4d\""),
        parameter("end", &LineFrame::end, "what a frame ends with"),
        parameter("end_hex", &LineFrame::end_hex, "the end as bytes"),
        parameter("after_end", &LineFrame::after_end, "number of bytes after `end` that belong to the frame",
                  range(0, 64)),
        parameter("length", &LineFrame::length, "length of the whole frame", rtdata::unit("By"), range(0, 65536)),
        parameter("length_at", &LineFrame::length_at,
                  "position of the length in the frame, from 0; 0: a frame does not contain its length", range(0, 64)),
        parameter("length_bytes", &LineFrame::length_bytes, "number of bytes of the length", range(1, 2)),
        parameter("length_adds", &LineFrame::length_adds, "number of bytes of the frame that the length does not count",
                  range(0, 64)),
        parameter("stuffing", &LineFrame::stuffing,
                  "instead of the settings above: SLIP (c0), HDLC (7e) or COBS (00) frames, which are unescaped"),
        parameter("byte_order", &LineFrame::byte_order, "byte order of the length and of binary fields"));
  }
};

/// The clock of a device: a field counts in steps of `step` and wraps around as its type does.
struct DeviceTime {
  std::string field = {};                        ///< an integer, or a double, which never wraps
  Duration step = std::chrono::milliseconds{1};  ///< time of one count

  friend constexpr auto parameters(type_tag<DeviceTime>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("field", &DeviceTime::field, "the field with the device's clock", TextIs::field, rtdata::required),
        parameter("step", &DeviceTime::step, "time of one count, such as \"1 us\"",
                  range(Duration{1ns}, Duration{1h})));
  }
};

struct LineConfig {
  LineFormat format = LineFormat::csv;
  std::vector<LineField> fields = {};
  char separator = ',';                 ///< between the columns of CSV; a blank stands for any number of blanks
  std::string pattern = {};             ///< of `format` pattern: a regular expression with a named group for each field
  std::string comment = "#";            ///< lines that begin with this text are skipped; empty: none
  char line_end = '\n';                 ///< what ends a line; without a newline some devices send a carriage return
  std::optional<LineFrame> frame = {};  ///< events are frames of bytes, not lines
  std::optional<LineMatch> only = {};   ///< which lines become events; others count as filtered
  std::optional<LineMatch> unreadable_if = {};  ///< lines that mean that the device has no value
  std::optional<LineChecksum> checksum = {};
  unsigned skip_lines = 0;  ///< lines skipped after each opening, such as a heading
  FirstLine first_line = FirstLine::discard;
  std::size_t max_line = 4096;                            ///< bytes; a longer line is unreadable
  std::string sequence_field = {};                        ///< the field that numbers the lines; empty: none
  std::optional<DeviceTime> device_time = {};             ///< events have the device's times; unset: those of the reads
  Duration silence{0};                                    ///< without a line for longer, it has a gap; 0: no limit
  Duration retry_first = std::chrono::milliseconds{100};  ///< first delay before a lost device is opened again
  Duration retry_longest = std::chrono::seconds{10};      ///< the delay doubles up to this
  bool start = true;                                      ///< start when made

  friend constexpr auto parameters(type_tag<LineConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("format", &LineConfig::format, "format of a line"),
        parameter("fields", &LineConfig::fields, "values in a line; not with `format` nmea",
                  only_with("format", "csv", "json", "labels", "binary", "pattern")),
        parameter("pattern", &LineConfig::pattern, "a regular expression with a named group for each field",
                  only_with("format", "pattern")),
        parameter("separator", &LineConfig::separator,
                  "character between the columns of CSV, or between label and value",
                  only_with("format", "csv", "labels")),
        parameter("comment", &LineConfig::comment, "lines that begin with this text are skipped",
                  only_with("format", "csv", "json", "labels", "binary", "pattern")),
        parameter("line_end", &LineConfig::line_end, "the character that ends a line"),
        parameter("frame", &LineConfig::frame, "how a frame begins and ends, if the device does not send lines"),
        parameter("only", &LineConfig::only, "which lines become events; others are skipped and count as filtered"),
        parameter("unreadable_if", &LineConfig::unreadable_if, "lines by which the device says that it has no value"),
        parameter("checksum", &LineConfig::checksum, "checksum of a line; a line with a wrong checksum is unreadable"),
        parameter("skip_lines", &LineConfig::skip_lines,
                  "number of lines that are skipped after each opening, such as a heading", range(0, 1000000)),
        parameter("first_line", &LineConfig::first_line,
                  "the first line after opening may be incomplete: discard or keep it"),
        parameter("max_line", &LineConfig::max_line, "a longer line is unreadable", rtdata::unit("By"),
                  range(16, 65536)),
        parameter("sequence_field", &LineConfig::sequence_field, "the field in which the device numbers its lines",
                  TextIs::field, only_with("format", "csv", "json", "labels", "binary", "pattern")),
        parameter("device_time", &LineConfig::device_time,
                  "the field with the device's clock, from which the times of events follow",
                  only_with("format", "csv", "json", "labels", "binary", "pattern")),
        parameter("silence", &LineConfig::silence,
                  "after this time without data, the sensor is degraded and has a gap; 0: never",
                  range(Duration{0}, Duration{24h})),
        parameter("retry_first", &LineConfig::retry_first, "first delay before a lost device is opened again",
                  range(Duration{1ms}, Duration{1h})),
        parameter("retry_longest", &LineConfig::retry_longest, "the delay doubles up to this",
                  range(Duration{1ms}, Duration{24h})),
        parameter("start", &LineConfig::start, "start it with the system"));
  }
};

/// The description ("line") of the events that lines with these fields make. Errors: bad-description, bad-argument.
Result<std::shared_ptr<const Description>> line_description(const std::vector<LineField>& fields);

/// The description of the events: from the fields, or of a fix. Errors: as `line_description`.
Result<std::shared_ptr<const Description>> description_of_lines(const LineConfig& config);

/// Checks that `fields` and `sequence_field` fit together, and that `separator` and `comment` cannot occur in columns.
void check_config(const LineConfig& config, const ConfigItem& item, Problems& problems);
/// How long the longest read takes: 1 KiB of short lines.
ReadTime read_time(const LineConfig& config);

}  // namespace rtdata
