// A field over time, reduced to steps: the data for pictures of recordings and of running instances.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "rtdata/data/description.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::app {

/// The recorded type, so that integers beyond 2^53 stay exact. All values of one curve have the same type.
using Number = std::variant<std::int64_t, std::uint64_t, double>;

/// The values of one field in the events of one step. A step without events is omitted.
struct CurveStep {
  Time begin{};               ///< UTC, a multiple of the step
  std::uint64_t events = 0;   ///< all of them
  std::uint64_t numbers = 0;  ///< those that have a number: not absent, not NaN
  Number least, most;         ///< of these values; may be infinite
  double mean = 0;            ///< of these values
};

/// A time with missing data.
struct CurveGap {
  Time first{}, last{};    ///< UTC, both included
  std::uint64_t lost = 0;  ///< ticks or events; 0: unknown number
  std::string reason;      ///< "missed: loop held"
};

/// The time is the beginning of the step in which it is.
struct Extreme {
  Number number;
  Time at{};
};

struct Curve {
  std::string name;                    ///< "room/climate.temperature"
  std::string unit;                    ///< UCUM; empty: none
  std::string topic, origin, path;     ///< curves of one origin on one topic have the same gaps
  Kind kind = Kind::f64;               ///< of the field
  std::vector<CurveStep> steps;        ///< in order of time
  std::optional<Extreme> least, most;  ///< of all numbers; empty: there are none
  std::vector<CurveGap> gaps;
  std::string verdict;  ///< "all there", "12 lost"
  bool has_loss = false;
};

/// Curves over one span of time.
struct Plot {
  std::string title;      ///< source: "bench.db, run 3"
  Time from{}, until{};   ///< UTC; `until` is not included
  Duration step{1};       ///< of all curves, above 0
  Duration read_step{1};  ///< of the times of extremes
  std::vector<Curve> curves;
  std::vector<std::string> notes;  ///< sentences below it
};

}  // namespace rtdata::app
