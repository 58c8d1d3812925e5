#include "rtdata/config/parts.hpp"

#include <algorithm>
#include <iterator>

#include "rtdata/loop/topic.hpp"

namespace rtdata {

bool StoredTopics::wants(std::string_view topic) const noexcept {
  return std::any_of(topics.begin(), topics.end(),
                     [&](const std::string& pattern) { return topic_matches(pattern, topic); });
}

std::string_view PartPlan::tier() const noexcept {
  for (const PartUse& use : uses)
    if (use.kind == "tier") return use.name;
  return "";
}

Parts::~Parts() {
  while (!made_.empty()) {
    const std::unique_ptr<Part> last = std::move(made_.back());
    made_.pop_back();
    by_name_.erase({last->plan.kind, last->plan.name});
  }
}

Parts::Part& Parts::part_named(std::string_view kind, std::string_view name) const {
  const auto found = by_name_.find({std::string(kind), std::string(name)});
  if (found != by_name_.end()) return *found->second;
  const std::vector<std::string> known = names(kind);
  const std::string nearest = nearest_name(name, known);
  std::string advice = nearest.empty() ? "there is none" : "did you mean \"" + nearest + "\"?";
  if (nearest.empty() && !known.empty()) {
    advice = "available:";
    for (std::size_t i = 0; i < known.size() && i < 12; ++i) advice.append(i == 0 ? " " : ", ").append(known[i]);
  }
  throw SetupError(
      {Errc::not_found, "no such " + std::string(kind), "\"" + std::string(name) + "\"", "", std::move(advice)});
}

void Parts::refuse_type(std::string_view kind, std::string_view name) const {
  const PartPlan& plan = part_named(kind, name).plan;
  throw SetupError({Errc::bad_argument, "cannot use the " + plan.object(), plan.item.place().text(),
                    "it is of type " + plan.type + ", which has another class",
                    "declare which types a parameter may name (names_part)"});
}

std::vector<std::string> Parts::names(std::string_view kind) const {
  std::vector<std::string> names;
  for (const auto& part : made_)
    if (part->plan.kind == kind) names.push_back(part->plan.name);
  return names;
}

std::vector<const PartPlan*> Parts::plans() const {
  std::vector<const PartPlan*> plans;
  for (const auto& part : made_) plans.push_back(&part->plan);
  return plans;
}

void Parts::add(std::unique_ptr<Part> part) {
  by_name_[{part->plan.kind, part->plan.name}] = part.get();
  made_.push_back(std::move(part));
}

/// Removes the part from the list before it is destroyed, because its destructor may use the list.
std::unique_ptr<Parts::Part> Parts::take(std::string_view kind, std::string_view name) {
  const Part& part = part_named(kind, name);
  // Most parts are taken in reverse order of creation.
  const auto at = std::find_if(made_.rbegin(), made_.rend(), [&](const auto& made) { return made.get() == &part; });
  std::unique_ptr<Part> last = std::move(*at);
  made_.erase(std::next(at).base());
  by_name_.erase({last->plan.kind, last->plan.name});
  return last;
}

}  // namespace rtdata
