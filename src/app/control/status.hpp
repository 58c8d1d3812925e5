// The status of a run, for `run`, `top`, the account at its end, and the control socket. Its JSON is documented in
// docs/program.md ("The status").
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

/// A value; any thread. Fields that are unknown or do not apply are empty.
struct Status {
  /// The version of the JSON and the requests. Within a version, keys are only added; their meaning does not change.
  static constexpr std::int64_t newest = 1;

  struct Instance {
    std::string name;  ///< the name of the configuration
    std::int64_t pid = 0;
    std::string started;  ///< UTC, in ISO 8601
    Duration running_for{0};
    std::string configuration;  ///< path of its file
  };
  /// The account of a sensor, of a topic with all its sensors, or of all sensors, including closed ones.
  struct Account {
    std::string name = {};
    std::uint64_t published = 0, late = 0, missed = 0, failed = 0, unreadable = 0;
    std::uint64_t failed_unreadable = 0;          ///< the part of failed whose sample is in unreadable, too
    std::uint64_t lost = 0;                       ///< by the source
    bool lost_is_known = false;                   ///< for a topic or all: true for at least one of its sensors
    std::uint64_t repeated = 0, first_lines = 0;  ///< no loss
    std::uint64_t dropped = 0;                    ///< by sinks; not of a sensor
    std::uint64_t handlers_dropped = 0;           ///< not of a sensor
    Outages outages = {};
    Health health = Health::ok;  ///< for a topic, the worst of its sensors
    std::string reason = {};

    /// Without what sinks dropped: others may have it.
    std::uint64_t losses() const noexcept { return missed + failed + unreadable - failed_unreadable + lost; }
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
    std::optional<std::string> value;             ///< the last one, as readable text
    std::optional<Alarm> alarm;                   ///< of a limit
    std::optional<std::string> state;             ///< of a machine
    std::optional<Duration> in_state;

    // In the process itself.
    std::uint64_t readings = 0;  ///< taken of its schedule, or received without one
    Time first_due{};
    Duration period{0};              ///< 0: no schedule now
    std::vector<std::byte> payload;  ///< source of `value`, which is made later and not on the loop
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
    std::optional<std::string> hangs_in;  ///< the callback in which a tier has been for more than a second
    Duration processor_time{0};           ///< used by the process itself until now
  };
  struct Sink {
    std::string name, path;
    std::uint64_t offered = 0, queued = 0, stored = 0;
    std::array<std::uint64_t, drop_reasons> dropped{};
    Health health = Health::ok;
    std::string reason;
    std::optional<Backlog> backlog;  ///< with `through`: the events waiting in the recording

    // Only within the process, for a closed sink.
    bool is_recording = false;
    std::string recording;                      ///< its recording (`through`); empty: none
    std::shared_ptr<const RunReport> recorded;  ///< its report of the run; null: not closed
    std::uint64_t all_dropped() const noexcept { return dropped[0] + dropped[1] + dropped[2]; }
  };
  /// A place on a bus.
  struct Place {
    std::string place;
    std::uint64_t transfers = 0, failed = 0, retried = 0;
    Duration busy{0}, longest{0};
    std::uint64_t skipped_bytes = 0;
  };
  /// A part of a kind without its own status, such as a bus.
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
  std::vector<Sensor> sensors;  ///< the present ones
  std::vector<Account> topics;
  std::vector<Sink> sinks;  ///< first those that were closed
  std::vector<Part> parts;
  std::vector<Callback> callbacks;  ///< that took most
  /// Sensors that never published an event; sensors without a schedule whose source does not number its data.
  std::vector<std::string> mute, not_detectable;
};

/// The present status from the runtime's ledger. `paths`: of the existing sinks, by name. Thread: the loop's.
Status status_of(Runtime& runtime, const std::map<std::string, std::string>& paths = {});

/// Numbers are shown with six digits.
std::string shown_value(const Value& value);

/// One line, without its end. It makes `value` of the sensors.
std::string json_of(Status& status);
/// Parses the answer of an instance. Errors: the instance's own error text; closed (it ends); newer-version (its
/// version is newer than this program).
Result<Status> status_from(std::string_view line);

}  // namespace rtdata::app
