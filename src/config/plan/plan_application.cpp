#include "config/plan/plan_application.hpp"

#include <algorithm>
#include <filesystem>
#include <optional>
#include <set>
#include <string_view>
#include <unordered_map>
#include <utility>

#include "config/plan/neighbours.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/support/deadline.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata::config_detail {
namespace {

bool ends(Fate fate) { return fate == Fate::restarted || fate == Fate::removed; }
/// What it has queued is in memory alone, and another may send at the same time. Not to a broker of MQTT, which knows
/// clients by their names.
bool sends_beside_another(const PartPlan& plan) {
  return plan.stores && plan.stores->is_sender && plan.stores->through.empty() && plan.type != "mqtt";
}
/// Of the sink that has left the runtime just now: another of its name may have another file.
void note_file_of_closed(Loop& loop, const std::string& name, const std::optional<StoredTopics>& stores) {
  auto& closed = loop.runtime().core().closed_sinks;
  if (stores && !closed.empty() && closed.back().name == name && !closed.back().path) closed.back().path = stores->path;
}
bool is_made(Fate fate) { return fate == Fate::restarted || fate == Fate::added; }

/// The names and places of parts, of which one is to be closed before another has them.
class Taken {
 public:
  void add(const PartPlan& part) {
    names_.insert(part.name);
    for_each_place(part, [&](Place place) { places_.insert(place); });
  }
  bool has_any_of(const PartPlan& part) const {
    bool has = names_.contains(part.name);
    for_each_place(part, [&](Place place) { has = has || places_.contains(place); });
    return has;
  }

 private:
  using Place = std::pair<std::string_view, std::string_view>;
  /// Devices that are on no bus are one place, since a path may have several names.
  template <class See>
  static void for_each_place(const PartPlan& part, const See& see) {
    const auto see_one = [&](const PartPlan::Place& place) {
      if (!place.text.empty()) see(place.bus.empty() ? Place{} : Place{place.bus, place.text});
    };
    see_one(part.place);
    for (const PartPlan::Place& place : part.more_places) see_one(place);
  }

  std::set<std::string_view> names_;
  std::set<Place> places_;
};

}  // namespace

Error error_at(const PartPlan& plan, Error error) {
  std::string where = plan.item.place().text();
  where += (where.empty() ? "" : ": ") + plan.object();
  error.where = error.where.empty() ? where : where + ": " + error.where;
  return error;
}

PlanApplication::PlanApplication(System& system, const SystemPlan& next, std::set<std::string> given_up)
    : system_(system),
      next_(next),
      given_up_(std::move(given_up)),
      compared_(next.good() ? system.compared_to(next) : throw ConfigError(next.problems)),
      all_(compared_.all()) {}

bool PlanApplication::step(Duration budget) {
  const MonotonicTime end = detail::later(system_.loop_.now(), budget);
  may_wait_ = budget != Duration::max();
  is_waiting_ = false;
  struct TakesLater {
    explicit TakesLater(bool& flag_, bool is_so) : flag(flag_) { flag = is_so; }
    ~TakesLater() { flag = false; }
    bool& flag;
  } const takes_later(system_.parts_.takes_devices_later_, may_wait_);
  while (stage_ != Stage::done) {
    switch (stage_) {
      case Stage::beginning:
        begin();
        break;
      case Stage::adding:
        add_one();
        break;
      case Stage::releasing:
        release();
        break;
      case Stage::replacing:
        replace();
        break;
      case Stage::taking:
        take();
        break;
      case Stage::finishing:
        finish_one();
        break;
      case Stage::undoing:
        undo_one();
        break;
      case Stage::done:
        break;
    }
    if (is_waiting_ || system_.loop_.now() >= end) break;
  }
  if (stage_ == Stage::done && failure_ != nullptr) std::rethrow_exception(std::exchange(failure_, nullptr));
  return stage_ != Stage::done;
}

void PlanApplication::refuse() const {
  for (const PartChange& change : all_.all) {
    if (change.fate != Fate::refused) continue;
    throw SetupError({Errc::busy, "cannot apply the configuration", change.object, change.why,
                      "nothing was changed; take the change back, or start the program again"});
  }
  refuse_hanging();
}

std::set<std::string> PlanApplication::tiers() const {
  std::set<std::string> tiers;
  for (const PlannedChange& planned : compared_.parts) {
    if (planned.change.fate == Fate::unchanged) continue;
    for (const PartPlan* const plan : {planned.now, planned.next}) {
      if (plan == nullptr) continue;
      tiers.insert(std::string(plan->tier()));
      if (!plan->stores) continue;  // of any tier's topics
      for (const PartPlan* const other : system_.parts().plans())
        if (other->kind == "tier") tiers.insert(other->name);
    }
  }
  tiers.erase("");
  return tiers;
}

void PlanApplication::refuse_hanging() const {
  for (const std::string& name : tiers()) {
    try {
      system_.tier(name).call([](Loop&) {});
    } catch (const SetupError& error) {
      if (error.error().code != Errc::not_turning) continue;  // one that does not exist yet
      throw SetupError({Errc::not_turning, "cannot apply the configuration", "tier " + name, error.error().why,
                        "nothing was changed; look for what blocks there, or leave as they are its parts, and the "
                        "sinks that take its topics"});
    }
  }
}

void PlanApplication::sort_out() {
  closes_nothing_ = std::none_of(compared_.parts.begin(), compared_.parts.end(),
                                 [](const PlannedChange& planned) { return ends(planned.change.fate); });
  if (closes_nothing_) {
    for (PlannedChange& planned : compared_.parts)
      if (is_made(planned.change.fate)) ahead_.push_back(&planned);
    return;
  }
  Taken ending, coming;
  std::set<std::pair<std::string_view, std::string_view>> closed, absent;  // kind and name
  std::vector<const PlannedChange*> sinks;
  for (const PlannedChange& planned : compared_.parts) {
    if (ends(planned.change.fate)) ending.add(*planned.now);
    if (ends(planned.change.fate)) closed.emplace(planned.now->kind, planned.now->name);
    if (!is_made(planned.change.fate)) continue;
    coming.add(*planned.next);
    if (planned.next->stores) sinks.push_back(&planned);
  }
  // What a sink that does not take this topic now would miss until it is made.
  const auto is_awaited = [&](const PartPlan& part) {
    return std::any_of(sinks.begin(), sinks.end(), [&](const PlannedChange* sink) {
      if (part.stored_by == sink->next->name) return true;
      if (!part.publishes || !sink->next->stores->wants(part.publishes->topic)) return false;
      return sink->now == nullptr || !sink->now->stores || !sink->now->stores->wants(part.publishes->topic);
    });
  };
  std::set<std::string_view> absent_topics;
  for (PlannedChange& planned : compared_.parts) {
    if (!is_made(planned.change.fate)) continue;
    const PartPlan& part = *planned.next;
    const bool is_ahead =
        planned.change.fate == Fate::added && part.kind == "sensor" && !ending.has_any_of(part) && !is_awaited(part) &&
        std::none_of(part.uses.begin(), part.uses.end(), [&](const PartUse& use) {
          return use.kind == "topic" ? absent_topics.contains(use.name) : absent.contains({use.kind, use.name});
        });
    if (is_ahead) {
      ahead_.push_back(&planned);
      continue;
    }
    absent.emplace(part.kind, part.name);
    if (part.publishes) absent_topics.insert(part.publishes->topic);
  }
  for (PlannedChange& planned : compared_.parts) {
    if (planned.change.fate != Fate::removed) continue;
    const PartPlan& part = *planned.now;
    const bool can_wait = part.kind == "sensor" && !coming.has_any_of(part) &&
                          std::none_of(part.uses.begin(), part.uses.end(), [&](const PartUse& use) {
                            return use.kind == "topic" || closed.contains({use.kind, use.name});
                          });
    if (!can_wait) continue;
    planned.change.fate = Fate::unchanged;  // until then
    later_.push_back(planned.now);
  }
}

void PlanApplication::begin() {
  refuse();
  const detail::Configurations& configurations = system_.loop_.runtime().core().configurations;
  is_new_text_ = configurations.whole() != next_.document.text || !configurations.changes().empty();
  system_.neighbours_.reset();  // it knows parts that go
  sort_out();
  if (closes_nothing_) take_text();
  stage_ = Stage::adding;
}

void PlanApplication::take_text() {
  if (!is_new_text_) return;
  detail::Configurations& configurations = system_.loop_.runtime().core().configurations;
  before_ = std::make_unique<detail::Configurations::State>(configurations.state());
  configurations.replace(next_.document.text);
}

void PlanApplication::add_one() {
  if (place_ == ahead_.size()) {
    stage_ = may_wait_ && !closes_nothing_ ? Stage::releasing : Stage::replacing;
    return;
  }
  PlannedChange& planned = *ahead_[place_++];
  try {
    make_part(*planned.next, {});
    made_.emplace_back(planned.next->kind, planned.next->name);
  } catch (...) {
    // It may need what is to be closed before, in a way that its plan does not say.
    if (!closes_nothing_) place_ = ahead_.size();
    if (closes_nothing_) fail(std::current_exception());
    return;
  }
  made_ahead_ = made_.size();
  planned.change.fate = Fate::unchanged;  // from here on
}

void PlanApplication::release() {
  if (releasing_ == nullptr) {
    releasing_ = std::make_shared<std::size_t>(0);
    try {
      refuse_held();
      for (const PlannedChange& planned : compared_.parts) {
        if (planned.now == nullptr || !planned.now->ending || !ends(planned.change.fate)) continue;
        released_.push_back(planned.now);
        ++*releasing_;
        const auto done = [&loop = system_.loop_, left = std::weak_ptr(releasing_)] {
          loop.post([left] {
            if (const auto still = left.lock()) --*still;
          });
        };
        planned.now->ending->begin(system_.parts_.part_named(planned.now->kind, planned.now->name).object, done);
      }
    } catch (...) {
      fail(std::current_exception());
      return;
    }
  }
  is_waiting_ = may_wait_ && *releasing_ != 0;
  if (!is_waiting_) stage_ = Stage::replacing;
}

/// Also what has begun to hold while sensors were added.
void PlanApplication::refuse_held() const {
  for (const PlannedChange& planned : compared_.parts) {
    if (planned.now == nullptr || !planned.now->hold || !ends(planned.change.fate)) continue;
    const PartPlan& part = *planned.now;
    if (!part.hold->is_so(system_.parts_.part_named(part.kind, part.name).object)) continue;
    throw SetupError({Errc::busy, "cannot apply the configuration", part.object(), part.hold->what, part.hold->advice});
  }
}

void PlanApplication::replace() {
  try {
    refuse_held();
    keep_what_is_taken_over();  // before `close`: what it throws has closed nothing
    close();
    if (!closes_nothing_) take_text();  // what was closed has ended with its own
    make();
    change_live();
  } catch (...) {
    fail(std::current_exception());
    return;
  }
  stage_ = Stage::taking;
}

void PlanApplication::take() {
  is_waiting_ = taking_->left != 0 && !taking_->failed;
  if (is_waiting_) return;
  if (taking_->failed) return fail(std::make_exception_ptr(SetupError(*std::move(taking_->failed))));
  settle();
  before_ = nullptr;
  place_ = 0;
  is_applied_ = true;
  stage_ = Stage::finishing;
}

void PlanApplication::finish_one() {
  if (place_ < compared_.parts.size()) {
    const PlannedChange& planned = compared_.parts[place_++];
    if (planned.change.fate == Fate::unchanged && planned.now != nullptr && planned.next != nullptr)
      system_.parts_.part_named(planned.next->kind, planned.next->name).plan = *planned.next;
  } else if (!later_.empty()) {
    const PartPlan& last = *later_.back();
    later_.pop_back();
    system_.parts_.remove(last.kind, last.name);
  } else {
    stage_ = Stage::done;
  }
}

void PlanApplication::undo_one() {
  if (made_.empty()) {
    stage_ = Stage::done;
    return;
  }
  remove_last_made();
}

void PlanApplication::remove_last_made() {
  const auto& [kind, name] = made_.back();
  const std::optional<StoredTopics> stores = system_.parts_.part_named(kind, name).plan.stores;
  system_.parts_.remove(kind, name);
  note_file_of_closed(system_.loop_, name, stores);
  made_.pop_back();
}

void PlanApplication::close() {
  for (const PlannedChange& planned : compared_.parts)  // what this throws has closed nothing
    if (planned.change.fate == Fate::removed && planned.now->on_removal)
      planned.now->on_removal(system_.parts_.part_named(planned.now->kind, planned.now->name).object);
  std::unordered_map<const PartPlan*, Fate> fates;
  for (const PlannedChange& planned : compared_.parts)
    if (planned.now != nullptr) fates.emplace(planned.now, planned.change.fate);
  std::vector<const PartPlan*> ending = system_.parts_.plans();
  std::erase_if(ending, [&](const PartPlan* plan) {
    const auto fate = fates.find(plan);  // none of what was added ahead
    return fate == fates.end() || !ends(fate->second);
  });
  released_.clear();  // `back_` makes them again
  closed_.reserve(ending.size());
  for (const PartPlan* plan : ending) closed_.push_back(*plan);
  // What stores waits for what it has queued, and goes first, unless another part uses it: sensors keep their schedules
  // meanwhile, which count the ticks that this costs.
  const auto is_used = [&](const PartPlan& plan) {
    return std::any_of(closed_.begin(), closed_.end(), [&](const PartPlan& other) {
      return std::any_of(other.uses.begin(), other.uses.end(),
                         [&](const PartUse& use) { return use.kind == plan.kind && use.name == plan.name; });
    });
  };
  std::vector<const PartPlan*> order;
  for (const PartPlan& plan : closed_) order.push_back(&plan);
  std::stable_partition(order.begin(), order.end(),
                        [&](const PartPlan* plan) { return !plan->stores || is_used(*plan); });
  for (auto plan = order.rbegin(); plan != order.rend(); ++plan) {
    std::unique_ptr<Parts::Part> part = system_.parts_.take((*plan)->kind, (*plan)->name);
    const bool has_file_alone = (*plan)->stores && (*plan)->stores->is_recording &&
                                !is_made_with((*plan)->stores->path);
    // What goes through a recording has nothing in memory: it ends with that.
    const bool is_given_up = (*plan)->stores && (*plan)->stores->through.empty() && given_up_.contains((*plan)->name);
    if (is_given_up || has_file_alone || sends_beside_another(**plan)) {
      if (has_file_alone && !is_given_up) ending_.push_back(part.get());
      finish(std::move(part));
    } else {
      part = nullptr;
      note_file_of_closed(system_.loop_, (*plan)->name, (*plan)->stores);
    }
    closed_at_[(*plan)->object()] = system_.loop_.now();
  }
}

bool PlanApplication::is_made_with(const std::string& path) const {
  const auto file = [](const std::string& text) { return std::filesystem::absolute(text).lexically_normal(); };
  return std::any_of(compared_.parts.begin(), compared_.parts.end(), [&](const PlannedChange& planned) {
    return planned.next != nullptr && is_made(planned.change.fate) && planned.next->stores &&
           !planned.next->stores->path.empty() && file(planned.next->stores->path) == file(path);
  });
}

void PlanApplication::finish(std::unique_ptr<Parts::Part> part) {
  const auto* const sending = part.get();
  Sink& sink = *part->object.as<Sink>();
  system_.finishing_->sinks.push_back(std::move(part));
  sink.finish([&loop = system_.loop_, all = std::weak_ptr(system_.finishing_), sending](std::uint64_t lost) {
    const auto finishing = all.lock();
    if (finishing == nullptr) return;
    finishing->lost += lost;
    note_file_of_closed(loop, sending->plan.name, sending->plan.stores);
    loop.post([all, sending] {  // not from within it
      if (const auto still = all.lock())
        std::erase_if(still->sinks, [&](const auto& one) { return one.get() == sending; });
    });
  });
}

void PlanApplication::keep_what_is_taken_over() {
  for (const PlannedChange& planned : compared_.parts) {
    if (planned.now == nullptr || !ends(planned.change.fate)) continue;
    const PartPlan& now = *planned.now;
    const PartObject& before = system_.parts_.part_named(now.kind, now.name).object;
    const auto* const sensor = now.kind == "sensor" ? before.as<AnySensor>() : nullptr;
    if (sensor != nullptr && !sensor->is_running()) stopped_.insert(now.object());
    if (now.make_again) back_[now.object()] = now.make_again(before);
    if (planned.next != nullptr && planned.next->make_again)
      again_[planned.next->object()] = planned.next->make_again(before);
  }
}

void PlanApplication::make_part(const PartPlan& plan, PartPlan::Make make) {
  auto part = std::make_unique<Parts::Part>(Parts::Part{plan, {}});
  if (make) part->plan.make = std::move(make);
  system_.make(std::move(part));
  Parts::Part& made = system_.parts_.part_named(plan.kind, plan.name);
  made.plan.make = plan.make;
  if (plan.when_made && system_.parts_.takes_devices_later()) {
    ++taking_->left;
    plan.when_made(made.object, [&loop = system_.loop_, weak = std::weak_ptr(taking_), &plan](Result<void> result) {
      loop.post([weak, &plan, result = std::move(result)] {
        const auto taking = weak.lock();  // with which the plan is there
        if (taking == nullptr) return;
        --taking->left;
        if (!result && !taking->failed) taking->failed = error_at(plan, result.error());
      });
    });
  }
  if (!stopped_.contains(plan.object())) return;
  made.object.as<AnySensor>()->stop();
  system_.loop_.runtime().core().log(LogLevel::warning, plan.object(),
                                     "it was stopped, and stays so now that it is made anew, until it is started");
}

void PlanApplication::make() {
  for (const PlannedChange& planned : compared_.parts) {
    if (!is_made(planned.change.fate)) continue;
    make_part(*planned.next, std::move(again_[planned.next->object()]));
    made_.emplace_back(planned.next->kind, planned.next->name);
    report_absence(*planned.next);
  }
}

void PlanApplication::report_absence(const PartPlan& plan) {
  const auto closed = closed_at_.find(plan.object());
  if (closed == closed_at_.end() || !plan.publishes || !plan.publishes->load) return;
  const Duration period = plan.publishes->load->period;
  const Duration away = system_.loop_.now() - closed->second;
  if (period <= Duration{0} || away <= period) return;
  system_.loop_.runtime().core().keep_report(
      &system_.loop_.core(), plan.object(),
      {Errc::held_too_long, "was not read", plan.object(), "it was made anew, which took " + to_string(away),
       "some " + std::to_string(away / period) +
           " ticks of its rate are in no account: between two schedules there is none"});
}

void PlanApplication::change_live() {
  for (const PlannedChange& planned : compared_.parts) {
    if (planned.change.fate != Fate::live) continue;
    Parts::Part& part = system_.parts_.part_named(planned.next->kind, planned.next->name);
    for (const auto& [key, change] : planned.next->live) {
      const ConfigItem* now = planned.now->item.find(key);
      const ConfigItem* next = planned.next->item.find(key);
      if (now != nullptr && next != nullptr ? *now == *next : now == next) continue;
      changed_.push_back({&part, &planned.now->live.at(key)});
      change(part.object);
    }
  }
}

void PlanApplication::settle() {
  std::vector<std::unique_ptr<Parts::Part>>& made = system_.parts_.made_;
  std::unordered_map<const Parts::Part*, std::size_t> places;
  places.reserve(made.size());
  const auto put_next = [&](const PartPlan& plan) -> Parts::Part& {
    Parts::Part& part = system_.parts_.part_named(plan.kind, plan.name);
    places.emplace(&part, places.size());
    return part;
  };
  for (const PlannedChange& planned : compared_.parts) {
    if (planned.next == nullptr) continue;
    Parts::Part& part = put_next(*planned.next);
    if (planned.change.fate == Fate::live) part.plan = *planned.next;
    if (planned.change.fate != Fate::unchanged || !planned.next->as_written) continue;
    try {
      planned.next->as_written(part.object);
    } catch (const SetupError& error) {  // its tier does not turn
      system_.loop_.runtime().core().log(LogLevel::warning, planned.next->object(),
                                         std::string("it is not as it is written: ") + error.what(),
                                         error.error().id());
    }
  }
  for (const PartPlan* plan : later_) put_next(*plan);
  // They are closed in the opposite order.
  std::vector<std::unique_ptr<Parts::Part>> in_order(made.size());
  for (std::unique_ptr<Parts::Part>& part : made) in_order[places.at(part.get())] = std::move(part);
  made = std::move(in_order);
  system_.configuration_ = next_.document.file;
  system_.root_ = next_.document.root;
  system_.log_ = next_.settings.log;
}

void PlanApplication::fail(std::exception_ptr why) {
  system_.parts_.takes_devices_later_ = false;
  // Before a recording begins anew with it.
  if (before_ != nullptr) system_.loop_.runtime().core().configurations.restore(std::move(*before_));
  before_ = nullptr;
  const std::string gone = bring_back();
  try {
    std::rethrow_exception(why);
  } catch (const SetupError& error) {
    Error told = error.error();
    told.advice += (told.advice.empty() ? "" : "; ") +
                   std::string(gone.empty() ? "the parts of before are running again"
                                            : "the parts of before are running again, but not " + gone);
    failure_ = std::make_exception_ptr(SetupError(std::move(told)));
  } catch (...) {  // no memory
    failure_ = why;
  }
  stage_ = Stage::undoing;
}

std::string PlanApplication::bring_back() {
  for (const auto& [part, change_back] : changed_) {
    try {
      (*change_back)(part->object);
    } catch (const SetupError&) {  // it had that value: it is as it was
    }
  }
  while (made_.size() > made_ahead_) remove_last_made();
  // Their files are wanted again: waits for what is being closed.
  for (const Parts::Part* const ending : ending_) {
    auto& sinks = system_.finishing_->sinks;
    const auto found = std::find_if(sinks.begin(), sinks.end(), [&](const auto& one) { return one.get() == ending; });
    if (found == sinks.end()) continue;
    const std::unique_ptr<Parts::Part> part = std::move(*found);
    sinks.erase(found);
  }
  std::string gone;
  const auto note_gone = [&](const PartPlan& plan, const SetupError& failed) {
    gone += (gone.empty() ? "" : "; ") + plan.object() + " (" + failed.what() + ")";
  };
  for (const PartPlan* plan : released_) {
    try {
      plan->ending->take_back(system_.parts_.part_named(plan->kind, plan->name).object);
    } catch (const SetupError& failed) {
      note_gone(*plan, failed);
    }
  }
  for (PartPlan& plan : closed_) {
    try {
      make_part(plan, std::move(back_[plan.object()]));
      report_absence(plan);
    } catch (const SetupError& failed) {
      note_gone(plan, failed);
    }
  }
  return gone;
}

}  // namespace rtdata::config_detail
