// A sink with `through`: reads committed rows of a recording and keeps its position there.
#include <algorithm>
#include <string>
#include <utility>

#include "data/saturating.hpp"
#include "sinks/core/sink_node.hpp"

namespace rtdata::detail {

void SinkNode::follow_recording() {
  RuntimeCore& runtime = loop()->runtime;
  std::string others;
  for (Recorder* recorder : runtime.recorders) {
    SinkNode* const sink = recorder->as_sink();
    if (sink == nullptr || sink == this) continue;
    const bool is_ending = sink->is_closing() && recording_ != nullptr;
    if (sink->config_.name == config_.through && !is_ending) recording_ = sink;
    others += (others.empty() ? "" : ", ") + sink->config_.name;
  }
  const auto refuse = [&](std::string why, std::string advice) {
    recording_ = nullptr;
    throw SetupError({Errc::not_found, "cannot attach sink " + config_.name, "through " + config_.through,
                      std::move(why), std::move(advice)});
  };
  if (recording_ == nullptr) {
    refuse("there is no such sink on this loop",
           others.empty() ? "make the recording first" : "make the recording first; available: " + others);
  }
  if (queue_->is_recording()) refuse("this sink is a recording itself", "remove `through`");
  const std::size_t rows = queue_->rows_at_once();
  auto feed = recording_->queue_->make_feed(
      {config_.name, config_.topics, config_.from,
       queue_->sender() != nullptr ? RowFeedConfig::Times::utc : RowFeedConfig::Times::recorded, rows});
  if (feed == nullptr) refuse("it is not a recording", "name a sqlite sink");
  take_over(feed->path());
  queue_->feed_from(std::move(feed));
  recording_->followers_.push_back(this);
  runtime.attach(*this);
  loop()->schedule().add(*this);
  life_ = Life::attached;
  recording_->commit_within(config_.batch_time);
  if (recording_->is_readable_) start_work();
}

/// The backlog of a closed sink of this name in this recording is offered to this one: it counts once.
void SinkNode::take_over(const std::string& recording) noexcept {
  for (ClosedSink& closed : loop()->runtime.closed_sinks) {
    if (closed.name != config_.name || closed.recording != recording || !closed.backlog) continue;
    closed.counts.offered -= std::exchange(closed.counts.queued, 0);
    closed.backlog = Backlog{};
  }
}

void SinkNode::leave_recording() noexcept {
  leave_followers("the recording that it goes through was closed");
  SinkNode* const recording = std::exchange(recording_, nullptr);
  if (recording == nullptr) return;
  std::erase(recording->followers_, this);
  if (recording->life_ == Life::closing && recording->followers_.empty() && recording->work_ == Work::idle)
    recording->start_work();
}

void SinkNode::leave_followers(const char* why) noexcept {
  for (SinkNode* follower : std::exchange(followers_, {})) {
    follower->recording_ = nullptr;
    if (!follower->is_open() || follower->is_closing()) continue;
    follower->health_ = Health::faulted;
    follower->note([&] { follower->fault_for_good(why); });
    follower->report_health();
  }
}

/// Sets the commit time to the shortest that the followers need.
void SinkNode::commit_within(Duration time) {
  if (time >= period() || !is_scheduled()) return;
  loop()->schedule().remove(*this);
  set_period(time);
  loop()->schedule().add(*this);
}

void SinkNode::note_backlog() noexcept {
  if (is_fed()) catch_up_.note(loop()->now(), queue_->feed()->counts().backlog);
}

void SinkNode::rows_came() {
  if (!is_attached() || recording_ == nullptr) return;
  note_backlog();
  if (has_given_up_) {
    if (!is_at_work()) note([&] { queue_->note_committed(); });
    if (recording_->has_all_rows_) finish_drain();
    return;
  }
  if (work_ == Work::idle) {
    start_work();
    return;
  }
  is_due_ = true;
  if (!is_at_work()) note([&] { queue_->note_committed(); });
}

/// Called when this sink closes while its peer is away: what waits stays in the recording. Rows that the recording has
/// still to commit wait, too, so that their number is known only after its last commit.
void SinkNode::give_up() {
  if (recording_ == nullptr || recording_->life_ != Life::closing || recording_->has_all_rows_) return finish_drain();
  has_given_up_ = true;
}

void SinkNode::notify_followers() {
  const std::vector<SinkNode*> followers = followers_;
  for (SinkNode* follower : followers) {
    if (std::find(followers_.begin(), followers_.end(), follower) != followers_.end()) follower->rows_came();
  }
}

// ---- sending

void SinkNode::begin_sending() {
  work_ = Work::sending;
  note_backlog();
  transfer_->begin(queue_->parcels());
}

void SinkNode::rows_settled(std::size_t parcel, std::size_t first, std::size_t last,
                            std::span<const RefusedRow> refused) {
  queue_->settle(parcel, first, last, refused);
  note_backlog();
  if (recording_ != nullptr) recording_->are_positions_due_ = true;
  if (health_ == Health::ok || !fault_.empty() || transfer_->is_waiting()) return;
  health_ = Health::ok;
  reason_.clear();
  report_health();
}

void SinkNode::all_settled() {
  Call call(*this);
  queue_->end_sending();
  work_ = Work::idle;
  SinkTurnResult turn;
  turn.refused = queue_->take_refusals(turn.refusal);
  const Health before = health_;
  is_due_ = is_due_ || is_fed();  // more may have been committed
  go_on_after(turn);
  report_result(turn, before);
  report_health();
}

void SinkNode::sender_threw(const Error& error) {
  Call call(*this);
  report(error, 1);
}

void SinkNode::sending_failed(const Error& error) {
  Call call(*this);
  catch_up_.restart();
  health_ = Health::faulted;
  set_reason(error);
  report(error, 1);
  report_health();
  // The backlog in a recording is safe: closing does not wait for a peer that does not answer.
  if (is_open() && life_ == Life::closing && is_fed()) give_up();
}

}  // namespace rtdata::detail
