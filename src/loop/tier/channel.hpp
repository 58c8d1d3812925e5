// A topic and its origins on their way over a bridge. The sending and the receiving side of each have fields of their
// own, used by the thread of their loop alone; what both sides read never changes, except one atomic flag.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "data/copy.hpp"
#include "loop/events/origin_core.hpp"
#include "loop/tier/bridge_records.hpp"
#include "loop/tier/byte_ring.hpp"

namespace rtdata::detail {

class BridgeSender;

/// A summary to detect changes of an account.
struct AccountSummary {
  std::uint64_t grown = 0;  // sum of counts, each of which only grows
  Duration period{0};
  bool has_gap = false;
  bool is_absent = false;
  bool has_sensor = false;
  bool is_active = false;
  Health health = Health::ok;
  bool operator==(const AccountSummary&) const = default;
};

/// An origin and its mirror, open on the receiving side from the announcement on.
struct Passage {
  Passage(std::uint32_t number_, OriginCore& source, Channel& channel_, std::uint32_t event_bytes)
      : number(number_),
        event(event_bytes, BridgeRecord::Sort::event, number_),
        channel(&channel_),
        sending{.source = &source} {}
  const std::uint32_t number;  // among its bridge's
  const BridgeRecord event;    // what its events' records begin with
  Channel* const channel;

  struct Sending {
    OriginCore* source;
    Drops drops{};                       // because the ring had no room
    std::uint64_t reported_dropped = 0;  // of these, those reported to the other side
    AccountSummary last_account = {};
  } sending;

  struct alignas(64) Receiving {   // a cache line of its own
    OriginCore* mirror = nullptr;  // null: its topic cannot be what it is elsewhere
    std::uint64_t known_dropped = 0;
    // As the last account has it.
    Duration period{0};
    bool is_active = false;
    bool has_sensor = false;
    Health health = Health::ok;
    std::string reason;
  } receiving;
};

/// A topic and its mirror.
class Channel {
 public:
  Channel(BridgeSender& bridge, ByteRing& ring, TopicCore& source);

  // On the sending loop
  /// Null: it was never published over this channel.
  Passage* passage_of(const OriginCore& origin) const noexcept {
    return origin.index < sending.passages.size() ? sending.passages[origin.index] : nullptr;
  }
  void send(Passage& passage, Time time, std::uint64_t sequence, const void* payload) {
    if (!is_wanted_.load(std::memory_order_relaxed)) return;
    // The usual case is handled inline.
    const Passage::Sending& of = passage.sending;
    std::byte* room = of.drops.dropped == of.reported_dropped ? sending.ring.reserve_at_hand(bytes_at_hand_) : nullptr;
    if (room == nullptr) return look_for_room(passage, time, sequence, payload);
    copy_few(begin_event(room, passage, time, sequence), payload, payload_bytes_);
    sending.ring.commit(record_bytes);
  }

  // On the receiving loop
  void set_wanted(bool is_wanted) noexcept {
    // Writes only on a change, because the sender reads it for each event.
    if (is_wanted_.load(std::memory_order_relaxed) != is_wanted) is_wanted_.store(is_wanted, std::memory_order_relaxed);
  }

 private:
  const std::size_t payload_bytes_;

 public:
  const std::uint32_t record_bytes;  ///< of each event

  struct Sending {
    BridgeSender& bridge;
    ByteRing& ring;
    TopicCore& source;
    std::vector<Passage*> passages = {};  // by the origin's index within the topic
  } sending;

  struct Receiving {
    TopicCore* mirror = nullptr;  // null: not heard of yet, or another topic has the name there
  } receiving;

 private:
  void look_for_room(Passage& passage, Time time, std::uint64_t sequence, const void* payload);
  /// Where its payload goes.
  static std::byte* begin_event(std::byte* room, const Passage& passage, Time time, std::uint64_t sequence) {
    ByteRing::fetch_for_writing(room);
    auto& record = *reinterpret_cast<EventRecord*>(room);
    static_cast<BridgeRecord&>(record) = passage.event;
    record.event = {time, sequence};
    return room + sizeof record;
  }
  const std::size_t bytes_at_hand_;    // as many, or more than there ever are: a long payload is copied elsewhere
  std::atomic<bool> is_wanted_{true};  // until the receiving side has heard of it
};

}  // namespace rtdata::detail
