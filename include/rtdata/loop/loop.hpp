/// Loop: one libuv loop, its time, its callbacks.
///
///     rtdata::Loop loop;                                    // owns a uv_loop_t
///     rtdata::Ticker tick(loop, 10ms, [](const rtdata::Tick& t) { ... });
///     loop.run_for(1s);
///
/// A Loop owns a `uv_loop_t`, is attached to the host program's, or (for tests) runs in virtual time. It handles
/// deadlines, file descriptors, deliveries of topics and `post`; it knows nothing about sensors. One absolute
/// CLOCK_MONOTONIC timerfd serves all its deadlines. A Loop makes a private Runtime unless it is given one.
///
/// Order within one turn: deadlines that are due, then I/O, then deliveries within a time budget. A tick is late by at
/// most the budget plus one group of callbacks (fast handlers: at most 128, expected to take under 5 us together; slow
/// handlers: one). Functions passed to `post` have a budget of the same length, so that many of them do not delay
/// ticks.
///
/// While the loop does not run, making an object waits until its device or recording is open, and throws if that fails.
/// While the loop runs nothing waits: the object opens on a lane, events are queued meanwhile, and an error is
/// reported. An owned loop runs within `run`, `run_for`, `poll` and `advance`, not between two such calls: a program
/// that polls should make objects in `post`. An attached loop runs from the end of its first turn in the host's
/// `uv_run` to its end: objects made before wait, objects made later in callbacks of the host do not.
///
/// Times and durations are ns in 64 bits. Their sums saturate, so Duration::max() means never, or without limit.
///
/// Owner: the user. It may be destroyed before its handles, which then become closed. Not movable. Do not destroy it in
/// one of its own callbacks, before its tiers, or while another thread runs it: that ends the program (std::abort) with
/// a message on stderr. While it is being destroyed, making an object on it or setting a handler throws SetupError
/// (busy). Thread: the one that runs it. From other threads, and from a sink's Writer: `post` and `stop` only.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/event.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/loop/callback.hpp"
#include "rtdata/loop/clock.hpp"

struct uv_loop_s;
typedef struct uv_loop_s uv_loop_t;

namespace rtdata {

class Runtime;
class Subscription;
template <class T>
class Topic;

namespace detail {
class LoopCore;
}

/// The longest duration of one reading if the device works.
struct ReadTime {
  std::optional<Duration> on_loop = {};  ///< it holds the loop; unset: not known
  std::optional<Duration> on_lane = {};  ///< it holds its lane; unset: not known, or it uses none
  std::string lane = {};                 ///< one for each physical device; empty: it is read on the loop
};

/// The data of a sensor for the load estimate.
struct SensorLoad {
  std::string name = {};
  Duration period{0};                  ///< 0: no schedule
  std::optional<Duration> phase = {};  ///< unset: not known
  ReadTime time = {};
};

struct LaneLoad {
  std::string lane = {};
  std::size_t sensors = 0;   ///< with a schedule
  std::size_t declared = 0;  ///< how many of these declare how long they hold it
  double share = 0;          ///< share of the lane's time; above 1 is impossible

  bool is_overloaded() const noexcept;
  /// "lane adc0: 3 sensors, 45 % (2 of 3 declared)"
  std::string text() const;
};

/// How long the sensors of a loop may hold it, estimated before it runs from the times that the drivers declare.
///
///     rtdata::Tier fast(loop, {.name = "fast"});
///     rtdata::Sensor<Pressure> chamber(fast.loop(), {.name = "chamber", .rate = 1_kHz, .read_time = 200us}, read_adc);
///     const rtdata::LoopLoad load = fast.loop().load();
///     if (load.is_overloaded()) complain(load.text());  // "fast: 1 sensor, worst 200 us of 1 ms, 20 %"
///
/// `worst` is the sum of the reads that may come due within the loop's shortest period: each sensor once. Of sensors
/// with the same longer period, only those with phases within one shortest period of each other are added. Sensors with
/// different periods, without a schedule or not running are assumed to coincide. A read on a lane counts for the lane;
/// on the loop, only its decoding counts, with its share of the shortest period. Handlers are not counted.
struct LoopLoad {
  static constexpr double most = 0.8;  ///< a greater share is an overload: the rest is for other work

  std::string loop = {};
  std::size_t sensors = 0;   ///< sensors that are read, on the loop or on a lane
  std::size_t declared = 0;  ///< how many of these declare how long they hold the loop; the others are not in `worst`
  Duration worst{0};
  Duration period{0};  ///< the shortest period; 0: no sensor has a schedule
  double busy = 0;     ///< share of the loop's time that all readings take in the long run
  std::vector<LaneLoad> lanes = {};

  /// worst / period, or `busy` if that is greater; 0 without a schedule.
  double share() const noexcept;
  /// True if the readings need too much of the loop's time on average, whatever their phases.
  bool is_too_busy() const noexcept { return busy > most; }
  bool is_overloaded() const noexcept { return share() > most; }
  /// "fast: 3 sensors, worst 1.4 ms of 2 ms, 70 % (2 of 3 declared)"
  std::string text() const;
};

LoopLoad estimate_load(std::string loop, std::span<const SensorLoad> sensors);

/// An error with its source, as passed to `on_error`.
struct ErrorReport {
  std::string_view object;  ///< "sensor chamber", "sink run.db", "handler print"
  const Error& error;
  std::uint64_t count = 1;  ///< number of such errors since the last report (repeats within a second are joined)
};

class Loop {
 public:
  struct Config {
    std::string name = "main";                                ///< in log lines
    Duration delivery_budget = std::chrono::milliseconds{1};  ///< time for handlers before ticks are checked again
    Duration hold_limit = std::chrono::milliseconds{10};      ///< a callback that takes longer is reported by its name
    Duration phase_grid = std::chrono::milliseconds{1};       ///< schedules start on its multiples; 0: none
    Duration spin{0};         ///< busy-wait for this long before a deadline: exact, but uses a processor
    Duration timer_slack{1};  ///< PR_SET_TIMERSLACK of the running thread while run() runs; 0: leave it
  };
  /// How a manual loop and its tiers are interleaved; repeatable for the same seed.
  struct Manual {
    /// 0: a fixed order, without delays. Other values: the seed chooses the order of things at one instant, and adds
    /// delays to work of other threads (see `jitter`).
    std::uint64_t seed = 0;
    /// Used only with a seed: the longest random delay of data between two loops, and the longest random extra time of
    /// a job on a lane (never beyond the job's limit).
    Duration jitter = std::chrono::milliseconds{1};
  };
  static constexpr std::size_t post_backlog = 10'000;  ///< functions given to `post` that may wait without a report

  Loop();
  explicit Loop(Config config);
  /// Attached to `host`, which must outlive this object and must run once more afterwards, so that libuv can finish
  /// closing our handles. It changes nothing of the host's.
  explicit Loop(uv_loop_t* host);
  Loop(uv_loop_t* host, Config config);
  /// Virtual time, starting at 0 and moved by `advance` only, for it and all its tiers.
  explicit Loop(Manual manual);
  Loop(Manual manual, Config config);
  /// As above, sharing `runtime`, which must outlive the loop.
  Loop(Runtime& runtime, Config config);
  ~Loop();
  Loop(const Loop&) = delete;
  Loop& operator=(const Loop&) = delete;

  /// Runs until `stop`, or until there is nothing left to wait for; returns at once if `stop` was called since the last
  /// run. An attached loop is run by its host (SetupError otherwise). SetupError (busy) if called from one of its
  /// callbacks, also from a callback outside `run` (such as `open` of a device, or a report about it); the same for
  /// `run_for`, `poll` and `advance`.
  void run();
  /// Runs for `duration` (of virtual time on a manual loop), or until `stop`. Deadlines at the very end still fire.
  void run_for(Duration duration);
  /// Runs everything that is due, posted or readable now, without waiting, and returns.
  void poll();
  /// Ends `run`. Thread-safe. On an attached loop: nothing.
  void stop() noexcept;
  /// Manual loops: lets time pass and runs deadlines in order of time, then of start. An endless chain at one instant
  /// does not stop time: handlers that publish for each other get 100 rounds at one instant, and after 1000 turns at
  /// one instant (a zero timer that restarts itself) each further turn takes 1 us. Running tiers also run their
  /// deadlines; without a seed, this loop has received everything that they sent when this returns.
  void advance(Duration duration);
  /// Manual loops: the clock, to let a callback "take" time or to set the time of day. SetupError on other loops.
  ManualClock& manual_clock();
  /// Manual loops: how long each lane job is to take.
  void script_lane_duration(Duration duration);

  /// Runs the function on this loop, after those posted before. Any thread; allocates; blocks for one short lock at
  /// most. The queue has no limit, so that no function is lost, but it is counted: `LoopStatus::posts` has the numbers
  /// posted, run and waiting, and the loop reports (backlog) more than `Loop::post_backlog` waiting functions. In one
  /// turn the loop runs them for `delivery_budget` at most and continues in its next turn, after the deadlines. A loop
  /// that is being destroyed destroys the function without running it.
  void post(Callback<void()> function);

  MonotonicTime now() noexcept;
  /// The time for an event at this instant: ns since the epoch, on a clock that never jumps within the run.
  Time time() noexcept;
  Runtime& runtime() noexcept;
  const Config& config() const noexcept;
  /// Handles put on a loop that we own must be closed before it is destroyed.
  uv_loop_t* uv() noexcept;

  /// The topic of that name, made if there is none. SetupError (description-differs) when it exists with another
  /// description, naming both; (bad-name) when the path is not a topic name.
  template <class T>
  Topic<T> topic(std::string_view name);
  /// Calls `handler` with every event of the topics that match (`+` one level, `#` all below; topics under `$` are
  /// matched only when written out), also of topics made later.
  [[nodiscard]] Subscription subscribe(std::string_view pattern, Callback<void(const EventView&)> handler);
  /// The same with a typed handler: the fields of T are found by name in each matching topic, once. A topic without one
  /// of the fields, or with another kind or unit, is reported and skipped; if `pattern` is the exact name of an
  /// existing topic, this throws.
  template <class T, class F>
  [[nodiscard]] Subscription subscribe(std::string_view pattern, F&& handler);

  /// Sets the handler for run-time errors of objects without their own `on_error`. Default: the runtime's log. A loop
  /// that is being destroyed no longer calls it; `drain` and `close` report the errors that were held back.
  void on_error(Callback<void(const ErrorReport&)> handler);

  /// The callback times of the objects on this loop, in the order in which the objects were made. A sensor counts its
  /// reads on the loop, not those on its lane.
  std::vector<CallbackStatus> callbacks() const;
  /// How long the sensors on this loop may hold it, from the times that their devices or configurations declare: see
  /// LoopLoad. For a running tier, call it in `Tier::call`.
  LoopLoad load() const;

  /// Stops every sensor (running reads may finish), lets every sink store its queue, writes and closes the ledger, then
  /// calls `done` with the number of events that could not be stored by the deadline. For attached loops; `close` is
  /// the blocking version for owned ones.
  void drain(Duration deadline, Callback<void(std::uint64_t lost)> done);
  /// See `drain`. Returns the number of lost events; if `stop` ended the wait, this includes the events still queued.
  /// SetupError: busy (from a callback of this loop), bad-argument (on an attached loop). `close` and `drain` throw
  /// std::bad_alloc if there is no memory to begin: then call it again, or let the destructor close the rest.
  std::uint64_t close(Duration deadline = std::chrono::seconds{10});

  detail::LoopCore& core() noexcept { return *core_; }

 private:
  std::unique_ptr<Runtime> own_runtime_;
  std::unique_ptr<detail::LoopCore> core_;
};

}  // namespace rtdata

#include "rtdata/loop/topic.hpp"
