#include "loop/core/lane_thread.hpp"

#include <time.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "data/saturating.hpp"
#include "rtdata/detail/loop/lane.hpp"

namespace rtdata::detail {
namespace {

constexpr std::size_t most_pooled_abandoned = 64;  // beyond this, a lane may abandon only one thread

LaneClock*& virtual_clock() noexcept {
  static thread_local LaneClock* clock = nullptr;
  return clock;
}

}  // namespace

LaneThread::LaneThread(std::shared_ptr<LanePool> pool)
    : pool_(pool != nullptr ? std::move(pool) : std::make_shared<LanePool>(std::size_t{0})) {}

bool LaneThread::is_stuck() const noexcept {
  const std::size_t own = abandoned_threads();
  return own >= Lane::most_abandoned || (own > 0 && pool_->abandoned_threads() >= most_pooled_abandoned);
}

std::size_t LaneThread::abandoned_threads() const noexcept {
  return static_cast<std::size_t>(std::max<std::ptrdiff_t>(queue_->behind.load(std::memory_order_acquire), 0));
}

LaneClock::LaneClock(MonotonicTime now) noexcept : began_(now), now_(now) { virtual_clock() = this; }
LaneClock::~LaneClock() { virtual_clock() = nullptr; }

MonotonicTime lane_now() noexcept {
  const LaneClock* const clock = virtual_clock();
  return clock != nullptr ? clock->now_ : std::chrono::steady_clock::now();
}

void lane_sleep(Duration duration) noexcept {
  if (duration.count() <= 0) return;
  if (LaneClock* const clock = virtual_clock()) {
    clock->now_ = later(clock->now_, duration);
    return;
  }
  constexpr std::int64_t second = 1'000'000'000;
  timespec left{static_cast<time_t>(duration.count() / second), static_cast<long>(duration.count() % second)};
  while (::nanosleep(&left, &left) != 0) {
  }
}

}  // namespace rtdata::detail
