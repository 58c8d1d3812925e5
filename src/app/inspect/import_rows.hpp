// The rows of a table that is imported. Private to the program.
#pragma once

#include <cstddef>
#include <cstdint>
#include <fstream>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/inspect/import_time.hpp"
#include "data/csv_row.hpp"

namespace rtdata::app {

/// Chooses rows of a table with several kinds of rows.
struct ImportChoice {
  std::optional<std::size_t> column = {};  // empty: the first cell of the line has the text, whatever follows it
  std::string text = {};
  std::string heading = {};  // of the column, for messages
  // The input:
  bool has_any = false;
  std::vector<std::string> others = {};  // other texts, a few of them
};

/// The rows of a file, one after the other, from `notation.skip` on, without comments. A cell that means "no value"
/// is empty.
class ImportRows {
 public:
  ImportRows(std::string path, const ImportNotation& notation);
  bool is_open() const { return in_.is_open(); }
  /// The number of the line on which the last row begins.
  std::uint64_t line() const noexcept { return line_; }
  std::string where() const { return path_ + ":" + std::to_string(line_); }

  /// The line of the last row, if it is skipped because it is cut off; otherwise 0.
  std::uint64_t cut_line() const noexcept { return cut_line_; }
  /// True if nothing follows the last row.
  bool is_at_end() { return in_.peek() == std::ifstream::traits_type::eof(); }
  /// From now on only these rows come.
  void choose(std::vector<ImportChoice> choices);
  const std::vector<ImportChoice>& choices() const noexcept { return choices_; }
  /// How many other rows were skipped since.
  std::uint64_t others() const noexcept { return others_; }
  /// From now on cells that mean "no value" are empty, except in these columns, and rows that repeat the heading
  /// are skipped.
  /// `names`: of the columns, for messages.
  void begin_rows(std::vector<detail::CsvCell> heading, std::vector<std::string> names,
                  std::vector<std::size_t> time_columns);
  std::uint64_t headings_again() const noexcept { return headings_again_; }
  /// Where the last row begins in the file; and goes back there, to that line.
  std::uint64_t position() const noexcept { return position_; }
  void go_to(std::uint64_t position, std::uint64_t line);

  /// False: there are no more. Errors: bad-argument (--strip), bad-data (a quote that does not end, a row of more than
  /// 1 MiB).
  Result<bool> next(std::vector<detail::CsvCell>& cells);
  /// Throws SetupError, bad-argument, unless the text of the last row is UTF-8. `column`: its heading; null: it is one.
  void check_text(const std::string& text, const std::string* column) const;
  /// The next line as it is, without a byte order mark; one of more than 1 MiB ends there. False: there are no more.
  bool next_line(std::string& line);

 private:
  bool is_none(const detail::CsvCell& cell) const;
  /// Removes the texts before or behind numbers. Errors: bad-argument, if that would change the numbers.
  Result<void> strip(std::string& text, std::size_t column);
  bool is_heading(const std::vector<detail::CsvCell>& cells) const;
  bool is_comment(std::string_view text) const;
  /// Applies each choice to a line before its cells are read, or, if `cells` are given, to these.
  bool is_chosen(std::string_view line, const std::vector<detail::CsvCell>* cells);

  static constexpr std::size_t longest_row = std::size_t{1} << 20;
  std::string path_;
  ImportNotation notation_;
  std::vector<double> no_numbers_;  // the "no value" texts that are numbers
  std::ifstream in_;
  std::vector<char> buffer_;  // of one line
  std::uint64_t line_ = 1, next_line_ = 1, cut_line_ = 0;
  std::uint64_t position_ = 0, next_position_ = 0;
  std::uint64_t empty_line_ = 0;  // the last one above, among rows at even steps
  bool are_rows_ = false;         // not the heading any more
  std::vector<detail::CsvCell> heading_;
  std::vector<std::string> names_, stripped_;  // of each column: its name, the text removed from its numbers
  std::vector<std::size_t> time_columns_;
  std::uint64_t headings_again_ = 0;
  std::vector<ImportChoice> choices_;
  std::uint64_t others_ = 0;
  bool has_line_end_ = true;  // the last line
  std::string utf16_ = {};    // the kind of UTF-16, for iconv; empty: it is not UTF-16
};

/// The separator that the first line names, as Excel writes it: "sep=;". Empty: none.
std::optional<char> separator_line(const std::string& path);

}  // namespace rtdata::app
