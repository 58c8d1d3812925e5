#include "loop/core/lanes.hpp"

#include <algorithm>

#include "loop/core/lane_thread.hpp"
#include "loop/core/loop_core.hpp"
#include "rtdata/detail/loop/lane.hpp"

namespace rtdata::detail {

Lanes::Lanes(LoopCore& loop)
    : loop_(loop), pool_(std::make_shared<LanePool>(most_slow)), listener_(std::make_shared<LaneListener>()) {
  if (!loop_.is_manual()) listener_->loop_wake = &loop_.uv.wake();
  loop_.deadlines.reserve_one();
}

Lanes::~Lanes() { listener_->stop_listening(); }

Lane& Lanes::of(const std::string& key, Duration give_up_after, const std::shared_ptr<LaneThread>& thread) {
  const auto make = [&] {
    return std::make_unique<Lane>(loop_, key, give_up_after,
                                  thread != nullptr ? thread : std::make_shared<LaneThread>(pool_));
  };
  for (auto& [name, lane] : by_key_) {
    if (name != key) continue;
    if (thread == nullptr || lane->uses(*thread)) return *lane;
    if (lane->is_deserted()) return *(lane = make());  // left from a closed bus of this name
  }
  by_key_.emplace_back(key, make());
  return *by_key_.back().second;
}

void Lanes::add() {
  listed_.reserve(count_ + 1);
  to_wake_.reserve(count_ + 1);
  ++count_;
}

void Lanes::remove(Lane& lane) noexcept {
  --count_;
  const auto found = std::find(listed_.begin(), listed_.end(), &lane);
  if (found == listed_.end()) return;
  if (collecting_) {
    *found = nullptr;
  } else {
    listed_.erase(found);
  }
}

void Lanes::count(Lane& lane, int more) noexcept {
  if (lane.is_pooled_) pooled_ += static_cast<std::size_t>(more);
  if (more > 0 && !std::exchange(lane.is_listed_, true)) listed_.push_back(&lane);
}

void Lanes::collect() {
  if (collecting_) return;
  collecting_ = true;
  // Threads end jobs roughly in the order of the list, so the search stops after the counted number of finished jobs. A
  // job that is finished but not counted yet may be taken for a counted one; the other is found when the first is
  // counted, because the thread then notifies again.
  std::size_t left = listener_->finished.load(std::memory_order_relaxed);
  if (left > 0) left = listener_->finished.exchange(0, std::memory_order_acquire);
  for (std::size_t i = 0; i < listed_.size() && left > 0; ++i) {
    if (listed_[i] != nullptr) {
      const LaneJob* const first = listed_[i]->first_.get();
      listed_[i]->collect();
      if (listed_[i] == nullptr || listed_[i]->first_.get() != first) --left;  // one of several jobs: search on
    }
    if (listed_[i] == nullptr || listed_[i]->first_ != nullptr) continue;
    listed_[i]->is_listed_ = false;
    listed_[i] = nullptr;
  }
  collecting_ = false;
  if (!listed_.empty()) std::erase(listed_, nullptr);
  wake_threads();
  if (pooled_ > 1 || !watch_.is_listed()) return;
  loop_.deadlines.remove(watch_);
  if (!loop_.deadlines.is_firing()) loop_.deadlines.arm();  // otherwise the loop would wake up for it
}

void Lanes::hand_over(const std::shared_ptr<LanePool>& pool) {
  if (std::find(to_wake_.rbegin(), to_wake_.rend(), pool) == to_wake_.rend()) to_wake_.push_back(pool);
  if (!collecting_ && !loop_.deadlines.is_firing()) wake_threads();
}

void Lanes::wake_threads() noexcept {
  if (to_wake_.empty()) return;
  for (const auto& pool : to_wake_) pool->wake();
  to_wake_.clear();
  watch_pool();
}

void Lanes::watch_pool() noexcept {
  constexpr Duration patience = std::chrono::milliseconds{1};
  if (pooled_ < 2 || watch_.is_listed() || !pool_->begin_watch()) return;
  watch_.due = later(loop_.now(), patience);
  loop_.deadlines.insert(watch_);
}

void Lanes::Watch::fire(MonotonicTime) {
  lanes.loop_.deadlines.remove(*this);
  lanes.collect();  // jobs that ended before a long one, without notification
  lanes.pool_->help();
  lanes.watch_pool();
}

void Lanes::close() noexcept {
  loop_.deadlines.remove(watch_);
  while (!by_key_.empty()) {  // one by one: `done` of a job may ask for lanes
    const auto last = std::move(by_key_.back().second);
    by_key_.pop_back();
  }
}

}  // namespace rtdata::detail
