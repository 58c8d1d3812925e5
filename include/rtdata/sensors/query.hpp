/// Query: a device that answers a text with a line of numbers: multimeters, scales, power supplies (SCPI and the like).
///
///     rtdata::SerialPort port({.device = "/dev/serial/by-id/usb-Meter-if00"});
///     rtdata::DriverSensor<rtdata::Query> meter(loop, {.name = "meter", .rate = 5_Hz}, port, {},
///         {.request = "MEAS:VOLT:DC?\n", .fields = {{.name = "voltage", .unit = "V"}}});
///
/// Each tick sends the request and decodes the answer as SerialLineSensor (serial_line.hpp) decodes lines: CSV (a
/// single number is a line of one column) or JSON. Bytes received before the request, such as a late answer, are
/// dropped. Several sensors may send different requests to one device, or to several devices on one line.
///
/// - No complete answer within the port's `answer_timeout` is a failure; an answer that cannot be decoded is
///   unreadable.
/// - With `frame` the answer is a frame of bytes (lines.hpp), such as binary fields at their places (`format` binary);
///   with only a `length`, this number of bytes.
/// - `at_open` is sent after each opening of the port, to set the device up. The answer of a text with a `?` in it,
///   such as "*OPC?\n", is awaited and discarded, so that it is not mistaken for the answer of the first reading; with
///   `at_open_answers`, the answer of each text.
/// - `prepare` is sent before each request, such as a command that starts a measurement; its answer is awaited and
///   discarded: a line, or for `prepare_hex` a frame if `frame` is set. Then the driver waits for `prepare_wait`.
/// - `skip_lines`: lines before each answer, for devices that echo what they are asked.
///
/// Driver (driver.hpp): used on the port's lane.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/io/serial.hpp"
#include "rtdata/sensors/driver.hpp"
#include "rtdata/sensors/lines.hpp"

namespace rtdata {

class Query {
 public:
  static constexpr std::string_view type = "query";
  static constexpr std::string_view
      aliases = "scpi instrument multimeter rs232 bms jbd battery gmc sdi-12 sdi12 shdlc obd elm327 m-bus mbus";
  static constexpr std::string_view
      description = "a device on a serial line that answers a request with a line of text";
  static constexpr std::string_view notes =
      "The bus is a `serial` one. `request` is sent unchanged: it must end with the line end of the device's commands, "
      "\"\\n\" or \"\\r\\n\". Binary requests are written as `request_hex`, such as \"02 4d 0d\". Answers are lines of "
      "CSV (a number alone is one column) or JSON, as for [serial](serial.md); a column without a name, such as a "
      "unit, is skipped.";
  struct Config {
    std::string request = {};                   ///< including its line end
    std::string request_hex = {};               ///< instead of `request`: bytes, as hexadecimal digits
    std::vector<std::string> at_open = {};      ///< sent after each opening of the port, in order
    std::vector<std::string> at_open_hex = {};  ///< bytes, sent after them
    bool at_open_answers = false;               ///< the device answers each of them, not only those with a `?`
    std::vector<std::string> prepare = {};      ///< sent before each request, in order; each is answered
    std::vector<std::string> prepare_hex = {};  ///< bytes, sent after them
    Duration prepare_wait{0};                   ///< wait after their answers, while the device measures
    char answer_end = '\n';                     ///< a carriage return before it is ignored
    unsigned skip_lines = 0;                    ///< before the answer
    LineFormat format = LineFormat::csv;
    std::vector<LineField> fields = {};
    char separator = ',';                 ///< between the columns of CSV; a blank stands for any number of blanks
    std::string pattern = {};             ///< of `format` pattern
    std::optional<LineFrame> frame = {};  ///< the answer is a frame of bytes, not a line
    std::optional<LineMatch> unreadable_if = {};  ///< answers that mean that the device has no value
    std::optional<LineChecksum> checksum = {};
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(
          parameter("request", &Config::request, "what is sent, including its end"),
          parameter("request_hex", &Config::request_hex, "instead of `request`: bytes, such as \"02 4d 0d\""),
          parameter("at_open", &Config::at_open, "what is sent after each opening of the port"),
          parameter("at_open_hex", &Config::at_open_hex, "bytes that are sent after `at_open`"),
          parameter("at_open_answers", &Config::at_open_answers,
                    "true: the device answers each command of `at_open`, not only queries (?); the answers are read "
                    "and discarded"),
          parameter("prepare", &Config::prepare,
                    "what is sent before each request, such as the start of a measurement; the device answers each"),
          parameter("prepare_hex", &Config::prepare_hex, "bytes that are sent after `prepare`"),
          parameter("prepare_wait", &Config::prepare_wait,
                    "how long to wait after the answers to `prepare`, while the device measures",
                    range(Duration{0}, Duration{std::chrono::minutes{10}})),
          parameter("answer_end", &Config::answer_end, "the character that ends an answer"),
          parameter("skip_lines", &Config::skip_lines, "number of lines before the answer, such as an echo",
                    range(0, 100)),
          parameter("format", &Config::format, "format of the answer",
                    choices(value("csv", LineFormat::csv), value("json", LineFormat::json),
                            value("labels", LineFormat::labels), value("binary", LineFormat::binary),
                            value("pattern", LineFormat::pattern))),
          parameter("fields", &Config::fields, "values in the answer", required),
          parameter("separator", &Config::separator, "character between the columns of CSV, or between label and value",
                    only_with("format", "csv", "labels")),
          parameter("pattern", &Config::pattern, "a regular expression with a named group for each field",
                    only_with("format", "pattern")),
          parameter("frame", &Config::frame, "how the answer begins and ends, if it is not a line"),
          parameter("unreadable_if", &Config::unreadable_if, "answers by which the device says that it has no value"),
          parameter("checksum", &Config::checksum,
                    "checksum of the answer; an answer with a wrong checksum is unreadable"));
    }
    /// Checks that there is one request, and that `fields` fit the other settings.
    friend void check_config(const Config& config, const ConfigItem& item, Problems& problems);
  };
  using Value = DescribedValue;
  using Device = SerialDevice;
  static constexpr ChipSample samples[] = {{.members = R"("request": "?\n", "fields": [{"name": "v"}])",
                                            .wires = ChipWires::answers,
                                            .bytes = {{{"3f 0a", "31 2e 35 0d 0a"}}},
                                            .values = {{{"v", 1.5}}},
                                            .has_proof = true}};
  static Result<std::shared_ptr<const Description>> describe(const Config& config) {
    return line_description(config.fields);
  }
  static constexpr std::size_t longest_answer = 4096;
  /// How long it holds the bus in addition to its transfers.
  static Duration bus_time(const Config& config) { return config.prepare_wait; }

  /// SetupError (bad-argument, bad-description): a configuration that cannot work.
  explicit Query(const Config& config);
  ~Query();
  Result<void> open(SerialDevice& line);
  Reading<DescribedValue> read(SerialDevice& line);

 private:
  struct Decoding;
  Result<void> open_if_lost(SerialDevice& line);
  Result<void> prepare(SerialDevice& line);
  enum class Answer { line, frame };
  Result<void> drop_answer(SerialDevice& line, Answer answer, const char* of);
  Result<std::string> ask_for_frame(SerialDevice& line);
  Result<std::string> next_frame(SerialDevice& line);
  Reading<DescribedValue> read_frame(SerialDevice& line);
  Reading<DescribedValue> read_line(SerialDevice& line);
  static Unreadable echoed(SerialDevice& line);
  Reading<DescribedValue> decoded(SerialDevice& line, std::string_view answer);
  const Config config_;
  const std::string request_;
  const std::vector<std::string> at_open_, prepare_;
  std::uint64_t losses_ = 0;  // of the port, when these were sent
  const std::unique_ptr<Decoding> decoding_;
};

}  // namespace rtdata
