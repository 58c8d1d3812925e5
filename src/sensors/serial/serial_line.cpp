#include "rtdata/sensors/serial_line.hpp"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstddef>
#include <cstring>
#include <optional>
#include <vector>

#include "data/utf8.hpp"
#include "io/tty.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"
#include "sensors/core/stream_node.hpp"
#include "sensors/serial/line_decoder.hpp"
#include "sensors/serial/nmea.hpp"

namespace rtdata {
namespace detail {
namespace {

// Read at once, and so per turn of the loop; the most lines that this can be stay below the capacity of a topic's ring.
constexpr std::size_t most_read = 1024;
// This many bytes without a line end mean that the device sends no lines at this speed.
constexpr std::size_t least_unended = 4096;
// A device that was silent for so long after the opening was not in the middle of a line.
constexpr Duration silence_before_a_line = std::chrono::milliseconds{100};

}  // namespace

class SerialLineNode final : public StreamNode {
 public:
  SerialLineNode(LoopCore& loop, const FeedConfig& feed, SerialConfig config, std::unique_ptr<LineDecoder> decoder)
      : StreamNode(loop, feed, decoder != nullptr ? described_type(decoder->description()) : payload_type<GpsFix>(),
                   {config.silence, config.retry_first, config.retry_longest}),
        config_(std::move(config)),
        decoder_(std::move(decoder)) {
    line_.reserve(config_.max_line + most_read);
    if (config_.first_line == FirstLine::discard) {
      quiet_ = Timer(loop.face, [this] {
        int waiting = 0;
        if (fd_ >= 0 && unended_ == 0 && ::ioctl(fd_, FIONREAD, &waiting) == 0 && waiting == 0) is_first_ = false;
      });
    }
    if (decoder_ != nullptr) {
      origin_.counts.lost_is_known = decoder_->has_sequence();
      if (decoder_->has_sequence()) {
        held_.size = decoder_->description()->size();
        held_.storage.resize(held_.size / sizeof(std::max_align_t) + 1);
        hold_ = Timer(loop.face, [this] { let_go(); });
      }
    } else {
      fixes_ = std::make_unique<NmeaFixes>(config_.device);
    }
  }

  void start() override {
    if (!is_open() || is_running()) return;
    Result<int> fd = open_tty(config_.device, config_.serial);
    if (!fd && config_.required) throw SetupError(std::move(fd).error());
    begin();
    if (decoder_ != nullptr) decoder_->forget_sequence();
    last_fix_.reset();
    unusable_lines_ = 0;
    const bool is_within_line = fd && drop_waiting(*fd);
    take(std::move(fd));
    if (is_within_line && fd_ >= 0) {  // however long it is silent, what comes first is the rest of that line
      quiet_.stop();
      is_first_ = true;
    }
  }
  void stop() override {
    if (is_open()) {
      let_go();
      finish_fix();
      report_unended();
    }
    StreamNode::stop();
  }
  void stop_schedule(MonotonicTime end) override {
    let_go();
    finish_fix();
    report_unended();
    StreamNode::stop_schedule(end);
  }
  std::optional<SensorLoad> load() const override {
    return SensorLoad{origin_.name, Duration{0}, {}, read_time(config_)};
  }

 private:
  void open_stream() override { take(open_tty(config_.device, config_.serial)); }
  void take(Result<int> fd) {
    if (fd) {
      use(*fd);
    } else {
      lose(fd.error(), loop()->now());
    }
  }
  void use(int fd) {
    fd_ = fd;
    if (fixes_ != nullptr) fixes_->reset();
    ++openings_;
    line_.clear();
    is_overlong_ = false;
    unended_ = 0;
    is_unended_reported_ = false;
    opened();
    is_first_ = config_.first_line == FirstLine::discard;
    if (is_first_) quiet_.start(silence_before_a_line);
    is_beginning_ = true;
    lines_to_skip_ = config_.skip_lines;
    watch_ = FdWatch(loop()->face, fd_, FdWatch::readable, object_name(),
                     [this](const FdEvent& event) { on_ready(event); });
  }
  /// Drops old input from before the start, which exists only if another program had the line open; its age is unknown.
  /// True: the dropped input does not end with a line end.
  bool drop_waiting(int fd) {
    std::array<char, most_read> bytes;
    std::size_t dropped = 0;
    bool is_within_line = false;
    constexpr int most_reads = 256;  // a device that sends all the time does not hold the loop
    for (int i = 0; i < most_reads; ++i) {
      const ssize_t got = ::read(fd, bytes.data(), bytes.size());
      if (got <= 0) break;  // an error shows again
      dropped += static_cast<std::size_t>(got);
      const char last = bytes[static_cast<std::size_t>(got) - 1];
      is_within_line = last != '\n' && last != '\r';
    }
    if (dropped > 0)
      loop()->runtime.log(LogLevel::info, object_name(),
                          std::to_string(dropped) + " bytes that had waited when the sensor was started are left out");
    return is_within_line;
  }
  void on_close() noexcept override {
    hold_.close();
    quiet_.close();
    if (std::exchange(held_.is_there, false)) {
      origin_.counts.lost += held_.lost;
      take_sample(held_.payload(), held_.time);
    }
    StreamNode::on_close();
  }
  void close_stream() noexcept override {
    watch_.close();  // before the descriptor
    if (fd_ >= 0) close_tty(fd_);
    fd_ = -1;
  }

  void on_ready(const FdEvent& event) {
    Call call(*this);
    const std::size_t before = line_.size();
    line_.resize(before + most_read);
    const ssize_t got = ::read(fd_, line_.data() + before, most_read);
    const int error_number = got < 0 ? errno : 0;
    line_.resize(before + static_cast<std::size_t>(std::max<ssize_t>(got, 0)));
    if (got > 0) {
      heard_bytes();
      time_ = loop()->runtime.event_time(heard_at());
      take_lines(before);
    } else if (got == 0 || (error_number != EAGAIN && error_number != EINTR) || event.hung_up) {
      const unsigned opening = openings_;
      let_go();
      finish_fix();
      if (fd_ < 0 || openings_ != opening) return;
      constexpr const char* what = "lost the serial line";
      constexpr const char* advice = "check the plug and the cable; it is opened again when it is back";
      lose(got == 0 || error_number == EIO || error_number == EAGAIN
               ? Error{Errc::disconnected, what, config_.device, "the device has disappeared", advice}
               : system_error(error_number, what, config_.device, advice),
           loop()->now());
    }
  }

  /// Takes the complete lines out of the buffer, whose bytes from `from` on are new.
  void take_lines(std::size_t from) {
    std::size_t begin = 0;
    const std::size_t last_end = line_.rfind('\n');  // those before `from` were taken
    if (last_end == std::string::npos) {
      unended_ += line_.size() - from;
    } else {
      unended_ = line_.size() - last_end - 1;
      is_unended_reported_ = false;
    }
    // A callback may stop the sensor, and start it again.
    const auto is_same = [this, opening = openings_] { return fd_ >= 0 && openings_ == opening; };
    while (is_same()) {
      const auto end = line_.find('\n', std::max(begin, from));
      if (end == std::string::npos) break;
      std::string_view line(line_.data() + begin, end - begin);
      begin = end + 1;
      if (std::exchange(is_beginning_, false) && line.starts_with(byte_order_mark))
        line.remove_prefix(byte_order_mark.size());
      if (std::exchange(is_first_, false)) {
        ++origin_.counts.first_lines;
        is_overlong_ = false;
      } else if (!std::exchange(is_overlong_, false)) {
        take_line(line);
      }
    }
    if (!is_same()) return;
    line_.erase(0, begin);
    if (line_.size() > config_.max_line) {
      line_.clear();
      if (!is_first_ && !std::exchange(is_overlong_, true)) {
        is_unended_reported_ = lines_to_skip_ == 0;
        fail_overlong();
        if (!is_same()) return;
      }
    }
    if (unended_ > std::max(config_.max_line, least_unended) && !std::exchange(is_unended_reported_, true)) {
      fail_unended();
    }
  }
  void fail_unended() {
    fail_line({Errc::bad_data, "no end of a line", config_.device, std::to_string(unended_) + " bytes came without one",
               "check `baud_rate`, and that the device ends its lines"});
  }
  /// Reports at the end that bytes came but never a usable line.
  void report_unended() {
    if (!is_running() || unended_ == 0 || !is_beginning_ || origin_.counts.received != 0) return;
    if (!std::exchange(is_unended_reported_, true)) fail_unended();
  }

  Error silence_error() const override {
    return {Errc::timed_out, "nothing comes", config_.device, "it has been silent for " + to_string(config_.silence),
            "check the device; `silence` sets how long it may be silent"};
  }

  void take_line(std::string_view line) {
    while (!line.empty() && line.back() == '\r') line.remove_suffix(1);  // some send two of them
    if (lines_to_skip_ != 0) {
      --lines_to_skip_;
      return;
    }
    if (line.size() > config_.max_line) return fail_overlong();
    if (fixes_ != nullptr) return take_sentence(line);
    if (decoder_->is_skipped(line)) return;
    const Result<void> decoded = decoder_->decode(line);
    if (!decoded) return fail_line(decoded.error());
    if (held_.is_there) {
      const unsigned opening = openings_;
      decoder_->takes_back() ? refuse_held() : let_go();
      if (fd_ < 0 || openings_ != opening) return;
    }
    const LineDecoder::NumberComparison step = decoder_->step();
    // Left-out numbers of lines that came but could not be used are not lost.
    const std::uint64_t unusable = std::exchange(unusable_lines_, 0);
    const std::uint64_t lost = step.lost - std::min(step.lost, unusable);
    if (lost != 0 || step.goes_back) return hold(lost, unusable);
    if (step.is_repeated) {
      ++origin_.counts.received;
      ++origin_.counts.repeated;
    } else if (!take_or_fail(decoder_->payload(), time_)) {
      return;
    }
    succeed();
  }

  /// A line whose number has made a jump is kept until the next one says whether that was a wrong digit.
  void hold(std::uint64_t lost, std::uint64_t unusable) {
    constexpr Duration most_held = std::chrono::seconds{1};
    held_.is_there = true;
    held_.lost = lost;
    held_.unusable = unusable;
    held_.time = time_;
    std::memcpy(held_.payload(), decoder_->payload(), held_.size);
    hold_.start(config_.silence > Duration{0} ? std::min(config_.silence, most_held) : most_held);
  }
  /// The jump stands: what is between is lost.
  void let_go() {
    if (!std::exchange(held_.is_there, false)) return;
    hold_.stop();
    if (!is_running()) return;
    Call call(*this);
    origin_.counts.lost += held_.lost;
    if (take_or_fail(held_.payload(), held_.time) && !is_silent()) succeed();
  }
  void refuse_held() {
    held_.is_there = false;
    hold_.stop();
    decoder_->drop_last();
    unusable_lines_ += held_.unusable;
    fail_line({Errc::bad_data, "cannot use a line", config_.device,
               "its number makes a jump that the next line takes back",
               "a digit was lost or changed on the way: check the wires, and which other device writes to the line"});
  }

  void take_sentence(std::string_view line) {
    // Tag blocks of a multiplexer, "\\s:station,c:1796040000*00\\", say where it came from.
    while (line.starts_with('\\')) {
      const std::size_t end = line.find('\\', 1);
      if (end == std::string_view::npos) break;
      line.remove_prefix(end + 1);
    }
    if (line.empty()) return;
    // Bytes before the sentence, such as a manufacturer's own data, are skipped.
    const std::size_t begin = line.rfind('$');
    const bool has_more = line.front() != '!' && begin != 0 && begin != std::string_view::npos;
    const unsigned opening = openings_;
    if (has_more) {
      fail_line({Errc::bad_data, "cannot use the bytes before a sentence", config_.device,
                 std::to_string(begin) + " bytes outside of an NMEA sentence", "let the receiver send NMEA only"});
      if (fd_ < 0 || openings_ != opening) return;
      line.remove_prefix(begin);
    }
    const Result<void> taken = fixes_->take(line, time_, publish_fix_);
    if (!taken) return fail_line(taken.error());
    if (!has_more) succeed();
  }
  void publish(GpsFix fix, Time time) {
    ++origin_.counts.received;
    // A receiver that says the same instant again has nothing new; without a time, each fix may be.
    const bool is_repeated = fix.gps_time && last_fix_ && is_same(*last_fix_, fix);
    last_fix_ = fix;
    if (is_repeated) {
      ++origin_.counts.repeated;
    } else {
      ++origin_.counts.published;
      origin_.topic.publish(origin_, time, &fix);
    }
  }
  static bool is_same(const GpsFix& a, const GpsFix& b) noexcept {
    return a.gps_time == b.gps_time && a.lat == b.lat && a.lon == b.lon && a.alt_msl == b.alt_msl &&
           a.speed == b.speed && a.track == b.track && a.mode == b.mode && a.satellites_used == b.satellites_used;
  }
  /// Publishes the last fix when no more sentences will come.
  void finish_fix() {
    if (fixes_ != nullptr && is_running()) fixes_->finish(publish_fix_);
  }

  void fail_overlong() {
    if (lines_to_skip_ != 0) {
      --lines_to_skip_;
      return;
    }
    fail_line({Errc::does_not_fit, "cannot use a line", config_.device,
               "it is longer than " + std::to_string(config_.max_line) + " bytes",
               "check `baud_rate`; `max_line` sets how long a line may be"});
  }

  void fail_line(const Error& error) {
    ++unusable_lines_;
    fail(error);
  }

  const SerialConfig config_;
  std::unique_ptr<LineDecoder> decoder_;  // null: NMEA
  std::unique_ptr<NmeaFixes> fixes_;
  const NmeaFixes::Publish publish_fix_ = [this](const GpsFix& fix, Time time) { publish(fix, time); };
  std::optional<GpsFix> last_fix_;
  struct Held {
    bool is_there = false;
    std::uint64_t lost = 0;
    std::uint64_t unusable = 0;  // lines before it
    Time time{};
    std::vector<std::max_align_t> storage = {};
    std::size_t size = 0;
    std::byte* payload() noexcept { return reinterpret_cast<std::byte*>(storage.data()); }
  };
  Held held_;
  Timer hold_;
  Timer quiet_;  // since the opening
  FdWatch watch_;
  int fd_ = -1;
  std::string line_;  // the bytes of the lines that are not complete, never more than max_line + most_read
  Time time_{};       // of the last read
  unsigned openings_ = 0;
  std::size_t unended_ = 0;           // bytes since the last end of a line
  bool is_unended_reported_ = false;  // that there are too many
  unsigned lines_to_skip_ = 0;
  std::uint64_t unusable_lines_ = 0;  // since the last good one
  bool is_first_ = true;              // nothing but the rest of a line may have come yet
  bool is_beginning_ = true;          // no line has come yet
  bool is_overlong_ = false;          // the rest of the line is thrown away
};

}  // namespace detail

Result<std::shared_ptr<const Description>> serial_description(const SerialConfig& config) {
  if (config.format == LineFormat::nmea) return description_of<GpsFix>();
  return line_description(config.fields);
}

void check_config(const SerialConfig& config, const ConfigItem& item, Problems& problems) {
  check_config(config.serial, item, problems);
  if (config.format == LineFormat::nmea) return;
  try {
    const detail::LineDecoder decoder(config);
  } catch (const SetupError& error) {
    const Error& e = error.error();
    const bool is_of_key = e.where == "sequence_field" || e.where == "separator" || e.where == "comment";
    const std::string key = is_of_key ? e.where : "fields";
    const ConfigItem* at = item.find(key);
    if (at == nullptr && key == "comment") at = item.find("separator");  // which is that of the default
    const bool is_key = e.where.empty() || e.where == key;
    problems.add(
        (at != nullptr ? *at : item).problem("bad-value", (is_key ? "" : e.where + ": ") + e.why + "; " + e.advice));
  }
}

ReadTime read_time(const SerialConfig&) { return {.on_loop = std::chrono::microseconds{500}}; }

SerialLineSensor::SerialLineSensor(Loop& loop, FeedConfig feed, SerialConfig config) {
  const auto refuse = [&](const char* why, const char* advice) {
    throw SetupError({Errc::bad_argument, "cannot use this serial line", "sensor " + feed.name, why, advice});
  };
  if (config.device.empty())
    refuse("it has no device", "set `device`, such as /dev/ttyUSB0; `ls /dev/serial/by-id` lists them");
  if (config.max_line == 0) refuse("max_line is 0", "such as 4096");
  if (config.retry_first <= Duration{0}) refuse("retry_first is not positive", "such as 100 ms");
  if (const auto flags = detail::control_flags(config.serial); !flags) throw SetupError(flags.error());
  const bool starts = config.start;
  auto decoder = config.format == LineFormat::nmea ? nullptr : std::make_unique<detail::LineDecoder>(config);
  auto* node = new detail::SerialLineNode(loop.core(), feed, std::move(config), std::move(decoder));
  SerialLineSensor made(node);
  if (starts) node->start();
  *this = std::move(made);
}

}  // namespace rtdata
