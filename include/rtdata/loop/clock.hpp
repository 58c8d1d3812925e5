/// Clock: the time source of a runtime: the machine's, or one that a test injects.
///
///     SteppedClock clock;                       // derived from rtdata::SystemClock, with a realtime() of its own
///     rtdata::Runtime runtime({.clock = &clock});
///     rtdata::Loop loop(runtime, {.name = "main"});
///
/// Thread: every loop of the runtime calls it on its own thread, tiers too, so a Clock of your own must allow several
/// calls at a time.
#pragma once

#include <optional>
#include <string>

#include "rtdata/data/time.hpp"

namespace rtdata {

namespace detail {
class VirtualThreads;
}

class Clock {
 public:
  virtual ~Clock() = default;
  /// The monotonic clock, on which sampling is scheduled. Never goes back. A clock injected into a loop that runs in
  /// real time must return CLOCK_MONOTONIC here, since the kernel's timers count on it.
  virtual MonotonicTime monotonic() noexcept = 0;
  /// The time of day. May jump in either direction.
  virtual Time realtime() noexcept = 0;
  /// Changes whenever `monotonic` begins anew: the machine's boot id.
  virtual std::string boot_id() = 0;
  /// The largest difference of `realtime` from UTC; empty: unknown, because no service synchronises the clock.
  virtual std::optional<Duration> accuracy() noexcept { return std::nullopt; }
  /// How long the machine was suspended since `monotonic` began, which stood still meanwhile.
  virtual Duration suspended() noexcept { return Duration{0}; }
};

/// The machine's clocks. Their accuracy is the estimated error that the NTP or PTP service gave to the
/// kernel, at least 1 ms.
class SystemClock : public Clock {
 public:
  MonotonicTime monotonic() noexcept override;
  Time realtime() noexcept override;
  std::string boot_id() override;
  std::optional<Duration> accuracy() noexcept override;
  Duration suspended() noexcept override;
};

/// The clocks of a manual loop: they stand still unless moved.
class ManualClock : public Clock {
 public:
  explicit ManualClock(Time realtime = Time{std::chrono::seconds{1'700'000'000}}) : realtime_(realtime) {}
  MonotonicTime monotonic() noexcept override { return monotonic_; }
  Time realtime() noexcept override { return realtime_; }
  /// Differs from object to object.
  std::string boot_id() override;
  std::optional<Duration> accuracy() noexcept override { return accuracy_; }
  Duration suspended() noexcept override { return suspended_; }

  /// Lets time pass on both clocks, up to the largest time at most; does nothing if the duration is not positive.
  /// Within a callback of a manual loop, the callback takes this long. With tiers, the other loops run meanwhile, so
  /// the callback may take longer.
  void pass(Duration duration) noexcept;
  /// Suspends the machine: only the time of day goes on. Does nothing if the duration is not positive.
  void suspend(Duration duration) noexcept;
  /// Sets the time of day, as an operator or NTP would.
  void set_realtime(Time time) noexcept { realtime_ = time; }
  /// Simulates a service that keeps the time of day with this accuracy; empty: no service.
  void set_accuracy(std::optional<Duration> accuracy) noexcept { accuracy_ = accuracy; }

 private:
  friend class detail::VirtualThreads;
  void move(Duration duration) noexcept;

  MonotonicTime monotonic_{};
  Time realtime_;
  Duration suspended_{0};
  std::optional<Duration> accuracy_;
  std::string boot_id_;
  detail::VirtualThreads* threads_ = nullptr;  // of a main loop and its tiers, which share it
};

/// The time of day at one instant of the monotonic clock, by one source.
struct ClockPair {
  MonotonicTime monotonic{};
  Time realtime{};
  std::string source = "system";          ///< "system": the program's clock; or the name of a plugged one: "gps"
  std::optional<Duration> accuracy = {};  ///< how far `realtime` may be from UTC; none: not known
  /// Why it is recorded: "start", "step" (the clock was set), "suspended" (the machine was), "sync" (its accuracy
  /// changed), "regular", "end".
  const char* occasion = "regular";
  Duration suspended{0};  ///< see Clock::suspended
};

}  // namespace rtdata
