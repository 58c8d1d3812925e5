// The lanes of a loop: those that it made, found by key, and those of other owners, which it collects finished jobs
// from.
#pragma once

#include <sched.h>

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/data/time.hpp"

namespace rtdata::detail {

class Lane;
class LaneThread;
class LoopCore;

/// Thread: the loop's.
class Lanes {
 public:
  explicit Lanes(LoopCore& loop) noexcept;
  Lanes(const Lanes&) = delete;
  Lanes& operator=(const Lanes&) = delete;
  ~Lanes();

  /// One for each key (a physical device), made when first asked for. The limit is that of jobs that are submitted
  /// without one. `thread`: of a bus, which other loops use too.
  Lane& of(const std::string& key, Duration give_up_after, const std::shared_ptr<LaneThread>& thread = nullptr);
  // Each lane lists itself.
  void add(Lane& lane) { listed_.push_back(&lane); }
  void remove(Lane& lane) noexcept;
  /// Ends the finished jobs of all lanes.
  void collect();
  /// Destroys those that the loop made.
  void close() noexcept;

  Duration scripted_duration{0};             ///< of each job on a manual loop
  std::optional<cpu_set_t> processors = {};  ///< for their threads, when the loop's own thread is bound to fewer

 private:
  LoopCore& loop_;
  std::vector<std::pair<std::string, std::unique_ptr<Lane>>> by_key_;
  std::vector<Lane*> listed_;  // null: removed while they are collected
  bool collecting_ = false;
};

}  // namespace rtdata::detail
