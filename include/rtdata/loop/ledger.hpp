/// Ledger: the account of every scheduled tick and every event.
///
/// Each term is counted where it happens; none is computed from the others. The equations:
///
///   reads, of a sensor with a schedule   scheduled = taken + missed + failed + in_flight
///   data, of every sensor                received = published + repeated + filtered + unreadable
///   topic and sink                       offered = stored + dropped + queued      (from attachment on)
///   subscription                         offered = delivered + dropped + cancelled + queued
///
/// One read may bring no sample, one or many. A read that brought nothing usable, an error or data that cannot be
/// decoded, is failed; any other is taken. `late` is the part of taken that began later than due plus max(1 ms, 10 % of
/// the period). "Repeated" means that the device itself had nothing new; an equal value is data. `lost` stands beside
/// the equations: what the source numbered and what never came.
///
///     const rtdata::SensorCounts counts = sensor.counts();
///     if (counts.missed + counts.failed != 0) std::cout << counts.missed << " ticks missed\n";
///
/// Values; snapshots taken on the loop's thread between callbacks balance exactly.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/text.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata {

struct SensorCounts {
  bool has_schedule = false;
  bool lost_is_known = false;  ///< the source numbers its data
  bool is_one_a_read = true;   ///< each read that was taken brought one sample, new or not, with the time of the read
  // Reads. All 0 without a schedule.
  std::uint64_t scheduled = 0;  ///< ticks of the schedule that have come due
  std::uint64_t taken = 0;      ///< ticks at which the device was read, and there was nothing new or something usable
  // Data, as far as reading and publishing touch it.
  std::uint64_t received = 0;  ///< samples that came, usable or not
  std::uint64_t published = 0;
  std::uint64_t lateness = 0;  ///< with a schedule: ns from when each of those was due to its time, summed (mod 2^64)
  // Reads.
  std::uint64_t late = 0;    ///< part of taken
  std::uint64_t missed = 0;  ///< ticks at which nothing was begun (the loop was held, the last read still ran)
  std::uint64_t failed = 0;  ///< ticks whose read brought nothing usable, or that passed while the device was faulted
  // Data.
  std::uint64_t repeated = 0;    ///< the device had nothing new
  std::uint64_t filtered = 0;    ///< held back on purpose
  std::uint64_t unreadable = 0;  ///< came, and could not be decoded
  std::uint64_t lost = 0;        ///< numbered by the source, and never came
  std::uint64_t in_flight = 0;   ///< reads begun and not finished: 0 or 1
  /// Beginnings thrown away, of lines in whose middle a port was opened: no loss, and in no equation.
  std::uint64_t first_lines = 0;

  bool balances() const noexcept {
    return scheduled == taken + missed + failed + in_flight && received == published + repeated + filtered + unreadable;
  }
  bool has_loss() const noexcept { return missed + failed + unreadable + lost > 0; }
};

struct SubscriptionCounts {
  std::uint64_t offered = 0;
  std::uint64_t delivered = 0;
  std::uint64_t dropped = 0;    ///< the ring was full
  std::uint64_t cancelled = 0;  ///< unsubscribed, or the sensor was stopped, before delivery
  std::uint64_t queued = 0;
  bool balances() const noexcept { return offered == delivered + dropped + cancelled + queued; }

  void add(const SubscriptionCounts& other) noexcept {
    offered += other.offered;
    delivered += other.delivered;
    dropped += other.dropped;
    cancelled += other.cancelled;
    queued += other.queued;
  }
};

/// Why a sink dropped an event.
enum class DropReason : std::uint8_t {
  queue_full_newest,  ///< the queue was full, the event just published was dropped
  queue_full_oldest,  ///< the queue was full, an older event made room
  refused,            ///< the writer could not take it, now or on retry (does not fit, disk full for too long, closed)
};
inline constexpr std::size_t drop_reasons = 3;
std::string_view name_of(DropReason reason) noexcept;

struct SinkCounts {
  std::uint64_t offered = 0;
  std::uint64_t stored = 0;
  std::uint64_t dropped[drop_reasons] = {};
  std::uint64_t queued = 0;
  std::uint64_t all_dropped() const noexcept { return dropped[0] + dropped[1] + dropped[2]; }
  bool balances() const noexcept { return offered == stored + all_dropped() + queued; }
};

/// A recorded absence, for one reason. With a schedule: consecutive ticks without a reading, or several such gaps
/// joined. Without one: a stretch in which nothing could come, or nothing came.
struct Gap {
  enum class Kind : std::uint8_t {
    missed,        ///< ticks at which nothing was begun
    failed,        ///< ticks whose reads brought nothing usable
    disconnected,  ///< no schedule: the device was away
    silent,        ///< no schedule: it sent nothing for longer than it may
    joined,        ///< several gaps of one origin, since there were too many: in between it has readings
  };
  Kind kind = Kind::missed;
  /// A word or two of the library's ("loop held", "still reading"), the id of the error that caused it, or "several".
  std::string_view reason;
  Time first{};             ///< when the first of its ticks was due; without a schedule, when it began
  Time last{};              ///< when the last of them was due; without a schedule, when it ended
  std::uint64_t count = 0;  ///< ticks without a reading; without a schedule, how many were joined, otherwise 0
};
std::string_view name_of(Gap::Kind kind) noexcept;

/// The outages of an origin without a schedule: stretches in which nothing could come, or nothing came for longer than
/// it may. Each is a gap. What they cost is a time and no count, since the number of events that would have come is not
/// known.
struct Outages {
  std::uint64_t number = 0;
  Duration time{0};         ///< of all together
  bool is_at_most = false;  ///< the time: between some of them, which a recording has as one gap, there was data

  void add(const Outages& other) noexcept {
    number += other.number;
    time += other.time;
    is_at_most = is_at_most || other.is_at_most;
  }
};
/// "1 outage of 6.3 s", "3 outages of 41 s together", "40 outages of at most 12 min together".
std::string to_string(const Outages& outages);

/// A stretch of unchanged schedule: its ticks were due at first_due + n * period, up to `end`.
struct Segment {
  Time first_due{};
  Duration period{0};  ///< 0: no schedule
  Time end{};          ///< when the schedule ended, or the last tick that the loop has dealt with
  std::uint64_t scheduled = 0;
  Duration late_after{0};  ///< reads that begin later than that after they were due are late

  /// `scheduled` computed again from the first three.
  std::uint64_t computed() const noexcept {
    if (period.count() <= 0 || end < first_due) return 0;
    return static_cast<std::uint64_t>((end - first_due) / period) + 1;
  }
};

inline constexpr const char* account_topic = "$rtdata/account";

/// The final account: an event for each sensor and feed with what became of its data, published on `$rtdata/account`
/// when a loop closes, after the last event of all others and before sinks close.
///
///     "sinks": [{"type": "http", "url": "https://collector.example/in", "topics": ["#", "$rtdata/account"]}]
///
/// So the receiver of what a sink sends can tell whether it has everything: of each origin, the events with sequences
/// up to `published`; and what the machine itself knows to be missing. `#` does not match the topic. With `through`,
/// the recording has to name it, too; then it waits there as all else does, when the peer is away at the end. It is
/// published only where a sink or a subscription names the topic, and a program that is killed publishes none.
struct FinalCounts {
  text<200> name;                ///< of the sensor or feed: the origin of its events
  text<200> topic;               ///< that it published on
  std::uint64_t published = 0;   ///< events, which is the sequence of the last one
  std::uint64_t late = 0;        ///< of its ticks
  std::uint64_t missed = 0;      ///< ticks at which nothing was begun
  std::uint64_t failed = 0;      ///< ticks whose read brought nothing usable
  std::uint64_t unreadable = 0;  ///< samples that came and could not be decoded
  std::uint64_t lost = 0;        ///< samples that the source numbered and that never came
  bool lost_is_known = false;    ///< the source numbers its data
  friend constexpr auto describe(type_tag<FinalCounts>) {
    return record("account", field("name", &FinalCounts::name, ""), field("topic", &FinalCounts::topic, ""),
                  field("published", &FinalCounts::published, ""), field("late", &FinalCounts::late, ""),
                  field("missed", &FinalCounts::missed, ""), field("failed", &FinalCounts::failed, ""),
                  field("unreadable", &FinalCounts::unreadable, ""), field("lost", &FinalCounts::lost, ""),
                  field("lost_is_known", &FinalCounts::lost_is_known, ""));
  }
};

}  // namespace rtdata
