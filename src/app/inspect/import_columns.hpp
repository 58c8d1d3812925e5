// The columns of a table that is imported: their names, units and types. Private to the program.
#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "data/csv_row.hpp"
#include "rtdata/data/description.hpp"
#include "rtdata/data/value.hpp"

namespace rtdata::app {

/// A column, and what all its cells that were looked at can be.
struct ImportColumn {
  std::string heading, name, unit;
  std::string array;  // of which it is an element, as of "accel[0]"; empty: none
  std::size_t index = 0;
  char decimal = '.';
  // What all its cells can be.
  bool can_be_integer = true, can_be_number = true, has_empty = false, has_any = false;
  bool has_large = false;
  bool can_be_with_comma = true, has_comma = false;  // a number with a decimal comma
  bool can_be_thousands = true;                      // what has commas may have those of thousands
  bool are_whole = true;                             // numbers without a fraction, or with commas as of thousands
  std::size_t longest = 1;

  /// Integers of which some would change as doubles stay texts.
  void look_at_all() { can_be_number = can_be_number && (can_be_integer || !has_large); }
  bool seems_to_have_decimal_commas() const {
    return has_any && !can_be_number && can_be_with_comma && has_comma && !can_be_thousands;
  }
  bool seems_to_have_thousands() const {
    return has_any && !can_be_number && has_comma && can_be_thousands && are_whole;
  }
  void look_at(const detail::CsvCell& cell);
  /// For people: "integer, may be absent".
  std::string type() const;
};

/// "chamber temperature [Cel]" is the field chamber_temperature in Cel; of "imu.ax", ax where that is unique.
void name_columns(std::vector<ImportColumn>& columns);

/// The payload of all columns with values but the one of time; of numbers "accel[0]", "accel[1]" an array, whose
/// elements are named after it. `file`: for errors, which are bad-argument and those of DescriptionBuilder.
Result<std::shared_ptr<const Description>> describe_columns(std::vector<ImportColumn>& columns, std::size_t time_column,
                                                            const std::string& file);

/// The cell as its column is described.
Value value_of(const ImportColumn& column, const detail::CsvCell& cell);

}  // namespace rtdata::app
