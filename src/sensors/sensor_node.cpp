#include "sensors/sensor_node.hpp"

#include <algorithm>

#include "loop/no_thread.hpp"
#include "loop/retry.hpp"

namespace rtdata {
namespace detail {
namespace {

constexpr std::string_view loop_held = "loop held";
constexpr std::string_view still_reading = "still reading";
constexpr std::string_view stopped = "stopped";

void check_rate(Rate rate, const std::string& name) {
  if (rate && rate.period() >= std::chrono::microseconds{1}) return;
  throw SetupError({Errc::bad_argument, "cannot use this rate", "sensor " + name,
                    rate ? "its period is " + to_string(rate.period()) : "a sensor needs a rate",
                    "set `rate` to something up to 1 MHz, such as 10_Hz"});
}

}  // namespace

SensorNode::SensorNode(LoopCore& loop, const SensorConfig& config, PayloadType type,
                       std::unique_ptr<SensorDevice> device)
    : SourceNode(loop, config.name, config.topic, std::move(type), OriginCore::Supply::schedule),
      RateMember(config.rate.period(), config.phase),
      device_(std::move(device)) {
  if (auto* on_lane = dynamic_cast<LaneDevice*>(device_.get()))
    lane_side_.reset(new LaneSide{*on_lane, nullptr, nullptr});
  const SensorConfig usual;
  if (config.late_after != usual.late_after || config.read_time || config.retry_first != usual.retry_first ||
      config.retry_longest != usual.retry_longest || config.faulted_after != usual.faulted_after ||
      config.required != usual.required || config.on_overrun != usual.on_overrun) {
    Rare& own = rare();
    own.read_time = config.read_time;
    own.late_after = config.late_after.value_or(Duration{-1});
    own.retry_first = config.retry_first;
    own.retry_longest = std::max(config.retry_longest, config.retry_first);
    own.faulted_after = std::max(config.faulted_after, 1u);
    own.is_required = config.required;
    own.on_overrun = config.on_overrun;
  }
}

SensorNode::~SensorNode() = default;

SensorNode::Rare& SensorNode::rare() {
  if (rare_ == nullptr) rare_ = std::make_unique<Rare>();
  return *rare_;
}

const SensorNode::Rare& SensorNode::settings() const noexcept {
  static const Rare usual;
  return rare_ != nullptr ? *rare_ : usual;
}

void SensorNode::start() {
  if (!is_open() || is_running()) return;
  Call call(*this);
  failures_ = 0;
  if (rare_ != nullptr) {
    rare_->retry_delay = Duration{0};
    rare_->retry_at = {};
  }
  if (device_is_open_) return begin_schedule();
  LoopCore& on = *loop();
  const Result<void> opened = open_device();
  if (!opened && settings().is_required) throw SetupError(opened.error());
  if (!is_open()) {  // closed by its own device
    if (opened) close_device(on);
    return;
  }
  if (is_running()) return;  // started by it
  device_is_open_ = static_cast<bool>(opened);
  begin_schedule();  // before anybody is told, who may stop it
  if (opened) {
    set_health(Health::ok, nullptr);  // what it was before it stopped is over
  } else {
    failures_ = settings().faulted_after - 1;
    failed(opened.error(), loop()->now());
  }
}

void SensorNode::begin_schedule() {
  const Duration late_after = settings().late_after;
  origin_.late_after = late_after.count() >= 0 ? late_after
                                               : std::max(Duration{std::chrono::milliseconds{1}}, period() / 10);
  loop()->schedule().add(*this);
  loop()->ref();
}

void SensorNode::schedule_began() { origin_.begin_segment(first_due(), period()); }

void SensorNode::count_read_begun() noexcept {
  if (port_ == nullptr || std::exchange(port_->is_begun_, true)) return;
  port_->late_after_ = origin_.late_after;
  origin_.begin_read();
}

/// A read on the loop that is counted as begun. As late as its row says, since the account and the rows are compared.
bool SensorNode::is_late(const SamplePort& port) noexcept {
  return port.tick_->lateness() + port.pushed_ > port.late_after_;
}

void SensorNode::end_schedule(EndOf what) {
  if (!is_scheduled()) return;
  count_read_begun();
  if (port_ != nullptr && what == EndOf::activity) {
    if (port_->is_usable_) {
      origin_.end_read(is_late(*port_));
    } else {
      origin_.fail_read(stopped, port_->tick_->due);
    }
  }
  // Ticks that came due and are overdue by more than the tolerance were missed; one that is due just now has not begun.
  const MonotonicTime now = loop()->now();
  MonotonicTime next = next_due();
  if (span_between(next, now) > origin_.late_after) {
    const auto count = (now - origin_.late_after - next) / period() + 1;
    origin_.miss(static_cast<std::uint64_t>(count), loop_held, next);
    next += count * period();
  }
  stop_schedule(std::min(now, later(next, Duration{-1})));
}

void SensorNode::stop_schedule(MonotonicTime end) {
  if (!is_scheduled()) return;
  loop()->schedule().remove(*this);
  loop()->unref();
  origin_.end_segment(end);
}

void SensorNode::stop() {
  if (!is_open()) return;
  Call call(*this);  // the device's close() may do so to this
  cancel_transaction();
  end_schedule(EndOf::activity);
  if (SamplePort* port = std::exchange(port_, nullptr)) port->sensor_ = nullptr;
  origin_.close_gap();
  origin_.topic.cancel(origin_);
  if (std::exchange(device_is_open_, false)) close_device(*loop());
}

void SensorNode::set_rate(Rate rate) {
  check_rate(rate, origin_.name);
  if (!is_open()) return;
  if (rare_ != nullptr) rare_->wanted_period = Duration{0};
  if (rate.period() != period()) change_period(rate.period());
}

void SensorNode::change_period(Duration period) {
  if (!is_running()) return set_period(period);
  end_schedule(EndOf::rate);
  set_period(period);
  begin_schedule();
}

std::optional<SensorLoad> SensorNode::load() const {
  SensorLoad load{origin_.name, period(), phase(), device_->read_time()};
  if (lane_side_ != nullptr && load.time.lane.empty()) load.time.lane = lane_side_->device.lane_key();
  if (settings().read_time) (lane_side_ != nullptr ? load.time.on_lane : load.time.on_loop) = settings().read_time;
  return load;
}

bool SensorNode::tell_times(CallbackStatus& status) const {
  status.name = object_name();
  status.times = times;
  return true;
}

void SensorNode::held(Duration took) {
  constexpr int slowest = 16;  // times the wanted period
  if (rare_ == nullptr || rare_->on_overrun == OnOverrun::warn) return;
  Call call(*this);
  const std::string lasted = "a read held the loop for " + to_string(took / 1000 * 1000);
  if (rare_->on_overrun == OnOverrun::stop) {
    stop();
    const Error error{Errc::held_too_long, "stopped", object_name(), lasted,
                      "make its read shorter, or read it on a lane; then start it again"};
    report(error);
    if (is_open() && !is_running()) set_health(Health::faulted, &error);
    return;
  }
  if (rare_->wanted_period.count() == 0) rare_->wanted_period = period();
  const Duration wanted = rare_->wanted_period;
  const Duration next = std::min(multiple(2, period()), multiple(slowest, wanted));
  if (next == period()) return;
  change_period(next);
  report({Errc::held_too_long, "slowed down to one in " + to_string(next), object_name(), lasted,
          "make its read shorter, or read it on a lane; wanted is one in " + to_string(wanted)});
}

void SensorNode::cancel_transaction() {
  if (lane_side_ == nullptr || lane_side_->transaction == nullptr) return;
  const auto transaction = std::exchange(lane_side_->transaction, nullptr);
  if (port_ != nullptr || origin_.counts.in_flight == 0) return;  // what is in flight is not this
  origin_.fail_read(stopped, transaction->due_);
  transaction->owner_ = nullptr;
  transaction->is_unwanted_.store(true, std::memory_order_relaxed);
}

void SensorNode::on_close() noexcept {
  stop();
  leave();
}

void SensorNode::drop_callbacks() noexcept {
  SourceNode::drop_callbacks();
  device_ = nullptr;
}

Result<void> SensorNode::open_device() noexcept {
  if (lane_side_ != nullptr) lane_side_->lane = nullptr;  // what is opened may be another physical device than before
  const LoopCore::Calling user_code(loop()->runtime);
  try {
    return device_->open();
  } catch (...) {
    return thrown("open() threw");
  }
}

void SensorNode::close_device(LoopCore& on) noexcept {
  const LoopCore::Calling user_code(on.runtime);
  try {
    device_->close();
  } catch (...) {
    report(thrown("close() threw"));
  }
}

Error SensorNode::thrown(const char* what) const noexcept {
  try {
    try {
      throw;
    } catch (const std::exception& e) {
      return {Errc::handler_threw, what, object_name(), e.what(), ""};
    } catch (...) {
      return {Errc::handler_threw, what, object_name(), "an exception that is no std::exception", ""};
    }
  } catch (...) {  // no memory, not even for an error: texts that need none
    return {Errc::handler_threw, "cannot read", "", "no memory", ""};
  }
}

bool SensorNode::make_ready(const Tick& tick) {
  if (tick.now < settings().retry_at) {
    origin_.fail_tick(settings().fault, tick.due);
    return false;
  }
  if (device_is_open_) return true;
  SamplePort port(*this, tick.due, Time{},
                  &tick);  // the device may stop the sensor, or change its rate, as it may in a read
  port_ = &port;
  LoopCore& on = *loop();
  const Result<void> opened = open_device();
  if (port.sensor_ == nullptr) {  // it was stopped; and if it was started again, opened again
    if (opened && !device_is_open_) close_device(on);
    return false;
  }
  port_ = nullptr;
  device_is_open_ = static_cast<bool>(opened);
  if (opened && !port.is_begun_) return true;
  if (opened) {  // the schedule of this tick may be over
    origin_.end_read(is_late(port));
    is_not_one_a_read();
    return false;
  }
  fail(port, opened.error(), tick);
  return false;
}

void SensorNode::prefetch() const noexcept {
  __builtin_prefetch(&origin_.sequence, 1);
  __builtin_prefetch(&origin_.counts.published, 1);
  __builtin_prefetch(device_.get());
}

void SensorNode::tick(const Tick& tick) {
  if (tick.missed > 0) [[unlikely]] {
    origin_.miss(tick.missed, loop_held, tick.due - static_cast<std::int64_t>(tick.missed) * period());
  }
  if (lane_side_ != nullptr && origin_.counts.in_flight != 0) {
    origin_.miss(1, still_reading, tick.due);
    return;
  }
  Call call(*this);
  loop()->nodes.begins(this);
  const bool was_ready = device_is_open_ && health() != Health::faulted;
  if (!was_ready && !make_ready(tick)) [[unlikely]]
    return;
  if (lane_side_ != nullptr) {
    submit(tick);
  } else {
    read_inline(tick);
  }
}

void SamplePort::publish(void* payload, Time time) {
  if (sensor_ == nullptr) return;  // stopped by its own sampling function
  is_usable_ = true;
  if (std::exchange(has_sample_, true) || time != time_) sensor_->is_not_one_a_read();
  const bool is_of_read = sensor_->origin().counts.is_one_a_read;
  const Time row = sensor_->publish(payload, time, due_);
  if (is_of_read) pushed_ = span_between(time, row);
}

void SamplePort::repeated() noexcept {
  if (sensor_ == nullptr) return;
  is_usable_ = true;
  if (std::exchange(has_sample_, true)) sensor_->is_not_one_a_read();
  sensor_->count_repeated();
}

Sampled SamplePort::unreadable(Error error) {
  if (sensor_ != nullptr) {
    if (std::exchange(has_sample_, true)) sensor_->is_not_one_a_read();
    sensor_->count_unreadable();
  }
  return fail(std::move(error));
}

Time SensorNode::publish(void* payload, Time time, MonotonicTime due) {
  ++origin_.counts.received;
  ++origin_.counts.published;
  try {
    origin_.topic.publish(origin_, time, payload);
    origin_.count_lateness(due);
  } catch (...) {  // published, and dropped for those who subscribe
    origin_.count_lateness(due);
    report(thrown("moving its payload threw"));
  }
  return origin_.last_time;
}

inline void SensorNode::took(Sampled sampled, const SamplePort& port) {
  if ((sampled == Sampled::nothing_new) == port.has_sample_) is_not_one_a_read();
  if (sampled == Sampled::nothing_new) count_repeated();
  if (port.error_) [[unlikely]]
    return complain(*port.error_);
  if (health() != Health::ok) [[unlikely]]
    recovered();
}

void SensorNode::read_inline(const Tick& tick) {
  SamplePort port(*this, tick.due, loop()->runtime.event_time(tick.now), &tick);
  port_ = &port;
  Sampled sampled;
  try {
    sampled = device_->sample(port);
  } catch (...) {
    sampled = port.fail(thrown("reading threw"));
  }
  if (port.sensor_ == nullptr) return;  // it stopped itself meanwhile, which has counted this tick
  port_ = nullptr;
  if (has_failed(sampled, port)) [[unlikely]]
    return fail(port, *port.error_, tick);
  if (port.is_begun_) [[unlikely]] {
    origin_.end_read(is_late(port));
  } else {
    origin_.read_at_once(tick.lateness() + port.pushed_);
  }
  took(sampled, port);
}

void SensorNode::fail(const SamplePort& port, const Error& error, const Tick& tick) {
  if (port.is_begun_) {
    origin_.fail_read(error.id(), tick.due);
  } else {
    origin_.fail_tick(error.id(), tick.due);
  }
  failed(error, tick.now);  // only now, since who is told may stop the sensor
}

void SensorNode::recovered() {
  failures_ = 0;
  rare().retry_delay = Duration{0};
  set_health(Health::ok, nullptr);
}

void SensorNode::complain(const Error& error) {
  failures_ = 0;  // those before it are no row any more
  report(error);
  if (is_open()) set_health(Health::degraded, &error);
}

void SensorNode::failed(const Error& error, MonotonicTime now) {
  ++failures_;
  Rare& state = rare();
  state.fault = error.id();
  const bool is_faulted = failures_ >= state.faulted_after;
  if (is_faulted) {
    state.retry_delay = state.retry_delay.count() == 0 ? state.retry_first
                                                       : doubled(state.retry_delay, state.retry_longest);
    state.retry_at = later(now, with_jitter(state.retry_delay, origin_.name, failures_));
    if (std::exchange(device_is_open_, false)) close_device(*origin_.topic.runtime().own_loop);
  }
  report(error);
  if (is_open()) set_health(is_faulted ? Health::faulted : Health::degraded, &error);
}

void SensorNode::submit(const Tick& tick) {
  auto& [device, lane, transaction] = *lane_side_;
  if (transaction == nullptr) {
    try {
      transaction = device.make_transaction();
    } catch (...) {
      const Error error = thrown("preparing to read threw");
      origin_.fail_tick(error.id(), tick.due);
      return failed(error, tick.now);
    }
    transaction->owner_ = this;
    transaction->loop_ = loop()->is_manual() ? loop() : nullptr;
  }
  transaction->due_ = tick.due;
  transaction->late_after_ = origin_.late_after;
  origin_.begin_read();
  try {
    if (lane == nullptr) lane = &loop()->lanes.of(device.lane_key(), device.give_up_after());
    if (lane->submit(transaction)) return;
  } catch (...) {
    const Error error = thrown("handing its read to a lane threw");
    origin_.fail_read(error.id(), tick.due);
    return failed(error, tick.now);
  }
  const Error error = told([this] {
    if (lane_side_->lane->lacks_thread()) return no_thread("cannot read", object_name());
    return lane_side_->lane->is_stuck()
               ? lane_side_->device.given_up_error()
               : Error{Errc::busy, "cannot read", object_name(),
                       "its lane is full of reads of sensors that share the device", "lower their rates"};
  });
  origin_.fail_read(error.id(), tick.due);
  failed(error, tick.now);
}

void SensorNode::transaction_done(Transaction& transaction, LaneJob::Outcome outcome) {
  Call call(*this);
  loop()->nodes.begins(this);
  LaneDevice& device = lane_side_->device;
  if (outcome != LaneJob::Outcome::finished) {
    const Error error = told([&] {
      return outcome == LaneJob::Outcome::given_up
                 ? device.given_up_error()
                 : Error{Errc::closed, "read was cancelled", object_name(), "its lane was closed", ""};
    });
    lane_side_->transaction = nullptr;
    origin_.fail_read(error.id(), transaction.due_);
    failed(error, loop()->now());
    return;
  }
  SamplePort port(*this, transaction.due_, loop()->runtime.event_time(transaction.began_), nullptr);
  Sampled sampled;
  try {
    sampled = device.decode(transaction, port);
  } catch (...) {
    sampled = port.fail(thrown("decoding threw"));
  }
  if (lane_side_->transaction.get() != &transaction) return;  // it was stopped meanwhile, which has counted this read
  if (has_failed(sampled, port)) {
    origin_.fail_read(port.error_->id(), transaction.due_);
    failed(*port.error_, loop()->now());
    return;
  }
  origin_.end_read(transaction.began_ - transaction.due_ + port.pushed_ > transaction.late_after_);
  took(sampled, port);
}

void Transaction::run() noexcept {
  if (is_unwanted_.load(std::memory_order_relaxed)) return;  // stopped while it waited: the device is left alone
  began_ = loop_ != nullptr ? loop_->now() : std::chrono::steady_clock::now();
  transact();
}

void Transaction::done(Outcome outcome) {
  if (owner_ != nullptr) owner_->transaction_done(*this, outcome);
}

Node* make_sensor(Loop& loop, SensorConfig config, PayloadType type, std::unique_ptr<SensorDevice> device) {
  check_rate(config.rate, config.name);
  auto* node = new SensorNode(loop.core(), config, std::move(type), std::move(device));
  try {
    if (config.start) node->start();
  } catch (...) {
    node->close();
    node->release();
    throw;
  }
  return node;
}

}  // namespace detail

namespace {

/// Calls with the node on its loop's thread: a tier's may be another one than this. `otherwise`: when it is closed.
template <class Returned, class Function>
Returned with(detail::Node* node, Returned otherwise, const Function& function) {
  if (node == nullptr || !node->is_open()) return otherwise;
  auto& source = static_cast<detail::SourceNode&>(*node);
  if (!source.loop()->runs_elsewhere()) return function(source);
  source.loop()->call_there([&] {
    if (source.is_open()) otherwise = function(source);
  });
  return otherwise;
}

template <class Function>
void with(detail::Node* node, const Function& function) {
  with(node, 0, [&](detail::SourceNode& source) {
    function(source);
    return 0;
  });
}

/// For what is refused where the loop may not be used.
template <class Function>
void change(detail::Node* node, const char* what, const Function& function) {
  with(node, [&](detail::SourceNode& source) {
    source.loop()->check_thread(what, source.origin().name);
    function(source);
  });
}

}  // namespace

void AnySensor::start() {
  change(node(), "cannot start sensor", [](auto& source) { source.start(); });
}
void AnySensor::stop() {
  change(node(), "cannot stop sensor", [](auto& source) { source.stop(); });
}
bool AnySensor::is_running() const noexcept {
  return with(node(), false, [](const auto& source) { return source.is_running(); });
}
void AnySensor::set_rate(Rate rate) {
  change(node(), "cannot change sensor", [&](auto& source) { source.set_rate(rate); });
}
Rate AnySensor::rate() const noexcept {
  return with(node(), Rate{}, [](const auto& source) { return source.rate(); });
}
SensorCounts AnySensor::counts() const noexcept {
  return with(node(), SensorCounts{}, [](const auto& source) { return source.counts(); });
}
Health AnySensor::health() const noexcept {
  return with(node(), Health::ok, [](const auto& source) { return source.health(); });
}
SensorStatus AnySensor::status() const {
  return with(node(), SensorStatus{}, [](const auto& source) { return detail::status_of(source); });
}
CallbackTimes AnySensor::times() const noexcept {
  return with(node(), CallbackTimes{}, [](const auto& source) { return source.callback_times(); });
}
void AnySensor::on_error(Callback<void(const ErrorReport&)> handler) {
  change(node(), "cannot set on_error of sensor", [&](auto& source) { source.set_on_error(std::move(handler)); });
}

}  // namespace rtdata
