// The lane side of a sensor whose device may block: opening, reading and closing on the lane.
#include <algorithm>
#include <utility>

#include "loop/core/lane_thread.hpp"
#include "loop/core/no_thread.hpp"
#include "sensors/core/sensor_node.hpp"

namespace rtdata::detail {
namespace {

constexpr std::string_view still_reading = "still reading";
// How long the start of a program waits for a device that is not required, so that the others can start.
constexpr Duration longest_start = std::chrono::seconds{1};

/// Closes the device of a transaction, after the transaction itself if it is running.
class Closing final : public LaneJob {
 public:
  explicit Closing(std::shared_ptr<Transaction> transaction) noexcept : transaction_(std::move(transaction)) {}
  void run() noexcept override { transaction_->close_unless_hung(); }
  void done(Outcome) override {}

 private:
  std::shared_ptr<Transaction> transaction_;
};

}  // namespace

void Transaction::run() noexcept {
  if (is_unwanted_.load(std::memory_order_relaxed)) return;  // stopped while it waited: the device is not touched
  if (!is_resumed_) began_ = lane_now();
  is_under_way_.store(true, std::memory_order_relaxed);
  transact();
  is_under_way_.store(false, std::memory_order_release);
  ended_ = lane_now();
}

void Transaction::close_unless_hung() noexcept {
  if (!is_under_way_.load(std::memory_order_acquire)) close();
}

void Transaction::done(Outcome outcome) {
  if (outcome != Outcome::finished) given_up();
  if (owner_ != nullptr) owner_->transaction_done(*this, outcome);
}

// ---- opening

bool SensorNode::is_starting() const noexcept {
  return lane_side() != nullptr && lane_side()->opening != nullptr && lane_side()->is_for_start;
}

void SensorNode::start_on_lane() {
  std::optional<Error> refusal;
  lane_side()->is_for_start = true;
  if (settings().is_required) lane_side()->refusal = &refusal;
  const Result<void> submitted = submit_opening();
  if (!submitted && settings().is_required) refusal = submitted.error();
  if (lane_side()->opening == nullptr && !refusal) {
    lane_side()->refusal = nullptr;
    return started(submitted);  // the handler may close this sensor
  }
  if (is_starting() && (loop()->is_being_set_up() || settings().is_required)) wait_for_start();
  lane_side()->refusal = nullptr;
  if (is_starting() && settings().is_required) {
    cancel_opening();
    refusal = lane_side()->device->given_up_error();
  }
  if (refusal) throw SetupError(*refusal);
}

void SensorNode::wait_for_start() {
  Lane& lane = *lane_side()->lane;
  const Duration limit = lane_side()->device->give_up_after();
  const MonotonicTime end = later(loop()->now(), settings().is_required ? limit : std::min(limit, longest_start));
  while (is_starting()) {  // others may be in front of it
    const Duration left = span_between(loop()->now(), end);
    if (left <= Duration{0}) return;
    lane.wait(left);
    if (!is_open()) return;
  }
}

void SensorNode::find_lane() {
  LaneDevice& device = *lane_side()->device;
  lane_side()->lane = &loop()->lanes.of(device.lane_key(), device.give_up_after(), device.lane_thread());
}

Result<void> SensorNode::submit_opening() {
  LaneSide& side = *lane_side();
  side.lane = nullptr;  // the opened device may differ from the earlier one
  side.transaction = nullptr;
  try {
    side.opening = side.device->make_opening();
    if (side.opening == nullptr) return {};
    side.opening->owner_ = this;
    find_lane();
    if (side.lane->submit(side.opening, side.device->give_up_after())) return {};
  } catch (...) {
    side.opening = nullptr;
    return thrown("open() threw");
  }
  side.opening = nullptr;
  return told([this] { return cannot_submit(); });
}

void SensorNode::opening_done(Transaction& opening, LaneJob::Outcome outcome) {
  LaneSide& side = *lane_side();
  const std::shared_ptr<Transaction> done = std::move(side.opening);
  side.opening = nullptr;
  Result<void> opened;
  if (outcome != LaneJob::Outcome::finished) {
    opened = told([&] {
      return outcome == LaneJob::Outcome::given_up
                 ? side.device->given_up_error()
                 : Error{Errc::closed, "opening was cancelled", object_name(), "its lane was closed", ""};
    });
  } else {
    const LoopCore::Calling user_code(loop()->runtime);
    side.opening = done;  // still running: an action of the device on the sensor ends it
    try {
      opened = side.device->take_opening(opening);
    } catch (...) {
      opened = thrown("open() threw");
    }
    if (side.opening != done) return;  // stopped meanwhile, which has counted the tick
    side.opening = nullptr;
  }
  if (side.is_for_start) {
    side.is_for_start = false;
    if (!opened && side.refusal != nullptr) {
      *side.refusal = opened.error();
      return;
    }
    return started(opened);
  }
  device_is_open_ = static_cast<bool>(opened);
  if (opened) return submit_read();
  fail_in_flight(opened.error());
}

void SensorNode::cancel_opening() noexcept {
  if (lane_side() == nullptr || lane_side()->opening == nullptr) return;
  const auto opening = std::exchange(lane_side()->opening, nullptr);
  opening->owner_ = nullptr;
  opening->is_unwanted_.store(true, std::memory_order_relaxed);
  if (!std::exchange(lane_side()->is_for_start, false)) origin_.fail_read(stopped, lane_side()->due);
}

// ---- reading

void SensorNode::tick_on_lane(const Tick& tick) {
  LaneSide& side = *lane_side();
  if (origin_.counts.in_flight != 0) return tick_in_flight(tick);
  if ((!device_is_open_ || health() == Health::faulted) && tick.now < settings().retry_at)
    return origin_.fail_tick(settings().fault, tick.due);
  side.due = tick.due;
  side.late_after = origin_.late_after;
  origin_.begin_read();
  if (device_is_open_) return submit_read();
  side.is_for_start = false;
  if (const Result<void> submitted = submit_opening(); !submitted) return fail_in_flight(submitted.error());
  if (side.opening != nullptr) return;
  device_is_open_ = true;
  submit_read();
}

void SensorNode::tick_in_flight(const Tick& tick) {
  LaneSide& side = *lane_side();
  if (side.opening != nullptr) return origin_.fail_tick(settings().fault, tick.due);
  if (side.transaction == nullptr || !side.transaction->is_resumed_) return origin_.miss(1, still_reading, tick.due);
  // If a conversion takes as long as the period, every second tick would be missed, so the last tick waits.
  miss_kept_tick();
  side.kept = tick.due;
  origin_.keep_tick(tick.due);
}

void SensorNode::begin_kept_tick() {
  LaneSide* const side = lane_side();
  if (side == nullptr || !side->kept || origin_.counts.in_flight != 0) return;
  Tick tick;
  tick.due = *std::exchange(side->kept, std::nullopt);
  tick.now = loop()->now();
  origin_.keep_tick(MonotonicTime::max());
  tick_on_lane(tick);
}

void SensorNode::miss_kept_tick() noexcept {
  LaneSide* const side = lane_side();
  if (side == nullptr || !side->kept) return;
  origin_.keep_tick(MonotonicTime::max());
  origin_.miss(1, still_reading, *std::exchange(side->kept, std::nullopt));
}

Error SensorNode::cannot_submit() const {
  const LaneSide& side = *lane_side();
  if (side.lane->lacks_thread()) return no_thread("cannot read", object_name());
  return side.device->given_up_error();
}

void SensorNode::fail_in_flight(const Error& error) {
  origin_.fail_read(error.id(), lane_side()->due);
  failed(error, loop()->now());
}

void SensorNode::submit_read() {
  LaneSide& side = *lane_side();
  if (side.transaction == nullptr) {
    try {
      side.transaction = side.device->make_transaction();
    } catch (...) {
      return fail_in_flight(thrown("preparing to read threw"));
    }
    side.transaction->owner_ = this;
    begin_warm_up();  // opened now, or made again after it hung
  }
  if (side.device->reads_on_loop()) return read_on_loop();
  try {
    if (side.lane == nullptr) find_lane();
    if (side.lane->submit(side.transaction, side.device->give_up_after())) return;
  } catch (...) {
    return fail_in_flight(thrown("handing its read to a lane threw"));
  }
  fail_in_flight(told([this] { return cannot_submit(); }));
}

void SensorNode::read_on_loop() {
  const std::shared_ptr<Transaction> transaction = lane_side()->transaction;
  if (loop()->is_manual()) {
    const LaneClock clock(loop()->now());
    transaction->run();
    loop()->manual_clock()->pass(clock.spent());
  } else {
    transaction->run();
  }
  transaction_done(*transaction, LaneJob::Outcome::finished);
}

void SensorNode::transaction_done(Transaction& transaction, LaneJob::Outcome outcome) {
  Call call(*this);
  loop()->nodes.begins(this);
  take_transaction(transaction, outcome);
  if (is_open()) begin_kept_tick();
}

void SensorNode::take_transaction(Transaction& transaction, LaneJob::Outcome outcome) {
  if (lane_side()->opening.get() == &transaction) return opening_done(transaction, outcome);
  LaneDevice& device = *lane_side()->device;
  const MonotonicTime due = lane_side()->due;
  const Duration late_after = lane_side()->late_after;
  if (outcome != LaneJob::Outcome::finished) {
    const Error error = told([&] {
      return outcome == LaneJob::Outcome::given_up
                 ? device.given_up_error()
                 : Error{Errc::closed, "read was cancelled", object_name(), "its lane was closed", ""};
    });
    lane_side()->transaction = nullptr;
    return fail_in_flight(error);
  }
  if (const auto pause = transaction.goes_on_after()) return resume_after(transaction, *pause);
  transaction.is_resumed_ = false;
  SamplePort port(*this, due, loop()->runtime.event_time(transaction.began_), nullptr);
  Sampled sampled;
  is_unusable_ = false;
  try {
    sampled = device.decode(transaction, port);
  } catch (...) {
    sampled = port.fail(thrown("decoding threw"));
  }
  if (lane_side()->transaction.get() != &transaction) return;  // stopped meanwhile, which has counted this read
  if (has_failed(sampled, port)) {
    if (!is_unusable(sampled)) return fail_in_flight(*port.error_);
    origin_.fail_read(port.error_->id(), due);
    return complain(*port.error_);
  }
  origin_.end_read(transaction.began_ - due + port.pushed_ > late_after);
  took(sampled, port);
}

void SensorNode::resume_after(Transaction& transaction, Duration pause) noexcept {
  transaction.is_resumed_ = true;
  LaneSide& side = *lane_side();
  side.resume.due = std::max(later(transaction.ended_, pause), loop()->now());
  loop()->deadlines.insert(side.resume);
}

void SensorNode::LaneSide::Resume::fire(MonotonicTime) {
  Call call(node);
  node.loop()->nodes.begins(&node);
  node.loop()->deadlines.remove(*this);
  node.submit_read();
}

// ---- closing

void SensorNode::cancel_transaction() noexcept {
  if (lane_side() == nullptr || lane_side()->transaction == nullptr || origin_.counts.in_flight == 0) return;
  const auto transaction = lane_side()->transaction;
  loop()->deadlines.remove(lane_side()->resume);
  origin_.fail_read(stopped, lane_side()->due);
  transaction->owner_ = nullptr;
  transaction->is_unwanted_.store(true, std::memory_order_relaxed);
}

void SensorNode::close_on_lane() noexcept {
  const auto transaction = std::exchange(lane_side()->transaction, nullptr);
  Lane* const lane = lane_side()->lane;
  if (transaction == nullptr || lane == nullptr) return;
  try {
    lane->submit(std::make_shared<Closing>(transaction));
  } catch (...) {  // no memory: its destructor closes
  }
}

}  // namespace rtdata::detail
