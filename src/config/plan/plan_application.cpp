#include "config/plan/plan_application.hpp"

#include <algorithm>
#include <filesystem>
#include <utility>

#include "config/plan/neighbours.hpp"
#include "data/saturating.hpp"
#include "loop/events/origin_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata::config_detail {
namespace {

bool ends(Fate fate) { return fate == Fate::restarted || fate == Fate::removed; }
bool is_made(Fate fate) { return fate == Fate::restarted || fate == Fate::added; }

/// Notes the file of the sink that was just closed, because a new sink of that name may have another file.
void note_file_of_closed(Loop& loop, const std::string& name, const std::optional<StoredTopics>& stores) {
  auto& closed = loop.runtime().core().closed_sinks;
  if (stores && !closed.empty() && closed.back().name == name && !closed.back().path) closed.back().path = stores->path;
}

/// True if both cannot exist at the same time: they write one file, or use one MQTT client name.
bool exclude_each_other(const PartPlan& one, const PartPlan& other) {
  const auto file = [](const PartPlan& plan) {
    return std::filesystem::absolute(plan.stores->path).lexically_normal();
  };
  if (one.type == "mqtt" && other.type == "mqtt") return true;
  return !one.stores->path.empty() && !other.stores->path.empty() && file(one) == file(other);
}

/// True if the part is an independent source, whose events do not come from other parts.
bool is_source(const PartPlan& plan) {
  return plan.kind == "sensor" &&
         std::none_of(plan.uses.begin(), plan.uses.end(), [](const PartUse& use) { return use.kind == "topic"; });
}

constexpr std::string_view made_anew = "made anew";

}  // namespace

Error error_at(const PartPlan& plan, Error error) {
  std::string where = plan.item.place().text();
  where += (where.empty() ? "" : ": ") + plan.object();
  error.where = error.where.empty() ? where : where + ": " + error.where;
  return error;
}

PlanApplication::PlanApplication(System& system, const SystemPlan& next)
    : system_(system),
      next_(&next),
      compared_(next.good() ? system.compared_to(next) : throw ConfigError(next.problems)),
      all_(compared_.all()) {}

PlanApplication::~PlanApplication() {
  if (stage_ == Stage::done) return;
  for (const PlannedChange& planned : compared_.parts)
    if (planned.next != nullptr && (planned.change.fate == Fate::restarted || old_) &&
        !system_.parts_.by_name_.contains({planned.next->kind, planned.next->name}))
      system_.not_made_.insert(planned.next->object());
}

bool PlanApplication::step(Duration budget) {
  const MonotonicTime end = detail::later(system_.loop_.now(), budget);
  may_wait_ = budget != Duration::max();
  is_waiting_ = false;
  while (stage_ != Stage::done) {
    switch (stage_) {
      case Stage::beginning:
        begin();
        break;
      case Stage::closing:
        close_one();
        break;
      case Stage::making:
        make_one();
        break;
      case Stage::taking:
        take();
        break;
      case Stage::finishing:
        finish_one();
        break;
      case Stage::done:
        break;
    }
    if (is_waiting_ || (system_.loop_.now() >= end && !switching_)) break;
  }
  if (stage_ == Stage::done) this->end();
  return stage_ != Stage::done;
}

void PlanApplication::end() {
  std::string missing;
  for (const auto& [object, why] : std::exchange(missing_, {})) {
    missing += (missing.empty() ? "" : "; ") + object + " (" + why + ")";
    system_.not_made_.insert(object);
  }
  if (failure_ == nullptr) {
    if (missing.empty()) return;
    throw SetupError(
        {Errc::not_turning, "not made", missing, "",
         "everything else is as configured; parts that are made late are closed again: find what blocks there"});
  }
  try {
    std::rethrow_exception(std::exchange(failure_, nullptr));
  } catch (const SetupError& error) {
    Error told = error.error();
    told.advice += (told.advice.empty() ? "" : "; ") +
                   std::string("the earlier parts are running again" + (missing.empty() ? "" : ", but not " + missing));
    throw SetupError(std::move(told));
  }
}

void PlanApplication::refuse() const {
  for (const PartChange& change : all_.all) {
    if (change.fate != Fate::refused) continue;
    throw SetupError({Errc::busy, "cannot apply the configuration", change.object, change.why,
                      "nothing was changed; undo the change, or start the program again"});
  }
  refuse_hanging();
  for (const PlannedChange& planned : compared_.parts)
    if (planned.now != nullptr && ends(planned.change.fate)) refuse_held(*planned.now);
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
      if (error.error().code != Errc::not_turning) continue;  // the tier does not exist yet
      throw SetupError({Errc::not_turning, "cannot apply the configuration", "tier " + name, error.error().why,
                        "nothing was changed; find what blocks there, or do not change its parts and the sinks "
                        "that take its topics"});
    }
  }
}

void PlanApplication::refuse_held(const PartPlan& part) const {
  if (!part.hold || !part.hold->is_so(system_.parts_.part_named(part.kind, part.name).object)) return;
  throw SetupError({Errc::busy, "cannot apply the configuration", part.object(), part.hold->what, part.hold->advice});
}

void PlanApplication::begin() {
  refuse();
  system_.neighbours_.reset();  // it refers to removed parts
  order_ = system_.parts_.plans();
  list_ending();
}

void PlanApplication::list_ending() {
  std::unordered_map<const PartPlan*, const PlannedChange*> all;
  ending_.clear();
  last_sink_ = nullptr;
  for (const PlannedChange& planned : compared_.parts) {
    if (planned.now != nullptr && ends(planned.change.fate)) all.emplace(planned.now, &planned);
    if (planned.next != nullptr && planned.next->stores && is_made(planned.change.fate)) last_sink_ = planned.next;
  }
  for (const PartPlan* plan : system_.parts_.plans())
    if (const auto found = all.find(plan); found != all.end()) ending_.insert(ending_.begin(), found->second);
  releasing_ = std::make_shared<std::size_t>(0);
  place_ = 0;
  stage_ = Stage::closing;
}

void PlanApplication::close_one() {
  const bool is_last = place_ == ending_.size();
  // Sinks are closed after the outputs, so that they get the outputs' last events.
  if (!released_.empty() && (is_last || ending_[place_]->now->stores)) {
    is_waiting_ = may_wait_ && *releasing_ != 0;
    if (is_waiting_) return;
    for (const PartPlan* plan : std::exchange(released_, {})) close(*plan);
  }
  if (is_last && failure_ != nullptr && !old_) return go_back(failure_);
  if (is_last) {
    if (!old_) take_text();
    if (last_sink_ == nullptr) switching_.reset();
    place_ = 0;
    stage_ = Stage::making;
    return;
  }
  const PlannedChange& planned = *ending_[place_++];
  try {
    begin_to_close(planned);
  } catch (...) {
    if (old_) return note_missing(planned.now->object(), "it cannot be closed");
    failure_ = std::current_exception();
    place_ = ending_.size();  // those before it are closed
  }
}

void PlanApplication::begin_to_close(const PlannedChange& planned) {
  const PartPlan& now = *planned.now;
  const PartObject& object = system_.parts_.part_named(now.kind, now.name).object;
  if (!old_) {
    refuse_held(now);
    if (now.make_again) back_[now.object()] = now.make_again(object);
  }
  if (planned.next != nullptr && planned.next->make_again)
    again_[planned.next->object()] = planned.next->make_again(object);
  if (const auto* const sensor = now.kind == "sensor" ? object.as<AnySensor>() : nullptr) {
    if (sensor->is_running())
      away_[now.object()] = {system_.loop_.now(), sensor->rate() ? sensor->rate().period() : Duration{0}};
    else if (!old_)
      stopped_.insert(now.object());
  }
  if (planned.change.fate == Fate::removed && now.on_removal) now.on_removal(object);
  if (!now.ending || !may_wait_) return close(now);
  const auto done = [&loop = system_.loop_, left = std::weak_ptr(releasing_)] {
    loop.post([left] {
      if (const auto still = left.lock()) --*still;
    });
  };
  now.ending(object, done);
  ++*releasing_;
  released_.push_back(&now);
}

void PlanApplication::close(const PartPlan& plan) {
  if (!old_) changed_.emplace(&plan, plan);
  const std::string name = plan.name;
  const std::optional<StoredTopics> stores = plan.stores;
  if (stores && !switching_) switching_.emplace(system_.loop_.runtime().core());
  std::unique_ptr<Parts::Part> part = system_.parts_.take(plan.kind, plan.name);
  // A sink with `through` has nothing in memory, so it is closed without waiting.
  if (stores && stores->through.empty() && part->object.as<Sink>() != nullptr) return finish(std::move(part));
  system_.close(std::move(part));
  note_file_of_closed(system_.loop_, name, stores);
}

void PlanApplication::finish(std::unique_ptr<Parts::Part> part) {
  const auto* const storing = part.get();
  Sink& sink = *part->object.as<Sink>();
  system_.finishing_->sinks.push_back(std::move(part));
  sink.finish([&loop = system_.loop_, all = std::weak_ptr(system_.finishing_), storing](std::uint64_t lost) {
    const auto finishing = all.lock();
    if (finishing == nullptr) return;
    finishing->lost += lost;
    note_file_of_closed(loop, storing->plan.name, storing->plan.stores);
    loop.post([all, storing] {  // not from within it
      if (const auto still = all.lock())
        std::erase_if(still->sinks, [&](const auto& one) { return one.get() == storing; });
    });
  });
}

void PlanApplication::take_text() {
  detail::Configurations& configurations = system_.loop_.runtime().core().configurations;
  if (configurations.whole() == next_->document.text && configurations.changes().empty()) return;
  before_ = std::make_unique<detail::Configurations::State>(configurations.state());
  configurations.replace(next_->document.text);
}

void PlanApplication::make_one() {
  if (place_ == compared_.parts.size()) {
    switching_.reset();
    stage_ = Stage::taking;
    return;
  }
  const PlannedChange& planned = compared_.parts[place_++];
  try {
    if (is_made(planned.change.fate)) make(*planned.next);
    if (planned.change.fate == Fate::live) change_live(planned);
    if (planned.change.fate == Fate::refused) note_missing(planned.change.object, planned.change.why);
  } catch (const SetupError& error) {
    // Does not wait for a hanging tier and does not undo its work.
    if (!old_ && error.error().code != Errc::not_turning) return go_back(std::current_exception());
    note_missing(planned.next->object(), error.error().text());
  } catch (...) {
    if (!old_) return go_back(std::current_exception());
    note_missing(planned.next->object(), "it cannot be made");
  }
  if (planned.next == last_sink_) switching_.reset();
}

void PlanApplication::make(const PartPlan& plan) {
  if (plan.stores) {  // waits for the old sink, which still stores to the same file
    auto& sinks = system_.finishing_->sinks;
    for (std::size_t i = 0; i < sinks.size();) {
      if (!exclude_each_other(sinks[i]->plan, plan)) {
        ++i;
      } else if (may_wait_) {
        sinks[i++]->object.as<Sink>()->end_before(plan.name);
      } else {
        const std::unique_ptr<Parts::Part> part = std::move(sinks[i]);
        sinks.erase(sinks.begin() + static_cast<std::ptrdiff_t>(i));
      }
    }
  }
  auto part = std::make_unique<Parts::Part>(Parts::Part{plan, {}});
  if (PartPlan::Make make = std::move(again_[plan.object()])) part->plan.make = std::move(make);
  if (away_.contains(plan.object())) part->plan.make = counting_absence(plan, std::move(part->plan.make));
  system_.parts_.takes_ = old_ ? Output::Takes::patiently : may_wait_ ? Output::Takes::later : Output::Takes::at_once;
  struct AtOnce {
    Output::Takes& takes;
    ~AtOnce() { takes = Output::Takes::at_once; }
  };
  {
    const AtOnce afterwards{system_.parts_.takes_};
    system_.make(std::move(part));
  }
  Parts::Part& made = system_.parts_.part_named(plan.kind, plan.name);
  made.plan.make = plan.make;
  if (plan.when_made && (old_ || may_wait_)) {
    ++taking_->left;
    plan.when_made(made.object, [&loop = system_.loop_, weak = std::weak_ptr(taking_), &plan](Result<void> result) {
      loop.post([weak, &plan, result = std::move(result)] {
        const auto taking = weak.lock();  // the plan is complete then
        if (taking == nullptr) return;
        --taking->left;
        if (!result && !taking->failed) taking->failed = error_at(plan, result.error());
      });
    });
  }
  if (!stopped_.contains(plan.object())) return;
  made.object.as<AnySensor>()->stop();
  system_.loop_.runtime().core().log(LogLevel::warning, plan.object(),
                                     "it was stopped, and stays stopped after the reload, until it is started");
}

PartPlan::Make PlanApplication::counting_absence(const PartPlan& plan, PartPlan::Make make) {
  return [away = away_[plan.object()], make = std::move(make), name = plan.name, has_outage = is_source(plan)](
             Loop& loop, const Parts& parts) {
    detail::OriginCore* const origin = loop.runtime().core().find_origin(name);
    // Its schedule was still running when it was closed.
    if (origin != nullptr && detail::later(origin->free_from(), 2 * away.period) >= away.since)
      origin->set_absence_period(away.period);
    PartObject made = make(loop, parts);
    if (origin == nullptr) return made;
    if (!made.as<AnySensor>()->is_running()) {
      origin->set_absence_period(Duration{0});
    } else if (away.period == Duration{0} && has_outage && loop.now() > away.since &&
               origin->absent_since() == Time::min()) {
      origin->begin_absence(Gap::Kind::disconnected, made_anew, away.since);
      origin->end_absence(loop.now());
    }
    return made;
  };
}

void PlanApplication::change_live(const PlannedChange& planned) {
  Parts::Part& part = system_.parts_.part_named(planned.next->kind, planned.next->name);
  const PartPlan now = std::exchange(part.plan, *planned.next);
  if (!old_) changed_.emplace(planned.now, now);
  for (const auto& [key, change] : planned.next->live) {
    const ConfigItem* before = now.item.find(key);
    const ConfigItem* next = planned.next->item.find(key);
    if (before != nullptr && next != nullptr ? !(*before == *next) : before != next) change(part.object);
  }
}

void PlanApplication::take() {
  is_waiting_ = may_wait_ && taking_->left != 0;
  if (is_waiting_) return;
  if (taking_->failed && !old_) return go_back(std::make_exception_ptr(SetupError(*std::move(taking_->failed))));
  for (const PlannedChange& planned : compared_.parts) {
    if (!old_ || !is_made(planned.change.fate) || !planned.next->when_made) continue;
    const auto* const output = system_.parts_.find<Output>(planned.next->kind, planned.next->name);
    if (output != nullptr && output->health() == Health::faulted)
      note_missing(planned.next->object(), output->status().reason + ": it is tried again");
  }
  settle();
  before_ = nullptr;
  place_ = 0;
  is_applied_ = !old_;
  stage_ = Stage::finishing;
}

void PlanApplication::settle() {
  std::vector<std::unique_ptr<Parts::Part>>& made = system_.parts_.made_;
  std::unordered_map<const Parts::Part*, std::size_t> places;
  places.reserve(made.size());
  for (const PlannedChange& planned : compared_.parts) {
    if (planned.next == nullptr) continue;
    const auto found = system_.parts_.by_name_.find({planned.next->kind, planned.next->name});
    if (found == system_.parts_.by_name_.end()) continue;  // it could not be made
    Parts::Part& part = *found->second;
    places.emplace(&part, places.size());
    if (planned.change.fate != Fate::unchanged || !planned.next->as_written) continue;
    try {
      planned.next->as_written(part.object);
    } catch (const SetupError& error) {  // its tier does not turn
      system_.loop_.runtime().core().log(LogLevel::warning, planned.next->object(),
                                         "it is not as configured: " + error.error().text(), error.error().id());
    }
  }
  // The parts are closed in reverse order.
  std::vector<std::unique_ptr<Parts::Part>> in_order(places.size());
  for (std::unique_ptr<Parts::Part>& part : made) {
    const auto found = places.find(part.get());
    if (found != places.end())
      in_order[found->second] = std::move(part);
    else
      in_order.push_back(std::move(part));  // it could not be closed
  }
  made = std::move(in_order);
  system_.configuration_ = next_->document.file;
  system_.root_ = next_->document.root;
  system_.log_ = next_->settings.log;
}

void PlanApplication::finish_one() {
  if (place_ == compared_.parts.size()) {
    stage_ = Stage::done;
    return;
  }
  const PlannedChange& planned = compared_.parts[place_++];
  if (planned.change.fate == Fate::unchanged && planned.now != nullptr && planned.next != nullptr)
    system_.parts_.part_named(planned.next->kind, planned.next->name).plan = *planned.next;
}

void PlanApplication::go_back(std::exception_ptr why) {
  failure_ = std::move(why);
  // Before a recording starts with it.
  if (before_ != nullptr) system_.loop_.runtime().core().configurations.restore(std::move(*before_));
  before_ = nullptr;
  old_.emplace();
  old_->document.file = system_.configuration_;
  old_->document.root = system_.root_;
  old_->settings.log = system_.log_;
  for (const PartPlan* plan : order_) {
    const auto changed = changed_.find(plan);
    old_->parts.push_back(changed != changed_.end() ? changed->second : *plan);
  }
  next_ = &*old_;
  compared_ = system_.compared_to(*old_);
  again_ = std::move(back_);
  taking_ = std::make_shared<Taking>();
  missing_.clear();
  list_ending();
}

void PlanApplication::note_missing(const std::string& object, const std::string& why) {
  missing_.emplace_back(object, why);
}

}  // namespace rtdata::config_detail
