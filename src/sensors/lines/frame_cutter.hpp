// Finds frames in a stream of bytes.
#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <string>
#include <string_view>

#include "rtdata/sensors/lines.hpp"

namespace rtdata::detail {

class FrameCutter {
 public:
  enum class Stream { endless, of_one };  ///< of_one: only one frame, which begins with the first byte
  /// `longest`: in bytes; longer frames are not used. SetupError (bad-argument): settings that cannot be combined.
  FrameCutter(const LineFrame& config, std::size_t longest, Stream stream = Stream::endless);

  struct Found {
    std::size_t skipped = 0;  ///< bytes that belong to no frame
    std::size_t size = 0;     ///< of the frame after them; 0: more bytes are needed
  };
  /// The least number of bytes in a frame that has begun.
  std::size_t least() const noexcept { return std::max<std::size_t>(start_.size(), 1); }
  bool has_start() const noexcept { return !start_.empty(); }
  /// Examines the received bytes that are not used yet. No allocation.
  Found next(std::string_view bytes) noexcept;
  /// True if a frame without a stated length contains a start of several bytes or of a control character.
  bool holds_another(std::string_view frame) const noexcept;
  /// The byte between stuffed frames, any number of times.
  bool is_mark(char byte) const noexcept { return config_.stuffing != Stuffing::none && byte == end_.front(); }
  /// The next bytes are the first of a stream.
  void reset() noexcept { is_overlong_ = false; }
  /// The frame as it was before its sender stuffed it, without marks; valid until the next call. Without `stuffing`,
  /// the frame unchanged. Errors: bad-data (invalid stuffing). No allocation without an error.
  Result<std::string_view> plain(std::string_view frame);
  /// The part between the start and the end of a frame. `text`: from the start of the frame; the checksum may have been
  /// removed.
  std::string_view body(std::string_view text) const noexcept;
  /// After a frame that cannot be used, a start within it may be the real start: the number of bytes to skip.
  std::size_t step_from(std::size_t size) const noexcept { return start_.empty() ? size : 1; }

 private:
  Found next_end(std::string_view bytes) noexcept;
  std::size_t marks_before(std::string_view bytes) const noexcept;
  std::optional<std::size_t> announced(std::string_view frame) const noexcept;

  const LineFrame config_;
  const std::size_t longest_;
  std::string start_, end_;
  std::string plain_;
  bool is_overlong_ = false;  // the end of a frame that is too long has not been received yet
};

}  // namespace rtdata::detail
