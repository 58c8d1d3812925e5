// A field of bytes: at a position in a frame, or in the group of a pattern.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string_view>

#include "rtdata/sensors/lines.hpp"
#include "sensors/lines/field_text.hpp"

namespace rtdata::detail {

/// A value.
class BinaryField {
 public:
  /// SetupError (bad-argument): types that cannot be combined. `order`: the order of its bytes.
  BinaryField(const LineField& field, const Leaf* leaf, WireOrder order);

  std::size_t at() const noexcept { return at_; }
  std::size_t size() const noexcept { return size_; }
  /// False: the field cannot have this number of bytes.
  bool takes(std::size_t bytes) const noexcept;
  /// Writes its value, or the mark of a missing value, to the payload. `bytes`: a number of bytes for which `takes` is
  /// true. Null: done, otherwise the reason. No allocation.
  const char* put(std::string_view bytes, const FieldText& text, std::byte* payload) const noexcept {
    if (!is_plain_ || bytes.size() != size_) return put_any(bytes, text, payload);
    const double value = scale_(whole_(bytes.data()));
    if (!std::isfinite(value)) return put_any(bytes, text, payload);
    std::memcpy(payload + offset_, &value, sizeof value);
    return nullptr;
  }

 private:
  const char* put_any(std::string_view bytes, const FieldText& text, std::byte* payload) const noexcept;
  std::uint64_t bits_of(std::string_view bytes) const noexcept;
  bool has_digits(std::string_view bytes) const noexcept;
  double number_of(std::string_view bytes) const noexcept;

  const Leaf* leaf_;
  std::size_t offset_, at_, size_ = 0;
  bool is_plain_ = false;  ///< all bytes of its type are a double, which is always there
  Kind wire_;
  bool is_big_;
  FieldScale scale_;
  bool is_bcd_;
  std::uint64_t mask_ = 0;                                 ///< 0: all bits
  double (*whole_)(const char* bytes) noexcept = nullptr;  ///< reads all bytes of its type; null: `bits_of` does
};

}  // namespace rtdata::detail
