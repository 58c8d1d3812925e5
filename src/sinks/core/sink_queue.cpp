#include "sinks/core/sink_queue.hpp"

#include <sys/mman.h>

#include <algorithm>
#include <cerrno>
#include <limits>
#include <utility>

namespace rtdata {

LiveCounts* RecordingWriter::live_counts(std::uint32_t) { return nullptr; }
void RecordingWriter::keep(const OriginAccount&, const Gap*) {}
std::unique_ptr<detail::RowFeed> RecordingWriter::feed(const detail::RowFeedConfig&) { return nullptr; }
Result<void> RecordingWriter::add_topic(std::uint32_t, std::string_view, const Description&) { return {}; }

namespace detail {
namespace {

constexpr std::size_t most_chunks_together = 16;

}  // namespace

SinkQueue::SinkQueue(const SinkConfig& config, std::unique_ptr<Writer> writer)
    : config_(config),
      writer_(std::move(writer)),
      recording_(writer_->as_recording()),
      sender_(writer_->as_sender()),
      sending_(sender_ != nullptr ? sender_->sending() : SendingConfig{}),
      opens_at_set_up_(recording_ != nullptr && recording_->opening() == RecordingWriter::Opening::at_set_up),
      pace_(recording_ != nullptr ? recording_->pace() : StorePace{}),
      due_rows_(pace_.bytes == 0 ? config.batch_rows : std::numeric_limits<std::size_t>::max()),
      chunks_(std::max<std::size_t>(config.queue_bytes / chunk_bytes, 4)) {
  const std::size_t part = std::max<std::size_t>(1, chunks_.size() / 8);
  due_chunks_ = pace_.bytes == 0 ? (chunks_.size() + 1) / 2
                                 : std::clamp<std::size_t>(pace_.bytes / chunk_bytes, 1, part);
  most_chunks_ = pace_.bytes == 0 ? std::min(most_chunks_together, chunks_.size() / 8) : due_chunks_ + 1;
  // Pages are the kernel's until they are used: a queue that never fills costs no memory.
  memory_bytes_ = chunks_.size() * chunk_bytes;
  void* memory = ::mmap(nullptr, memory_bytes_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1,
                        0);
  if (memory == MAP_FAILED) {
    throw SetupError(system_error(errno, "cannot allocate the queue", config.name, "make `queue_bytes` smaller"));
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
  const SlotLocation at = location_of(index);
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
  const char* what = "an exception that is not a std::exception";
  try {
    try {
      throw;
    } catch (const std::exception& e) {
      set_up_error_ = {Errc::handler_threw, "the writer threw", call, std::string(reason_of(e)),
                       "the sink goes on without it"};
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
  if (recording_ != nullptr) call_on_loop("live_counts", [&] { counts = recording_->live_counts(index); });
  return counts;
}

void SinkQueue::keep(const OriginAccount& now, const Gap* closed) noexcept {
  if (recording_ != nullptr) call_on_loop("keep", [&] { recording_->keep(now, closed); });
}

ChunkHeader* SinkQueue::take_chunk(std::uint32_t index) {
  const std::uint64_t revision = revision_.load(std::memory_order_acquire);
  if (revision != full_at_revision_) {  // else the lane has freed none since the last look
    for (ChunkHeader& chunk : used_chunks()) {
      if ((chunk.ticket_and_state.load(std::memory_order_acquire) & 3) == ChunkHeader::free) return &chunk;
    }
    const std::size_t used = used_.load(std::memory_order_relaxed);
    if (used < chunks_.size()) {
      used_.store(used + 1, std::memory_order_release);
      return &chunks_[used];
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
    for (ChunkHeader& chunk : used_chunks()) {
      const std::uint64_t value = chunk.ticket_and_state.load(std::memory_order_acquire);
      if ((value & 3) == ChunkHeader::queued && (oldest == nullptr || value < oldest_value)) {
        oldest = &chunk;
        oldest_value = value;
      }
    }
    if (oldest == nullptr) return drop_newest();  // the lane is at work on all of them
    if (!oldest->ticket_and_state.compare_exchange_strong(oldest_value,
                                                          ticket_in_state(oldest_value >> 2, ChunkHeader::filling)))
      continue;
    for_each_record(*oldest, [this](const RecordHeader& header) {
      Slot& lost = slot(header.stored->index);
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
    filling_->ticket_and_state.store(ticket_in_state(0, ChunkHeader::filling), std::memory_order_relaxed);
  }
  return filling_->data + filling_->used;
}

void SinkQueue::queue_filling() {
  const std::uint64_t ticket = last_ticket_.load(std::memory_order_relaxed) + 1;
  filling_->ticket_and_state.store(ticket_in_state(ticket, ChunkHeader::queued), std::memory_order_release);
  last_ticket_.store(ticket, std::memory_order_release);
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
  accounts_[next_account_].after_ticket.store(last_ticket_.load(std::memory_order_relaxed) + 1,
                                              std::memory_order_release);
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
    sum.stored += stored(i).stored.load(std::memory_order_relaxed);
    sum.dropped[static_cast<std::size_t>(DropReason::refused)] += refused;
    if (feed_ != nullptr) continue;
    sum.offered += s.live->offered;
    sum.dropped[static_cast<std::size_t>(DropReason::queue_full_newest)] += s.dropped_newest;
    sum.dropped[static_cast<std::size_t>(DropReason::queue_full_oldest)] += s.dropped_oldest;
  }
  if (feed_ != nullptr) {  // the lane fills the queue, and the recording knows what waits
    const FeedCounts fed = feed_->counts();
    sum.offered = fed.offered;
    sum.queued = fed.backlog;
    sum.dropped[static_cast<std::size_t>(DropReason::queue_full_oldest)] = fed.removed;
    return sum;
  }
  for (const ChunkHeader& chunk : used_chunks()) {
    if ((chunk.ticket_and_state.load(std::memory_order_acquire) & 3) != ChunkHeader::free) sum.queued += chunk.rows;
  }
  sum.queued -= std::min(sum.queued, rows_settled_.load(std::memory_order_relaxed));
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
  for (const ChunkHeader& chunk : used_chunks()) {
    const auto state = chunk.ticket_and_state.load(std::memory_order_acquire) & 3;
    if (state == ChunkHeader::queued || state == ChunkHeader::writing) return false;
  }
  for (const AccountBox& box : accounts_) {
    if (box.after_ticket.load(std::memory_order_acquire) != 0) return false;
  }
  return true;
}

}  // namespace detail
}  // namespace rtdata
