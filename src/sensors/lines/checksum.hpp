// The checksum of a line or a frame.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "rtdata/sensors/lines.hpp"

namespace rtdata::detail {

/// A value. Its calls allocate memory only for an error.
class Checksum {
 public:
  /// SetupError (bad-argument): settings that cannot be combined.
  explicit Checksum(const LineChecksum& config);

  /// The text without its checksum. Errors: bad-data (a wrong checksum or no checksum).
  Result<std::string_view> checked(std::string_view text) const;
  /// True if the checksum after `after` is wrong.
  bool is_damaged(std::string_view text) const noexcept;
  std::uint32_t of(std::string_view bytes) const noexcept;

 private:
  /// The position of the checksum in a text, its value and the expected value.
  struct Place {
    std::size_t end = 0;      // of what is kept; npos: there is no `after`
    std::size_t covered = 0;  // up to here
    std::string_view written = {};
    bool is_whole = false;
    std::uint32_t number = 0, right = 0;
  };
  Place place_in(std::string_view text) const noexcept;
  std::size_t place_of_after(std::string_view text) const noexcept;
  std::size_t width() const noexcept;
  bool read(std::string_view written, std::uint32_t& number) const noexcept;
  /// Continues from `value`.
  std::uint32_t crc(std::string_view bytes, std::uint32_t value) const noexcept;

  const LineChecksum config_;
  std::size_t bytes_ = 1;                   // of the checksum
  std::string appended_;                    // what it covers and is not sent
  std::uint32_t first_ = 0, last_xor_ = 0;  // of a CRC
  bool is_crc_ = false, is_reflected_ = false;
  std::array<std::array<std::uint32_t, 256>, 4> tables_{};  // of a CRC: of a byte, and of those before it
};

}  // namespace rtdata::detail
