// The fields of a recording that a command line names.
#pragma once

#include <string>
#include <vector>

#include "rtdata/recording/recording.hpp"

namespace rtdata::app {

/// A field of a topic. A record or an array means all numbers in it.
struct ChosenField {
  std::string topic;
  std::string path;  ///< of a number
  bool operator==(const ChosenField&) const = default;
};

/// The fields of "TOPIC.FIELD", or "TOPIC" (all its numbers). `topics`: the known topics. Throws SetupError: there is
/// no such topic or field, with the nearest name; it holds no number.
std::vector<ChosenField> chosen_fields(const std::vector<std::string>& names, const std::vector<RecordedTopic>& topics);

}  // namespace rtdata::app
