// Rows of CSV (RFC 4180).
#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/error.hpp"

namespace rtdata::detail {

struct CsvCell {
  std::string text;
  bool quoted = false;
};

/// One row, with or without its line end; nothing may follow it. Errors: bad-data, with the number of the column.
Result<std::vector<CsvCell>> split_csv(std::string_view row, char separator = ',');
/// Bytes of the first row of a text, its line end included; 0: it does not end.
std::size_t csv_row_size(std::string_view text) noexcept;

}  // namespace rtdata::detail
