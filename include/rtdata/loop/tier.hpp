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
/// What is published on one tier reaches subscriptions and sinks of every other one, as copies, through a bounded ring
/// for each pair of loops; full, it drops the new event and counts it with the subscription or sink that misses it. The
/// publishing side takes no lock and allocates nothing; the other side is woken once a turn, or earlier when much was
/// published. Only payloads that are trivially copyable cross: to subscribe to others on another loop is a SetupError,
/// or is reported when it is done by name.
///
/// Without permission for its policy, priority, memory lock or processor a tier runs all the same; `warnings` says what
/// to set, and so does the log.
///
/// Objects are made on the tier's loop before it runs, or in `call`. Closing a handle, and every verb of a sensor, may
/// be called on the main loop's thread while the tier runs: they wait for the tier to do it. All else is for `call`.
/// A tier that does not turn refuses verbs as `call` does, and one that has begun with a verb and does not come back
/// from it for 1 s is not waited for either: the error says so, and the verb may still be done. What is asked for is
/// then what the main loop knows last, and faulted. Closing waits for 5 s; then the tier does it as soon as it turns,
/// which is reported: what the callbacks of the handle refer to must live until then.
///
/// A tier of which a callback never returns does not keep `Loop::close` from closing the recordings: they are marked as
/// incomplete, with the callback's name and the time up to which the tier's account is known.
///
/// On a manual loop a tier shares its virtual time, and runs whenever the main loop's thread waits: in `advance`,
/// `run`, `close`, `call`, `stop`, and in `ManualClock::pass`. One of them runs at a time, in an order that
/// `Loop::Manual` chooses. A callback there must wait for another loop in no other way (`manual_clock().pass(1ms)`
/// until it is so), nor hold a lock that another one takes while it posts. `policy`, `cpus` and the like mean nothing.
///
/// Owner: the user; must be destroyed before its main loop, after the handles made on it or not; in a callback of the
/// main loop too, but not in one of its own, nor on another thread, nor in a call of a sink's Writer: that ends the
/// program, having said so. Thread: the main loop's.
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
    int priority = 0;            ///< 1 to 99 for real-time policies
    std::vector<int> cpus = {};  ///< processors that it may run on; empty: any
    bool lock_memory = true;     ///< with a real-time policy: mlockall, so that no page of the process is swapped out
    std::size_t stack = 256 * 1024;  ///< bytes of its stack touched at the start, so that they are there
    bool keep_cpu_awake = false;  ///< /dev/cpu_dma_latency 0 while it runs: less lateness, more power, all processors
    Duration spin{0};  ///< wait so long, to 10 ms, before a deadline spinning: costs as much of a processor a tick
    Duration hold_limit = Loop::Config{}.hold_limit;
    Duration delivery_budget = Loop::Config{}.delivery_budget;
    Duration phase_grid = Loop::Config{}.phase_grid;
    Duration timer_slack = Loop::Config{}.timer_slack;
    std::size_t ring_bytes = std::size_t{1} << 20;  ///< of each ring from and to another loop; 1024 or more
  };

  /// SetupError (busy): tiers of this main loop run already, so that others cannot be made; (bad-argument): `main`
  /// belongs to a tier; a priority, a spin or a processor out of range; a name that is taken; (bad-name): a name that
  /// is empty, longer than 200 characters or has control characters.
  Tier(Loop& main, Config config);
  /// Stops it. A callback that does not return is waited for without limit, since it may use what is destroyed next;
  /// the log says which it is.
  ~Tier();
  Tier(const Tier&) = delete;
  Tier& operator=(const Tier&) = delete;

  Loop& loop() noexcept;
  const Config& config() const noexcept;

  /// Begins to turn. The main loop's `run` does it too, and does not return by itself while a tier runs.
  void start();
  /// Ends its thread after the callback under way; nothing is drained, and its objects stay. May be started again. In
  /// one of its own callbacks, or in a call of a sink's Writer: asks for it, and returns.
  void stop() noexcept;
  /// The same, but waits no longer than this for the callback. False: it hangs there, see `doing`, and the tier ends
  /// when it returns. A program that must end all the same calls std::_Exit, since destroying anything on the tier
  /// waits for it.
  bool stop_within(Duration at_most) noexcept;
  /// The callback that it began last, "sensor chamber" or "handler of room/#"; empty: none, or one that has no name or
  /// is gone. Any thread.
  std::string doing() const;
  bool is_running() const noexcept;

  /// Runs `function(loop())` on the tier's thread, waits for it and returns what it returns; at once while the tier
  /// does not run, and in its own callbacks. What it throws is thrown here. SetupError (not-turning): the tier has not
  /// come out of a callback for 1 s, and the function is never called; at once when that is known already. A function
  /// that has begun is waited for. SetupError (busy) in a call of a sink's Writer, which may hold what the tier waits
  /// for.
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

  /// What it runs with, once started.
  Scheduling scheduling() const noexcept;
  /// What was asked for and not granted, and what to set for it.
  const std::vector<std::string>& warnings() const noexcept;

 private:
  void call_erased(Callback<void()> function);
  std::unique_ptr<detail::TierCore> core_;
};

/// Looks, as long as it lives, whether every running tier of a main loop turns.
///
///     rtdata::TierWatch watch(loop);
///     rtdata::Ticker feed(loop, 1s, [&](const rtdata::Tick&) { if (watch.all_turn()) feed_the_watchdog(); });
///
/// It asks each tier four times in a limit. One that has not answered for longer than the limit, since a callback does
/// not return or its processor is taken, is reported by name (not-turning) and becomes faulted in `$rtdata/health`,
/// until it answers.
///
/// Owner: the user; must be destroyed before its loop. It keeps the loop's `run` from returning. Thread: the loop's.
class TierWatch {
 public:
  /// SetupError (bad-argument): less than 1 ms.
  explicit TierWatch(Loop& main, Duration limit = std::chrono::seconds{1});
  TierWatch(const TierWatch&) = delete;
  TierWatch& operator=(const TierWatch&) = delete;

  /// As of the last look.
  bool all_turn() const noexcept { return *all_turn_; }

 private:
  std::shared_ptr<bool> all_turn_;  // with the ticker's callback, which may be on the stack when this goes
  Ticker ticker_;
};

}  // namespace rtdata
