#include "sinks/core/sink_tap.hpp"

#include <algorithm>
#include <cassert>
#include <cstring>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "sinks/core/sink_node.hpp"

namespace rtdata::detail {
namespace {

/// The counts since `before`; `in_flight` is the current one.
SensorCounts since(const SensorCounts& before, SensorCounts now) {
  static_assert(sizeof now == 14 * sizeof(std::uint64_t) + 8, "each count but in_flight is here");
  now.scheduled -= before.scheduled;
  now.taken -= before.taken;
  now.published -= before.published;
  now.lateness -= before.lateness;
  now.late -= before.late;
  now.missed -= before.missed;
  now.failed -= before.failed;
  now.received -= before.received;
  now.repeated -= before.repeated;
  now.filtered -= before.filtered;
  now.unreadable -= before.unreadable;
  now.lost -= before.lost;
  now.first_lines -= before.first_lines;
  return now;
}

/// These counts are the same at each event as long as all goes well: a read that was in time, with one sample.
std::uint64_t course_of(const SensorCounts& c) noexcept {
  constexpr std::uint64_t apart = (std::uint64_t{1} << 32) + 1;
  const std::uint64_t others = c.late + c.missed + c.failed + c.repeated + c.filtered + c.unreadable + c.lost;
  return (c.has_schedule ? c.scheduled - c.published : 0) + others * apart;
}

}  // namespace

SinkTap::SinkTap(SinkNode& sink, std::shared_ptr<SinkQueue> queue, TopicCore& topic, std::uint32_t number, Takes takes)
    : sink_(sink),
      queue_(std::move(queue)),
      topic_(topic),
      number_(number),
      takes_(takes),
      payload_bytes_(topic.type.size),
      record_bytes_(record_bytes_of(topic.type.size)),
      run_(sink.run_of(topic)) {
  for (OriginCore* origin : topic.origins()) {
    origin->divide_gaps();  // what follows begins another
    if (origin->sensor != nullptr) origin->sensor->count_read_begun();
    before_.push_back({origin->counts, origin->has_segment() ? origin->segment({}) : Segment{}});
  }
}

void SinkTap::offer(OriginCore& origin, Time time, std::uint64_t sequence, const void* payload) {
  OriginSlot& place = places_[origin.index];
  const std::uint64_t course = course_of(origin.counts);
  if (takes_ == Takes::account) [[unlikely]] {
    if (std::exchange(place.course, course) != course)
      keep(origin, origin.is_mirror ? Now::between_events : Now::at_an_event);
    return;
  }
  if (place.first_sequence == 0 || (course != place.course && !origin.is_mirror)) [[unlikely]] {
    if (place.first_sequence == 0) place.first_sequence = sequence;
    place.course = course;
    keep(origin, origin.is_mirror ? Now::between_events : Now::at_an_event);
  }
  ++place.live->offered;
  place.last_sequence = sequence;
  if (takes_ == Takes::none) [[unlikely]] {  // the lane never has an event of this slot: the count is the loop's
    place.stored->refused.store(place.stored->refused.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
    return;
  }
  SinkQueue& queue = *queue_;
  std::byte* to = queue.room(place.slot, record_bytes_);
  if (to == nullptr) [[unlikely]]
    return sink_.start_work();
  const RecordHeader record{place.stored, to_nanoseconds(time), sequence};
  std::memcpy(to, &record, sizeof record);
  std::memcpy(to + sizeof record, payload, payload_bytes_);
  queue.commit(record_bytes_);
  if (queue.is_batch_due()) sink_.hand_over(SinkNode::Hand::rows);
}

void SinkTap::miss(OriginCore& origin, std::uint64_t count, std::uint64_t last_sequence) {
  if (takes_ == Takes::account) return;
  OriginSlot& place = places_[origin.index];
  place.live->offered += count;
  queue_->slot(place.slot).dropped_newest += count;
  if (place.first_sequence == 0) place.first_sequence = last_sequence - count + 1;
  place.last_sequence = last_sequence;
}

void SinkTap::expect(OriginCore& origin) {
  if (knows(origin)) return;
  assert(takes_ == Takes::none || topic_.type.description->size() == payload_bytes_);
  if (places_.size() <= origin.index) {
    const auto count = std::max<std::size_t>(origin.index + 1, topic_.origins().size());
    accounted_.resize(count);
    closed_.resize(count);
    ended_.resize(count);
    places_.resize(count);
  }
  begin_slot(origin);
  sink_.account_is_due();
}

void SinkTap::begin_slot(const OriginCore& origin) {
  const std::uint32_t slot = [&] {
    const LoopCore::OffLimits off_limits(*topic_.runtime().own_loop);  // to what the writer does in `live_counts`
    return queue_->add_slot({number_, origin.name, topic_.name, topic_.type.description, run_});
  }();
  places_[origin.index] = {queue_->slot(slot).live, &queue_->stored(slot), 0, 0, 0, slot};
}

void SinkTap::look_at_run() {
  std::string now = sink_.run_of(topic_);
  if (is_ended_ || now == run_) return;
  run_ = std::move(now);
  for (const OriginCore* origin : topic_.origins())
    if (knows(*origin)) begin_slot(*origin);
}

void SinkTap::keep_all() noexcept {
  for (const OriginCore* origin : topic_.origins())
    if (knows(*origin)) keep(*origin, Now::between_events);
}

void SinkTap::keep(const OriginCore& origin, Now when) noexcept {
  if (is_ended_) return;
  OriginAccount now = account_of(origin, MonotonicTime::min());
  if (when == Now::at_an_event) {  // which its origin has counted, and which is not offered yet
    --now.sensor.received;
    --(takes_ == Takes::account ? now.sensor.filtered : now.sensor.published);
  }
  if (now.segment.period == Duration{0}) now.segment = ended_[origin.index];
  const Closed& closed = closed_[origin.index];
  queue_->keep(now, closed.is_any ? &closed.gap : nullptr);
}

void SinkTap::note_closed(OriginCore& origin, const Gap& gap, std::uint64_t accounts) noexcept {
  Closed& closed = closed_[origin.index];
  Gap& all = closed.gap;
  if (!std::exchange(closed.is_any, true) || (closed.accounts != accounts && queue_->has_stored_accounts())) {
    all = gap;
  } else {
    if (all.count == 0) all.count = 1;  // without a schedule, how many
    all.count += std::max<std::uint64_t>(gap.count, 1);
    all.kind = Gap::Kind::joined;
    all.first = std::min(all.first, gap.first);  // a gap may be reported late
    all.last = std::max(all.last, gap.last);
    if (all.reason != gap.reason) all.reason = "several";
  }
  closed.accounts = accounts;
  keep(origin, Now::between_events);
}

void SinkTap::note_ended(const OriginCore& origin, const Segment& segment) noexcept { ended_[origin.index] = segment; }

OriginAccount SinkTap::account_of(const OriginCore& origin, MonotonicTime until) const noexcept {
  const OriginSlot& place = places_[origin.index];
  const Slot& slot = queue_->slot(place.slot);
  OriginAccount now{place.slot,
                    origin.counts,
                    0,
                    slot.live->offered,
                    slot.dropped_newest,
                    slot.dropped_oldest,
                    place.first_sequence,
                    place.last_sequence,
                    {},
                    {}};
  if (origin.index < before_.size()) {
    const SensorCounts& before = before_[origin.index].counts;
    now.sensor = since(before, now.sensor);
    now.carried = before.in_flight;
  }
  if (takes_ == Takes::account) now.sensor.filtered += std::exchange(now.sensor.published, 0);
  if (origin.has_segment()) now.segment = since_attached(origin, origin.segment(until));
  if (const Gap* gap = origin.gap_under_way()) {
    now.gap = *gap;
    now.has_gap = true;
  }
  return now;
}

Segment SinkTap::since_attached(const OriginCore& origin, Segment segment) const noexcept {
  if (origin.index >= before_.size()) return segment;
  const Segment& before = before_[origin.index].segment;
  if (before.scheduled == 0 || segment.first_due != before.first_due) return segment;
  segment.first_due = later(segment.first_due, multiple(static_cast<std::int64_t>(before.scheduled), before.period));
  segment.scheduled -= before.scheduled;
  return segment;
}

bool SinkTap::is_news(const OriginCore& origin, const OriginAccount& now) {
  OriginAccount& before = accounted_[origin.index];
  if (now.offered == before.offered && now.dropped_oldest == before.dropped_oldest &&
      now.sensor.lost == before.sensor.lost && now.sensor.scheduled == before.sensor.scheduled &&
      now.sensor.received == before.sensor.received && now.segment.period == before.segment.period &&
      now.sensor.in_flight == before.sensor.in_flight && now.has_gap == before.has_gap &&
      (!now.has_gap || (now.gap.first == before.gap.first && now.gap.kind == before.gap.kind))) {
    return false;
  }
  before = now;
  return true;
}

}  // namespace rtdata::detail
