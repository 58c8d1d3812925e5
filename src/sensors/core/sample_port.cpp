// Counts and publishes the samples of a read.
#include <utility>

#include "sensors/core/sensor_node.hpp"

namespace rtdata::detail {

void SamplePort::publish(void* payload, Time time) {
  if (sensor_ == nullptr) return;  // stopped by its own sampling function
  const bool was_usable = std::exchange(is_usable_, true);
  if (std::exchange(has_sample_, true) || time != time_) sensor_->is_not_one_a_read();
  const bool is_of_read = sensor_->origin().counts.is_one_a_read;
  const auto [fate, row] = sensor_->take(payload, time, due_);
  if (fate == Processor::Fate::unusable) {
    is_usable_ = was_usable;
    error_ = sensor_->unusable_error();
  } else if (fate == Processor::Fate::published && is_of_read) {
    pushed_ = span_between(time, row);
  }
}

void SamplePort::publish_at(void* payload, MonotonicTime time) {
  if (sensor_ != nullptr) publish(payload, sensor_->time_of(time));
}

void SamplePort::lost(std::uint64_t count) {
  if (sensor_ == nullptr || count == 0) return;
  sensor_->count_lost(count);
  error_ = Error{Errc::backlog, "samples are lost", sensor_->blame_name(),
                 "the device dropped " + std::to_string(count) + " before they were read",
                 "read it more often, or set a lower sample rate in the device"};
}

void SamplePort::lost_in_fault(std::uint64_t count) {
  if (sensor_ != nullptr && count > 0) sensor_->count_lost(count);
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

void SensorNode::leave_out(SamplePort& port) noexcept {
  if (port.sensor_ == nullptr) return;
  if (std::exchange(port.has_sample_, true)) port.sensor_->is_not_one_a_read();
  ++port.sensor_->origin_.counts.received;
  ++port.sensor_->origin_.counts.filtered;
}

bool SensorNode::is_published(SamplePort& port, void* payload) {
  if (port.sensor_ == nullptr) return false;
  const SensorCounts& of = port.sensor_->counts();
  const std::uint64_t before = of.published;
  port.publish(payload);
  return port.sensor_ != nullptr && of.published != before;
}

SensorNode::Taken SensorNode::take(void* payload, Time time, MonotonicTime due) {
  Fate fate = Fate::published;
  try {
    fate = take_sample(payload, time);
    if (fate == Fate::published) origin_.count_lateness(due);
    if (fate == Fate::unusable) is_unusable_ = true;
  } catch (...) {  // published, and dropped for those who subscribe
    origin_.count_lateness(due);
    report(thrown("moving its payload threw"));
  }
  return {fate, origin_.last_time};
}

}  // namespace rtdata::detail
