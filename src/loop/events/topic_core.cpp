#include "loop/events/topic_core.hpp"

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstring>
#include <new>

#include "data/copy.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/bridge.hpp"

namespace rtdata::detail {
namespace {

// Events with a very fast handler share one clock reading; a handler of some microseconds is timed for each event. The
// aim applies to the events of a group in one handler.
constexpr std::uint64_t most_in_group = 128;
constexpr Duration group_aim = std::chrono::microseconds{5};
// A single handler longer than the aim was usually interrupted; beyond this limit it counts as slow at once.
constexpr Duration slow_at_once = 20 * group_aim;

// Leaves room for a time after the last event's.
constexpr Time latest_time = Time::max() - std::chrono::hours{24};

}  // namespace

TopicCore::TopicCore(RuntimeCore& runtime, std::string name_, PayloadType type_)
    : name(std::move(name_)),
      type(std::move(type_)),
      payload_offset(event_payload_offset(type.alignment)),
      runtime_(runtime),
      is_short_(type.move_construct == nullptr && type.size <= few_bytes) {
  if (type.description == nullptr || !type.description->is_of_changes() || type.move_construct != nullptr ||
      type.alignment > alignof(std::max_align_t))
    return;
  change_ = std::make_unique<std::byte[]>(payload_offset + type.size);
  followers_ = Followers::several;
}

TopicCore::~TopicCore() {
  drop_slots(head_);
  ::operator delete (slots_, std::align_val_t{64});
}

inline void TopicCore::go_on(OriginCore& origin, Time time, std::uint64_t sequence, void* payload) {
  origin.last_time = time;
  origin.sequence = sequence;
  if (followers_ == Followers::none) return;
  if (followers_ == Followers::one_channel) {
    if (origin.only_way != nullptr) origin.only_way->channel->send(*origin.only_way, time, sequence, payload);
    return;
  }
  if (followers_ == Followers::several) return hand_out(origin, time, sequence, payload);
  if (!is_short_ || !is_ready() || head_ - tail_ > mask_) return enqueue(origin, time, sequence, payload);
  // One of a burst of short ones, for handlers alone: without a call.
  std::byte* to = slot(head_++);
  ::new (to) EventHeader{time, sequence, origin.name};
  copy_few(to + payload_offset, payload, type.size);
}

void TopicCore::publish(OriginCore& origin, Time time, void* payload) {
  if (time <= origin.last_time || time > latest_time) [[unlikely]]
    time = std::max(std::min(time, latest_time), origin.last_time + Duration{1});
  go_on(origin, time, origin.sequence + 1, payload);
}

void TopicCore::republish(OriginCore& origin, Time time, std::uint64_t sequence, const void* payload) {
  go_on(origin, time, sequence, const_cast<void*>(payload));
}

void TopicCore::keep_change(const OriginCore& origin, Time time, std::uint64_t sequence, const void* payload) noexcept {
  ::new (change_.get()) EventHeader{time, sequence, origin.name};
  std::memcpy(change_.get() + payload_offset, payload, type.size);
  has_change_ = true;
}

std::optional<EventView> TopicCore::last_change() const {
  if (!has_change_) return std::nullopt;
  return view_of(*this, change_.get());
}

void TopicCore::hand_out(OriginCore& origin, Time time, std::uint64_t sequence, void* payload) {
  if (change_ != nullptr) keep_change(origin, time, sequence, payload);
  for (std::size_t i = 0; i < taps_.size(); ++i) taps_[i]->offer(origin, time, sequence, payload);
  for (Channel* channel : channels_out_) {
    if (Passage* passage = channel->passage_of(origin)) channel->send(*passage, time, sequence, payload);
  }
  if (!links_.empty()) enqueue(origin, time, sequence, payload);
}

void TopicCore::enqueue(const OriginCore& origin, Time time, std::uint64_t sequence, void* payload) {
  if (head_ - tail_ > mask_) {
    ++dropped_;
    return;
  }
  std::byte* to = slot(head_);
  ::new (to) EventHeader{time, sequence, origin.name};
  if (type.move_construct == nullptr) [[likely]] {
    copy_short(to + payload_offset, payload, type.size);
  } else if (!move_payload(origin, to + payload_offset, payload)) {
    return;
  }
  ++head_;
  if (!is_ready()) runtime_.own_loop->deliveries.add(*this);
}

void TopicCore::receive(OriginCore& mirror, const Arrival* first, std::size_t count, std::size_t stride) {
  const auto arrival = [&](std::size_t i) {
    return reinterpret_cast<const Arrival*>(reinterpret_cast<const std::byte*>(first) + i * stride);
  };
  mirror.sequence = arrival(count - 1)->sequence;
  mirror.last_time = arrival(count - 1)->time;
  if (change_ != nullptr)
    keep_change(mirror, arrival(count - 1)->time, arrival(count - 1)->sequence, arrival(count - 1) + 1);
  for (std::size_t i = 0; i < count && !taps_.empty(); ++i) {
    const Arrival& event = *arrival(i);
    for (std::size_t tap = 0; tap < taps_.size(); ++tap)
      taps_[tap]->offer(mirror, event.time, event.sequence, &event + 1);
  }
  if (links_.empty()) return;
  const std::uint64_t taken = std::min<std::uint64_t>(count, mask_ + 1 - (head_ - tail_));
  dropped_ += count - taken;
  const auto copy_all = [&, all = mask_ + 1, slot_bytes = stride_, origin = std::string_view(mirror.name),
                         size = type.size](auto copy) {
    std::byte* to = slot(head_);
    const std::uint64_t to_ring_end = all - (head_ & mask_);
    for (std::size_t i = 0; i < taken; ++i, to += slot_bytes) {
      if (i == to_ring_end) [[unlikely]]
        to = slots_;
      const Arrival* from = arrival(i);
      ::new (to) EventHeader{from->time, from->sequence, origin};
      copy(to + payload_offset, from + 1, size);
    }
  };
  if (is_short_) {
    copy_all([](std::byte* to, const void* from, std::size_t size) { copy_few(to, from, size); });
  } else {
    copy_all([](std::byte* to, const void* from, std::size_t size) { std::memcpy(to, from, size); });
  }
  head_ += taken;
  if (taken > 0 && !is_ready()) runtime_.own_loop->deliveries.add(*this);
}

void TopicCore::miss(OriginCore& mirror, std::uint64_t count, std::uint64_t last_sequence) {
  for (std::size_t i = 0; i < taps_.size(); ++i) taps_[i]->miss(mirror, count, last_sequence);
  if (!links_.empty()) dropped_ += count;
}

void TopicCore::followers_changed() noexcept {
  const Followers before = followers_;
  const bool is_wanted = !links_.empty() || runtime_.exchange.is_wanted(name) ||
                         std::any_of(taps_.begin(), taps_.end(), [](const Tap* tap) { return tap->takes_events(); });
  if (change_ != nullptr) {
    followers_ = Followers::several;
  } else if (taps_.empty() && channels_out_.empty()) {
    followers_ = links_.empty() ? Followers::none : Followers::handlers;
  } else {
    followers_ = taps_.empty() && !is_wanted && channels_out_.size() == 1 ? Followers::one_channel : Followers::several;
  }
  if (followers_ != before) {
    for (OriginCore* origin : origins_) find_way(*origin);
  }
  for (Channel* channel : channels_in_) channel->set_wanted(is_wanted);
}

void TopicCore::find_way(OriginCore& origin) noexcept {
  origin.only_way = followers_ == Followers::one_channel ? channels_out_.front()->passage_of(origin) : nullptr;
}

bool TopicCore::move_payload(const OriginCore& origin, std::byte* to, void* payload) {
  // The payload's constructor is user code: it may publish here, stop its sensor, and throw.
  if (moving_ != nullptr) {  // the place is being filled
    ++dropped_;
    return false;
  }
  const LoopCore::Calling user_code(runtime_);
  moving_ = &origin;
  is_moving_cancelled_ = false;
  try {
    type.move_construct(to, payload);
  } catch (...) {
    moving_ = nullptr;
    ++dropped_;
    throw;
  }
  moving_ = nullptr;
  if (is_moving_cancelled_) {
    const auto index = [&](std::uint64_t i) { return static_cast<std::size_t>(i & mask_); };
    for (std::uint64_t i = std::max(tail_, cancelled_until_); i < head_; ++i) is_cancelled_[index(i)] = 0;
    is_cancelled_[index(head_)] = 1;
    cancelled_until_ = head_ + 1;
  }
  return true;
}

void TopicCore::make_ring(std::size_t capacity) {
  const std::size_t alignment = std::max(type.alignment, alignof(EventHeader));
  stride_ = (payload_offset + type.size + alignment - 1) / alignment * alignment;
  const std::size_t slots = std::bit_ceil(std::max<std::size_t>(capacity, 2));
  mask_ = slots - 1;
  is_cancelled_.resize(slots);
  slots_ = static_cast<std::byte*>(::operator new (slots* stride_, std::align_val_t{64}));
}

void TopicCore::add_tap(Tap& tap) {
  for (OriginCore* origin : origins_) {
    if (origin->is_claimed || origin->is_mirror) tap.expect(*origin);
  }
  taps_.push_back(&tap);
  followers_changed();
}

Result<void> TopicCore::link(SubscriptionNode& node) {
  auto map = node.accept(*this);
  if (!map) return std::move(map).error();
  if (slots_ == nullptr) make_ring(runtime_.config.ring_events);
  links_.push_back({&node, std::move(*map), head_, head_, dropped_});
  followers_changed();
  return {};
}

SubscriptionCounts TopicCore::counts_of(const Link& link) const noexcept {
  SubscriptionCounts counts;
  counts.dropped = dropped_ - link.dropped_before;
  counts.offered = head_ - link.from + counts.dropped;
  counts.delivered = link.delivered;
  counts.cancelled = link.cancelled;
  counts.queued = head_ - link.next;
  return counts;
}

void TopicCore::retire(Link& link) noexcept {
  link.cancelled += head_ - link.next;
  link.next = head_;
  retired_.add(counts_of(link));
  link.node = nullptr;
  needs_sweep_ = true;
}

void TopicCore::unlink(SubscriptionNode& node) noexcept {
  if (delivering_ == &node) return;  // its deliver() is on the stack: retired when that returns
  bool is_linked = false;
  for (Link& link : links_) {
    if (link.node != &node) continue;
    retire(link);
    is_linked = true;
  }
  if (!is_linked) return;
  if (delivering_ == nullptr) std::erase_if(links_, [](const Link& link) { return link.node == nullptr; });
  followers_changed();
}

void TopicCore::cancel(const OriginCore& origin) noexcept {
  if (moving_ == &origin) is_moving_cancelled_ = true;
  const auto index = [&](std::uint64_t i) { return static_cast<std::size_t>(i & mask_); };
  for (std::uint64_t i = std::max(tail_, cancelled_until_); i < head_; ++i) is_cancelled_[index(i)] = 0;
  for (std::uint64_t i = tail_; i != head_; ++i) {
    const auto& header = *reinterpret_cast<const EventHeader*>(slot(i));
    if (header.origin.data() == origin.name.data()) is_cancelled_[index(i)] = 1;
  }
  cancelled_until_ = head_;
}

MonotonicTime TopicCore::deliver_group(LoopCore& loop, MonotonicTime begin, MonotonicTime time_limit) {
  const std::uint64_t to_ring_end = mask_ + 1 - (tail_ & mask_);
  const std::uint64_t end = tail_ + std::min({group_, round_end_ - tail_, to_ring_end});
  MonotonicTime from = begin;
  Duration longest{0};
  const SubscriptionNode* slowest = nullptr;
  bool is_complete = true;
  for (std::size_t i = 0; i < links_.size(); ++i) {
    SubscriptionNode* node = links_[i].node;
    if (node == nullptr || links_[i].next >= end) continue;
    if (from != begin && loop.deliveries.must_pause(from, time_limit)) {
      is_complete = false;  // the next call continues with this handler
      break;
    }
    const std::uint64_t next = links_[i].next;
    const EventRun run{*this,           slot(next), stride_, next, end - next, is_cancelled_.data() + (next & mask_),
                       cancelled_until_};
    const auto map = links_[i].field_map;
    delivering_ = node;
    {
      Call call(*node);
      loop.nodes.begins(node);
      loop.deliveries.handler_begins(from);
      const auto result = node->deliver(run, map.get());
      Link& link = links_[i];  // the vector may have grown meanwhile
      link.delivered += result.seen - result.cancelled;
      link.cancelled += result.cancelled;
      link.next += result.seen;
      const MonotonicTime to = std::max(from, loop.quick_now());
      loop.blame.time_callback(node->times, from, to, [&] { return node->name; });
      if (to - from > longest) {
        longest = to - from;
        slowest = node;
      }
      from = to;
      if (!node->is_open()) retire(links_[i]);  // a report of its time may have added links
    }
    delivering_ = nullptr;
  }
  adapt_group(longest, slowest, is_complete);
  if (is_complete) drop_slots(end);
  if (needs_sweep_) {
    std::erase_if(links_, [](const Link& link) { return link.node == nullptr; });
    needs_sweep_ = false;
    followers_changed();
    if (links_.empty()) drop_slots(head_);
  }
  return from;
}

void TopicCore::adapt_group(Duration longest, const SubscriptionNode* slowest, bool is_complete) noexcept {
  if (longest <= group_aim) {
    slow_last_ = nullptr;
    if (is_complete && longest < group_aim / 2 && group_ < most_in_group) group_ *= 2;
    return;
  }
  const bool is_slow = slowest == std::exchange(slow_last_, slowest) || longest > slow_at_once;
  if (is_slow)
    group_ = std::max<std::uint64_t>(
        group_ * static_cast<std::uint64_t>(group_aim.count()) / static_cast<std::uint64_t>(longest.count()), 1);
}

void TopicCore::drop_slots(std::uint64_t last) noexcept {
  if (type.destroy == nullptr) {
    tail_ = last;
    return;
  }
  // Destructors are user code and may publish; a slot is free after its payload is destroyed.
  for (; tail_ != last; ++tail_) type.destroy(slot(tail_) + payload_offset);
}

void TopicCore::abandon() noexcept {
  const LoopCore::Calling user_code(runtime_);  // destructors run user code; nothing must be delivered meanwhile
  drop_slots(head_);
}

SubscriptionCounts TopicCore::subscription_counts() const noexcept {
  SubscriptionCounts sum = retired_;
  for (const Link& link : links_) {
    if (link.node != nullptr) sum.add(counts_of(link));
  }
  return sum;
}

SubscriptionCounts TopicCore::counts_of(const SubscriptionNode& node) const noexcept {
  for (const Link& link : links_) {
    if (link.node == &node) return counts_of(link);
  }
  return {};
}

}  // namespace rtdata::detail
