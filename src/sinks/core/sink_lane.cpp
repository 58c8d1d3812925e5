// The work of a sink's lane: gathers batches from the queue, passes them to the writer, and counts the results.
#include <algorithm>
#include <limits>
#include <new>
#include <utility>

#include "sinks/core/sink_queue.hpp"

namespace rtdata::detail {
namespace {

/// For the only writing thread: avoids a locked instruction for each of thousands of counters.
void add(std::atomic<std::uint64_t>& sum, std::uint64_t count) noexcept {
  sum.store(sum.load(std::memory_order_relaxed) + count, std::memory_order_relaxed);
}

/// Its texts are short enough to need none.
Error no_memory() { return {Errc::io_failed, "cannot store", "", "no memory", ""}; }

}  // namespace

void SinkQueue::pause(Duration duration) {
  std::unique_lock lock(abandon_mutex_);
  abandoned_signal_.wait_for(lock, duration, [this] { return abandoned_; });
}

ChunkHeader* SinkQueue::next_queued(std::uint64_t before) {
  // Chunks queued during the search could hide an earlier one, so they are left for later.
  before = std::min(before, last_ticket_.load(std::memory_order_acquire) + 1);
  for (;;) {
    ChunkHeader* next = nullptr;
    std::uint64_t next_value = 0;
    for (ChunkHeader& chunk : used_chunks()) {
      const std::uint64_t value = chunk.ticket_and_state.load(std::memory_order_acquire);
      if ((value & 3) == ChunkHeader::queued && value >> 2 < before && (next == nullptr || value < next_value)) {
        next = &chunk;
        next_value = value;
      }
    }
    if (next == nullptr) return nullptr;
    // The loop may take it back at this moment.
    if (next->ticket_and_state.compare_exchange_strong(next_value,
                                                       ticket_in_state(next_value >> 2, ChunkHeader::writing))) {
      taken_ticket_ = next_value >> 2;
      return next;
    }
  }
}

bool SinkQueue::gather() {
  slots_in_batch_.reserve(slot_count());  // here, where nothing has changed yet, it may throw
  batch_.chunks_.clear();
  batch_.rows_ = 0;
  batch_.account_ = nullptr;
  AccountBox& box = accounts_[account_cursor_];
  const std::uint64_t after = box.after_ticket.load(std::memory_order_acquire);
  const std::uint64_t before = after != 0 ? after : std::numeric_limits<std::uint64_t>::max();
  // Stores everything that waits together, in short transactions.
  const std::size_t window_rows = sender_ != nullptr ? sending_.window * sending_.parcel_rows : 0;
  const std::size_t enough_rows = pace_.bytes == 0 ? std::max(config_.batch_rows, window_rows) : 1;
  bool has_all = false;                     // all before the account has been gathered, or was taken back by the loop
  const bool takes_all = feed_ != nullptr;  // rows that a recording gave together are settled together
  while ((takes_all || batch_.rows_ < enough_rows || batch_.chunks_.size() < most_chunks_) && !has_all) {
    ChunkHeader* chunk = next_queued(before);
    has_all = chunk == nullptr || taken_ticket_ + 1 == before;
    if (chunk == nullptr) break;
    batch_.chunks_.push_back(chunk);
    batch_.rows_ += chunk->rows;
  }
  if (after != 0 && has_all) batch_.account_ = &box.account;
  if (batch_.chunks_.empty() && batch_.account_ == nullptr) return false;
  slots_in_batch_.clear();
  for (const ChunkHeader* chunk : batch_.chunks_) {
    SlotStored* of = nullptr;
    std::uint32_t count = 0;  // of it, that follow one another
    const auto add_run = [&] {
      if (count == 0) return;
      if (of->in_batch == 0) slots_in_batch_.push_back(of);
      of->in_batch += std::exchange(count, 0);
    };
    for_each_record(*chunk, [&](const RecordHeader& header) {
      if (header.stored != of) add_run();
      of = header.stored;
      ++count;
    });
    add_run();
  }
  return true;
}

void SinkQueue::finish_batch() {
  const std::lock_guard lock(abandon_mutex_);
  if (abandoned_) return;
  if (feed_ != nullptr) feed_->settled(batch_.rows_);
  revision_.fetch_add(1, std::memory_order_acq_rel);
  for (SlotStored* s : slots_in_batch_) {
    add(s->stored, s->in_batch - s->refused_in_batch);
    if (s->refused_in_batch != 0) add(s->refused, s->refused_in_batch);
    s->in_batch = s->refused_in_batch = 0;
  }
  for (ChunkHeader* chunk : batch_.chunks_) {
    chunk->ticket_and_state.store(ticket_in_state(0, ChunkHeader::free), std::memory_order_release);
  }
  if (batch_.account_ != nullptr) {
    AccountBox& box = accounts_[account_cursor_];
    account_cursor_ = (account_cursor_ + 1) % account_count;
    box.after_ticket.store(0, std::memory_order_release);
  }
  rows_settled_.store(0, std::memory_order_relaxed);
  revision_.fetch_add(1, std::memory_order_acq_rel);
  has_batch_ = false;
  if (topic_fault_.empty()) topic_fault_ = std::exchange(topic_fault_in_batch_, {});
  if (refusals_in_batch_ == 0) return;
  if (refusals_ == 0) first_refusal_ = std::move(first_refusal_in_batch_);
  refusals_ += std::exchange(refusals_in_batch_, 0);
}

void SinkQueue::fail_batch() noexcept {
  is_open_ = false;
  parcels_.clear();
  refusals_in_batch_ = 0;
  topic_fault_in_batch_.clear();
  if (!has_batch_) return;
  for (SlotStored* s : slots_in_batch_) s->refused_in_batch = 0;
}

void SinkQueue::refuse_batch() {
  for (SlotStored* s : slots_in_batch_) s->refused_in_batch = s->in_batch;
}

template <class Call>
Result<void> SinkQueue::call_writer(Call&& call) {
  Result<void> result;
  try {
    try {
      result = call();
    } catch (const std::bad_alloc&) {
      throw;
    } catch (const std::exception& e) {
      result = Error{Errc::handler_threw, "the writer threw", "", std::string(reason_of(e)), ""};
    } catch (...) {
      result = Error{Errc::handler_threw, "the writer threw", "", "an exception that is not a std::exception", ""};
    }
  } catch (...) {
    result = no_memory();
  }
  if (!result) {
    fail_batch();
    if (result.error().code == Errc::closed) has_ended_ = true;
  }
  return result;
}

bool SinkQueue::is_abandoned() {
  const std::lock_guard lock(abandon_mutex_);
  return abandoned_;
}

Result<void> SinkQueue::open() {
  if (has_ended_ || is_open_) return {};
  // Each time, so that the backlog is known while the peer is away.
  if (feed_ != nullptr) {
    if (auto attached = call_writer([this] { return feed_->attach(); }); !attached) return attached;
  }
  auto result = call_writer([this] { return writer_->open(); });
  is_open_ = result || has_ended_;
  return result;
}

Result<void> SinkQueue::store() {
  if (!is_open_ && !has_batch_ && feed_ == nullptr && is_idle()) return {};  // there is nothing to open it for
  Result<void> result;
  for (;;) {
    if (is_abandoned()) return result;
    if (!has_ended_ && !is_open_) {
      result = open();
      if (!is_open_) return result;
    }
    if (!has_batch_) {
      if (auto filled = call_writer([this] { return fill(); }); !filled) return filled;
      if (!gather()) break;
    }
    has_batch_ = true;
    if (!has_ended_) {
      result = call_writer([this] { return sender_ != nullptr ? encode() : writer_->write(batch_); });
      if (!result && !has_ended_) return result;
    }
    if (has_ended_) refuse_batch();
    if (!parcels_.empty()) return result;  // the loop sends them
    finish_batch();
  }
  if (has_ended_) return result;  // the error that ended it, once
  return call_writer([this] { return writer_->flush(); });
}

Result<void> SinkQueue::do_task(SinkTurn::Task task) {
  if (task == SinkTurn::Task::open) return is_abandoned() ? Result<void>{} : open();
  if (auto stored = store(); !stored || is_abandoned() || !parcels_.empty()) return stored;
  switch (task) {
    case SinkTurn::Task::store_and_sync:
      return recording_ != nullptr ? call_writer([this] { return recording_->sync(); }) : Result<void>{};
    case SinkTurn::Task::store_and_close:
      return is_open_ ? call_writer([this] { return writer_->close(); }) : Result<void>{};
    default:
      return {};
  }
}

SinkTurnResult SinkQueue::work(const SinkTurn& turn) noexcept {
  if (turn.pause.count() > 0) pause(turn.pause);
  to_utc_ = turn.to_utc;
  SinkTurnResult now;
  now.task = turn.task;
  try {
    now.result = do_task(turn.task);
  } catch (...) {  // no memory, not even for an error: the batch is tried again
    now.result = no_memory();
  }
  now.has_ended = has_ended_;
  now.has_parcels = !parcels_.empty();
  try {
    now.refused = take_refusals(now.refusal);
    now.topic_fault = topic_fault_;
    if (recording_ != nullptr) {
      now.warning = recording_->take_warning();
      now.remarks = recording_->take_remarks();
    }
    if (feed_ != nullptr) {
      for (std::string& remark : feed_->take_remarks()) now.remarks.push_back(std::move(remark));
    }
  } catch (...) {  // a warning less
  }
  return now;
}

void SinkQueue::note_topic_fault(const Error& why) {
  if (topic_fault_in_batch_.empty()) topic_fault_in_batch_ = why.text();
}

void SinkQueue::note_refusal(std::uint32_t index, std::uint64_t sequence, const Error& why) {
  if (feed_ != nullptr) feed_->refused(slot(index).info, sequence, why);
  ++stored(index).refused_in_batch;
  if (refusals_in_batch_++ == 0) first_refusal_in_batch_ = why;
}

std::uint64_t SinkQueue::take_refusals(Error& why) {
  if (refusals_ != 0) why = first_refusal_;
  return std::exchange(refusals_, 0);
}

}  // namespace rtdata::detail
