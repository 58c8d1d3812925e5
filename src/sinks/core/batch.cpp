// A batch as a writer sees it: the records of the chunks that the lane has gathered.
#include "sinks/core/sink_queue.hpp"

namespace rtdata {

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
void Batch::refuse(const Record& record, const Error& why) {
  queue_->note_refusal(record.slot, record.header.sequence, why);
}
void Batch::refuse_topic(const Record& record, const Error& why) {
  queue_->note_refusal(record.slot, record.header.sequence, why);
  queue_->note_topic_fault(why);
}

}  // namespace rtdata
