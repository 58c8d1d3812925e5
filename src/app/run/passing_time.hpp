// Virtual time beside peers and devices whose time is the machine's.
#pragma once

#include <functional>

#include "rtdata/loop/loop.hpp"

namespace rtdata::app {

/// Lets the time of a manual loop pass until `is_over`: as fast as it goes; but while a sink sends something to its
/// peer, or waits before it tries again, no faster than the machine's time, so that time-outs, delays and deadlines are
/// real ones. Loop's thread, not within a callback.
void pass_time(Loop& loop, const std::function<bool()>& is_over);

}  // namespace rtdata::app
