// Estimates the growth of sinks' files before anything runs. Private to the program.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/config/system.hpp"

namespace rtdata::app {

/// The growth of one sink's file from sensors with a known rate (of reads, or of the device's own samples). Other
/// sensors do not count.
struct Growth {
  const PartPlan* sink = nullptr;  ///< valid as long as the plan
  double bytes_per_day = 0;
  bool is_limited = false;  ///< the sink deletes the oldest data at a limit

  /// "bench.jsonl: about 24 GB a day, without limit"
  std::string text() const;
};

/// For the included types of sinks that write files, in the order of the plan; without sinks that take nothing. Counts
/// 9 bytes for each field: nearly right for numbers in a recording; text takes up to four times that.
std::vector<Growth> growth_of(const SystemPlan& plan);

/// The file system that a path is on.
struct Disk {
  std::uint64_t device = 0;
  std::uint64_t free_bytes = 0;
};
std::optional<Disk> disk_of(const std::string& path);

/// Adds the warning fills-disk for every sink without limit, if all such sinks together fill the disk within `span`.
void warn_of_growth(SystemPlan& plan, Duration span,
                    const std::function<std::optional<Disk>(const std::string&)>& disk = disk_of);
/// The time to look ahead for a run without an end.
inline constexpr Duration growth_span = std::chrono::hours{24 * 30};

}  // namespace rtdata::app
