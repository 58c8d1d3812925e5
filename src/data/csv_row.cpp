#include "data/csv_row.hpp"

namespace rtdata::detail {
namespace {

Error bad(std::string where, std::string why) {
  return {Errc::bad_data, "the text is not a row of CSV", std::move(where), std::move(why), ""};
}

}  // namespace

Result<std::vector<CsvCell>> split_csv(std::string_view row, char separator) {
  std::vector<CsvCell> cells(1);
  std::size_t i = 0;
  const auto where = [&] { return "column " + std::to_string(cells.size()); };
  while (i < row.size()) {
    CsvCell& cell = cells.back();
    const char c = row[i];
    if (c == '"') {
      if (cell.quoted || !cell.text.empty()) return bad(where(), "a quote within a cell");
      cell.quoted = true;
      for (++i;; ++i) {
        if (i >= row.size()) return bad(where(), "a quoted cell does not end");
        if (row[i] == '"') {
          if (i + 1 >= row.size() || row[i + 1] != '"') break;
          ++i;
        }
        cell.text += row[i];
      }
      ++i;
    } else if (c == separator) {
      cells.emplace_back();
      ++i;
    } else if (c == '\n' || c == '\r') {
      const std::size_t end = i + (c == '\r' && i + 1 < row.size() && row[i + 1] == '\n' ? 2 : 1);
      if (end != row.size() || (c == '\r' && end == i + 1)) return bad(where(), "something follows the end of the row");
      i = end;
    } else {
      if (cell.quoted) return bad(where(), "something follows a quoted cell");
      cell.text += c;
      ++i;
    }
  }
  return cells;
}

std::size_t csv_row_size(std::string_view text) noexcept {
  bool quoted = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] == '"') quoted = !quoted;
    if (text[i] == '\n' && !quoted) return i + 1;
  }
  return 0;
}

}  // namespace rtdata::detail
