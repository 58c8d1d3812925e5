// Numbers and times as the cells of an imported table have them. Private to the program.
#pragma once

#include <string>

#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::app {

/// How cells, numbers and times are written.
struct ImportNotation {
  char separator = ',';
  char decimal = '.';
  std::string zone = {};          ///< of times that say none; empty: these are refused
  Duration scale{1'000'000'000};  ///< what 1 is of times that are numbers
  Time start{};                   ///< what 0 is of these
};

/// Whether the text is a number, and which.
bool is_number(const std::string& text, char decimal, double& number);

/// Whether its commas may as well be those of thousands: "1,234", "12,500,000"; not "0,250" nor "1,5".
bool may_have_thousands(const std::string& text);

/// Of a cell of the column of time. Absolute ones are ISO 8601, also 24:00 for the end of a day; numbers count `scale`
/// from `start`. Errors: bad-argument, bad-data.
Result<Time> time_of(const std::string& text, const ImportNotation& notation);

/// By which this would be a time of these decades, since 1970: "; with --scale 1ns it is 2026-03-01". Empty: by none.
std::string scale_of(double number);

/// For people: nothing was imported, and why.
Error import_refused(std::string where, std::string why, std::string advice);

}  // namespace rtdata::app
