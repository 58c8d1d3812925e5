#include "config/plan/change.hpp"

#include <algorithm>
#include <map>
#include <set>
#include <string>
#include <utility>

#include "config/read/mistakes.hpp"
#include "data/listed.hpp"

namespace rtdata {
namespace config_detail {
namespace {

using Key = std::pair<std::string_view, std::string_view>;  // kind and name
Key key_of(const PartPlan& part) { return {part.kind, part.name}; }

/// The keys whose values differ, in the order in which they are written.
std::vector<std::string> differing_keys(const ConfigItem& now, const ConfigItem& next) {
  std::vector<std::string> keys;
  for (const ConfigChild& child : next.children()) {
    const ConfigItem* before = child_of(now, child.key);
    if (before == nullptr || !(*before == child.item)) keys.push_back(child.key);
  }
  for (const ConfigChild& child : now.children())
    if (child_of(next, child.key) == nullptr) keys.push_back(child.key);
  return keys;
}

/// Compares settings other than parts, in the order of the file.
void compare_settings(const ConfigItem& now, const ConfigItem& next, std::vector<PartChange>& changes) {
  const auto compare_one = [&](const std::string& key) {
    const bool is_kept = key == "notes" || key == "$schema";
    const bool is_page = key == "page";
    if (!is_kept && !is_page && key != "control" && key != "name" && key != "loop" && key != "log") return;  // of parts
    const ConfigItem* const before = child_of(now, key);
    const ConfigItem* const after = child_of(next, key);
    if (before != nullptr && after != nullptr && *before == *after) return;
    const bool has_other_commands = is_page && before != nullptr && after != nullptr &&
                                    differing_keys(*before, *after) == std::vector<std::string>{"commands"};
    const bool is_live = key == "control" || has_other_commands;
    if (is_kept) {
      changes.push_back({key, Fate::live, "kept with the text"});
    } else if (is_live) {
      changes.push_back({key, Fate::live, "from the next one on"});
    } else {
      changes.push_back({key, Fate::refused, "the program reads it only when it starts; start the program again"});
    }
  };
  for (const ConfigChild& child : next.children()) compare_one(child.key);
  for (const ConfigChild& child : now.children())
    if (child_of(next, child.key) == nullptr) compare_one(child.key);
}

/// Compares one part, without the parts that it uses.
PartChange compared(const PartPlan& now, const PartPlan& next) {
  PartChange change{next.object()};
  const std::vector<std::string> keys = differing_keys(now.item, next.item);
  if (keys.empty() && now.secrets == next.secrets) return change;
  if (next.kind == "tier") {
    change.fate = Fate::refused;
    change.why = "a tier is made before the loops run; start the program again";
    return change;
  }
  const bool is_live = !keys.empty() && now.secrets == next.secrets &&
                       std::all_of(keys.begin(), keys.end(), [&](const std::string& key) {
                         return next.live.contains(key) && now.live.contains(key);
                       });
  change.fate = is_live ? Fate::live : Fate::restarted;
  change.why = keys.empty() ? "a secret" : detail::listed(keys);
  return change;
}

/// Why it cannot be made during the run; empty: it can.
std::string obstacle(const PlannedChange& planned, const RunSoFar& run) {
  const PartPlan& part = *planned.next;
  if (!part.publishes) return "";
  const std::string& topic = part.publishes->topic;
  const auto is_scheduled = [](const PartPlan& plan) {
    return plan.publishes && plan.publishes->load && plan.publishes->load->period > Duration{0};
  };
  if (const RunSoFar::Published earlier = run.published(part.name); !earlier.topic.empty()) {
    if (earlier.topic != topic)
      return "earlier in this run it published on topic " + earlier.topic + "; give it another name, or that topic";
    if (earlier.tier != part.tier())
      return "its name belongs to " + (earlier.tier.empty() ? "the main loop" : "tier " + earlier.tier) +
             " until the end of the run; start the program again, or give it another name";
  }
  if (planned.now != nullptr && is_scheduled(*planned.now) != is_scheduled(part))
    return "a sensor with a schedule and one without are accounted for in different ways; give it another name";
  if (part.publishes->description == nullptr) return "";
  const Description* carries = run.carried(topic);
  if (carries == nullptr || carries->same_meaning(*part.publishes->description)) return "";
  return "the topic " + topic + " carries other values until the end of the run (" +
         detail::listed(carries->differences(*part.publishes->description)) + "); give it another topic";
}

/// Refuses to restart or remove a part that is held.
void respect_hold(const PartPlan& part, const RunSoFar& run, PartChange& change) {
  if (!part.hold || (change.fate != Fate::restarted && change.fate != Fate::removed)) return;
  if (!run.is_held) {
    change.why += (change.why.empty() ? "" : "; ") + ("refused while " + part.hold->what);
  } else if (run.is_held(part)) {
    change = {change.object, Fate::refused, part.hold->what + "; " + part.hold->advice};
  }
}

}  // namespace

ComparedPlans compare(const Compared& now, const Compared& next, const RunSoFar& run) {
  ComparedPlans plans;
  compare_settings(now.root, next.root, plans.settings);
  std::map<Key, const PartPlan*> before;
  for (const PartPlan* part : now.parts) before.emplace(key_of(*part), part);
  std::set<Key> known, restarted;
  plans.parts.reserve(next.parts.size());
  for (const PartPlan* part : next.parts) {
    known.insert(key_of(*part));
    const auto found = before.find(key_of(*part));
    PlannedChange planned{found != before.end() ? found->second : nullptr, part, {part->object(), Fate::added}};
    PartChange& change = planned.change;
    if (planned.now != nullptr) {
      change = compared(*planned.now, *part);
    } else if (part->kind == "tier") {
      change.fate = Fate::refused;
      change.why = "a tier is made before the loops run; start the program again";
    }
    if (change.fate == Fate::unchanged || change.fate == Fate::live) {
      // Each part comes after the parts that it uses.
      for (const PartUse& use : part->uses) {
        if (use.kind == "topic" || !restarted.contains({use.kind, use.name})) continue;
        change.fate = Fate::restarted;
        change.why = "it uses " + use.kind + " " + use.name;
      }
    }
    if (change.fate == Fate::restarted || change.fate == Fate::added || change.fate == Fate::live) {
      if (std::string why = obstacle(planned, run); !why.empty()) {
        change.fate = Fate::refused;
        change.why = std::move(why);
      }
    }
    if (planned.now != nullptr) respect_hold(*planned.now, run, change);
    if (change.fate == Fate::restarted) restarted.insert(key_of(*part));
    plans.parts.push_back(std::move(planned));
  }
  for (const PartPlan* part : now.parts) {
    if (known.contains(key_of(*part))) continue;
    PartChange change{part->object(), Fate::removed};
    if (part->kind == "tier") {
      change.fate = Fate::refused;
      change.why = "the thread of a tier ends with the run; start the program again";
    }
    respect_hold(*part, run, change);
    plans.parts.push_back({part, nullptr, std::move(change)});
  }
  return plans;
}

PlanChange ComparedPlans::all() const {
  PlanChange change{settings};
  for (const PlannedChange& part : parts) change.all.push_back(part.change);
  return change;
}

}  // namespace config_detail

std::string_view name_of(Fate fate) noexcept {
  constexpr std::string_view names[] = {"unchanged", "changed while it runs", "restarted", "added", "removed",
                                        "refused"};
  return names[static_cast<std::size_t>(fate)];
}

std::string PartChange::text() const {
  const std::string fated = object + ": " + std::string(name_of(fate));
  if (why.empty()) return fated;
  return fate == Fate::refused ? fated + ": " + why : fated + " (" + why + ")";
}

std::size_t PlanChange::count(Fate fate) const noexcept {
  return static_cast<std::size_t>(
      std::count_if(all.begin(), all.end(), [&](const PartChange& change) { return change.fate == fate; }));
}

std::string PlanChange::text() const {
  std::string text;
  for (const PartChange& change : all)
    if (change.fate != Fate::unchanged) text += change.text() + "\n";
  return text;
}

PlanChange plan_change(const SystemPlan& now, const SystemPlan& next) {
  const auto parts_of = [](const SystemPlan& plan) {
    std::vector<const PartPlan*> parts;
    for (const PartPlan& part : plan.parts) parts.push_back(&part);
    return parts;
  };
  std::map<std::string_view, const Description*> carried;
  std::map<std::string_view, config_detail::RunSoFar::Published> published;
  for (const PartPlan& part : now.parts) {
    if (!part.publishes) continue;
    published.emplace(part.name, config_detail::RunSoFar::Published{part.publishes->topic, std::string(part.tier())});
    if (part.publishes->description != nullptr)
      carried.emplace(part.publishes->topic, part.publishes->description.get());
  }
  const auto found_in = [](const auto& map, const std::string& key) {
    const auto found = map.find(key);
    return found != map.end() ? found->second : typename std::decay_t<decltype(map)>::mapped_type{};
  };
  return config_detail::compare({parts_of(now), now.document.root}, {parts_of(next), next.document.root},
                                {[&](const std::string& topic) { return found_in(carried, topic); },
                                 [&](const std::string& origin) { return found_in(published, origin); }})
      .all();
}

}  // namespace rtdata
