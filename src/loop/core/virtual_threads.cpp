#include "loop/core/virtual_threads.hpp"

#include <algorithm>
#include <utility>

#include "data/saturating.hpp"

namespace rtdata::detail {
namespace {

constexpr MonotonicTime never = MonotonicTime::max();

}  // namespace

VirtualThreads::VirtualThreads(ManualClock& clock) : clock_(clock) { threads_.push_back(&main_); }

VirtualThreads::~VirtualThreads() {
  if (clock_.threads_ == this) clock_.threads_ = nullptr;
}

void VirtualThreads::choose_by(const Loop::Manual& config) {
  seed_ = config.seed;
  jitter_ = std::max(config.jitter, Duration{0});
  random_.seed(seed_);
}

void VirtualThreads::add(Thread& thread) {
  runnable_.reserve(threads_.size() + 1);
  threads_.push_back(&thread);
  thread.until = {};  // as soon as possible
  clock_.threads_ = this;
}

void VirtualThreads::remove(Thread& thread) noexcept {
  std::erase(threads_, &thread);
  if (!has_others()) clock_.threads_ = nullptr;
}

void VirtualThreads::begin(Thread& thread) noexcept {
  std::unique_lock lock(mutex_);
  thread.turn.wait(lock, [&] { return has_turn_ == &thread; });
  thread.id = std::this_thread::get_id();
  running_.store(thread.id, std::memory_order_relaxed);
}

void VirtualThreads::end(Thread& thread) noexcept {
  remove(thread);
  pass_turn_on(choose_next());
}

VirtualThreads::Thread& VirtualThreads::self() noexcept {
  const std::thread::id id = std::this_thread::get_id();
  const auto found = std::find_if(threads_.begin() + 1, threads_.end(), [&](Thread* one) { return one->id == id; });
  return found != threads_.end() ? **found : main_;
}

void VirtualThreads::pass_turn_on(Thread* to) noexcept {
  if (to == nullptr) {
    to = &main_;
    main_.nothing_comes = true;
  }
  const std::lock_guard lock(mutex_);
  has_turn_ = to;
  to->turn.notify_one();  // under the lock: a thread that ended may be destroyed when the lock is free
}

void VirtualThreads::hand_over(Thread& from) noexcept {
  Thread* const next = choose_next();
  if (next == &from) return;
  if (next == nullptr && &from == &main_) {
    main_.nothing_comes = true;
    return;
  }
  pass_turn_on(next);
  std::unique_lock lock(mutex_);
  from.turn.wait(lock, [&] { return has_turn_ == &from; });
}

VirtualThreads::Thread* VirtualThreads::choose_next() noexcept {
  // Limits loops that send to each other at one instant, which would stop time.
  constexpr unsigned most_choices = 10'000;
  constexpr Duration turn = std::chrono::microseconds{1};
  for (;;) {
    const MonotonicTime now = clock_.monotonic();
    MonotonicTime earliest = never;
    Thread* last_resort = nullptr;
    runnable_.clear();
    for (Thread* thread : threads_) {
      if (!thread->ready_at && thread->is_ready != nullptr && (*thread->is_ready)())
        thread->ready_at = thread->sees_at_once ? now : later(now, choose_delay());
      const MonotonicTime at = std::min(thread->until, thread->ready_at.value_or(never));
      if (at > now || at == never) {
        earliest = std::min(earliest, at);
      } else if (thread->is_last) {
        last_resort = thread;
      } else {
        runnable_.push_back(thread);
      }
    }
    if (runnable_.empty() && last_resort != nullptr) return last_resort;
    if (runnable_.empty() && earliest == never) return nullptr;
    const bool is_over = runnable_.empty() || ++choices_ > most_choices;
    if (is_over) {
      clock_.move(runnable_.empty() ? earliest - now : turn);
      choices_ = 0;
      last_ = threads_.size();
      continue;
    }
    if (seed_ != 0) return runnable_[static_cast<std::size_t>(random_() % runnable_.size())];
    // Round robin, so that each gets its turn.
    const auto index = [&](Thread* thread) {
      return static_cast<std::size_t>(std::find(threads_.begin(), threads_.end(), thread) - threads_.begin());
    };
    const auto after = std::find_if(runnable_.begin(), runnable_.end(),
                                    [&](Thread* one) { return index(one) > last_; });
    Thread* const chosen = after != runnable_.end() ? *after : runnable_.front();
    last_ = index(chosen);
    return chosen;
  }
}

bool VirtualThreads::wait(MonotonicTime until, const std::function<bool()>& is_ready) noexcept {
  Thread& thread = self();
  thread.until = until;
  thread.is_ready = is_ready ? &is_ready : nullptr;
  hand_over(thread);
  running_.store(std::this_thread::get_id(), std::memory_order_relaxed);
  thread.is_ready = nullptr;
  thread.ready_at.reset();
  thread.sees_at_once = true;
  thread.is_last = false;
  return !std::exchange(thread.nothing_comes, false);
}

bool VirtualThreads::wait_for_news(MonotonicTime until, const std::function<bool()>& has_news) noexcept {
  self().sees_at_once = false;
  return wait(until, has_news);
}

void VirtualThreads::wait_for_others() noexcept {
  self().is_last = true;
  wait(clock_.monotonic(), {});
}

void VirtualThreads::sleep(Duration duration) noexcept {
  if (duration.count() > 0) wait(std::min(later(clock_.monotonic(), duration), never - Duration{1}), {});
}

void VirtualThreads::preempt() noexcept {
  constexpr unsigned one_in = 16;
  if (seed_ == 0 || running_.load(std::memory_order_relaxed) != std::this_thread::get_id()) return;  // or none of ours
  if (has_others() && random_() % one_in == 0) wait(clock_.monotonic(), {});
}

Duration VirtualThreads::choose_delay() noexcept {
  if (!choose()) return Duration{0};
  return Duration{static_cast<std::int64_t>(random_() % (static_cast<std::uint64_t>(jitter_.count()) + 1))};
}

}  // namespace rtdata::detail
