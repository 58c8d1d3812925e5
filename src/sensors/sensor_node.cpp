#include "sensors/sensor_node.hpp"

#include <algorithm>

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

SensorNode::SensorNode(LoopCore& loop, const SensorConfig& config, PayloadType type, std::unique_ptr<SensorDevice> device)
    : SourceNode(loop, config.name, config.topic, std::move(type)),
      device_(std::move(device)),
      lane_device_(dynamic_cast<LaneDevice*>(device_.get())),
      period_(config.rate.period()),
      phase_(config.phase),
      late_after_(config.late_after.value_or(Duration{-1})),
      retry_first_(config.retry_first),
      retry_longest_(std::max(config.retry_longest, config.retry_first)),
      faulted_after_(std::max(config.faulted_after, 1u)),
      required_(config.required) {
  set_companion(&origin_);
}

SensorNode::~SensorNode() = default;

void SensorNode::start() {
  if (!is_open() || is_running()) return;
  failures_ = 0;
  retry_delay_ = Duration{0};
  retry_at_ = {};
  if (!device_is_open_) {
    const Result<void> opened = open_device();
    if (opened) {
      device_is_open_ = true;
    } else if (required_) {
      throw SetupError(opened.error());
    } else {
      failures_ = faulted_after_ - 1;
      failed(opened.error(), loop()->now());
    }
  }
  begin_schedule();
}

void SensorNode::begin_schedule() {
  origin_.late_after = late_after_.count() >= 0 ? late_after_ : std::max(Duration{std::chrono::milliseconds{1}}, period_ / 10);
  loop()->hold();
  loop()->schedule().add(*this, period_, phase_);
}

void SensorNode::schedule_began() { origin_.begin_segment(first_due(), period_); }

void SensorNode::end_schedule(EndOf what) {
  if (!is_scheduled()) return;
  if (const Tick* tick = std::exchange(sampling_, nullptr)) {
    if (what == EndOf::rate) {
      origin_.read_at_once(tick->lateness());
    } else if (published_) {
      origin_.read_at_once(tick->lateness());
      ++origin_.counts.published;
    } else {
      origin_.fail_tick(stopped, tick->due);
    }
  }
  // Ticks that came due and are overdue by more than the tolerance were missed; one that is due just now has not begun.
  const MonotonicTime now = loop()->now();
  MonotonicTime next = next_due();
  if (now - next > origin_.late_after) {
    const auto count = (now - origin_.late_after - next) / period_ + 1;
    origin_.miss(static_cast<std::uint64_t>(count), loop_held, next);
    next += count * period_;
  }
  stop_schedule(std::min(now, next - Duration{1}));
}

void SensorNode::stop_schedule(MonotonicTime end) {
  if (!is_scheduled()) return;
  loop()->schedule().remove(*this);
  loop()->unhold();
  origin_.end_segment(end);
}

void SensorNode::stop() {
  if (!is_open()) return;
  ++runs_;
  cancel_transaction();
  end_schedule(EndOf::activity);
  origin_.close_gap();
  origin_.topic.cancel(origin_);
  if (std::exchange(device_is_open_, false)) device_->close();
}

void SensorNode::set_rate(Rate rate) {
  check_rate(rate, origin_.name);
  if (!is_open() || rate.period() == period_) return;
  if (!is_running()) {
    period_ = rate.period();
    return;
  }
  end_schedule(EndOf::rate);
  period_ = rate.period();
  begin_schedule();
}

void SensorNode::cancel_transaction() {
  if (transaction_ == nullptr) return;
  if (origin_.counts.in_flight != 0) {
    origin_.fail_read(stopped, transaction_->due_);
    transaction_->owner_ = nullptr;
    transaction_->is_unwanted_.store(true, std::memory_order_relaxed);
  }
  transaction_ = nullptr;
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
  lane_ = nullptr;  // what is opened may be another physical device than before
  try {
    return device_->open();
  } catch (const std::exception& e) {
    return Error{Errc::handler_threw, "open() threw", object_name(), e.what(), ""};
  } catch (...) {
    return Error{Errc::handler_threw, "open() threw", object_name(), "an exception that is no std::exception", ""};
  }
}

bool SensorNode::is_ready(MonotonicTime now) {
  if (device_is_open_ && health() != Health::faulted) [[likely]] return true;
  if (now < retry_at_) return false;
  if (device_is_open_) return true;
  const Result<void> opened = open_device();
  if (opened) {
    device_is_open_ = true;
    return true;
  }
  failed(opened.error(), now);
  return false;
}

void SensorNode::tick(const Tick& tick) {
  if (tick.missed > 0) [[unlikely]] {
    origin_.miss(tick.missed, loop_held, tick.due - static_cast<std::int64_t>(tick.missed) * period_);
  }
  if (lane_device_ != nullptr && origin_.counts.in_flight != 0) {
    origin_.miss(1, still_reading, tick.due);
    return;
  }
  Call call(*this);
  if (!is_ready(tick.now)) {
    if (is_scheduled()) origin_.fail_tick(fault_, tick.due);
    return;
  }
  if (lane_device_ != nullptr) {
    submit(tick);
  } else {
    read_inline(tick);
  }
}

void SensorNode::read_inline(const Tick& tick) {
  read_time_ = loop()->runtime.event_time(tick.now);
  published_ = false;
  publishing_run_ = runs_;
  sampling_ = &tick;
  Error error;
  Sampled sampled = Sampled::failed;
  try {
    sampled = device_->sample(*this, error);
  } catch (const std::exception& e) {
    error = {Errc::handler_threw, "reading threw", object_name(), e.what(), ""};
  } catch (...) {
    error = {Errc::handler_threw, "reading threw", object_name(), "an exception that is no std::exception", ""};
  }
  if (publishing_run_ != runs_) return;  // it stopped itself meanwhile, which has counted this tick
  if (std::exchange(sampling_, nullptr) == nullptr) {  // it changed its rate meanwhile, which has counted it as taken
    took(sampled == Sampled::failed ? Sampled::nothing_new : sampled);
    return;
  }
  if (sampled == Sampled::failed) [[unlikely]] {
    fault_ = error.id();
    origin_.fail_tick(fault_, tick.due);
    failed(error, tick.now);
    return;
  }
  origin_.read_at_once(tick.lateness());
  took(sampled);
}

void SensorNode::publish(void* payload, Time time) {
  if (publishing_run_ != runs_) return;  // stopped by its own sampling function
  published_ = true;
  origin_.topic.publish(origin_, time, payload);
}

void SensorNode::took(Sampled sampled) {
  if (sampled == Sampled::value) {
    if (published_) ++origin_.counts.published;
  } else {
    ++origin_.counts.repeated;
  }
  if (failures_ != 0) [[unlikely]] {
    failures_ = 0;
    retry_delay_ = Duration{0};
    set_health(Health::ok, nullptr);
  }
}

void SensorNode::failed(const Error& error, MonotonicTime now) {
  fault_ = error.id();
  ++failures_;
  if (failures_ >= faulted_after_) {
    retry_delay_ = retry_delay_.count() == 0 ? retry_first_ : std::min(2 * retry_delay_, retry_longest_);
    retry_at_ = now + with_jitter(retry_delay_, origin_.name, failures_);
    if (std::exchange(device_is_open_, false)) device_->close();
  }
  report(error);
  if (is_open()) set_health(failures_ >= faulted_after_ ? Health::faulted : Health::degraded, &error);
}

void SensorNode::submit(const Tick& tick) {
  if (transaction_ == nullptr) {
    transaction_ = lane_device_->make_transaction();
    transaction_->owner_ = this;
    transaction_->loop_ = loop()->is_manual() ? loop() : nullptr;
  }
  Transaction& transaction = *transaction_;
  transaction.due_ = tick.due;
  origin_.begin_read();
  if (lane_ == nullptr) lane_ = &loop()->lane(lane_device_->lane_key(), lane_device_->give_up_after());
  if (!lane_->submit(transaction_)) {
    const Error error = lane_->is_stuck() ? lane_device_->given_up_error()
                                          : Error{Errc::busy, "cannot read", object_name(),
                                                  "its lane is full of reads of sensors that share the device", "lower their rates"};
    origin_.fail_read(error.id(), tick.due);
    failed(error, tick.now);
  }
}

void SensorNode::transaction_done(Transaction& transaction, LaneJob::Outcome outcome) {
  Call call(*this);
  if (outcome != LaneJob::Outcome::finished) {
    const Error error = outcome == LaneJob::Outcome::given_up
                            ? lane_device_->given_up_error()
                            : Error{Errc::closed, "read was cancelled", object_name(), "its lane was closed", ""};
    transaction_ = nullptr;
    origin_.fail_read(error.id(), transaction.due_);
    failed(error, loop()->now());
    return;
  }
  read_time_ = loop()->runtime.event_time(transaction.began_);
  published_ = false;
  publishing_run_ = runs_;
  Error error;
  const Sampled sampled = lane_device_->decode(transaction, *this, error);
  if (sampled == Sampled::failed) {
    origin_.fail_read(error.id(), transaction.due_);
    failed(error, loop()->now());
    return;
  }
  origin_.end_read(transaction.began_ - transaction.due_);
  took(sampled);
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

detail::SourceNode* source(detail::Node* node) noexcept {
  return node != nullptr && node->is_open() ? static_cast<detail::SourceNode*>(node) : nullptr;
}

}  // namespace

void AnySensor::start() {
  if (auto* s = source(node())) s->start();
}
void AnySensor::stop() {
  if (auto* s = source(node())) s->stop();
}
bool AnySensor::is_running() const noexcept {
  auto* s = source(node());
  return s != nullptr && s->is_running();
}
void AnySensor::set_rate(Rate rate) {
  if (auto* s = source(node())) s->set_rate(rate);
}
Rate AnySensor::rate() const noexcept {
  auto* s = source(node());
  return s != nullptr ? s->rate() : Rate{};
}
SensorCounts AnySensor::counts() const noexcept {
  auto* s = source(node());
  return s != nullptr ? s->counts() : SensorCounts{};
}
Health AnySensor::health() const noexcept {
  auto* s = source(node());
  return s != nullptr ? s->health() : Health::ok;
}
SensorStatus AnySensor::status() const {
  auto* s = source(node());
  return s != nullptr ? s->status() : SensorStatus{};
}
CallbackTimes AnySensor::times() const noexcept {
  auto* s = source(node());
  return s != nullptr ? s->callback_times() : CallbackTimes{};
}
void AnySensor::on_error(Callback<void(const ErrorReport&)> handler) {
  if (auto* s = source(node())) s->set_on_error(std::move(handler));
}

}  // namespace rtdata
