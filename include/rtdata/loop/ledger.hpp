/// Ledger: the account of every scheduled tick and every event.
///
/// Each term is counted where it happens; none is computed from the others. The equations:
///
///   reads, of a sensor with a schedule   scheduled = taken + missed + failed + in_flight
///   data, of every sensor                received = published + repeated + filtered + unreadable
///   topic and sink                       offered = stored + dropped + queued      (from attachment on)
///   subscription                         offered = delivered + dropped + cancelled + queued
///
/// One read may give no sample, one or many. A read with an error, or whose data cannot all be used, is failed; any
/// other is taken. `late` is the part of taken that began later than due plus max(1 ms, 10 % of the period). "Repeated"
/// means that the device itself had no new sample; an equal value is data. `lost` is in no equation: samples that the
/// source numbered but that never arrived.
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
  bool is_one_a_read = true;   ///< each read taken gave one sample, new or not, with the time of the read
  // Reads. All 0 without a schedule.
  std::uint64_t scheduled = 0;  ///< ticks of the schedule that have come due
  std::uint64_t taken = 0;      ///< ticks at which the device was read with a usable result or nothing new
  // Data, as counted by reading and publishing.
  std::uint64_t received = 0;  ///< samples received, usable or not
  std::uint64_t published = 0;
  std::uint64_t lateness = 0;  ///< with a schedule: sum of the samples' delays after their due times, ns (mod 2^64)
  // Reads.
  std::uint64_t late = 0;    ///< part of taken
  std::uint64_t missed = 0;  ///< ticks without a read (the loop was held, or the last read still ran)
  std::uint64_t failed = 0;  ///< ticks whose read gave nothing usable, or while the device was faulted
  // Data.
  std::uint64_t repeated = 0;    ///< the device had nothing new
  std::uint64_t filtered = 0;    ///< held back on purpose
  std::uint64_t unreadable = 0;  ///< received, but could not be decoded
  std::uint64_t lost = 0;        ///< numbered by the source, never received
  std::uint64_t in_flight = 0;   ///< reads begun and not finished: 0 or 1
  /// First lines discarded because the port was opened in the middle of them; not a loss, in no equation.
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

/// A recorded absence of data, for one reason. With a schedule: consecutive ticks without a reading, or several such
/// gaps joined. Without a schedule: a time in which no data could come, or none came.
struct Gap {
  enum class Kind : std::uint8_t {
    missed,        ///< ticks at which nothing was begun
    failed,        ///< ticks whose reads gave nothing usable
    disconnected,  ///< no schedule: the device was away
    silent,        ///< no schedule: it sent nothing for longer than allowed
    joined,        ///< several gaps of one origin, joined because there were too many; there are readings in between
  };
  Kind kind = Kind::missed;
  /// A word or two of the library's ("loop held", "still reading"), the id of the error that caused it, or "several".
  std::string_view reason;
  Time first{};             ///< when the first of its ticks was due; without a schedule, when it began
  Time last{};              ///< when the last of them was due; without a schedule, when it ended
  std::uint64_t count = 0;  ///< ticks without a reading; without a schedule, how many were joined, otherwise 0
};
std::string_view name_of(Gap::Kind kind) noexcept;

/// The outages of an origin without a schedule: times in which no data could come, or none came for longer than
/// allowed. Each is a gap. They have a duration and no count, because the number of missing events is unknown.
struct Outages {
  std::uint64_t number = 0;
  Duration time{0};         ///< of all together
  bool is_at_most = false;  ///< `time` is an upper limit: some outages were recorded as one gap, with data in between

  void add(const Outages& other) noexcept {
    number += other.number;
    time += other.time;
    is_at_most = is_at_most || other.is_at_most;
  }
};
/// "1 outage of 6.3 s", "3 outages of 41 s together", "40 outages of at most 12 min together".
std::string to_string(const Outages& outages);

/// A part of a schedule with one period: its ticks were due at first_due + n * period, up to `end`.
struct Segment {
  Time first_due{};
  Duration period{0};  ///< 0: no schedule
  Time end{};          ///< when the schedule ended, or the last tick that the loop has dealt with
  std::uint64_t scheduled = 0;
  Duration late_after{0};  ///< a read that begins later than this after its due time is late

  /// `scheduled` computed again from the first three.
  std::uint64_t computed() const noexcept {
    if (period.count() <= 0 || end < first_due) return 0;
    return static_cast<std::uint64_t>((end - first_due) / period) + 1;
  }
};

inline constexpr const char* account_topic = "$rtdata/account";

/// The final account: one event for each sensor and feed with the counts of its data. It is published on
/// `$rtdata/account` when a loop closes, after all other events and before the sinks close.
///
///     "sinks": [{"type": "http", "url": "https://collector.example/in", "topics": ["#", "$rtdata/account"]}]
///
/// With it the receiver of a sink's data can check that it has everything: for each origin, the events with sequences
/// up to `published`; it also shows the losses on the machine itself. `#` does not match the topic. With `through`, the
/// recording must name the topic too; if the peer is away at the end, the account waits there like all other events. It
/// is published only if a sink or a subscription names the topic. A program that is killed publishes none.
struct FinalCounts {
  text<200> name;                ///< of the sensor or feed: the origin of its events
  text<200> topic;               ///< that it published on
  std::uint64_t published = 0;   ///< number of events; equals the sequence of the last one
  std::uint64_t late = 0;        ///< of its ticks
  std::uint64_t missed = 0;      ///< ticks at which nothing was begun
  std::uint64_t failed = 0;      ///< ticks whose read gave nothing usable
  std::uint64_t unreadable = 0;  ///< samples that came and could not be decoded
  std::uint64_t lost = 0;        ///< samples that the source numbered but that never arrived
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
