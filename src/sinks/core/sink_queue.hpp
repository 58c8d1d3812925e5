// The queue between a loop and a sink's lane: chunks of records in memory allocated at the start, and accounts. Shared
// by both, because a hanging lane may be abandoned.
#pragma once

#include <array>
#include <atomic>
#include <bit>
#include <condition_variable>
#include <cstddef>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/sinks/recording_writer.hpp"
#include "rtdata/sinks/sender.hpp"
#include "sinks/core/row_feed.hpp"

namespace rtdata::detail {

struct SlotStored;

/// Lies before each payload in a chunk.
struct RecordHeader {
  SlotStored* stored;
  std::int64_t time;
  std::uint64_t sequence;
};
/// The size of a record in a chunk: its header and its padded payload.
constexpr std::size_t record_bytes_of(std::size_t payload_bytes) noexcept {
  return sizeof(RecordHeader) + (payload_bytes + 7) / 8 * 8;
}
inline constexpr std::size_t chunk_bytes = 64 * 1024;

struct ChunkHeader {
  enum State : std::uint64_t { free, filling, queued, writing };
  // ticket << 2 | state: a chunk that was taken back and filled again has another ticket
  std::atomic<std::uint64_t> ticket_and_state{free};
  std::byte* data = nullptr;
  std::size_t used = 0;
  std::uint32_t rows = 0;
};

constexpr std::uint64_t ticket_in_state(std::uint64_t ticket, ChunkHeader::State state) noexcept {
  return ticket << 2 | state;
}

/// One (topic, origin): what is fixed, and the loop's counts.
struct alignas(64) Slot {
  SlotInfo info;
  LiveCounts own;
  LiveCounts* live = &own;
  std::uint64_t dropped_newest = 0;
  std::uint64_t dropped_oldest = 0;
};

/// The lane's counts of a slot, and what the lane needs to know of it. Small and apart from the slot, since the lane
/// touches it for each record.
struct SlotStored {
  std::atomic<std::uint64_t> stored{0};  // changed between two steps of the queue's revision
  std::atomic<std::uint64_t> refused{0};
  std::uint32_t in_batch = 0;
  std::uint32_t refused_in_batch = 0;
  std::uint32_t index = 0;  // the slot's number
  std::uint32_t payload_bytes = 0;
  const SlotInfo* info = nullptr;
};

/// The payload lies behind the header that is given. The size is looked up where the slot changes only, so that the
/// processor knows where the next record lies before it has read this one.
template <class Function>
void for_each_record(const ChunkHeader& chunk, Function&& function) {
  const SlotStored* slot = nullptr;
  std::size_t bytes = 0;
  for (std::size_t at = 0; at < chunk.used; at += bytes) {
    const auto& header = *reinterpret_cast<const RecordHeader*>(chunk.data + at);
    if (header.stored != slot) {
      slot = header.stored;
      bytes = record_bytes_of(slot->payload_bytes);
    }
    function(header);
  }
}

/// A turn of work of the lane.
struct SinkTurn {
  enum class Task {
    open,
    store,
    store_and_sync,   ///< makes stored data survive a power cut
    store_and_close,  ///< nothing follows
  };
  Task task = Task::store;
  Duration pause{0};   ///< before the work
  Duration to_utc{0};  ///< of a sender that goes from memory: from the recorded time to UTC
};

/// The result of a turn of work.
struct SinkTurnResult {
  SinkTurn::Task task = SinkTurn::Task::store;
  Result<void> result;
  bool has_ended = false;  ///< the writer said that it has: nothing is tried again
  std::uint64_t refused = 0;
  Error refusal;            ///< the first of them
  std::string topic_fault;  ///< why a topic can never be stored; empty: all can
  std::optional<Error> warning;
  std::vector<std::string> remarks;  ///< for the log
  bool has_parcels = false;          ///< the batch is encoded, and is to be sent

  bool has_opened() const noexcept { return task == SinkTurn::Task::open && (result || has_ended); }
  bool has_synced() const noexcept { return task == SinkTurn::Task::store_and_sync && result; }
  bool has_closed() const noexcept {
    return task == SinkTurn::Task::store_and_close && !has_parcels && (result || has_ended);
  }
};

/// A row of a parcel that the peer will never take.
struct RefusedRow {
  std::size_t row = 0;
  Error why;
};

class SinkQueue {
 public:
  SinkQueue(const SinkConfig& config, std::unique_ptr<Writer> writer);
  ~SinkQueue();

  // ---- loop
  /// Room for a record, or null when the queue is full: then the policy has been applied and counted.
  std::byte* room(std::uint32_t slot, std::size_t bytes);
  void commit(std::size_t bytes) noexcept {
    filling_->used += bytes;
    ++filling_->rows;
    ++rows_since_handover_;
  }
  /// Queues the chunk being filled. False when nothing has come since the last call.
  bool hand_over();
  /// True if rows wait to be handed over.
  bool has_rows() const noexcept { return full_chunks_ != 0 || (filling_ != nullptr && filling_->rows != 0); }
  /// True if a full batch, or half of the queue, is waiting.
  bool is_batch_due() const noexcept { return rows_since_handover_ >= due_rows_ || full_chunks_ >= due_chunks_; }
  const StorePace& pace() const noexcept { return pace_; }
  /// Rows handed over since the last account.
  std::uint64_t rows_since_account() const noexcept { return rows_since_account_; }
  /// True if `next_account` may be filled. Otherwise all but one are queued; that one is reserved for the end.
  bool has_account() const noexcept;
  /// True if no account is on its way: all that were handed over are stored.
  bool has_stored_accounts() const noexcept {
    for (const AccountBox& box : accounts_) {
      if (box.after_ticket.load(std::memory_order_acquire) != 0) return false;
    }
    return true;
  }
  Account& next_account() noexcept { return accounts_[next_account_].account; }
  /// Queues it behind all that was handed over before.
  void hand_over_account();
  /// Its number.
  std::uint32_t add_slot(SlotInfo info);
  Slot& slot(std::uint32_t index) const noexcept {
    const SlotLocation at = location_of(index);
    return blocks_[at.block].load(std::memory_order_acquire)[at.offset];
  }
  SlotStored& stored(std::uint32_t index) const noexcept {
    const SlotLocation at = location_of(index);
    return stored_blocks_[at.block].load(std::memory_order_acquire)[at.offset];
  }
  std::uint32_t slot_count() const noexcept { return slot_count_.load(std::memory_order_acquire); }
  /// A snapshot between two batches; while the lane ends batches faster than this can count, an approximate one.
  SinkCounts counts() const noexcept;
  /// The drops of each topic with losses. Queued events count as waiting, or as lost too.
  enum class Queued { waits, lost };
  std::vector<TopicDrops> dropped_by_topic(Queued queued) const;
  bool is_idle() const noexcept;
  /// True if the writer is opened in a separate turn, from set-up on.
  bool opens_at_set_up() const noexcept { return opens_at_set_up_; }
  /// The answer of the writer about a topic.
  Result<void> add_topic(std::uint32_t number, std::string_view topic, const Description& description) {
    return recording_ != nullptr ? recording_->add_topic(number, topic, description) : Result<void>{};
  }
  void keep(const OriginAccount& now, const Gap* closed) noexcept;
  /// The error of one of these calls that was not reported yet.
  std::optional<Error> take_set_up_error() noexcept { return std::exchange(set_up_error_, std::nullopt); }
  /// From now on the loop counts here, not in the writer's memory, which may be closed.
  void keep_own_counts() noexcept;
  /// After this returns, the lane begins and counts no more batches.
  void abandon();
  /// Null: the writer is not a Sender.
  Sender* sender() const noexcept { return sender_; }
  /// From here on the rows come from a recording, on the lane.
  void feed_from(std::unique_ptr<RowFeed> feed) {
    feed_ = std::move(feed);
    if (auto at_end = writer_->goes_through(feed_->path())) feed_->at_end(std::move(at_end));
  }
  const RowFeed* feed() const noexcept { return feed_.get(); }
  void note_committed() { feed_->note_committed(); }
  /// Nothing more is sent: queued rows wait in the recording, unless a limit has deleted them.
  void end_feed() {
    feed_->note_committed();
    feed_->forget();
  }
  bool keeps_account() const noexcept { return recording_ != nullptr && feed_ == nullptr; }
  bool is_recording() const noexcept { return recording_ != nullptr && recording_->is_recording(); }
  std::string run() const { return recording_ != nullptr ? recording_->run() : std::string(); }
  /// For a recording that was closed.
  std::shared_ptr<const RunReport> recorded() const { return recording_ != nullptr ? recording_->recorded() : nullptr; }
  /// For a sink that goes through this recording; null: this is not a recording.
  std::unique_ptr<RowFeed> make_feed(const RowFeedConfig& config) {
    return recording_ != nullptr ? recording_->feed(config) : nullptr;
  }
  /// For a sink with `through`: the number of rows that fit into half of the queue and make some parcels.
  std::size_t rows_at_once() const noexcept {
    return std::max(config_.batch_rows, sender_ != nullptr ? 2 * sending_.window * sending_.parcel_rows : 0);
  }
  /// Memory that rows of a recording may take at a time.
  std::size_t bytes_at_once() const noexcept { return memory_bytes_ / 2; }

  // ---- loop, while the lane is idle and the batch is sent: sink_sending.cpp
  const std::vector<Parcel>& parcels() const noexcept { return parcels_; }
  /// The peer has the next rows, from `first` up to, but not including, `last` of that parcel, except the refused ones.
  void settle(std::size_t parcel, std::size_t first, std::size_t last, std::span<const RefusedRow> refused) noexcept;
  /// All parcels are settled.
  void end_sending() noexcept;
  /// The refusals since the last call: how many, and the first reason.
  std::uint64_t take_refusals(Error& why);

  // ---- lane (sink_lane.cpp)
  /// An error leaves what is queued there, unless it is `closed`: then all later events are refused.
  SinkTurnResult work(const SinkTurn& turn) noexcept;
  void note_refusal(std::uint32_t slot, std::uint64_t sequence, const Error& why);
  /// A topic of the batch can never be stored.
  void note_topic_fault(const Error& why);

 private:
  friend class rtdata::Batch;
  // Slots never move: they lie in blocks of 8, 16, 32 and so on.
  static constexpr std::size_t first_block = 8;
  static constexpr std::size_t most_blocks = 17;
  static constexpr std::size_t most_slots = first_block * ((std::size_t{1} << most_blocks) - 1);
  struct SlotLocation {
    std::size_t block;
    std::size_t offset;
  };
  static SlotLocation location_of(std::uint32_t index) noexcept {
    const std::size_t block = std::bit_width(index / first_block + 1) - 1;
    return {block, index - first_block * ((std::size_t{1} << block) - 1)};
  }
  static constexpr std::size_t account_count = 4;
  struct AccountBox {
    Account account;
    std::atomic<std::uint64_t> after_ticket{0};  // 0: free; else 1 + the last ticket before it
  };
  LiveCounts* live_counts_of(std::uint32_t index) noexcept;
  /// A call of the writer's on the loop: its exception is reported later.
  template <class Call>
  void call_on_loop(const char* name, Call&& call) noexcept;
  /// In the handler of an exception from a call on the loop.
  void note_set_up_error(const char* call) noexcept;
  std::span<ChunkHeader> used_chunks() noexcept { return {chunks_.data(), used_.load(std::memory_order_acquire)}; }
  std::span<const ChunkHeader> used_chunks() const noexcept {
    return {chunks_.data(), used_.load(std::memory_order_acquire)};
  }
  ChunkHeader* take_chunk(std::uint32_t slot);
  void queue_filling();
  SinkCounts sum() const noexcept;
  /// Takes the oldest chunk with a ticket before this one.
  ChunkHeader* next_queued(std::uint64_t before);
  bool gather();
  void finish_batch();
  void fail_batch() noexcept;
  void refuse_batch();
  /// Waits, until the queue is abandoned at the latest.
  void pause(Duration duration);
  bool is_abandoned();
  Result<void> open();
  Result<void> store();
  Result<void> do_task(SinkTurn::Task task);
  /// Fills the queue from the recording, if that is where the rows come from.
  Result<void> fill();
  /// The batch becomes parcels.
  Result<void> encode();
  Parcel& add_parcel();
  template <class Call>
  Result<void> call_writer(Call&& call);

  const SinkConfig config_;
  const std::unique_ptr<Writer> writer_;
  RecordingWriter* const recording_;  // the same; null: it is none
  Sender* const sender_;              // as well
  const SendingConfig sending_;
  Duration to_utc_{0};  // lane; see SinkTurn
  const bool opens_at_set_up_;
  const StorePace pace_;
  std::size_t due_rows_ = 0;     // a batch by number
  std::size_t due_chunks_ = 0;   // by memory
  std::size_t most_chunks_ = 0;  // stored together when more waits
  std::byte* memory_ = nullptr;
  std::size_t memory_bytes_ = 0;
  std::vector<ChunkHeader> chunks_;
  std::atomic<std::size_t> used_{0};  // chunks that were ever filled, which are the first; nobody looks at the others
  std::array<std::atomic<Slot*>, most_blocks> blocks_{};
  std::array<std::atomic<SlotStored*>, most_blocks> stored_blocks_{};
  std::atomic<std::uint32_t> slot_count_{0};
  std::array<AccountBox, account_count> accounts_;

  // loop
  std::optional<Error> set_up_error_;
  ChunkHeader* filling_ = nullptr;
  std::size_t rows_since_handover_ = 0;
  std::uint64_t rows_since_account_ = 0;
  std::size_t full_chunks_ = 0;  // queued since the last hand-over because they were full
  std::size_t next_account_ = 0;
  std::uint64_t full_at_revision_ = ~std::uint64_t{0};  // when no chunk was free
  // lane
  Batch batch_;
  bool has_batch_ = false;
  std::vector<SlotStored*> slots_in_batch_;
  bool is_open_ = false;
  std::size_t account_cursor_ = 0;
  std::uint64_t taken_ticket_ = 0;  // the last one gathered
  std::uint64_t refusals_ = 0;
  std::uint64_t refusals_in_batch_ = 0;
  Error first_refusal_;
  Error first_refusal_in_batch_;
  std::string topic_fault_;
  std::string topic_fault_in_batch_;
  bool has_ended_ = false;
  // the lane's, and while it is idle the loop's
  std::unique_ptr<RowFeed> feed_;
  std::vector<Parcel> parcels_;
  std::vector<Parcel> spare_parcels_;           // for their memory
  std::atomic<std::uint64_t> rows_settled_{0};  // of the batch, and counted
  // both
  std::atomic<std::uint64_t> last_ticket_{0};  // that the loop has given
  std::atomic<std::uint64_t> revision_{0};     // odd while a batch is being counted
  std::mutex abandon_mutex_;
  std::condition_variable abandoned_signal_;
  bool abandoned_ = false;  // guarded by the mutex
};

}  // namespace rtdata::detail
