// Curves of a recording.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "app/inspect/curve.hpp"
#include "app/inspect/recorded_range.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata::app {

/// "missed: loop held"
std::string reason_of(const RecordedGap& gap);

/// Whether a field of that kind has a curve.
bool is_number(Kind kind) noexcept;

/// A field of a topic. A record or an array stands for all numbers in it.
struct ChosenField {
  std::string topic;
  std::string path;  ///< of a number
  bool operator==(const ChosenField&) const = default;
};

/// Of "TOPIC.FIELD", or "TOPIC": all its numbers. `topics`: what there is. Throws SetupError: there is no such topic or
/// field, with the nearest name; it holds no number.
std::vector<ChosenField> chosen_fields(const std::vector<std::string>& names, const std::vector<RecordedTopic>& topics);

/// One for each field and origin, in the order of the fields; with the verdict of the run's account beside each. Reads
/// each event in the range once. `origin`: only this one. Throws SetupError.
Plot curves_of(const Recording& recording, const RecordedRange& range, const std::vector<ChosenField>& fields,
               const std::optional<std::string>& origin, Duration step);

/// The same of all numbers of a run, but of what its course is made of, from the steps in the recording where these are
/// fine enough: at most about `columns` steps in each, and fewer, but 120, if there are more than 200 curves.
/// `account`: of the run.
Plot curves_of_run(const Recording& recording, const RecordedRange& range, const RunReport& account,
                   std::size_t columns);

}  // namespace rtdata::app
