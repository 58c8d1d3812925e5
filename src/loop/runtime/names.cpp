#include "loop/runtime/names.hpp"

#include <mutex>
#include <string>

#include "data/name.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/bridge.hpp"

namespace rtdata::detail {

OriginCore& Names::claim(std::string_view name, TopicCore& topic, OriginCore::Supply supply) {
  if (!is_name(name)) {
    throw SetupError({Errc::bad_name, "cannot make sensor", quoted_name(name), name_rule, "give it another `name`"});
  }
  const OriginCore::State state = take(name, topic, supply);
  OriginCore* origin = nullptr;
  try {
    origin = &runtime_.find_or_make_origin(name, topic);
    if (supply == OriginCore::Supply::feed) origin->expect_gaps();
    origin->adopt(state);
    origin->is_claimed = true;
    origin->supply = supply;
    topic.expect(*origin);  // may run code of a writer
    for (Bridge* bridge : runtime_.outbound) bridge->sending.open(*origin);
  } catch (...) {  // out of memory: nothing was published
    if (origin != nullptr) {
      origin->is_claimed = false;
      origin->supply = state.supply;
    }
    Names& all = runtime_.main().names;
    const std::lock_guard lock(all.mutex_);
    all.claims_.find(name)->second.is_there = false;
    throw;
  }
  return *origin;
}

OriginCore::State Names::take(std::string_view name, const TopicCore& topic, OriginCore::Supply supply) {
  const auto refuse = [&](const std::string& why, const char* advice) {
    throw SetupError({Errc::busy, "cannot make sensor", std::string(name), why, advice});
  };
  Names& all = runtime_.main().names;
  const std::string here = runtime_.hub != nullptr ? runtime_.own_loop->config.name : std::string();
  const std::lock_guard lock(all.mutex_);
  Claim& claim = all.claims_[std::string(name)];
  const auto on_loop = [&] {
    const std::string& tier = claim.where.tier;
    return " on loop " + (tier.empty() ? runtime_.main().own_loop->config.name : tier);
  };
  const bool is_elsewhere = !claim.where.topic.empty() && claim.where.tier != here;
  if (claim.is_there)
    refuse("there is one of that name already" + (is_elsewhere ? on_loop() : ""),
           "give each sensor a `name` of its own");
  if (is_elsewhere)
    refuse("earlier in this run it was" + on_loop() + ", to which its name belongs",
           "start the program again, or give it another name");
  OriginCore::State state;
  const OriginCore* const kept = claim.where.topic.empty() ? nullptr : runtime_.find_origin(name);
  if (kept != nullptr) {
    state = kept->state();
  } else if (claim.left != nullptr) {
    state = *claim.left;
  }
  if (!claim.where.topic.empty() && claim.where.topic != topic.name)
    refuse("earlier in this run it published on topic " + claim.where.topic, "choose another name or that topic");
  const bool is_unused = !state.counts.has_schedule && state.counts.received == 0;
  if (!is_unused && state.supply != OriginCore::Supply::none && state.supply != supply) {
    refuse(state.supply == OriginCore::Supply::feed ? "earlier in this run it was fed, here it is to have a schedule"
                                                    : "earlier in this run it had a schedule, here it is to be fed",
           "choose another name: the two are accounted for in different ways");
  }
  claim.where = {topic.name, here};
  claim.is_there = true;
  return state;
}

Names::Published Names::published(std::string_view name) const {
  Names& all = runtime_.main().names;
  const std::lock_guard lock(all.mutex_);
  const auto found = all.claims_.find(name);
  return found != all.claims_.end() ? found->second.where : Published{};
}

void Names::release(OriginCore& origin) noexcept {
  origin.is_claimed = false;
  origin.made_of.clear();
  for (Bridge* bridge : runtime_.outbound) bridge->sending.send_soon();
  Names& all = runtime_.main().names;
  const std::lock_guard lock(all.mutex_);
  all.claims_.find(origin.name)->second.is_there = false;
}

void Names::release_all() noexcept {
  Names& all = runtime_.main().names;
  const std::lock_guard lock(all.mutex_);
  for (const OriginCore& origin : runtime_.origins()) {
    const auto found = all.claims_.find(origin.name);
    if (found == all.claims_.end() || found->second.where.tier != runtime_.own_loop->config.name) continue;
    Claim& claim = found->second;
    try {
      claim.left = std::make_unique<OriginCore::State>(origin.state());
      claim.is_there = false;
    } catch (...) {  // no memory: the name is lost
      claim.is_there = true;
    }
  }
}

}  // namespace rtdata::detail
