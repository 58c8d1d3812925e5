// Numbers as they lie in a payload.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "rtdata/data/description.hpp"

namespace rtdata::detail {

template <class T>
T load(const std::byte* from) noexcept {
  T value;
  std::memcpy(&value, from, sizeof value);
  return value;
}

/// Loads a value of an integer kind; uint64 as the same bits.
inline std::int64_t load_integer(Kind kind, const std::byte* from) noexcept {
  switch (kind) {
    case Kind::i8:
      return load<std::int8_t>(from);
    case Kind::i16:
      return load<std::int16_t>(from);
    case Kind::i32:
      return load<std::int32_t>(from);
    case Kind::u8:
      return load<std::uint8_t>(from);
    case Kind::u16:
      return load<std::uint16_t>(from);
    case Kind::u32:
      return load<std::uint32_t>(from);
    default:
      return load<std::int64_t>(from);
  }
}

}  // namespace rtdata::detail
