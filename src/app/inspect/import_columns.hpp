// The columns of a table that is imported: their names, units and types. Private to the program.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "app/inspect/import_time.hpp"
#include "data/csv_row.hpp"
#include "rtdata/data/description.hpp"
#include "rtdata/data/value.hpp"

namespace rtdata::app {

/// A column, and the types that all its cells so far can have.
struct ImportColumn {
  std::string heading, bare, name, unit;  // bare: the heading without its unit
  std::string array;                      // its array, as for "accel[0]"; empty: none
  std::size_t index = 0;
  bool is_round = false;  // its unit is in ( )
  bool is_time = false;
  bool is_text = false;  // whatever its cells are
  ImportNumbers numbers = {};
  // The types that all its cells can have.
  bool can_be_integer = true, can_be_number = true, has_empty = false, has_any = false;
  bool has_large = false;
  std::string first_large = {};  // an integer that is not exact as a double
  std::uint64_t first_large_line = 0;
  bool can_be_with_comma = true, has_comma = false;  // a number with a decimal comma
  bool can_be_thousands = true;                      // its commas may be thousands separators
  bool are_whole = true;                             // no fractions; commas may separate thousands
  std::size_t longest = 1;
  // Why it is text.
  std::uint64_t values = 0, texts = 0;
  std::string first_text = {};
  std::uint64_t first_text_line = 0;
  // How many of these texts are numbers with this separator of thousands.
  struct Mark {
    std::string text;
    std::uint64_t count = 0;
  };
  std::vector<Mark> marks = {};
  std::uint64_t numbers_with_more = 0;  // of these texts: a number, and the same letters behind it
  std::string more = {};                // these letters
  std::string with_zeros = {};          // the first whole number with zeros before it
  // It may be a time, too: its numbers never fall.
  double before = 0;
  bool never_falls = true, rises = false;
  bool is_as_time = true;  // each cell equals that of the time

  /// Integers that are not exact as doubles stay texts.
  void look_at_all() {
    can_be_integer = can_be_integer && !is_text;
    can_be_number = can_be_number && (can_be_integer || !has_large) && !is_text;
  }
  bool seems_to_have_decimal_commas() const {
    return has_any && !can_be_number && can_be_with_comma && has_comma && !can_be_thousands;
  }
  bool seems_to_have_thousands() const {
    return has_any && !can_be_number && has_comma && can_be_thousands && are_whole;
  }
  /// The separator of thousands, if all its texts are such numbers. Empty: none.
  std::string thousands_in_texts() const;
  /// True if it would have numbers except for a few of its cells.
  bool is_text_for_few() const { return !can_be_number && texts > 0 && texts < values - texts; }
  void look_at(const detail::CsvCell& cell, std::uint64_t line);
  void look_at_text(const std::string& text);
  /// As text: "integer, may be absent".
  std::string type() const;
};

/// "chamber temperature [Cel]", or with ( ), is the field chamber_temperature in Cel; of "imu.ax", ax where that is
/// unique, in a table that rtdata wrote. In other tables a point is part of the name: PM2.5, Dew Pt.
void name_columns(std::vector<ImportColumn>& columns);

/// The unit of a row of units: "[m]", "(m)" and "m" are the same.
std::string unit_of(std::string text);

/// True if the heading is that of a latitude or longitude.
bool says_a_place(const std::string& heading);

/// The description of all columns with values, without those of time; number columns "accel[0]", "accel[1]" become an
/// array. `file`: for error messages. Errors: bad-argument and those of DescriptionBuilder.
Result<std::shared_ptr<const Description>> describe_columns(std::vector<ImportColumn>& columns,
                                                            const std::string& file);

/// The value of the cell, in the type of its column.
Value value_of(const ImportColumn& column, const detail::CsvCell& cell);

}  // namespace rtdata::app
