/// Timers: one-shot, and periodic without drift.
///
///     rtdata::Timer once(loop, 500ms, [] { ... });
///     rtdata::Ticker tick(loop, 10ms, [](const rtdata::Tick& t) { ... });
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's. Spans are std::chrono, ns resolution; the
/// machine limits the precision (`script/bench` prints it).
#pragma once

#include <cstdint>
#include <string>

#include "rtdata/loop/callback.hpp"
#include "rtdata/loop/handle.hpp"
#include "rtdata/loop/loop.hpp"

namespace rtdata {

/// Fires once per start.
class Timer : public Handle {
 public:
  struct Config {
    std::string name = "timer";  ///< in reports
  };
  Timer() noexcept = default;
  /// Makes a timer that is not started; see `start`.
  Timer(Loop& loop, Callback<void()> callback);
  Timer(Loop& loop, Config config, Callback<void()> callback);
  /// Makes and starts a timer that fires `delay` from now. A delay of zero or less fires in the next turn.
  Timer(Loop& loop, Duration delay, Callback<void()> callback);

  /// (Re)starts: fires `delay` from now, once; Duration::max(): never.
  void start(Duration delay);
  /// At an instant of the monotonic clock.
  void start_at(MonotonicTime due);
  /// Never fires again unless started again.
  void stop();
  bool is_running() const noexcept;
};

/// The argument of a periodic callback.
struct Tick {
  MonotonicTime due{};       ///< when this tick was to begin
  MonotonicTime now{};       ///< when it began
  std::uint64_t index = 0;   ///< number of this tick in its schedule, from 0; missed ones count
  std::uint64_t missed = 0;  ///< ticks skipped just before this one

  Duration lateness() const noexcept { return now - due; }
};

/// Fires at start + n * period, computed from the start, so errors do not accumulate. A tick that could not begin
/// before the next one was due is skipped and counted as missed, never caught up. The first tick is at the start.
class Ticker : public Handle {
 public:
  struct Config {
    Duration period{0};           ///< at least 1 us
    Duration phase{0};            ///< added to the start, modulo the period if negative
    std::string name = "ticker";  ///< in reports
  };
  Ticker() noexcept = default;
  /// Started at once. Errors: bad-argument for a period under 1 us.
  Ticker(Loop& loop, Duration period, Callback<void(const Tick&)> callback);
  Ticker(Loop& loop, Config config, Callback<void(const Tick&)> callback);

  void start();
  void stop();
  /// Starts a new schedule now; called from its own callback, the first tick comes one period from now. Does nothing if
  /// the period is the same.
  void set_period(Duration period);
  bool is_running() const noexcept;
  /// Over all starts of this handle.
  std::uint64_t fired() const noexcept;
  std::uint64_t missed() const noexcept;
  CallbackTimes times() const noexcept;
};

}  // namespace rtdata
