/// Ledger: the account of every scheduled tick and every event.
///
/// Each term is counted where it happens; none is computed from the others. The equations:
///
///   scheduled sensor    scheduled = taken + missed + failed + in_flight;  taken = published + repeated + filtered
///   without a schedule  received = published + repeated + filtered + failed
///   topic and sink      offered = stored + dropped + queued      (from attachment on)
///   subscription        offered = delivered + dropped + cancelled + queued
///
/// `late` is the part of taken that began later than due plus max(1 ms, 10 % of the period). "Repeated" means that the
/// device itself had nothing new; an equal value is data.
///
/// Values; snapshots taken on the loop's thread between callbacks balance exactly.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "rtdata/data/time.hpp"

namespace rtdata {

struct SensorCounts {
  std::uint64_t scheduled = 0;  ///< ticks of the schedule that have come due
  std::uint64_t taken = 0;      ///< ticks at which the device was read and answered
  std::uint64_t published = 0;
  std::uint64_t late = 0;      ///< part of taken
  std::uint64_t missed = 0;    ///< ticks at which nothing was begun (the loop was held, the last read still ran)
  std::uint64_t failed = 0;    ///< ticks whose read failed, or that passed while the device was faulted
  std::uint64_t received = 0;  ///< inputs of a sensor without a schedule
  std::uint64_t repeated = 0;
  std::uint64_t filtered = 0;
  std::uint64_t lost = 0;       ///< numbered by the source and never seen here
  std::uint64_t in_flight = 0;  ///< reads begun and not finished: 0 or 1
  bool has_schedule = false;
  bool lost_is_known = false;  ///< the source numbers its data

  bool balances() const noexcept {
    const bool flow = has_schedule ? taken == published + repeated + filtered
                                   : received == published + repeated + filtered + failed;
    return flow && (!has_schedule || scheduled == taken + missed + failed + in_flight);
  }
  bool has_loss() const noexcept { return missed + failed + lost > 0; }
};

struct SubscriptionCounts {
  std::uint64_t offered = 0;
  std::uint64_t delivered = 0;
  std::uint64_t dropped = 0;    ///< the ring was full
  std::uint64_t cancelled = 0;  ///< unsubscribed, or the sensor was stopped, before delivery
  std::uint64_t queued = 0;
  bool balances() const noexcept { return offered == delivered + dropped + cancelled + queued; }
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

/// A recorded absence: consecutive ticks without a reading, for one reason.
struct Gap {
  enum class Kind : std::uint8_t { missed, failed };
  Kind kind = Kind::missed;
  /// A word or two of the library's ("loop held", "still reading"), or the id and text of the error that caused it.
  std::string_view reason;
  Time first{};             ///< when the first of them was due
  Time last{};              ///< when the last of them was due
  std::uint64_t count = 0;  ///< ticks
};

/// A stretch of unchanged schedule: its ticks were due at first_due + n * period, up to `end`.
struct Segment {
  Time first_due{};
  Duration period{0};  ///< 0: no schedule
  Time end{};          ///< when the schedule ended, or the last tick that the loop has dealt with
  std::uint64_t scheduled = 0;

  /// `scheduled` computed again from the other three.
  std::uint64_t computed() const noexcept {
    if (period.count() <= 0 || end < first_due) return 0;
    return static_cast<std::uint64_t>((end - first_due) / period) + 1;
  }
};

}  // namespace rtdata
