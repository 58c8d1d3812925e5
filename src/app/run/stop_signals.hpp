// SIGINT and SIGTERM: the first one asks the run to end, a second one ends the process. SIGHUP reads the configuration
// again, or, when the terminal that the program was started on has gone, is as the others.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "rtdata/loop/loop.hpp"

namespace rtdata::app {

/// While it lives, the three signals are taken by a thread of its own, so that they are seen also when the loop is
/// held. Those that are ignored stay so. SIGPIPE is ignored: a write to who has gone fails, and ends no run. Make it
/// before any other thread: they inherit that the signals are blocked.
class StopSignals {
 public:
  /// A loop that does not turn for so long after a signal has hung.
  static constexpr Duration hang_limit = std::chrono::seconds{5};
  static constexpr Duration slow_limit = std::chrono::seconds{3};
  StopSignals();
  StopSignals(const StopSignals&) = delete;
  StopSignals& operator=(const StopSignals&) = delete;
  ~StopSignals();

  struct Actions {
    /// On the loop, once.
    std::function<void(const char* signal)> first;
    /// On the loop: how many events wait to be stored.
    std::function<std::uint64_t()> queued;
    /// On the signals' thread. `queued`: as it is now; nothing when the loop does not answer. Does not return.
    std::function<void(const char* signal, std::optional<std::uint64_t> queued)> second;
    /// On the signals' thread, for SIGHUP: reads the configuration again.
    std::function<void()> reload;
    /// On the signals' thread, at once, with the first signal. Empty: nothing.
    std::function<void()> at_once = {};
    /// On the signals' thread: the loop has not come to `first` for `hang_limit`. Does not return. Empty: nothing.
    std::function<void(const char* signal)> hangs = {};
    /// On the signals' thread, once: the loop does not turn yet, `slow_limit` after the first `attach`. Empty: nothing.
    std::function<void()> slow = {};
  };
  /// `loop` must live until `detach`. A signal that came before counts as the first; a SIGHUP then, or while `reload`
  /// is empty, is kept: the configuration may have been read before it. Once more: with other actions.
  void attach(Loop& loop, Actions actions);
  void detach() noexcept;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace rtdata::app
