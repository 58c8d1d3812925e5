#include "config/plan/plan_application.hpp"

#include <algorithm>
#include <unordered_map>
#include <utility>

#include "config/plan/neighbours.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata::config_detail {
namespace {

bool ends(Fate fate) { return fate == Fate::restarted || fate == Fate::removed; }
/// What it has queued is in memory alone, and another may send at the same time. Not to a broker of MQTT, which knows
/// clients by their names.
bool sends_beside_another(const PartPlan& plan) {
  return plan.stores && plan.stores->is_sender && plan.stores->through.empty() && plan.type != "mqtt";
}
bool is_made(Fate fate) { return fate == Fate::restarted || fate == Fate::added; }

}  // namespace

void PlanApplication::run() {
  detail::Configurations& configurations = system_.loop_.runtime().core().configurations;
  const bool is_new_text = configurations.whole() != next_.document.text || !configurations.changes().empty();
  const detail::Configurations::State before = configurations.state();
  system_.neighbours_.reset();  // it knows parts that go
  close();
  if (is_new_text) configurations.replace(next_.document.text);
  try {
    make();
    change_live();
  } catch (const SetupError& error) {
    Error told = error.error();
    if (is_new_text) configurations.restore(before);  // before a recording begins anew with it
    undo(told);
    throw SetupError(std::move(told));
  } catch (...) {  // no memory
    Error ignored;
    if (is_new_text) configurations.restore(before);
    undo(ignored);
    throw;
  }
  settle();
}

void PlanApplication::close() {
  std::unordered_map<const PartPlan*, Fate> fates;
  for (const PlannedChange& planned : changes_.parts)
    if (planned.now != nullptr) fates.emplace(planned.now, planned.change.fate);
  std::vector<const PartPlan*> ending = system_.parts_.plans();
  std::erase_if(ending, [&](const PartPlan* plan) { return !ends(fates.at(plan)); });
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
  keep_what_is_taken_over();
  for (auto plan = order.rbegin(); plan != order.rend(); ++plan) {
    std::unique_ptr<Parts::Part> part = system_.parts_.take((*plan)->kind, (*plan)->name);
    if (sends_beside_another(**plan)) finish(std::move(part));
    part = nullptr;
    closed_at_[(*plan)->object()] = system_.loop_.now();
  }
}

void PlanApplication::finish(std::unique_ptr<Parts::Part> part) {
  const auto* const sending = part.get();
  Sink& sink = *part->object.as<Sink>();
  system_.finishing_->sinks.push_back(std::move(part));
  sink.finish([&loop = system_.loop_, all = std::weak_ptr(system_.finishing_), sending](std::uint64_t lost) {
    const auto finishing = all.lock();
    if (finishing == nullptr) return;
    finishing->lost += lost;
    loop.post([all, sending] {  // not from within it
      if (const auto still = all.lock())
        std::erase_if(still->sinks, [&](const auto& one) { return one.get() == sending; });
    });
  });
}

void PlanApplication::keep_what_is_taken_over() {
  for (const PlannedChange& planned : changes_.parts) {
    if (planned.now == nullptr || !ends(planned.change.fate)) continue;
    const PartPlan& now = *planned.now;
    const PartObject& before = system_.parts_.part_named(now.kind, now.name).object;
    if (now.make_again) back_[now.object()] = now.make_again(before);
    if (planned.next != nullptr && planned.next->make_again)
      again_[planned.next->object()] = planned.next->make_again(before);
  }
}

void PlanApplication::make_part(const PartPlan& plan, PartPlan::Make make) {
  auto part = std::make_unique<Parts::Part>(Parts::Part{plan, {}});
  if (make) part->plan.make = std::move(make);
  system_.make(std::move(part));
  system_.parts_.part_named(plan.kind, plan.name).plan.make = plan.make;
}

void PlanApplication::make() {
  for (const PlannedChange& planned : changes_.parts) {
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
  for (const PlannedChange& planned : changes_.parts) {
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
  std::unordered_map<const Parts::Part*, std::size_t> places;
  std::size_t place = 0;
  for (const PlannedChange& planned : changes_.parts) {
    if (planned.next == nullptr) continue;
    Parts::Part& part = system_.parts_.part_named(planned.next->kind, planned.next->name);
    if (!is_made(planned.change.fate)) part.plan = *planned.next;
    places.emplace(&part, place++);
  }
  // They are closed in the opposite order.
  std::sort(system_.parts_.made_.begin(), system_.parts_.made_.end(),
            [&](const auto& a, const auto& b) { return places.at(a.get()) < places.at(b.get()); });
  system_.configuration_ = next_.document.file;
  system_.root_ = next_.document.root;
  system_.log_ = next_.settings.log;
}

void PlanApplication::undo(Error& error) {
  for (const auto& [part, change_back] : changed_) {
    try {
      (*change_back)(part->object);
    } catch (const SetupError&) {  // it had that value: it is as it was
    }
  }
  for (auto part = made_.rbegin(); part != made_.rend(); ++part) system_.parts_.remove(part->first, part->second);
  std::string lost;
  for (PartPlan& plan : closed_) {
    std::string object = plan.object();
    try {
      make_part(plan, std::move(back_[object]));
      report_absence(plan);
    } catch (const SetupError& failed) {
      lost += (lost.empty() ? "" : "; ") + object + " (" + failed.what() + ")";
    }
  }
  error.advice += (error.advice.empty() ? "" : "; ") +
                  std::string(lost.empty() ? "the parts of before are running again"
                                           : "the parts of before are running again, but not " + lost);
}

}  // namespace rtdata::config_detail
