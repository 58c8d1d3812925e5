// Numbers and times in the cells of an imported table. Private to the program.
#pragma once

#include <cstdint>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::app {

struct ImportNumbers {
  char decimal = '.';
  std::string thousands = {};  ///< between groups of three digits; empty: nothing is
};

/// How rows, cells, numbers and times are written.
struct ImportNotation {
  std::uint64_t skip = 0;                  ///< lines before the first row
  std::vector<std::string> comments = {};  ///< texts at the begin of lines that are not rows
  char separator = ',';
  ImportNumbers numbers = {};
  std::vector<std::string> none = {};   ///< texts, and numbers in any notation, that mean "no value"
  std::vector<std::string> strip = {};  ///< removed from the begin or end of cells with numbers
  bool has_blanks = false;              ///< any number of blanks and tabs separates the cells
  bool adds_days = true;                ///< times without a date that go back at midnight belong to the next day
  bool takes_partial = false;           ///< a last row without a line end, and rows without a time, are skipped
  std::string time_format = {};         ///< see `read_time`; empty: ISO 8601 and numbers
  std::string zone = {};                ///< for times without a zone; empty: these are refused
  bool has_named_zone = false;          ///< that of the process
  long double step = 0;                 ///< ns between rows that have no time; 0: they have one
  Duration scale{1'000'000'000};        ///< duration of 1, for times that are numbers
  Time start{};                         ///< time of 0, for times that are numbers or have no date
};

/// The number as C++ writes it: without separators of thousands, with a decimal point. Empty: it is not a number.
/// `buffer` may hold it.
std::string_view usual_number(std::string_view text, const ImportNumbers& written, std::string& buffer);

/// True if the text is a number, with its value.
bool is_number(std::string_view text, const ImportNumbers& written, double& number);

/// True if its commas may separate thousands: "1,234", "12,500,000"; not "0,250" or "1,5".
bool may_have_thousands(const std::string& text);

/// Reads the times of the rows, one after the other.
class ImportClock {
 public:
  explicit ImportClock(const ImportNotation& notation) : notation_(notation) {}
  /// The time in a cell. Absolute times are ISO 8601, also with 24:00 for the end of a day, or of the format; numbers
  /// count in `scale` from `start`. In an hour that comes twice, it is the first time that is not before the row
  /// above. Errors: bad-argument, bad-data.
  Result<Time> read(const std::string& text);
  /// How many times were in an hour that comes twice.
  std::uint64_t twice() const noexcept { return twice_; }
  /// How often midnight, or the full hour, came between two times without a date.
  std::uint64_t midnights() const noexcept { return midnights_; }
  /// The least and the largest offset of --zone that was used. Empty: none was.
  const std::optional<std::pair<Duration, Duration>>& offsets() const noexcept { return offsets_; }

 private:
  Result<Time> read_usual(const std::string& text);
  Result<Time> read_formatted(const std::string& text);
  Result<Time> of_zone(Time shown);
  void add_offset(Duration offset);

  const ImportNotation notation_;
  Time before_ = Time::min();
  Duration step_{0};  // between the last two rows
  std::uint64_t twice_ = 0, midnights_ = 0, steps_ = 0;
  std::optional<std::pair<Duration, Duration>> offsets_ = {};
  std::size_t decimals_ = 0;  // of the rows above, without a decimal mark
};

/// Why `ImportClock` refuses times without a zone.
inline constexpr const char* says_no_zone = "it says no time zone";

/// Finds out whether the numbers of a column are times of day: 085958 and 090000 are two seconds apart.
class ClockDigits {
 public:
  void look_at(std::string_view text);
  /// "%H%M%S", or with hundredths "%H%M%S%f". Empty: they seem to be numbers. `is_said`: the heading says it.
  std::string format(bool is_said) const;
  /// An example: "085958 is 08:59:58".
  std::string shown() const;

 private:
  static constexpr std::size_t enough_minutes = 8,
                               enough_seconds = 4;  // enough values, so that all are below 60 not by chance
  bool can_be_ = true, has_hundredths_ = false, has_all_digits_ = true, has_zero_ = false, has_jump_ = false;
  std::uint64_t rows_ = 0;
  double before_ = 0, number_before_ = 0, step_ = 0, step_of_number_ = 0;
  std::set<std::int64_t> minutes_, seconds_;  // a few different ones
  std::string shown_ = {};
  std::int64_t shown_time_ = 0;
};

/// The unit of time that is a word of the heading: "ms" of "time_ms", "ms since boot" and "ms". Empty: none is.
std::string unit_in(std::string_view heading);

/// The duration of a unit as tables write it: "ms", "millisecond", "usec", "minutes". Empty: it is not a unit of time.
std::optional<Duration> duration_of_unit(std::string_view unit);
/// True for texts in ( ) of headings that are not units: "UTC", "unix".
bool says_a_zone(std::string_view unit);
/// "20250329", "2025032922": true if these digits may be a day, with or without a time of day.
bool may_be_a_day(std::string_view text);

/// A scale that gives a time in these decades, counted from 1970: "; with --scale 1ns it is 2026-03-01". Empty: none.
std::string scale_of(double number);

/// An error that says that nothing was imported, and why.
Error import_refused(std::string where, std::string why, std::string advice);
/// Throws that, as SetupError.
[[noreturn]] void refuse_import(std::string where, std::string why, std::string advice);

}  // namespace rtdata::app
