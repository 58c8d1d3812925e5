// Hashes that are equal in every process, on every machine and in every build, unlike std::hash.
#pragma once

#include <cstdint>
#include <string_view>

namespace rtdata::detail {

/// FNV-1a of 64 bits, continued from `hash`.
constexpr std::uint64_t fnv1a(std::string_view text, std::uint64_t hash = 0xcbf29ce484222325) noexcept {
  for (const char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3;
  return hash;
}

}  // namespace rtdata::detail
