// The implementation of a topic: its taps (sinks), its ring, its links (subscriptions).
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "loop/core/deliveries.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::detail {

class Channel;
class LoopCore;
class OriginCore;
class RuntimeCore;

/// The `type_key` of a topic of which a replay gives only the account: recordings alone take it.
struct NoEvents;

/// A sink's attachment to a topic. Copies each event when it is published.
class Tap {
 public:
  virtual void offer(OriginCore& origin, Time time, std::uint64_t sequence, const void* payload) = 0;
  /// `count` events up to this sequence were published on another loop but lost, because the ring in between was full.
  virtual void miss(OriginCore& origin, std::uint64_t count, std::uint64_t last_sequence) = 0;
  /// Call it before the first event of this origin: it allocates everything needed. Throws; may be called again.
  virtual void expect(OriginCore& origin) = 0;
  /// The origin calls it when its account changes without an event: ticks were missed or failed, or the schedule has
  /// changed.
  virtual void note_change(OriginCore& origin) noexcept = 0;
  /// False: it only needs the accounts of the topic's origins, so other loops send no events.
  virtual bool takes_events() const noexcept { return true; }

 protected:
  ~Tap() = default;
};

class TopicCore final : public DeliveryQueue {
 public:
  TopicCore(RuntimeCore& runtime, std::string name, PayloadType type);
  ~TopicCore();
  TopicCore(const TopicCore&) = delete;
  TopicCore& operator=(const TopicCore&) = delete;

  const std::string name;
  const PayloadType type;
  const std::size_t payload_offset;  ///< from an event's start

  /// Gives the event its sequence and a time after the origin's last event, and copies it to every tap and into the
  /// ring. Moves from `payload` if its type is not trivially copyable.
  void publish(OriginCore& origin, Time time, void* payload);

  /// The same with a recorded time and sequence, both above those of the origin's last event. For payloads with a
  /// description.
  void republish(OriginCore& origin, Time time, std::uint64_t sequence, const void* payload);

  /// An event from another loop, as brought by its bridge.
  struct Arrival {
    Time time;
    std::uint64_t sequence;
    // the payload
  };
  /// Receives arrivals of one origin, `stride` bytes apart.
  void receive(OriginCore& mirror, const Arrival* first, std::size_t count, std::size_t stride);
  /// See Tap::miss.
  void miss(OriginCore& mirror, std::uint64_t count, std::uint64_t last_sequence);

  /// Errors: description-differs.
  Result<void> link(SubscriptionNode& node);
  void unlink(SubscriptionNode& node) noexcept;
  void add_tap(Tap& tap);
  void expect(OriginCore& origin) {
    for (std::size_t i = 0; i < taps_.size(); ++i) taps_[i]->expect(origin);
  }
  void remove_tap(Tap& tap) noexcept {
    std::erase(taps_, &tap);
    followers_changed();
  }
  void notify_taps(OriginCore& origin) noexcept {
    for (std::size_t i = 0; i < taps_.size(); ++i) taps_[i]->note_change(origin);
  }
  // Channels to and from the same topic on other loops.
  void add_channel_out(Channel& channel) {
    channels_out_.push_back(&channel);
    followers_changed();
  }
  void add_channel_in(Channel& channel) {
    channels_in_.push_back(&channel);
    followers_changed();
  }
  void remove_channel(Channel& channel) noexcept {
    std::erase(channels_out_, &channel);
    std::erase(channels_in_, &channel);
    followers_changed();
  }
  /// Call it when subscribers or sinks may have changed. Tells other loops if this one needs their events.
  void followers_changed() noexcept;
  /// Call it when the origin's passage over a channel was made.
  void find_way(OriginCore& origin) noexcept;
  /// The last event, for topics that publish only changes. Empty: none yet.
  std::optional<EventView> last_change() const;
  /// Cancels queued deliveries of this origin.
  void cancel(const OriginCore& origin) noexcept;
  /// Delivers to every link.
  MonotonicTime deliver_group(LoopCore& loop, MonotonicTime begin, MonotonicTime time_limit) override;
  RuntimeCore& runtime() const noexcept { return runtime_; }
  /// The loop is destroyed: cancels everything queued.
  void abandon() noexcept;

  const SubscriptionNode* first_subscriber() const noexcept { return links_.empty() ? nullptr : links_.front().node; }
  SubscriptionCounts subscription_counts() const noexcept;
  SubscriptionCounts counts_of(const SubscriptionNode& node) const noexcept;
  std::vector<OriginCore*>& origins() noexcept { return origins_; }
  const std::vector<OriginCore*>& origins() const noexcept { return origins_; }

  std::string cut_off_from;  ///< another loop that publishes it, but whose events do not arrive; empty once reported
  OriginCore* program_origin = nullptr;  ///< of the program's own events, once there is one

 private:
  struct Link {
    SubscriptionNode* node;  // null: to be swept
    std::shared_ptr<const void> field_map;
    std::uint64_t from;  // ring position at subscription
    std::uint64_t next;  // ring position of the next event to deliver
    std::uint64_t dropped_before;
    std::uint64_t delivered = 0;
    std::uint64_t cancelled = 0;
  };
  void go_on(OriginCore& origin, Time time, std::uint64_t sequence, void* payload);
  void hand_out(OriginCore& origin, Time time, std::uint64_t sequence, void* payload);
  void enqueue(const OriginCore& origin, Time time, std::uint64_t sequence, void* payload);
  /// False: dropped, because another payload is being moved.
  bool move_payload(const OriginCore& origin, std::byte* to, void* payload);
  void make_ring(std::size_t capacity);
  std::byte* slot(std::uint64_t position) const noexcept { return slots_ + (position & mask_) * stride_; }
  SubscriptionCounts counts_of(const Link& link) const noexcept;
  void retire(Link& link) noexcept;
  /// Adapts the group size to the slowest handler.
  void adapt_group(Duration longest, const SubscriptionNode* slowest, bool is_complete) noexcept;
  /// Destroys what is queued up to this position.
  void drop_slots(std::uint64_t last) noexcept;

  RuntimeCore& runtime_;
  const bool is_short_;  // bytes to copy, and few
  enum class Followers : std::uint8_t { none, handlers, one_channel, several };
  Followers followers_ = Followers::none;  // where events go; several: sinks, or more than one of these
  std::vector<Tap*> taps_;
  std::vector<Channel*> channels_out_;
  std::vector<Channel*> channels_in_;
  std::vector<Link> links_;
  std::vector<OriginCore*> origins_;
  void keep_change(const OriginCore& origin, Time time, std::uint64_t sequence, const void* payload) noexcept;
  std::unique_ptr<std::byte[]> change_;  // the last event, like a slot; null: the topic publishes not only changes
  bool has_change_ = false;
  std::byte* slots_ = nullptr;
  std::vector<std::uint8_t> is_cancelled_;  // by slot; holds for events before `cancelled_until_`
  std::uint64_t cancelled_until_ = 0;
  std::size_t stride_ = 0;
  std::size_t mask_ = 0;
  std::uint64_t dropped_ = 0;
  std::uint64_t group_ = 1;                      // events per group, adapted to what handlers take
  const SubscriptionNode* slow_last_ = nullptr;  // took too long for the last group; compared only, it may be gone
  const SubscriptionNode* delivering_ = nullptr;
  bool needs_sweep_ = false;
  bool is_moving_cancelled_ = false;
  const OriginCore* moving_ = nullptr;  // the origin whose payload is being moved into the ring
  SubscriptionCounts retired_;
};

}  // namespace rtdata::detail
