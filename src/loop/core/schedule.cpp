#include "loop/core/schedule.hpp"

#include <algorithm>
#include <exception>
#include <new>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {
namespace {

// Thousands of members do not fit into the caches, so the memory of the next ones is prefetched while the first ones
// run.
constexpr std::size_t far_ahead = 16;
constexpr std::size_t near_ahead = 8;

constexpr Duration try_again_after = std::chrono::milliseconds{100};

/// The memory around the member, which a tick uses.
void fetch(const RateMember* member) noexcept {
  if (member == nullptr) return;
  const auto* byte = reinterpret_cast<const char*>(member);
  for (const int at : {-40, 24, 87}) __builtin_prefetch(byte + at, 1);
}

}  // namespace

MonotonicTime RateMember::next_due() const noexcept {
  return group_ == nullptr ? MonotonicTime::max() : group_->next_due_of(*this);
}

MonotonicTime RateGroup::next_due_of(const RateMember& member) const noexcept {
  if (!firing_) return std::max(due, member.first_due_);
  if (member.place_ >= position_) return std::max(first_missed_, member.first_due_);
  return std::max(later(firing_due_, period_), member.first_due_);
}

bool RateGroup::is_idle() const noexcept {
  for (std::size_t i = 0; i < members_.places(); ++i) {
    const RateMember* const member = members_.at(i);
    if (member != nullptr && !member->is_idle()) return false;
  }
  return true;
}

void RateGroup::leave_out_until(MonotonicTime at) noexcept {
  const Duration span = span_between(due, at);
  if (span <= Duration{0}) return;
  const std::int64_t ticks = span / period_ + (span % period_ != Duration{0} ? 1 : 0);
  due = later(due, multiple(ticks, period_));
}

void RateGroup::fire(MonotonicTime now) {
  // Skips ticks that are late by a period or more: takes the latest due tick.
  const auto behind = (now - due) / period_;
  first_missed_ = due;
  firing_due_ = due + behind * period_;
  due = later(firing_due_, period_);
  loop_.deadlines.moved(*this);
  firing_ = true;
  const std::size_t end = members_.places();  // members that join meanwhile are first due later
  MonotonicTime from = now;
  for (position_ = 0; position_ < end;) {
    RateMember* member = members_.at(position_++);
    if (position_ + far_ahead < end) fetch(members_.at(position_ + far_ahead));
    if (position_ + near_ahead < end && members_.at(position_ + near_ahead) != nullptr)
      members_.at(position_ + near_ahead)->prefetch();
    if (member == nullptr || member->first_due_ > firing_due_) continue;
    Tick tick;
    tick.due = firing_due_;
    tick.now = from;
    if (behind > 0) [[unlikely]] {
      tick.missed = static_cast<std::uint64_t>((firing_due_ - std::max(first_missed_, member->first_due_)) / period_);
    }
    loop_.schedule().ticking_ = member;
    try {
      member->tick(tick);
    } catch (...) {  // no memory, even for a report; the other members still get their ticks
      loop_.call_own("loop", [] { throw; });
    }
    const MonotonicTime to = std::max(from, loop_.quick_now());
    // A member that removed itself may be destroyed.
    if (members_.at(position_ - 1) == member &&
        loop_.blame.time_callback(member->times, from, to, [&] { return member->blame_name(); })) [[unlikely]] {
      if (members_.at(position_ - 1) == member) member->held(to - from);
      from = loop_.now();
    } else {
      from = to;
    }
  }
  loop_.schedule().ticking_ = nullptr;
  firing_ = false;
  members_.close_holes();
  if (members_.empty()) loop_.schedule().discard(*this);
}

void Schedule::add(RateMember& member) {
  if (loop_.is_running()) return place(member);
  waiting_.add(member);
  member.is_waiting_ = true;
  loop_.wake_for_waiting();
}

void Schedule::begin_waiting() noexcept {
  if (waiting_.empty()) return;
  for (std::size_t i = 0; i < waiting_.places(); ++i) {
    RateMember* const member = waiting_.at(i);
    if (member == nullptr) continue;
    try {
      place(*member);
    } catch (const std::bad_alloc&) {  // the member waits for the next turn
    } catch (const std::exception& e) {
      report(*member, reason_of(e));
    } catch (...) {
      report(*member, "an exception that is not a std::exception");
    }
    member->is_waiting_ = member->group_ == nullptr;
    if (!member->is_waiting_) waiting_.remove_at(i);
  }
  waiting_.close_holes();
  // Makes sure that there is a next turn.
  if (!waiting_.empty()) loop_.runtime.reports.flush_at(later(loop_.now(), try_again_after));
}

void Schedule::report(const RateMember& member, std::string_view why) noexcept try {
  loop_.runtime.keep_report(
      &loop_, member.blame_name(),
      {Errc::handler_threw, "its schedule could not begin", "loop " + loop_.config.name, std::string(why),
       member.group_ == nullptr ? "the loop tries it again in its next turn" : ""});
} catch (...) {  // out of memory
}

void Schedule::place(RateMember& member) {
  const Duration period = member.period_;
  const Duration grid = loop_.config.phase_grid;
  Duration first = std::max(loop_.turn_start(), member.not_before()).time_since_epoch();
  // The kernel's own ticks are at whole milliseconds and would interrupt a busy-waiting loop.
  const Duration beside = loop_.config.spin.count() > 0 ? grid / 3 : Duration{0};
  if (grid.count() > 0 && first <= Duration::max() - grid)
    first = (first - beside + grid - Duration{1}) / grid * grid + beside;
  first = later(MonotonicTime{first}, member.first_phase()).time_since_epoch();
  if (&member == ticking_) first = later(MonotonicTime{first}, period).time_since_epoch();
  const RateGroups::key_type key{period, first % period};
  const MonotonicTime first_due{first};
  RateGroup* group = nullptr;
  const auto [begin, end] = groups_.equal_range(key);
  for (auto at = begin; at != end && group == nullptr; ++at) {
    if (at->second->firing_due_ < first_due) group = at->second.get();
  }
  if (group == nullptr) {
    // A group that has already had this tick cannot repeat it for a new member.
    auto made = std::make_unique<RateGroup>(loop_, period);
    made->members_.reserve(1);
    const auto at = groups_.emplace(key, std::move(made));
    try {
      loop_.deadlines.reserve_one();
    } catch (...) {
      groups_.erase(at);
      throw;
    }
    group = at->second.get();
    group->self_ = at;
    group->due = first_due;
    loop_.deadlines.insert(*group);
    group->members_.add(member);
  } else {
    group->members_.add(member);   // throws: nothing has changed
    if (first_due < group->due) {  // its members all start later
      group->due = first_due;
      loop_.deadlines.moved(*group);
    }
  }
  member.group_ = group;
  member.first_due_ = first_due;
  member.schedule_began();
}

void Schedule::remove(RateMember& member) noexcept {
  if (std::exchange(member.is_waiting_, false)) {
    waiting_.remove(member);
    waiting_.tidy();
    return;
  }
  RateGroup* group = member.group_;
  if (group == nullptr) return;
  member.group_ = nullptr;
  group->members_.remove(member);
  if (group->firing_) return;  // which closes the holes at its end
  group->members_.tidy();
  if (group->members_.empty()) discard(*group);
}

void Schedule::discard(RateGroup& group) noexcept {
  loop_.deadlines.remove(group);
  loop_.deadlines.release_one();
  groups_.erase(group.self_);
}

}  // namespace rtdata::detail
