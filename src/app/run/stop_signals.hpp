// SIGINT and SIGTERM: the first one asks the run to end, a second one ends the process. SIGHUP reads the configuration
// again; if the program's terminal has closed, it acts like the others.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "rtdata/loop/loop.hpp"

namespace rtdata::app {

/// While it lives, a separate thread handles the three signals, so that they work even if the loop is held. Ignored
/// signals stay ignored. SIGPIPE is ignored: a write to a closed pipe fails and does not end the run. Construct it
/// before any other thread, so that the threads inherit the blocked signals.
class StopSignals {
 public:
  /// A loop that does not turn for this long after a signal counts as hung.
  static constexpr Duration hang_limit = std::chrono::seconds{5};
  static constexpr Duration slow_limit = std::chrono::seconds{3};
  StopSignals();
  StopSignals(const StopSignals&) = delete;
  StopSignals& operator=(const StopSignals&) = delete;
  ~StopSignals();

  struct Actions {
    /// Called on the loop, once.
    std::function<void(const char* signal)> first;
    /// On the loop: the number of events waiting to be stored.
    std::function<std::uint64_t()> queued;
    /// On the signals' thread. `queued`: the present number; empty if the loop does not answer. Does not return.
    std::function<void(const char* signal, std::optional<std::uint64_t> queued)> second;
    /// On the signals' thread, for SIGHUP; must not wait. Has the configuration read again.
    std::function<void()> reload;
    /// On the signals' thread, at once, with the first signal. Empty: nothing.
    std::function<void()> at_once = {};
    /// On the signals' thread, if the loop has not called `first` for `hang_limit`. Does not return. May be empty.
    std::function<void(const char* signal)> hangs = {};
    /// On the signals' thread, once, if the loop does not turn `slow_limit` after the first `attach`. May be empty.
    std::function<void()> slow = {};
  };
  /// `loop` must live until `detach`. An earlier signal counts as the first. An earlier SIGHUP, or one while `reload`
  /// is empty, is kept, because the configuration may have been read before it. A second call replaces the actions.
  void attach(Loop& loop, Actions actions);
  void detach() noexcept;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace rtdata::app
