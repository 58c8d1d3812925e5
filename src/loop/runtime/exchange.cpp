#include "loop/runtime/exchange.hpp"

#include <algorithm>
#include <iterator>
#include <mutex>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/bridge.hpp"
#include "loop/tier/tier_core.hpp"

namespace rtdata::detail {

std::string Exchange::catch_up(Duration at_most) {
  if (standstill_) return standstill_->unknown;
  constexpr Duration turn = std::chrono::milliseconds{1};  // time for each tier
  LoopCore& loop = *runtime_.own_loop;
  const MonotonicTime end = later(loop.now(), at_most);
  const auto left = [&] { return std::max(end - loop.now(), Duration{0}); };
  runtime_.receive_all();
  for (TierCore* tier : runtime_.tiers) tier->ask_account();
  std::vector<TierCore*> silent;
  do {
    for (TierCore* tier : runtime_.tiers) tier->wait_for_account(std::min(left(), turn));
    silent = runtime_.tiers;
    std::erase_if(silent, [](TierCore* tier) { return tier->has_whole_account(); });
  } while (!silent.empty() && left() > Duration{0});
  std::string unknown;
  for (TierCore* tier : silent) tier->add_unknown(unknown);
  return unknown;
}

std::string Exchange::unknown() const {
  std::string unknown;
  for (const TierCore* tier : runtime_.tiers) {
    if (tier->is_known()) continue;
    unknown += (unknown.empty() ? "" : "; ") + tier->unknown();
  }
  return unknown;
}

namespace {

const std::vector<std::string> all_topics{"#"};

}  // namespace

Exchange::Standstill::Standstill(RuntimeCore& runtime) : runtime_(runtime), all_(runtime, all_topics) {
  const Time time = runtime.event_now();
  runtime.exchange.standstill_ = {time, runtime.exchange.catch_up(std::chrono::seconds{1})};
}

Exchange::Standstill::~Standstill() { runtime_.exchange.standstill_.reset(); }

Exchange::Interest::Interest(RuntimeCore& runtime, const std::vector<std::string>& patterns)
    : runtime_(runtime), patterns_(patterns) {
  runtime_.exchange.wanted_.push_back(&patterns_);
  for (const auto& topic : runtime_.topics()) topic->followers_changed();
}

Exchange::Interest::~Interest() {
  std::erase(runtime_.exchange.wanted_, &patterns_);
  for (const auto& topic : runtime_.topics()) topic->followers_changed();
}

bool Exchange::is_wanted(std::string_view topic) const noexcept {
  return std::any_of(wanted_.begin(), wanted_.end(), [&](const std::vector<std::string>* wanted) {
    return std::any_of(wanted->begin(), wanted->end(),
                       [&](const std::string& pattern) { return topic_matches(pattern, topic); });
  });
}

void Exchange::announce(Announcement announcement) {
  const std::lock_guard lock(announced_mutex_);
  announced_.push_back(std::move(announcement));
  has_announced_.store(true, std::memory_order_release);
}

void Exchange::take_announcements() {
  if (has_announced_.load(std::memory_order_acquire)) {
    const std::lock_guard lock(announced_mutex_);
    taken_.insert(taken_.end(), std::make_move_iterator(announced_.begin()), std::make_move_iterator(announced_.end()));
    announced_.clear();
    has_announced_.store(false, std::memory_order_relaxed);
  }
  for (; !taken_.empty(); taken_.pop_front()) taken_.front().bridge->receiving.hear(taken_.front());
}

void Exchange::report_cut_off(TopicCore& topic) {
  const SubscriptionNode* node = topic.first_subscriber();
  if (node == nullptr || topic.cut_off_from.empty()) return;
  Error error = cannot_cross(topic);
  error.where += ", which is published on loop " + std::exchange(topic.cut_off_from, {});
  runtime_.keep_report(node->loop(), node->name, std::move(error));
}

void Exchange::forget(const Bridge& of) {
  const std::lock_guard lock(announced_mutex_);
  const auto is_of_it = [&](const Announcement& one) { return one.bridge == &of; };
  std::erase_if(announced_, is_of_it);
  std::erase_if(taken_, is_of_it);
}

}  // namespace rtdata::detail
