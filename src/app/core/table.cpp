#include "app/core/table.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>

#include "app/core/terminal_text.hpp"
#include "data/utf8.hpp"

namespace rtdata::app {

Table::Table(std::vector<std::string> heading) {
  for (std::string& cell : heading) {
    to_the_right_.push_back(cell.starts_with('>'));
    if (cell.starts_with('>')) cell.erase(0, 1);
  }
  rows_.push_back({std::move(heading), {}});
}

void Table::add(std::vector<std::string> row, std::string note) {
  for (std::string& cell : row) cell = detail::visible(cell);
  rows_.push_back({std::move(row), detail::visible(note)});
}

std::string Table::text(std::string_view indent, std::size_t columns) const {
  std::vector<std::size_t> widths(to_the_right_.size(), 0);
  for (const Row& row : rows_)
    for (std::size_t i = 0; i < row.cells.size(); ++i) widths[i] = std::max(widths[i], width_of(row.cells[i]));
  std::size_t all = width_of(indent);
  for (const std::size_t width : widths) all += width + 2;
  all -= 2;  // after the last
  if (columns != 0 && all > columns)
    widths[0] -= std::min(all - columns, widths[0] - std::min(widths[0], width_of(rows_[0].cells[0])));
  std::string text;
  for (const Row& row : rows_) {
    std::string line(indent);
    for (std::size_t i = 0; i < row.cells.size(); ++i) {
      const std::size_t width = width_of(row.cells[i]);
      if (i == 0 && width > widths[0]) {
        text += line + row.cells[0] + "\n";
        line.append(widths[0], ' ');
        continue;
      }
      const std::string pad(widths[i] - width, ' ');
      line += (i == 0 ? "" : "  ") + (to_the_right_[i] ? pad + row.cells[i] : row.cells[i] + pad);
    }
    line.erase(line.find_last_not_of(' ') + 1);
    text += line + "\n";
    if (!row.note.empty()) text += wrapped(std::string(indent) + "  ! " + row.note, columns) + "\n";
  }
  return text;
}

std::size_t width_of(std::string_view text) noexcept {
  return static_cast<std::size_t>(std::count_if(text.begin(), text.end(), [](char c) { return (c & 0xc0) != 0x80; }));
}

std::string fitted(std::string_view whole, std::size_t width) {
  const std::string text = printable(whole);
  const bool is_cut = width_of(text) > width;
  std::string result;
  std::size_t count = 0;
  for (const char c : text) {
    if ((c & 0xc0) != 0x80 && ++count > (is_cut ? width - 1 : width)) break;
    result += c;
  }
  if (is_cut) result += '~';
  return result;
}

std::string frequency_text(double hertz) {
  std::array<char, 32> text{};
  const auto with = [&](const char* format, double value) { std::snprintf(text.data(), text.size(), format, value); };
  if (hertz >= 999950) {
    with("%.2f MHz", hertz / 1e6);
  } else if (hertz >= 999.95) {
    with("%.2f kHz", hertz / 1e3);
  } else {
    with(hertz >= 99.95 ? "%.0f Hz" : "%.1f Hz", hertz);
  }
  return text.data();
}

std::string short_count(std::uint64_t count) {
  if (count < 100000) return std::to_string(count);
  std::array<char, 32> text{};
  const double value = static_cast<double>(count);
  if (count < 10'000'000) {
    std::snprintf(text.data(), text.size(), "%.1fk", value / 1e3);
  } else if (value < 1e10) {
    std::snprintf(text.data(), text.size(), "%.1fM", value / 1e6);
  } else {
    std::snprintf(text.data(), text.size(), "%.1fG", value / 1e9);
  }
  return text.data();
}

}  // namespace rtdata::app
