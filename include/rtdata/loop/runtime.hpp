/// Runtime: what a loop has beside its turns: topics, the ledger, the clock, the run, the log, and the exchange with
/// others.
///
/// A Loop makes a private one unless it is given one; one loop at a time uses it. Nothing is global to the process.
///
/// The main loop's runtime knows all its tiers: it has a copy of each of their topics, sensors and losses, which come
/// over the rings between the loops. A tier's own runtime, `tier.loop().runtime()`, holds the tier's sensors and
/// subscriptions and the topics that other loops announced to it; no sink, and no other loop. Only the tier's thread
/// may use it.
///
/// Owner: the user, or the loop that made it; it must outlive its loop: destroying it before, or in its own `on_log`,
/// ends the program (std::abort), having said so. Thread: the loop's.
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/description.hpp"
#include "rtdata/loop/callback.hpp"
#include "rtdata/loop/clock.hpp"
#include "rtdata/loop/ledger.hpp"
#include "rtdata/loop/scheduling.hpp"

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
  std::string_view error_id;  ///< stable id, empty when it is no error
};

/// Whether a sensor, sink, lane, loop or tier works.
enum class Health : std::uint8_t { ok, degraded, faulted };
std::string_view name_of(Health health) noexcept;

struct SensorStatus {
  std::string name;
  std::string topic;
  Duration period{0};
  bool running = false;
  Health health = Health::ok;
  std::string reason;  ///< why it is not ok
  SensorCounts counts;
  std::string loop = {};  ///< the name of the loop or tier that it is on
  Time first_due{};  ///< the ticks of its schedule are due at first_due + n * period; means nothing while not running
  Outages outages = {};  ///< without a schedule; one that lasts counts up to now
};

/// The functions given to `Loop::post` of one loop: each of them was run or waits.
struct PostCounts {
  std::uint64_t posted = 0;
  std::uint64_t run = 0;
  std::uint64_t most_waiting = 0;  ///< when the loop began to run them

  std::uint64_t waiting() const noexcept { return posted - run; }
};

/// A loop or tier, and the thread that it runs on.
struct LoopStatus {
  std::string name;
  bool is_tier = false;
  bool running = false;
  Scheduling scheduling;                   ///< as the kernel granted it
  Duration processor_time{0};              ///< spent by its thread so far
  std::vector<std::string> warnings = {};  ///< settings of the thread that the kernel refused
  PostCounts posts = {};                   ///< up to now, also while the tier runs
};

struct TopicDrops {
  std::string topic;
  std::uint64_t count = 0;
};

/// What waits in the recording that a sink goes through: `SinkCounts::queued` events.
struct Backlog {
  std::uint64_t bytes = 0;  ///< of their payloads
  Time oldest{};            ///< the time of the oldest of them; 0: nothing waits
  Duration age{0};          ///< how long that one has waited
  /// When nothing waits any more at the pace of the last seconds; none: it does not become less.
  std::optional<Duration> catch_up = {};
};

struct SinkStatus {
  std::string name;
  Health health = Health::ok;
  std::string reason;
  SinkCounts counts;
  std::vector<TopicDrops> dropped;  ///< of all reasons, for each topic that lost some
  /// Of a sink that goes through a recording, once it has looked into that; none: its events wait in memory.
  std::optional<Backlog> backlog = {};
};

struct TopicStatus {
  std::string name;
  std::shared_ptr<const Description> description;  ///< null for a payload without one
  std::uint64_t published = 0;
  SubscriptionCounts subscriptions;  ///< summed
};

class Runtime {
 public:
  struct Config {
    std::string name = {};           ///< of the set-up; kept in recordings
    std::string notes = {};          ///< the user's; kept in recordings
    std::string configuration = {};  ///< the text of the file it was made from; kept in recordings
    /// Texts that errors, log records and reasons of health must not show: "(secret)" stands in their place.
    std::vector<std::string> secrets = {};
    Clock* clock = nullptr;          ///< null: the machine's. Must outlive the runtime.
    OutputGuard* guard = nullptr;    ///< holds the devices of outputs (outputs/guard.hpp); null: nobody does. Likewise.
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
  /// Records what a source of time (GPS, PPS, a radio clock) showed at an instant of the monotonic line. It sets no
  /// clock: recordings keep the pair, and derive the UTC of their rows from the most accurate pairs that they have.
  ///
  ///     loop.runtime()
  ///         .note_wall_clock({.monotonic = at, .realtime = utc, .source = "gps", .accuracy = 1us})
  ///         .or_throw();
  ///
  /// As often as the source speaks: of each source only what says something new is kept, at most once in 10 s. Its
  /// `occasion` is not looked at. Errors: bad-name (empty, over 64 characters, "system"), bad-argument (an accuracy
  /// that is not positive; a 17th source).
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
  /// Every equation of the ledger holds at this instant. False while the account of a tier is unknown: it did not stop
  /// in the time that a drain gave it, which was reported, and has neither come out of its callback nor been stopped
  /// since. Here and in `has_loss`, a running tier counts as it was when the main loop was drained last.
  bool balances() const;
  /// Something was missed, failed or lost, a source without a schedule had an outage, a sink dropped something or a
  /// subscription on a tier, or something could not be taken from a tier, which was reported.
  bool has_loss() const;

  detail::RuntimeCore& core() noexcept { return *core_; }

 private:
  std::unique_ptr<detail::RuntimeCore> core_;
};

}  // namespace rtdata
