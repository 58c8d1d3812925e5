#include "sensors/core/sensor_node.hpp"

#include <algorithm>

namespace rtdata::detail {
namespace {

constexpr std::string_view loop_held = "loop held";

void check_rate(Rate rate, const std::string& name) {
  if (rate && rate.period() >= std::chrono::microseconds{1}) return;
  throw SetupError({Errc::bad_argument, "cannot use this rate", "sensor " + name,
                    rate ? "its period is " + to_string(rate.period()) : "a sensor needs a rate",
                    "set `rate` to at most 1 MHz, such as 10_Hz"});
}

}  // namespace

SensorNode::SensorNode(LoopCore& loop, const SensorConfig& config, PayloadType type,
                       std::unique_ptr<SensorDevice> device)
    : SourceNode(loop, config.name, config.topic, std::move(type), OriginCore::Supply::schedule, config.process,
                 config.warm_up),
      RateMember(config.rate.period()),
      device_(std::move(device)) {
  set_settings(config);
}

SensorNode::SensorNode(LoopCore& loop, const SensorConfig& config, PayloadType type, std::unique_ptr<LaneDevice> device)
    : SourceNode(loop, config.name, config.topic, std::move(type), OriginCore::Supply::schedule, config.process,
                 config.warm_up, device->identity_by_word()),
      RateMember(config.rate.period()) {
  extra().lane_side = std::make_unique<LaneSide>(*this, std::move(device));
  loop.deadlines.reserve_one();
  set_settings(config);
}

void SensorNode::set_settings(const SensorConfig& config) {
  const SensorConfig usual;
  if (config.late_after != usual.late_after || config.read_time || config.retry_first != usual.retry_first ||
      config.retry_longest != usual.retry_longest || config.faulted_after != usual.faulted_after ||
      config.required != usual.required || config.phase != usual.phase || config.on_overrun != usual.on_overrun) {
    Extra& own = extra();
    own.phase = config.phase;
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

const SensorNode::Extra& SensorNode::settings() const noexcept {
  static const Extra usual{};
  const Extra* own = extra_if_any();
  return own != nullptr ? *own : usual;
}

void SensorNode::start() {
  if (!is_open() || is_running()) return;
  Call call(*this);
  restart_filters();
  if (Extra* state = extra_if_any()) {
    state->failures = 0;
    state->backoff.reset();
    state->retry_at = {};
  }
  if (device_is_open_) return begin_schedule();
  if (lane_side() != nullptr) return start_on_lane();
  LoopCore& on = *loop();
  const Result<void> opened = open_device();
  if (!opened && settings().is_required) throw SetupError(opened.error());
  if (!is_open()) {  // closed by its own device
    if (opened) close_device(on);
    return;
  }
  if (is_running()) return;  // started by it
  started(opened);
}

void SensorNode::started(const Result<void>& opened) {
  device_is_open_ = static_cast<bool>(opened);
  if (opened) begin_warm_up();
  begin_schedule();  // before a handler runs, which may stop it
  if (opened) {
    set_health(Health::ok, nullptr);  // the state before the stop has ended
  } else {
    extra().failures = settings().faulted_after - 1;
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

/// For a read on the loop, counted as begun. Uses the row's time, because the account and the rows are compared.
bool SensorNode::is_late(const SamplePort& port) noexcept {
  return port.tick_->lateness() + port.pushed_ > port.late_after_;
}

void SensorNode::end_schedule(EndOf what) {
  if (!is_scheduled()) return;
  miss_kept_tick();
  count_read_begun();
  if (port_ != nullptr && what == EndOf::activity) {
    if (port_->is_usable_) {
      origin_.end_read(is_late(*port_));
    } else {
      origin_.fail_read(stopped, port_->tick_->due);
    }
  }
  // Due ticks that are overdue by more than the tolerance were missed; a tick that is just due has not begun.
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
  if (is_starting()) cancel_opening();
  if (!is_scheduled()) return;
  miss_kept_tick();
  loop()->schedule().remove(*this);
  loop()->unref();
  origin_.end_segment(end);
}

void SensorNode::stop() {
  if (!is_open()) return;
  Call call(*this);  // the device's close() may do so to this
  origin_.set_absence_period(Duration{0});
  cancel_opening();
  cancel_transaction();
  count_unread();
  end_schedule(EndOf::activity);
  if (SamplePort* port = std::exchange(port_, nullptr)) port->sensor_ = nullptr;
  origin_.close_gap();
  origin_.topic.cancel(origin_);
  if (std::exchange(device_is_open_, false)) close_device(*loop());
}

/// Counts samples that a device with a FIFO took during a fault at the end of the schedule.
void SensorNode::count_unread() noexcept {
  LaneSide* const side = lane_side();
  if (side == nullptr || side->device == nullptr) return;
  const std::uint64_t unread = side->device->stopped(loop()->now());
  if (settings().failures > 0 && unread > 0) count_lost(unread);
}

void SensorNode::set_rate(Rate rate) {
  check_rate(rate, origin_.name);
  if (!is_open()) return;
  if (Extra* state = extra_if_any()) state->wanted_period = Duration{0};
  if (rate.period() != period()) change_period(rate.period());
}

void SensorNode::change_period(Duration period) {
  if (!is_scheduled()) return set_period(period);
  end_schedule(EndOf::rate);
  set_period(period);
  begin_schedule();
}

std::optional<SensorLoad> SensorNode::load() const {
  SensorLoad load{origin_.name, period(), phase(), {}};
  const LaneSide* side = lane_side();
  load.time = side != nullptr ? side->device->read_time() : device_->read_time();
  if (side != nullptr && load.time.lane.empty()) load.time.lane = side->device->lane_key();
  if (settings().read_time) (side != nullptr ? load.time.on_lane : load.time.on_loop) = settings().read_time;
  return load;
}

bool SensorNode::report_times(CallbackStatus& status) const {
  status.name = object_name();
  status.times = times;
  return true;
}

void SensorNode::held(Duration took) {
  constexpr int slowest = 16;  // times the wanted period
  Extra* const own = extra_if_any();
  if (own == nullptr || own->on_overrun == OnOverrun::warn) return;
  Call call(*this);
  const std::string lasted = "a read held the loop for " + to_string(took / 1000 * 1000);
  if (own->on_overrun == OnOverrun::stop) {
    stop();
    const Error error{Errc::held_too_long, "stopped", object_name(), lasted,
                      "make its read shorter, or read it on a lane; then start it again"};
    report(error);
    if (is_open() && !is_running()) set_health(Health::faulted, &error);
    return;
  }
  if (own->wanted_period.count() == 0) own->wanted_period = period();
  const Duration wanted = own->wanted_period;
  const Duration next = std::min(multiple(2, period()), multiple(slowest, wanted));
  if (next == period()) return;
  change_period(next);
  report({Errc::held_too_long, "slowed down to one read every " + to_string(next), object_name(), lasted,
          "make its read shorter, or read it on a lane; the configured period is " + to_string(wanted)});
}

void SensorNode::on_close() noexcept {
  stop();
  if (lane_side() != nullptr) loop()->deadlines.release_one();
  leave();
}

void SensorNode::drop_callbacks() noexcept {
  SourceNode::drop_callbacks();
  device_ = nullptr;
  if (LaneSide* side = lane_side()) side->device = nullptr;
}

Result<void> SensorNode::open_device() noexcept {
  const LoopCore::Calling user_code(loop()->runtime);
  try {
    return device_->open();
  } catch (...) {
    return thrown("open() threw");
  }
}

void SensorNode::close_device(LoopCore& on) noexcept {
  if (lane_side() != nullptr) return close_on_lane();
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
      return {Errc::handler_threw, what, object_name(), std::string(reason_of(e)), ""};
    } catch (...) {
      return {Errc::handler_threw, what, object_name(), "an exception that is not a std::exception", ""};
    }
  } catch (...) {  // no memory even for an error: uses texts that need none
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
  if (opened) begin_warm_up();
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
    miss_kept_tick();
    origin_.miss(tick.missed, loop_held, tick.due - static_cast<std::int64_t>(tick.missed) * period());
  }
  Call call(*this);
  loop()->nodes.begins(this);
  if (device_ == nullptr) return tick_on_lane(tick);
  const bool was_ready = device_is_open_ && health() != Health::faulted;
  if (!was_ready && !make_ready(tick)) [[unlikely]]
    return;
  read_inline(tick);
}

void SensorNode::read_inline(const Tick& tick) {
  SamplePort port(*this, tick.due, loop()->runtime.event_time(tick.now), &tick);
  port_ = &port;
  Sampled sampled;
  is_unusable_ = false;
  try {
    sampled = device_->sample(port);
  } catch (...) {
    sampled = port.fail(thrown("reading threw"));
  }
  if (port.sensor_ == nullptr) return;  // the sensor stopped itself meanwhile; stopping has counted this tick
  port_ = nullptr;
  if (has_failed(sampled, port)) [[unlikely]] {
    if (!is_unusable(sampled)) return fail(port, *port.error_, tick);
    count_failed(port, *port.error_, tick);
    return complain(*port.error_);
  }
  if (port.is_begun_) [[unlikely]] {
    origin_.end_read(is_late(port));
  } else {
    origin_.read_at_once(tick.lateness() + port.pushed_);
  }
  took(sampled, port);
}

void SensorNode::count_failed(const SamplePort& port, const Error& error, const Tick& tick) noexcept {
  if (port.is_begun_) {
    origin_.fail_read(error.id(), tick.due);
  } else {
    origin_.fail_tick(error.id(), tick.due);
  }
}

void SensorNode::fail(const SamplePort& port, const Error& error, const Tick& tick) {
  count_failed(port, error, tick);
  failed(error, tick.now);  // only now, because the handler may stop the sensor
}

void SensorNode::recovered() {
  extra().failures = 0;
  extra().backoff.reset();
  set_health(Health::ok, nullptr);
}

void SensorNode::complain(const Error& error) {
  forget_failures();  // earlier ones are no longer consecutive
  report(error);
  if (is_open()) set_health(Health::degraded, &error);
}

void SensorNode::failed(const Error& error, MonotonicTime now) {
  Extra& state = extra();
  ++state.failures;
  state.fault = error.id();
  const bool is_faulted = state.failures >= state.faulted_after;
  if (is_faulted) {
    state.retry_at = later(now, state.backoff.next(state.retry_first, state.retry_longest, origin_.name));
    if (std::exchange(device_is_open_, false)) close_device(*origin_.topic.runtime().own_loop);
  }
  report(error);
  if (is_open()) set_health(is_faulted ? Health::faulted : Health::degraded, &error);
}

namespace {

template <class Device>
Node* make(Loop& loop, const SensorConfig& config, PayloadType type, std::unique_ptr<Device> device) {
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

}  // namespace

Node* make_sensor(Loop& loop, SensorConfig config, PayloadType type, std::unique_ptr<SensorDevice> device) {
  return make(loop, config, std::move(type), std::move(device));
}
Node* make_sensor(Loop& loop, SensorConfig config, PayloadType type, std::unique_ptr<LaneDevice> device) {
  return make(loop, config, std::move(type), std::move(device));
}

}  // namespace rtdata::detail
