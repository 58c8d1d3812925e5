// An error of a processing that does not fit its sensor, thrown where the sensor's item is not known.
#pragma once

#include <vector>

#include "rtdata/data/problem.hpp"
#include "rtdata/process/processing.hpp"

namespace rtdata::config_detail {

class MisfitError : public ConfigError {
 public:
  explicit MisfitError(const ProcessingError& error) : ConfigError(problems_of(error)), mistakes(error.mistakes()) {}
  const std::vector<ProcessingMistake> mistakes;

 private:
  static Problems problems_of(const ProcessingError& error) {
    Problems problems;
    for (const ProcessingMistake& mistake : error.mistakes())
      problems.add("bad-value", {}, "process." + mistake.field, mistake.why + "; " + mistake.advice);
    return problems;
  }
};

}  // namespace rtdata::config_detail
