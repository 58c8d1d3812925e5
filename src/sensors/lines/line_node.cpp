#include "sensors/lines/line_node.hpp"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <utility>

#include "data/utf8.hpp"
#include "sensors/lines/line_config.hpp"

namespace rtdata::detail {
namespace {

// The most bytes read at once, that is per turn of the loop: their lines stay below the capacity of a topic's ring.
constexpr std::size_t most_read = 1024;
// This many bytes without a line end mean that the device sends no lines at this speed.
constexpr std::size_t least_unended = 4096;
// Bytes outside of frames, after which no frame begins, are reported after this time.
constexpr Duration longest_untold = std::chrono::seconds{1};
// Within frames that cannot be used, at most this number of starts is tried; then the whole frame is skipped, so that a
// turn ends.
constexpr unsigned most_tries = 16;
// A device that was silent for this time after opening was not in the middle of a line.
constexpr Duration silence_before_a_line = std::chrono::milliseconds{100};

bool is_same(const GpsFix& a, const GpsFix& b) noexcept {
  return a.gps_time == b.gps_time && a.lat == b.lat && a.lon == b.lon && a.alt_msl == b.alt_msl && a.speed == b.speed &&
         a.track == b.track && a.mode == b.mode && a.satellites_used == b.satellites_used;
}

}  // namespace

LineNode::LineNode(LoopCore& loop, const FeedConfig& feed, LineConfig config, std::string place, const char* advice)
    : LineNode(loop, feed, config, std::move(place), advice, decoder_of_lines(config)) {}

LineNode::LineNode(LoopCore& loop, const FeedConfig& feed, LineConfig config, std::string place, const char* advice,
                   std::unique_ptr<LineDecoder> decoder)
    : StreamNode(loop, feed, decoder != nullptr ? described_type(decoder->description()) : payload_type<GpsFix>(),
                 {config.silence, config.retry_first, config.retry_longest}),
      config_(std::move(config)),
      place_(std::move(place)),
      advice_(advice),
      decoder_(std::move(decoder)) {
  line_.reserve(config_.max_line + most_read);
  if (config_.frame) {
    cutter_.emplace(*config_.frame, config_.max_line);
    outside_ = Timer(loop.face, [this] {
      if (fd_ < 0) return;
      Call call(*this);
      report_outside(true);
    });
  }
  if (config_.first_line == FirstLine::discard) {
    quiet_ = Timer(loop.face, [this] {
      int waiting = 0;
      if (fd_ >= 0 && unended_ == 0 && line_.empty() && ::ioctl(fd_, FIONREAD, &waiting) == 0 && waiting == 0)
        is_first_ = false;
    });
  }
  if (decoder_ != nullptr) {
    origin_.counts.lost_is_known = decoder_->has_sequence();
    if (decoder_->has_sequence()) {
      held_.size = decoder_->description()->size();
      held_.storage.resize(held_.size / sizeof(std::max_align_t) + 1);
      hold_ = Timer(loop.face, [this] { let_go(); });
    }
    if (config_.device_time) clock_.emplace(*config_.device_time, *decoder_->description());
  } else {
    fixes_ = std::make_unique<NmeaFixes>(place_);
  }
}

void LineNode::start() {
  if (!is_open() || is_running()) return;
  begin_lines();
  open_stream();
}

void LineNode::begin_lines() {
  begin();
  if (decoder_ != nullptr) decoder_->forget_sequence();
  last_fix_.reset();
  unusable_lines_ = 0;
}

void LineNode::expect_rest_of_line() {
  quiet_.stop();
  is_first_ = true;
}

void LineNode::stop() {
  if (is_open()) {
    let_go();
    finish_fix();
    report_unended();
  }
  StreamNode::stop();
}

void LineNode::stop_schedule(MonotonicTime end) {
  let_go();
  finish_fix();
  report_unended();
  StreamNode::stop_schedule(end);
}

std::optional<SensorLoad> LineNode::load() const {
  return SensorLoad{origin_.name, Duration{0}, {}, read_time(config_)};
}

void LineNode::take(Result<int> fd) {
  if (fd) {
    use(*fd);
  } else {
    lose(fd.error(), loop()->now());
  }
}

void LineNode::use(int fd) {
  fd_ = fd;
  if (fixes_ != nullptr) fixes_->reset();
  if (cutter_) cutter_->reset();
  if (clock_) clock_->forget();
  ++openings_;
  line_.clear();
  is_overlong_ = false;
  unended_ = skipped_ = reported_bytes_ = 0;
  is_unended_reported_ = false;
  opened();
  is_first_ = config_.first_line == FirstLine::discard;
  if (is_first_) quiet_.start(silence_before_a_line);
  is_beginning_ = true;
  lines_to_skip_ = config_.skip_lines;
  watch_source(fd_);
}

void LineNode::watch_source(int fd) {
  watch_ = FdWatch(loop()->face, fd, FdWatch::readable, object_name(),
                   [this](const FdEvent& event) { on_ready(event); });
}

void LineNode::on_close() noexcept {
  hold_.close();
  quiet_.close();
  outside_.close();
  if (std::exchange(held_.is_there, false)) {
    origin_.counts.lost += held_.lost;
    take_sample(held_.payload(), held_.time);
  }
  StreamNode::on_close();
}

void LineNode::close_stream() noexcept {
  watch_.close();  // before the descriptor
  if (fd_ >= 0) close_source(fd_);
  fd_ = -1;
}

void LineNode::on_ready(const FdEvent& event) {
  Call call(*this);
  const std::size_t before = line_.size();
  line_.resize(before + most_read);
  const ssize_t got = ::read(fd_, line_.data() + before, most_read);
  const int error_number = got < 0 ? errno : 0;
  line_.resize(before + static_cast<std::size_t>(std::max<ssize_t>(got, 0)));
  if (got > 0) {
    take_read(before);
  } else if (got == 0 || (error_number != EAGAIN && error_number != EINTR) || event.hung_up) {
    take_end(error_number);
  }
}

void LineNode::take_bytes_read(std::string_view bytes, int error_number) {
  Call call(*this);
  if (bytes.empty()) return take_end(error_number);
  const std::size_t before = line_.size();
  line_ += bytes;
  take_read(before);
}

/// The bytes from `before` on are new.
void LineNode::take_read(std::size_t before) {
  heard_bytes();
  time_ = loop()->runtime.event_time(heard_at());
  cutter_ ? take_frames() : take_lines(before);
}

void LineNode::take_end(int error_number) {
  const auto is_same = [this, opening = openings_] { return fd_ >= 0 && openings_ == opening; };
  let_go();
  finish_fix();
  if (is_same() && (cutter_ || is_stream_)) report_rest(End::of_source);
  if (is_same()) source_ended(error_number);
}

/// Takes the complete lines out of the buffer, whose bytes from `from` on are new.
void LineNode::take_lines(std::size_t from) {
  std::size_t begin = 0;
  const std::size_t last_end = line_.rfind(config_.line_end);  // those before `from` were taken
  if (last_end == std::string::npos) {
    unended_ += line_.size() - from;
  } else {
    unended_ = line_.size() - last_end - 1;
    is_unended_reported_ = false;
  }
  // A callback may stop the sensor, and start it again.
  const auto is_same = [this, opening = openings_] { return fd_ >= 0 && openings_ == opening; };
  while (is_same()) {
    const auto end = line_.find(config_.line_end, std::max(begin, from));
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

/// Takes the complete frames out of the buffer.
void LineNode::take_frames() {
  std::size_t begin = 0;
  // A callback may stop the sensor, and start it again.
  const auto is_same = [this, opening = openings_] { return fd_ >= 0 && openings_ == opening; };
  is_taking_ = true;
  while (is_same()) {
    const std::string_view rest = std::string_view(line_).substr(begin);
    const FrameCutter::Found found = cutter_->next(rest);
    skip(rest.substr(0, found.skipped), rest.size() - found.skipped >= cutter_->least());
    begin += found.skipped;
    if (!is_same() || found.size == 0) break;
    const std::string_view frame = rest.substr(found.skipped, found.size);
    const bool is_first = std::exchange(is_first_, false) && !cutter_->has_start();  // its start is not known
    if (is_first) ++origin_.counts.first_lines;
    const bool is_used = is_first || take_frame(frame);
    if (!is_same()) break;
    if (is_used) {
      begin += found.size;
      reported_bytes_ = 0;
      tries_ = 0;
    } else {
      const bool is_hopeless = ++tries_ > most_tries;
      if (is_hopeless) tries_ = 0;
      const std::size_t step = is_hopeless ? found.size : cutter_->step_from(found.size);
      begin += step;
      reported_bytes_ = found.size - step;
    }
  }
  is_taking_ = false;
  if (is_same()) line_.erase(0, begin);
}

/// Reports bytes that belong to no frame, except those of an unusable frame, which have been reported. `are_all`: a
/// frame seems to begin after them.
void LineNode::skip(std::string_view bytes, bool are_all) {
  const std::size_t reported = std::min(bytes.size(), reported_bytes_);
  reported_bytes_ -= reported;
  bytes.remove_prefix(reported);
  const auto blank = [this](char c) { return c == '\r' || c == '\n' || c == '\0' || cutter_->is_mark(c); };
  if (!std::all_of(bytes.begin(), bytes.end(), blank)) skipped_ += bytes.size();
  const bool is_much = skipped_ > std::max(config_.max_line, least_unended);
  if (skipped_ == 0) return;
  if (!is_much && !are_all) return outside_.start(longest_untold);
  report_outside(is_much);
}

void LineNode::report_outside(bool is_much) {
  outside_.stop();
  const std::size_t size = std::exchange(skipped_, 0);
  if (size == 0) return;
  if (std::exchange(is_first_, false)) {
    ++origin_.counts.first_lines;
    if (!is_much) return;
  }
  fail_line({Errc::bad_data, "bytes outside of a frame", place_,
             std::to_string(size) + (size == 1 ? " byte is" : " bytes are") + " discarded", advice_});
}

/// False: it cannot be used.
bool LineNode::take_frame(std::string_view frame) {
  if (lines_to_skip_ != 0) {
    --lines_to_skip_;
    return true;
  }
  if (!config_.checksum && cutter_->holds_another(frame)) {
    fail_line({Errc::bad_data, "cannot use a frame", place_,
               "a second frame begins inside this frame: the end of the first was lost",
               std::string(advice_) + "; if the start bytes can occur in the data, set `checksum` or a length"});
    return false;
  }
  const Result<std::string_view> plain = cutter_->plain(frame);
  const Result<std::string_view> checked = plain ? decoder_->checked(*plain) : plain;
  if (!checked) {
    fail_line(checked.error());
    return false;
  }
  const std::string_view text = config_.format == LineFormat::binary ? *checked : cutter_->body(*checked);
  if (!decoder_->is_meant(text)) {
    leave_out();
    return true;
  }
  if (const Result<void> decoded = decoder_->decode(text); !decoded) {
    fail_line(decoded.error());
    return false;
  }
  take_decoded();
  return true;
}

void LineNode::fail_unended() {
  fail_line({Errc::bad_data, "no end of a line", place_, std::to_string(unended_) + " bytes came without a line end",
             advice_});
}

/// Reports at the end that bytes came but never a usable line.
void LineNode::report_unended() {
  if (cutter_) {
    if (!is_taking_) report_rest(End::ours);  // otherwise a callback stops the sensor: the rest is not examined
    return;
  }
  if (!is_running() || unended_ == 0 || !is_beginning_ || origin_.counts.received != 0) return;
  if (!std::exchange(is_unended_reported_, true)) fail_unended();
}

/// The source has ended within a line, or within a frame whose length is wrong. If the sensor is stopped within a
/// frame, it is not counted as lost.
void LineNode::report_rest(End end) {
  if (!is_running()) return;
  const std::size_t outside = skipped_;
  const std::uint64_t received = origin_.counts.received;
  const auto is_same = [this, opening = openings_] { return fd_ >= 0 && openings_ == opening; };
  if (cutter_ && cutter_->has_start()) {
    for (unsigned tries = 0; is_same() && !line_.empty() && tries < 16 * most_tries; ++tries) {
      const std::size_t before = line_.size();
      take_frames();
      if (!is_same()) return;
      if (line_.empty() || line_.size() != before) continue;
      line_.erase(0, 1);
      ++skipped_;
    }
  }
  if (is_overlong_) line_.clear();  // the rest of a line that has been reported
  const bool has_found = origin_.counts.received != received;
  const std::size_t size = end == End::of_source ? line_.size() + skipped_ : has_found ? 0 : outside;
  line_.clear();
  skipped_ = 0;
  if (!is_same() || size == 0) return;
  if (std::exchange(is_first_, false)) {
    ++origin_.counts.first_lines;
    return;
  }
  fail_line({Errc::bad_data, "cannot use what came last", place_,
             std::to_string(size) + (size == 1 ? " byte" : " bytes") + " came without an end", advice_});
}

void LineNode::end_message() {
  if (!line_.empty() || skipped_ != 0) report_rest(End::of_source);
  if (cutter_) cutter_->reset();
}

Error LineNode::silence_error() const {
  return {Errc::timed_out, "nothing comes", place_, "it has been silent for " + to_string(config_.silence),
          "check the device; `silence` is how long it may be silent"};
}

void LineNode::take_line(std::string_view line) {
  if (config_.line_end == '\r' && line.starts_with('\n')) line.remove_prefix(1);
  while (!line.empty() && line.back() == '\r') line.remove_suffix(1);  // some devices send two
  if (lines_to_skip_ != 0) {
    --lines_to_skip_;
    return;
  }
  if (line.size() > config_.max_line) return fail_overlong();
  if (fixes_ != nullptr) return take_sentence(line);
  if (decoder_->is_skipped(line)) return;
  const bool is_meant = decoder_->is_meant(line);
  if (!is_meant && !decoder_->is_damaged(line)) return leave_out();
  const Result<std::string_view> text = decoder_->checked(line);
  if (!text) return fail_line(text.error());
  const Result<void> decoded = decoder_->decode(*text);
  if (!decoded) return fail_line(decoded.error());
  take_decoded();
}

void LineNode::take_decoded() {
  if (held_.is_there) {
    const unsigned opening = openings_;
    decoder_->takes_back() ? refuse_held() : let_go();
    if (fd_ < 0 || openings_ != opening) return;
  }
  const LineDecoder::NumberComparison step = decoder_->step();
  // Missing numbers of lines that were received but could not be used are not lost.
  const std::uint64_t unusable = std::exchange(unusable_lines_, 0);
  const std::uint64_t lost = step.lost - std::min(step.lost, unusable);
  const Time time = clock_ ? time_of_decoded() : time_;
  if (lost != 0 || step.goes_back) return hold(lost, unusable, time);
  if (step.is_repeated) {
    ++origin_.counts.received;
    ++origin_.counts.repeated;
  } else if (!take_or_fail(decoder_->payload(), time)) {
    return;
  }
  succeed();
}

/// The device's time of the line.
Time LineNode::time_of_decoded() {
  const MonotonicTime at = clock_->time_of(decoder_->payload(), heard_at());
  RuntimeCore& runtime = loop()->runtime;
  if (clock_->take_useless())
    runtime.log(LogLevel::warning, object_name(),
                "the device clock differs too much from the computer's clock, or stops at times: from now on events "
                "get the time of the read; check `field` and `step` of `device_time`");
  if (clock_->take_restart()) runtime.log(LogLevel::info, object_name(), "the device clock restarted, or was set");
  if (const auto drift = clock_->take_drift())
    runtime.log(LogLevel::info, object_name(),
                "the device clock is " + std::to_string(std::lround(std::fabs(*drift))) + " ppm " +
                    (*drift < 0 ? "slower" : "faster") +
                    " than the computer's clock; event times are corrected for this");
  return runtime.event_time(at);
}

/// A line whose number jumped is kept until the next line shows whether a digit was wrong.
void LineNode::hold(std::uint64_t lost, std::uint64_t unusable, Time time) {
  constexpr Duration most_held = std::chrono::seconds{1};
  held_.is_there = true;
  held_.lost = lost;
  held_.unusable = unusable;
  held_.time = time;
  std::memcpy(held_.payload(), decoder_->payload(), held_.size);
  hold_.start(config_.silence > Duration{0} ? std::min(config_.silence, most_held) : most_held);
}

/// The jump was real: the numbers in between are lost.
void LineNode::let_go() {
  if (!std::exchange(held_.is_there, false)) return;
  hold_.stop();
  if (!is_running()) return;
  Call call(*this);
  origin_.counts.lost += held_.lost;
  if (take_or_fail(held_.payload(), held_.time) && !is_silent()) succeed();
}

void LineNode::refuse_held() {
  held_.is_there = false;
  hold_.stop();
  decoder_->drop_last();
  unusable_lines_ += held_.unusable;
  fail_line({Errc::bad_data, "cannot use a line", place_,
             "its sequence number jumps, and the next line continues the old sequence",
             "check the wires, and whether another device writes to the line: a digit was lost or changed"});
}

void LineNode::take_sentence(std::string_view line) {
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
    fail_line({Errc::bad_data, "cannot use the bytes before a sentence", place_,
               std::to_string(begin) + " bytes outside of an NMEA sentence", "set the receiver to send only NMEA"});
    if (fd_ < 0 || openings_ != opening) return;
    line.remove_prefix(begin);
  }
  const Result<void> taken = fixes_->take(line, time_, publish_fix_);
  if (!taken) return fail_line(taken.error());
  if (!has_more) succeed();
}

void LineNode::publish(GpsFix fix, Time time) {
  ++origin_.counts.received;
  // A receiver that sends the same time again has nothing new; without a time, each fix may be new.
  const bool is_repeated = fix.gps_time && last_fix_ && is_same(*last_fix_, fix);
  last_fix_ = fix;
  if (is_repeated) {
    ++origin_.counts.repeated;
  } else {
    ++origin_.counts.published;
    origin_.topic.publish(origin_, time, &fix);
  }
}

/// Publishes the last fix if no more sentences are expected.
void LineNode::finish_fix() {
  if (fixes_ != nullptr && is_running()) fixes_->finish(publish_fix_);
}

void LineNode::fail_overlong() {
  if (lines_to_skip_ != 0) {
    --lines_to_skip_;
    return;
  }
  fail_line({Errc::does_not_fit, "cannot use a line", place_,
             "it is longer than " + std::to_string(config_.max_line) + " bytes",
             std::string(advice_) + "; set a larger `max_line` if lines can be longer"});
}

void LineNode::fail_line(const Error& error) {
  ++unusable_lines_;
  fail(error);
}

void check_source(const LineConfig& config, const std::string& sensor) {
  const auto refuse = [&](const char* why, const char* advice) {
    throw SetupError({Errc::bad_argument, "cannot take these lines", "sensor " + sensor, why, advice});
  };
  check_bytes_are_framed(config);
  if (config.max_line == 0) refuse("max_line is 0", "such as 4096");
  if (config.retry_first <= Duration{0}) refuse("retry_first is not positive", "such as 100 ms");
}

}  // namespace rtdata::detail
