#include "recording/verify_ticks.hpp"

#include <algorithm>

namespace rtdata::detail {
bool TickCheck::is_held(const LedgerEntry& entry) {
  const SensorCounts& s = entry.sensor;
  return s.has_schedule && s.is_one_a_read && s.published == entry.offered &&
         s.published + s.repeated + s.filtered == s.taken;
}

TickCheck::TickCheck(const LedgerEntry& entry, const std::vector<const RecordedSegment*>& segments,
                     const std::vector<const RecordedGap*>& gaps, const UtcLine& line)
    : line_(&line),
      first_sequence_(entry.first_sequence),
      carried_(entry.carried),
      more_ticks_(entry.sensor.repeated + entry.sensor.filtered),
      is_exact_(carried_ == 0 && more_ticks_ == 0) {
  std::size_t next_gap = 0;
  for (std::size_t i = 0; i < segments.size(); ++i) {
    if (segments[i]->segment.period.count() > 0) {
      // One may end when the next begins: what begins then is the next one's.
      const Time before = i + 1 < segments.size() ? segments[i + 1]->segment.first_due : Time::max();
      add_segment(i, segments[i]->segment, before, gaps, next_gap);
    }
  }
  for (; next_gap < gaps.size(); ++next_gap) {
    // The read that was under way when the recording began may have a gap without any schedule.
    if (!segments.empty() || carried_ == 0) mistake(describe(*gaps[next_gap]) + " lies after the schedule");
  }
}

void TickCheck::add_segment(std::size_t number, const Segment& segment, Time before,
                            const std::vector<const RecordedGap*>& gaps, std::size_t& next_gap) {
  const std::int64_t first = to_nanoseconds(segment.first_due), period = segment.period.count();
  const auto ticks = static_cast<std::int64_t>(segment.computed());
  std::int64_t at = 0;  // the first tick that is in no stretch yet
  // Joined gaps and the readings between them: only the number of taken ticks is known, not which ones.
  std::int64_t joined_from = 0, joined_up_to = -1;
  std::uint64_t joined = 0;
  const auto end_joined = [&] {
    if (joined_up_to < joined_from) return;
    const auto span = static_cast<std::uint64_t>(joined_up_to - joined_from + 1);
    if (joined > span) {
      mistake("from " + utc(first + joined_from * period) + " on, " + std::to_string(joined) + " of " +
              std::to_string(span) + " ticks are in gaps");
    }
    add_stretch(number, segment, joined_from, span, std::min(joined, span));
    at = joined_up_to + 1;
    joined_up_to = -1;
    joined_from = 0;
    joined = 0;
  };
  for (; next_gap < gaps.size() && gaps[next_gap]->first <= segment.end && gaps[next_gap]->first < before; ++next_gap) {
    const RecordedGap& gap = *gaps[next_gap];
    if (gap.last < segment.first_due) {  // the gap of a read that was under way when the recording began
      if (number != 0 || carried_ == 0) mistake(describe(gap) + " belongs to no schedule");
      continue;
    }
    std::int64_t from = gap.first < segment.first_due ? 0 : (to_nanoseconds(gap.first) - first) / period;
    const std::int64_t up_to = (to_nanoseconds(gap.last) - first) / period;
    if (up_to >= ticks) {
      mistake(describe(gap) + " continues after the schedule, up to " + utc(gap.last));
      continue;
    }
    const bool is_joined = gap.kind == "joined";
    const bool is_within = joined_up_to >= joined_from && from <= joined_up_to;
    if (!is_within) end_joined();
    if (!is_within && from < at) {
      mistake(describe(gap) + " overlaps the one before");
      if (up_to < at) continue;
      from = at;
    }
    if (is_within) {
      joined += gap.count;
      joined_up_to = std::max(joined_up_to, up_to);
      continue;
    }
    if (from > at) add_stretch(number, segment, at, static_cast<std::uint64_t>(from - at), 0);
    at = up_to + 1;
    if (!is_joined) continue;
    joined_from = from;
    joined_up_to = up_to;
    joined = gap.count;
  }
  end_joined();
  if (ticks > at) add_stretch(number, segment, at, static_cast<std::uint64_t>(ticks - at), 0);
}

void TickCheck::add_stretch(std::size_t segment, const Segment& of, std::int64_t first_tick, std::uint64_t ticks,
                            std::uint64_t missing) {
  if (ticks == missing) return;
  const std::int64_t period = of.period.count();
  stretches_.push_back({segment, to_nanoseconds(of.first_due) + first_tick * period, period, ticks, ticks - missing,
                        taken_, of.late_after.count()});
  if (missing != 0) is_exact_ = false;
  taken_ += ticks - missing;
}

const TickCheck::Stretch* TickCheck::find(std::uint64_t n, std::size_t& near) const {
  if (n >= taken_) return nullptr;
  while (n < stretches_[near].before) --near;
  while (n - stretches_[near].before >= stretches_[near].taken) ++near;
  return &stretches_[near];
}

void TickCheck::mistake(std::string sentence) {
  ++mistakes_;
  if (sentences_.size() < most_sentences) sentences_.push_back(std::move(sentence));
}

void TickCheck::add(std::int64_t time, std::uint64_t sequence) {
  if (sequence < first_sequence_) return;  // reported as a separate mistake
  const std::uint64_t number = sequence - first_sequence_;
  // What was under way when the recording began may have been the first one.
  const Stretch* earliest = number < carried_ ? nullptr : find(number - carried_, lower_);
  if (earliest == nullptr && number >= carried_) {
    return mistake("the row of sequence " + std::to_string(sequence) + ", " + utc(time) +
                   ", belongs to no tick: every tick is in a gap or has another row");
  }
  if (earliest != nullptr && time < earliest->earliest(number - carried_)) {
    return mistake("the time of sequence " + std::to_string(sequence) + ", " + utc(time) +
                   ", is before that of its tick, which was due at " + utc(earliest->earliest(number - carried_)) +
                   " at the earliest");
  }
  ++rows_;
  if (is_exact_) {
    const std::uint64_t late = static_cast<std::uint64_t>(time) -
                               static_cast<std::uint64_t>(earliest->earliest(number));
    lateness_.sum += late;
    if (late > static_cast<std::uint64_t>(earliest->late_after)) ++lateness_.late;
  }
  const Stretch* next = find(number + more_ticks_ + 1, upper_);
  if (next == nullptr || earliest == nullptr || next->segment != earliest->segment) return;
  const std::int64_t end = next->latest(number + more_ticks_ + 1) + next->period;
  if (time >= end) {
    mistake("the time of sequence " + std::to_string(sequence) + ", " + utc(time) +
            ", is too late: it must be before " + utc(end));
  }
}

}  // namespace rtdata::detail
