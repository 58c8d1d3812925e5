// Times in another notation than ISO 8601, of an imported table. Private to the program.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::app {

/// A time as written: without a zone, the time that a clock shows.
struct WrittenTime {
  Time time{};           // since 1970, or without a date since midnight
  bool has_date = true;  // false: only a time of day
  bool has_zone = false;
  std::size_t decimals = 0;  // digits of a %f without a decimal mark before it
};

/// Reads the whole text. %Y %y %m %b %d %j, %H %I %p %M %S (with decimals), %f (decimals of the second), %L (counted
/// milliseconds), %u (microseconds), %N (nanoseconds), %z, %s (seconds since 1970), %a (ignored), %F is %Y-%m-%d, %T
/// is %H:%M:%S; %B and %A are %b and %a. A blank means any number of blanks, and between digits there is one. If
/// parts have nothing between them, the first may lack its zeros: 905 is %H%M. Without a date, hours may exceed 23.
/// Errors: bad-argument.
Result<WrittenTime> read_time(std::string_view text, std::string_view format);

/// The mistake in a format. Empty: none.
std::string format_mistake(std::string_view format);

/// The format of a pattern in a heading, "Time(dd/mm/yyyy)": "%d/%m/%Y". Empty: it has no pattern of a whole date.
std::string format_in(std::string_view heading);
/// The order of day, month and year in it: "dmy". Empty: not all of them are in it.
std::string order_of_date(std::string_view format);

/// False: its times are times of day.
bool format_has_date(std::string_view format);
/// False: its times of day have only minutes and less.
bool format_has_hour(std::string_view format);

}  // namespace rtdata::app
