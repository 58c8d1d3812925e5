// Files of the kernel as texts, and who has a device open. All of it may block: for lanes and set-up.
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

/// At most 4 KiB, without blanks and line ends at both ends. `what`: of the error.
Result<std::string> read_kernel_file(const std::string& path, const char* what);
Result<void> write_kernel_file(const std::string& path, std::string_view text, const char* what);
/// Without those that begin with a dot; none when it cannot be read. Not sorted.
std::vector<std::string> names_in_folder(const std::string& folder);
/// "process 1234 (iio_readdev)" that has the device open, or `this_program`; empty: not to be seen. Whose descriptors
/// those are of other users is for root to see.
std::string holder_of(const std::string& device);
inline constexpr std::string_view this_program = "this program";

}  // namespace rtdata::detail
