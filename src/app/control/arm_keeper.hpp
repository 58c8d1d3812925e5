// Arming and disarming that survive a kill: they are on disk before the command is answered.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "rtdata/config/system.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::app {

/// Syncs the armed state of an output to the recording from which a machine resumes after a kill. Thread: the main
/// loop's. Destroy it before the system.
class ArmKeeper {
 public:
  /// `failed`: why it is not on disk, and the consequence; empty: it is, or no machine needs it.
  using Told = std::function<void(const std::string& failed)>;
  ArmKeeper(Loop& loop, System& system) : loop_(loop), system_(system) {}

  /// Calls `act`, which arms or disarms the output and returns true if it did. Then calls back with the result, at once
  /// or within 3 s. If `act` returns false, does not call back.
  void keep(const std::string& output, const std::function<bool()>& act, Told told);
  /// The run ends: stops all waiting.
  void end();

 private:
  struct Waiting;
  void look_at_event(const std::shared_ptr<Waiting>& waiting);
  void look_at_card(const std::shared_ptr<Waiting>& waiting);
  void conclude(const std::shared_ptr<Waiting>& waiting, const std::string& why);
  std::uint64_t dropped(const Waiting& waiting) const;

  Loop& loop_;
  System& system_;
  std::vector<std::shared_ptr<Waiting>> waiting_;
};

}  // namespace rtdata::app
