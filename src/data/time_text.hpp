// Times as text, without allocation.
#pragma once

#include <cstddef>

#include "rtdata/data/time.hpp"

namespace rtdata::detail {

inline constexpr std::size_t iso8601_size = 30;

/// Writes the text of `to_iso8601`: always `iso8601_size` characters. Returns the end.
char* put_iso8601(char* to, Time time) noexcept;

}  // namespace rtdata::detail
