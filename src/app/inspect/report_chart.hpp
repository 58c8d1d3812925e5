// The curves of a report as pictures: SVG within its page.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "app/inspect/curve.hpp"
#include "rtdata/process/limits.hpp"

namespace rtdata::app {

/// An event at an instant: a thin line in every picture.
struct ChartMark {
  Time at{};               ///< UTC
  std::size_t number = 0;  ///< in the list of the page; 0: none
  const char* kind = "";   ///< "note", "command", "alarm", "state": the class of its line
};

/// Limits, and when they held.
struct TimedLimits {
  LimitSettings limits;
  Time from{}, until{};  ///< UTC; `until` is not included
};

/// A picture for each curve of a plot, above a time axis in UTC: the range of each step filled, the mean as a line,
/// gaps and limits shaded. Common elements are only in the first picture.
class ReportCharts {
 public:
  ReportCharts(const Plot& plot, const std::vector<ChartMark>& marks);
  /// `limits`: those of this field, if any.
  std::string chart_of(const Curve& curve, const std::vector<TimedLimits>& limits);
  /// The style sheet of the pictures.
  static const char* style();

 private:
  std::string gaps_of(const Curve& curve);
  std::string bands_of(const TimedLimits& limits, const std::function<std::optional<int>(double)>& y_of) const;
  std::size_t column_of(Time time) const;
  double x_of(Time time) const;

  const Plot& plot_;
  std::size_t columns_;
  std::string common_;  // of all pictures
  bool is_first_ = true;
  std::map<std::pair<std::string, std::string>, std::size_t> gaps_;  // by topic and origin: the number of its shades
};

/// "failed: io-failed, 2 lost in 1 gap; ..." for the reader of a picture; empty: nothing is missing.
std::string gaps_text(const Curve& curve);

}  // namespace rtdata::app
