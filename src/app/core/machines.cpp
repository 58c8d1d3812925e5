#include "app/core/machines.hpp"

#include <algorithm>
#include <map>
#include <memory>
#include <set>
#include <utility>

#include "data/saturating.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/data/description.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/process/expression.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata::app {
namespace {

/// A machine with its tier.
struct PlacedMachine {
  fsm::MachineSettings own;
  config_detail::Placement placement;
  friend constexpr auto parameters(type_tag<PlacedMachine>) {
    return parameter_list(include_member(&PlacedMachine::own), include_member(&PlacedMachine::placement));
  }
  friend void check_config(const PlacedMachine& machine, const ConfigItem& item, Problems& problems) {
    check_config(machine.own, item, problems);
  }
};

bool arms(const fsm::MachineSettings& settings, const std::string& output) {
  return std::any_of(settings.states.begin(), settings.states.end(), [&](const fsm::StateSettings& state) {
    return std::find(state.arm.begin(), state.arm.end(), output) != state.arm.end();
  });
}

/// Sets outputs when states change.
class OutputSetter {
 public:
  OutputSetter(Loop& loop, const Parts& parts, const fsm::MachineSettings& settings)
      : loop_(loop), settings_(settings), by_("machine " + settings.name) {
    for (const fsm::StateSettings& state : settings.states) {
      for (const fsm::OutputValue& one : state.set) outputs_[one.output] = parts.find<Output>("output", one.output);
      for (const std::string& name : state.arm) outputs_[name] = parts.find<Output>("output", name);
    }
    std::erase_if(outputs_, [](const auto& output) { return output.second == nullptr; });  // a replay makes no outputs
  }
  bool is_needed() const { return !outputs_.empty(); }
  void arrive(std::string_view name) {
    for (const fsm::StateSettings& state : settings_.states) {
      if (state.name != name) continue;
      for (const fsm::OutputValue& one : state.set)
        if (const auto known = outputs_.find(one.output); known != outputs_.end()) set(*known->second, one);
    }
  }
  template <class Function>
  auto on_its_loop(const Function& function) const {
    if (!loop_.core().runs_elsewhere()) return function();
    std::optional<decltype(function())> result;
    loop_.core().call_there([&] { result = function(); });
    return std::move(*result);
  }
  /// A value that the machine has set, with its remaining lease.
  struct Held {
    fsm::OutputValue value;
    MonotonicTime until;
  };
  /// The values still set by the machine; not values with an expired lease or set by others.
  std::vector<Held> held() const {
    std::vector<Held> all;
    for (const fsm::OutputValue& one : set_) {
      const Output& output = *outputs_.at(one.output);
      if (output.is_armed() && output.value() == one.value)
        all.push_back({one, detail::later(loop_.now(), output.lease_left())});
    }
    return all;
  }
  /// Sets outputs safe when the machine is removed; values set by others since then stay.
  void leave_safe() {
    for (const fsm::OutputValue& one : std::exchange(set_, {})) {
      Output& output = *outputs_.at(one.output);
      const std::optional<double> value = output.value();
      const bool is_of_others = value && *value != one.value && *value != output.safe_value();
      if (!output.is_armed() || output.is_safe() || is_of_others) continue;
      const Result<void> done = output.set(output.safe_value(), by_ + ", removed");
      loop_.runtime().core().log(done ? LogLevel::warning : LogLevel::error, by_,
                                 "it is removed: output " + one.output + ", which it had set, is " +
                                     (done ? "being set to its safe value" : "not set safe: " + done.error().why));
    }
  }
  /// Sets the values of the previous machine again on outputs that a reload has restarted.
  void hold(const std::vector<Held>& before) {
    for (const auto& [one, until] : before) {
      const auto known = outputs_.find(one.output);
      if (known == outputs_.end() || until <= loop_.now()) continue;
      if (known->second->value() == one.value)
        set_.push_back(one);
      else
        set(*known->second, one);
    }
  }
  /// Arms the outputs that were armed when the machine paused.
  void arm_again(const Parts& parts, const std::string& recording, std::int64_t run) const {
    for (const PartPlan* plan : parts.plans()) {
      const auto known = plan->kind == "output" ? outputs_.find(plan->name) : outputs_.end();
      if (known == outputs_.end() || !arms(settings_, plan->name)) continue;
      const Result<bool> was = was_armed(recording, run, plan->name, plan->publishes->topic);
      if (!was)
        loop_.runtime().core().log(
            LogLevel::error, by_,
            "output " + plan->name +
                " is not armed again: the program could not read its last state: " + was.error().text());
      else if (*was)
        tell(plan->name, "armed", known->second->arm(by_ + ", resumed"));
    }
  }

 private:
  void set(Output& output, const fsm::OutputValue& one) {
    std::erase_if(set_, [&](const fsm::OutputValue& other) { return other.output == one.output; });
    const Result<void> done = output.set(one.value, by_);
    if (done) set_.push_back(one);
    tell(one.output, "set", done);
  }
  void tell(const std::string& output, const char* what, const Result<void>& done) const {
    if (!done)
      loop_.runtime().core().log(LogLevel::error, by_,
                                 "output " + output + " is not " + what + ": " + done.error().why);
  }

  Loop& loop_;
  const fsm::MachineSettings settings_;
  const std::string by_;
  std::map<std::string, Output*> outputs_;
  std::vector<fsm::OutputValue> set_;  // the last value set by the machine for each output
};

struct ActingMachine : fsm::ConfiguredMachine {
  ActingMachine(fsm::ConfiguredMachine machine, std::shared_ptr<OutputSetter> its_setter)
      : ConfiguredMachine(std::move(machine)), setter(std::move(its_setter)) {}
  std::shared_ptr<OutputSetter> setter;
};

/// The machine that is replaced.
struct MachineBefore {
  std::string state;
  MonotonicTime since;
  bool is_acted_on;
  std::vector<OutputSetter::Held> held;
};

/// The description of a change, plus each state as a name that is true in it. Null: a state has a name that expressions
/// cannot use.
std::shared_ptr<const Description> with_states(const fsm::MachineSettings& settings) {
  DescriptionBuilder builder("state_change");
  builder.field("lasted", Kind::f64, "s");
  for (const fsm::StateSettings& state : settings.states) builder.field(state.name, Kind::boolean);
  const auto described = builder.build();
  return described ? *described : nullptr;
}

/// The state in which a machine continues after a reload. Empty: the state no longer exists, which is logged.
std::optional<fsm::ConfiguredMachine::Beginning> after_reload(Loop& loop, const fsm::MachineSettings& settings,
                                                              const MachineBefore& before, MonotonicTime now) {
  const bool is_there = std::any_of(settings.states.begin(), settings.states.end(),
                                    [&](const fsm::StateSettings& state) { return state.name == before.state; });
  if (is_there)
    return fsm::ConfiguredMachine::Beginning{before.state, now - before.since, "reloaded", before.is_acted_on};
  loop.runtime().core().log(
      LogLevel::warning, "machine " + settings.name,
      "it was in " + before.state + ", which is no longer a state of it: it begins in " + settings.start);
  return std::nullopt;
}

PartObject make(Loop& loop, const Parts& parts, const fsm::MachineSettings& settings,
                const std::optional<MachineBefore>& before) {
  std::optional<fsm::ConfiguredMachine::Beginning> beginning;
  if (before) beginning = after_reload(loop, settings, *before, loop.now());
  fsm::ConfiguredMachine::Sync sync;
  const auto setter = std::make_shared<OutputSetter>(loop, parts, settings);
#ifdef RTDATA_WITH_SQLITE
  if (settings.resume) {
    std::string path;
    for (const PartPlan* plan : parts.plans())
      if (plan->kind == "sink" && plan->name == settings.resume->recording) path = plan->stores->path;
    if (const auto last = before ? std::nullopt : resumed(loop, settings, path)) {
      beginning = last->beginning;
      // If a reload adds the machine again, the outputs do not change.
      if (!loop.runtime().core().main().has_recorded(last->run.uuid)) setter->arm_again(parts, path, last->run.run);
    }
    Sink& sink = parts.get<Sink>("sink", settings.resume->recording);
    sync = [&sink](Callback<void()> done) { sink.sync(std::move(done)); };
  }
#endif
  const bool is_at_once = !sync;
  if (before) setter->hold(before->held);
  PartObject made = PartObject::made_by<fsm::ConfiguredMachine>(
      [&] { return ActingMachine(fsm::ConfiguredMachine(loop, settings, beginning, std::move(sync)), setter); });
  if (setter->is_needed()) {
    auto& machine = *made.as<fsm::ConfiguredMachine>();
    machine.on_state([setter](std::string_view state) { setter->arrive(state); });
    const bool is_known = beginning && beginning->is_acted_on && machine.counts().transitions == 0;
    if (is_at_once && !is_known) setter->arrive(machine.now().state);
  }
  return made;
}

/// Reserves the outputs: only one machine may set an output. The comparison of parts checks that the output follows no
/// topic and is on the same loop.
void take_outputs(PartPlan& plan, const fsm::MachineSettings& settings) {
  std::set<std::string> taken;
  for (const fsm::StateSettings& state : settings.states)
    for (const fsm::OutputValue& one : state.set)
      if (taken.insert(one.output).second)
        plan.more_places.push_back({"output", one.output, "one machine sets an output", "", ""});
}

}  // namespace

void add_machines(Registry& registry) {
  registry.add_part<PlacedMachine>(
      "machine", "machine", "a state machine, with expressions as conditions",
      [](PartPlan& plan, const PlacedMachine& config) {
        const fsm::MachineSettings& settings = config.own;
        plan.name = settings.name;
        plan.publishes = PublishedTopic{settings.topic.empty() ? settings.name : settings.topic,
                                        description_of<fsm::StateChange>(),
                                        std::nullopt,
                                        {},
                                        with_states(settings)};
        take_outputs(plan, settings);
        if (settings.resume) plan.stored_by = settings.resume->recording;
        plan.check_topics = [settings](const PartPlan& part, const PartPlan::PayloadOf& payload_of,
                                       Problems& problems) {
          check_machine_names(settings, payload_of, part.item, problems);
        };
        plan.make = [settings](Loop& loop, const Parts& parts) { return make(loop, parts, settings, std::nullopt); };
        plan.on_removal = [](const PartObject& object) {
          const auto* const machine = object.as<ActingMachine>();
          if (machine == nullptr) return;
          machine->setter->on_its_loop([&] {
            machine->setter->leave_safe();
            return true;
          });
        };
        plan.make_again = [settings](const PartObject& object) -> PartPlan::Make {
          const auto* const machine = object.as<ActingMachine>();
          if (machine == nullptr) return {};
          return [settings, before = machine->setter->on_its_loop([&] {
            const fsm::ConfiguredMachine::Now now = machine->now();
            return MachineBefore{std::string(now.state), now.since, machine->is_acted_on(), machine->setter->held()};
          })](Loop& loop, const Parts& parts) { return make(loop, parts, settings, before); };
        };
      });
}

std::optional<NotArmedIn> refuses_arming(const Parts& parts, const std::string& output) {
  for (const std::string& name : parts.names("machine")) {
    const auto* const machine = parts.find<fsm::ConfiguredMachine>("machine", name);
    if (machine == nullptr) continue;
    const std::string now(machine->now().state);
    std::string states;
    bool is_possible = false;
    for (const fsm::StateSettings& state : machine->settings().states) {
      if (std::find(state.arm.begin(), state.arm.end(), output) == state.arm.end()) continue;
      states += (states.empty() ? "" : ", ") + state.name;
      is_possible = is_possible || state.name == now;
    }
    if (!states.empty() && !is_possible) return NotArmedIn{name, now, states};
  }
  return std::nullopt;
}

std::vector<ArmsAgain> who_arms_again(const Parts& parts, const std::string& output) {
  const auto named = [&](std::string_view kind, std::string_view name) -> const PartPlan* {
    for (const PartPlan* plan : parts.plans())
      if (plan->kind == kind && plan->name == name) return plan;
    return nullptr;
  };
  std::vector<ArmsAgain> all;
  const PartPlan* const plan = named("output", output);
  for (const std::string& name : parts.names("machine")) {
    const auto* const machine = parts.find<fsm::ConfiguredMachine>("machine", name);
    if (plan == nullptr || machine == nullptr) continue;
    const fsm::MachineSettings& settings = machine->settings();
    if (!settings.resume || !arms(settings, output)) continue;
    const PartPlan* const recording = named("sink", settings.resume->recording);
    if (recording != nullptr && recording->stores->wants(plan->publishes->topic))
      all.push_back({name, recording, plan->publishes->topic});
  }
  return all;
}

}  // namespace rtdata::app
