#include "sinks/core/sink_account.hpp"

#include <algorithm>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {
namespace {

// Accounts of many origins are made in parts, so that none holds the loop for long.
constexpr std::size_t origins_at_once = 500;

}  // namespace

Result<void> SinkAccount::add_topic(TopicCore& topic, SinkNode& sink) {
  const auto number = static_cast<std::uint32_t>(taps_.size());
  {
    const LoopCore::OffLimits off_limits(*topic.runtime().own_loop);
    if (auto taken = queue_->add_topic(number, topic.name, *topic.type.description); !taken) return taken;
  }
  add_tap(topic, sink, SinkTap::Takes::all);
  return {};
}

void SinkAccount::add_tap(TopicCore& topic, SinkNode& sink, SinkTap::Takes takes) {
  const auto number = static_cast<std::uint32_t>(taps_.size());
  taps_.push_back(std::make_unique<SinkTap>(sink, queue_, topic, number, takes));
  try {
    tap_of_[&topic] = taps_.back().get();
    topic.add_tap(*taps_.back());
  } catch (...) {  // no memory: there is no such tap
    tap_of_.erase(&topic);
    taps_.pop_back();
    throw;
  }
}

void SinkAccount::follow(OriginCore& origin, SinkNode& sink, Tiers tiers) {
  const SinkTap* const tap = origin.made_of.empty() || !queue_->is_recording() ? nullptr : find_tap(origin);
  if (tap == nullptr || !tap->knows(origin)) return;
  std::string all;
  for (const std::string& name : origin.made_of) {
    all += (all.empty() ? "" : " ") + name;
    TopicCore* const topic = origin.topic.runtime().find_topic(name);
    topic != nullptr ? follow(*topic, sink, tiers) : void(awaited_.insert(name));
  }
  notes.add_made_of(tap->slot_of(origin), std::move(all));
}

void SinkAccount::follow(TopicCore& topic, SinkNode& sink, Tiers tiers) {
  if (tap_of_.contains(&topic) || topic.type.description == nullptr) return;
  const auto is_ahead = [](const OriginCore* origin) {
    return origin->is_mirror && origin->counts.scheduled + origin->counts.received != 0;
  };
  if (tiers == Tiers::ahead && std::any_of(topic.origins().begin(), topic.origins().end(), is_ahead)) {
    is_follow_due_ = true;
    return;
  }
  add_tap(topic, sink, SinkTap::Takes::account);
  for (OriginCore* const origin : topic.origins()) follow(*origin, sink, tiers);
}

void SinkAccount::follow(OriginCore& origin, SinkNode& sink) { follow(origin, sink, Tiers::ahead); }

void SinkAccount::follow_all(SinkNode& sink) {
  for (std::size_t i = 0; i < taps_.size(); ++i) {
    for (OriginCore* const origin : taps_[i]->topic().origins()) follow(*origin, sink, Tiers::caught_up);
  }
}

void SinkAccount::follow_new(TopicCore& topic, SinkNode& sink) {
  if (awaited_.erase(topic.name) != 0) follow(topic, sink, Tiers::ahead);
}

void SinkAccount::keep_all(LoopCore& loop) noexcept {
  const LoopCore::OffLimits off_limits(loop);  // to what the writer does
  for (const auto& tap : taps_) tap->keep_all();
}

void SinkAccount::end() noexcept {
  for (const auto& tap : taps_) {
    tap->topic().remove_tap(*tap);
    tap->end();
  }
}

SinkTap* SinkAccount::find_tap(const OriginCore& origin) const {
  const auto tap = tap_of_.find(&origin.topic);
  return tap != tap_of_.end() ? tap->second : nullptr;
}

void SinkAccount::close_gaps() noexcept {
  for (const auto& tap : taps_) {
    for (OriginCore* origin : tap->topic().origins()) origin->close_gap();
  }
}

bool SinkAccount::goes_on_by_itself() const noexcept {
  return std::any_of(taps_.begin(), taps_.end(), [](const auto& tap) {
    const auto& origins = tap->topic().origins();
    return std::any_of(origins.begin(), origins.end(), [](const OriginCore* origin) { return origin->has_segment(); });
  });
}

void SinkAccount::add(OriginCore& origin, const Gap& gap) {
  SinkTap* tap = find_tap(origin);
  if (tap == nullptr || !tap->knows(origin)) return;
  tap->note_closed(origin, gap, accounts_);  // which throws nothing
  notes.add(tap->slot_of(origin), gap, queue_->slot_count());
}

void SinkAccount::add(OriginCore& origin, const Segment& segment) {
  SinkTap* tap = find_tap(origin);
  if (tap == nullptr || !tap->knows(origin)) return;
  const Segment recorded = tap->since_attached(origin, segment);
  if (recorded.scheduled == 0) return;
  tap->note_ended(origin, recorded);  // which throws nothing
  notes.add(tap->slot_of(origin), recorded);
}

SinkAccount::Enqueued SinkAccount::enqueue(Part part, Time at, MonotonicTime until, const std::string& unknown) {
  const bool is_last = part == Part::last;
  Account& account = queue_->next_account();
  account.at = at;
  account.is_last = is_last;
  // All that asks for memory comes first: when there is none, the account stays as it was.
  account.unknown = unknown;
  account.origins.clear();
  std::size_t all = 0;
  for (const auto& tap : taps_) all += tap->topic().origins().size();
  account.origins.reserve(is_last ? all : std::min(all, origins_at_once));
  notes.report_lost(at);
  if (part != Part::next) next_topic_ = next_origin_ = 0;
  bool has_more = false;
  for (std::size_t looked_at = 0; next_topic_ < taps_.size(); ++next_topic_, next_origin_ = 0) {
    SinkTap& tap = *taps_[next_topic_];
    for (const auto& origins = tap.topic().origins(); next_origin_ < origins.size() && !has_more; ++next_origin_) {
      const OriginCore& origin = *origins[next_origin_];
      if (!tap.knows(origin)) continue;
      const OriginAccount now = tap.account_of(origin, until);
      if (tap.is_news(origin, now) || is_last) account.origins.push_back(now);
      has_more = !is_last && ++looked_at == origins_at_once;
    }
    if (has_more) break;
  }
  notes.move_into(account);
  const bool is_something = !account.is_empty();
  if (is_something) {
    queue_->hand_over_account();
    ++accounts_;
  }
  return {is_something, has_more};
}

}  // namespace rtdata::detail
