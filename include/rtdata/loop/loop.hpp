/// Loop: one libuv loop, its time, its callbacks.
///
///     rtdata::Loop loop;                                    // owns a uv_loop_t
///     rtdata::Ticker tick(loop, 10ms, [](const rtdata::Tick& t) { ... });
///     loop.run_for(1s);
///
/// A Loop owns a `uv_loop_t`, borrows the host program's, or (for tests) runs in virtual time. It knows deadlines, file
/// descriptors, topics' deliveries and `post`; nothing of sensors. One absolute CLOCK_MONOTONIC timerfd serves all its
/// deadlines. A Loop makes a private Runtime unless it is given one.
///
/// Order within one turn: what is due, then I/O, then deliveries under a time budget. A tick is late by at most the
/// budget plus one group of callbacks (handlers that took nanoseconds: at most 128, expected to take under 5 us
/// together; slower ones: one). Functions given to `post` have a budget of the same length: a flood of them does not
/// hold ticks.
///
/// While the loop does not run, what is made on it waits for its opening (of a device on a lane, of a recording), and
/// reports what failed. While it runs nothing waits: the opening goes on on a lane, what comes meanwhile is queued, and
/// an error is reported. A loop of its own runs within `run`, `run_for`, `poll` and `advance`, and not between two
/// calls of these: a program that polls should make things in `post`, where nothing waits. An attached loop runs from
/// the end of its first turn, in which the host's `uv_run` has called it back, to its end: what is made before waits,
/// what is made in callbacks of the host later does not.
///
/// Instants and spans are ns in 64 bits. Sums of them saturate: what would come after the end of time is due at its
/// end, which never comes, so that Duration::max() means never, or without limit.
///
/// Owner: the user; it must outlive nothing: handles that outlive it become closed. Not movable. Destroying it in one
/// of its own callbacks, before its tiers, or while another thread runs it ends the program (std::abort) with a message
/// on stderr. While it is destroyed, nothing can be made on it, and no handler set (SetupError, busy).
/// Thread: the one that runs it. From other threads, and from a sink's Writer: `post` and `stop` only.
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

/// How long one reading takes at most while the device is well.
struct ReadTime {
  std::optional<Duration> on_loop = {};  ///< it holds the loop; unset: not known
  std::optional<Duration> on_lane = {};  ///< it holds its lane; unset: not known, or it uses none
  std::string lane = {};                 ///< one for each physical device; empty: it is read on the loop
};

/// What the estimate needs of a sensor.
struct SensorLoad {
  std::string name = {};
  Duration period{0};                  ///< 0: no schedule
  std::optional<Duration> phase = {};  ///< unset: not known
  ReadTime time = {};
};

struct LaneLoad {
  std::string lane = {};
  std::size_t sensors = 0;   ///< with a schedule
  std::size_t declared = 0;  ///< of these, how many say how long they hold it
  double share = 0;          ///< of the lane's time; above 1 it cannot be done

  bool is_overloaded() const noexcept;
  /// "lane adc0: 3 sensors, 45 % (2 of 3 declared)"
  std::string text() const;
};

/// How long the sensors of a loop may hold it, estimated before it runs from what their drivers declare.
///
///     rtdata::Tier fast(loop, {.name = "fast"});
///     rtdata::Sensor<Pressure> chamber(fast.loop(), {.name = "chamber", .rate = 1_kHz, .read_time = 200us}, read_adc);
///     const rtdata::LoopLoad load = fast.loop().load();
///     if (load.is_overloaded()) complain(load.text());  // "fast: 1 sensor, worst 200 us of 1 ms, 20 %"
///
/// `worst` is the sum of the reads that come due within the loop's shortest period: each sensor once, but of sensors
/// that share a longer period only those whose phases lie within one shortest period of each other. Sensors of
/// different periods, without a schedule or not running are assumed to coincide. A read on a lane counts for the lane;
/// it holds the loop only while it is decoded, at another time for each sensor, and so counts there with its share of
/// the shortest period. Handlers are not counted.
struct LoopLoad {
  static constexpr double most = 0.8;  ///< above it a loop or lane is overloaded: the rest is for all else

  std::string loop = {};
  std::size_t sensors = 0;   ///< that are read, on the loop or on a lane
  std::size_t declared = 0;  ///< of these, how many say how long they hold the loop; the others are not in `worst`
  Duration worst{0};
  Duration period{0};  ///< the shortest; 0: nothing has a schedule
  double busy = 0;     ///< share of the loop's time that all readings take in the long run
  std::vector<LaneLoad> lanes = {};

  /// worst / period; 0 without a schedule. No less than the share of time that all readings take in the long run.
  double share() const noexcept;
  /// The readings take more of the loop's time than there is to spare, whenever they come.
  bool is_too_busy() const noexcept { return busy > most; }
  bool is_overloaded() const noexcept { return share() > most; }
  /// "fast: 3 sensors, worst 1.4 ms of 2 ms, 70 % (2 of 3 declared)"
  std::string text() const;
};

LoopLoad estimate_load(std::string loop, std::span<const SensorLoad> sensors);

/// Where an error came from and how it reads, as `on_error` gets it.
struct ErrorReport {
  std::string_view object;  ///< "sensor chamber", "sink run.db", "handler print"
  const Error& error;
  std::uint64_t count = 1;  ///< how often since the last report of the same kind (repeats within a second are joined)
};

class Loop {
 public:
  struct Config {
    std::string name = "main";                                ///< in log lines
    Duration delivery_budget = std::chrono::milliseconds{1};  ///< of handlers, before ticks are looked at again
    Duration hold_limit = std::chrono::milliseconds{10};      ///< a callback that takes longer is reported by its name
    Duration phase_grid = std::chrono::milliseconds{1};       ///< schedules start on its multiples; 0: none
    Duration spin{0};  ///< the last stretch before a deadline is waited for spinning: exact, and costs a processor
    Duration timer_slack{1};  ///< PR_SET_TIMERSLACK of the running thread while run() runs; 0: leave it
  };
  /// How a manual loop and its tiers are interleaved, the same for the same seed.
  struct Manual {
    /// 0: in a fixed order, without delays. Any other: what can happen at one instant happens in an order that the seed
    /// chooses, and what threads would do a little later may happen later, see `jitter`.
    std::uint64_t seed = 0;
    /// With a seed, the longest delay after which a loop sees what another one has sent, in its order, and by which a
    /// lane's job takes longer, within its limit.
    Duration jitter = std::chrono::milliseconds{1};
  };
  static constexpr std::size_t post_backlog = 10'000;  ///< functions given to `post` that may wait without a report

  Loop();
  explicit Loop(Config config);
  /// Borrows `host`, which must live until this object is destroyed and be run once more after that, so that libuv can
  /// finish closing our handles. Nothing of the host's is touched.
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

  /// Runs until `stop`, or until nothing is left that could happen; at once when `stop` was called since the last run.
  /// On an attached loop the host runs it instead (SetupError otherwise). SetupError (busy) when called from one of its
  /// callbacks, also from those that are called while it does not run (`open` of a device that is made, a report of
  /// that), as for `run_for`, `poll` and `advance`.
  void run();
  /// Runs for `duration` (of virtual time on a manual loop), or until `stop`. What is due at the very end still
  /// happens.
  void run_for(Duration duration);
  /// Runs what is due, posted or readable now, without waiting, and returns.
  void poll();
  /// Ends `run`. Thread-safe. On an attached loop: nothing.
  void stop() noexcept;
  /// Manual loops: lets time pass, and runs what comes due in order of time, then of start. An endless chain at one
  /// instant does not stop the time: handlers that publish for each other get 100 rounds at an instant, and after 1000
  /// turns at one instant (a timer of zero that starts itself) each further turn takes 1 us. Tiers that run do what
  /// comes due on them; without a seed, all that they send by then has been taken when this returns.
  void advance(Duration duration);
  /// Manual loops: the clock, to let a callback "take" time or to set the time of day. SetupError on others.
  ManualClock& manual_clock();
  /// Manual loops: how long each lane job is to take.
  void script_lane_duration(Duration duration);

  /// Runs the function on this loop, after those posted before. Any thread; allocates; blocks for one short lock at
  /// most. The queue has no limit, so that no function is lost: it is counted instead. `LoopStatus::posts` says how
  /// many were posted, were run and wait, and the loop reports (backlog) more than `Loop::post_backlog` waiting ones.
  /// In one turn the loop runs them for `delivery_budget` at most, and goes on with the others in its next turn, after
  /// what came due. A loop that is being destroyed destroys the function unrun.
  void post(Callback<void()> function);

  MonotonicTime now() noexcept;
  /// The time that an event gets at this instant: ns since the epoch on a line that never jumps within the run.
  Time time() noexcept;
  Runtime& runtime() noexcept;
  const Config& config() const noexcept;
  /// Handles put on a loop that we own must be closed before it is destroyed.
  uv_loop_t* uv() noexcept;

  /// The topic of that name, made if there is none. SetupError (description-differs) when it exists with another
  /// description, naming both; (bad-name) when the path is no topic name.
  template <class T>
  Topic<T> topic(std::string_view name);
  /// Calls `handler` with every event of the topics that match (`+` one level, `#` all below; topics under `$` are
  /// matched only when written out), also of topics made later.
  [[nodiscard]] Subscription subscribe(std::string_view pattern, Callback<void(const EventView&)> handler);
  /// The same with a typed handler: the fields of T are found by name in each matching topic, once. A topic that lacks
  /// one, or has it with another kind or unit, is reported and left out; an exact name that exists already throws.
  template <class T, class F>
  [[nodiscard]] Subscription subscribe(std::string_view pattern, F&& handler);

  /// Called with each error met at run time whose object has no `on_error` of its own. Default: the runtime's log. A
  /// loop that is being destroyed does not call it any more; `drain` and `close` report the errors that were held back.
  void on_error(Callback<void(const ErrorReport&)> handler);

  /// The times that callbacks of the objects on this loop took, in the order in which the objects were made. A sensor
  /// counts its reads on the loop, not those on its lane.
  std::vector<CallbackStatus> callbacks() const;
  /// How long the sensors on this loop may hold it, by what their devices or configurations say: see LoopLoad. Of a
  /// tier that runs, ask in `Tier::call`.
  LoopLoad load() const;

  /// Stops every sensor (reads under way may finish), hands every sink what is queued, closes and writes the ledger,
  /// then calls `done` with the number of events that could not be stored by the deadline. For attached loops; `close`
  /// is the same, blocking, for owned ones.
  void drain(Duration deadline, Callback<void(std::uint64_t lost)> done);
  /// See `drain`. Returns the number of events lost; when `stop` ended the wait, of those still queued. SetupError from
  /// a callback of this loop (busy) and on an attached one (bad-argument). std::bad_alloc when there is no memory to
  /// begin with, as of `drain`: then it may be called again, and what is not closed by then closes when it is
  /// destroyed.
  std::uint64_t close(Duration deadline = std::chrono::seconds{10});

  detail::LoopCore& core() noexcept { return *core_; }

 private:
  std::unique_ptr<Runtime> own_runtime_;
  std::unique_ptr<detail::LoopCore> core_;
};

}  // namespace rtdata

#include "rtdata/loop/topic.hpp"
