// Computes the outages of an origin without a schedule from its gaps.
#pragma once

#include <algorithm>
#include <vector>

#include "rtdata/recording/recording.hpp"

namespace rtdata::detail {

/// For joined gaps only the whole duration is known, in which there was data too.
inline Outages outages_of(const std::vector<const RecordedGap*>& gaps) {
  Outages outages;
  for (const RecordedGap* gap : gaps) {
    const bool is_joined = gap->kind == "joined";
    if (!is_joined && gap->kind != "disconnected" && gap->kind != "silent") continue;
    outages.number += is_joined ? gap->count : 1;
    outages.time += std::max(gap->last - gap->first, Duration{0});
    outages.is_at_most = outages.is_at_most || is_joined;
  }
  return outages;
}

}  // namespace rtdata::detail
