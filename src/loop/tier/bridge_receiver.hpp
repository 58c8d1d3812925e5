// The receiving side of a bridge.
#pragma once

#include <cstddef>
#include <variant>
#include <vector>

#include "loop/tier/channel.hpp"

namespace rtdata::detail {

struct Announcement;
class LoopCore;

/// Thread: the receiving loop's. It runs no user code and keeps reports for later.
class BridgeReceiver {
 public:
  BridgeReceiver(LoopCore& from, LoopCore& to, ByteRing& ring) noexcept : from_(from), to_(to), ring_(ring) {}
  BridgeReceiver(const BridgeReceiver&) = delete;
  BridgeReceiver& operator=(const BridgeReceiver&) = delete;
  ~BridgeReceiver();

  void hear(const Announcement& announcement);
  /// Takes data sent before the call.
  void receive();
  /// Takes data sent before `BridgeSender::send_all_accounts` returned this position.
  void receive_up_to(std::size_t position);
  /// The position up to which it has received.
  std::size_t received() const noexcept { return ring_.seen(); }
  void add_statuses(std::vector<SensorStatus>& all) const;

 private:
  void receive_topic(const Announcement& announcement);
  void receive_origin(const Announcement& announcement);
  /// Takes the records seen, up to the first one of a passage that is not open. False: there is one.
  bool take_seen();
  /// Takes the first event and following ones of the same sensor.
  void take_events(const EventRecord& first, Passage& passage);
  void take_record(const BridgeRecord& record, Passage& passage);
  void take_entry(const std::variant<Gap, Segment>& entry, OriginCore& mirror);
  void take_drops(const Drops& drops, Passage& passage);
  void take_account(const OriginSnapshot& account, Passage& passage);

  LoopCore& from_;  // its name only
  LoopCore& to_;
  ByteRing& ring_;
  std::vector<Channel*> channels_;  // that were heard of
  std::vector<Passage*> open_;      // by number; null: not open, so its records wait in the ring
};

}  // namespace rtdata::detail
