// Arming and disarming that outlive a kill: they are on the card before who commanded them is answered.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "rtdata/config/system.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::app {

/// Forces onto the card whether an output is armed, where a machine that goes on after a kill looks for that.
/// Thread: the main loop's. Gone before the system.
class ArmKeeper {
 public:
  /// `failed`: why it is not on the card, and what that means; empty: it is, or no machine looks for it.
  using Told = std::function<void(const std::string& failed)>;
  ArmKeeper(Loop& loop, System& system) : loop_(loop), system_(system) {}

  /// Arms or disarms it with `act`, which returns whether that was done, and tells what came of it: at once, or within
  /// 3 s. Not done: nothing is told.
  void keep(const std::string& output, const std::function<bool()>& act, Told told);
  /// The run ends: nothing is waited for any more.
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
