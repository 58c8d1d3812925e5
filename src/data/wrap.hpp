/// Text for terminals, broken at spaces.
#pragma once

#include <algorithm>
#include <string>
#include <string_view>

namespace rtdata::detail {

/// Appends a paragraph of lines of at most 80 columns, the first after `bullet`, the others as far to the right.
inline void wrap(std::string& out, std::string_view bullet, std::string_view text) {
  constexpr std::size_t width = 80;
  const std::string indent(bullet.size(), ' ');
  std::string line(bullet);
  bool is_empty = true;
  while (!text.empty()) {
    const std::size_t end = std::min(text.find(' '), text.size());
    const std::string_view word = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    if (!is_empty && line.size() + 1 + word.size() > width) {
      out += line + "\n";
      line = indent;
      is_empty = true;
    }
    if (!is_empty) line += ' ';
    line += word;
    is_empty = false;
  }
  out += line + "\n";
}

}  // namespace rtdata::detail
