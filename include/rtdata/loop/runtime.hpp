/// Runtime: the shared state of loops: topics, the ledger, the clock, the run, the log, and the exchange between loops.
///
/// A Loop makes a private one unless it is given one; one loop at a time uses it. Nothing is global to the process.
///
/// The main loop's runtime knows all its tiers: it has a copy of each of their topics, sensors and losses, received
/// over the rings between the loops. A tier's own runtime, `tier.loop().runtime()`, holds the tier's sensors and
/// subscriptions and the topics that other loops announced; it knows no sinks and no other loops. Only the tier's
/// thread may use it.
///
/// Owner: the user, or the loop that made it. It must outlive its loop: destroying it earlier, or in its own `on_log`,
/// ends the program (std::abort) with a message. Thread: the loop's.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/description.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/data/text.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/loop/callback.hpp"
#include "rtdata/loop/clock.hpp"
#include "rtdata/loop/ledger.hpp"

namespace rtdata {

class OutputGuard;

namespace detail {
class RuntimeCore;
}

enum class LogLevel : std::uint8_t { debug, info, warning, error };

/// One line for the log. Valid for the call.
struct LogRecord {
  LogLevel level = LogLevel::info;
  Time time{};
  std::string_view object;  ///< "sensor chamber"
  std::string_view text;
  std::string_view error_id;  ///< stable id; empty if it is not an error
};

/// The health of a sensor, sink, lane, loop or tier.
enum class Health : std::uint8_t { ok, degraded, faulted };
std::string_view name_of(Health health) noexcept;

inline constexpr const char* health_topic = "$rtdata/health";

constexpr auto describe(type_tag<Health>) {
  return enumeration("health_state", value("ok", Health::ok), value("degraded", Health::degraded),
                     value("faulted", Health::faulted));
}

/// A change of health of a part of a system, as an event:
///
///     auto s = loop.subscribe<rtdata::HealthChange>("$rtdata/health", [](const rtdata::Event<rtdata::HealthChange>& e)
///     {
///       if (e->state == rtdata::Health::faulted) alarm(e->kind, e->name, e->reason);
///     });
///
/// One event for each change between ok, degraded and faulted, on any tier; its time is that of the change. `#` does
/// not match the topic; a sink must name it to record it. SQLite recordings always keep the changes, in the table
/// rtdata_health.
///
/// By kind: the name in the event, and what the states mean:
///   sensor   its name.            degraded: reads fail. faulted: closed, and tried again now and then; or stopped by
///                                 `on_overrun`.
///   sink     its name.            faulted: it cannot store.
///   lane     the device or bus.   degraded: a job was given up, its thread abandoned. faulted: no thread is left to
///                                 run jobs.
///   loop     its or the tier's.   degraded: held longer than its limit in the last 10 s.
///   tier     its name.            faulted: it does not turn (see TierWatch).
struct HealthChange {
  text<16> kind;
  text<200> name;
  Health state = Health::ok;
  text<96> reason;  ///< a longer one is cut and ends with "..."; empty if ok
  friend constexpr auto describe(type_tag<HealthChange>) {
    return record("health", field("kind", &HealthChange::kind, ""), field("name", &HealthChange::name, ""),
                  field("state", &HealthChange::state, ""), field("reason", &HealthChange::reason, ""));
  }
};

struct SensorStatus {
  std::string name;
  std::string topic;
  Duration period{0};
  bool running = false;
  Health health = Health::ok;
  std::string reason;  ///< why it is not ok
  SensorCounts counts;
  std::string loop = {};  ///< the name of the loop or tier that it is on
  Time first_due{};       ///< ticks are due at first_due + n * period; valid only while running
  Outages outages = {};   ///< without a schedule; a current one counts up to now
};

/// The functions passed to `Loop::post` of one loop: each was run or waits.
struct PostCounts {
  std::uint64_t posted = 0;
  std::uint64_t run = 0;
  std::uint64_t most_waiting = 0;  ///< when the loop began to run them

  std::uint64_t waiting() const noexcept { return posted - run; }
};

enum class SchedulingPolicy : std::uint8_t {
  other,        ///< SCHED_OTHER: shares the processor fairly
  fifo,         ///< SCHED_FIFO: runs until it waits, before all of lower priority
  round_robin,  ///< SCHED_RR: as fifo, taking turns with those of its priority
};
std::string_view name_of(SchedulingPolicy policy) noexcept;

/// The policy and priority of a thread, as the kernel keeps them (sched(7)). The functions act on the calling thread.
///
///     rtdata::PriorityRange range = rtdata::priority_range(rtdata::SchedulingPolicy::fifo);   // 1 to 99
///     if (auto set = rtdata::set_scheduling({rtdata::SchedulingPolicy::fifo, 80}); !set)
///       std::cerr << set.error().text_with_id();
///
/// Real-time policies need permission: run as root, or with CAP_SYS_NICE (`setcap cap_sys_nice,cap_ipc_lock+ep
/// PROGRAM`), or with `rtprio` in /etc/security/limits.conf, or `LimitRTPRIO=` in a systemd unit.
struct Scheduling {
  SchedulingPolicy policy = SchedulingPolicy::other;
  int priority = 0;  ///< 0 for `other`, else within `priority_range`
};

struct PriorityRange {
  int lowest = 0;
  int highest = 0;
};
PriorityRange priority_range(SchedulingPolicy policy) noexcept;

/// The scheduling of the calling thread.
Scheduling current_scheduling() noexcept;

/// Sets the scheduling of the calling thread. Threads that it creates afterwards start as SCHED_OTHER
/// (SCHED_RESET_ON_FORK). Errors: not-permitted (the error gives the needed setting), bad-argument (the priority is out
/// of range).
Result<void> set_scheduling(Scheduling scheduling) noexcept;

/// A loop or tier, and the thread that it runs on.
struct LoopStatus {
  std::string name;
  bool is_tier = false;
  bool running = false;
  Scheduling scheduling;                   ///< as the kernel granted it
  Duration processor_time{0};              ///< processor time of its thread so far
  std::vector<std::string> warnings = {};  ///< settings of the thread that the kernel refused
  PostCounts posts = {};                   ///< up to now, also while the tier runs
};

struct TopicDrops {
  std::string topic;
  std::uint64_t count = 0;
};

/// The events that wait in the recording for a sink with `through`: `SinkCounts::queued` events.
struct Backlog {
  std::uint64_t bytes = 0;  ///< of their payloads
  Time oldest{};            ///< the time of the oldest of them; 0: nothing waits
  Duration age{0};          ///< how long that one has waited
  /// Time until nothing waits, at the speed of the last seconds; empty: the backlog does not shrink.
  std::optional<Duration> catch_up = {};
};

struct SinkStatus {
  std::string name;
  Health health = Health::ok;
  std::string reason;
  SinkCounts counts;
  std::vector<TopicDrops> dropped;  ///< for all reasons, one entry for each topic with losses
  /// For a sink with `through`, after it has read its recording; empty: its events wait in memory.
  std::optional<Backlog> backlog = {};
};

struct TopicStatus {
  std::string name;
  std::shared_ptr<const Description> description;  ///< null for a payload without one
  std::uint64_t published = 0;
  SubscriptionCounts subscriptions;  ///< summed
};

/// A change of the configuration during a run, as stored in recordings (rtdata_configuration).
struct ConfigurationChange {
  Time time{};
  std::string object;  ///< "sensor chamber": the part that was added, changed or removed; empty: all
  std::string text;    ///< the new text of the part or of all; empty: the part was removed
};

class Runtime {
 public:
  struct Config {
    std::string name = {};           ///< of the set-up; kept in recordings
    std::string notes = {};          ///< the user's; kept in recordings
    std::string configuration = {};  ///< the text of the file it was made from; kept in recordings
    /// Texts that errors, log records and reasons of health must not show: they show "(secret)" instead.
    std::vector<std::string> secrets = {};
    Clock* clock = nullptr;          ///< null: the machine's. Must outlive the runtime.
    OutputGuard* guard = nullptr;    ///< holds the outputs' devices; null: none. Must outlive the runtime.
    std::size_t ring_events = 1024;  ///< capacity of each topic's delivery ring, rounded up to a power of two
  };
  Runtime();
  explicit Runtime(Config config);
  ~Runtime();
  Runtime(const Runtime&) = delete;
  Runtime& operator=(const Runtime&) = delete;

  const Config& config() const noexcept;
  /// Where log records go. Default: warnings and errors to standard error, a line each.
  void on_log(Callback<void(const LogRecord&)> handler);
  /// Records the time of a time source (GPS, PPS, a radio clock) at an instant of the monotonic clock. It sets no
  /// clock: recordings store the pair and derive the UTC of their rows from the most accurate pairs.
  ///
  ///     loop.runtime()
  ///         .note_wall_clock({.monotonic = at, .realtime = utc, .source = "gps", .accuracy = 1us})
  ///         .or_throw();
  ///
  /// Call it as often as the source gives a time: only new information is stored, at most once in 10 s for each source.
  /// `occasion` is ignored. Errors: bad-name (empty, over 64 characters, "system"), bad-argument (an accuracy that is
  /// not positive; a 17th source).
  Result<void> note_wall_clock(const ClockPair& pair);

  /// Notes the place (file, line, path) that configures the object of that name ("sensor chamber"): reports of
  /// callbacks that held the loop name it. A system made from a configuration file notes the places of its sensors and
  /// sinks.
  void note_place(std::string object, std::string place);

  std::vector<SensorStatus> sensors() const;
  /// The status of all sinks; first those that were closed in this run.
  std::vector<SinkStatus> sinks() const;
  std::vector<TopicStatus> topics() const;
  /// The runtime's own first, then its tiers.
  std::vector<LoopStatus> loops() const;
  /// True if every equation of the ledger holds now. False while the account of a tier is unknown: the tier did not
  /// stop within the deadline of a drain (which was reported) and has not stopped since. Here and in `has_loss`, a
  /// running tier counts with its state at the last drain of the main loop.
  bool balances() const;
  /// True if anything was missed, failed or lost: a tick, a sample, an outage of a source without a schedule, an event
  /// dropped by a sink or by a subscription on a tier, or data that could not be taken over from a tier (which was
  /// reported).
  bool has_loss() const;

  detail::RuntimeCore& core() noexcept { return *core_; }

 private:
  std::unique_ptr<detail::RuntimeCore> core_;
};

}  // namespace rtdata
