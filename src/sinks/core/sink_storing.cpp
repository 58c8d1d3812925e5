// Control of a sink's lane: opening, storing the queue, retrying after a failure.
#include <algorithm>
#include <iterator>

#include "data/saturating.hpp"
#include "loop/core/no_thread.hpp"
#include "sinks/core/sink_node.hpp"

namespace rtdata::detail {
namespace {

constexpr Duration long_opening = std::chrono::seconds{5};
constexpr Duration tiers_wait_at_most = std::chrono::milliseconds{5};
constexpr const char* opening_reason = "opening, which takes long; events wait in the queue";

}  // namespace

void SinkNode::hand_over(Hand what) {
  if (is_closing()) return;
  if (is_fed()) return rows_came();
  bool has_rows = false;
  if (work_ != Work::idle) {  // the chunk fills further
    is_due_ = true;
  } else {
    has_rows = queue_->hand_over();
  }
  const bool has_account = what == Hand::rows_and_account;
  if (is_waiting() || work_ == Work::held) {
    is_account_due_ = is_account_due_ || has_account;
  } else if ((has_account && begin_account()) || has_rows) {
    start_work();
  }
}

void SinkNode::sync(Callback<void()> done) {
  if (is_closing()) return;
  syncs_.push_back(std::move(done));
  hand_over(Hand::rows);
  start_work();
}

/// The syncs of the turn of work that has ended, if it did them.
std::vector<Callback<void()>> SinkNode::take_synced(const SinkTurnResult& turn) {
  std::vector<Callback<void()>> done;
  const auto end = syncs_.begin() + static_cast<std::ptrdiff_t>(std::exchange(syncs_begun_, 0));
  if (!turn.has_synced()) return done;
  std::move(syncs_.begin(), end, std::back_inserter(done));
  syncs_.erase(syncs_.begin(), end);
  return done;
}

bool SinkNode::is_sync_due() const noexcept {
  if (!syncs_.empty()) return true;
  const Duration time = queue_->pace().sync_time;
  return time.count() > 0 && unsynced_since_ && span_between(*unsynced_since_, loop()->now()) >= time;
}

SinkTurn::Task SinkNode::next_task() const noexcept {
  if (is_to_open_) return SinkTurn::Task::open;
  const bool has_all = recording_ == nullptr || recording_->has_all_rows_;
  if (is_closing() && is_end_due() && has_all) return SinkTurn::Task::store_and_close;
  return is_sync_due() ? SinkTurn::Task::store_and_sync : SinkTurn::Task::store;
}

/// By the current clock, which may have been set since the start. Smaller moves are part of the loop's own line.
Duration SinkNode::to_utc() noexcept {
  constexpr Duration least = std::chrono::milliseconds{1};
  RuntimeCore& runtime = loop()->runtime;
  const Duration now = runtime.clock().realtime() - runtime.event_now();
  const Duration moved = now - to_utc_;
  if (moved > least || moved < -least) to_utc_ = now;
  return to_utc_;
}

void SinkNode::start_work() {
  if (work_ != Work::idle || !is_attached() || life_ == Life::closed) return;
  if (!is_to_open_ && !unsynced_since_) unsynced_since_ = loop()->now();
  if (is_closing() && !is_last_reported_ && is_end_due()) {
    enqueue_account(SinkAccount::Part::last);
    if (!is_last_reported_) return retry_later(Work::waiting);
  }
  job_->turn.task = next_task();
  if (job_->turn.task == SinkTurn::Task::store_and_sync) {
    if (!is_fed()) queue_->hand_over();
    syncs_begun_ = syncs_.size();
  }
  if (queue_->sender() != nullptr && !is_fed()) job_->turn.to_utc = to_utc();
  work_ = is_to_open_ ? Work::opening : Work::storing;
  Work why = Work::waiting;
  try {
    if (lane_->submit(job_)) {
      if (work_ == Work::opening) work_timer_.start(long_opening);
      return;
    }
    why = Work::waiting_for_thread;  // the timer reports it, since this may be within a publish
    health_ = Health::faulted;
    set_reason(no_thread());
  } catch (...) {  // no memory for the lane: as after an error
  }
  retry_later(why);
}

void SinkNode::wait_for_opening() {
  is_setting_up_ = true;
  const MonotonicTime begin = loop()->now();
  bool is_reported = false;
  while (work_ == Work::opening) {
    lane_->wait(loop()->is_manual() ? Duration::max() : tiers_wait_at_most);
    loop()->call_own("loop",
                     [&] { loop()->runtime.receive(); });  // what tiers publish meanwhile must not fill their rings
    if (work_ != Work::opening || is_reported || span_between(begin, loop()->now()) < long_opening) continue;
    is_reported = true;
    note([&] { loop()->runtime.log(LogLevel::info, object_name(), "opening, which takes long"); });
  }
  is_setting_up_ = false;
  if (!set_up_error_) return;
  life_ = Life::made;
  throw SetupError(std::move(*set_up_error_));
}

void SinkNode::retry_later(Work why) {
  work_ = why;
  work_timer_.start(
      backoff_.next(config_.retry_first, std::max(config_.retry_longest, config_.retry_first), config_.name));
}

void SinkNode::stop_waiting() {
  if (!is_waiting()) return;
  work_ = Work::idle;
  work_timer_.stop();
}

void SinkNode::work_timer_fired() {
  Call call(*this);
  if (work_ == Work::opening) {
    if (health_ == Health::ok) {
      health_ = Health::degraded;
      note([&] { reason_ = opening_reason; });
    }
    return report_health();
  }
  if (std::exchange(work_, Work::idle) == Work::waiting_for_thread) report(no_thread(), 1);
  report_health();
  if (is_open()) start_work();
}

Error SinkNode::no_thread() const {
  Error error = detail::no_thread("cannot store", config_.name);
  error.advice += "; events wait in the queue";
  return error;
}

void SinkNode::work_done(LaneJob::Outcome outcome) {
  Call call(*this);
  if (std::exchange(work_, Work::idle) == Work::opening) work_timer_.stop();
  std::vector<Callback<void()>> synced;
  if (outcome == LaneJob::Outcome::finished && is_attached()) {  // else too late: counted as lost
    const SinkTurnResult turn = std::exchange(job_->result, {});
    synced = take_synced(turn);
    // A full disk is not a mistake of the user: it is tried again, as later.
    if (is_setting_up_ && !turn.result && turn.result.error().code != Errc::storage_full) {
      set_up_error_ = turn.result.error();
      return;
    }
    if (turn.has_opened()) {
      is_to_open_ = false;
      if (turn.result && life_ == Life::attached) account_.keep_all(*loop());
    }
    if (turn.refused != 0 && recording_ != nullptr) recording_->are_positions_due_ = true;  // there are their keys
    const Health before = health_;
    if (turn.has_parcels) {
      begin_sending();
    } else {
      go_on_after(turn);
    }
    report_result(turn, before);
    // Events that wait in a recording are safe there: closing does not wait for a peer that is away.
    const bool gives_up = is_fed() && life_ == Life::closing && !turn.result;
    if (is_open() && turn.has_closed()) finish_drain();
    if (is_open() && gives_up) give_up();
    // A recording on a full disk has what waits from before, which goes out meanwhile.
    const bool is_full = is_to_open_ && !turn.result && turn.result.error().code == Errc::storage_full;
    is_readable_ = is_readable_ || turn.has_opened() || is_full;
    if (is_open() && turn.has_ended) leave_followers("the recording that it goes through has ended");
    if (is_open() && (turn.result || is_full)) notify_followers();
  }
  report_health();                       // at the end, since this sink may take the event itself
  for (Callback<void()>& done : synced)  // they may do anything to this sink
    if (is_open()) loop()->call_own(object_name(), [&] { done(); });
}

void SinkNode::go_on_after(const SinkTurnResult& turn) {
  if (!turn.topic_fault.empty()) fault_for_good(turn.topic_fault);
  obstacle_ = turn.result ? std::error_code{} : turn.result.error().code;
  if (!turn.result) {
    catch_up_.restart();
    health_ = Health::faulted;
    error_already_reported_ = false;
    note([&] {
      std::string reason = loop()->runtime.hide(turn.result.error().text());
      error_already_reported_ = is_closing() && reason == reason_;
      reason_ = std::move(reason);
    });
    if (!turn.has_ended) return retry_later(Work::waiting);
  } else if (turn.has_ended) {
    // stays faulted
  } else if (!fault_.empty()) {
    fault_for_good({});
  } else {
    health_ = Health::ok;
    reason_.clear();
  }
  backoff_.reset();
  note_backlog();
  if (turn.has_synced() || turn.has_ended) unsynced_since_.reset();
  if (turn.has_closed()) {
    life_ = Life::closed;
  } else if (is_closing()) {
    const bool is_done = queue_->is_idle() && !std::exchange(is_due_, false);
    has_all_rows_ = !is_end_due() && is_done;
    if (next_task() == SinkTurn::Task::store_and_close || !is_done) start_work();
  } else if (is_due_ || is_account_due_ || !queue_->is_idle() || !syncs_.empty()) {
    is_due_ = false;
    if (!is_fed()) queue_->hand_over();
    if (is_account_due_) begin_account();
    start_work();
  }
}

void SinkNode::report_result(const SinkTurnResult& turn, Health before) {
  const auto log = [&](LogLevel level, const std::string& text) {
    note([&] { loop()->runtime.log(level, object_name(), text); });
  };
  for (const std::string& remark : turn.remarks) {
    if (is_open()) log(LogLevel::warning, remark);
  }
  if (!is_open()) return;
  if (const auto error = queue_->take_set_up_error()) report(*error, 1);
  if (!is_open()) return;
  if (turn.refused != 0 && !turn.has_ended) {
    note([&] {
      Error error = turn.refusal;
      if (turn.refused > 1) error.where += " (the first of " + std::to_string(turn.refused) + ")";
      report(error, turn.refused);
    });
  }
  if (is_open() && turn.warning) report(*turn.warning, 1);
  // While it closes, it is tried often: an error like the last one is reported at the end, with the number of lost
  // events.
  if (is_open() && !turn.result && !error_already_reported_) report(turn.result.error(), 1);
  if (is_open() && turn.result && before != Health::ok && health_ == Health::ok) log(LogLevel::info, "ok again");
}

}  // namespace rtdata::detail
