#include "loop/core/deliveries.hpp"

#include <cstddef>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {

Deliveries::~Deliveries() {
  for (; first_ != nullptr; first_ = first_->next_ready_) first_->is_ready_ = false;  // they outlive the loop
}

void Deliveries::add(DeliveryQueue& queue) {
  loop_.assert_thread();
  queue.is_ready_ = true;
  queue.next_ready_ = nullptr;
  if (last_ == nullptr) {
    first_ = &queue;
    loop_.uv.forbid_sleep();
  } else {
    last_->next_ready_ = &queue;
  }
  last_ = &queue;
}

void Deliveries::deliver(Budget budget) {
  constexpr int most_rounds = 100;  // each delivers events published by the handlers of the previous round
  left_ = Left::nothing;
  if (delivering_ || loop_.is_ending()) return;
  delivering_ = true;
  MonotonicTime current = loop_.now();
  const MonotonicTime end = budget == Budget::limited ? later(current, loop_.config.delivery_budget)
                                                      : MonotonicTime::max();
  if (budget == Budget::none || !loop_.is_manual()) rounds_ = 0;
  while (first_ != nullptr && left_ == Left::nothing)
    left_ = rounds_ < most_rounds ? deliver_round(current, end) : Left::circle;
  delivering_ = false;
  loop_.runtime.send_now();
}

bool Deliveries::must_pause(MonotonicTime now, MonotonicTime limit) const noexcept {
  return limit != MonotonicTime::max() && (now >= limit || loop_.deadlines.is_due(now));
}

Deliveries::Left Deliveries::deliver_round(MonotonicTime& current, MonotonicTime end) {
  // An interrupted round continues, so that rounds of handlers in a circle are counted even if deadlines come in
  // between.
  std::size_t unfinished = 0;
  for (DeliveryQueue* queue = first_; queue != nullptr; queue = queue->next_ready_) {
    if (!round_is_open_) queue->begin_round();
    if (queue->is_in_round()) ++unfinished;
  }
  round_is_open_ = true;
  while (unfinished > 0) {
    DeliveryQueue* queue = first_;
    const bool is_of_round = queue->is_in_round();  // others became ready meanwhile
    if (is_of_round) current = queue->deliver_group(loop_, current, end);
    if (is_of_round && !queue->is_in_round()) --unfinished;
    if (!queue->has_pending()) {
      first_ = queue->next_ready_;
      if (first_ == nullptr) last_ = nullptr;
      queue->is_ready_ = false;
    } else if (queue->next_ready_ != nullptr) {  // to the back, so that one busy queue does not hold the others
      first_ = queue->next_ready_;
      last_->next_ready_ = queue;
      last_ = queue;
      queue->next_ready_ = nullptr;
    }
    if (must_pause(current, end)) return Left::later;
  }
  round_is_open_ = false;
  ++rounds_;
  return Left::nothing;
}

}  // namespace rtdata::detail
