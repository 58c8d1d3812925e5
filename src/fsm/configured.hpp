/// ConfiguredMachine: a state machine from a configuration, with expressions as conditions.
///
///     {"name": "flight", "inputs": ["baro"], "max_age": "500 ms", "start": "pad",
///      "states": [{"name": "pad"}, {"name": "flying"}, {"name": "landed", "final": true}],
///      "transitions": [
///        {"from": "pad", "to": "flying", "when": "altitude > 20", "for": "300 ms"},
///        {"from": "flying", "to": "landed", "event": "touchdown"},
///        {"from": "flying", "to": "landed", "after": "20 min"}]}
///
/// It is an fsm::Machine (machine.hpp) whose transitions are tried with each event of its inputs. Names in `when` are
/// FIELD (of the first of the inputs), TOPIC.FIELD, and TOPIC for a topic with a single number, as for derived topics
/// (docs/expressions.md). A value older than `max_age` counts as missing: expressions with it wait, and a condition
/// that waits or fails is false. Conditions of the current state evaluate each event of the inputs; their memories
/// (`highest(x)`, `mean(x, 2)` ...) restart when the machine arrives in the state. Use a derived topic for memory over
/// several states.
///
/// With `resume` it continues in the last state of an earlier recorded run.
///
/// Owner: the holder. Thread: the loop's, unless stated otherwise; the main loop's thread may destroy a machine on a
/// tier, like a handle.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/config_item.hpp"
#include "rtdata/data/description.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/fsm/machine.hpp"

namespace rtdata::fsm {

/// An output value of a state, set by the program (ConfiguredMachine::on_state).
struct OutputValue {
  std::string output;
  double value = 1;

  friend constexpr auto parameters(type_tag<OutputValue>) {
    return parameter_list(
        parameter("output", &OutputValue::output, "which output", required, names_part("output")),
        parameter("value", &OutputValue::value, "the value to set; for a GPIO line 1 is on and 0 is off"));
  }
};

struct StateSettings {
  std::string name;
  bool is_final = false;
  std::vector<OutputValue> set = {};
  std::vector<std::string> arm = {};

  friend constexpr auto parameters(type_tag<StateSettings>) {
    return parameter_list(
        parameter("name", &StateSettings::name, "name of the state, at most 48 bytes", required, TextIs::name),
        parameter("set", &StateSettings::set, "values of outputs, set when the machine enters the state"),
        parameter("arm", &StateSettings::arm,
                  "outputs that can be armed in this state; an output listed in any state can be armed only in the "
                  "states that list it",
                  names_part("output")),
        parameter("final", &StateSettings::is_final, "true: by design, no transition leads out of this state"));
  }
};

struct TransitionSettings {
  std::string from;
  std::string to;
  std::string when = {};
  Duration hold{0};
  Duration after{0};
  std::string event = {};
  std::string cause = {};

  friend constexpr auto parameters(type_tag<TransitionSettings>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("from", &TransitionSettings::from, "the state that the transition leaves", required,
                  TextIs::recorded),
        parameter("to", &TransitionSettings::to, "the state that the transition enters", required, TextIs::recorded),
        parameter("when", &TransitionSettings::when, "an expression that must be true", TextIs::recorded),
        parameter("for", &TransitionSettings::hold, "`when` must have been true for this long",
                  range(Duration{0}, Duration{24h * 365})),
        parameter("after", &TransitionSettings::after, "the machine must have been in `from` for this long",
                  range(Duration{0}, Duration{24h * 365})),
        parameter("event", &TransitionSettings::event, "the transition is tried only at this named event",
                  TextIs::name),
        parameter("cause", &TransitionSettings::cause, "cause that is recorded; default: made from the settings above",
                  TextIs::recorded));
  }
};

/// How the machine resumes after a pause.
struct ResumeSettings {
  enum class UnknownAge { resume, start };
  std::string recording;                   ///< a sink, of the same loop
  Duration max_age{0};                     ///< of the pause
  UnknownAge unknown_age{};                ///< what to do if the clock cannot measure the pause
  Duration wait{std::chrono::seconds{1}};  ///< longest wait of the handler for syncing a change to disk

  friend constexpr auto parameters(type_tag<ResumeSettings>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("recording", &ResumeSettings::recording, "recording that contains the changes of the machine",
                  required, names_part("sink", "sqlite")),
        parameter("max_age", &ResumeSettings::max_age, "after a longer pause the machine begins in `start`", required,
                  range(Duration{1ms}, Duration{24h * 365})),
        parameter("unknown_age", &ResumeSettings::unknown_age,
                  "how the machine starts when the length of the pause is unknown", required,
                  choices(value("resume", UnknownAge::resume), value("start", UnknownAge::start))),
        parameter("wait", &ResumeSettings::wait,
                  "longest time that actions on a change wait until the change is on the disk",
                  range(Duration{1ms}, Duration{1min})));
  }
};

struct MachineSettings {
  std::string name;
  std::string topic = {};
  std::vector<std::string> inputs = {};
  Duration max_age = std::chrono::seconds{10};
  std::string start;
  std::vector<StateSettings> states;
  std::vector<TransitionSettings> transitions = {};
  std::optional<ResumeSettings> resume = {};

  friend constexpr auto parameters(type_tag<MachineSettings>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("name", &MachineSettings::name, "unique name; the changes of the machine are recorded under it",
                  required, TextIs::name),
        parameter("topic", &MachineSettings::topic, "topic of its changes; default: `name`", TextIs::topic),
        parameter("inputs", &MachineSettings::inputs,
                  "topics; each of their events tries the transitions, and `when` can use their fields",
                  names_part("topic")),
        parameter("max_age", &MachineSettings::max_age, "older values of inputs count as absent; 0 s: no limit",
                  range(Duration{0}, Duration{24h * 365})),
        parameter("start", &MachineSettings::start, "the state in which the machine begins", required,
                  TextIs::recorded),
        parameter("states", &MachineSettings::states, "all its states", required),
        parameter("transitions", &MachineSettings::transitions,
                  "the transitions, in the order in which they are tried"),
        parameter("resume", &MachineSettings::resume,
                  "continues in the state in which an earlier run of a recording ended"));
  }
};

/// Checks rules over several parameters: that states exist, that conditions can be read, and the faults of
/// `find_faults`.
void check_config(const MachineSettings& settings, const ConfigItem& item, Problems& problems);
/// Checks that the inputs have the fields of the conditions. `payload_of`: the description of a topic; null if unknown,
/// then its fields are not checked.
void check_machine_names(const MachineSettings& settings,
                         const std::function<const Description*(std::string_view topic)>& payload_of,
                         const ConfigItem& item, Problems& problems);
/// The states and transitions, without transitions between missing states.
Graph graph_of(const MachineSettings& settings);

class ConfiguredMachine {
 public:
  /// Where a machine begins. Empty: in `start`.
  struct Beginning {
    std::string state;
    Duration in_state{0};      ///< time already spent in the state
    std::string cause = {};    ///< why the state changed, as published: "resumed after 1.2 s"
    bool is_acted_on = false;  ///< the handler was already called for it
  };
  /// Calls `done` on the machine's loop when everything published so far is on disk.
  using Sync = std::function<void(Callback<void()> done)>;
  /// `sync`: if set, the handler (`on_state`) is called after the change is on disk. SetupError: as Machine; a mistake
  /// in the settings (bad-argument).
  ConfiguredMachine(Loop& loop, const MachineSettings& settings, const std::optional<Beginning>& beginning = {},
                    Sync sync = {});
  ConfiguredMachine(ConfiguredMachine&&) noexcept;
  ConfiguredMachine& operator=(ConfiguredMachine&&) noexcept;
  ~ConfiguredMachine();

  /// Raises a named event, which its loop processes soon. Any thread. An error: no transition uses this event.
  Result<void> raise(std::string_view event);
  struct Now {
    std::string_view state;  ///< valid as long as the machine
    MonotonicTime since{};   ///< to the microsecond
  };
  /// Any thread.
  Now now() const noexcept;
  /// True if the handler was called for the present state.
  bool is_acted_on() const noexcept;
  /// Sets the handler of states, called on the loop after each arrival. With `resume`, it is called when the change is
  /// on disk or `wait` is over; if there are more changes meanwhile, only for the last. One handler; an empty one
  /// removes it.
  void on_state(Callback<void(std::string_view state)> handler);
  MachineCounts counts() const noexcept;
  const MachineSettings& settings() const noexcept;

 private:
  struct Core;
  std::shared_ptr<Core> core_;
};

}  // namespace rtdata::fsm
