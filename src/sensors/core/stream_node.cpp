#include "sensors/core/stream_node.hpp"

#include <algorithm>
#include <utility>

namespace rtdata::detail {

StreamNode::StreamNode(LoopCore& loop, const FeedConfig& feed, PayloadType type, Waits waits)
    : SourceNode(loop, feed.name, feed.topic, std::move(type), OriginCore::Supply::feed, feed.process, feed.warm_up),
      waits_(waits),
      retry_(loop.face, [this] { open_stream(); }),
      silence_(loop.face, [this] { look_for_silence(); }) {}

void StreamNode::stop_schedule(MonotonicTime end) {
  if (!is_open()) return;
  retry_.stop();
  silence_.stop();
  close_stream();
  origin_.end_absence(end);
  origin_.close_gap();
}

void StreamNode::set_rate(Rate) {
  throw SetupError({Errc::bad_argument, "cannot set a rate", object_name(), "the device decides when it sends",
                    "set the rate in the device"});
}

void StreamNode::begin() noexcept {
  restart_filters();
  is_running_ = true;
  backoff_.reset();
}

void StreamNode::end() noexcept {
  is_running_ = false;
  is_connected_ = false;
  retry_.stop();
  silence_.stop();
  close_stream();
  origin_.end_absence(loop()->now());
  origin_.close_gap();
  origin_.topic.cancel(origin_);
}

void StreamNode::opened() {
  heard_at_ = came_at_ = loop()->now();
  is_connected_ = true;
  has_come_ = has_heard_ = false;
  is_silent_ = false;
  begin_warm_up();
  if (waits_.silence > Duration{0}) {
    silence_.start(waits_.silence);
  } else {
    origin_.end_absence(heard_at_);
  }
}

void StreamNode::lose(const Error& error, MonotonicTime since) {
  silence_.stop();
  close_stream();
  const bool was_connected = std::exchange(is_connected_, false);
  if (std::exchange(is_silent_, false)) {
    origin_.end_absence(since);
  } else if (was_connected && (waits_.silence > Duration{0} || (has_heard_ && !has_come_))) {
    since = std::min(since, came_at_);
  }
  origin_.begin_absence(Gap::Kind::disconnected, error.id(), since);
  retry_.start(backoff_.next(waits_.retry_first, std::max(waits_.retry_longest, waits_.retry_first), origin_.name));
  Call call(*this);
  report(error);
  if (is_open() && is_running_) set_health(Health::faulted, &error);
}

void StreamNode::heard() {
  heard_bytes();
  came();
}

void StreamNode::heard_bytes() {
  heard_at_ = loop()->now();
  has_heard_ = true;
  if (!std::exchange(is_silent_, false)) return;
  origin_.end_absence(heard_at_);
  came_at_ = heard_at_;  // up to here there is a gap
  silence_.start(waits_.silence);
}

void StreamNode::came() noexcept {
  came_at_ = loop()->now();
  has_come_ = true;
  if (!is_silent_) origin_.end_absence(came_at_);
}

void StreamNode::look_for_silence() {
  const MonotonicTime due = heard_at_ + waits_.silence;
  if (loop()->now() < due) return silence_.start(due - loop()->now());
  is_silent_ = true;
  const Error error = silence_error();
  origin_.end_absence(heard_at_);  // without a connection
  origin_.begin_absence(Gap::Kind::silent, "silent", heard_at_);
  Call call(*this);
  degrade(error);
  if (is_open() && is_running_ && is_silent_) fell_silent();
}

void StreamNode::leave_out() {
  ++origin_.counts.received;
  ++origin_.counts.filtered;
  heard();
}

void StreamNode::succeed() {
  came();
  set_healthy();
}

void StreamNode::set_healthy() {
  backoff_.reset();
  if (health() != Health::ok) set_health(Health::ok, nullptr);
}

bool StreamNode::take_or_fail(void* payload, Time time) {
  came();
  if (take_sample(payload, time) != Fate::unusable) return true;
  degrade(unusable_error());
  return false;
}

void StreamNode::fail(const Error& error) {
  came();
  ++origin_.counts.received;
  ++origin_.counts.unreadable;
  degrade(error);
}

void StreamNode::degrade(const Error& error) {
  report(error);
  if (is_open() && is_running_) set_health(Health::degraded, &error);
}

void StreamNode::on_close() noexcept {
  end();
  retry_.close();
  silence_.close();
  leave();
}

}  // namespace rtdata::detail
