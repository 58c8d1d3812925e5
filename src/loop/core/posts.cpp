#include "loop/core/posts.hpp"

#include <algorithm>
#include <mutex>
#include <string>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "loop/core/virtual_threads.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {

void Posts::add(Callback<void()> function) {
  if (!function) refuse_empty("cannot post", "loop " + loop_.config.name);
  {
    const std::lock_guard lock(mutex_);
    if (!takes_more_) return;  // the function is destroyed after the lock is released
    waiting_.push_back(std::move(function));
    ++posted_;
    is_any_waiting_.store(true, std::memory_order_release);
  }
  loop_.uv.wake().send();
  if (loop_.virtual_threads() != nullptr) loop_.virtual_threads()->preempt();
}

bool Posts::has_some() noexcept {
  const std::lock_guard lock(mutex_);
  return !waiting_.empty() || next_ < taken_.size();
}

PostCounts Posts::counts() noexcept {
  const std::lock_guard lock(mutex_);
  return {posted_, run_.load(std::memory_order_relaxed), most_waiting_};
}

void Posts::take() {
  taken_.clear();
  next_ = 0;
  if (!is_any_waiting_.load(std::memory_order_acquire)) return;
  {
    const std::lock_guard lock(mutex_);
    taken_.swap(waiting_);
    is_any_waiting_.store(false, std::memory_order_relaxed);
    most_waiting_ = std::max<std::uint64_t>(most_waiting_, taken_.size());
  }
  if (taken_.size() > Loop::post_backlog) [[unlikely]] {
    loop_.call_own("loop", [&] {
      loop_.runtime.report(&loop_, "loop " + loop_.config.name,
                           {Errc::backlog, std::to_string(taken_.size()) + " posted functions wait", "",
                            "they come faster than the loop runs them, or the loop was held",
                            "post one function for many changes, or look at LoopStatus::posts before posting more"});
    });
  }
}

bool Posts::run_taken(MonotonicTime begin, MonotonicTime end) {
  MonotonicTime from = begin;
  while (next_ < taken_.size()) {
    run_.fetch_add(1, std::memory_order_relaxed);
    CallbackTimes times;
    loop_.nodes.begins(nullptr);
    {
      Callback<void()> function = std::move(taken_[next_++]);
      loop_.call_user("posted function", function);
    }  // the destructors of its captures count for it
    const MonotonicTime to = loop_.now();
    if (loop_.blame.held_last() < from)  // otherwise a callback that it called was blamed
      loop_.blame.time_callback(times, from, to, [] { return std::string("posted function"); });
    from = to;
    if (next_ < taken_.size() &&
        (to >= end || (to > begin && end != MonotonicTime::max() && loop_.deadlines.is_due(to))))
      return false;
  }
  return true;
}

bool Posts::run(MonotonicTime end) {
  // The thread that adds a function wakes the loop afterwards.
  if (next_ == taken_.size() && !is_any_waiting_.load(std::memory_order_acquire)) return false;
  const MonotonicTime begin = loop_.now();
  if (next_ < taken_.size() && !run_taken(begin, end)) {  // functions that an earlier call has left
    loop_.uv.wake().send();
    return true;
  }
  take();
  if (run_taken(begin, end)) return false;
  loop_.uv.wake().send();
  return true;
}

std::uint64_t Posts::run_all(MonotonicTime end) {
  const std::uint64_t posted = counts().posted;
  while (run_.load(std::memory_order_relaxed) < posted && loop_.now() < end) run(end);
  const std::uint64_t run = run_.load(std::memory_order_relaxed);
  return run < posted ? posted - run : 0;
}

void Posts::drop() noexcept {
  std::vector<Callback<void()>> unrun;
  {
    const std::lock_guard lock(mutex_);
    takes_more_ = false;
    unrun.swap(waiting_);
  }
  unrun.clear();  // outside the lock: captures may post
  taken_.clear();
}

}  // namespace rtdata::detail
