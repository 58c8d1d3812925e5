#include "sinks/core/sink_queue.hpp"

#include <sys/mman.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <limits>
#include <new>
#include <utility>

namespace rtdata {

LiveCounts* RecordingWriter::live_counts(std::uint32_t) { return nullptr; }
void RecordingWriter::keep(const OriginAccount&, const Gap*) {}
Result<void> RecordingWriter::add_topic(std::uint32_t, std::string_view, const Description&) { return {}; }

namespace detail {
namespace {

template <class Function>
void for_each_record(const ChunkHeader& chunk, Function&& function) {
  for (std::size_t at = 0; at < chunk.used;) {
    SlotStored& stored = *reinterpret_cast<const RecordHeader*>(chunk.data + at)->stored;
    function(stored);
    at += record_bytes_of(stored.payload_bytes);
  }
}

/// For the only thread that writes it: no locked instruction for each of thousands.
void add(std::atomic<std::uint64_t>& sum, std::uint64_t count) noexcept {
  sum.store(sum.load(std::memory_order_relaxed) + count, std::memory_order_relaxed);
}

constexpr std::size_t most_chunks_together = 16;

/// Its texts are short enough to need none.
Error no_memory() { return {Errc::io_failed, "cannot store", "", "no memory", ""}; }

constexpr std::uint64_t with(std::uint64_t ticket, ChunkHeader::State state) { return ticket << 2 | state; }

}  // namespace

SinkQueue::SinkQueue(const SinkConfig& config, std::unique_ptr<Writer> writer)
    : config_(config),
      writer_(std::move(writer)),
      recording_(writer_->as_recording()),
      opens_at_set_up_(recording_ != nullptr && recording_->opening() == RecordingWriter::Opening::at_set_up),
      pace_(recording_ != nullptr ? recording_->pace() : StorePace{}),
      due_rows_(pace_.bytes == 0 ? config.batch_rows : std::numeric_limits<std::size_t>::max()),
      chunks_(std::max<std::size_t>(config.queue_bytes / chunk_bytes, 4)),
      counts_live_(recording_ != nullptr && !opens_at_set_up_) {
  const std::size_t part = std::max<std::size_t>(1, chunks_.size() / 8);
  due_chunks_ = pace_.bytes == 0 ? (chunks_.size() + 1) / 2
                                 : std::clamp<std::size_t>(pace_.bytes / chunk_bytes, 1, part);
  most_chunks_ = pace_.bytes == 0 ? std::min(most_chunks_together, chunks_.size() / 8) : due_chunks_ + 1;
  // Pages are the kernel's until they are used: a queue that never fills costs no memory.
  memory_bytes_ = chunks_.size() * chunk_bytes;
  void* memory = ::mmap(nullptr, memory_bytes_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1,
                        0);
  if (memory == MAP_FAILED) {
    throw SetupError(system_error(errno, "cannot set aside the queue", config.name, "make `queue_bytes` smaller"));
  }
  memory_ = static_cast<std::byte*>(memory);
  for (std::size_t i = 0; i < chunks_.size(); ++i) chunks_[i].data = memory_ + i * chunk_bytes;
  batch_.queue_ = this;
  batch_.chunks_.reserve(chunks_.size());
}

SinkQueue::~SinkQueue() {
  ::munmap(memory_, memory_bytes_);
  for (auto& block : blocks_) delete[] block.load(std::memory_order_relaxed);
  for (auto& block : stored_blocks_) delete[] block.load(std::memory_order_relaxed);
}

std::uint32_t SinkQueue::add_slot(SlotInfo info) {
  const std::uint32_t index = slot_count_.load(std::memory_order_relaxed);
  if (index == most_slots)
    throw SetupError({Errc::bad_argument, "too many origins", config_.name,
                      "a sink takes at most " + std::to_string(most_slots), ""});
  const Place at = place_of(index);
  if (at.offset == 0) {
    auto slots = std::make_unique<Slot[]>(first_block << at.block);
    stored_blocks_[at.block].store(new SlotStored[first_block << at.block], std::memory_order_release);
    blocks_[at.block].store(slots.release(), std::memory_order_release);
  }
  Slot& made = slot(index);
  made.info = std::move(info);
  SlotStored& stored_of = stored(index);
  stored_of.info = &made.info;
  stored_of.index = index;
  if (made.info.description != nullptr)  // else no event of it ever comes
    stored_of.payload_bytes = static_cast<std::uint32_t>(made.info.description->size());
  if (LiveCounts* live = live_counts_of(index)) made.live = live;
  slot_count_.store(index + 1, std::memory_order_release);
  return index;
}

void SinkQueue::note_set_up_error(const char* call) noexcept {
  if (set_up_error_) return;
  const char* what = "an exception that is no std::exception";
  try {
    try {
      throw;
    } catch (const std::exception& e) {
      set_up_error_ = {Errc::handler_threw, "the writer threw", call, e.what(), "the sink goes on without it"};
    } catch (...) {
      set_up_error_ = {Errc::handler_threw, "the writer threw", call, what, "the sink goes on without it"};
    }
  } catch (...) {  // no memory, not even for an error: texts that need none
    set_up_error_ = Error{Errc::io_failed, "no memory", call, "", ""};
  }
}

template <class Call>
void SinkQueue::call_on_loop(const char* name, Call&& call) noexcept {
  try {
    call();
  } catch (...) {
    note_set_up_error(name);
  }
}

LiveCounts* SinkQueue::live_counts_of(std::uint32_t index) noexcept {
  LiveCounts* counts = nullptr;
  if (counts_live_) call_on_loop("live_counts", [&] { counts = recording_->live_counts(index); });
  return counts;
}

void SinkQueue::move_counts() noexcept {
  counts_live_ = true;
  for (std::uint32_t i = 0; i < slot_count(); ++i) {
    LiveCounts* live = live_counts_of(i);
    if (live == nullptr) continue;
    *live = *slot(i).live;
    slot(i).live = live;
  }
}

void SinkQueue::begin_counting() noexcept {
  call_on_loop("begin_counting", [&] { recording_->begin_counting(); });
}

void SinkQueue::keep(const OriginAccount& now, const Gap* closed) noexcept {
  if (counts_live_) call_on_loop("keep", [&] { recording_->keep(now, closed); });
}

ChunkHeader* SinkQueue::take_chunk(std::uint32_t index) {
  const std::uint64_t revision = revision_.load(std::memory_order_acquire);
  if (revision != full_at_revision_) {  // else the lane has freed none since the last look
    for (ChunkHeader& chunk : chunks_) {
      if ((chunk.ticket_and_state.load(std::memory_order_acquire) & 3) == ChunkHeader::free) return &chunk;
    }
  }
  full_at_revision_ = revision;
  const auto drop_newest = [&] {
    Slot& lost = slot(index);
    ++lost.dropped_newest;
    ++lost.live->dropped;
    return nullptr;
  };
  if (config_.when_full == WhenFull::drop_newest) return drop_newest();
  for (;;) {
    ChunkHeader* oldest = nullptr;
    std::uint64_t oldest_value = 0;
    for (ChunkHeader& chunk : chunks_) {
      const std::uint64_t value = chunk.ticket_and_state.load(std::memory_order_acquire);
      if ((value & 3) == ChunkHeader::queued && (oldest == nullptr || value < oldest_value)) {
        oldest = &chunk;
        oldest_value = value;
      }
    }
    if (oldest == nullptr) return drop_newest();  // the lane is at work on all of them
    if (!oldest->ticket_and_state.compare_exchange_strong(oldest_value, with(oldest_value >> 2, ChunkHeader::filling)))
      continue;
    for_each_record(*oldest, [this](const SlotStored& stored) {
      Slot& lost = slot(stored.index);
      ++lost.dropped_oldest;
      ++lost.live->dropped;
    });
    return oldest;
  }
}

std::byte* SinkQueue::room(std::uint32_t slot, std::size_t bytes) {
  if (filling_ != nullptr && filling_->used + bytes > chunk_bytes) {
    queue_filling();
    ++full_chunks_;
  }
  if (filling_ == nullptr) {
    filling_ = take_chunk(slot);
    if (filling_ == nullptr) return nullptr;
    filling_->used = 0;
    filling_->rows = 0;
    filling_->ticket_and_state.store(with(0, ChunkHeader::filling), std::memory_order_relaxed);
  }
  return filling_->data + filling_->used;
}

void SinkQueue::queue_filling() {
  filling_->ticket_and_state.store(with(++last_ticket_, ChunkHeader::queued), std::memory_order_release);
  filling_ = nullptr;
}

bool SinkQueue::hand_over() {
  const bool has_rows = filling_ != nullptr && filling_->rows != 0;
  const bool is_due = has_rows || full_chunks_ != 0;
  if (has_rows) queue_filling();
  rows_since_account_ += std::exchange(rows_since_handover_, 0);
  full_chunks_ = 0;
  return is_due;
}

bool SinkQueue::has_account() const noexcept {
  return accounts_[(next_account_ + 1) % account_count].after_ticket.load(std::memory_order_acquire) == 0;
}

void SinkQueue::hand_over_account() {
  accounts_[next_account_].after_ticket.store(last_ticket_ + 1, std::memory_order_release);
  next_account_ = (next_account_ + 1) % account_count;
  rows_since_account_ = 0;
}

SinkCounts SinkQueue::counts() const noexcept {
  constexpr int most_tries = 100;  // the lane holds the revision odd for the time that counting one batch takes
  SinkCounts result;
  for (int i = 0; i < most_tries; ++i) {
    const std::uint64_t before = revision_.load(std::memory_order_acquire);
    result = sum();
    const std::uint64_t after = const_cast<std::atomic<std::uint64_t>&>(revision_).fetch_add(0,
                                                                                             std::memory_order_acq_rel);
    if (before == after && before % 2 == 0) break;
  }
  return result;
}

void SinkQueue::keep_own_counts() noexcept {
  for (std::uint32_t i = 0; i < slot_count(); ++i) {
    Slot& s = slot(i);
    s.own = *s.live;
    s.live = &s.own;
  }
}

void SinkQueue::abandon() {
  const std::lock_guard lock(abandon_mutex_);
  abandoned_ = true;
  abandoned_signal_.notify_all();
}

SinkCounts SinkQueue::sum() const noexcept {
  SinkCounts sum;
  for (std::uint32_t i = 0; i < slot_count(); ++i) {
    const Slot& s = slot(i);
    const std::uint64_t refused = stored(i).refused.load(std::memory_order_relaxed);
    sum.offered += s.live->offered;
    sum.stored += stored(i).stored.load(std::memory_order_relaxed);
    sum.dropped[static_cast<std::size_t>(DropReason::queue_full_newest)] += s.dropped_newest;
    sum.dropped[static_cast<std::size_t>(DropReason::queue_full_oldest)] += s.dropped_oldest;
    sum.dropped[static_cast<std::size_t>(DropReason::refused)] += refused;
  }
  for (const ChunkHeader& chunk : chunks_) {
    if ((chunk.ticket_and_state.load(std::memory_order_acquire) & 3) != ChunkHeader::free) sum.queued += chunk.rows;
  }
  return sum;
}

std::vector<TopicDrops> SinkQueue::dropped_by_topic(Queued queued) const {
  std::vector<TopicDrops> all;
  for (std::uint32_t i = 0; i < slot_count(); ++i) {
    const Slot& s = slot(i);
    const SlotStored& lane = stored(i);
    const std::uint64_t dropped = queued == Queued::lost ? s.live->offered - lane.stored.load(std::memory_order_relaxed)
                                                         : s.dropped_newest + s.dropped_oldest +
                                                               lane.refused.load(std::memory_order_relaxed);
    if (all.size() <= s.info.topic_number) all.resize(s.info.topic_number + 1);
    all[s.info.topic_number].topic = s.info.topic;
    all[s.info.topic_number].count += dropped;
  }
  std::erase_if(all, [](const TopicDrops& topic) { return topic.count == 0; });
  return all;
}

bool SinkQueue::is_idle() const noexcept {
  for (const ChunkHeader& chunk : chunks_) {
    const auto state = chunk.ticket_and_state.load(std::memory_order_acquire) & 3;
    if (state == ChunkHeader::queued || state == ChunkHeader::writing) return false;
  }
  for (const AccountBox& box : accounts_) {
    if (box.after_ticket.load(std::memory_order_acquire) != 0) return false;
  }
  return true;
}

// ---- lane

void SinkQueue::pause(Duration duration) {
  std::unique_lock lock(abandon_mutex_);
  abandoned_signal_.wait_for(lock, duration, [this] { return abandoned_; });
}

ChunkHeader* SinkQueue::next_queued(std::uint64_t before) {
  for (;;) {
    ChunkHeader* next = nullptr;
    std::uint64_t next_value = 0;
    for (ChunkHeader& chunk : chunks_) {
      const std::uint64_t value = chunk.ticket_and_state.load(std::memory_order_acquire);
      if ((value & 3) == ChunkHeader::queued && value >> 2 < before && (next == nullptr || value < next_value)) {
        next = &chunk;
        next_value = value;
      }
    }
    if (next == nullptr) return nullptr;
    // The loop may take it back at this moment.
    if (next->ticket_and_state.compare_exchange_strong(next_value, with(next_value >> 2, ChunkHeader::writing))) {
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
  // What waits already is stored together, in transactions that stay short.
  const std::size_t enough_rows = pace_.bytes == 0 ? config_.batch_rows : 1;
  bool has_all = false;  // all before the account has been gathered, or was taken back by the loop
  while ((batch_.rows_ < enough_rows || batch_.chunks_.size() < most_chunks_) && !has_all) {
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
    for_each_record(*chunk, [this](SlotStored& counts) {
      if (counts.in_batch++ == 0) slots_in_batch_.push_back(&counts);
    });
  }
  return true;
}

void SinkQueue::finish_batch() {
  const std::lock_guard lock(abandon_mutex_);
  if (abandoned_) return;
  revision_.fetch_add(1, std::memory_order_acq_rel);
  for (SlotStored* s : slots_in_batch_) {
    add(s->stored, s->in_batch - s->refused_in_batch);
    if (s->refused_in_batch != 0) add(s->refused, s->refused_in_batch);
    s->in_batch = s->refused_in_batch = 0;
  }
  for (ChunkHeader* chunk : batch_.chunks_) {
    chunk->ticket_and_state.store(with(0, ChunkHeader::free), std::memory_order_release);
  }
  if (batch_.account_ != nullptr) {
    AccountBox& box = accounts_[account_cursor_];
    account_cursor_ = (account_cursor_ + 1) % account_count;
    box.after_ticket.store(0, std::memory_order_release);
  }
  revision_.fetch_add(1, std::memory_order_acq_rel);
  has_batch_ = false;
  if (topic_fault_.empty()) topic_fault_ = std::exchange(topic_fault_in_batch_, {});
  if (refusals_in_batch_ == 0) return;
  if (refusals_ == 0) first_refusal_ = std::move(first_refusal_in_batch_);
  refusals_ += std::exchange(refusals_in_batch_, 0);
}

void SinkQueue::fail_batch() noexcept {
  is_open_ = false;
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
      result = Error{Errc::handler_threw, "the writer threw", "", e.what(), ""};
    } catch (...) {
      result = Error{Errc::handler_threw, "the writer threw", "", "an exception that is no std::exception", ""};
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
  auto result = call_writer([this] { return writer_->open(); });
  is_open_ = result || has_ended_;
  return result;
}

Result<void> SinkQueue::store() {
  Result<void> result;
  for (;;) {
    if (is_abandoned()) return result;
    if (!has_ended_ && !is_open_) {
      result = open();
      if (!is_open_) return result;
    }
    if (!has_batch_ && !gather()) break;
    has_batch_ = true;
    if (!has_ended_) {
      result = call_writer([this] { return writer_->write(batch_); });
      if (!result && !has_ended_) return result;
    }
    if (has_ended_) refuse_batch();
    finish_batch();
  }
  if (has_ended_) return result;  // the error that ended it, once
  return call_writer([this] { return writer_->flush(); });
}

Result<void> SinkQueue::do_task(SinkTurn::Task task) {
  if (task == SinkTurn::Task::open) return is_abandoned() ? Result<void>{} : open();
  if (auto stored = store(); !stored || is_abandoned()) return stored;
  switch (task) {
    case SinkTurn::Task::store_and_sync:
      return recording_ != nullptr ? call_writer([this] { return recording_->sync(); }) : Result<void>{};
    case SinkTurn::Task::store_and_close:
      return call_writer([this] { return writer_->close(); });
    default:
      return {};
  }
}

SinkTurnResult SinkQueue::work(const SinkTurn& turn) noexcept {
  if (turn.pause.count() > 0) pause(turn.pause);
  SinkTurnResult now;
  now.task = turn.task;
  try {
    now.result = do_task(turn.task);
  } catch (...) {  // no memory, not even for an error: the batch is tried again
    now.result = no_memory();
  }
  now.has_ended = has_ended_;
  try {
    now.refused = take_refusals(now.refusal);
    now.topic_fault = topic_fault_;
    if (recording_ != nullptr) {
      now.warning = recording_->take_warning();
      now.remarks = recording_->take_remarks();
    }
  } catch (...) {  // a warning less
  }
  return now;
}

void SinkQueue::note_topic_fault(const Error& why) {
  if (topic_fault_in_batch_.empty()) topic_fault_in_batch_ = why.text();
}

void SinkQueue::note_refusal(std::uint32_t index, const Error& why) {
  ++stored(index).refused_in_batch;
  if (refusals_in_batch_++ == 0) first_refusal_in_batch_ = why;
}

std::uint64_t SinkQueue::take_refusals(Error& why) {
  if (refusals_ != 0) why = first_refusal_;
  return std::exchange(refusals_, 0);
}

}  // namespace detail

// ---- Batch

Record Batch::Iterator::operator*() const noexcept {
  const std::byte* at = batch_->chunks_[chunk_]->data + offset_;
  const auto* record = reinterpret_cast<const detail::RecordHeader*>(at);
  const detail::SlotStored& slot = *record->stored;
  return {slot.index,
          slot.info,
          {from_nanoseconds(record->time), record->sequence, slot.info->origin},
          {at + sizeof *record, slot.payload_bytes}};
}

Batch::Iterator& Batch::Iterator::operator++() noexcept {
  const detail::ChunkHeader& chunk = *batch_->chunks_[chunk_];
  offset_ += detail::record_bytes_of(
      reinterpret_cast<const detail::RecordHeader*>(chunk.data + offset_)->stored->payload_bytes);
  if (offset_ >= chunk.used) {
    offset_ = 0;
    ++chunk_;
  }
  return *this;
}

Batch::Iterator Batch::begin() const { return Iterator(*this, 0); }
Batch::Iterator Batch::end() const { return Iterator(*this, chunks_.size()); }
const SlotInfo& Batch::slot(std::uint32_t slot) const noexcept { return queue_->slot(slot).info; }
std::size_t Batch::slots() const noexcept { return queue_->slot_count(); }
std::uint64_t Batch::stored_after(std::uint32_t slot) const noexcept {
  const detail::SlotStored& s = queue_->stored(slot);
  return s.stored.load(std::memory_order_relaxed) + s.in_batch - s.refused_in_batch;
}
std::uint64_t Batch::refused_after(std::uint32_t slot) const noexcept {
  const detail::SlotStored& s = queue_->stored(slot);
  return s.refused.load(std::memory_order_relaxed) + s.refused_in_batch;
}
void Batch::refuse(const Record& record, const Error& why) { queue_->note_refusal(record.slot, why); }
void Batch::refuse_topic(const Record& record, const Error& why) {
  queue_->note_refusal(record.slot, why);
  queue_->note_topic_fault(why);
}

}  // namespace rtdata
