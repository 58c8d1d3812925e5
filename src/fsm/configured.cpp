#include "fsm/configured.hpp"

#include <algorithm>
#include <atomic>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "process/expression_sources.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::fsm {

// Members are destroyed from the last: handlers of events before the state that they change.
struct ConfiguredMachine::Core {
  Core(Loop& its_loop, const MachineSettings& its_settings, Sync its_sync);
  Core(const Core&) = delete;
  Core& operator=(const Core&) = delete;

  /// The state of an input, in addition to its events.
  struct Age {
    bool has_come = false;
    bool is_silence_reported = false;
    bool is_forgotten = false;  // its values are too old and were removed from the conditions of the current state
    MonotonicTime came{};       // initially the time of construction
  };
  /// Of a transition.
  struct When {
    Expression expression;
    std::string of;   // "from pad to boost", in reports
    std::size_t way;  // among the transitions out of its state
    ExpressionResult result = {};
    bool is_failure_reported = false;
  };

  void build(const std::vector<std::string>& names);
  void listen();
  void take(std::size_t input, const EventView& event, Time time);
  void recall();
  void report_missing(const rtdata::detail::ExpressionSources::Source& source) const;
  void forget_old();
  void evaluate(When& when, Time time);
  bool holds(std::size_t when, const Moment& moment);
  void arrived(std::size_t state);
  void report_silence();
  void report(Errc code, const char* what, const std::string& where, std::string why, std::string advice) const;
  bool is_old(std::size_t input) const {
    if (!ages[input].has_come) return true;
    const bool ages_at_all = settings.max_age > Duration{0} && !inputs.all()[input].is_held;
    return ages_at_all && loop.now() - ages[input].came > settings.max_age;
  }
  bool uses(const Expression& expression, std::size_t input) const {
    const auto& fields = inputs.all()[input].fields;
    return std::any_of(fields.begin(), fields.end(), [&](const auto& field) { return expression.uses(field.index); });
  }
  // The handler of states
  void act();
  void acted_on(std::uint64_t number);

  Loop& loop;
  const MachineSettings settings;
  const Sync sync;
  std::vector<std::string> events;  // that transitions wait for
  rtdata::detail::ExpressionSources inputs{{}, {}};
  std::vector<Age> ages;                      // of the inputs
  std::vector<std::optional<double>> values;  // of the names of all conditions
  std::vector<When> whens;
  std::vector<std::vector<std::size_t>> whens_of;  // for each state
  std::size_t state = 0;
  std::optional<Time> last_time;  // of an input's event
  bool is_evaluated = false;      // conditions of the current state were evaluated for the present event
  /// The state and its arrival time, for all threads: 16 bits, and 48 bits of microseconds.
  std::atomic<std::uint64_t> shown{0};

  Callback<void(std::string_view)> handler;
  bool is_acted_on = false;   // the handler was called for the present arrival
  bool was_acted_on = false;  // the previous machine's handler was called for the first arrival
  std::uint64_t arrivals = 0;
  std::uint64_t syncing = 0;  // the arrival being synced to disk; 0: none
  std::weak_ptr<Core> self;

  Machine machine;
  Timer patience;  // limit for syncing
  Ticker silence;
  std::vector<Subscription> subscriptions;
};

namespace {

constexpr int time_bits = 48;
constexpr std::size_t most_states = 1u << 16;

}  // namespace

ConfiguredMachine::Core::Core(Loop& its_loop, const MachineSettings& its_settings, Sync its_sync)
    : loop(its_loop),
      settings(its_settings),
      sync(std::move(its_sync)),
      machine(loop, {.name = settings.name, .topic = settings.topic, .start = settings.start}) {
  const auto refuse = [&](std::string why) {
    throw SetupError({Errc::bad_argument, "cannot make a machine", "machine " + settings.name, std::move(why), ""});
  };
  if (settings.states.size() > most_states) refuse("it has more than " + std::to_string(most_states) + " states");
  std::vector<std::string> texts;
  for (const TransitionSettings& transition : settings.transitions) texts.push_back(transition.when);
  const std::vector<std::string> names = rtdata::detail::names_of(texts);
  if (!names.empty() && settings.inputs.empty()) refuse("the machine has no `inputs`, but its conditions have names");
  build(names);
  inputs = rtdata::detail::ExpressionSources(settings.inputs, names);
  ages.resize(settings.inputs.size(), {.came = loop.now()});
  values.resize(names.size());
}

void ConfiguredMachine::Core::build(const std::vector<std::string>& names) {
  whens_of.resize(settings.states.size());
  for (std::size_t i = 0; i < settings.states.size(); ++i) {
    const StateSettings& one = settings.states[i];
    machine.add_state(one.name, {.arrive = [this, i] { arrived(i); }, .is_final = one.is_final});
  }
  const Graph graph = graph_of(settings);
  for (std::size_t i = 0; i < settings.transitions.size(); ++i) {
    const TransitionSettings& one = settings.transitions[i];
    Condition condition;
    if (!one.when.empty()) {
      const std::size_t number = whens.size();
      const auto way = static_cast<std::size_t>(
          std::count_if(settings.transitions.begin(), settings.transitions.begin() + std::ptrdiff_t(i),
                        [&](const TransitionSettings& before) { return before.from == one.from; }));
      whens.push_back({Expression(one.when, names), "from " + one.from + " to " + one.to, way});
      for (std::size_t k = 0; k < settings.states.size(); ++k)
        if (settings.states[k].name == one.from) whens_of[k].push_back(number);
      condition = [this, number](const Moment& moment) { return holds(number, moment); };
    }
    if (!one.event.empty()) events.push_back(one.event);
    machine.add_transition({.from = one.from,
                            .to = one.to,
                            .on = one.event,
                            .when = std::move(condition),
                            .hold = one.hold,
                            .after = one.after,
                            .cause = i < graph.edges.size() ? graph.edges[i].label : ""});
  }
}

/// Separate, because a subscription may fail.
void ConfiguredMachine::Core::listen() {
  subscriptions = inputs.subscribe(loop, "machine " + settings.name, [this](std::size_t input, const EventView& event) {
    take(input, event, event.time());
  });
  for (const std::string& topic : settings.inputs) detail::is_made_of(detail::node_of_open(machine, topic), topic);
  if (sync)
    patience = Timer(loop, {.name = "machine " + settings.name}, [this] {
      report(Errc::timed_out, "actions on a change no longer wait for the disk", "state " + settings.states[state].name,
             "the disk took longer than " + to_string(settings.resume->wait),
             "check the recording: after a power failure now, the machine would not continue in this state");
      acted_on(syncing);
    });
  if (settings.max_age > Duration{0} && !ages.empty()) {
    const Duration period = std::max<Duration>(settings.max_age, std::chrono::milliseconds{100});
    silence = Ticker(loop, {.period = period, .name = "machine " + settings.name},
                     [this](const Tick&) { report_silence(); });
  }
}

/// Takes the last events of inputs that publish only changes.
void ConfiguredMachine::Core::recall() {
  const std::shared_ptr<Core> kept = self.lock();
  const Time now = loop.core().runtime.event_time(loop.now());
  inputs.recall(loop, [&](std::size_t input, const EventView& event) { take(input, event, now); });
}

void ConfiguredMachine::Core::take(std::size_t input, const EventView& event, Time time) {
  if (!machine.is_started()) return;
  Age& age = ages[input];
  const bool was_old = age.has_come && is_old(input);
  const MonotonicTime came = loop.now();
  age = {.has_come = true, .came = came};
  const std::vector<std::size_t>& own = whens_of[state];
  const bool is_new = inputs.put(input, event, [&](std::size_t name, std::optional<double> value) {
    values[name] = value;
    for (const std::size_t number : own)
      if (Expression& expression = whens[number].expression; expression.uses(name))
        rtdata::detail::set_or_unknown(expression, name, value);
  });
  if (is_new) report_missing(inputs.all()[input]);
  last_time = time;
  forget_old();
  // Evaluates all conditions, because functions with a memory need each event.
  for (const std::size_t number : own) evaluate(whens[number], time);
  is_evaluated = true;
  const std::shared_ptr<Core> kept = self.lock();  // a handler of the change may destroy the machine
  rtdata::detail::Node& node = detail::node_of_open(machine, inputs.all()[input].topic);
  if (was_old)
    for (const std::size_t number : own)
      if (uses(whens[number].expression, input)) detail::restart_hold(node, whens[number].way);
  detail::input_event(node, time, came);
  is_evaluated = false;
}

void ConfiguredMachine::Core::report_missing(const rtdata::detail::ExpressionSources::Source& source) const {
  for (const auto& field : source.fields)
    if (field.leaf == nullptr)
      report(Errc::not_found, "a condition has no value", "topic " + source.topic,
             "the topic has no number `" + field.name + "`", "check its fields, and the conditions");
}

/// Removes values that are too old from the conditions of the current state.
void ConfiguredMachine::Core::forget_old() {
  for (std::size_t i = 0; i < ages.size(); ++i) {
    if (ages[i].is_forgotten || !ages[i].has_come || !is_old(i)) continue;
    ages[i].is_forgotten = true;
    for (const auto& field : inputs.all()[i].fields)
      for (const std::size_t number : whens_of[state]) whens[number].expression.set_unknown(field.index);
  }
}

void ConfiguredMachine::Core::evaluate(When& when, Time time) {
  when.result = when.expression.evaluate(time);
  if (!when.result.has_failed()) {
    when.is_failure_reported = false;
  } else if (!std::exchange(when.is_failure_reported, true)) {
    report(Errc::bad_data, "a condition failed", when.of, when.expression.why(),
           "the condition counts as false: guard it, as in `x != 0 and 1 / x > 5`, or check the measured value");
  }
}

bool ConfiguredMachine::Core::holds(std::size_t number, const Moment& moment) {
  When& when = whens[number];
  if (!is_evaluated) {  // evaluated because time has passed or a named event came
    forget_old();
    evaluate(when, moment.time);
  }
  return when.result.is_true();
}

void ConfiguredMachine::Core::arrived(std::size_t index) {
  state = index;
  is_evaluated = false;
  const auto us = std::chrono::duration_cast<std::chrono::microseconds>(
      (loop.now() - machine.in_state()).time_since_epoch());
  shown.store((std::uint64_t{index} << time_bits) |
                  (static_cast<std::uint64_t>(us.count()) & ((std::uint64_t{1} << time_bits) - 1)),
              std::memory_order_release);
  for (const std::size_t number : whens_of[state]) {
    When& when = whens[number];
    when.expression.reset();
    when.is_failure_reported = false;
    for (std::size_t i = 0; i < ages.size(); ++i) {
      if (is_old(i)) continue;
      for (const auto& field : inputs.all()[i].fields)
        if (const auto& value = values[field.index]; value && when.expression.uses(field.index))
          when.expression.set(field.index, *value);
    }
    if (last_time) evaluate(when, *last_time);  // its memories start with the values at the arrival
  }
  ++arrivals;
  is_acted_on = std::exchange(was_acted_on, false);
  if (!is_acted_on) act();
}

void ConfiguredMachine::Core::act() {
  if (!sync) return acted_on(arrivals);
  if (syncing != 0) return;  // the handler is called for the last change
  syncing = arrivals;
  patience.start(settings.resume->wait);
  sync([weak = self, number = syncing] {
    if (const std::shared_ptr<Core> core = weak.lock(); core != nullptr && core->syncing == number)
      core->acted_on(number);
  });
}

void ConfiguredMachine::Core::acted_on(std::uint64_t number) {
  const std::shared_ptr<Core> kept = self.lock();
  syncing = 0;
  if (patience) patience.stop();
  if (number != arrivals) return act();
  is_acted_on = true;
  if (handler) handler(settings.states[state].name);
}

void ConfiguredMachine::Core::report_silence() {
  for (std::size_t i = 0; i < ages.size(); ++i) {
    const bool is_silent = loop.now() - ages[i].came > settings.max_age && !inputs.all()[i].is_held;
    if (!is_silent || std::exchange(ages[i].is_silence_reported, true)) continue;
    report(Errc::timed_out, "conditions wait", "topic " + settings.inputs[i],
           ages[i].has_come ? "the topic has had no event for more than " + to_string(settings.max_age)
                            : "the topic has had no event yet",
           "the conditions are tried again with its next event; a longer `max_age` bridges longer pauses");
  }
}

void ConfiguredMachine::Core::report(Errc code, const char* what, const std::string& where, std::string why,
                                     std::string advice) const {
  rtdata::detail::LoopCore& core = loop.core();
  const std::string object = "machine " + settings.name;
  core.call_own("machine", [&] {
    core.runtime.report(&core, object, {code, what, where, std::move(why), std::move(advice)});
  });
}

ConfiguredMachine::ConfiguredMachine(Loop& loop, const MachineSettings& settings,
                                     const std::optional<Beginning>& beginning, Sync sync)
    : core_(std::make_shared<Core>(loop, settings, std::move(sync))) {
  core_->self = core_;
  core_->listen();
  if (beginning) {
    core_->was_acted_on = beginning->is_acted_on;
    core_->machine.start_in(beginning->state, beginning->cause, beginning->in_state);
  } else {
    core_->machine.start();
  }
  core_->recall();
}
ConfiguredMachine::ConfiguredMachine(ConfiguredMachine&&) noexcept = default;
ConfiguredMachine& ConfiguredMachine::operator=(ConfiguredMachine&&) noexcept = default;
ConfiguredMachine::~ConfiguredMachine() = default;

Result<void> ConfiguredMachine::raise(std::string_view event) {
  const std::vector<std::string>& known = core_->events;
  if (std::find(known.begin(), known.end(), event) == known.end()) {
    const std::string nearest = nearest_name(event, known);
    return Error{Errc::bad_name, "cannot raise event", std::string(event),
                 "no transition of machine " + core_->settings.name + " waits for it",
                 nearest.empty() ? "" : "did you mean \"" + nearest + "\"?"};
  }
  core_->loop.post([weak = std::weak_ptr<Core>(core_), name = std::string(event)] {
    if (const std::shared_ptr<Core> core = weak.lock()) core->machine.raise(name);
  });
  return {};
}

ConfiguredMachine::Now ConfiguredMachine::now() const noexcept {
  const std::uint64_t shown = core_->shown.load(std::memory_order_acquire);
  const auto us = static_cast<std::int64_t>(shown & ((std::uint64_t{1} << time_bits) - 1));
  return {core_->settings.states[shown >> time_bits].name, MonotonicTime{std::chrono::microseconds{us}}};
}
bool ConfiguredMachine::is_acted_on() const noexcept { return core_->is_acted_on; }

void ConfiguredMachine::on_state(Callback<void(std::string_view)> handler) { core_->handler = std::move(handler); }
MachineCounts ConfiguredMachine::counts() const noexcept { return core_->machine.counts(); }
const MachineSettings& ConfiguredMachine::settings() const noexcept { return core_->settings; }

}  // namespace rtdata::fsm
