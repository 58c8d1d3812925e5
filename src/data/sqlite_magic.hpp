// How a file of SQLite begins (www.sqlite.org/fileformat.html).
#pragma once

#include <unistd.h>

#include <array>
#include <string_view>

namespace rtdata::detail {

inline constexpr std::string_view sqlite_magic("SQLite format 3\0", 16);

/// Any thread. Blocks on the disk.
inline bool is_sqlite_file(int fd) noexcept {
  std::array<char, sqlite_magic.size()> begin{};
  return ::pread(fd, begin.data(), begin.size(), 0) == static_cast<ssize_t>(begin.size()) &&
         std::string_view(begin.data(), begin.size()) == sqlite_magic;
}

}  // namespace rtdata::detail
