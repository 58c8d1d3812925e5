// How a run stands: what `run`, `top` and the account at its end print, and what the control socket answers. Its JSON
// is documented in docs/program.md ("The status").
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/value.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata::app {

/// A value: any thread may have one. What is not known, or means nothing of that object, is empty.
struct Status {
  /// Of the JSON and of what may be asked for. Within one, keys are added only: what they mean stays.
  static constexpr std::int64_t newest = 1;

  struct Instance {
    std::string name;  ///< of the set-up
    std::int64_t pid = 0;
    std::string started;  ///< UTC, in ISO 8601
    Duration running_for{0};
    std::string configuration;  ///< path of its file
  };
  /// Of a sensor, of a topic with all its sensors, and of all together; also of those that were closed since.
  struct Account {
    std::string name = {};
    std::uint64_t published = 0, late = 0, missed = 0, failed = 0, unreadable = 0;
    std::uint64_t lost = 0;                       ///< by the source
    bool lost_is_known = false;                   ///< of a topic or of all: of one of its sensors at least
    std::uint64_t repeated = 0, first_lines = 0;  ///< no loss
    std::uint64_t dropped = 0;                    ///< by sinks; not of a sensor
    std::uint64_t handlers_dropped = 0;           ///< not of a sensor
    Outages outages = {};
    Health health = Health::ok;  ///< of a topic the worst of its sensors'
    std::string reason = {};

    std::uint64_t losses() const noexcept { return missed + failed + unreadable + lost + dropped; }
    bool has_loss() const noexcept { return losses() + outages.number > 0; }
  };
  struct Lateness {
    Duration p50{0}, p99{0}, max{0};
  };
  struct Alarm {
    std::string name;
    bool is_active = false, is_acknowledged = false;
  };
  struct Sensor : Account {
    std::string topic, loop;
    bool is_running = false;
    std::optional<double> wanted_hz, reached_hz;  ///< reached: over the last seconds
    std::optional<Lateness> lateness;             ///< of the last whole second
    std::optional<std::string> value;             ///< the last one, for people
    std::optional<Alarm> alarm;                   ///< of a limit
    std::optional<std::string> state;             ///< of a machine
    std::optional<Duration> in_state;

    // In the process itself.
    std::uint64_t readings = 0;  ///< taken of its schedule, or received without one
    Time first_due{};
    Duration period{0};              ///< 0: it has no schedule now
    std::vector<std::byte> payload;  ///< `value` is made of it where that is wanted, not on the loop
    std::shared_ptr<const Description> description;
    std::optional<std::string> shown() const;
  };
  struct Loop {
    std::string name;
    bool is_tier = false, is_running = false;
    std::string policy;
    int priority = 0;
    std::optional<double> load_percent;  ///< of a processor, over the last seconds
    std::optional<Lateness> lateness;    ///< of its sensors together
    std::vector<std::string> warnings;
    std::optional<std::string> hangs_in;  ///< the callback that a tier has not come out of for a second
    Duration processor_time{0};           ///< so far; in the process itself
  };
  struct Sink {
    std::string name, path;
    std::uint64_t offered = 0, queued = 0, stored = 0;
    std::array<std::uint64_t, drop_reasons> dropped{};
    Health health = Health::ok;
    std::string reason;
    std::optional<Backlog> backlog;  ///< what waits in the recording that it goes through: `queued` events

    // In the process itself, of one that was closed.
    bool is_recording = false;
    std::string recording;                      ///< that it went through; empty: none
    std::shared_ptr<const RunReport> recorded;  ///< what it says of its run; null: it was not closed
    std::uint64_t all_dropped() const noexcept { return dropped[0] + dropped[1] + dropped[2]; }
  };
  /// A place on a bus.
  struct Place {
    std::string place;
    std::uint64_t transfers = 0, failed = 0, retried = 0;
    Duration busy{0}, longest{0};
  };
  /// Of a kind that has no status of its own, such as a bus.
  struct Part {
    std::string kind, name, type;
    std::vector<std::string> users;  ///< "sensor chamber"
    std::vector<Place> places;
  };
  struct Callback {
    std::string name, loop;
    std::uint64_t count = 0;
    Duration total{0}, max{0};
  };

  std::int64_t version = newest;
  Instance instance;
  Account total;
  std::uint64_t queued = 0;   ///< in sinks
  std::uint64_t waiting = 0;  ///< in recordings, to be sent
  std::vector<Loop> loops;
  std::vector<Sensor> sensors;  ///< that are there now
  std::vector<Account> topics;
  std::vector<Sink> sinks;  ///< first those that were closed
  std::vector<Part> parts;
  std::vector<Callback> callbacks;  ///< that took most
  /// Sensors that never gave an event, and those without a schedule whose source numbers nothing.
  std::vector<std::string> mute, not_detectable;
};

/// What the ledger of the runtime says now. `paths`: of the sinks that are there, by name. Thread: the loop's.
Status status_of(Runtime& runtime, const std::map<std::string, std::string>& paths = {});

/// A number has six digits.
std::string shown_value(const Value& value);

/// One line, without its end. It makes `value` of the sensors.
std::string json_of(Status& status);
/// What an instance answers. Errors: why it has none, in its words; closed (it ends); newer-version (its version is
/// newer than this program).
Result<Status> status_from(std::string_view line);

}  // namespace rtdata::app
