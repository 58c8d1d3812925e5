// Numbers and times in the cells of an imported table. Private to the program.
#pragma once

#include <string>

#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::app {

/// How cells, numbers and times are written.
struct ImportNotation {
  char separator = ',';
  char decimal = '.';
  std::string zone = {};          ///< for times without a zone; empty: these are refused
  Duration scale{1'000'000'000};  ///< duration of 1, for times that are numbers
  Time start{};                   ///< time of 0, for times that are numbers
};

/// Whether the text is a number, and which.
bool is_number(const std::string& text, char decimal, double& number);

/// True if its commas may separate thousands: "1,234", "12,500,000"; not "0,250" or "1,5".
bool may_have_thousands(const std::string& text);

/// The time in a cell. Absolute times are ISO 8601, also with 24:00 for the end of a day; numbers count in `scale` from
/// `start`. Errors: bad-argument, bad-data.
Result<Time> time_of(const std::string& text, const ImportNotation& notation);

/// A scale that gives a time in these decades, counted from 1970: "; with --scale 1ns it is 2026-03-01". Empty: none.
std::string scale_of(double number);

/// An error that says that nothing was imported, and why.
Error import_refused(std::string where, std::string why, std::string advice);

}  // namespace rtdata::app
