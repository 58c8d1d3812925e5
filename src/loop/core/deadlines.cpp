#include "loop/core/deadlines.hpp"

#include <algorithm>
#include <array>

#include "loop/core/loop_core.hpp"

namespace rtdata::detail {

void Deadlines::reserve_one() {
  heap_.make_room(reserved_ + 1);
  if (reserved_ + 1 > next_round_.capacity()) next_round_.reserve(2 * (reserved_ + 1));
  ++reserved_;
}

void Deadlines::insert(Deadline& deadline) noexcept {
  loop_.assert_thread();
  if (firing_ && deadline.due <= firing_until_) {  // in the next round, so that one round ends
    next_round_.push_back(&deadline);
    deadline.heap_index = Deadline::waiting;
    return;
  }
  heap_.insert(deadline);
  if (!firing_ && heap_.top() == &deadline) arm();
}

void Deadlines::remove(Deadline& deadline) noexcept {
  if (deadline.heap_index == Deadline::waiting) {
    std::erase(next_round_, &deadline);
    deadline.heap_index = Deadline::npos;
    return;
  }
  heap_.remove(deadline);
}

void Deadlines::moved(Deadline& deadline) noexcept {
  if (deadline.heap_index == Deadline::waiting || (firing_ && deadline.due <= firing_until_)) {
    remove(deadline);
    insert(deadline);
    return;
  }
  heap_.moved(deadline);
  if (!firing_) arm();
}

std::optional<MonotonicTime> Deadlines::next_due() const noexcept {
  if (heap_.top() == nullptr || heap_.top()->due == MonotonicTime::max()) return std::nullopt;
  return heap_.top()->due;
}

void Deadlines::leave_out_idle(MonotonicTime until) noexcept {
  // Idle deadlines at the front, removed until the next other deadline is known.
  struct Idle {
    Deadline* deadline;
    MonotonicTime due;
  };
  std::array<Idle, 16> idle;
  std::size_t count = 0;
  for (; count < idle.size(); ++count) {
    Deadline* const top = heap_.top();
    if (top == nullptr || top->due >= until || !top->is_idle()) break;
    idle[count] = {top, top->due};
    top->due = MonotonicTime::max();
    heap_.moved(*top);
  }
  if (count == 0) return;
  const MonotonicTime next = std::min(until, heap_.top()->due);
  for (std::size_t i = 0; i < count; ++i) {
    Deadline& deadline = *idle[i].deadline;
    deadline.due = idle[i].due;
    if (next != MonotonicTime::max()) deadline.leave_out_until(next);
    heap_.moved(deadline);
  }
}

void Deadlines::arm() noexcept {
  if (loop_.is_manual()) return;
  const Duration spin = std::max(loop_.config.spin, Duration{0});
  const Deadline* top = heap_.top();
  loop_.uv.arm(top == nullptr ? MonotonicTime{} : std::max(later(top->due, -spin), MonotonicTime{Duration{1}}));
}

void Deadlines::spin() noexcept {
  const Deadline* top = heap_.top();
  if (top == nullptr || loop_.is_manual()) return;
  for (MonotonicTime current = loop_.now(); current < top->due && span_between(current, top->due) <= loop_.config.spin;
       current = loop_.now()) {
  }
}

void Deadlines::fire_due() {
  // Deadlines that become due meanwhile fire at once, but after `rounds` rounds I/O comes first.
  constexpr int rounds = 4;
  if (firing_) return;
  firing_ = true;
  for (int round = 0; round < rounds; ++round) {
    const MonotonicTime until = loop_.now();
    if (!is_due(until)) {
      handled_until_ = std::max(handled_until_, until);
      break;
    }
    firing_until_ = until;
    MonotonicTime begin = until;
    while (is_due(until)) {
      Deadline& due = *heap_.top();
      const MonotonicTime due_at = due.due;
      // `fire` may throw without memory. If it has not moved itself by then, it is removed, so that it does not fire
      // for ever.
      if (!loop_.call_own("loop", [&] { due.fire(begin); }) && heap_.top() == &due && due.due == due_at) remove(due);
      begin = loop_.now();
    }
    for (Deadline* deadline : next_round_) heap_.insert(*deadline);
    next_round_.clear();
    handled_until_ = std::max(handled_until_, until);
  }
  loop_.lanes.wake_threads();
  firing_ = false;
}

}  // namespace rtdata::detail
