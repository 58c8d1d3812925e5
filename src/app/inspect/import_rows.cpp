#include "app/inspect/import_rows.hpp"

#include <algorithm>
#include <string_view>
#include <utility>

#include "app/inspect/import_columns.hpp"
#include "app/inspect/import_time.hpp"
#include "data/utf8.hpp"

namespace rtdata::app {

ImportRows::ImportRows(std::string path, const ImportNotation& notation)
    : path_(std::move(path)), notation_(notation), in_(path_, std::ios::binary), buffer_(longest_row + 1) {
  for (const std::string& text : notation_.none) {
    double number = 0;
    if (is_number(text, notation_.numbers, number)) no_numbers_.push_back(number);
  }
}

bool ImportRows::next_line(std::string& line) {
  in_.getline(buffer_.data(), static_cast<std::streamsize>(buffer_.size()));
  const auto got = static_cast<std::size_t>(in_.gcount());
  if (got == 0) return false;
  const bool is_cut = in_.fail() && !in_.eof();
  if (is_cut) in_.clear();
  has_line_end_ = !is_cut && !in_.eof();
  line.assign(buffer_.data(), has_line_end_ ? got - 1 : got);
  next_position_ += got;
  if (next_line_++ > 1) return true;
  if (line.starts_with(detail::byte_order_mark)) line.erase(0, detail::byte_order_mark.size());
  if (line.starts_with("\xff\xfe") || line.starts_with("\xfe\xff"))
    utf16_ = "UTF-16";
  else if (line.size() > 1 && (line[0] == '\0') != (line[1] == '\0'))  // a letter without its mark
    utf16_ = line[0] == '\0' ? "UTF-16BE" : "UTF-16LE";
  return true;
}

void ImportRows::go_to(std::uint64_t position, std::uint64_t line) {
  in_.clear();
  in_.seekg(static_cast<std::streamoff>(position));
  next_position_ = position;
  next_line_ = line;
}

bool ImportRows::is_none(const detail::CsvCell& cell) const {
  if (std::find(notation_.none.begin(), notation_.none.end(), cell.text) != notation_.none.end()) return true;
  double number = 0;
  return !no_numbers_.empty() && is_number(cell.text, notation_.numbers, number) &&
         std::find(no_numbers_.begin(), no_numbers_.end(), number) != no_numbers_.end();
}

void ImportRows::begin_rows(std::vector<detail::CsvCell> heading, std::vector<std::string> names,
                            std::vector<std::size_t> time_columns) {
  heading_ = std::move(heading);
  names_ = std::move(names);
  stripped_.assign(names_.size(), {});
  time_columns_ = std::move(time_columns);
  are_rows_ = true;
}

Result<void> ImportRows::strip(std::string& text, std::size_t column) {
  for (const std::string& end : notation_.strip) {
    if (end.empty() || !(text.ends_with(end) || text.starts_with(end))) continue;
    std::string rest = text.substr(text.ends_with(end) ? 0 : end.size(), text.size() - end.size());
    rest.erase(0, std::min(rest.find_first_not_of(" \t"), rest.size()));
    rest.erase(rest.find_last_not_of(" \t") + 1);
    double number = 0;
    if (!is_number(rest, notation_.numbers, number)) continue;
    if (column >= names_.size()) return {};  // the number of cells is checked elsewhere
    const std::string& name = names_[column];
    if ((end == "S" || end == "W") && says_a_place(name))
      return import_refused(where(),
                            "\"" + text + "\" in column " + name + " is " + (end == "S" ? "south" : "west") +
                                ", which --strip " + end + " would remove",
                            "make negative numbers of these first, such as by sed -E 's/([0-9.]+)" + end + "/-\\1/'");
    std::string& before = stripped_[column];
    if (before.empty()) before = end;
    if (before != end)
      return import_refused(where(),
                            "\"" + text + "\" in column " + name + " has " + end + ", and rows above have " + before +
                                ": --strip would remove the unit, and values of different units would be mixed",
                            "convert the column to one unit first, or do not use --strip " + before +
                                " for it: its cells are then texts");
    text = std::move(rest);
    return {};
  }
  return {};
}

bool ImportRows::is_heading(const std::vector<detail::CsvCell>& cells) const {
  return !heading_.empty() && std::equal(cells.begin(), cells.end(), heading_.begin(), heading_.end(),
                                         [](const auto& a, const auto& b) { return a.text == b.text; });
}

bool ImportRows::is_comment(std::string_view text) const {
  return std::any_of(notation_.comments.begin(), notation_.comments.end(),
                     [&](const std::string& begin) { return !begin.empty() && text.starts_with(begin); });
}

void ImportRows::choose(std::vector<ImportChoice> choices) {
  choices_ = std::move(choices);
  others_ = 0;
}

bool ImportRows::is_chosen(std::string_view line, const std::vector<detail::CsvCell>* cells) {
  if (choices_.empty()) return true;
  constexpr std::size_t most_shown = 8;
  constexpr std::string_view around = " \t\r\"";
  std::string_view first = line.substr(0, line.find(notation_.separator));
  first.remove_prefix(std::min(first.find_first_not_of(around), first.size()));
  first = first.substr(0, first.find_last_not_of(around) + 1);
  for (ImportChoice& choice : choices_) {
    if (choice.column.has_value() == (cells == nullptr)) continue;
    if (cells != nullptr && *choice.column >= cells->size()) continue;  // the number of cells is checked elsewhere
    const std::string_view text = cells == nullptr ? first : std::string_view((*cells)[*choice.column].text);
    choice.has_any = choice.has_any || text == choice.text;
    if (text == choice.text) continue;
    ++others_;
    const std::string shown(text.substr(0, 40));
    const bool is_new = std::find(choice.others.begin(), choice.others.end(), shown) == choice.others.end();
    if (is_new && choice.others.size() <= most_shown) choice.others.push_back(shown);
    return false;
  }
  return true;
}

/// With one blank where there are several, and none at the ends; within quotes as they are.
static std::string with_single_blanks(const std::string& line) {
  std::string text;
  bool is_quoted = false;
  for (const char c : line) {
    if (c == '"') is_quoted = !is_quoted;
    const bool is_blank = !is_quoted && (c == ' ' || c == '\t' || c == '\r');
    if (!is_blank)
      text += c;
    else if (!text.empty() && text.back() != ' ')
      text += ' ';
  }
  if (!is_quoted && text.ends_with(' ')) text.pop_back();
  return text;
}

Result<bool> ImportRows::next(std::vector<detail::CsvCell>& cells) {
  std::string row, line;
  bool is_quoted = false;  // the row continues on the next line, because this one ends within quotes
  while (next_line_ <= notation_.skip && next_line(line)) {
  }
  const auto begin = [&] {
    row.clear();
    line_ = next_line_;
    position_ = next_position_;
  };
  begin();
  while (next_line(line)) {
    if (!utf16_.empty())
      return import_refused(path_, "it is UTF-16",
                            "convert the file: iconv -f " + utf16_ + " -t UTF-8 " + path_ + " >table.csv");
    // A line of blanks does not count, except in a table whose cells are separated by tabs.
    const std::size_t text = line.find_first_not_of(notation_.separator == '\t' ? " \r" : " \t\r");
    if (!is_quoted && (text == std::string::npos || is_comment(std::string_view(line).substr(text)))) {
      if (text == std::string::npos && are_rows_ && notation_.step > 0 && empty_line_ == 0) empty_line_ = line_;
      begin();
      continue;
    }
    if (empty_line_ != 0)
      return Error{Errc::bad_data, "cannot import", path_ + ":" + std::to_string(empty_line_),
                   "the line is empty; with --rate or --step the program cannot tell whether a row is missing here",
                   "remove the line, or write the row, with \"\" for no value"};
    if (notation_.has_blanks) line = with_single_blanks(line);
    // Before quotes are read: lines of another kind need not be CSV.
    if (!is_quoted && !is_chosen(line, nullptr)) {
      begin();
      continue;
    }
    row += line;
    row += '\n';
    if (row.size() > longest_row)
      return Error{Errc::bad_data, "cannot import", where(), "the row is longer than 1 MiB", ""};
    if (std::count(line.begin(), line.end(), '"') % 2 != 0) is_quoted = !is_quoted;
    if (is_quoted) continue;
    if (!has_line_end_ && notation_.takes_partial) break;
    auto split = detail::split_csv(row, notation_.separator);
    if (!split) {
      const bool has_other_ends = line.find('\r') < line.size() - 1;
      return Error{Errc::bad_data, "cannot import", where(), split.error().where + ": " + split.error().why,
                   has_other_ends ? "if its lines end with CR alone: tr '\\r' '\\n' <" + path_ + " >lines.csv"
                   : are_rows_ ? "if its \" is part of the text, remove them all: tr -d '\"' <" + path_ + " >table.csv"
                               : "if it is not a heading in CSV, name the columns yourself: --skip " +
                                     std::to_string(line_) + " --columns t,..."};
    }
    cells = *std::move(split);
    for (detail::CsvCell& cell : cells) {
      if (!cell.quoted) {
        // Blanks around a cell are removed, as on a serial line.
        cell.text.erase(0, std::min(cell.text.find_first_not_of(" \t"), cell.text.size()));
        cell.text.erase(cell.text.find_last_not_of(" \t") + 1);
      }
    }
    if (!are_rows_) return true;
    const bool is_again = is_heading(cells);
    if (is_again) ++headings_again_;
    if (is_again || !is_chosen({}, &cells)) {
      begin();
      continue;
    }
    for (std::size_t i = 0; i < cells.size(); ++i) {
      if (std::find(time_columns_.begin(), time_columns_.end(), i) != time_columns_.end()) continue;
      if (!notation_.strip.empty())
        if (auto stripped = strip(cells[i].text, i); !stripped) return std::move(stripped).error();
      if (!notation_.none.empty() && is_none(cells[i])) cells[i] = {};
    }
    return true;
  }
  if (in_.bad()) return Error{Errc::io_failed, "cannot read", path_, "", ""};
  if (row.empty()) return false;
  // A mark for inches, say, would hide all rows after it.
  const bool has_lines = is_quoted && next_line_ > line_ + 1;
  if (!notation_.takes_partial || has_lines)
    return Error{Errc::bad_data, "cannot import", where(), "a quoted cell does not end",
                 has_lines ? "if its \" is part of the text, remove them all: tr -d '\"' <" + path_ + " >table.csv"
                           : "if the file is cut off there, write --partial"};
  cut_line_ = line_;
  return false;
}

void ImportRows::check_text(const std::string& text, const std::string* column) const {
  if (detail::is_readable(text)) return;
  refuse_import(where(),
                (column == nullptr ? "the heading \"" : "the text \"") + detail::readable(text.substr(0, 40)) + "\"" +
                    (column == nullptr ? "" : " in column " + *column) + " is not UTF-8",
                "convert the file: iconv -f WINDOWS-1252 -t UTF-8 " + path_ + " >table.csv");
}

std::optional<char> separator_line(const std::string& path) {
  ImportRows table(path, {});
  std::string line;
  if (!table.next_line(line)) return {};
  std::erase(line, '"');
  std::erase(line, '\r');
  constexpr std::string_view says = "sep=";
  return line.size() == says.size() + 1 && line.starts_with(says) ? std::optional(line.back()) : std::nullopt;
}

}  // namespace rtdata::app
