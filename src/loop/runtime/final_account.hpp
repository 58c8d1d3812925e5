// The last events of a run: rtdata/loop/ledger.hpp.
#pragma once

#include <vector>

#include "rtdata/loop/runtime.hpp"

namespace rtdata::detail {

class LoopCore;
class RuntimeCore;

/// The sensors and feeds that were closed in this run and are not in `open` (Runtime::sensors), by name, with their
/// final counts and outages; without those that never had a tick, an event or an outage.
std::vector<SensorStatus> closed_sensors(const RuntimeCore& runtime, const std::vector<SensorStatus>& open);

/// Call it after all sensors have stopped. Does nothing without a subscriber or sink.
void publish_final_account(LoopCore& loop) noexcept;

}  // namespace rtdata::detail
