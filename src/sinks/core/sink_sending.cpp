// Sending a batch: makes parcels on the lane, and counts their answers on the loop.
#include <algorithm>
#include <utility>

#include "sinks/core/sink_queue.hpp"

namespace rtdata::detail {

// ---- lane

Result<void> SinkQueue::fill() {
  if (feed_ == nullptr) return {};
  auto filled = feed_->fill(*this);
  if (!filled) return std::move(filled).error();
  (void)hand_over();
  return {};
}

Parcel& SinkQueue::add_parcel() {
  if (spare_parcels_.empty()) return parcels_.emplace_back();
  parcels_.push_back(std::move(spare_parcels_.back()));
  spare_parcels_.pop_back();
  Parcel& parcel = parcels_.back();
  parcel.rows_.clear();
  parcel.bytes_.clear();
  return parcel;
}

Result<void> SinkQueue::encode() {
  Parcel* parcel = nullptr;
  std::size_t in_batch = 0;
  const SlotStored* slot = nullptr;  // of the record: what it says is the same for all of the slot
  Record record;
  const auto encode_one = [&](const RecordHeader& header) {
    if (slot != header.stored) {
      slot = header.stored;
      record = {slot->index, slot->info, {{}, 0, slot->info->origin}, {}};
    }
    record.header.time = from_nanoseconds(header.time) + to_utc_;
    record.header.sequence = header.sequence;
    record.payload = {reinterpret_cast<const std::byte*>(&header + 1), slot->payload_bytes};
    if (parcel == nullptr || parcel->rows_.size() >= sending_.parcel_rows ||
        parcel->bytes_.size() >= sending_.parcel_bytes) {
      const std::size_t size = parcel != nullptr ? parcel->bytes_.size() : 0;
      parcel = &add_parcel();
      parcel->rows_.reserve(std::min(sending_.parcel_rows, batch_.rows_ - in_batch));
      parcel->bytes_.reserve(size);
    }
    const std::size_t before = parcel->bytes_.size();
    if (auto encoded = sender_->encode(record, parcel->bytes_)) {
      parcel->rows_.push_back(
          {record.info, record.slot, in_batch, record.header.sequence, record.header.time, parcel->bytes_.size()});
    } else {
      parcel->bytes_.resize(before);
      batch_.refuse(record, encoded.error());
    }
    ++in_batch;
  };
  for (const ChunkHeader* chunk : batch_.chunks_) for_each_record(*chunk, encode_one);
  if (parcel != nullptr && parcel->rows_.empty()) parcels_.pop_back();
  return {};
}

// ---- loop

void SinkQueue::settle(std::size_t number, std::size_t first, std::size_t last,
                       std::span<const RefusedRow> refused) noexcept {
  const Parcel& parcel = parcels_[number];
  revision_.fetch_add(1, std::memory_order_acq_rel);
  const std::vector<Parcel::Row>& rows = parcel.rows_;
  for (std::size_t begin = first, end = first; begin < last; begin = end) {
    while (end < last && rows[end].slot == rows[begin].slot) ++end;
    SlotStored& slot = stored(rows[begin].slot);
    slot.in_batch -= static_cast<std::uint32_t>(end - begin);
    slot.stored.fetch_add(end - begin, std::memory_order_relaxed);
  }
  for (const RefusedRow& row : refused) {
    const Parcel::Row& of = parcel.rows_[row.row];
    SlotStored& slot = stored(of.slot);
    slot.stored.fetch_sub(1, std::memory_order_relaxed);
    slot.refused.fetch_add(1, std::memory_order_relaxed);
    try {
      if (refusals_ == 0) first_refusal_ = row.why;
      if (feed_ != nullptr) feed_->refused(*of.info, of.sequence, row.why);
    } catch (...) {  // no memory: counted without its reason
    }
    ++refusals_;
  }
  rows_settled_.fetch_add(last - first, std::memory_order_relaxed);
  if (feed_ != nullptr) feed_->settled(rows[last - 1].in_batch + 1);
  revision_.fetch_add(1, std::memory_order_acq_rel);
}

void SinkQueue::end_sending() noexcept {
  if (spare_parcels_.size() < parcels_.size()) spare_parcels_.swap(parcels_);
  try {  // all of them: a small batch must not cost the next one its memory
    for (Parcel& parcel : parcels_) spare_parcels_.push_back(std::move(parcel));
  } catch (...) {  // no memory: some less
  }
  parcels_.clear();
  finish_batch();
}

}  // namespace rtdata::detail
