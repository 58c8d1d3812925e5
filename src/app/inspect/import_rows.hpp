// The rows of a table that is imported. Private to the program.
#pragma once

#include <cstddef>
#include <cstdint>
#include <fstream>
#include <string>
#include <utility>
#include <vector>

#include "data/csv_row.hpp"

namespace rtdata::app {

/// The rows of a file, one after the other.
class ImportRows {
 public:
  ImportRows(std::string path, char separator)
      : path_(std::move(path)), separator_(separator), in_(path_, std::ios::binary), buffer_(longest_row + 1) {}
  bool is_open() const { return in_.is_open(); }
  /// The number of the line on which the last row begins.
  std::uint64_t line() const noexcept { return line_; }
  std::string where() const { return path_ + ":" + std::to_string(line_); }

  /// False: there are no more. Errors: bad-data (a quote that does not end, a row of more than 1 MiB).
  Result<bool> next(std::vector<detail::CsvCell>& cells);
  /// The next line as it is; one of more than 1 MiB ends there. False: there are no more.
  bool next_line(std::string& line);

 private:
  static constexpr std::size_t longest_row = std::size_t{1} << 20;
  std::string path_;
  char separator_;
  std::ifstream in_;
  std::vector<char> buffer_;  // of one line
  std::uint64_t line_ = 1, next_line_ = 1;
};

}  // namespace rtdata::app
