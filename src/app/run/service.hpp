// Notifies a service manager (systemd) of a run: that it is ready, its status, that it ends, and that all its
// loops turn.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "rtdata/detail/io/descriptor.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::app {

/// The connection to the service manager, from $NOTIFY_SOCKET, $WATCHDOG_USEC and $WATCHDOG_PID, see sd_notify(3).
class ServiceManager {
 public:
  ServiceManager();
  ServiceManager(const ServiceManager&) = delete;
  ServiceManager& operator=(const ServiceManager&) = delete;

  /// Sends one or several lines of "KEY=value". Never waits; does nothing without a manager. Errors: the operating
  /// system's.
  Result<void> tell(std::string_view state);
  /// The watchdog time of this process; 0: none.
  Duration watchdog() const noexcept { return watchdog_; }

 private:
  std::string address_;  // empty: none; its first byte is 0 for an abstract one
  detail::Descriptor fd_;
  Duration watchdog_{0};
};

/// A run as a service. Watches the tiers of the loop, and feeds the watchdog at half its time while all of them turn.
/// The main loop does this, so it must turn too. Destroy it before the loop. Thread: the loop's.
class Service {
 public:
  explicit Service(Loop& loop);

  Result<void> tell(std::string_view state) { return manager_.tell(state); }
  bool all_turn() const noexcept { return !tiers_ || tiers_->all_turn(); }
  /// How often the watchdog was not fed because a tier did not turn.
  std::uint64_t withheld() const noexcept { return withheld_; }

 private:
  void feed();
  ServiceManager manager_;
  std::optional<TierWatch> tiers_;  // empty: no watch needed
  std::uint64_t withheld_ = 0;
  Ticker ticker_;  // closed: there is no watchdog
};

}  // namespace rtdata::app
