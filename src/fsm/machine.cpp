#include "rtdata/fsm/machine.hpp"

#include <algorithm>
#include <array>
#include <vector>

#include "data/nearest.hpp"
#include "fsm/machine_table.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/events/made_of.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata::fsm {
namespace {

using detail::any_event;
using detail::MachineTable;
using detail::no_event;
using detail::StateEntry;
using detail::TransitionEntry;
using rtdata::detail::LoopCore;
using rtdata::detail::Node;

constexpr const char* not_standard = "an exception that is not a std::exception";

class StateOfFunctions final : public State {
 public:
  explicit StateOfFunctions(StateConfig config) : config_(std::move(config)) {}
  void arrive(const Moment& moment) override {
    if (config_.arrive) config_.arrive(moment);
  }
  void leave(const Moment& moment) override {
    if (config_.leave) config_.leave(moment);
  }
  bool check(const Moment& moment) override { return !config_.check || config_.check(moment); }

 private:
  StateConfig config_;
};

/// Cuts the text to fit, without a broken character at its end.
text<max_cause> cut(std::string_view cause) {
  if (cause.size() > max_cause) {
    std::size_t end = max_cause;
    while (end > 0 && (static_cast<unsigned char>(cause[end]) & 0xc0) == 0x80) --end;
    cause = cause.substr(0, end);
  }
  return text<max_cause>(cause);
}

}  // namespace

class MachineNode final : public Node {
 public:
  MachineNode(Loop& loop, Machine::Config config)
      : Node(loop.core()),
        config_(std::move(config)),
        feed_(loop, {.name = config_.name, .topic = config_.topic}),
        time_(loop, {.name = object()}, [this] { time_passed(); }),
        go_on_(loop, {.name = object()}, [this] { take_waiting(); }),
        table_(config_.name) {
    feed_.set_numbered();  // it numbers its own events
  }

  // Its table
  void add_state(std::string name, std::unique_ptr<State> code, bool is_final, bool has_check) {
    check_use("cannot add a state");
    table_.add_state(std::move(name), std::move(code), is_final, has_check);
  }
  void remove_state(std::string_view name) {
    check_use("cannot remove a state");
    StateEntry& state = table_.entry(name, "cannot remove state");
    if (&state == current_ || &state == going_to_)
      table_.refuse(Errc::busy, "cannot remove state", state.name, "the machine is in it", "leave it first");
    if (state.name == config_.failure && current_ != nullptr) {
      table_.refuse(Errc::busy, "cannot remove state", state.name, "the machine goes to it when an action throws",
                    "keep it");
    }
    table_.remove_state(state);
    tidy();
  }
  void add_transition(Transition transition) {
    check_use("cannot add a transition");
    const StateEntry& from = table_.add_transition(std::move(transition));
    if (&from == current_ && going_to_ == nullptr) arm();
  }
  std::size_t remove_transitions(std::string_view from, std::string_view to) {
    check_use("cannot remove transitions");
    const std::size_t count = table_.remove_transitions(from, to);
    tidy();
    return count;
  }

  // Its life
  void start(std::string_view name, std::string_view cause, Duration in_state) {
    check_use("cannot start");
    if (current_ != nullptr || going_to_ != nullptr) return;
    StateEntry& state = table_.entry(name.empty() ? std::string_view(config_.start) : name, "cannot start in");
    if (!config_.failure.empty()) (void)table_.entry(config_.failure, "cannot use as the state after failures");
    const rtdata::detail::Call call(*this);
    const LoopCore::Calling calling(loop()->runtime);
    is_busy_ = true;
    go(state, cause, loop()->face.time(), in_state);
    ended();
    take_waiting();
  }
  void raise(std::string_view name) {
    check_use("cannot raise an event");
    const std::uint16_t number = table_.event_number(name);
    if (number == any_event) return unknown(name);
    take_now(number);
  }
  void look() {
    check_use("cannot look");
    take_now(no_event);
  }
  void is_made_of(std::string_view topic) {
    rtdata::detail::OriginCore* const origin = feed_ ? loop()->runtime.find_origin(config_.name) : nullptr;
    if (origin == nullptr) return;
    std::vector<std::string> topics = origin->made_of;
    if (std::find(topics.begin(), topics.end(), topic) != topics.end()) return;
    topics.emplace_back(topic);
    set_made_of(*origin, std::move(topics));
  }
  /// In a delivery of the loop.
  void restart_hold(std::size_t way) {
    if (current_ != nullptr && way < current_->ways.size()) current_->ways[way]->since.reset();
  }
  /// An input's value was too old from `from` on. Conditions that were evaluated since then did not use it; the others
  /// lose their hold time.
  void input_was_old(MonotonicTime from) {
    if (last_came_ > from || current_ == nullptr) return;
    for (const auto& way : current_->ways) way->since.reset();
  }
  void input(Time time, MonotonicTime came) {
    last_time_ = time;
    last_came_ = came;
    take(any_event, time, came);
  }

  std::string_view state() const noexcept {
    return current_ != nullptr ? std::string_view(current_->name) : std::string_view();
  }
  Duration in_state() const { return current_ != nullptr ? loop()->now() - arrived_ : Duration{0}; }
  const MachineCounts& counts() const noexcept { return counts_; }
  const std::string& name() const noexcept { return config_.name; }
  Graph graph() const { return table_.graph(config_.name, config_.start); }
  std::string callback_name() const override { return object(); }

 private:
  ~MachineNode() override;
  std::string object() const { return "machine " + config_.name; }
  void check_use(const char* what) const { loop()->check_thread(what, config_.name); }

  // Events
  /// An event from the program, possibly outside the loop's callbacks.
  void take_now(std::uint16_t event) {
    const rtdata::detail::Call call(*this);
    const LoopCore::Calling calling(loop()->runtime);
    const MonotonicTime now = loop()->now();
    take(event, on_line(now), now);
  }
  /// Takes the event now, or after the events that wait for the end of a change.
  void take(std::uint16_t event, Time time, MonotonicTime now) {
    if (is_busy_ || waiting_ > 0) [[unlikely]]
      return keep(event, time);
    const rtdata::detail::Call call(*this);
    is_busy_ = true;
    try_ways(event, time, now);
    ended();
    if (waiting_ > 0) take_waiting();
  }
  void keep(std::uint16_t event, Time time) {
    if (waiting_ == queue_.size()) {
      ++counts_.dropped;
      return report(Errc::backlog, "an event was dropped", event >= no_event ? "of an input" : table_.events()[event],
                    std::to_string(queue_.size()) + " events are already waiting for the end of a change",
                    "raise fewer in one action");
    }
    queue_[(first_ + waiting_++) % queue_.size()] = {event, time};
    if (!is_busy_) take_waiting();
  }
  /// Takes waiting events and those that they cause, up to the queue's size; then the loop has a turn in between.
  void take_waiting() {
    const rtdata::detail::Call call(*this);
    for (std::size_t i = 0; waiting_ > 0; ++i) {
      if (i == queue_.size()) return go_on_.start(Duration{0});
      const Waiting next = queue_[first_];
      first_ = (first_ + 1) % queue_.size();
      --waiting_;
      is_busy_ = true;
      try_ways(next.event, next.time, loop()->now());
      ended();
    }
  }
  void time_passed() {
    const rtdata::detail::Call call(*this);
    take_now(no_event);
    if (is_open()) arm();
  }
  /// The loop's time on the events' clock: events of a replayed recording are from another day.
  Time on_line(MonotonicTime now) { return last_time_ ? *last_time_ + (now - last_came_) : loop()->face.time(); }
  /// Called when an action or a condition, and everything it called, is done.
  void ended() {
    is_busy_ = false;
    if (table_.has_removed()) tidy();
  }
  /// Destroys removed states and transitions when none is on the stack.
  void tidy() {
    if (!is_busy_ && table_.has_removed()) table_.tidy();
  }

  void try_ways(std::uint16_t event, Time time, MonotonicTime now) {
    ++counts_.events;
    const bool is_named = event < no_event;
    if (current_ == nullptr || !feed_.is_running() || (is_named && !waits_for(*current_, event))) {
      if (is_named) ++counts_.ignored;
      return;
    }
    StateEntry& from = *current_;
    const Moment moment{time, from.name, std::max(now - arrived_, Duration{0}),
                        is_named ? std::string_view(table_.events()[event]) : std::string_view()};
    if (TransitionEntry* const way = way_out(from, event, moment)) {
      ++counts_.transitions;
      go(way->to, way->cause, time);
    }
  }
  static bool waits_for(const StateEntry& state, std::uint16_t event) {
    return std::any_of(state.ways.begin(), state.ways.end(),
                       [&](const auto& way) { return way->on == event && !way->is_removed; });
  }
  /// The first transition that may be taken; null: none.
  TransitionEntry* way_out(StateEntry& from, std::uint16_t event, const Moment& moment) {
    const bool is_time = event == no_event;
    if (is_time) event = any_event;
    // By index, because conditions may add transitions.
    for (std::size_t i = 0, count = from.ways.size(); i < count && is_open(); ++i) {
      TransitionEntry& way = *from.ways[i];
      if (way.on != event || way.is_removed || moment.in_state < way.after) continue;
      if (way.when && !ask(way, from, moment)) {
        way.since.reset();
        continue;
      }
      if (is_time && way.hold > Duration{0}) continue;
      if (way.is_removed || !has_held(way, moment.time) || !may_go_to(way.to, moment) || way.is_removed) continue;
      return is_open() ? &way : nullptr;
    }
    return nullptr;
  }
  bool ask(TransitionEntry& way, const StateEntry& from, const Moment& moment) {
    try {
      return way.when(moment);
    } catch (const std::exception& e) {
      condition_threw(way, from, rtdata::detail::reason_of(e));
    } catch (...) {
      condition_threw(way, from, not_standard);
    }
    return false;
  }
  void condition_threw(const TransitionEntry& way, const StateEntry& from, std::string_view why) noexcept {
    threw([&] { return "the condition of " + from.name + " to " + way.to.name; }, why);
  }
  static bool has_held(TransitionEntry& way, Time now) {
    if (way.hold == Duration{0}) return true;
    if (!way.since) way.since = now;
    return now - *way.since >= way.hold;
  }
  bool may_go_to(StateEntry& state, const Moment& moment) {
    bool may = is_open();
    if (may && state.has_check) may = call("check", state, [&] { may = state.code->check(moment); }) && may;
    return may;
  }

  /// Goes to a state, and then to the failure state if an action threw.
  void go(StateEntry& target, std::string_view cause, Time time, Duration before = Duration{0}) {
    StateEntry* to = &target;
    StateEntry* const failure = config_.failure.empty() ? nullptr : table_.find(config_.failure);
    const char* why = nullptr;
    going_to_ = to;
    if (current_ != nullptr) {
      const Moment moment{time, current_->name, in_state()};
      if (!call("leave", *current_, [&] { current_->code->leave(moment); }) && failure != nullptr) {
        to = failure;
        why = "failure of leave";
      }
      if (!is_open()) return;
    }
    if (!arrive_in(*to, why != nullptr ? why : cause, time, before) && is_open() && failure != nullptr &&
        failure != to) {
      // The state whose arrive threw is left like any other.
      const Moment moment{time, current_->name, Duration{0}};
      going_to_ = failure;
      call("leave", *current_, [&] { current_->code->leave(moment); });
      if (is_open()) arrive_in(*failure, "failure of arrive", time);
    }
    if (!is_open()) return;
    going_to_ = nullptr;
    arm();
  }
  /// `before`: how long it was in the state before this machine was made.
  bool arrive_in(StateEntry& to, std::string_view cause, Time time, Duration before = Duration{0}) {
    StateChange change;
    if (current_ != nullptr) {
      change.from = current_->name;
      change.lasted = std::chrono::duration<double>(in_state()).count();
    }
    change.to = to.name;
    change.cause = cut(cause);
    current_ = &to;
    going_to_ = &to;
    arrived_ = loop()->now() - before;
    for (const auto& way : to.ways) way->since.reset();
    feed_.publish(change, time);  // before the events that it causes
    if (!is_open()) return false;
    return call("arrive", to, [&] { to.code->arrive({time, to.name, before}); });
  }
  /// Starts the timer for the next timed transition of the current state.
  void arm() {
    const Duration passed = in_state();
    Duration next = Duration::max();
    for (const auto& way : current_->ways)
      if (!way->is_removed && way->on == any_event && way->after > passed) next = std::min(next, way->after);
    if (next == Duration::max()) return time_.stop();
    time_.start_at(rtdata::detail::later(arrived_, next));
  }

  // Users' functions
  template <class Function>
  bool call(const char* what, const StateEntry& state, Function&& function) {
    return run([&] { return std::string(what) + " of state " + state.name; }, std::forward<Function>(function));
  }
  /// False: it threw.
  template <class Name, class Function>
  bool run(const Name& name, Function&& function) {
    try {
      function();
      return true;
    } catch (const std::exception& e) {
      threw(name, rtdata::detail::reason_of(e));
    } catch (...) {
      threw(name, not_standard);
    }
    return false;
  }
  template <class Name>
  void threw(const Name& name, std::string_view why) noexcept {
    ++counts_.failures;
    if (!is_open()) return;
    loop()->call_own("machine",
                     [&] { report(Errc::handler_threw, "an exception left", name(), std::string(why), ""); });
  }
  void report(Errc code, const char* what, std::string_view of, std::string why, std::string advice) {
    loop()->runtime.report(loop(), object(),
                           {code, what, object() + ", " + std::string(of), std::move(why), std::move(advice)});
  }
  void unknown(std::string_view name) {
    ++counts_.ignored;
    report(Errc::bad_name, "cannot raise event", name, "no transition waits for an event of that name",
           rtdata::detail::suggestion(name, {table_.events().begin(), table_.events().end()}));
  }

  void on_close() noexcept override {
    time_.close();
    go_on_.close();
    feed_.close();
    current_ = going_to_ = nullptr;
    waiting_ = 0;
  }
  void drop_callbacks() noexcept override;

  const Machine::Config config_;
  Feed<StateChange> feed_;
  Timer time_;   // for the next `after`
  Timer go_on_;  // continues with waiting events after a turn of the loop
  MachineTable table_;
  StateEntry* current_ = nullptr;
  StateEntry* going_to_ = nullptr;  // during a change
  MonotonicTime arrived_{};
  std::optional<Time> last_time_;  // of an input's event
  MonotonicTime last_came_{};      // when that came
  struct Waiting {
    std::uint16_t event;
    Time time;
  };
  std::array<Waiting, Machine::max_waiting> queue_{};  // a ring
  std::size_t first_ = 0;
  std::size_t waiting_ = 0;
  bool is_busy_ = false;  // an action or a condition may be on the stack
  MachineCounts counts_;
};

// Separate, so that the end of a call (`Call`) stays short.
MachineNode::~MachineNode() = default;
void MachineNode::drop_callbacks() noexcept { table_.clear(); }

namespace {

/// Null when it is closed: then every function does nothing.
MachineNode* open_node(rtdata::detail::Node* node) noexcept {
  return node != nullptr && node->is_open() ? static_cast<MachineNode*>(node) : nullptr;
}

}  // namespace

Machine::Machine(Loop& loop, Config config) : Handle(new MachineNode(loop, std::move(config))) {}
void Machine::add_state(std::string name, StateConfig config) {
  auto* m = open_node(node());
  if (m == nullptr) return;
  const bool is_final = config.is_final, has_check = static_cast<bool>(config.check);
  m->add_state(std::move(name), std::make_unique<StateOfFunctions>(std::move(config)), is_final, has_check);
}
void Machine::add_state(std::string name, std::unique_ptr<State> state, bool is_final) {
  if (auto* m = open_node(node())) m->add_state(std::move(name), std::move(state), is_final, true);
}
void Machine::remove_state(std::string_view name) {
  if (auto* m = open_node(node())) m->remove_state(name);
}
void Machine::add_transition(Transition transition) {
  if (auto* m = open_node(node())) m->add_transition(std::move(transition));
}
std::size_t Machine::remove_transitions(std::string_view from, std::string_view to) {
  auto* m = open_node(node());
  return m != nullptr ? m->remove_transitions(from, to) : 0;
}
void Machine::start() { start_in({}); }
void Machine::start_in(std::string_view state, std::string_view cause, Duration in_state) {
  if (auto* m = open_node(node())) m->start(state, cause, in_state);
}
void Machine::raise(std::string_view event) {
  if (auto* m = open_node(node())) m->raise(event);
}
void Machine::look() {
  if (auto* m = open_node(node())) m->look();
}
std::string_view Machine::state() const noexcept {
  auto* m = open_node(node());
  return m != nullptr ? m->state() : std::string_view();
}
Duration Machine::in_state() const {
  auto* m = open_node(node());
  return m != nullptr ? m->in_state() : Duration{0};
}
MachineCounts Machine::counts() const noexcept {
  auto* m = open_node(node());
  return m != nullptr ? m->counts() : MachineCounts{};
}
Graph Machine::graph() const {
  auto* m = open_node(node());
  return m != nullptr ? m->graph() : Graph{};
}

namespace detail {

void input_event(rtdata::detail::Node& machine, Time time, MonotonicTime came) {
  if (machine.is_open()) static_cast<MachineNode&>(machine).input(time, came);
}
void restart_hold(rtdata::detail::Node& machine, std::size_t way) {
  if (machine.is_open()) static_cast<MachineNode&>(machine).restart_hold(way);
}
void input_event(InputTimes& input, Time time) {
  const MonotonicTime now = input.machine.loop()->deliveries.handler_began();
  auto& machine = static_cast<MachineNode&>(input.machine);
  if (input.time && input.max_age != Duration::max() && now - input.came > input.max_age)
    machine.input_was_old(input.came + input.max_age);
  input.time = time;
  input.came = now;
  machine.input(time, now);
}
rtdata::detail::Node& node_of_open(const Machine& machine, std::string_view input) {
  rtdata::detail::Node* const node = machine.node();
  if (node != nullptr && node->is_open()) return *node;
  throw SetupError({Errc::closed, "cannot make an input", std::string(input), "its machine is closed", ""});
}
void is_made_of(rtdata::detail::Node& machine, std::string_view topic) {
  if (machine.is_open()) static_cast<MachineNode&>(machine).is_made_of(topic);
}
Loop& loop_of(rtdata::detail::Node& machine) { return machine.loop()->face; }
MonotonicTime now_of(rtdata::detail::Node& machine) { return machine.loop()->now(); }
const std::string& name_of(rtdata::detail::Node& machine) { return static_cast<MachineNode&>(machine).name(); }

}  // namespace detail
}  // namespace rtdata::fsm
