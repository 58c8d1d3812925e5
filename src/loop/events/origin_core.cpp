#include "loop/events/origin_core.hpp"

#include <algorithm>
#include <new>
#include <utility>

#include "data/fitting.hpp"
#include "loop/events/topic_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/loop/gaps.hpp"

namespace rtdata::detail {

OriginCore::OriginCore(std::string_view name_, TopicCore& topic_, std::uint32_t index_)
    : name(name_), topic(topic_), index(index_) {}

void OriginCore::begin_segment(MonotonicTime first_due, Duration period) noexcept {
  counts.has_schedule = true;
  if (gaps_ != nullptr && gaps_->away_period > Duration{0}) [[unlikely]]
    miss_while_away(std::min(first_due, topic.runtime().clock().monotonic()));
  first_due_ = first_due;
  period_ = period;
  scheduled_before_ = counts.scheduled;
  topic.tell_taps_of_change(*this);
}

void OriginCore::miss_while_away(MonotonicTime until) noexcept {
  const Duration period = std::exchange(gaps_->away_period, Duration{0});
  const std::int64_t ticks = span_between(free_from(), until) / period;
  if (ticks <= 0) return;
  begin_segment(later(until, -multiple(ticks, period)), period);
  miss(static_cast<std::uint64_t>(ticks), "made anew", first_due_);
  end_segment(last_due());
}

MonotonicTime OriginCore::last_due() const noexcept {
  const auto ticks = static_cast<std::int64_t>(counts.scheduled - scheduled_before_);
  return ticks == 0 ? later(first_due_, -period_) : later(first_due_, multiple(ticks - 1, period_));
}

Segment OriginCore::segment(MonotonicTime end) const noexcept {
  const RuntimeCore& runtime = topic.runtime();
  const MonotonicTime last = last_due();
  end = std::min(end, later(kept_due_, Duration{-1}));
  if (is_mirror || end < last) end = last;  // within a turn, ticks are counted that are due after `handled_until`
  return {runtime.event_time(first_due_), period_, runtime.event_time(end), counts.scheduled - scheduled_before_,
          late_after};
}

Time OriginCore::first_due() const noexcept { return topic.runtime().event_time(first_due_); }

void OriginCore::adopt(const State& state) {
  if (state.outages.number != 0) expect_gaps();
  mirror(state.outages, Time::min());
  counts = state.counts;
  sequence = state.sequence;
  last_time = state.last_time;
  supply = state.supply;
  first_due_ = state.free_from;
  period_ = Duration{0};
  is_mirror = false;
  comes_from = nullptr;
  gap_is_open_ = false;  // the last holder of the name has closed it
}

void OriginCore::mirror(const SensorCounts& sent, std::uint64_t last_sequence, const Segment& under_way,
                        const Gap* gap) noexcept {
  counts = sent;
  sequence = last_sequence;
  first_due_ = topic.runtime().clock_log.monotonic_of(under_way.first_due);
  period_ = under_way.period;
  late_after = under_way.late_after;
  scheduled_before_ = sent.scheduled - under_way.scheduled;
  gap_is_open_ = gap != nullptr;
  if (gap_is_open_) gaps_->gap = *gap;
  topic.tell_taps_of_change(*this);
}

void OriginCore::mirror(const Outages& ended, Time absent_since) noexcept {
  if (gaps_ == nullptr && ended.number == 0) return;
  gaps_->outages = ended;
  gaps_->absent_since = absent_since;
}

Outages OriginCore::outages(Time now) const noexcept {
  Outages all = ended_outages();
  if (const Time since = absent_since(); since != Time::min() && now > since) all.time += now - since;
  return all;
}

void OriginCore::end_segment(MonotonicTime end) noexcept {
  if (!has_segment()) return;
  close_gap();
  const Segment ended = segment(end);
  first_due_ = std::max(end, later(last_due(), Duration{1}));
  period_ = Duration{0};
  for (Listener* listener : topic.runtime().listeners) listener->on_segment(*this, ended);
  topic.tell_taps_of_change(*this);
}

void OriginCore::count_lateness(MonotonicTime due) noexcept {
  const auto number = [](Time time) { return static_cast<std::uint64_t>(to_nanoseconds(time)); };
  counts.lateness += number(last_time) - number(topic.runtime().event_time(due));
}

void OriginCore::fail_read(std::string_view reason, MonotonicTime due) noexcept {
  --counts.in_flight;
  ++counts.failed;
  const bool is_of_last_segment = due < first_due_;  // a gap lies in one segment
  if (is_of_last_segment) close_gap();
  extend_gap(Gap::Kind::failed, reason, due, due, 1);
  if (is_of_last_segment) close_gap();
}

void OriginCore::fail_tick(std::string_view reason, MonotonicTime due) noexcept {
  ++counts.scheduled;
  ++counts.failed;
  extend_gap(Gap::Kind::failed, reason, due, due, 1);
}

void OriginCore::miss(std::uint64_t count, std::string_view reason, MonotonicTime first) noexcept {
  counts.scheduled += count;
  counts.missed += count;
  extend_gap(Gap::Kind::missed, reason, first, first + period_ * static_cast<std::int64_t>(count - 1), count);
}

void OriginCore::extend_gap(Gap::Kind kind, std::string_view reason, MonotonicTime first, MonotonicTime last,
                            std::uint64_t count) noexcept {
  const Time from = topic.runtime().event_time(first), to = topic.runtime().event_time(last);
  if (gaps_ == nullptr) {
    gaps_.reset(new (std::nothrow) Gaps);
    if (gaps_ == nullptr) {  // no memory to join it with the next ones: it stands for itself
      report({kind, reason, from, to, count});
      return topic.tell_taps_of_change(*this);
    }
  }
  Gaps& now = *gaps_;
  // A read that was under way when the gaps around it were joined and reported.
  if (from <= now.joined_up_to && count != 0) return report({kind, reason, from, to, count});
  const bool goes_on = gap_is_open_ && !now.is_interrupted && now.last_kind == kind && now.last_reason == reason &&
                       from == later(now.gap.last, period_);
  if (gap_is_open_ && !goes_on && !now.is_joining) close_gap();
  if (!gap_is_open_) {
    now.gap = {kind, reason, from, to, 0};
    now.parts = 0;
    now.is_joining = !now.allowance.has_some(from.time_since_epoch());
    gap_is_open_ = true;
  }
  if (now.parts == 0 || !goes_on) ++now.parts;
  if (now.parts > 1) now.gap.kind = Gap::Kind::joined;
  if (now.gap.reason != reason) now.gap.reason = "several";
  now.gap.first = std::min(now.gap.first, from);
  now.gap.last = std::max(now.gap.last, to);
  now.gap.count += count;
  now.last_kind = kind;
  now.last_reason = reason;
  now.is_interrupted = false;
  topic.tell_taps_of_change(*this);
}

void OriginCore::begin_absence(Gap::Kind kind, std::string_view reason, MonotonicTime from) noexcept {
  if (gaps_->is_absence) return;
  if (gap_is_open_) gaps_->is_interrupted = true;  // several that are joined
  extend_gap(kind, reason, from, from, 0);
  gaps_->is_absence = gap_is_open_;
  ++gaps_->outages.number;
  gaps_->absent_since = topic.runtime().event_time(from);
}

void OriginCore::end_absence(MonotonicTime to) noexcept {
  if (gaps_ == nullptr || !std::exchange(gaps_->is_absence, false)) return;
  const Time end = topic.runtime().event_time(to);
  gaps_->outages.time += std::max(end - std::exchange(gaps_->absent_since, Time::min()), Duration{0});
  gaps_->gap.last = std::max(gaps_->gap.last, end);
  interrupt_gap();
}

void OriginCore::interrupt_gap() noexcept {
  if (!gaps_->is_joining) return close_gap();
  gaps_->is_interrupted = true;
  const Time now = has_segment() ? topic.runtime().event_time(last_due()) : gaps_->gap.last;
  if (gaps_->allowance.has_some(now.time_since_epoch())) close_gap();
}

void OriginCore::close_gap() noexcept {
  if (!gap_is_open_ || is_mirror) return;  // a mirror's closes on its own loop
  if (gaps_->is_absence) {
    RuntimeCore& runtime = topic.runtime();
    gaps_->gap.last = std::max(gaps_->gap.last, runtime.event_time(runtime.clock().monotonic()));
  }
  Gap closed = gaps_->gap;
  if (closed.kind == Gap::Kind::joined && closed.count == 0) closed.count = gaps_->parts;  // without a schedule
  gap_is_open_ = gaps_->is_absence;
  if (gap_is_open_) {
    gaps_->gap = {gaps_->last_kind, gaps_->last_reason, closed.last, closed.last, 0};
    gaps_->parts = 1;
    gaps_->is_joining = false;
  }
  gaps_->allowance.spend(closed.last.time_since_epoch());
  if (closed.kind == Gap::Kind::joined) gaps_->joined_up_to = closed.last;
  report(closed);
}

void OriginCore::divide_gaps() noexcept {
  close_gap();
  if (gaps_ == nullptr) return;
  if (gaps_->joined_up_to != Time::min() || gaps_->parts != 0)
    gaps_->joined_up_to = std::max(gaps_->joined_up_to, topic.runtime().event_time(last_due()));
}

void OriginCore::report(const Gap& gap) noexcept {
  for (Listener* listener : topic.runtime().listeners) listener->on_gap(*this, gap);
  publish_gap(*this, gap);
}

void publish_gap(const OriginCore& origin, const Gap& gap) noexcept {
  RuntimeCore& runtime = origin.topic.runtime();
  TopicCore* const to = runtime.hub == nullptr ? runtime.find_topic(gap_topic) : nullptr;  // else the main loop does it
  if (to == nullptr || to->type.type_key != payload_type<GapEvent>().type_key) return;
  try {
    const GapEvent event{fitting<200>(origin.name),
                         fitting<200>(origin.topic.name),
                         fitting<16>(name_of(gap.kind)),
                         fitting<96>(gap.reason),
                         to_nanoseconds(gap.first),
                         to_nanoseconds(gap.last),
                         gap.count};
    publish_from_program(*to, &event);
  } catch (...) {  // no memory: recordings have it
  }
}

}  // namespace rtdata::detail
