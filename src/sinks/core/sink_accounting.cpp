// When a sink hands over accounts, and in which parts.
#include <algorithm>

#include "data/saturating.hpp"
#include "sinks/core/sink_node.hpp"

namespace rtdata::detail {
namespace {

constexpr Duration pause_between_parts = std::chrono::milliseconds{1};
constexpr Duration early_after = std::chrono::milliseconds{10};

}  // namespace

bool SinkNode::is_account_worth_it() const noexcept {
  constexpr std::uint64_t events_an_origin = 50;  // so that accounts are not larger than their events
  const StorePace& pace = queue_->pace();
  const std::uint64_t slots = queue_->slot_count();
  return pace.account_time.count() == 0 || !account_.notes.is_empty() || slots != reported_slots_ ||
         span_between(account_at_, loop()->now()) >= pace.account_time ||
         queue_->rows_since_account() >= std::max(pace.account_events, events_an_origin * slots);
}

void SinkNode::set_account_timer() {
  if (is_between_parts_) {
    account_timer_.start(pause_between_parts);
  } else if (early_at_) {
    account_timer_.start_at(*early_at_);
  } else {
    account_timer_.stop();
  }
}

/// As at attaching: what tiers counted before does not belong to this recording.
void SinkNode::follow_timer_fired() {
  if (life_ != Life::attached) return;
  const std::string unknown = loop()->runtime.exchange.catch_up(std::chrono::seconds{1});
  if (!unknown.empty())
    unknown_ += (unknown_.empty() ? "" : "; ") + ("the sink added accounts to its ledger, although " + unknown);
  if (life_ == Life::attached) account_.follow_all(*this);
}

void SinkNode::account_is_due() {
  const MonotonicTime now = loop()->now();
  if (life_ != Life::attached || early_at_ || now < next_early_) return;
  next_early_ = later(now, config_.batch_time);
  early_at_ = later(now, early_after);
  if (!is_between_parts_) set_account_timer();
}

void SinkNode::account_timer_fired() {
  if (life_ != Life::attached) return;
  if (!is_between_parts_) {
    early_at_.reset();
    if (is_waiting()) {
      is_account_due_ = true;
    } else if (begin_account()) {
      start_work();
    }
  } else if (is_waiting() || !account_.has_room()) {
    set_account_timer();
  } else if (enqueue_account(SinkAccount::Part::next)) {
    start_work();
  }
}

bool SinkNode::begin_account() {
  if (is_between_parts_) return false;  // the one before is under way
  is_account_due_ = !account_.has_room();
  if (is_account_due_) return false;
  account_at_ = loop()->now();
  reported_slots_ = queue_->slot_count();
  return enqueue_account(SinkAccount::Part::first);
}

bool SinkNode::enqueue_account(SinkAccount::Part part) noexcept try {
  if (!queue_->keeps_account()) {  // for a sink that is fed, the recording has it
    is_last_reported_ = part == SinkAccount::Part::last;
    return false;
  }
  is_account_due_ = part != SinkAccount::Part::last;
  if (part == SinkAccount::Part::next) set_account_timer();  // if there is no memory for it now
  if (had_no_memory_) {
    unknown_ += std::string(unknown_.empty() ? "" : "; ") + "there was no memory for some of its reports";
    loop()->runtime.keep_report(
        loop(), object_name(),
        {Errc::io_failed, "not kept", config_.name, "there was no memory for some of its account",
         "the recording marks these counts as unknown"});
    had_no_memory_ = false;
  }
  const Time now = loop()->runtime.clock_log.end(loop()->now());
  const auto enqueued = account_.enqueue(part, now, loop()->deadlines.handled_until(), unknown_);
  is_account_due_ = false;
  had_no_news_ = part == SinkAccount::Part::first && !enqueued.is_something && !enqueued.has_more;
  reported_rows_ = queue_->rows_since_account();
  is_between_parts_ = enqueued.has_more;
  set_account_timer();
  if (part == SinkAccount::Part::last) is_last_reported_ = true;
  return enqueued.is_something;
} catch (...) {  // no memory: nothing has changed
  return false;
}

}  // namespace rtdata::detail
