// Words in a row, as a message lists them.
#pragma once

#include <string>
#include <vector>

namespace rtdata::detail {

/// "a, b, c"
inline std::string listed(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
  return text;
}

}  // namespace rtdata::detail
