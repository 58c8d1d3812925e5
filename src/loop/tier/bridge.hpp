// A bridge: takes what is published on one loop to another, through a ring of copies. One for each ordered pair of loops.
//
//   1. The sending side hears of each topic and sensor of its loop, and announces it (a short lock; no event is on its way yet).
//   2. The receiving side makes topic and origin of the same names, the mirrors. Whether anybody there wants the topic's
//      events is a flag of its channel, which the sending side looks at for each event.
//   3. Events, gaps, ended segments and accounts go through the ring in the order in which they happened. A full ring drops
//      the event and counts it with its sensor; before the sensor's next event, or with its next account, goes how many
//      there were.
//   4. A name belongs to one loop at a time, which the hub says at set-up. When another loop has taken it over, the receiving
//      side first takes what the old one has sent; then that passage is past, and the mirror is fed by the new one.
//   5. After the sending loop's callbacks, or earlier when much waits, all that waits can be seen by the receiving loop,
//      which is woken once for it: through the kernel only when it sleeps (wake.hpp).
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <unordered_map>
#include <variant>
#include <vector>

#include "data/copy.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/events/topic_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/support/deadline.hpp"
#include "loop/tier/byte_ring.hpp"

namespace rtdata::detail {

class Bridge;

/// What a bridge's records begin with.
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

/// What is compared to see whether an account says anything new.
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

/// One sensor (origin) and its mirror: a sending and a receiving side, each owned by the thread of its loop. They exchange
/// records through the bridge's ring, and nothing else; what both read never changes.
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
    std::uint64_t dropped = 0;           // for want of room in the ring, since the beginning
    std::uint64_t reported_dropped = 0;  // of these, those that the other side was told of
    std::uint64_t last_dropped = 0;      // sequence of the last one
    AccountSummary last_account = {};
    bool is_given_up = false;  // another loop has the name: no more accounts
  } sending;

  struct alignas(64) Receiving {   // a cache line of its own
    OriginCore* mirror = nullptr;  // null: its topic cannot be what it is elsewhere
    bool is_past = false;          // another loop has the name
    std::uint64_t known_dropped = 0;
    // As the last account has it.
    Duration period{0};
    bool is_active = false;
    bool has_sensor = false;
    Health health = Health::ok;
    std::string reason;
  } receiving;
};

/// One topic and its mirror. The sending side owns all but `mirror_`, and `is_wanted_` is between the two.
class Channel {
 public:
  Channel(Bridge& bridge, TopicCore& source);

  // The sending side
  /// Null: it does not publish on this loop.
  Passage* passage_of(const OriginCore& origin) const noexcept {
    return !origin.is_mirror && origin.index < passages_.size() ? passages_[origin.index] : nullptr;
  }
  void send(Passage& passage, Time time, std::uint64_t sequence, const void* payload) {
    if (!is_wanted_.load(std::memory_order_relaxed)) return;
    // What most events are is done here, without a call.
    const Passage::Sending& sending = passage.sending;
    std::byte* room = sending.dropped == sending.reported_dropped ? ring_.reserve_at_hand(bytes_at_hand_) : nullptr;
    if (room == nullptr) return look_for_room(passage, time, sequence, payload);
    copy_few(begin_event(room, passage, time, sequence), payload, payload_bytes_);
    ring_.commit(record_bytes_);
  }

  // The receiving side
  void set_wanted(bool is_wanted) noexcept {
    // Not without need: the sender looks at it for each event.
    if (is_wanted_.load(std::memory_order_relaxed) != is_wanted) is_wanted_.store(is_wanted, std::memory_order_relaxed);
  }

 private:
  friend class Bridge;
  void look_for_room(Passage& passage, Time time, std::uint64_t sequence, const void* payload);
  struct EventRecord : BridgeRecord {
    TopicCore::Arrival event;
    // the payload
  };
  /// Where its payload goes.
  static std::byte* begin_event(std::byte* room, const Passage& passage, Time time, std::uint64_t sequence) {
    ByteRing::fetch_for_writing(room);
    auto& record = *reinterpret_cast<EventRecord*>(room);
    static_cast<BridgeRecord&>(record) = passage.event;
    record.event = {time, sequence};
    return room + sizeof record;
  }
  ByteRing& ring_;
  const std::size_t payload_bytes_;
  const std::size_t record_bytes_;
  const std::size_t bytes_at_hand_;  // as many, or more than there ever are: a long payload is copied elsewhere
  std::vector<Passage*> passages_;   // the sending side's, by the origin's index within the topic
  Bridge& bridge_;
  TopicCore& source_;
  std::atomic<bool> is_wanted_{true};  // until the other side has heard of it
  TopicCore* mirror_ = nullptr;        // the receiving side's
};

class Bridge final : public Listener {
 public:
  /// While neither loop turns, or on both threads at once as far as anybody can tell: at set-up.
  Bridge(LoopCore& from, LoopCore& to, std::size_t ring_bytes);
  /// As above.
  ~Bridge();
  Bridge(const Bridge&) = delete;
  Bridge& operator=(const Bridge&) = delete;

  LoopCore& from() const noexcept { return from_; }
  LoopCore& to() const noexcept { return to_; }

  // ---- the sending side
  Result<void> on_topic(TopicCore& topic) override;
  void on_origin(OriginCore& origin) override;
  void on_gap(OriginCore& origin, const Gap& gap) override;
  void on_segment(OriginCore& origin, const Segment& segment) override;
  void on_error(Time first, Time last, std::string_view object, const Error& error, std::uint64_t count) override;
  void on_health(Time first, Time last, const HealthChange& change, std::uint64_t count) override;
  /// What was sent can be taken by the other side, which is woken for it.
  void wake() noexcept;
  // Neither side runs user code in any of these: what there is to report is kept.
  /// The end of a turn of the sending loop: sends accounts, and wakes the other side.
  void turn_done();
  /// Sends how all the sensors do, now. Returns how much is left for want of room: what is there has to be received first.
  std::size_t send_accounts();
  /// All there is to say of the sensors up to now, gaps under way too.
  struct AccountsSent {
    std::size_t left;      // as `send_accounts` returns it
    std::size_t position;  // up to which the other side has to take for it, and no more
  };
  AccountsSent send_all_accounts();
  /// Another loop has the name of this origin: its account is no longer told.
  void give_up(const OriginCore& origin) noexcept;
  // These take it on the other side, too: on either thread, while none of the loops turns.
  /// What was sent crosses.
  void hand_over();
  /// The sending loop is about to go: all that is left crosses.
  void finish();

  // ---- the receiving side
  void hear(Announcement& announcement);
  /// Takes what was sent before the call.
  void receive();
  /// Takes what was sent before `send_all_accounts` returned this position.
  void receive_up_to(std::size_t position);
  void add_statuses(std::vector<SensorStatus>& all) const;

 private:
  friend class Channel;
  using Record = BridgeRecord;
  using Sort = BridgeRecord::Sort;
  using EventRecord = Channel::EventRecord;
  struct GapRecord : Record {
    Gap gap;
  };
  struct SegmentRecord : Record {
    Segment segment;
  };
  struct AccountRecord : Record {
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
  struct DropsRecord : Record {
    std::uint64_t dropped;
    std::uint64_t last_sequence;  // up to which
  };
  Channel* channel_of(const TopicCore& topic) noexcept;
  Passage* passage_of(const OriginCore& origin) noexcept;
  /// `room`: all for gaps, segments and last accounts, which have to find some when events have filled the ring.
  template <class RecordType>
  RecordType* reserve(Sort sort, const Passage& passage, ByteRing::Room room) noexcept;
  /// These are false when there is no room for it.
  bool send_drops(Passage& passage, ByteRing::Room room) noexcept;
  bool send_account(Passage& passage, ByteRing::Room room) noexcept;
  void send_some_accounts();
  /// A gap or an ended segment. The recording does not balance without it, so one that finds no room waits.
  struct Note {
    Passage* passage;
    std::variant<Gap, Segment> what;
  };
  void note(Note note);
  bool send(const Note& note) noexcept;
  bool send_notes() noexcept;
  void report_lost_notes(LoopCore& on);
  /// The other side is woken before the end of the turn when much waits: both work at the same time then.
  void make_known(std::size_t before) noexcept {
    if (ring_.completes_burst(before)) wake();
  }
  void announce(Channel* channel, Passage* passage, const std::string& name, PayloadType type);
  /// Up to the first record of an origin that is not heard of yet. Returns whether there was none.
  bool take_heard();
  /// The same, of what was looked at.
  bool take_seen();
  /// The front of the ring, and those alike behind it.
  void take_events(const EventRecord& first, Passage& passage);
  void take(const Record& record, Passage& passage);

  LoopCore& from_;
  LoopCore& to_;
  ByteRing ring_;
  const bool is_to_main_;  // which has the sinks and shows the sensors

  // the sending side
  std::deque<Channel> channels_;
  std::unordered_map<const TopicCore*, Channel*> channel_by_topic_;
  std::deque<Passage> passages_;
  bool has_announced_ = false;  // since the other side was woken
  /// Accounts are sent some time after something happened, and not while nothing does.
  struct Reminder final : Deadline {
    explicit Reminder(Bridge& bridge_) : bridge(bridge_) {}
    void fire(MonotonicTime) override;
    Bridge& bridge;
  };
  Reminder reminder_{*this};
  bool is_reminded_ = false;
  MonotonicTime next_accounts_{};
  std::size_t next_account_ = 0;
  std::size_t accounts_left_ = 0;  // to be looked at since something happened last
  std::deque<Note> notes_;         // that found no room yet; before any account
  std::uint64_t notes_lost_ = 0;   // too many waited

  // the receiving side
  std::vector<Passage*> heard_;  // by number; null: not heard of yet, so that what follows waits in the ring
};

}  // namespace rtdata::detail
