// A scheduled sensor: one member of a rate group, one device, one origin.
#pragma once

#include <memory>

#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sensors/transaction.hpp"
#include "sensors/source_node.hpp"

namespace rtdata::detail {

class SensorNode final : public SourceNode, public RateMember, private SamplePort {
 public:
  SensorNode(LoopCore& loop, const SensorConfig& config, PayloadType type, std::unique_ptr<SensorDevice> device);
  ~SensorNode() override;

  void start() override;
  void stop() override;
  void set_rate(Rate rate) override;
  Rate rate() const noexcept override { return Rate::from_period(period_); }
  bool is_running() const noexcept override { return is_scheduled(); }
  CallbackTimes callback_times() const noexcept override { return times; }
  void stop_schedule(MonotonicTime end) override;
  bool is_reading() const noexcept override { return origin_.counts.in_flight != 0; }

  void tick(const Tick& tick) override;
  void schedule_began() override;
  std::string blame_name() const override { return object_name(); }
  void transaction_done(Transaction& transaction, LaneJob::Outcome outcome);

 private:
  void publish(void* payload) override { publish(payload, Time{read_time_}); }
  void publish(void* payload, Time time) override;
  void on_close() noexcept override;
  void drop_callbacks() noexcept override;
  /// Whether the device may be read now: opens it again when its time has come.
  bool is_ready(MonotonicTime now);
  Result<void> open_device() noexcept;
  void begin_schedule();
  enum class EndOf { activity, rate };
  /// Counts what the schedule still owes, the read under way too, and takes it off the loop.
  void end_schedule(EndOf what);
  void read_inline(const Tick& tick);
  void submit(const Tick& tick);
  void took(Sampled sampled);
  void failed(const Error& error, MonotonicTime now);
  void cancel_transaction();

  std::unique_ptr<SensorDevice> device_;
  LaneDevice* lane_device_;  // null: read inline
  Lane* lane_ = nullptr;     // the loop's; found when the device was opened
  std::shared_ptr<Transaction> transaction_;
  Duration period_;
  Duration phase_;
  Duration late_after_;  // negative: by the rule
  Duration retry_first_;
  Duration retry_longest_;
  Duration retry_delay_{0};
  MonotonicTime retry_at_{};
  Time read_time_{};
  std::string_view fault_;  // id of the error that opened the gap under way
  unsigned faulted_after_;
  unsigned failures_ = 0;  // in a row
  bool required_;
  bool device_is_open_ = false;
  bool published_ = false;
  const Tick* sampling_ = nullptr;  // the tick whose inline read is on the stack and not yet counted
  unsigned runs_ = 0;               // counts stops, so that a read on the stack notices one
  unsigned publishing_run_ = 0;
};

}  // namespace rtdata::detail
