// The end of a sink: drained by its loop, or closed by its owner.
#include <algorithm>

#include "data/saturating.hpp"
#include "sinks/core/sink_node.hpp"

namespace rtdata::detail {

void SinkNode::drain(MonotonicTime deadline, Callback<void(std::uint64_t)> done) {
  if (!is_open() || !is_attached()) return done(0);
  drained_.push_back(std::move(done));
  if (drained_.size() > 1) return;
  Call call(*this);
  // The recording that it goes through is closed after it.
  if (is_fed()) deadline = later(loop()->now(), std::max(span_between(loop()->now(), deadline), Duration{0}) / 4 * 3);
  deadline_.start_at(deadline);
  begin_closing(deadline);
}

void SinkNode::begin_closing(MonotonicTime deadline) {
  RuntimeCore& runtime = loop()->runtime;
  if (life_ != Life::attached) return;
  runtime.reports.flush(Reports::Repeated::all);
  if (life_ != Life::attached) return;  // a user's handler has closed this sink
  // The published events, including those of tiers, must match the last account, so no user code runs between here and
  // the account. Storing needs time, too.
  std::string unknown = runtime.exchange.unknown();
  note([&] {
    if (unknown.empty())
      unknown = runtime.exchange.catch_up(std::max(span_between(loop()->now(), deadline), Duration{0}) / 2);
    if (!unknown.empty()) unknown_ += (unknown_.empty() ? "" : "; ") + unknown;
  });
  life_ = Life::closing;
  report_run();
  account_.end();
  note([&] {
    if (!account_.notes.has_end() && !runtime.clock_log.is_repeated())
      account_.notes.add(runtime.clock_log.read("end"));
  });
  account_.close_gaps();
  is_between_parts_ = false;
  early_at_.reset();
  account_timer_.stop();
  if (!is_fed()) queue_->hand_over();
  if (is_end_due()) enqueue_account(SinkAccount::Part::last);
  queue_->keep_own_counts();
  if (is_scheduled()) loop()->schedule().remove(*this);
  if (is_waiting()) {  // one try at once, then the delays begin anew
    stop_waiting();
    backoff_.reset();
  }
  if (transfer_ != nullptr) transfer_->try_now();
  if (life_ == Life::closing) start_work();
}

void SinkNode::wait_for_predecessors() {
  for (Recorder* const recorder : loop()->runtime.recorders) {
    SinkNode* const sink = recorder->as_sink();
    if (sink == nullptr ||
        std::find(sink->comes_before_.begin(), sink->comes_before_.end(), config_.name) == sink->comes_before_.end())
      continue;
    predecessors_.push_back(sink);
    sink->successors_.push_back(this);
  }
  if (predecessors_.empty()) return;
  work_ = Work::held;
  health_ = Health::degraded;
  reason_ = "waits until the sink that had its file has ended; events wait in the queue";
}

void SinkNode::release_successors() noexcept {
  for (SinkNode* const sink : std::exchange(successors_, {})) {
    std::erase(sink->predecessors_, this);
    if (!sink->predecessors_.empty()) continue;
    sink->work_ = Work::idle;
    sink->start_work();
  }
}

void SinkNode::finish_drain() {
  if (drained_.empty()) return;
  Call call(*this);
  auto done = std::move(drained_);
  drained_.clear();
  deadline_.stop();
  const std::uint64_t lost = leave();
  for (auto& report_end : done) report_end(lost);
}

std::uint64_t SinkNode::leave() noexcept {
  if (!is_attached()) return 0;
  const bool is_closed = std::exchange(life_, Life::left) == Life::closed;
  stop_waiting();
  work_timer_.stop();
  if (transfer_ != nullptr) transfer_->end();
  if (is_fed() && !is_at_work()) note([&] { queue_->end_feed(); });
  queue_->abandon();
  RuntimeCore& runtime = loop()->runtime;
  runtime.detach(*this);
  try {
    last_ = status();
  } catch (...) {  // no memory for texts
    last_.emplace();
    last_->health = health_;
    last_->counts = queue_->counts();
  }
  leave_recording();
  // Events that wait in a recording stay there.
  const std::uint64_t lost = is_fed() ? 0 : std::exchange(last_->counts.queued, 0);
  last_->counts.dropped[static_cast<std::size_t>(DropReason::refused)] += lost;
  ClosedSink end;
  end.health = health_;
  end.counts = last_->counts;
  note([&] {
    last_->dropped = queue_->dropped_by_topic(is_fed() ? SinkQueue::Queued::waits : SinkQueue::Queued::lost);
    static_cast<SinkStatus&>(end) = *last_;
    if (is_fed()) end.recording = queue_->feed()->path();
    end.is_recording = queue_->is_recording() && !is_fed();
    if (is_closed) end.recorded = queue_->recorded();
  });
  runtime.closed_sinks.push_back(std::move(end));  // there is room for it
  note([&] {
    const std::string why = reason_.empty() ? "" : " (" + reason_ + ")";
    if (lost > 0) {
      runtime.report(loop(), object_name(),
                     {Errc::timed_out, "lost " + std::to_string(lost) + (lost == 1 ? " event" : " events"),
                      config_.name, "they could not be stored before the deadline" + why,
                      queue_->sender() != nullptr
                          ? "check the peer; with `through` events wait in a recording"
                          : "check the storage; for a recording, the next start writes down what was lost"});
    } else if (!is_closed && !is_fed()) {
      runtime.report(loop(), object_name(),
                     {Errc::timed_out, "not closed", config_.name, "there was no time or no memory for its end" + why,
                      "the next start seals the recording"});
    }
  });
  runtime.reports.flush(Reports::Repeated::all);  // of closing; there may be no later turn to report them
  release_successors();
  return lost;
}

void SinkNode::on_close() noexcept {
  std::uint64_t lost = 0;
  for (std::size_t left = predecessors_.size(); is_attached() && left > 0 && !predecessors_.empty(); --left)
    predecessors_.back()->close();  // a sink that is being closed already stays in the list
  for (SinkNode* const sink : predecessors_) std::erase(sink->successors_, this);
  leave_recording();  // nobody waits for another here
  if (is_attached()) {
    const MonotonicTime end = later(loop()->now(), config_.close_deadline);
    begin_closing(end);
    // A Sender needs a running loop to send: Loop::close and Loop::drain wait for that.
    while (life_ == Life::closing && work_ != Work::sending && loop()->now() < end) {
      if (!is_at_work()) {
        const bool is_retry = is_waiting();
        stop_waiting();
        if (is_retry) pause_before_storing(std::min(backoff_.last(), end - loop()->now()));
        start_work();
        if (!is_at_work()) break;  // the system gives no thread
      }
      lane_->wait(end - loop()->now());
    }
    lost = leave();
  }
  leave_recording();
  account_.end();
  loop()->runtime.detach(*this);
  if (is_scheduled()) loop()->schedule().remove(*this);
  job_->sink = nullptr;
  if (is_at_work()) lane_->abandon_thread();
  lane_ = nullptr;
  for (Timer* timer : {&work_timer_, &account_timer_, &deadline_, &follow_}) timer->close();
  auto done = std::move(drained_);
  drained_.clear();
  for (auto& report_end : done) report_end(lost);
}

void SinkNode::pause_before_storing(Duration duration) {
  if (loop()->is_manual()) {
    loop()->manual_clock()->pass(duration);
  } else {
    job_->turn.pause = duration;
  }
}

}  // namespace rtdata::detail
