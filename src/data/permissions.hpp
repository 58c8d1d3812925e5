// The permissions of a new file, as written in a configuration.
#pragma once

#include <sys/types.h>

#include <optional>
#include <string>
#include <string_view>

#include "rtdata/data/error.hpp"

namespace rtdata::detail {

inline constexpr const char* permissions_rule =
    "permissions are octal digits; the owner may read and write, and no user may execute: such as \"0640\" or \"0644\"";

/// Empty: invalid text.
inline std::optional<mode_t> permissions_of(std::string_view text) noexcept {
  if (text.size() == 4 && text.front() == '0') text.remove_prefix(1);
  if (text.size() != 3 || text.front() != '6') return std::nullopt;
  mode_t mode = 0;
  for (const char digit : text) {
    if (digit < '0' || digit > '6' || (digit - '0') % 2 != 0) return std::nullopt;
    mode = mode << 3 | static_cast<mode_t>(digit - '0');
  }
  return mode;
}

/// Error: bad_argument.
inline Result<mode_t> permissions_of(std::string_view text, const std::string& path) {
  if (const auto mode = permissions_of(text)) return *mode;
  return Error{Errc::bad_argument, "cannot write", path, "`permissions` is \"" + std::string(text) + "\"",
               permissions_rule};
}

}  // namespace rtdata::detail
