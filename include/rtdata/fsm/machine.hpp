/// Machine: a state machine on a loop, whose changes are events of a topic.
///
///     rtdata::fsm::Machine flight(loop, {.name = "flight", .start = "pad"});
///     rtdata::fsm::Input<Altitude> altitude(flight, "altitude", 500ms);        // the latest event, for half a second
///     flight.add_state("pad");
///     flight.add_state("boost", {.arrive = [&] { beeper.stop(); }});
///     flight.add_state("landed", {.is_final = true});
///     flight.add_transition({.from = "pad", .to = "boost", .when = [&] { return altitude && altitude->metres > 20; },
///                            .hold = 100ms});
///     flight.add_transition({.from = "boost", .to = "landed", .on = "touchdown"});
///     flight.start();
///     flight.raise("touchdown");
///
/// From `start` until it is closed the machine is in exactly one state. It reacts to the events of its inputs, to named
/// events (`raise`), and to time. At each event it tries the transitions out of the current state in the order in which
/// they were added, and takes the first whose conditions are true; it does not try the others. So each event causes at
/// most one change. A change runs `leave` of the old state, then `arrive` of the new one. An event that is raised
/// meanwhile, or in a condition, waits until the change is complete.
///
/// An exception from an action or a condition is reported with its name and counted. A condition that throws counts as
/// false. If `leave` throws, the change continues; if `arrive` throws, the machine is in the new state. With
/// `Config::failure` the machine then goes to that state: instead of to the new state if `leave` threw, or from the new
/// state if `arrive` threw. An exception in the failure state itself changes nothing more.
///
/// States and transitions may be added and removed at any time, also in actions and conditions; a state that the
/// machine is in, or is going to, or goes to after failures, cannot be removed.
///
/// Nothing is allocated while events are handled and states change. When the loop drains, the machine stands still.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's. Errors: SetupError (bad-argument, bad-name,
/// not-found, busy). Calls on a closed machine do nothing.
#pragma once

#include <concepts>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/text.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/loop/callback.hpp"
#include "rtdata/loop/handle.hpp"
#include "rtdata/loop/loop.hpp"

namespace rtdata::fsm {

/// The states and transitions of a machine as data, for checks and drawings.
///
///     const fsm::Graph graph = machine.graph();
///     for (const fsm::GraphFault& fault : fsm::find_faults(graph)) print(fault.text);
///     print(fsm::mermaid(graph));
struct Graph {
  static constexpr std::size_t none = static_cast<std::size_t>(-1);
  struct Node {
    std::string name;
    bool is_final = false;  ///< no transition may leave it
  };
  struct Edge {
    std::size_t from = 0;  ///< index in `states`
    std::size_t to = 0;
    std::string label = {};         ///< "burnout", "altitude > 5, for 300 ms"
    std::string on = {};            ///< the event that it waits for; empty: any
    bool is_unconditional = false;  ///< always taken when tried; later ones on the same event never are
    Duration after{0};              ///< the time in the state before which it is not tried
  };
  std::string name;  ///< of the machine
  std::vector<Node> states;
  std::vector<Edge> edges;   ///< of each state in the order in which they are tried
  std::size_t start = none;  ///< index in `states`
};

/// A mistake, and its state or transition.
struct GraphFault {
  enum class Kind {
    no_start,     ///< there is no start state
    unreachable,  ///< no way leads to the state from the start
    dead_end,     ///< nothing leads out of the state, and it is not final
    left_final,   ///< a final state with a transition out of it
    duplicate,    ///< two transitions that are the same
    never_taken,  ///< another one is always taken before it
  };
  Kind kind;
  std::size_t state = Graph::none;  ///< index in `states`
  std::size_t edge = Graph::none;   ///< index in `edges`
  std::string text;                 ///< "nothing leads to state `boost`"
};

/// In the order of the states, then of the transitions.
std::vector<GraphFault> find_faults(const Graph& graph);

/// A state diagram as Mermaid reads it (GitHub and GitLab show it in a ```mermaid block).
std::string mermaid(const Graph& graph);
/// As Graphviz reads it: `dot -Tsvg`.
std::string dot(const Graph& graph);

inline constexpr std::size_t max_name = 48;    ///< bytes of a state's or an event's name
inline constexpr std::size_t max_cause = 120;  ///< bytes of a cause; a longer one is cut in the events of the machine

/// What a machine publishes with each change. The first has no `from`.
struct StateChange {
  text<max_name> from;
  text<max_name> to;
  text<max_cause> cause;  ///< the transition's, "start", or "failure of leave" and "failure of arrive"
  double lasted = 0;      ///< how long the machine was in `from`
  friend constexpr auto describe(type_tag<StateChange>) {
    return record("state_change", field("from", &StateChange::from), field("to", &StateChange::to),
                  field("cause", &StateChange::cause), field("lasted", &StateChange::lasted, "s"))
        .of_changes();
  }
};

/// When an action or a condition is called.
struct Moment {
  Time time{};               ///< of the event; for timed changes, the loop's time after the last event
  std::string_view state;    ///< the current state; in `leave` the old one
  Duration in_state{0};      ///< for how long
  std::string_view event{};  ///< the named event; empty: none
};

/// A function with or without a Moment.
class Action : public Callback<void(const Moment&)> {
 public:
  Action() noexcept = default;
  template <class F>
  requires(!std::is_base_of_v<Action, std::remove_cvref_t<F>> && std::invocable<std::decay_t<F>&, const Moment&>)
      Action(F&& function)
      : Callback(std::forward<F>(function)) {}
  template <class F>
  requires(!std::is_base_of_v<Action, std::remove_cvref_t<F>> && std::invocable<std::decay_t<F>&>) Action(F&& function)
      : Callback([f = std::forward<F>(function)](const Moment&) mutable { f(); }) {}
};
class Condition : public Callback<bool(const Moment&)> {
 public:
  Condition() noexcept = default;
  template <class F>
  requires(!std::is_base_of_v<Condition, std::remove_cvref_t<F>> &&
           std::is_invocable_r_v<bool, std::decay_t<F>&, const Moment&>) Condition(F&& function)
      : Callback(std::forward<F>(function)) {}
  template <class F>
  requires(!std::is_base_of_v<Condition, std::remove_cvref_t<F>> && std::is_invocable_r_v<bool, std::decay_t<F>&>)
      Condition(F&& function)
      : Callback([f = std::forward<F>(function)](const Moment&) mutable { return bool(f()); }) {}
};

/// A state as a class. Owner: the machine.
class State {
 public:
  virtual ~State() = default;
  virtual void arrive(const Moment&) {}
  virtual void leave(const Moment&) {}
  /// Returns true if the machine may go to this state now; called after all other conditions were true.
  virtual bool check(const Moment&) { return true; }
};

/// A state made of functions.
struct StateConfig {
  Action arrive = {};
  Action leave = {};
  Condition check = {};   ///< as State::check
  bool is_final = false;  ///< no transition may leave it
};

/// A transition from one state to another. All conditions that are set must be true. Without any condition, the next
/// event takes it.
struct Transition {
  std::string from;
  std::string to;
  /// The named event at which it is tried. Empty: it is tried with every event of an input and after `after`, but not
  /// with named events.
  std::string on = {};
  Condition when = {};
  /// `when` must have been true for this long: at one event, at each later event, and at an event that comes at least
  /// this much later. If an input becomes stale in between, the time starts again. Only events start and end it, not
  /// passing time and not `look`.
  Duration hold{0};
  /// The machine must have been in `from` this long; then it is tried.
  Duration after{0};
  std::string cause = {};  ///< in StateChange and drawings; default: made of the above
};

struct MachineCounts {
  std::uint64_t events = 0;       ///< events that were handled: of inputs, named ones, and of time
  std::uint64_t transitions = 0;  ///< without the start
  std::uint64_t ignored = 0;      ///< named events that no transition of the state waited for
  std::uint64_t dropped = 0;      ///< named events raised while `Machine::max_waiting` were waiting
  std::uint64_t failures = 0;     ///< actions and conditions that threw
};

class Machine;
namespace detail {
/// Takes an event of an input, during its delivery.
void input_event(rtdata::detail::Node& machine, Time time, MonotonicTime came);
/// Restarts the hold time of a transition out of the current state. `way`: its index, in the order in which the
/// transitions were added.
void restart_hold(rtdata::detail::Node& machine, std::size_t way);
/// SetupError (closed).
rtdata::detail::Node& node_of_open(const Machine& machine, std::string_view input);
/// Registers an input topic: recordings of the machine's changes also store the account of that topic.
void is_made_of(rtdata::detail::Node& machine, std::string_view topic);
Loop& loop_of(rtdata::detail::Node& machine);
MonotonicTime now_of(rtdata::detail::Node& machine);
const std::string& name_of(rtdata::detail::Node& machine);

/// When the events of an input came.
struct InputTimes {
  InputTimes(rtdata::detail::Node& of, Duration age) : machine(of), max_age(age) { machine.retain(); }
  InputTimes(const InputTimes&) = delete;
  InputTimes& operator=(const InputTimes&) = delete;
  ~InputTimes() { machine.release(); }
  bool is_fresh() const {
    return time && machine.is_open() && (max_age == Duration::max() || now_of(machine) - came <= max_age);
  }
  Duration age() const { return time && machine.is_open() ? now_of(machine) - came : Duration::max(); }
  rtdata::detail::Node& machine;
  const Duration max_age;
  std::optional<Time> time{};  // of the last event; none: nothing came yet
  MonotonicTime came{};
};
/// Notes when the event came, and passes it to the machine, which is open. What the machine does may destroy the input.
void input_event(InputTimes& input, Time time);
}  // namespace detail

class Machine : public Handle {
 public:
  static constexpr std::size_t max_waiting = 256;  ///< events that may wait for the end of a change
  struct Config {
    std::string name;          ///< unique in the runtime; the origin of its events
    std::string topic = {};    ///< default: as the name
    std::string start;         ///< the state in which it begins
    std::string failure = {};  ///< the state to go to when an action throws; empty: none
  };

  Machine() noexcept = default;
  Machine(Loop& loop, Config config);

  void add_state(std::string name, StateConfig config = {});
  void add_state(std::string name, std::unique_ptr<State> state, bool is_final = false);
  /// With the transitions to and from it. SetupError: the machine is in it, or on the way to it (busy).
  void remove_state(std::string_view name);
  void add_transition(Transition transition);
  /// Removes all transitions from one state to another. Returns their number.
  std::size_t remove_transitions(std::string_view from, std::string_view to);

  /// Goes to the start state, or to the given one, and runs its `arrive`. SetupError (not-found) if there is no such
  /// state. Does nothing if the machine was started before.
  void start();
  /// `in_state`: the time already spent in the state, for a machine that continues an earlier one.
  void start_in(std::string_view state, std::string_view cause = "start", Duration in_state = Duration{0});
  /// Raises a named event. Before the start it is ignored and counted as ignored. An event that no transition uses is
  /// reported.
  void raise(std::string_view event);
  /// Tries the transitions without an event, for example after a change of something other than an input.
  void look();

  /// Valid until the next change. Empty: not started, or closed.
  std::string_view state() const noexcept;
  Duration in_state() const;
  bool is_started() const noexcept { return !state().empty(); }
  MachineCounts counts() const noexcept;
  /// Its states and transitions as they are now.
  Graph graph() const;

 private:
  friend rtdata::detail::Node& detail::node_of_open(const Machine& machine, std::string_view input);
};

/// The latest event of a topic, and one that makes the machine try its transitions. It may be closed before its machine
/// or after it.
template <class T>
class Input {
 public:
  Input() noexcept = default;
  /// `max_age`: an older event counts as missing. The topic: a name, not a pattern.
  Input(Machine& machine, std::string_view topic, Duration max_age = Duration::max())
      : latest_(new Latest(detail::node_of_open(machine, topic), max_age)) {
    Latest* const latest = latest_.get();
    Loop& loop = detail::loop_of(latest->machine);
    latest->subscription = loop.topic<T>(topic).subscribe(loop,
                                                          [latest](const Event<T>& event) { latest->take(event); });
    latest->subscription.set_name("machine " + detail::name_of(latest->machine));
    detail::is_made_of(latest->machine, topic);
  }

  /// True if there is an event that is not too old.
  explicit operator bool() const { return latest_ != nullptr && latest_->is_fresh(); }
  /// The last value, whatever its age; zeros before the first event.
  const T& operator*() const noexcept { return latest_->value; }
  const T* operator->() const noexcept { return &latest_->value; }
  /// Since the last event came. Duration::max(): none did.
  Duration age() const { return latest_ != nullptr ? latest_->age() : Duration::max(); }
  /// Of the last event.
  std::optional<Time> time() const noexcept { return latest_ != nullptr ? latest_->time : std::nullopt; }

 private:
  struct Latest : detail::InputTimes {
    using InputTimes::InputTimes;
    void take(const Event<T>& event) {
      if (!machine.is_open()) return;
      value = *event;
      detail::input_event(*this, event.time);
    }
    T value{};
    Subscription subscription;
  };
  std::unique_ptr<Latest> latest_;
};

}  // namespace rtdata::fsm
