// How fast the files of sinks grow, estimated before anything runs. Private to the program.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/config/system.hpp"

namespace rtdata::app {

/// What the sensors with a rate, or whose devices take samples at a rate of their own, make of the file of one sink.
/// Those without a rate are left out: theirs is not known.
struct Growth {
  const PartPlan* sink = nullptr;  ///< valid as long as the plan
  double bytes_per_day = 0;
  bool is_limited = false;  ///< the oldest data goes when it is large or old enough

  /// "bench.jsonl: about 24 GB a day, without limit"
  std::string text() const;
};

/// Of the sinks of the shipped types that write files, in the order of the plan; none that takes nothing. Counted are 9
/// bytes a field: nearly what a recording of numbers takes; text takes up to four times that.
std::vector<Growth> growth_of(const SystemPlan& plan);

/// The file system that a path is on.
struct Disk {
  std::uint64_t device = 0;
  std::uint64_t free_bytes = 0;
};
std::optional<Disk> disk_of(const std::string& path);

/// Adds a warning, fills-disk, for every sink without limit on a disk that is full within `span` by all such sinks.
void warn_of_growth(SystemPlan& plan, Duration span,
                    const std::function<std::optional<Disk>(const std::string&)>& disk = disk_of);
/// What is looked ahead when nothing ends the run.
inline constexpr Duration growth_span = std::chrono::hours{24 * 30};

}  // namespace rtdata::app
