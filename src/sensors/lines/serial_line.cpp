#include "rtdata/sensors/serial_line.hpp"

#include <unistd.h>

#include <array>
#include <cerrno>
#include <string>
#include <utility>
#include <vector>

#include "io/tty.hpp"
#include "sensors/lines/line_config.hpp"
#include "sensors/lines/line_node.hpp"
#include "sensors/lines/serial_source.hpp"

namespace rtdata {
namespace detail {

class SerialLineNode final : public LineNode, private SerialSource::User {
 public:
  SerialLineNode(LoopCore& loop, const FeedConfig& feed, SerialConfig config)
      : LineNode(loop, feed, std::move(config.lines), std::move(config.device),
                 config.lines.frame ? "check `baud_rate`, `frame` and what the device sends"
                                    : "check `baud_rate`, and that the device ends its lines"),
        settings_(config.serial),
        at_open_(texts_at_open(config.at_open, config.at_open_hex)),
        is_required_(config.required) {}

  void start() override {
    if (!is_open() || is_running()) return;
    Result<int> fd = open();
    if (!fd && is_required_) throw SetupError(std::move(fd).error());
    begin_lines();
    const bool is_within_line = fd && !source_->has_users() && drop_waiting(*fd);
    take(std::move(fd));
    if (is_within_line && has_source()) expect_rest_of_line();
  }

 private:
  Result<int> open() {
    auto source = SerialSource::open(*loop(), place(), settings_);
    if (!source) return source.error();
    source_ = *std::move(source);
    for (const std::string& text : at_open_) {
      if (::write(source_->fd(), text.data(), text.size()) == static_cast<ssize_t>(text.size())) continue;
      const int number = errno;
      source_ = nullptr;
      return system_error(number, "cannot send `at_open`", place(), "check that the device accepts data");
    }
    return source_->fd();
  }
  void open_stream() override { take(open()); }
  void watch_source(int) override { source_->add(*this); }
  void take_bytes(std::string_view bytes, int error_number) override { take_bytes_read(bytes, error_number); }
  void close_source(int) noexcept override {
    source_->remove(*this);
    source_ = nullptr;
  }
  void source_ended(int error_number) override {
    constexpr const char* what = "lost the serial line";
    constexpr const char* advice = "check the plug and the cable; it is opened again when it is back";
    if (error_number == 0 || error_number == EIO || error_number == EAGAIN)
      return lose({Errc::disconnected, what, place(), "the device has disappeared", advice}, loop()->now());
    lose(system_error(error_number, what, place(), advice), loop()->now());
  }

  /// Drops old input from before the start, which exists only if another program had the line open; its age is unknown.
  /// True: the dropped input does not end with a line end.
  bool drop_waiting(int fd) {
    std::array<char, 1024> bytes;
    std::size_t dropped = 0;
    bool is_within_line = false;
    constexpr int most_reads = 256;  // a device that sends all the time must not block the loop
    for (int i = 0; i < most_reads; ++i) {
      const ssize_t got = ::read(fd, bytes.data(), bytes.size());
      if (got <= 0) break;  // an error will appear again
      dropped += static_cast<std::size_t>(got);
      const char last = bytes[static_cast<std::size_t>(got) - 1];
      is_within_line = last != config().line_end && last != '\n' && last != '\r';
    }
    if (dropped > 0)
      loop()->runtime.log(LogLevel::info, object_name(),
                          std::to_string(dropped) + " bytes that were waiting when the sensor started are skipped");
    return is_within_line;
  }

  const SerialSettings settings_;
  const std::vector<std::string> at_open_;
  const bool is_required_;
  std::shared_ptr<SerialSource> source_;
};

}  // namespace detail

void check_config(const SerialConfig& config, const ConfigItem& item, Problems& problems) {
  check_config(config.serial, item, problems);
  detail::check_at_open(config.at_open_hex, item, problems);
  check_config(config.lines, item, problems);
}

ReadTime read_time(const SerialConfig& config) { return read_time(config.lines); }

SerialLineSensor::SerialLineSensor(Loop& loop, FeedConfig feed, SerialConfig config) {
  const auto refuse = [&](const char* why, const char* advice) {
    throw SetupError({Errc::bad_argument, "cannot use this serial line", "sensor " + feed.name, why, advice});
  };
  if (config.device.empty())
    refuse("it has no device", "set `device`, such as /dev/ttyUSB0; `ls /dev/serial/by-id` lists them");
  detail::check_source(config.lines, feed.name);
  if (const auto flags = detail::control_flags(config.serial); !flags) throw SetupError(flags.error());
  const bool starts = config.lines.start;
  auto* node = new detail::SerialLineNode(loop.core(), feed, std::move(config));
  SerialLineSensor made(node);
  if (starts) node->start();
  *this = std::move(made);
}

}  // namespace rtdata
