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
#include <vector>

#include "data/copy.hpp"
#include "loop/byte_ring.hpp"
#include "loop/deadline.hpp"
#include "loop/loop_core.hpp"
#include "loop/runtime_core.hpp"
#include "loop/topic_core.hpp"

namespace rtdata::detail {

class Bridge;

/// One sensor (origin) and its mirror.
struct Passage {
  Passage(std::uint32_t number_, OriginCore& source_, Channel& channel_)
      : number(number_), source(&source_), channel(&channel_) {}
  const std::uint32_t number;  // among its bridge's
  OriginCore* const source;    // the sending side's
  Channel* const channel;
  std::uint64_t dropped = 0;  // the sending side's: for want of room in the ring, counted from the beginning
  std::uint64_t told_dropped = 0;
  struct Told {
    std::uint64_t grown = 0;  // sum of counts, each of which only grows
    Duration period{0};
    bool has_sensor = false;
    bool is_active = false;
    Health health = Health::ok;
    bool operator==(const Told&) const = default;
  };
  Told told;                        // what its last account said
  bool is_given_up = false;         // another loop has the name
  std::uint64_t last_sequence = 0;  // then
  OriginCore* mirror = nullptr;     // from here on the receiving side's; null: its topic cannot be what it is elsewhere
  bool is_past = false;             // another loop has the name
  std::uint64_t known_dropped = 0;
  Duration period{0};
  bool is_active = false;
  bool has_sensor = false;
  Health health = Health::ok;
  std::string reason;
};

/// One topic and its mirror.
class Channel {
 public:
  Channel(Bridge& bridge, TopicCore& source);

  // The sending side
  void send(OriginCore& origin, Time time, std::uint64_t sequence, const void* payload);

  // The receiving side
  void set_wanted(bool is_wanted) noexcept { is_wanted_.store(is_wanted, std::memory_order_relaxed); }

 private:
  friend class Bridge;
  void look_for_room(Passage& passage, Time time, std::uint64_t sequence, const void* payload);
  /// Where its payload goes.
  static std::byte* begin_event(std::byte* room, const Passage& passage, Time time, std::uint64_t sequence);
  Bridge& bridge_;
  TopicCore& source_;
  const std::uint32_t record_bytes_;
  std::vector<Passage*> passages_;     // the sending side's, by the origin's index within the topic
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
  void on_error(Time time, std::string_view object, const Error& error, std::uint64_t count) override;
  void on_health(Time time, const HealthChange& change) override;
  /// What was sent can be taken by the other side, which is woken for it.
  void wake() noexcept;
  // Neither side runs user code in any of these: what there is to report is kept.
  /// The end of a turn of the sending loop: sends accounts, and wakes the other side.
  void turn_done();
  /// Sends how the sensors do, all of them, now.
  void send_accounts();
  /// Another loop has the name of this origin: its account is no longer told.
  void give_up(const OriginCore& origin) noexcept;
  /// The sending loop is about to go: all that is left crosses. On either thread, while none of the loops turns.
  void finish();

  // ---- the receiving side
  void hear(Announcement& announcement);
  /// Takes what was sent before the call.
  void receive();
  void add_statuses(std::vector<SensorStatus>& all) const;

 private:
  friend class Channel;
  /// The other side is woken before the end of the turn when so much waits: both work at the same time then.
  static constexpr unsigned most_unannounced = 128;
  enum class Sort : std::uint32_t { event, gap, segment, account, drops };
  struct Record {         // the ring's records begin with it
    std::uint32_t bytes;  // the ring's
    std::uint32_t tag;    // what it is, and the passage's number
    static std::uint32_t tag_of(Sort sort, const Passage& passage) noexcept {
      return passage.number << 3 | static_cast<std::uint32_t>(sort);
    }
    Sort sort() const noexcept { return static_cast<Sort>(tag & 7); }
    std::uint32_t passage() const noexcept { return tag >> 3; }
    bool operator==(const Record&) const = default;
  };
  struct EventRecord : Record {
    TopicCore::Arrival event;
    // the payload
  };
  struct GapRecord : Record {
    Gap gap;
  };
  struct SegmentRecord : Record {
    Segment segment;
  };
  struct AccountRecord : Record {
    std::uint64_t dropped;
    SensorCounts counts;
    std::uint64_t sequence;
    Segment under_way;
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
  bool send_drops(Passage& passage, std::uint64_t last_sequence, ByteRing::Room room) noexcept;
  enum class Accounts { news, all };
  bool send_account(Passage& passage, ByteRing::Room room, Accounts which) noexcept;
  void send_some_accounts();
  void commit(std::uint32_t bytes) noexcept {
    ring_.commit(bytes);
    if (++unannounced_ >= most_unannounced) wake();
  }
  void announce(Channel* channel, Passage* passage, const std::string& name, PayloadType type);
  /// Up to the first record of an origin that is not heard of yet. Returns whether there was none.
  bool take_heard();
  /// The front of the ring, and those alike behind it.
  void take_events(const EventRecord& first, Passage& passage);
  void take(const Record& record, Passage& passage);
  void note_drops(Passage& passage, std::uint64_t dropped, std::uint64_t last_sequence);

  LoopCore& from_;
  LoopCore& to_;
  ByteRing ring_;
  const bool is_to_main_;  // which has the sinks and shows the sensors

  // the sending side
  std::deque<Channel> channels_;
  std::unordered_map<const TopicCore*, Channel*> channel_by_topic_;
  std::deque<Passage> passages_;
  unsigned unannounced_ = 0;  // what was sent since the other side was woken, and cannot be seen there yet
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
  std::uint64_t notes_lost_ = 0;   // gaps and segments that found no room

  // the receiving side
  std::vector<Passage*> heard_;  // by number; null: not heard of yet, so that what follows waits in the ring
};

}  // namespace rtdata::detail
