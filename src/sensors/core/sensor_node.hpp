// A scheduled sensor: one member of a rate group, one device, one origin.
#pragma once

#include <memory>

#include "data/backoff.hpp"
#include "loop/core/deadline.hpp"
#include "rtdata/detail/sensors/transaction.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "sensors/core/source_node.hpp"

namespace rtdata::detail {

/// The reason of a read that failed because of a stop.
inline constexpr std::string_view stopped = "stopped";

class SensorNode final : public SourceNode, public RateMember {
 public:
  SensorNode(LoopCore& loop, const SensorConfig& config, PayloadType type, std::unique_ptr<SensorDevice> device);
  SensorNode(LoopCore& loop, const SensorConfig& config, PayloadType type, std::unique_ptr<LaneDevice> device);
  ~SensorNode() override;

  void start() override;
  void stop() override;
  void set_rate(Rate rate) override;
  Rate rate() const noexcept override { return Rate::from_period(period()); }
  bool is_running() const noexcept override { return is_scheduled() || is_starting(); }
  CallbackTimes callback_times() const noexcept override { return times; }
  void stop_schedule(MonotonicTime end) override;
  bool is_reading() const noexcept override { return origin_.counts.in_flight != 0; }
  void count_read_begun() noexcept override;
  static bool is_late(const SamplePort& port) noexcept;
  std::optional<SensorLoad> load() const override;

  void tick(const Tick& tick) override;
  void prefetch() const noexcept override;
  MonotonicTime not_before() const noexcept override { return origin_.free_from(); }
  Duration wanted_phase() const noexcept override { return settings().phase; }
  void schedule_began() override;
  std::string blame_name() const override { return object_name(); }
  std::string callback_name() const override { return object_name(); }
  bool report_times(CallbackStatus& status) const override;
  void held(Duration took) override;
  void transaction_done(Transaction& transaction, LaneJob::Outcome outcome);
  void opening_done(Transaction& opening, LaneJob::Outcome outcome);
  struct Taken {
    Fate fate;
    Time row;  // of what was published
  };
  Taken take(void* payload, Time time, MonotonicTime due);
  using SourceNode::unusable_error;
  void is_not_one_a_read() noexcept { origin_.counts.is_one_a_read = false; }
  void count_repeated() noexcept {
    ++origin_.counts.received;
    ++origin_.counts.repeated;
  }
  Time time_of(MonotonicTime at) noexcept { return loop()->runtime.event_time(at); }
  void count_lost(std::uint64_t count) noexcept {
    origin_.counts.lost_is_known = true;
    origin_.counts.lost += count;
  }
  void count_unreadable() noexcept {
    ++origin_.counts.received;
    ++origin_.counts.unreadable;
  }
  /// Counts a sample that `only` does not select as filtered; the read has not failed.
  static void leave_out(SamplePort& port) noexcept;
  /// Publishes the sample. False: its processing kept it back, or found it unusable.
  static bool is_published(SamplePort& port, void* payload);

 private:
  void on_close() noexcept override;
  void drop_callbacks() noexcept override;
  /// Opens or reads a failed device again if its time has come. False: not yet; the tick was counted.
  bool make_ready(const Tick& tick);
  Result<void> open_device() noexcept;
  /// `on`: the loop, also when the sensor is closed already.
  void close_device(LoopCore& on) noexcept;
  /// Completes start() with the result of the opening.
  void started(const Result<void>& opened);
  void set_settings(const SensorConfig& config);
  /// The error of the exception that is being handled.
  Error thrown(const char* what) const noexcept;
  /// Returns the result of `make`, or an error if there is no memory.
  template <class Make>
  Error told(const Make& make) const noexcept {
    try {
      return make();
    } catch (...) {
      return thrown("reading threw");
    }
  }
  void begin_schedule();
  void change_period(Duration period);
  enum class EndOf { activity, rate };
  /// Counts the remaining ticks of the schedule and the running read, and removes it from the loop.
  void end_schedule(EndOf what);
  void read_inline(const Tick& tick);

  // Of a device on a lane (sensor_lane.cpp).
  void start_on_lane();
  /// Waits until the opening that start() has begun is done, but no longer than the device's limit.
  void wait_for_start();
  bool is_starting() const noexcept;
  /// Submits an opening to the lane, or continues at once if none is needed. Errors: neither is possible.
  Result<void> submit_opening();
  void tick_on_lane(const Tick& tick);
  /// A tick that came while another was in flight.
  void tick_in_flight(const Tick& tick);
  void take_transaction(Transaction& transaction, LaneJob::Outcome outcome);
  /// Begins the kept tick, late.
  void begin_kept_tick();
  /// Counts the kept tick as missed.
  void miss_kept_tick() noexcept;
  void find_lane();
  /// Runs the transaction again after the pause that the device needs.
  void resume_after(Transaction& transaction, Duration pause) noexcept;
  /// Reads for the tick that is in flight.
  void submit_read();
  /// Runs the transaction on the loop, for a device with short reads.
  void read_on_loop();
  Error cannot_submit() const;
  /// Handles a failed read or opening of a tick on the lane.
  void fail_in_flight(const Error& error);
  /// Closes the device on its lane, after the running job.
  void close_on_lane() noexcept;
  void cancel_opening() noexcept;
  /// True if the read returned an error and gave no usable sample.
  static bool has_failed(Sampled sampled, const SamplePort& port) noexcept {
    return (sampled == Sampled::failed || port.error_) && !port.is_usable_;
  }
  /// Counts a read that has not failed.
  void took(Sampled sampled, const SamplePort& port);
  void recovered();
  /// Handles a failed read on the loop, or a failed opening before it.
  void fail(const SamplePort& port, const Error& error, const Tick& tick);
  void count_failed(const SamplePort& port, const Error& error, const Tick& tick) noexcept;
  void failed(const Error& error, MonotonicTime now);
  /// True if a read has failed only because processing found no usable sample; opening the device again would not help.
  bool is_unusable(Sampled sampled) const noexcept { return is_unusable_ && sampled != Sampled::failed; }
  /// Reports an unusable reading although the device answered: the sensor is degraded, the device stays open.
  void complain(const Error& error);
  void cancel_transaction() noexcept;
  void count_unread() noexcept;

  /// The state of a device that is read on a lane.
  struct LaneSide {
    LaneSide(SensorNode& node, std::unique_ptr<LaneDevice> device_) : device(std::move(device_)), resume(node) {}
    /// The deadline for continuing a transaction after a pause of the device.
    struct Resume final : Deadline {
      explicit Resume(SensorNode& node_) : node(node_) {}
      void fire(MonotonicTime now) override;
      SensorNode& node;
    };
    std::unique_ptr<LaneDevice> device;
    Lane* lane = nullptr;                      // the loop's; found when the device is opened
    std::shared_ptr<Transaction> opening;      // under way
    bool is_for_start = false;                 // of the opening: begun by start(), not by a tick
    std::optional<Error>* refusal = nullptr;   // where to store the error of the opening for start(); null: report it
    std::shared_ptr<Transaction> transaction;  // under way, or for the next read
    MonotonicTime due{};                       // of the tick in flight
    Duration late_after{0};                    // of the schedule of that tick
    Resume resume;
    std::optional<MonotonicTime> kept;  // the tick that came while the device was converting, or was read
  };
  /// State that a sensor on the loop with default settings needs only after a failure.
  struct Extra final : OnDemand {
    std::unique_ptr<LaneSide> lane_side;  // null: read on the loop
    Duration phase{0};
    Duration late_after{-1};  // negative: by the rule
    std::optional<Duration> read_time;
    Duration retry_first = SensorConfig{}.retry_first;
    Duration retry_longest = SensorConfig{}.retry_longest;
    unsigned faulted_after = SensorConfig{}.faulted_after;
    bool is_required = false;
    OnOverrun on_overrun = OnOverrun::warn;
    Duration wanted_period{0};  // the period before slowing down; 0: not slowed down
    Backoff backoff;
    MonotonicTime retry_at{};
    unsigned failures = 0;   // in a row
    std::string_view fault;  // id of the error that opened the gap under way
  };
  std::unique_ptr<OnDemand> make_on_demand() const override { return std::make_unique<Extra>(); }
  Extra& extra() { return static_cast<Extra&>(on_demand()); }
  /// Null: not needed so far.
  Extra* extra_if_any() const noexcept { return static_cast<Extra*>(on_demand_.get()); }
  /// As set, or the usual ones.
  const Extra& settings() const noexcept;
  void forget_failures() noexcept {
    if (Extra* state = extra_if_any()) state->failures = 0;
  }
  LaneSide* lane_side() const noexcept {
    const Extra* own = extra_if_any();
    return own != nullptr ? own->lane_side.get() : nullptr;
  }

  bool device_is_open_ = false;
  bool is_unusable_ = false;              // a sample of the read under way
  std::unique_ptr<SensorDevice> device_;  // null: it is on a lane, or closed
  SamplePort* port_ = nullptr;            // of the read on the stack
};

inline void SensorNode::took(Sampled sampled, const SamplePort& port) {
  if ((sampled == Sampled::nothing_new) == port.has_sample_) is_not_one_a_read();
  if (sampled == Sampled::nothing_new) count_repeated();
  if (port.error_) [[unlikely]]
    return complain(*port.error_);
  if (health() != Health::ok) [[unlikely]]
    recovered();
}

}  // namespace rtdata::detail
