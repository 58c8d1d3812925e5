// Reads files of the kernel, and finds who has a device open. Everything may block: use it on lanes and during set-up.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/error.hpp"

namespace rtdata::detail {

/// Without the newline and blanks around it.
constexpr std::string_view trimmed(std::string_view text) noexcept {
  constexpr std::string_view blanks = " \t\r\n";
  const auto first = text.find_first_not_of(blanks);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(blanks) - first + 1);
}

/// At most 4 KiB, without leading and trailing blanks and line ends. `what`: for the error.
Result<std::string> read_kernel_file(const std::string& path, const char* what);
Result<void> write_kernel_file(const std::string& path, std::string_view text, const char* what);
/// Names without a leading dot, not sorted; empty if the folder cannot be read.
std::vector<std::string> names_in_folder(const std::string& folder);
/// The process that has the device open, such as "process 1234 (iio_readdev)", or `this_program`; empty: not visible.
/// Only root can see processes of other users.
std::string holder_of(const std::string& device);
inline constexpr std::string_view this_program = "this program";

}  // namespace rtdata::detail
