// Virtual time with peers and devices in real time.
#pragma once

#include <functional>

#include "rtdata/loop/loop.hpp"

namespace rtdata::app {

/// Lets the time of a manual loop pass as fast as possible until `is_over` returns true. While a sink sends to its peer
/// or waits for a retry, time passes no faster than real time, so that timeouts, delays and deadlines are real. Loop's
/// thread, not within a callback.
void pass_time(Loop& loop, const std::function<bool()>& is_over);

}  // namespace rtdata::app
