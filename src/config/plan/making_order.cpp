#include "config/plan/making_order.hpp"

#include <cstdint>
#include <unordered_map>
#include <utility>

#include "config/read/mistakes.hpp"

namespace rtdata::config_detail {
namespace {

/// A depth-first topological sort of the parts by what they use. Not recursive, since a chain of uses may be long.
class MakingOrder {
 public:
  MakingOrder(const std::vector<PartPlan>& parts, const Neighbours& neighbours, Problems& problems)
      : parts_(parts), problems_(problems), states_(parts.size()), used_(parts.size()) {
    std::unordered_map<const PartPlan*, std::size_t> index;
    for (std::size_t i = 0; i < parts.size(); ++i) index.emplace(&parts[i], i);
    for (std::size_t i = 0; i < parts.size(); ++i) {
      for (const PartUse& use : parts[i].uses) {
        if (use.kind == "topic") {
          for (const PartPlan* other : neighbours.publishers(use.name)) used_[i].push_back({index.at(other), &use});
        } else if (const PartPlan* other = neighbours.find(use.kind, use.name)) {
          used_[i].push_back({index.at(other), &use});
        }
      }
    }
  }

  std::vector<std::size_t> order() && {
    for (std::size_t i = 0; i < parts_.size(); ++i) walk_from(i);
    return std::move(order_);
  }

 private:
  struct Used {
    std::size_t part;
    const PartUse* use;
  };
  struct Step {
    std::size_t part;
    std::size_t next = 0;  ///< of those that it uses
  };
  enum class State : std::uint8_t { not_seen, under_way, placed };

  void walk_from(std::size_t first) {
    if (states_[first] != State::not_seen) return;
    std::vector<Step> steps;
    const auto enter = [&](std::size_t part) {
      states_[part] = State::under_way;
      steps.push_back({part});
    };
    enter(first);
    while (!steps.empty()) {
      Step& step = steps.back();
      if (step.next == used_[step.part].size()) {
        states_[step.part] = State::placed;
        order_.push_back(step.part);
        steps.pop_back();
        continue;
      }
      const Used& used = used_[step.part][step.next++];
      if (states_[used.part] == State::under_way) report_cycle(steps, used);
      if (states_[used.part] == State::not_seen) enter(used.part);
    }
  }

  void report_cycle(const std::vector<Step>& steps, const Used& closing) {
    const PartPlan& first = parts_[closing.part];
    std::string message = "it uses itself: " + first.object();
    std::size_t i = steps.size();
    while (steps[i - 1].part != closing.part) --i;
    for (; i < steps.size(); ++i) {
      const PartUse& use = *used_[steps[i - 1].part][steps[i - 1].next - 1].use;
      message += " uses " + parts_[steps[i].part].object() + ", at " + place_of(use.item) + ", which";
    }
    message += " uses " + first.object() + ", at " + place_of(closing.use->item);
    problems_.add(closing.use->item.problem("uses-itself", std::move(message)));
  }

  const std::vector<PartPlan>& parts_;
  Problems& problems_;
  std::vector<State> states_;
  std::vector<std::vector<Used>> used_;
  std::vector<std::size_t> order_;
};

}  // namespace

void put_in_making_order(std::vector<PartPlan>& parts, const Neighbours& neighbours, Problems& problems) {
  std::vector<PartPlan> ordered;
  ordered.reserve(parts.size());
  for (const std::size_t part : MakingOrder(parts, neighbours, problems).order())
    ordered.push_back(std::move(parts[part]));
  parts = std::move(ordered);
}

}  // namespace rtdata::config_detail
