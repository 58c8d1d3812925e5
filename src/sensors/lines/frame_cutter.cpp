#include "sensors/lines/frame_cutter.hpp"

#include <algorithm>
#include <utility>

#include "data/hex_bytes.hpp"

namespace rtdata::detail {
namespace {

[[noreturn]] void refuse_frame(std::string why, const char* advice) {
  throw SetupError({Errc::bad_argument, "cannot use these frames", "frame", std::move(why), advice});
}

std::string bytes_of(const char* key, const std::string& text, const std::string& hex) {
  if (!text.empty() && !hex.empty())
    refuse_frame("it has both `" + std::string(key) + "` and `" + key + "_hex`", "remove one of them");
  auto bytes = bytes_of_hex(hex);
  if (!bytes)
    refuse_frame("`" + std::string(key) + "_hex` is not bytes",
                 "write two hexadecimal digits for each, such as \"42 4d\"");
  return text.empty() ? *bytes : text;
}

char mark_of(Stuffing stuffing) noexcept {
  return stuffing == Stuffing::slip ? '\xc0' : stuffing == Stuffing::hdlc ? '\x7e' : '\0';
}

/// Each block begins with its length. After a block that is not full there was a 0.
bool put_back_cobs(std::string_view stuffed, std::string& plain) {
  while (!stuffed.empty()) {
    const std::size_t size = static_cast<unsigned char>(stuffed.front());
    if (size == 0 || size > stuffed.size()) return false;
    plain += stuffed.substr(1, size - 1);
    stuffed.remove_prefix(size);
    if (size < 255 && !stuffed.empty()) plain += '\0';
  }
  return true;
}

/// A byte after `escape` represents another byte.
bool put_back_escaped(Stuffing stuffing, std::string_view stuffed, std::string& plain) {
  const char escape = stuffing == Stuffing::slip ? '\xdb' : '\x7d';
  for (std::size_t i = 0; i < stuffed.size(); ++i) {
    if (stuffed[i] != escape) {
      plain += stuffed[i];
      continue;
    }
    if (++i == stuffed.size()) return false;
    if (stuffing == Stuffing::hdlc) {
      plain += static_cast<char>(stuffed[i] ^ 0x20);
    } else {
      if (stuffed[i] != '\xdc' && stuffed[i] != '\xdd') return false;
      plain += stuffed[i] == '\xdc' ? '\xc0' : '\xdb';
    }
  }
  return true;
}

/// The number of bytes at the end that may be the start of this mark.
std::size_t beginning_of(std::string_view mark, std::string_view bytes) noexcept {
  std::size_t size = std::min(bytes.size(), mark.size() - 1);
  while (!bytes.ends_with(mark.substr(0, size))) --size;
  return size;
}

}  // namespace

FrameCutter::FrameCutter(const LineFrame& config, std::size_t longest, Stream stream)
    : config_(config),
      longest_(longest),
      start_(bytes_of("start", config.start, config.start_hex)),
      end_(bytes_of("end", config.end, config.end_hex)) {
  if (config.stuffing != Stuffing::none) {
    if (!start_.empty() || !end_.empty() || config.after_end != 0 || config.length != 0 || config.length_at != 0 ||
        config.length_adds != 0)
      refuse_frame("with `stuffing`, a special byte marks the end of a frame",
                   "remove all settings except `stuffing` and `byte_order`");
    end_ = mark_of(config.stuffing);
    plain_.reserve(longest);
    return;
  }
  const bool is_bare = stream == Stream::of_one && start_.empty() && config.length != 0 && config.length_at == 0;
  if (start_.empty() && end_.empty() && !is_bare)
    refuse_frame("the beginning and the end of a frame are unknown",
                 "set `start` or `end`, or `start_hex` or `end_hex`");
  const bool has_length = config.length != 0 || config.length_at != 0;
  if (end_.empty() && !has_length) refuse_frame("the end of a frame is unknown", "set `end`, `length` or `length_at`");
  if (start_.empty() && has_length && !is_bare)
    refuse_frame("a frame with a length needs a start", "set `start` or `start_hex`");
  if (config.length != 0 && config.length_at != 0) refuse_frame("it has two lengths", "remove `length` or `length_at`");
  if (config.length > longest) refuse_frame("`length` is longer than `max_line`", "set a larger `max_line`");
  if (config.length != 0 && config.length <= start_.size())
    refuse_frame("`length` is not longer than the start", "set it to the number of all bytes of the frame");
  if (config.length_at != 0 && config.length_at < start_.size())
    refuse_frame("`length_at` is within the start", "count from the first byte of the start");
  if (config.length_adds != 0 && config.length_at == 0) refuse_frame("`length_adds` needs `length_at`", "remove it");
  if (config.after_end != 0 && (end_.empty() || has_length))
    refuse_frame("`after_end` works only with an `end` and without a length", "remove it");
}

/// The length stated in a frame. Empty: those bytes have not been received yet.
std::optional<std::size_t> FrameCutter::announced(std::string_view frame) const noexcept {
  if (config_.length_at == 0) return config_.length;
  if (frame.size() < config_.length_at + config_.length_bytes) return std::nullopt;
  std::size_t length = 0;
  for (std::size_t i = 0; i < config_.length_bytes; ++i) {
    const std::size_t at = config_.byte_order == WireOrder::big ? i : config_.length_bytes - 1 - i;
    length = length << 8 | static_cast<unsigned char>(frame[config_.length_at + at]);
  }
  return length + config_.length_adds;
}

FrameCutter::Found FrameCutter::next(std::string_view bytes) noexcept {
  if (start_.empty() && config_.length == 0) return next_end(bytes);
  for (std::size_t begin = 0;;) {
    const bool is_next = begin == 0 && bytes.starts_with(start_);  // the usual case, unless bytes were lost
    const std::size_t start = is_next ? 0 : bytes.find(start_, begin);
    if (start == std::string_view::npos) {
      return {bytes.size() - beginning_of(start_, bytes.substr(begin)), 0};
    }
    const std::string_view frame = bytes.substr(start);
    begin = start + 1;
    std::size_t size = 0;
    if (config_.length != 0 || config_.length_at != 0) {
      const auto length = announced(frame);
      if (!length) return {start, 0};
      size = *length;
      if (size == 0 || size < config_.length_at + config_.length_bytes || size < start_.size() + end_.size()) continue;
    } else {
      const std::size_t end = frame.find(end_, start_.size());
      if (end == std::string_view::npos && frame.size() <= longest_) return {start, 0};
      size = end == std::string_view::npos ? longest_ + 1 : end + end_.size() + config_.after_end;
    }
    if (size > longest_) continue;
    if (frame.size() < size) return {start, 0};
    if (config_.after_end == 0 && !frame.substr(0, size).ends_with(end_)) continue;
    return {start, size};
  }
}

/// Stuffed frames may also begin with marks, and between two marks in a row there is no frame. The first mark ends a
/// frame that is too long.
std::size_t FrameCutter::marks_before(std::string_view bytes) const noexcept {
  if (config_.stuffing == Stuffing::none || is_overlong_) return 0;
  return std::min(bytes.find_first_not_of(end_.front()), bytes.size());
}

bool FrameCutter::holds_another(std::string_view frame) const noexcept {
  const bool may_be_content = start_.empty() || (start_.size() == 1 && static_cast<unsigned char>(start_[0]) >= ' ');
  return !may_be_content && !end_.empty() && config_.length == 0 && config_.length_at == 0 &&
         frame.find(start_, start_.size()) != std::string_view::npos;
}

/// Frames without a start begin at the end of the last frame.
FrameCutter::Found FrameCutter::next_end(std::string_view bytes) noexcept {
  for (std::size_t begin = 0;;) {
    begin += marks_before(bytes.substr(begin));
    const std::size_t end = bytes.find(end_, begin);
    if (end == std::string_view::npos) {
      is_overlong_ = is_overlong_ || bytes.size() - begin > longest_;
      if (!is_overlong_) return {begin, 0};
      return {bytes.size() - beginning_of(end_, bytes.substr(begin)), 0};
    }
    const std::size_t next = end + end_.size() + config_.after_end;
    if (next - begin > longest_) is_overlong_ = true;
    if (next > bytes.size()) return {is_overlong_ ? end : begin, 0};
    if (!std::exchange(is_overlong_, false)) return {begin, next - begin};
    begin = next;
  }
}

Result<std::string_view> FrameCutter::plain(std::string_view frame) {
  if (config_.stuffing == Stuffing::none) return frame;
  frame.remove_suffix(std::min(frame.size(), end_.size()));
  plain_.clear();
  const bool is_good = config_.stuffing == Stuffing::cobs ? put_back_cobs(frame, plain_)
                                                          : put_back_escaped(config_.stuffing, frame, plain_);
  if (!is_good)
    return Error{Errc::bad_data, "cannot use a frame", "frame", "its bytes do not follow its `stuffing`",
                 "check `stuffing` and `baud_rate`"};
  return std::string_view(plain_);
}

std::string_view FrameCutter::body(std::string_view text) const noexcept {
  if (config_.stuffing != Stuffing::none) return text;
  text.remove_prefix(std::min(start_.size(), text.size()));
  if (!end_.empty())
    if (const std::size_t end = text.rfind(end_); end != std::string_view::npos) text = text.substr(0, end);
  return text;
}

}  // namespace rtdata::detail
