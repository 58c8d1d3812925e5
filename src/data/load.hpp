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

/// Calls `use` with a zero of the C++ type of an integer kind; of int64 for any other kind.
template <class Use>
auto for_integer(Kind kind, const Use& use) {
  switch (kind) {
    case Kind::i8:
      return use(std::int8_t{});
    case Kind::i16:
      return use(std::int16_t{});
    case Kind::i32:
      return use(std::int32_t{});
    case Kind::u8:
      return use(std::uint8_t{});
    case Kind::u16:
      return use(std::uint16_t{});
    case Kind::u32:
      return use(std::uint32_t{});
    case Kind::u64:
      return use(std::uint64_t{});
    default:
      return use(std::int64_t{});
  }
}

/// The same for an integer kind, f32 or f64.
template <class Use>
auto for_number(Kind kind, const Use& use) {
  if (kind == Kind::f64) return use(double{});
  if (kind == Kind::f32) return use(float{});
  return for_integer(kind, use);
}

/// Loads a value of an integer kind; uint64 as the same bits.
inline std::int64_t load_integer(Kind kind, const std::byte* from) noexcept {
  return for_integer(kind, [from](auto zero) { return static_cast<std::int64_t>(load<decltype(zero)>(from)); });
}

}  // namespace rtdata::detail
