// The settings of a machine in a configuration: checks, and the graph.
#include <algorithm>
#include <utility>

#include "data/setting_mistake.hpp"
#include "fsm/configured.hpp"
#include "process/expression_fields.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::fsm {
namespace {

using rtdata::detail::item_of;

const ConfigItem& element_of(const ConfigItem& item, const std::string& list, std::size_t index) {
  return item_of(item, list + "[" + std::to_string(index) + "]");
}

/// Of a text without mistakes.
bool is_a_condition(const std::string& when) {
  return Expression(when, rtdata::detail::names_of({when})).is_condition();
}
/// The name, if it is the whole text (a flag). Empty: the text has more.
std::optional<std::string> flag_named(const std::string& when) {
  const std::vector<std::string> names = rtdata::detail::names_of({when});
  if (names.size() != 1 || Expression::normal_name(names[0]) != Expression::normal_name(when)) return {};
  return names[0];
}

/// Checks one machine; a step runs only if the earlier ones found no mistake that it depends on.
class Checker {
 public:
  Checker(const MachineSettings& settings, const ConfigItem& item, Problems& problems)
      : settings_(settings), item_(item), problems_(problems) {}

  void check() {
    check_inputs();
    const std::size_t before = problems_.size();
    check_states();
    for (std::size_t i = 0; i < settings_.transitions.size(); ++i) check_transition(i);
    if (problems_.size() == before) check_graph();
  }

 private:
  void add(const ConfigItem& at, std::string id, std::string why, std::string suggestion = {}) {
    problems_.add(at.problem(std::move(id), std::move(why), std::move(suggestion)));
  }
  void check_inputs() {
    const auto& inputs = settings_.inputs;
    for (std::size_t i = 0; i < inputs.size(); ++i) {
      if (!is_topic_name(inputs[i])) {
        add(element_of(item_, "inputs", i), "bad-value", "\"" + inputs[i] + "\" is not a topic");
      } else if (std::find(inputs.begin(), inputs.begin() + std::ptrdiff_t(i), inputs[i]) !=
                 inputs.begin() + std::ptrdiff_t(i)) {
        add(element_of(item_, "inputs", i), "bad-value", "the topic \"" + inputs[i] + "\" is listed twice");
      }
    }
  }
  void check_states() {
    if (settings_.states.empty())
      return add(item_of(item_, "states"), "bad-value", "a machine needs at least one state");
    for (std::size_t i = 0; i < settings_.states.size(); ++i) {
      const std::string& name = settings_.states[i].name;
      const ConfigItem& at = item_of(element_of(item_, "states", i), "name");
      if (name.size() > max_name)
        add(at, "bad-name", "the name of a state can have at most " + std::to_string(max_name) + " bytes");
      if (const std::string why = why_no_name(name); !why.empty()) add(at, "bad-name", why);
      if (std::find(names_.begin(), names_.end(), name) != names_.end())
        add(at, "duplicate-name", "there is already a state \"" + name + "\"");
      names_.push_back(name);
    }
    check_known(settings_.start, item_of(item_, "start"));
  }
  /// Why expressions cannot use the state's name: it would mean another value.
  std::string why_no_name(const std::string& state) const {
    const std::string topic = Expression::normal_name(settings_.topic.empty() ? settings_.name : settings_.topic);
    if (state.find('/') != std::string::npos)
      return "the name of a state cannot contain `/`: expressions read it as `.`";
    if (state == "lasted")
      return "`lasted` is a field of the machine's changes: expressions could not refer to the state";
    if (state == topic || state.starts_with(topic + "."))
      return "`" + topic + "` is the machine's topic: expressions could not refer to the state";
    return "";
  }
  void check_known(const std::string& state, const ConfigItem& at) {
    if (std::find(names_.begin(), names_.end(), state) == names_.end())
      add(at, "unknown-state", "there is no state \"" + state + "\" in `states`", nearest_name(state, names_));
  }
  void check_transition(std::size_t index) {
    const TransitionSettings& transition = settings_.transitions[index];
    const ConfigItem& at = element_of(item_, "transitions", index);
    if (!names_.empty()) {
      check_known(transition.from, item_of(at, "from"));
      check_known(transition.to, item_of(at, "to"));
    }
    if (transition.event.size() > max_name) {
      add(item_of(at, "event"), "bad-name",
          "the name of an event can have at most " + std::to_string(max_name) + " bytes");
    }
    if (transition.hold > Duration{0} && transition.when.empty())
      add(item_of(at, "for"), "bad-value",
          "`for` needs a `when`, which must be true for this long: add `when`, or use `after`");
    if (transition.hold > Duration{0} && !transition.event.empty()) {
      add(item_of(at, "for"), "bad-value",
          "with `event`, the condition is tried only once, when the event comes: remove `for` or `event`");
    }
    if (!transition.when.empty()) return check_condition(transition, item_of(at, "when"));
    if (settings_.inputs.empty() && transition.event.empty() && transition.after == Duration{0})
      add(at, "bad-value",
          "this transition can never be taken, because the machine has no `inputs`: add `event` or `after`");
  }
  void check_condition(const TransitionSettings& transition, const ConfigItem& at) {
    const std::size_t before = problems_.size();
    rtdata::detail::check_expression(transition.when, at, problems_);
    if (problems_.size() != before) return;
    const std::vector<std::string> names = rtdata::detail::names_of({transition.when});
    if (settings_.inputs.empty() && !names.empty())
      return add(at, "bad-value", "the machine has no `inputs` that could contain `" + names[0] + "`");
    // Without names and functions the condition is constant.
    if (names.empty() && transition.when.find('(') == std::string::npos &&
        !Expression(transition.when, names).evaluate(Time{}).is_true())
      return add(at, "bad-value", "this condition is never true");
    if (!is_a_condition(transition.when) && !flag_named(transition.when))
      add(at, "bad-value", "it is a number, not a condition: compare it with something");
  }
  void check_graph() {
    for (const GraphFault& fault : find_faults(graph_of(settings_))) {
      const bool is_of_state = fault.state != Graph::none;
      if (fault.edge == Graph::none && !is_of_state) continue;  // no start: already reported
      const ConfigItem& at = is_of_state ? item_of(element_of(item_, "states", fault.state), "name")
                                         : element_of(item_, "transitions", fault.edge);
      add(at, is_of_state ? "bad-state" : "bad-transition", fault.text);
    }
  }

  const MachineSettings& settings_;
  const ConfigItem& item_;
  Problems& problems_;
  std::vector<std::string> names_;
};

/// "altitude > 20, for 300 ms"
std::string cause_of(const TransitionSettings& transition) {
  if (!transition.cause.empty()) return transition.cause;
  std::string cause = transition.event;
  const auto add = [&](const std::string& more) { cause += (cause.empty() ? "" : ", ") + more; };
  if (!transition.when.empty()) add(transition.when);
  if (transition.hold > Duration{0}) add("for " + to_string(transition.hold));
  if (transition.after > Duration{0}) add("after " + to_string(transition.after));
  return cause;
}

}  // namespace

void check_config(const MachineSettings& settings, const ConfigItem& item, Problems& problems) {
  Checker(settings, item, problems).check();
}

void check_machine_names(const MachineSettings& settings,
                         const std::function<const Description*(std::string_view topic)>& payload_of,
                         const ConfigItem& item, Problems& problems) {
  for (std::size_t i = 0; i < settings.transitions.size(); ++i) {
    const std::string& when = settings.transitions[i].when;
    if (when.empty()) continue;
    const ConfigItem& at = item_of(element_of(item, "transitions", i), "when");
    rtdata::detail::check_field_names(when, settings.inputs, payload_of, at, problems);
    const std::optional<std::string> flag = flag_named(when);
    if (!flag || is_a_condition(when)) continue;
    const rtdata::detail::FieldName field = rtdata::detail::field_named(settings.inputs, *flag);
    const Description* const payload = payload_of(settings.inputs[field.topic]);
    const Leaf* const leaf = payload != nullptr ? rtdata::detail::leaf_named(*payload, field, *flag) : nullptr;
    if (leaf != nullptr && leaf->kind != Kind::boolean)
      problems.add(at.problem("bad-value", "it is a number, not a condition: compare it with something"));
  }
}

Graph graph_of(const MachineSettings& settings) {
  Graph graph;
  graph.name = settings.name;
  const auto index = [&](const std::string& name) {
    const auto found = std::find_if(settings.states.begin(), settings.states.end(),
                                    [&](const StateSettings& state) { return state.name == name; });
    return found != settings.states.end() ? static_cast<std::size_t>(found - settings.states.begin()) : Graph::none;
  };
  graph.start = index(settings.start);
  for (const StateSettings& state : settings.states) graph.states.push_back({state.name, state.is_final});
  for (const TransitionSettings& transition : settings.transitions) {
    const std::size_t from = index(transition.from), to = index(transition.to);
    if (from == Graph::none || to == Graph::none) continue;
    graph.edges.push_back(
        {from, to, cause_of(transition), transition.event, transition.when.empty(), transition.after});
  }
  return graph;
}

}  // namespace rtdata::fsm
