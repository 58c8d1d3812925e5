#include "loop/core/lanes.hpp"

#include <algorithm>

#include "rtdata/loop/lane.hpp"

namespace rtdata::detail {

Lanes::Lanes(LoopCore& loop) noexcept : loop_(loop) {}
Lanes::~Lanes() = default;

Lane& Lanes::of(const std::string& key, Duration give_up_after, const std::shared_ptr<LaneThread>& thread) {
  for (auto& [name, lane] : by_key_) {
    if (name != key) continue;
    if (thread == nullptr || lane->uses(*thread)) return *lane;
    if (lane->is_deserted()) {  // of a bus of this name that was closed
      lane = std::make_unique<Lane>(loop_, key, give_up_after, thread);
      return *lane;
    }
  }
  by_key_.emplace_back(key, std::make_unique<Lane>(loop_, key, give_up_after, thread));
  return *by_key_.back().second;
}

void Lanes::remove(Lane& lane) noexcept {
  const auto found = std::find(listed_.begin(), listed_.end(), &lane);
  if (found == listed_.end()) return;
  if (collecting_) {
    *found = nullptr;
  } else {
    listed_.erase(found);
  }
}

void Lanes::collect() {
  collecting_ = true;
  for (std::size_t i = 0; i < listed_.size(); ++i) {
    if (listed_[i] != nullptr) listed_[i]->collect();
  }
  collecting_ = false;
  std::erase(listed_, nullptr);
}

void Lanes::close() noexcept {
  while (!by_key_.empty()) {  // one by one: `done` of a job may ask for lanes
    const auto last = std::move(by_key_.back().second);
    by_key_.pop_back();
  }
}

}  // namespace rtdata::detail
