// When a sink begins that is made in place of another.
#pragma once

#include <optional>

#include "rtdata/data/time.hpp"

namespace rtdata::detail {

/// Since when it has what other loops publish, while an `Exchange::Standstill` lives on this thread: from before that
/// began. None: from now on.
std::optional<Time> standstill_began() noexcept;

}  // namespace rtdata::detail
