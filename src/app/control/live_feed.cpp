#include "app/control/live_feed.hpp"

#include <algorithm>
#include <utility>

#include "rtdata/loop/runtime.hpp"

namespace rtdata::app {

bool covers(std::string_view outer, std::string_view inner) noexcept {
  if (outer == inner) return true;
  return topic_matches(outer, inner) && (!inner.ends_with('#') || outer.ends_with('#'));
}

void LiveFeed::bring(const std::string& pattern) {
  // A wider subscription is never replaced by a narrower one: its queued events would be lost.
  const bool is_there = std::any_of(subscriptions_.begin(), subscriptions_.end(),
                                    [&](const auto& one) { return covers(one.first, pattern); });
  if (is_there) return;
  Subscription subscription = loop_.subscribe(pattern, [this](const EventView& event) { take(event); });
  subscription.set_name("readers");
  subscriptions_.emplace(pattern, std::move(subscription));
}

void LiveFeed::end() {
  subscriptions_.clear();
  lost_.clear();
  ring_->has_lost.store(false, std::memory_order_relaxed);
}

/// Once for each description: it looks through all topics.
void LiveFeed::keep(const Description& description) {
  auto& kept = ring_->descriptions[&description];
  for (const TopicStatus& topic : loop_.runtime().topics())
    if (topic.description.get() == &description) kept = topic.description;
}

void LiveFeed::take(const EventView& event) {
  const Description* const description = &event.description();
  if (std::exchange(last_, description) != description && !ring_->descriptions.contains(description))
    keep(*description);
  if (!lost_.empty()) tell_lost();
  // If an origin lost events, the loss is sent before its next event.
  if (lost_.empty() && ring_->put(event.topic(), event.header(), &event.description(), event.payload())) return;
  std::string key = std::string(event.topic()) + '\0' + std::string(event.origin());
  Lost& lost = lost_[std::move(key)];
  lost.topic = event.topic();
  lost.origin = event.origin();
  lost.time = event.time();
  lost.sequence = std::max(lost.sequence, event.sequence());
  ring_->has_lost.store(true, std::memory_order_relaxed);
}

bool LiveFeed::mark(std::uint64_t number) { return ring_->put("", {Time{}, number, ""}, nullptr, {}); }

void LiveFeed::tell_lost() {
  while (!lost_.empty()) {
    const Lost& lost = lost_.begin()->second;
    if (!ring_->put(lost.topic, {lost.time, lost.sequence, lost.origin}, nullptr, {})) return;
    lost_.erase(lost_.begin());
  }
  ring_->has_lost.store(false, std::memory_order_relaxed);
}

}  // namespace rtdata::app
