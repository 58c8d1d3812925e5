// The common part of scheduled sensors and feeds: an origin, health, errors.
#pragma once

#include <memory>
#include <string>

#include "loop/core/handler.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "process/processor.hpp"
#include "rtdata/detail/sensors/transaction.hpp"
#include "rtdata/loop/loop.hpp"

namespace rtdata::detail {

class SourceNode : public SensorEntry {
 public:
  SourceNode(LoopCore& loop, std::string_view name, std::string_view topic, PayloadType type, OriginCore::Supply supply,
             const Processing& processing, Duration warm_up, const std::string& identity_by_word = {});

  virtual void start() = 0;
  virtual void set_rate(Rate rate) = 0;
  virtual Rate rate() const noexcept = 0;
  void set_processing(const Processing& processing);
  virtual bool is_running() const noexcept = 0;
  virtual CallbackTimes callback_times() const noexcept { return {}; }
  const OriginCore& origin() const noexcept override { return origin_; }
  Duration schedule_period() const noexcept override { return rate().period(); }
  bool is_active() const noexcept override { return is_running(); }
  Health health() const noexcept override { return health_; }
  std::string_view reason() const noexcept override {
    return on_demand_ != nullptr ? std::string_view(on_demand_->reason) : std::string_view();
  }

  const SensorCounts& counts() const noexcept { return origin_.counts; }
  void set_on_error(Callback<void(const ErrorReport&)> handler) { on_demand().on_error.set(std::move(handler)); }

 protected:
  ~SourceNode() override;
  virtual std::string object_name() const { return "sensor " + origin_.name; }
  using Fate = Processor::Fate;
  /// Takes a sample: counts it as received and by its result, and publishes it, processed, unless it is held back.
  /// Moving its payload may throw: then it counts as published, and as dropped for subscribers.
  Fate take_sample(void* payload, Time time) {
    ++origin_.counts.received;
    if (warm_until_ != MonotonicTime::min() && is_warming_up(time)) [[unlikely]] {
      ++origin_.counts.filtered;
      return Fate::filtered;
    }
    if (processor_ != nullptr) [[unlikely]] {
      if (const Fate fate = process(payload, time); fate != Fate::published) return fate;
    }
    ++origin_.counts.published;
    origin_.topic.publish(origin_, time, payload);
    return Fate::published;
  }
  /// Why the last one was unusable.
  Error unusable_error() const { return processor_->error(origin_.name); }
  void restart_filters() noexcept {
    if (processor_ != nullptr) processor_->restart();
  }
  /// The device was opened now: samples of the next `warm_up` are filtered.
  void begin_warm_up() noexcept;
  /// Hands the error to the sensor's own handler, or to the loop's.
  void report(const Error& error) noexcept;
  void set_health(Health health, const Error* reason);
  /// To be called from a derived class's on_close.
  void leave() noexcept;
  void drop_callbacks() noexcept override {
    if (on_demand_ != nullptr) on_demand_->on_error.reset();
  }
  /// State that most sensors never need; made at its first use, because there may be thousands of sensors. A derived
  /// class may extend it.
  struct OnDemand {
    OnDemand() = default;
    OnDemand(const OnDemand&) = delete;
    OnDemand& operator=(const OnDemand&) = delete;
    virtual ~OnDemand() = default;
    Handler<ErrorReport> on_error;
    std::string reason;  // why it is not ok
  };
  virtual std::unique_ptr<OnDemand> make_on_demand() const { return std::make_unique<OnDemand>(); }
  OnDemand& on_demand() {
    if (on_demand_ == nullptr) on_demand_ = make_on_demand();
    return *on_demand_;
  }

 private:
  Fate process(void*& payload, Time time) noexcept;
  /// `time`: of a sample that came now.
  bool is_warming_up(Time time) noexcept;
  void note_processing(const Processing& processing);

  Health health_ = Health::ok;
  std::unique_ptr<Processor> processor_;  // null: samples are published as they come
  const Duration warm_up_;
  MonotonicTime warm_until_ = MonotonicTime::min();  // that: it is warm

 protected:
  OriginCore& origin_;
  std::unique_ptr<OnDemand> on_demand_;  // null: none yet
};

}  // namespace rtdata::detail
