#include "loop/runtime/names.hpp"

#include <mutex>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/support/name.hpp"

namespace rtdata::detail {

OriginCore& Names::claim(std::string_view name, TopicCore& topic, OriginCore::Supply supply) {
  if (!is_name(name)) {
    throw SetupError({Errc::bad_name, "cannot make sensor", quoted_name(name), name_rule, "give it another `name`"});
  }
  // Events that another loop has published under the name come first. Before the lock, so that little is left under it.
  runtime_.receive_all();
  const auto refuse = [&](const std::string& why, const char* advice) {
    throw SetupError({Errc::busy, "cannot make sensor", std::string(name), why, advice});
  };
  const auto refuse_holder = [&](const RuntimeCore& holder) {
    refuse(
        "there is one of that name already" + (&holder == &runtime_ ? "" : " on loop " + holder.own_loop->config.name),
        "give each sensor a `name` of its own");
  };
  const auto refuse_topic = [&](const std::string& earlier) {
    refuse("earlier in this run it published on topic " + earlier, "choose another name or that topic");
  };
  const auto check_supply = [&](OriginCore::Supply earlier, const SensorCounts& counts) {
    const bool is_unused = !counts.has_schedule && counts.received == 0;
    if (is_unused || earlier == OriginCore::Supply::none || earlier == supply) return;
    refuse(earlier == OriginCore::Supply::feed ? "earlier in this run it was fed, here it is to have a schedule"
                                               : "earlier in this run it had a schedule, here it is to be fed",
           "choose another name: the two are accounted for in different ways");
  };
  Names& all = runtime_.main().names;
  bool is_new = false;
  OriginCore* origin = nullptr;
  if (!all.is_shared_) {
    origin = runtime_.find_origin(name);
    if (origin != nullptr && origin->is_claimed) refuse_holder(runtime_);
    if (origin != nullptr && &origin->topic != &topic) refuse_topic(origin->topic.name);
    if (origin != nullptr) check_supply(origin->supply, origin->counts);
    is_new = origin == nullptr || origin->supply == OriginCore::Supply::none;
    origin = &runtime_.find_or_make_origin(name, topic);
    if (supply == OriginCore::Supply::feed) origin->expect_gaps();
  } else {
    const std::lock_guard lock(all.mutex_);
    Claim& claim = all.claims_[std::string(name)];
    if (claim.holder != nullptr) refuse_holder(*claim.holder);
    runtime_.receive_all();  // also what the last holder published since then, before it let go
    if (claim.left != nullptr && claim.left->topic != topic.name) refuse_topic(claim.left->topic);
    if (claim.left != nullptr) check_supply(claim.left->state.supply, claim.left->state.counts);
    const OriginCore* known = runtime_.find_origin(name);
    is_new = known == nullptr || known->is_mirror || known->supply == OriginCore::Supply::none;
    origin = &runtime_.find_or_make_origin(name, topic);
    if (supply == OriginCore::Supply::feed) origin->expect_gaps();
    if (is_new) origin->adopt(claim.left != nullptr ? claim.left->state : OriginCore::State{});
    claim.holder = &runtime_;
  }
  origin->is_claimed = true;
  origin->supply = supply;
  try {
    topic.expect(*origin);  // a writer's code may run: not under the lock
    for (std::size_t i = 0; is_new && i < runtime_.listeners.size(); ++i) runtime_.listeners[i]->on_origin(*origin);
  } catch (...) {  // out of memory: nothing is claimed
    origin->supply = OriginCore::Supply::none;
    release(*origin);
    throw;
  }
  return *origin;
}

void Names::share() {
  if (std::exchange(is_shared_, true)) return;
  for (const OriginCore& origin : runtime_.origins()) {
    Claim& claim = claims_[origin.name];
    if (origin.is_claimed) {
      claim.holder = &runtime_;
    } else {
      claim.left = std::make_unique<Claim::Left>(Claim::Left{origin.topic.name, origin.state()});
    }
  }
}

void Names::release(OriginCore& origin) noexcept {
  origin.is_claimed = false;
  Names& all = runtime_.main().names;
  if (!all.is_shared_) return;
  const std::lock_guard lock(all.mutex_);
  if (const auto found = all.claims_.find(origin.name); found != all.claims_.end())
    release(found->first, found->second);
}

void Names::release_all() noexcept {
  Names& all = runtime_.main().names;
  const std::lock_guard lock(all.mutex_);
  for (auto& [name, claim] : all.claims_) {
    if (claim.holder == &runtime_) release(name, claim);
  }
}

void Names::release(std::string_view name, Claim& claim) noexcept try {
  claim.holder = nullptr;
  runtime_.send_now();  // before the next holder sends
  const OriginCore* origin = runtime_.find_origin(name);
  if (claim.left == nullptr) claim.left = std::make_unique<Claim::Left>(Claim::Left{origin->topic.name, {}});
  claim.left->state = origin->state();
} catch (...) {  // out of memory: on another loop it begins anew
}

}  // namespace rtdata::detail
