// Deadlines: one ordered set of instants, in an intrusive binary heap. Equal instants come in order of creation.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "data/saturating.hpp"

namespace rtdata::detail {

class Deadline {
 public:
  /// Called when it is due: does the work, then sets a new `due` or removes itself from the heap.
  virtual void fire(MonotonicTime now) = 0;
  /// True if `fire` would do nothing now. Virtual time then skips this deadline until another one is due.
  virtual bool is_idle() const noexcept { return false; }
  /// Sets `due` to its first instant from `at` on; earlier ones are not counted.
  virtual void leave_out_until(MonotonicTime) noexcept {}

  MonotonicTime due{};
  std::uint64_t order = 0;
  std::size_t heap_index = npos;
  static constexpr std::size_t npos = static_cast<std::size_t>(-1);
  static constexpr std::size_t waiting = npos - 1;  ///< for the loop's next round
  bool is_listed() const noexcept { return heap_index != npos; }

 protected:
  ~Deadline() = default;
};

class DeadlineHeap {
 public:
  Deadline* top() const noexcept { return entries_.empty() ? nullptr : entries_.front(); }
  std::size_t size() const noexcept { return entries_.size(); }
  /// Allocates memory for `count` deadlines.
  void make_room(std::size_t count) {
    if (count > entries_.capacity()) entries_.reserve(std::max(count, 2 * entries_.capacity()));
  }
  /// Needs room from `make_room`.
  void insert(Deadline& deadline) noexcept {
    entries_.push_back(&deadline);
    if (deadline.order == 0) deadline.order = ++last_order_;
    deadline.heap_index = entries_.size() - 1;
    sift_up(deadline.heap_index);
  }
  void remove(Deadline& deadline) noexcept {
    const std::size_t hole = deadline.heap_index;
    if (hole == Deadline::npos) return;
    deadline.heap_index = Deadline::npos;
    Deadline* last = entries_.back();
    entries_.pop_back();
    if (last == &deadline) return;
    place(hole, last);
    moved(*last);
  }
  /// Call it after `due` has changed.
  void moved(Deadline& deadline) noexcept {
    sift_up(deadline.heap_index);
    sift_down(deadline.heap_index);
  }

 private:
  static bool before(const Deadline* a, const Deadline* b) noexcept {
    return a->due != b->due ? a->due < b->due : a->order < b->order;
  }
  void place(std::size_t index, Deadline* deadline) noexcept {
    entries_[index] = deadline;
    deadline->heap_index = index;
  }
  void sift_up(std::size_t index) noexcept {
    Deadline* deadline = entries_[index];
    while (index > 0 && before(deadline, entries_[(index - 1) / 2])) {
      place(index, entries_[(index - 1) / 2]);
      index = (index - 1) / 2;
    }
    place(index, deadline);
  }
  void sift_down(std::size_t index) noexcept {
    Deadline* deadline = entries_[index];
    for (;;) {
      std::size_t child = 2 * index + 1;
      if (child >= entries_.size()) break;
      if (child + 1 < entries_.size() && before(entries_[child + 1], entries_[child])) ++child;
      if (!before(entries_[child], deadline)) break;
      place(index, entries_[child]);
      index = child;
    }
    place(index, deadline);
  }

  std::vector<Deadline*> entries_;
  std::uint64_t last_order_ = 0;
};

}  // namespace rtdata::detail
