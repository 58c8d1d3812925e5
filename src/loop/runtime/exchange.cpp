#include "loop/runtime/exchange.hpp"

#include <algorithm>
#include <mutex>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/bridge.hpp"
#include "loop/tier/tier_core.hpp"

namespace rtdata::detail {

std::string Exchange::catch_up(Duration at_most) {
  constexpr Duration turn = std::chrono::milliseconds{1};  // of one tier: one that hangs takes no other's time
  LoopCore& loop = *runtime_.own_loop;
  const MonotonicTime end = later(loop.now(), at_most);
  const auto left = [&] { return std::max(end - loop.now(), Duration{0}); };
  std::vector<TierCore*> silent;
  std::uint64_t known_names = 0;
  do {
    runtime_.receive_all();
    known_names = takeovers;
    for (TierCore* tier : runtime_.tiers) tier->ask_account();
    silent = runtime_.tiers;
    do {
      std::erase_if(silent, [&](TierCore* tier) { return tier->hear_out(std::min(left(), turn)); });
    } while (!silent.empty() && left() > Duration{0});
    // A takeover takes all that the old holder has sent, to keep the order, and so more than it answered for: once
    // more.
  } while (takeovers != known_names && left() > Duration{0});
  std::string unknown;
  for (TierCore* tier : silent) tier->add_unknown(unknown);
  if (unknown.empty() && takeovers != known_names) unknown = "names went from tier to tier all the time";
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
  {
    const std::lock_guard lock(announced_mutex_);
    announced_.push_back(std::move(announcement));
  }
  has_announced_.store(true, std::memory_order_release);
}

void Exchange::take_announcements() {
  if (!has_announced_.exchange(false, std::memory_order_acquire)) return;
  std::vector<Announcement> taken;
  {
    const std::lock_guard lock(announced_mutex_);
    taken.swap(announced_);
  }
  for (Announcement& one : taken) one.bridge->hear(one);
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
  std::erase_if(announced_, [&](const Announcement& one) { return one.bridge == &of; });
}

}  // namespace rtdata::detail
