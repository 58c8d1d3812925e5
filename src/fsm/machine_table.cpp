#include "fsm/machine_table.hpp"

#include <utility>

#include "data/nearest.hpp"

namespace rtdata::fsm::detail {
namespace {

std::string cause_of(const Transition& transition) {
  if (!transition.cause.empty()) return transition.cause;
  std::string cause = transition.on;
  const auto add = [&](const std::string& more) { cause += (cause.empty() ? "" : ", ") + more; };
  if (transition.when) add("a condition");
  if (transition.hold > Duration{0}) add("for " + to_string(transition.hold));
  if (transition.after > Duration{0}) add("after " + to_string(transition.after));
  return cause;
}

}  // namespace

void MachineTable::add_state(std::string name, std::unique_ptr<State> code, bool is_final, bool has_check) {
  check_name(name, "state");
  if (code == nullptr) refuse(Errc::bad_argument, "cannot add state", name, "there is no state", "give it one");
  if (find(name) != nullptr) {
    refuse(Errc::bad_name, "cannot add state", name, "a state with this name already exists",
           "remove it first, or give it another name");
  }
  states_.push_back(std::make_unique<StateEntry>(StateEntry{std::move(name), std::move(code), is_final, has_check}));
}

void MachineTable::remove_state(StateEntry& state) {
  for (const auto& other : states_)
    for (const auto& way : other->ways)
      if (&way->to == &state) way->is_removed = true;
  const auto found = std::find_if(states_.begin(), states_.end(), [&](const auto& e) { return e.get() == &state; });
  has_removed_ = true;
  removed_.push_back(std::move(*found));
  states_.erase(found);
}

StateEntry& MachineTable::add_transition(Transition transition) {
  StateEntry& from = entry(transition.from, "cannot add a transition from");
  StateEntry& to = entry(transition.to, "cannot add a transition to");
  const std::string name = transition.from + " to " + transition.to;
  if (transition.hold > Duration{0} && !transition.when)
    refuse(Errc::bad_argument, "cannot add transition", name, "`hold` without a condition",
           "give `when`, or use `after`");
  if (transition.hold < Duration{0} || transition.after < Duration{0})
    refuse(Errc::bad_argument, "cannot add transition", name, "a time is negative", "give 0 or more");
  if (transition.hold > Duration{0} && !transition.on.empty()) {
    refuse(Errc::bad_argument, "cannot add transition", name,
           "`hold` with `on`: with a named event the condition is tried only once", "remove one of them");
  }
  std::uint16_t on = any_event;
  if (!transition.on.empty()) {
    check_name(transition.on, "event");
    on = event_number(transition.on);
    if (on == any_event) {
      if (events_.size() >= no_event)
        refuse(Errc::bad_argument, "cannot add transition", name, "there are too many events", "use fewer");
      events_.push_back(transition.on);
      on = static_cast<std::uint16_t>(events_.size() - 1);
    }
  }
  std::string cause = cause_of(transition);
  from.ways.push_back(std::make_unique<TransitionEntry>(TransitionEntry{.on = on,
                                                                        .to = to,
                                                                        .when = std::move(transition.when),
                                                                        .after = transition.after,
                                                                        .hold = transition.hold,
                                                                        .cause = std::move(cause)}));
  return from;
}

std::size_t MachineTable::remove_transitions(std::string_view from, std::string_view to) {
  StateEntry& source = entry(from, "cannot remove transitions from");
  const StateEntry& target = entry(to, "cannot remove transitions to");
  std::size_t count = 0;
  for (const auto& way : source.ways) {
    if (&way->to != &target || way->is_removed) continue;
    has_removed_ = true;
    way->is_removed = true;
    ++count;
  }
  return count;
}

void MachineTable::tidy() {
  has_removed_ = false;
  for (const auto& state : states_)
    state->ways.erase(
        std::remove_if(state->ways.begin(), state->ways.end(), [](const auto& way) { return way->is_removed; }),
        state->ways.end());
  removed_.clear();
}

void MachineTable::clear() noexcept {
  states_.clear();
  removed_.clear();
}

StateEntry* MachineTable::find(std::string_view name) const noexcept {
  const auto found = std::find_if(states_.begin(), states_.end(), [&](const auto& e) { return e->name == name; });
  return found == states_.end() ? nullptr : found->get();
}
StateEntry& MachineTable::entry(std::string_view name, const char* what) const {
  if (StateEntry* const found = find(name)) return *found;
  std::vector<std::string_view> names;
  for (const auto& state : states_) names.push_back(state->name);
  refuse(Errc::not_found, what, "state " + std::string(name), "there is no state with this name",
         rtdata::detail::suggestion(name, names));
}

Graph MachineTable::graph(const std::string& machine, const std::string& start) const {
  Graph graph;
  graph.name = machine;
  const auto index = [&](const StateEntry& state) {
    return static_cast<std::size_t>(
        std::find_if(states_.begin(), states_.end(), [&](const auto& e) { return e.get() == &state; }) -
        states_.begin());
  };
  for (const auto& state : states_) {
    if (state->name == start) graph.start = graph.states.size();
    graph.states.push_back({state->name, state->is_final});
  }
  for (const auto& state : states_) {
    for (const auto& way : state->ways) {
      if (way->is_removed) continue;
      graph.edges.push_back({index(*state), index(way->to), way->cause, way->on == any_event ? "" : events_[way->on],
                             !way->when && !way->to.has_check, way->after});
    }
  }
  return graph;
}

void MachineTable::refuse(Errc code, const char* what, std::string_view of, std::string why, std::string advice) const {
  throw SetupError({code, what, object_ + ", " + std::string(of), std::move(why), std::move(advice)});
}

void MachineTable::check_name(const std::string& name, const char* what) const {
  if (name.empty()) refuse(Errc::bad_name, "cannot add", what, "its name is empty", "give it one");
  if (name.size() > max_name) {
    refuse(Errc::bad_name, "cannot add", what + (" " + name),
           "its name is longer than " + std::to_string(max_name) + " bytes", "give it a shorter one");
  }
}

}  // namespace rtdata::fsm::detail
