// Columns of text. Private to the program.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace rtdata::app {

/// A table as text: first row the heading; columns whose heading begins with '>' are aligned to the right. Two
/// blanks separate columns; lines end with a newline, without blanks before it.
class Table {
 public:
  explicit Table(std::vector<std::string> heading);
  /// `note`: a line below it, such as why something is not ok; empty: none.
  void add(std::vector<std::string> row, std::string note = {});
  bool empty() const noexcept { return rows_.size() < 2; }
  /// If the table is wider than `columns` (0: no limit), the first column becomes narrower: a cell that does not fit
  /// gets its own line, and the rest of its row follows.
  std::string text(std::string_view indent = "", std::size_t columns = 0) const;

 private:
  std::vector<bool> to_the_right_;
  struct Row {
    std::vector<std::string> cells;
    std::string note;
  };
  std::vector<Row> rows_;
};

/// Characters (code points) of UTF-8 text.
std::size_t width_of(std::string_view text) noexcept;
/// The text cut to `width` characters; one that was cut ends with "~". Control characters become '?'.
std::string fitted(std::string_view text, std::size_t width);
/// "1.2 kHz", "12.5 Hz", "0 Hz", at most 9 characters.
std::string frequency_text(double hertz);
/// "12.3k", "4.5M" for large counts: at most 7 characters.
std::string short_count(std::uint64_t count);

}  // namespace rtdata::app
