// The records in the ring of a bridge.
#pragma once

#include <cstdint>
#include <variant>

#include "loop/events/topic_core.hpp"
#include "rtdata/loop/ledger.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::detail {

struct Passage;

/// The head of each record.
struct BridgeRecord {
  enum class Sort : std::uint32_t { event, gap, segment, account, drops };
  BridgeRecord() = default;
  BridgeRecord(std::uint32_t bytes_, Sort sort, std::uint32_t passage)
      : bytes(bytes_), tag(passage << 3 | static_cast<std::uint32_t>(sort)) {}
  Sort sort() const noexcept { return static_cast<Sort>(tag & 7); }
  std::uint32_t passage() const noexcept { return tag >> 3; }
  bool operator==(const BridgeRecord&) const = default;
  std::uint32_t bytes;  // the ring's
  std::uint32_t tag;    // what it is, and the passage's number
};

struct EventRecord : BridgeRecord {
  TopicCore::Arrival event;
  // the payload
};

struct GapRecord : BridgeRecord {
  Gap gap;
};

struct SegmentRecord : BridgeRecord {
  Segment segment;
};

/// The account of an origin at one instant, and the health of its sensor.
struct OriginSnapshot {
  SensorCounts counts;
  std::uint64_t sequence;
  Segment under_way;
  Gap gap;  // under way, if `has_gap`
  bool has_gap;
  Outages outages;    // that have ended
  Time absent_since;  // of the one that lasts
  Duration period;
  bool is_active;
  bool has_sensor;
  Health health;
  char reason[96];
};

struct AccountRecord : BridgeRecord {
  OriginSnapshot account;
};

/// Events of an origin dropped because the ring was full, since the bridge was made.
struct Drops {
  std::uint64_t dropped;
  std::uint64_t last_sequence;  // of the last one
};

struct DropsRecord : BridgeRecord {
  Drops drops;
};

/// An ended gap or segment. If the ring is full it waits, because the recording does not balance without it.
struct LedgerEntry {
  Passage* passage;
  std::variant<Gap, Segment> entry;
};

}  // namespace rtdata::detail
