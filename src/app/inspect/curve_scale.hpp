// The numbers and times of curves: where they lie in a picture, and their texts.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

#include "app/inspect/curve.hpp"

namespace rtdata::app {

/// "missed: loop held"
std::string gap_text(const std::string& kind, const std::string& reason);

/// Adds a step to the one before, which becomes longer.
void join(const CurveStep& step, CurveStep& to);

bool is_finite(const Number& number);
double as_double(const Number& number);
/// How far a number is from the least to the most, 0 to 1.
double fraction(const Number& number, const Number& least, const Number& most);
Number middle(const Number& least, const Number& most);

/// The finite numbers of a curve.
struct Scale {
  std::optional<Number> least, most;
  bool has_infinite = false;
  std::uint64_t numbers = 0;
  double mean = 0;
  int digits = 6;  // enough to show a hundredth of the range

  explicit Scale(const Curve& curve);
  bool is_constant() const { return least && *least == *most && !has_infinite; }
  std::string text(double number) const;
  std::string text(const Number& number) const;
};

/// The shortest that reads back equal.
std::string exact_text(const Number& number, Kind kind);

/// "-inf", "20.1": the least and the most of all numbers, and their mean; empty: there is none.
struct RangeTexts {
  std::string least, most, mean;
};
RangeTexts range_texts(const Curve& curve, const Scale& scale);

/// Rounded down.
std::int64_t floor_of(std::int64_t value, std::int64_t of);

/// "12:00:00.123", with enough decimals that times one step apart differ.
std::string clock_text(Time time, Duration step);
std::string date_text(Time time);
/// With its date, if that differs from the date of `beside`.
std::string instant_text(Time time, Time beside, Duration step);

/// The shortest of two digits that is not below `least`, above 0.
Duration two_digits(Duration least);
/// The shortest of the usual distances between marks of an axis that is not below `least`.
Duration distance_of_marks(Duration least);
/// The text of a mark of the axis from `from` to `until`, with this distance of the marks.
std::string mark_text(Time time, Duration distance, Time from, Time until);

}  // namespace rtdata::app
