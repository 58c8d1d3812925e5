#include "app/inspect/import_rows.hpp"

#include <algorithm>
#include <utility>

#include "app/inspect/import_time.hpp"
#include "data/utf8.hpp"

namespace rtdata::app {

bool ImportRows::next_line(std::string& line) {
  in_.getline(buffer_.data(), static_cast<std::streamsize>(buffer_.size()));
  const auto got = static_cast<std::size_t>(in_.gcount());
  if (got == 0) return false;
  const bool is_cut = in_.fail() && !in_.eof();
  if (is_cut) in_.clear();
  line.assign(buffer_.data(), is_cut || in_.eof() ? got : got - 1);  // without its end
  return true;
}

Result<bool> ImportRows::next(std::vector<detail::CsvCell>& cells) {
  std::string row, line;
  bool is_quoted = false;  // the row continues on the next line, because this one ends within quotes
  line_ = next_line_;
  while (next_line(line)) {
    ++next_line_;
    row += line;
    row += '\n';
    if (line_ == 1 && row.starts_with(detail::byte_order_mark)) row.erase(0, detail::byte_order_mark.size());
    if (line_ == 1 && (row.starts_with("\xff\xfe") || row.starts_with("\xfe\xff")))
      return import_refused(path_, "it is UTF-16", "convert the file: iconv -f UTF-16 -t UTF-8 " + path_);
    if (row.size() > longest_row)
      return Error{Errc::bad_data, "cannot import", where(), "the row is longer than 1 MiB", ""};
    if (std::count(line.begin(), line.end(), '"') % 2 != 0) is_quoted = !is_quoted;
    if (is_quoted) continue;
    if (row == "\n" || row == "\r\n") {
      row.clear();
      line_ = next_line_;
      continue;
    }
    auto split = detail::split_csv(row, separator_);
    if (!split)
      return Error{Errc::bad_data, "cannot import", where(), split.error().where + ": " + split.error().why, ""};
    cells = *std::move(split);
    for (detail::CsvCell& cell : cells) {
      if (cell.quoted) continue;
      // Blanks around a cell are removed, as on a serial line.
      cell.text.erase(0, std::min(cell.text.find_first_not_of(" \t"), cell.text.size()));
      cell.text.erase(cell.text.find_last_not_of(" \t") + 1);
    }
    return true;
  }
  if (in_.bad()) return Error{Errc::io_failed, "cannot read", path_, "", ""};
  if (!row.empty()) return Error{Errc::bad_data, "cannot import", where(), "a quoted cell does not end", ""};
  return false;
}

}  // namespace rtdata::app
