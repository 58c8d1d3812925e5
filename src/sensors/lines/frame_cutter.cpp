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
    refuse_frame("there are both `" + std::string(key) + "` and `" + key + "_hex`", "remove one of them");
  auto bytes = bytes_of_hex(hex);
  if (!bytes)
    refuse_frame("`" + std::string(key) + "_hex` is not bytes", "two hexadecimal digits each, such as \"42 4d\"");
  return text.empty() ? *bytes : text;
}

/// How many bytes at the end may be the first ones of this mark.
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
  const bool is_bare = stream == Stream::of_one && start_.empty() && config.length != 0 && config.length_at == 0;
  if (start_.empty() && end_.empty() && !is_bare)
    refuse_frame("nothing says where a frame begins or ends", "set `start` or `end`, or `start_hex` or `end_hex`");
  const bool has_length = config.length != 0 || config.length_at != 0;
  if (end_.empty() && !has_length)
    refuse_frame("nothing says where a frame ends", "set `end`, `length` or `length_at`");
  if (start_.empty() && has_length && !is_bare)
    refuse_frame("a frame of a known length has a start", "set `start` or `start_hex`");
  if (config.length != 0 && config.length_at != 0)
    refuse_frame("there are two lengths", "remove `length` or `length_at`");
  if (config.length > longest) refuse_frame("`length` is longer than `max_line`", "set a larger `max_line`");
  if (config.length != 0 && config.length <= start_.size())
    refuse_frame("`length` is that of the start", "count all bytes");
  if (config.length_at != 0 && config.length_at < start_.size())
    refuse_frame("`length_at` is within the start", "count from the first byte of the start");
  if (config.length_adds != 0 && config.length_at == 0)
    refuse_frame("`length_adds` belongs to `length_at`", "leave it out");
  if (config.after_end != 0 && (end_.empty() || has_length))
    refuse_frame("`after_end` belongs to an `end` without a length", "leave it out");
}

/// The length that a frame says it has; empty: those bytes are still to come.
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
    const std::size_t start = bytes.find(start_, begin);
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

/// Frames without a start begin where the last one ended.
FrameCutter::Found FrameCutter::next_end(std::string_view bytes) noexcept {
  for (std::size_t begin = 0;;) {
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

std::string_view FrameCutter::body(std::string_view text) const noexcept {
  text.remove_prefix(std::min(start_.size(), text.size()));
  if (!end_.empty())
    if (const std::size_t end = text.rfind(end_); end != std::string_view::npos) text = text.substr(0, end);
  return text;
}

}  // namespace rtdata::detail
