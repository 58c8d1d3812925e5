#include "loop/runtime/names.hpp"

#include <mutex>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/support/name.hpp"
#include "loop/tier/bridge.hpp"

namespace rtdata::detail {

OriginCore& Names::claim(std::string_view name, TopicCore& topic, OriginCore::Supply supply) {
  if (!is_name(name)) {
    throw SetupError({Errc::bad_name, "cannot make sensor", quoted_name(name), name_rule, "give it another `name`"});
  }
  const OriginCore::State state = take(name, topic, supply);
  OriginCore* origin = nullptr;
  try {
    runtime_.exchange.take_announcements();  // that the last holder gave up the name: what it published comes first
    origin = &runtime_.find_or_make_origin(name, topic);
    if (supply == OriginCore::Supply::feed) origin->expect_gaps();
    origin->adopt(state);
    origin->is_claimed = true;
    origin->supply = supply;
    topic.expect(*origin);  // a writer's code may run
    for (Bridge* bridge : runtime_.outbound) bridge->sending.open(*origin);
  } catch (...) {  // out of memory: nothing was published
    if (origin != nullptr) {
      origin->supply = state.supply;
      release(*origin);
    } else {
      give_back(name);
    }
    throw;
  }
  return *origin;
}

OriginCore::State Names::take(std::string_view name, const TopicCore& topic, OriginCore::Supply supply) {
  const auto refuse = [&](const std::string& why, const char* advice) {
    throw SetupError({Errc::busy, "cannot make sensor", std::string(name), why, advice});
  };
  Names& all = runtime_.main().names;
  const std::lock_guard lock(all.mutex_);
  Claim& claim = all.claims_[std::string(name)];
  const OriginCore* kept = claim.holder == &runtime_ ? runtime_.find_origin(name) : nullptr;  // see `release`
  if (claim.holder != nullptr && (kept == nullptr || kept->is_claimed)) {
    refuse("there is one of that name already" +
               (claim.holder == &runtime_ ? "" : " on loop " + claim.holder->own_loop->config.name),
           "give each sensor a `name` of its own");
  }
  OriginCore::State state;
  if (kept != nullptr) {
    state = kept->state();
  } else if (claim.left != nullptr) {
    state = *claim.left;
  }
  if (!claim.topic.empty() && claim.topic != topic.name)
    refuse("earlier in this run it published on topic " + claim.topic, "choose another name or that topic");
  const bool is_unused = !state.counts.has_schedule && state.counts.received == 0;
  if (!is_unused && state.supply != OriginCore::Supply::none && state.supply != supply) {
    refuse(state.supply == OriginCore::Supply::feed ? "earlier in this run it was fed, here it is to have a schedule"
                                                    : "earlier in this run it had a schedule, here it is to be fed",
           "choose another name: the two are accounted for in different ways");
  }
  claim.topic = topic.name;
  claim.holder = &runtime_;
  return state;
}

void Names::give_back(std::string_view name) noexcept {
  Names& all = runtime_.main().names;
  const std::lock_guard lock(all.mutex_);
  for (auto& [known, claim] : all.claims_) {
    if (known == name) claim.holder = nullptr;
  }
}

void Names::release(OriginCore& origin) noexcept try {
  origin.is_claimed = false;
  auto left = std::make_unique<OriginCore::State>(origin.state());
  for (Bridge* bridge : runtime_.outbound) bridge->sending.give_up(origin);
  Names& all = runtime_.main().names;
  const std::lock_guard lock(all.mutex_);
  Claim& claim = all.claims_.find(origin.name)->second;
  claim.left = std::move(left);
  claim.holder = nullptr;
} catch (...) {  // out of memory: the name stays with this loop, where alone it can be claimed again
}

void Names::release_all() noexcept {
  for (const OriginCore& origin : runtime_.origins()) {
    if (origin.is_claimed) release(*runtime_.find_origin(origin.name));
  }
  Names& all = runtime_.main().names;
  const std::lock_guard lock(all.mutex_);
  for (auto& [name, claim] : all.claims_) {
    if (claim.holder == &runtime_) claim.holder = nullptr;
  }
}

}  // namespace rtdata::detail
