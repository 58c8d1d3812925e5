// The last events of a run: rtdata/loop/ledger.hpp.
#pragma once

#include <vector>

#include "rtdata/loop/runtime.hpp"

namespace rtdata::detail {

class LoopCore;
class RuntimeCore;

/// The sensors and feeds that were closed in this run, and are none of those that are `open` (Runtime::sensors): by
/// name, with the counts and outages that they ended with. Without those that never had a tick, an event or an outage.
std::vector<SensorStatus> closed_sensors(const RuntimeCore& runtime, const std::vector<SensorStatus>& open);

/// After all sensors have stopped. Nothing where nobody wants them.
void publish_final_account(LoopCore& loop) noexcept;

}  // namespace rtdata::detail
