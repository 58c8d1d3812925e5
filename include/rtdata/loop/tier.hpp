/// Tier: a loop on a thread of its own, with a scheduling policy, a priority and a processor.
///
///     rtdata::Loop loop;                                     // the normal tier: sinks, slow handlers
///     rtdata::Tier fast(loop,
///         {.name = "fast", .policy = rtdata::SchedulingPolicy::fifo, .priority = 80, .cpus = {1}});
///     rtdata::Sensor<Pressure> chamber(fast.loop(), {.name = "chamber", .rate = 1_kHz}, read_adc);
///     auto s = loop.subscribe("chamber", [](const rtdata::EventView& e) { ... });  // runs on `loop`
///     rtdata::SqliteSink sink(loop, {.path = "run.db"});
///     loop.run();                                            // starts the tier
///
/// Events published on one tier reach subscriptions and sinks on all other loops as copies, through a bounded ring for
/// each pair of loops. A full ring drops the new event and counts it for the subscription or sink that misses it. The
/// publishing side takes no lock and allocates nothing; the other side is woken once a turn, or earlier after many
/// events. Only trivially copyable payloads can cross: subscribing to another payload on another loop throws
/// SetupError, or is reported if the subscription is by name.
///
/// Without permission for its policy, priority, memory lock or processor a tier still runs; `warnings` and the log say
/// what to set.
///
/// Make objects on the tier's loop before it runs, or in `call`. While the tier runs, the main loop's thread may close
/// a handle and call every function of a sensor: the call waits until the tier has done it. Everything else needs
/// `call`. A tier that does not turn refuses these calls like `call` does. If a call has begun and does not return for
/// 1 s, the caller stops waiting: the error says so, and the tier may still complete the call. Queries then return the
/// last state known to the main loop, as faulted. Closing waits for 5 s; after that the tier closes the object as soon
/// as it turns, which is reported: everything that the callbacks refer to must live until then.
///
/// If a callback of a tier never returns, `Loop::close` still closes the recordings: they are marked as incomplete,
/// with the callback's name and the time up to which the tier's account is known.
///
/// On a manual loop a tier shares its virtual time, and runs whenever the main loop's thread waits: in `advance`,
/// `run`, `close`, `call`, `stop`, and in `ManualClock::pass`. One of them runs at a time, in an order that
/// `Loop::Manual` chooses. A callback must not wait for another loop in any other way than `manual_clock().pass(1ms)`
/// in a loop, and must not hold a lock that another loop takes while it posts. `policy`, `cpus` and similar settings
/// have no effect.
///
/// Owner: the user; destroy it before its main loop, before or after its handles. It may be destroyed in a callback of
/// the main loop. Destroying it in one of its own callbacks, on another thread, or in a call of a sink's Writer ends
/// the program with a message. Thread: the main loop's.
#pragma once

#include <memory>
#include <string>
#include <type_traits>
#include <vector>

#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata {

namespace detail {
class TierCore;
}

class Tier {
 public:
  struct Config {
    std::string name = "fast";  ///< in log lines, and of its thread (the first 15 characters)
    SchedulingPolicy policy = SchedulingPolicy::other;
    int priority = 0;                ///< 1 to 99 for real-time policies
    std::vector<int> cpus = {};      ///< processors that it may run on; empty: any
    bool lock_memory = true;         ///< with a real-time policy: mlockall, so that the process is not swapped out
    std::size_t stack = 256 * 1024;  ///< bytes of its stack to touch at the start, so that they are in memory
    bool keep_cpu_awake = false;  ///< /dev/cpu_dma_latency 0 while it runs: less lateness, more power, all processors
    Duration spin{0};             ///< busy-wait before a deadline, up to 10 ms: uses the processor that long each tick
    Duration hold_limit = Loop::Config{}.hold_limit;
    Duration delivery_budget = Loop::Config{}.delivery_budget;
    Duration phase_grid = Loop::Config{}.phase_grid;
    Duration timer_slack = Loop::Config{}.timer_slack;
    std::size_t ring_bytes = std::size_t{1} << 20;  ///< of each ring from and to another loop; 1024 or more
  };

  /// SetupError: busy (tiers of this main loop run already, so no further one can be made); bad-argument (`main`
  /// belongs to a tier; a priority, a spin or a processor is out of range; the name is taken); bad-name (the name is
  /// empty, longer than 200 characters or has control characters).
  Tier(Loop& main, Config config);
  /// Stops it. Waits without limit for a running callback, because it may use objects that are destroyed next; the log
  /// names the callback.
  ~Tier();
  Tier(const Tier&) = delete;
  Tier& operator=(const Tier&) = delete;

  Loop& loop() noexcept;
  const Config& config() const noexcept;

  /// Starts the thread. The main loop's `run` also starts it, and does not return by itself while a tier runs.
  void start();
  /// Ends its thread after the running callback; drains nothing and keeps its objects. It may be started again. In one
  /// of its own callbacks, or in a call of a sink's Writer, only requests the stop and returns.
  void stop() noexcept;
  /// The same, but waits at most this long for the callback. False: the callback (see `doing`) has not returned; the
  /// tier ends when it does. A program that must end anyway calls std::_Exit, because destroying an object of the tier
  /// waits for it.
  bool stop_within(Duration at_most) noexcept;
  /// The callback that it called last, "sensor chamber" or "handler of room/#"; empty: none, or it has no name or no
  /// longer exists. Any thread.
  std::string doing() const;
  bool is_running() const noexcept;

  /// Runs `function(loop())` on the tier's thread and returns its result or throws its exception. If the tier does not
  /// run, or in its own callbacks, runs it at once on the calling thread. SetupError: not-turning (a callback of the
  /// tier has not returned for 1 s, and the function will never be called; thrown at once if that is known already),
  /// busy (in a call of a sink's Writer, for which the tier may be waiting). Once the function has begun, the call
  /// waits without limit.
  template <class Function>
  auto call(Function&& function) {
    using Returned = std::invoke_result_t<Function&, Loop&>;
    if constexpr (std::is_void_v<Returned>) {
      call_erased([&] { function(loop()); });
    } else {
      std::unique_ptr<Returned> returned;
      call_erased([&] { returned = std::make_unique<Returned>(function(loop())); });
      return std::move(*returned);
    }
  }

  /// The scheduling of its thread, once started.
  Scheduling scheduling() const noexcept;
  /// Settings that the system refused, each with the way to permit it.
  const std::vector<std::string>& warnings() const noexcept;

 private:
  void call_erased(Callback<void()> function);
  std::unique_ptr<detail::TierCore> core_;
};

/// Checks, as long as it lives, that every running tier of a main loop turns.
///
///     rtdata::TierWatch watch(loop);
///     rtdata::Ticker feed(loop, 1s, [&](const rtdata::Tick&) { if (watch.all_turn()) feed_the_watchdog(); });
///
/// It asks each tier four times within `limit`. A tier that has not answered for longer than `limit` (a callback does
/// not return, or other threads have its processor) is reported by name (not-turning) and is faulted in
/// `$rtdata/health` until it answers.
///
/// Owner: the user; must be destroyed before its loop. It keeps the loop's `run` from returning. Thread: the loop's.
class TierWatch {
 public:
  /// SetupError (bad-argument): less than 1 ms.
  explicit TierWatch(Loop& main, Duration limit = std::chrono::seconds{1});
  TierWatch(const TierWatch&) = delete;
  TierWatch& operator=(const TierWatch&) = delete;

  /// The result of the last check.
  bool all_turn() const noexcept { return *all_turn_; }

 private:
  std::shared_ptr<bool> all_turn_;  // with the ticker's callback, which may be on the stack when this goes
  Ticker ticker_;
};

}  // namespace rtdata
