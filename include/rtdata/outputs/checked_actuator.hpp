/// CheckedActuator: an Actuator whose device may go away between two values, and come back without the last one.
///
/// A guard (guard.hpp) asks each second. After an error the output has failed: the guard makes another Actuator, which
/// is set to the safe value as soon as it takes that. Without a guard nobody asks.
///
/// Owner and thread: as of every Actuator (output.hpp).
#pragma once

#include "rtdata/outputs/output.hpp"

namespace rtdata {

class CheckedActuator : public Actuator {
 public:
  /// Whether the device that has taken the last value is still there. Does not wait.
  /// Errors: disconnected, or what the device says.
  virtual Result<void> check() = 0;
};

}  // namespace rtdata
