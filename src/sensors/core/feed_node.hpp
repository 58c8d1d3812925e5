// A sensor without a schedule, which gets its samples from its source.
#pragma once

#include <string>
#include <utility>

#include "rtdata/sensors/feed.hpp"
#include "sensors/core/source_node.hpp"

namespace rtdata::detail {

class FeedNode : public SourceNode {
 public:
  FeedNode(LoopCore& loop, const FeedConfig& config, PayloadType type)
      : SourceNode(loop, config.name, config.topic, std::move(type), OriginCore::Supply::feed, config.process,
                   config.warm_up) {
    begin_warm_up();
  }

  void start() override {
    if (is_running_ || !is_open()) return;
    restart_filters();
    is_running_ = true;
    begin_warm_up();
  }
  void stop() override {
    is_running_ = false;
    origin_.end_absence(loop()->now());
    origin_.close_gap();
    origin_.topic.cancel(origin_);
  }
  void stop_schedule(MonotonicTime end) override {
    origin_.end_absence(end);
    origin_.close_gap();
  }
  bool is_reading() const noexcept override { return false; }
  void set_rate(Rate) override {
    throw SetupError({Errc::bad_argument, "cannot set a rate", object_name(), "the sensor is fed, not sampled",
                      "set the rate at its source"});
  }
  Rate rate() const noexcept override { return {}; }
  bool is_running() const noexcept override { return is_running_; }

  void publish(void* payload) { publish(payload, loop()->runtime.event_time(loop()->now())); }
  void publish(void* payload, Time time) {
    if (health() != Health::ok) return publish_after_failure(payload, time);
    if (take_sample(payload, time) == Fate::unusable) [[unlikely]]
      complain_of_input(unusable_error());
  }
  void fail(const Error& error) {
    if (!is_running_) return;
    ++origin_.counts.received;
    ++origin_.counts.unreadable;
    complain_of_input(error);
  }
  void complain_of_input(const Error& error) {
    complain(error, health() == Health::faulted ? Health::faulted : Health::degraded);
  }
  void fail_size(std::size_t given) {
    fail({Errc::bad_data, "cannot publish", object_name(),
          "it was given " + std::to_string(given) + " bytes, but its payload has " + std::to_string(payload_size()),
          "give it the bytes of its description"});
  }
  void fault(const Error& error) {
    if (is_running_) origin_.begin_absence(Gap::Kind::disconnected, error.id(), loop()->now());
    complain(error, Health::faulted);
  }
  void complain(const Error& error, Health health) {
    Call call(*this);
    report(error);
    if (is_open()) set_health(health, &error);
  }
  void repeated() {
    if (!is_running_) return;
    ++origin_.counts.received;
    ++origin_.counts.repeated;
  }
  void lost(std::uint64_t count) {
    if (!is_running_) return;
    origin_.counts.lost += count;
    set_numbered();  // else recordings would take the number for one that nobody knows
  }
  void set_numbered() { origin_.counts.lost_is_known = true; }
  void check_thread() const { loop()->check_thread("cannot feed", origin_.name); }
  std::size_t payload_size() const noexcept { return origin_.topic.type.size; }

 protected:
  void on_close() noexcept override {
    stop();
    leave();
  }

 private:
  /// Separate, so that the usual path needs no call.
  [[gnu::noinline]] void publish_after_failure(void* payload, Time time) {
    origin_.end_absence(loop()->now());
    if (health() == Health::faulted) begin_warm_up();
    if (take_sample(payload, time) == Fate::unusable) return complain_of_input(unusable_error());
    set_health(Health::ok, nullptr);  // last, because a handler may close this feed
  }
  bool is_running_ = true;
};

}  // namespace rtdata::detail
