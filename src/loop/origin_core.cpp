#include "loop/origin_core.hpp"

#include <algorithm>

#include "loop/bridge.hpp"
#include "loop/runtime_core.hpp"
#include "loop/topic_core.hpp"

namespace rtdata::detail {

OriginCore::OriginCore(std::string_view name_, TopicCore& topic_, std::uint32_t index_)
    : name(name_), topic(topic_), index(index_) {}

void OriginCore::begin_segment(MonotonicTime first_due, Duration period) {
  counts.has_schedule = true;
  first_due_ = first_due;
  period_ = period;
  scheduled_before_ = counts.scheduled;
  topic.tell_taps_of_change(*this);
}

MonotonicTime OriginCore::last_due() const noexcept {
  return first_due_ + (static_cast<std::int64_t>(counts.scheduled - scheduled_before_) - 1) * period_;
}

Segment OriginCore::segment(MonotonicTime end) const noexcept {
  const RuntimeCore& runtime = topic.runtime();
  const MonotonicTime last = last_due();
  if (is_mirror || end < last) end = last;  // within a turn, ticks are counted that its end is not told of yet
  return {runtime.event_time(first_due_), period_, runtime.event_time(end), counts.scheduled - scheduled_before_};
}

Time OriginCore::first_due() const noexcept { return topic.runtime().event_time(first_due_); }

void OriginCore::adopt(const State& state) noexcept {
  counts = state.counts;
  sequence = state.sequence;
  last_time = state.last_time;
  first_due_ = state.free_from;
  period_ = Duration{0};
  is_mirror = false;
  gap_is_open_ = false;  // who had the name has closed it
  if (passage != nullptr) passage->is_past = true;
  passage = nullptr;
}

void OriginCore::become_mirror(Passage& from) noexcept {
  is_mirror = true;
  if (passage != nullptr) passage->is_past = true;
  passage = &from;
  from.mirror = this;
}

void OriginCore::mirror(const SensorCounts& told, std::uint64_t last_sequence, const Segment& under_way,
                        const Gap* gap) {
  counts = told;
  sequence = last_sequence;
  first_due_ = topic.runtime().monotonic_of(under_way.first_due);
  period_ = under_way.period;
  scheduled_before_ = told.scheduled - under_way.scheduled;
  gap_is_open_ = gap != nullptr;
  if (gap_is_open_) {
    if (gap_ == nullptr) gap_ = std::make_unique<Gap>();
    *gap_ = *gap;
  }
  topic.tell_taps_of_change(*this);
}

void OriginCore::end_segment(MonotonicTime end) {
  if (!has_segment()) return;
  close_gap();
  const Segment ended = segment(end);
  first_due_ = std::max(end, last_due() + Duration{1});
  period_ = Duration{0};
  for (Listener* listener : topic.runtime().listeners) listener->on_segment(*this, ended);
  topic.tell_taps_of_change(*this);
}

void OriginCore::fail_read(std::string_view reason, MonotonicTime due) {
  --counts.in_flight;
  ++counts.failed;
  const bool is_of_last_segment = due < first_due_;  // a gap lies in one segment
  if (is_of_last_segment) close_gap();
  extend_gap(Gap::Kind::failed, reason, due, due, 1);
  if (is_of_last_segment) close_gap();
}

void OriginCore::fail_tick(std::string_view reason, MonotonicTime due) {
  ++counts.scheduled;
  ++counts.failed;
  extend_gap(Gap::Kind::failed, reason, due, due, 1);
}

void OriginCore::miss(std::uint64_t count, std::string_view reason, MonotonicTime first) {
  counts.scheduled += count;
  counts.missed += count;
  extend_gap(Gap::Kind::missed, reason, first, first + period_ * static_cast<std::int64_t>(count - 1), count);
}

void OriginCore::extend_gap(Gap::Kind kind, std::string_view reason, MonotonicTime first, MonotonicTime last,
                            std::uint64_t count) {
  const RuntimeCore& runtime = topic.runtime();
  if (gap_is_open_ && (gap_->kind != kind || gap_->reason != reason)) close_gap();
  if (!gap_is_open_) {
    if (gap_ == nullptr) gap_ = std::make_unique<Gap>();
    *gap_ = {kind, reason, runtime.event_time(first), {}, 0};
    gap_is_open_ = true;
  }
  gap_->last = runtime.event_time(last);
  gap_->count += count;
  topic.tell_taps_of_change(*this);
}

void OriginCore::close_gap() noexcept {
  if (!gap_is_open_) return;
  const Gap closed = *gap_;
  gap_is_open_ = false;
  for (Listener* listener : topic.runtime().listeners) listener->on_gap(*this, closed);
}

}  // namespace rtdata::detail
