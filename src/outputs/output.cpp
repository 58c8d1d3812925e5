#include "rtdata/outputs/output.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "data/fitting.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/events/made_of.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/turn_watch.hpp"
#include "outputs/input.hpp"
#include "outputs/port.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/topic.hpp"
#include "sensors/core/feed_node.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_set = "cannot set the output";
constexpr Duration retry_period = std::chrono::seconds{1};
constexpr Duration slow_start = std::chrono::seconds{1};
constexpr Duration answer_limit = std::chrono::seconds{3};  // longer than a lane's

/// Why the configuration is invalid; empty: it is valid.
std::string refusal_of(const OutputConfig& config) {
  if (!std::isfinite(config.safe)) return "`safe` is not a finite number";
  if (config.on.empty()) {
    if (!config.expression.empty() || !config.with.empty() || config.hysteresis || config.pid)
      return "`expression`, `with`, `hysteresis` and `pid` need `on`, the topic that the output follows";
    return "";
  }
  if (config.lease != Duration{0})
    return "`lease` works only for outputs that `set` sets; use `max_age` for an output that follows a topic";
  if (config.hysteresis && config.pid) return "use `hysteresis` or `pid`, not both";
  return "";
}

}  // namespace

namespace detail {

class OutputNode final : public FeedNode, private OutputPort::Listener {
 public:
  OutputNode(Loop& loop, OutputConfig config, MakeActuator make)
      : FeedNode(loop.core(), FeedConfig{config.name, config.topic, {}}, payload_type<OutputChange>()),
        config_(std::move(config)),
        make_(std::move(make)),
        range_(range_of(make_)),
        stale_(loop, {.name = name()}, [this] { look_at_age(); }),
        lease_(loop, {.name = name()}, [this] { look_at_lease(); }),
        retry_(loop, {.name = name()}, [this] { try_again(); }),
        patience_(loop, {.name = name()}, [this] { miss_answer(); }),
        turning_(loop, {.name = name()}, [this] { look_at_loops(); }),
        telling_(loop, {.name = name()}, [this] { tell(); }) {
    set_numbered();  // it makes its events itself
    if (!config_.on.empty()) input_.emplace(config_);
  }

  /// Separate, because it may fail.
  void begin(OutputGuard* guard, const std::string& guarded, Output::Takes takes) {
    if (const std::string why = range_.refusal(config_.safe); !why.empty())
      throw SetupError({Errc::out_of_range, "cannot make the output", name(), "`safe`: " + why, ""});
    Loop& loop = this->loop()->face;
    if (guard != nullptr && !guarded.empty()) take_guard(loop, *guard, guarded);
    if (port_ == nullptr) port_ = make_lane_port(loop, name(), make_, *this);
    if (input_) {
      subscriptions_ = input_->subscribe(
          loop, name(), [this](std::size_t topic, const EventView& event) { take(topic, event, event.time()); });
      set_made_of(origin_, input_->topics());
    }
    if (takes != Output::Takes::at_once) {
      is_patient_ = takes == Output::Takes::patiently;
      begin_taking();
    } else {
      take_device(config_.armed == Arming::at_start);
      recall();
    }
    if (!port_->is_guarded()) {
      this->loop()->runtime.log(LogLevel::info, name(),
                                "it has no guard: no process sets its safe value if this program hangs or crashes");
      return;
    }
    beat_ = Ticker(loop, {.period = config_.watchdog / 4, .name = name() + " watchdog"},
                   [this](const Tick&) { turn(); });
  }

  Result<void> set(double value, std::string_view by) {
    if (state_ == State::stopped) return stopped();
    if (!std::isfinite(value)) return refusal(Errc::bad_argument, "the value is not a finite number", "");
    if (input_)
      return refusal(Errc::bad_argument, "the output follows the topic \"" + config_.on + "\"",
                     "disarm it to hold it safe");
    const Order order{value, OutputCause::set, fitting<48>(by), now()};
    if (is_over_) {
      record(order, {}, program_ends);
      return refusal(Errc::closed, program_ends, "");
    }
    if (const std::string why = range_.refusal(value); !why.empty()) {
      record(order, {}, why);
      return refusal(Errc::out_of_range, why, "");
    }
    if (!is_armed_) {
      record(order, {}, "it is disarmed");
      return refusal(Errc::not_permitted, "it is disarmed", "arm it first");
    }
    if (is().left) {
      record(order, {}, given_back);
      return refusal(Errc::busy, given_back, "set it again after the reload");
    }
    if (state_ == State::failed) {  // while its safe value is being set, the order waits for it
      record(order, {}, "the device has failed");
      return refusal(
          Errc::io_failed, "the device has failed",
          "the program sets the safe value as soon as the device accepts it; set the output again after that");
    }
    last_set_ = now();
    if (config_.lease > Duration{0} && !lease_.is_running()) lease_.start(config_.lease);
    is_overdue_ = false;
    request(order);
    settle();
    return {};
  }

  Result<void> arm(std::string_view by) {
    if (is().left) return refusal(Errc::busy, given_back, "arm it after the reload");
    if (!is().held) return stopped();
    if (is_over_) return refusal(Errc::closed, program_ends, "");
    if (is_lost_) return refusal(Errc::disconnected, "its guard has ended: it stays safe", "start the program again");
    if (is_armed_) return {};
    beat();
    port_->arm();
    is_watched_ = true;
    is_armed_ = true;
    has_tripped_ = false;
    record({config_.safe, OutputCause::arm, fitting<48>(by), now()}, value_,
           is().failing ? "the device has failed" : "");
    recall();
    settle();
    return {};
  }

  Result<void> disarm(std::string_view by) {
    if (state_ == State::stopped) return stopped();
    if (!is_armed_) return {};
    is_armed_ = false;
    if (is().left) {
      record({config_.safe, OutputCause::disarm, fitting<48>(by), now()}, value_,
             state_ == State::ending ? given_back : "");
      return {};
    }
    end_lease();
    stop_watching();
    set_safe(OutputCause::disarm, by);
    settle();
    return {};
  }

  Result<void> change_pid(const PidConfig& pid) {
    if (const Result<void> has_one = check_pid(); !has_one) return has_one;
    const double all[] = {pid.setpoint, pid.kp, pid.ki, pid.kd, pid.least, pid.most};
    const bool is_finite = std::all_of(std::begin(all), std::end(all), [](double one) { return std::isfinite(one); });
    if (!is_finite || !(pid.least < pid.most))
      return Error{Errc::bad_argument, cannot_control, name(),
                   is_finite ? "`least` is not below `most`" : "a setting is not a finite number", ""};
    input_->pid()->change(pid);
    is_setpoint_commanded_ = false;
    return {};
  }
  Result<void> change_setpoint(double setpoint) {
    if (const Result<void> has_one = check_pid(); !has_one) return has_one;
    PidConfig pid = input_->pid()->config();
    pid.setpoint = setpoint;
    Result<void> changed = change_pid(pid);
    is_setpoint_commanded_ = changed.has_value();
    return changed;
  }
  bool is_setpoint_commanded() const noexcept { return is_setpoint_commanded_; }

  double safe_value() const noexcept { return config_.safe; }
  bool is_armed() const noexcept { return is_armed_; }
  void when_published(Callback<void()> done) {
    if (published_armed_ == is_armed_) return tell_later(std::move(done));
    waiting_.push_back(std::move(done));
  }
  void when_taken(Callback<void(Result<void>)> done) {
    when_taken_.push_back(std::move(done));
    if (state_ != State::taking) report_taken();
  }
  void finish(Callback<void()> done) {
    ended_.push_back(std::move(done));
    if (state_ == State::ending) return;
    if (!is().held) return report_ended();
    end_orders(State::ending);
    if (const Result<void> begun = port_->begin_finish(first_value()); !begun) finish_ending(begun);
  }
  Duration lease_left() const noexcept {
    return config_.lease > Duration{0} ? std::max(config_.lease - (now() - last_set_), Duration{0}) : Duration::max();
  }
  bool has_ended_unsafe() const noexcept { return has_ended_unsafe_; }
  bool is_safe() const noexcept { return !is().busy && value_ && *value_ == config_.safe; }
  std::optional<double> value() const noexcept { return value_; }
  bool is_guarded() const noexcept { return port_ != nullptr && port_->is_guarded(); }

  void start() override {
    if (is_running() || !is_open()) return;
    FeedNode::start();
    state_ = State::stopped;
    take_device(config_.armed == Arming::at_start);
    recall();
  }
  void stop() override {
    give_back();
    FeedNode::stop();
  }
  void stop_schedule(MonotonicTime end) override {
    give_back();
    FeedNode::stop_schedule(end);
  }

 private:
  struct Order {
    double value = 0;
    OutputCause cause = OutputCause::start;
    text<48> by = {};
    MonotonicTime asked{};
    bool is_repeat = false;  // repeats the value that is being set: used only if the device does not accept it
  };

  /// The state of its device.
  enum class State : std::uint8_t { stopped, taking, ready, busy, failed, mending, ending, left };
  struct Standing {
    bool held, busy, failing, left;
  };
  static constexpr Standing standing(State state) noexcept {
    // clang-format off
    constexpr Standing all[] = {
        {false, false, false, false},  // stopped
        {true,  true,  false, false},  // taking: the device is being opened while the loop turns
        {true,  false, false, false},  // ready
        {true,  true,  false, false},  // busy: a value is being set
        {true,  false, true,  false},  // failed: the safe value is tried repeatedly
        {true,  true,  true,  false},  // mending: the safe value is being set
        {false, false, false, true},   // ending: `finish` was called, and is not complete
        {false, false, false, true},   // left: `finish` is complete
    };
    // clang-format on
    return all[static_cast<std::size_t>(state)];
  }
  Standing is() const noexcept { return standing(state_); }
  /// For a device that is held and was opened.
  void be(bool busy, bool failing) noexcept {
    if (!is().held || state_ == State::taking) return;
    state_ = failing ? (busy ? State::mending : State::failed) : (busy ? State::busy : State::ready);
  }

  static constexpr const char* program_ends = "the program ends";
  static constexpr const char* cannot_control = "cannot change the controller";
  static constexpr const char* given_back = "its device is being released";

  std::string name() const { return "output " + origin_.name; }
  std::string object_name() const override { return name(); }
  MonotonicTime now() const { return loop()->now(); }
  Error refusal(Errc code, std::string why, std::string advice) const {
    return {code, cannot_set, name(), std::move(why), std::move(advice)};
  }
  Result<void> check_pid() {
    if (input_ && input_->pid() != nullptr) return {};
    return Error{Errc::bad_argument, cannot_control, name(), "it has no `pid`", ""};
  }
  Error stopped() const { return refusal(Errc::closed, "it is stopped", ""); }
  Error placed(Error error) const {
    error.where = error.where.empty() ? name() : name() + ", " + error.where;
    return error;
  }

  // ---- The device

  std::optional<double> first_value() const { return config_.keep ? std::nullopt : std::optional(config_.safe); }
  void take_device(bool is_armed) {
    beat();
    is_watched_ = false;
    value_.reset();
    const MonotonicTime began = now();
    const Result<void> opened = port_->open(first_value());
    if (!opened && !is_away(opened)) throw SetupError(placed(opened.error()));
    is_armed_ = is_armed && !is_lost_;
    note_opened(began, opened);
    follow_input();
  }
  /// True: the output waits for its device. False: the error ends the setup, or a reload that caused it is undone. With
  /// `required` an absent device is such an error during the setup.
  bool is_away(const Result<void>& opened) const {
    const auto& code = opened.error().code;
    if (is_patient_) return true;
    if (config_.required && loop()->is_being_set_up()) return false;
    return code == Errc::disconnected ||
           (loop()->is_being_set_up() && (code == Errc::not_found || code == Errc::timed_out));
  }
  void note_opened(MonotonicTime began, const Result<void>& opened) {
    state_ = opened ? State::ready : State::failed;
    has_ended_unsafe_ = false;
    if (opened && !config_.keep) value_ = config_.safe;
    record({config_.safe, OutputCause::start, {}, began}, value_,
           !opened        ? opened.error().why
           : config_.keep ? "the output keeps its value"
                          : "");
    if (!opened) {
      complain(placed(opened.error()), Health::faulted);
      if (is_open() && is().failing) retry_.start(retry_period);
    }
  }
  void follow_input() {
    last_input_ = now();
    hanging_ = nullptr;
    if (!input_) return;
    input_->begin(now());
    stale_.start(config_.max_age);
  }

  /// The device is opened while the loop turns, like a value that is being set.
  void begin_taking() {
    beat();
    state_ = State::taking;
    is_armed_ = config_.armed == Arming::at_start && !is_lost_;
    busy_ = {config_.keep ? std::nan("") : config_.safe, OutputCause::start, {}, now()};
    follow_input();
    if (const Result<void> begun = port_->begin_open(first_value()); !begun) return finish_taking(begun);
    patience_.start(slow_start);
  }
  void finish_taking(const Result<void>& opened) {
    state_ = State::stopped;
    patience_.stop();
    const bool is_taken = opened || is_away(opened);
    is_patient_ = false;
    if (is_taken) {
      note_opened(busy_.asked, opened);
    } else {
      taken_ = placed(opened.error());
      for (Timer* timer : {&stale_, &lease_, &retry_}) timer->stop();
    }
    report_taken();
    if (!is_open()) return;
    if (is_taken && opened) {
      settle();
      recall();
      go_on();
    } else if (next_) {
      record(*std::exchange(next_, std::nullopt), {}, "the device failed");
    }
  }
  void report_taken() {
    for (Callback<void(Result<void>)>& done : std::exchange(when_taken_, {}))
      tell_later([done = std::move(done), result = taken_]() mutable { done(std::move(result)); });
  }
  /// In a later turn, unless it is closed before.
  void tell_later(Callback<void()> done) {
    told_later_.push_back(std::move(done));
    telling_.start(Duration{0});
  }
  void tell() {
    Call call(*this);
    for (Callback<void()>& done : std::exchange(told_later_, {}))
      if (is_open()) loop()->call_own(name(), [&] { done(); });
  }
  void give_back() noexcept {
    try {
      if (state_ == State::ending) return finish_ending(port_->wait_for_end());
      if (!is().held) return;
      end_orders(State::stopped);
      note_given_back(port_->finish(first_value()));
    } catch (const std::exception& thrown) {
      loop()->runtime.log(LogLevel::error, name(), thrown.what());
    }
  }
  /// The program ends, but its loop still turns: sets the safe value (not with `keep`), and refuses later orders.
  void end_orders_early() {
    if (std::exchange(is_over_, true)) return;
    for (Timer* timer : {&stale_, &lease_, &turning_}) timer->stop();
    if (config_.keep) return;
    stop_watching();
    set_safe(OutputCause::stop, "");
  }
  /// The guard disarms it no more.
  void stop_watching() noexcept {
    if (std::exchange(is_watched_, false)) port_->disarm();
  }
  /// Drops all requested values.
  void end_orders(State next) {
    const State was = std::exchange(state_, next);
    for (Timer* timer : {&stale_, &lease_, &retry_, &patience_, &turning_}) timer->stop();
    if (was == State::taking) busy_.value = config_.safe;
    stop_order_ = {config_.safe, OutputCause::stop, {}, now()};
    if (standing(was).busy) record(busy_, {}, "the output is being closed");
    if (next_) record(*std::exchange(next_, std::nullopt), {}, "the output is being closed");
  }
  void note_given_back(const Result<void>& done) {
    if (const auto trip = port_->late_trip()) report_trip(*trip);
    if (!done) {
      has_ended_unsafe_ = !config_.keep;
      value_.reset();
      record(stop_order_, {}, done.error().why);
      complain(placed(done.error()), Health::faulted);
    } else {
      const bool is_reported = is_over_ && !config_.keep && value_ == config_.safe;
      value_ = config_.keep ? value_ : std::optional(config_.safe);
      if (!is_reported) record(stop_order_, value_, config_.keep ? "the output keeps its value" : "");
    }
  }
  /// What `finish` began.
  void finish_ending(const Result<void>& done) {
    state_ = State::left;
    note_given_back(done);
    if (is_open()) report_ended();
  }
  void report_ended() {
    for (Callback<void()>& done : std::exchange(ended_, {})) tell_later(std::move(done));
  }

  /// Requests the value, or records that there is nothing to do.
  void request(const Order& order) {
    const bool is_asked = order.cause == OutputCause::set || order.cause == OutputCause::input;
    const double last = next_ ? next_->value : is().busy ? busy_.value : value_.value_or(std::nan(""));
    if (last == order.value) {
      if (is_asked && is().busy && !next_) {
        next_ = order;
        next_->is_repeat = true;
        return;
      }
      if (is_asked) return repeated();
      if (!is().busy) return record(order, value_, "");
      return record(order, {}, "this value is already being sent to the device");
    }
    if (!is().busy) return send(order);
    if (next_ && next_->is_repeat) {
      repeated();
    } else if (next_ && next_->cause == OutputCause::input) {
      ++origin_.counts.received;
      ++origin_.counts.filtered;
    } else if (next_) {
      record(*next_, {}, "replaced by a newer value before the device was ready");
    }
    next_ = order;
  }
  void send(const Order& order) {
    beat();
    busy_ = order;
    be(true, is().failing);
    if (const Result<void> sent = port_->set(order.value); !sent) {
      answered(sent.error());
    } else {
      sent_ = now();
      if (!patience_.is_running()) patience_.start(answer_limit);
    }
  }
  void set_safe(OutputCause cause, std::string_view by) {
    if (input_) input_->follow(config_.safe);
    request({config_.safe, cause, fitting<48>(by), now()});
  }

  void answered(Result<void> result) override {
    Call call(*this);
    if (state_ == State::ending) return finish_ending(result);
    if (state_ == State::taking) return finish_taking(result);
    const bool had_failed = is().failing;
    if (!is().busy) return;
    be(false, had_failed);
    if (!result) return failed(placed(result.error()));
    value_ = busy_.value;
    be(false, false);
    retry_.stop();
    record(busy_, value_, "");
    settle();
    if (had_failed) recall();
    go_on();
  }
  void go_on() {
    if (!is().held || is().busy || !next_) return;
    const Order order = *std::exchange(next_, std::nullopt);
    if (value_ != order.value) return send(order);
    if (order.is_repeat) return repeated();
    record(order, value_, "");
  }
  void failed(const Error& error) {
    record(busy_, {}, error.why);
    std::optional<Order> waiting = std::exchange(next_, std::nullopt);
    value_.reset();
    const bool was_failing = is().failing;
    be(false, true);
    if (!was_failing) complain(error, Health::faulted);
    // Its handler may have stopped and restarted it.
    const bool goes_on = is_open() && is().failing;
    if (goes_on && !was_failing && (waiting || busy_.value != config_.safe)) {
      set_safe(OutputCause::failure, "");
    } else if (goes_on) {
      retry_.start(retry_period);
    }
    if (waiting) follow_failure(*waiting);
  }
  /// A value requested while another one was being set that failed: it is set after the safe value, if the device
  /// accepts that at once.
  void follow_failure(Order order) {
    if (!is().busy || next_ || !is_armed_) return record(order, {}, "the device failed");
    order.is_repeat = order.value == busy_.value;
    next_ = order;
  }
  void try_again() {
    Call call(*this);
    if (is().held && !is().busy) set_safe(OutputCause::failure, "");
  }
  /// The value of the device is unknown. Reported once; the answer may still come.
  void miss_answer() {
    Call call(*this);
    if (!is().busy) return;
    if (state_ == State::taking)
      return complain(
          {Errc::timed_out, "the output cannot be set yet", name(),
           "its device has not answered for " + to_string(slow_start), "check the device; the next value waits"},
          Health::degraded);
    // Started with an earlier value, which was answered.
    if (const MonotonicTime due = sent_ + answer_limit; due > now()) return patience_.start_at(due);
    value_.reset();
    complain({Errc::timed_out, cannot_set, name(),
              "there is no answer after " + to_string(answer_limit) + (is_guarded() ? " from the guard" : ""),
              "check the device, or start the program again"},
             Health::faulted);
  }

  // ---- The guard

  /// A guard that has ended accepts no output: the program keeps the output safe, as in `lost`, and does not arm it
  /// again.
  void take_guard(Loop& loop, OutputGuard& guard, const std::string& guarded) {
    try {
      port_ = make_guard_port(loop, name(), guard, guarded, config_.safe, *this);
    } catch (const SetupError& refused) {
      if (refused.error().code != Errc::disconnected) throw;
      is_lost_ = true;
      complain(placed(refused.error()), Health::faulted);
    }
  }
  /// The loop turns.
  void turn() {
    Call call(*this);
    beat();  // what it reports may end this output
    if (!is_open() || !is().held || state_ == State::taking) return;
    if (is_armed_ && !std::exchange(is_watched_, true)) port_->arm();
    if (port_->is_to_end()) end_orders_early();
  }
  void beat() {
    if (port_ == nullptr) return;
    const MonotonicTime now = this->now();
    if (now - last_beat_ > config_.watchdog) turning_since_ = now;
    last_beat_ = now;
    port_->beat(now + config_.watchdog);
    look_at_guard();
  }
  /// While the output is not safe, the guard checks the beat at least once in the watchdog time. After a pause of the
  /// beats it may have made the output safe, and then checks no more.
  void look_at_guard() {
    const std::optional<MonotonicTime> seen = port_->guard_seen();
    const bool is_silent = is().held && !is().busy && value_ && *value_ != config_.safe && seen &&
                           now() - std::max(*seen, turning_since_) > 4 * config_.watchdog;
    if (!std::exchange(is_guard_silent_, is_silent) && is_silent)
      complain({Errc::timed_out, "no process would set the output safe", name(), "its guard does not run",
                "find out what stopped the process rtdata-guard"},
               Health::faulted);
  }
  void tripped(const Result<void>& done) override {
    Call call(*this);
    end_lease();
    has_tripped_ = true;
    is_watched_ = false;
    be(is().busy, !done);
    retry_.stop();
    is_armed_ = false;
    if (next_) record(*std::exchange(next_, std::nullopt), {}, "it is disarmed");
    if (input_) input_->follow(config_.safe);
    report_trip(done);
    // The device may have accepted the value since; setting it again shows this.
    if (is_open() && state_ == State::failed) set_safe(OutputCause::failure, "");
  }
  void vanished(const Error& error) override {
    Call call(*this);
    if (!is().held) return;
    value_.reset();
    be(is().busy, true);
    if (input_) input_->follow(config_.safe);
    record({config_.safe, OutputCause::failure, {}, now()}, {}, error.why);
    complain(placed(error), Health::faulted);
    // A value that is being set opens the device again; its result is answered.
    if (is_open() && state_ == State::failed) set_safe(OutputCause::failure, "");
  }
  void report_trip(const Result<void>& done) {
    is_armed_ = false;
    value_ = done ? std::optional(config_.safe) : std::nullopt;
    record({config_.safe, OutputCause::watchdog, fitting<48>("guard"), now()}, value_, done ? "" : done.error().why);
    Error error{Errc::not_turning, "the guard has set the output to its safe value", name(),
                "the loop did not turn for " + to_string(config_.watchdog),
                "find out what held the loop, then arm the output again"};
    if (!done) {
      error.what = "the guard could not set the output to its safe value";
      error.why += ", and the device did not accept the value: " + done.error().why;
      error.advice = "check the device: the safe value is sent again until the device accepts it";
    }
    complain(error, done ? Health::degraded : Health::faulted);
  }
  void lost(const Error& error) override {
    Call call(*this);
    if (!is().held || is_lost_) return;
    if (state_ == State::taking) finish_taking(error);
    is_lost_ = true;
    is_armed_ = false;
    end_lease();
    const bool was_busy = is().busy;
    be(false, is().failing);
    if (was_busy) record(busy_, {}, error.why);
    if (next_) record(*std::exchange(next_, std::nullopt), {}, error.why);
    value_.reset();
    beat_.close();
    patience_.stop();
    port_ = make_lane_port(loop()->face, name(), make_, *this);
    complain(placed(error), Health::faulted);
    if (is_open() && is().held) set_safe(OutputCause::watchdog, "program");
  }

  // ---- What it follows

  /// Takes the last events of topics that publish only changes.
  void recall() {
    if (!input_) return;
    const Time time = loop()->runtime.event_time(now());
    input_->recall(loop()->face, [&](std::size_t topic, const EventView& event) { take(topic, event, time); });
  }
  void take(std::size_t topic, const EventView& event, Time time) {
    if (!is().held || is_over_) return;
    Call call(*this);
    input_->put(topic, event, now());
    if (input_->has_held() && !turning_.is_running()) turning_.start(Duration{0});
    if (hanging_ != nullptr || !input_->computes_with(topic)) return;
    const std::optional<double> value = input_->evaluate(time, now());
    if (!input_->why().empty()) return go_stale(Errc::bad_data, input_->why(), "check the measured value");
    if (!value) return;
    if (const std::string why = range_.refusal(*value); !why.empty())
      return go_stale(Errc::out_of_range, why, "check the measured value, and the expression");
    last_input_ = now();
    is_stale_ = false;
    const OutputInput::Silence silence = input_->silence();
    if (silence.topic == nullptr)
      stale_.stop();
    else if (!stale_.is_running())
      stale_.start_at(silence.since + config_.max_age);
    if (is_armed_ && !is().failing)
      request({*value, OutputCause::input, fitting<48>(config_.on), now()});
    else
      input_->follow(config_.safe);
    settle();
  }
  void look_at_age() {
    Call call(*this);
    const OutputInput::Silence silence = input_->silence();
    if (!is().held || silence.topic == nullptr) return;
    const MonotonicTime due = std::min(silence.since, last_input_) + config_.max_age;
    if (due > now()) return stale_.start_at(due);
    const bool is_silent = now() - silence.since >= config_.max_age;
    go_stale(Errc::timed_out,
             "the topic \"" + *silence.topic + "\" has had " +
                 (is_silent ? "no event" : "only events without a value") + " for " + to_string(config_.max_age),
             "the output follows the topic again with its next event; a longer `max_age` bridges longer pauses");
  }
  /// A loop's last event is valid as long as that loop turns, because it would publish a change.
  void look_at_loops() {
    Call call(*this);
    if (!is().held || is_over_) return;
    const std::vector<LoopCore*> loops = input_->loops_of_held(loop()->face);
    const LoopCore* const before = std::exchange(hanging_, turns_.look(loops, now(), config_.max_age));
    if (loops.empty()) return;  // looked for again with the next event
    turning_.start(std::max(config_.max_age / 4, Duration{std::chrono::milliseconds{1}}));
    if (hanging_ != nullptr && before == nullptr)
      go_stale(Errc::not_turning,
               "loop " + hanging_->config.name + " has not turned for " + to_string(config_.max_age) +
                   ", so changes of the topic are unknown",
               "find out what blocks that loop; the output follows the topic again when it turns");
    if (hanging_ == nullptr && before != nullptr) recall();
  }
  void go_stale(Errc code, const std::string& why, std::string advice) {
    if (std::exchange(is_stale_, true)) return;
    set_safe(OutputCause::stale, config_.on);
    complain({code, "the output is being set to its safe value", name(), why, std::move(advice)},
             worst(Health::degraded));
  }
  /// Ends the lease, because no value is set.
  void end_lease() {
    lease_.stop();
    is_overdue_ = false;
  }
  void look_at_lease() {
    Call call(*this);
    if (!is().held) return;
    if (const MonotonicTime due = last_set_ + config_.lease; due > now()) return lease_.start_at(due);
    is_overdue_ = true;
    set_safe(OutputCause::lease, "");
    complain({Errc::timed_out, "the output is being set to its safe value", name(),
              "no program or command has set it for " + to_string(config_.lease),
              "set the output again, more often than `lease`"},
             worst(Health::degraded));
  }

  // ---- Reports

  Health worst(Health health) const { return health_now() == Health::faulted ? Health::faulted : health; }
  Health health_now() const {
    if (is().failing || is_lost_) return Health::faulted;
    return is_stale_ || is_overdue_ || has_tripped_ ? Health::degraded : Health::ok;
  }
  void settle() {
    if (is_open() && health() != Health::ok && health_now() == Health::ok && !is().busy)
      set_health(Health::ok, nullptr);
  }
  void record(const Order& order, std::optional<double> done, std::string_view why) {
    OutputChange change{.asked = order.value, .done = done, .cause = order.cause, .armed = is_armed_, .by = order.by};
    if (done) change.took = std::chrono::duration<double>(now() - order.asked).count();
    change.why = fitting<160>(why);
    if (!is_running()) return;
    take_sample(&change, loop()->runtime.event_time(now()));
    published_armed_ = change.armed;
    for (Callback<void()>& waits : std::exchange(waiting_, {})) tell_later(std::move(waits));
  }

  void on_close() noexcept override {
    give_back();
    subscriptions_.clear();
    for (Timer* timer : {&stale_, &lease_, &retry_, &patience_, &turning_, &telling_}) timer->close();
    beat_.close();
    FeedNode::on_close();
    port_.reset();
  }
  void drop_callbacks() noexcept override {
    FeedNode::drop_callbacks();
    for (auto* all : {&waiting_, &ended_, &told_later_}) all->clear();
    when_taken_.clear();
  }

  const OutputConfig config_;
  const MakeActuator make_;
  const OutputRange range_;
  std::optional<OutputInput> input_;
  Timer stale_, lease_, retry_, patience_, turning_, telling_;
  TurnWatch turns_;
  Ticker beat_;
  std::vector<Subscription> subscriptions_;
  std::unique_ptr<OutputPort> port_;
  std::optional<double> value_;  // the value that the device has
  Order busy_;                   // the value that is being set, if any
  std::optional<Order> next_;
  Order stop_order_;
  std::vector<Callback<void(Result<void>)>> when_taken_;
  Result<void> taken_;                     // an error: the device could not be opened
  std::vector<Callback<void()>> ended_;    // called when `finish` is complete
  std::vector<Callback<void()>> waiting_;  // for an event that says whether it is armed
  std::vector<Callback<void()>> told_later_;
  MonotonicTime last_set_{}, last_input_{}, last_beat_{}, turning_since_{}, sent_{};
  const LoopCore* hanging_ = nullptr;  // on which it depends
  State state_ = State::stopped;
  bool is_over_ = false;     // the program ends
  bool is_watched_ = false;  // the guard was told that it is armed
  bool is_patient_ = false;  // the output starts, whatever its device answers
  bool is_armed_ = false;
  bool published_armed_ = false;  // by the last event
  bool is_stale_ = false;
  bool is_overdue_ = false;
  bool has_tripped_ = false;
  bool is_lost_ = false;
  bool is_guard_silent_ = false;
  bool has_ended_unsafe_ = false;
  bool is_setpoint_commanded_ = false;
};

}  // namespace detail

void check_config(const OutputConfig& config, const ConfigItem& item, Problems& problems) {
  if (const std::string why = refusal_of(config); !why.empty()) problems.add(item.problem("bad-value", why));
  if (config.on.empty()) return;
  check_config(detail::derived_of(config), item, problems);
}

void check_output_names(const OutputConfig& config,
                        const std::function<const Description*(std::string_view topic)>& payload_of,
                        const ConfigItem& item, Problems& problems) {
  if (!config.on.empty()) check_derived_names(detail::derived_of(config), payload_of, item, problems);
}

Output::Output(Loop& loop, OutputConfig config, MakeActuator make, std::string guarded, Takes takes) {
  if (const std::string why = refusal_of(config); !why.empty())
    throw SetupError({Errc::bad_argument, "cannot make the output", config.name, why, ""});
  OutputGuard* const guard = loop.runtime().config().guard;
  auto* const node = new detail::OutputNode(loop, std::move(config), std::move(make));
  *this = Output(node);
  node->begin(guard, guarded, takes);
}

namespace {

/// Calls the function on the thread of the output's loop, which for a tier may differ from this one. `otherwise`: the
/// result if it is closed. The function must own what it uses.
template <class Returned, class Function>
Returned with(detail::Node* node, Returned otherwise, Function function) {
  if (node == nullptr || !node->is_open()) return otherwise;
  auto& output = static_cast<detail::OutputNode&>(*node);
  if (!output.loop()->runs_elsewhere()) return function(output);
  return output.loop()->ask_there(
      [&output, otherwise = std::move(otherwise), function = std::move(function)]() mutable {
        return output.is_open() ? function(output) : std::move(otherwise);
      });
}

/// For calls that return an error.
template <class Function>
Result<void> ordered(detail::Node* node, Function function) {
  try {
    return with(node, Result<void>(Error{Errc::closed, cannot_set, "", "the output is closed", ""}),
                std::move(function));
  } catch (const SetupError& error) {  // its loop does not turn
    return error.error();
  }
}
/// The same with the name of the caller: another thread gets a copy; on this thread it is used without allocation.
template <class Function>
Result<void> ordered_by(detail::Node* node, std::string_view by, const char* what, Function function) {
  const auto order = [what, function](detail::OutputNode& output, std::string_view who) {
    output.loop()->check_thread(what, output.origin().name);
    return function(output, who);
  };
  if (node != nullptr && node->is_open() && node->loop()->runs_elsewhere())
    return ordered(node, [order, by = std::string(by)](detail::OutputNode& output) { return order(output, by); });
  return ordered(node, [order, by](detail::OutputNode& output) { return order(output, by); });
}
/// For calls that cannot be refused. `unknown`: the result if its loop does not turn.
template <class Returned, class Function>
Returned asked(detail::Node* node, Returned otherwise, Returned unknown, const Function& function) noexcept {
  try {
    return with(node, std::move(otherwise), function);
  } catch (const std::exception&) {
    return unknown;
  }
}

}  // namespace

Result<void> Output::set(double value, std::string_view by) {
  return ordered_by(node(), by, cannot_set,
                    [value](detail::OutputNode& output, std::string_view who) { return output.set(value, who); });
}
Result<void> Output::arm(std::string_view by) {
  return ordered_by(node(), by, "cannot arm the output",
                    [](detail::OutputNode& output, std::string_view who) { return output.arm(who); });
}
Result<void> Output::disarm(std::string_view by) {
  return ordered_by(node(), by, "cannot disarm the output",
                    [](detail::OutputNode& output, std::string_view who) { return output.disarm(who); });
}
Result<void> Output::change_pid(const PidConfig& pid) {
  return ordered(node(), [pid](detail::OutputNode& output) { return output.change_pid(pid); });
}
Result<void> Output::change_setpoint(double setpoint) {
  return ordered(node(), [setpoint](detail::OutputNode& output) { return output.change_setpoint(setpoint); });
}
bool Output::is_setpoint_commanded() const noexcept {
  if (node() == nullptr || !node()->is_open()) return false;
  return static_cast<const detail::OutputNode*>(node())->is_setpoint_commanded();  // it changes by these calls alone
}
double Output::safe_value() const noexcept {
  if (node() == nullptr || !node()->is_open()) return 0;
  return static_cast<const detail::OutputNode*>(node())->safe_value();  // it never changes
}
bool Output::is_armed() const noexcept {
  return asked(node(), false, false, [](const detail::OutputNode& output) { return output.is_armed(); });
}
void Output::when_published(Callback<void()> done) {
  with(node(), 0, [done = std::move(done)](detail::OutputNode& output) mutable {
    output.when_published(std::move(done));
    return 0;
  });
}
void Output::when_taken(Callback<void(Result<void>)> done) {
  with(node(), 0, [done = std::move(done)](detail::OutputNode& output) mutable {
    output.when_taken(std::move(done));
    return 0;
  });
}
void Output::finish(Callback<void()> done) {
  with(node(), 0, [done = std::move(done)](detail::OutputNode& output) mutable {
    output.finish(std::move(done));
    return 0;
  });
}
Duration Output::lease_left() const noexcept {
  return asked(node(), Duration{0}, Duration{0}, [](const detail::OutputNode& output) { return output.lease_left(); });
}
bool Output::has_ended_unsafe() const noexcept {
  return asked(node(), false, true, [](const detail::OutputNode& output) { return output.has_ended_unsafe(); });
}
bool Output::is_safe() const noexcept {
  return asked(node(), false, false, [](const detail::OutputNode& output) { return output.is_safe(); });
}
std::optional<double> Output::value() const noexcept {
  return asked(node(), std::optional<double>{}, std::optional<double>{},
               [](const detail::OutputNode& output) { return output.value(); });
}
bool Output::is_guarded() const noexcept {
  return asked(node(), false, false, [](const detail::OutputNode& output) { return output.is_guarded(); });
}

}  // namespace rtdata
