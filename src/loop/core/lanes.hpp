// The lanes of a loop: lanes that it made, found by key, with their thread pool; lanes of other owners; and the
// collection of all finished jobs.
#pragma once

#include <sched.h>

#include <algorithm>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "loop/core/deadline.hpp"
#include "loop/core/lane_pool.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::detail {

class Lane;
class LaneThread;
class LoopCore;

/// Thread: the loop's.
class Lanes {
 public:
  static constexpr std::size_t most_slow = 64;  ///< running jobs, not counting lanes that were quick before

  explicit Lanes(LoopCore& loop);
  Lanes(const Lanes&) = delete;
  Lanes& operator=(const Lanes&) = delete;
  ~Lanes();

  /// The lane for a key (a physical device), made at the first call. The limit is for jobs submitted without one.
  /// `thread`: of a bus, shared with other loops; null: of the pool.
  Lane& of(const std::string& key, Duration give_up_after, const std::shared_ptr<LaneThread>& thread = nullptr);
  /// Ends the finished jobs of all lanes.
  void collect();
  /// Destroys those that the loop made.
  void close() noexcept;

  // ---- of each lane
  void add();
  void remove(Lane& lane) noexcept;
  /// Changes the number of outstanding jobs.
  void count(Lane& lane, int more) noexcept;
  /// Wakes a thread of the pool for a pushed job, now or once for all deadlines that are due together.
  void hand_over(const std::shared_ptr<LanePool>& pool);
  /// Wakes pools with new jobs since the last call. Called after deadlines have fired, and before waiting.
  void wake_threads() noexcept;
  /// Waits until jobs of lanes make `is_so` true, but no longer than `at_most`; calls `while_waiting` meanwhile.
  template <class Predicate>
  void wait(Duration at_most, const Predicate& is_so) {
    constexpr Duration step = std::chrono::milliseconds{10};
    for (Duration left = at_most; left > Duration{0} && !is_so(); left -= step) {
      const bool is_watched = !while_waiting.empty();
      listener_->wait(is_watched ? std::min(left, step) : left, is_so);
      if (!is_watched) return;
      beat();
    }
  }
  void beat() const {
    for (const auto& [owner, call] : while_waiting) call();
  }
  /// Before any lane is made; for tests.
  void set_pool(std::shared_ptr<LanePool> pool) noexcept { pool_ = std::move(pool); }
  const std::shared_ptr<LaneListener>& shared_listener() const noexcept { return listener_; }

  Duration scripted_duration{0};  ///< of each job on a manual loop
  /// Called regularly while the loop waits for a lane intentionally, to show that it does not hang. Stored with the
  /// owner, who removes it.
  std::vector<std::pair<const void*, std::function<void()>>> while_waiting = {};
  std::optional<cpu_set_t> processors = {};  ///< for their threads, when the loop's own thread is bound to fewer

 private:
  /// Checks for long jobs while several jobs of the pool are outstanding.
  struct Watch final : Deadline {
    explicit Watch(Lanes& lanes_) : lanes(lanes_) {}
    void fire(MonotonicTime now) override;
    Lanes& lanes;
  };
  void watch_pool() noexcept;

  LoopCore& loop_;
  std::vector<std::pair<std::string, std::unique_ptr<Lane>>> by_key_;
  std::size_t count_ = 0;      // of all lanes
  std::vector<Lane*> listed_;  // lanes with outstanding jobs; null: removed while collecting
  bool collecting_ = false;
  std::shared_ptr<LanePool> pool_;
  std::size_t pooled_ = 0;                          // outstanding jobs of lanes of the pool
  std::vector<std::shared_ptr<LanePool>> to_wake_;  // of the pool, and of others
  Watch watch_{*this};
  const std::shared_ptr<LaneListener> listener_;
};

}  // namespace rtdata::detail
