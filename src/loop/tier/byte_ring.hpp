// A bounded ring of records of any size, between one thread that writes and one that reads. No lock, no allocation
// after it was made.
//
// Positions count bytes since the beginning, modulo the range of std::size_t: on a machine of 32 bits they wrap after 4
// GiB. So they are compared by how far they are apart, which is never more than the ring is long. The first lap is the
// last one before they wrap, so that each ring shows whether that works.
#pragma once

#include <algorithm>
#include <atomic>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <memory>

namespace rtdata::detail {

class ByteRing {
 public:
  /// `bytes` is rounded up to a power of two. An eighth is reserved for essential records.
  explicit ByteRing(std::size_t bytes)
      : mask_(std::bit_ceil(bytes) - 1),
        kept_((mask_ + 1) / 8),
        burst_(std::min<std::size_t>(8192, (mask_ + 1) / 4)),
        memory_(new (std::align_val_t{64}) std::byte[mask_ + 1]),
        at_(memory_),
        straight_to_(memory_) {}
  ByteRing(const ByteRing&) = delete;
  ByteRing& operator=(const ByteRing&) = delete;
  ~ByteRing() { ::operator delete[](memory_, std::align_val_t{64}); }

  // ---- the writer

  /// Room for a record of `bytes` (a multiple of 8, at least 8), aligned to 8, whose first 4 bytes are to say how many
  /// it has; null when there is none.
  enum class Room { usual, all };
  std::byte* reserve(std::size_t bytes, Room room) noexcept {
    return find_room(bytes, room == Room::usual ? kept_ : 0) ? at_ : nullptr;
  }
  /// Null also if finding space needs `reserve`, or if this completes a burst, which should be published first.
  std::byte* reserve_at_hand(std::size_t bytes) noexcept {
    return straight_to_ - at_ >= static_cast<std::ptrdiff_t>(bytes) ? at_ : nullptr;
  }
  // Cache lines come from the other side's processor: they are prefetched some records before they are needed.
  static void fetch_for_writing(const std::byte* record) noexcept { __builtin_prefetch(record + fetched_ahead, 1); }
  static void fetch_for_reading(const std::byte* record) noexcept { __builtin_prefetch(record + fetched_ahead, 0); }
  /// The record reserved last, of as many bytes, is complete.
  void commit(std::size_t bytes) noexcept { at_ += bytes; }
  /// Makes committed records visible to the reader. Use it seldom, because each call costs both sides a cache line.
  void publish() noexcept {
    published_ = head();
    published_head_.store(published_, std::memory_order_release);
  }
  std::size_t published() const noexcept { return published_; }
  bool has_unpublished() const noexcept { return head() != published_; }
  /// True if the unpublished records and `bytes` more are enough to publish them and wake the reader.
  bool completes_burst(std::size_t bytes) const noexcept { return head() + bytes - published_ > burst_; }
  /// A longer record may not fit even into an empty ring.
  std::size_t longest_record() const noexcept { return (mask_ + 1 - kept_) / 2; }

  // ---- the reader

  /// Sees what has been published up to now. Seldom, as `publish`.
  void look() noexcept { known_head_ = published_head_.load(std::memory_order_acquire); }
  /// The same, up to the position `published` only, which the writer had given. Never goes back.
  void look_up_to(std::size_t published) noexcept {
    if (is_beyond(published, known_head_)) known_head_ = published;
  }
  /// The position up to which the reader sees records.
  std::size_t seen() const noexcept { return known_head_; }
  /// The oldest record of those seen, or null. Valid until `pop`.
  const std::byte* front() noexcept {
    if (own_tail_ == known_head_) return nullptr;
    if (size_at(own_tail_ & mask_) == 0) [[unlikely]]
      own_tail_ += mask_ + 1 - (own_tail_ & mask_);
    return memory_ + (own_tail_ & mask_);
  }
  void pop() noexcept { own_tail_ += size_at(own_tail_ & mask_); }
  /// Bytes of those seen that lie behind each other, from the front on.
  std::size_t straight_bytes() const noexcept {
    return std::min(known_head_ - own_tail_, mask_ + 1 - (own_tail_ & mask_));
  }
  void pop(std::size_t bytes) noexcept { own_tail_ += bytes; }
  /// Frees the popped records for the writer.
  void release() noexcept { tail_.store(own_tail_, std::memory_order_release); }

 private:
  /// By how much the first lies beyond the second; negative: before it.
  static std::ptrdiff_t apart(std::size_t a, std::size_t b) noexcept { return static_cast<std::ptrdiff_t>(a - b); }
  static bool is_beyond(std::size_t a, std::size_t b) noexcept { return apart(a, b) > 0; }
  std::size_t head() const noexcept { return lap_ + static_cast<std::size_t>(at_ - memory_); }
  /// Reads the reader's position, and continues at the beginning if the end is too near. False: no space.
  bool find_room(std::size_t bytes, std::size_t kept) noexcept {
    const std::size_t size = mask_ + 1;
    const std::size_t to_end = lap_ + size - head();
    const bool is_at_end = to_end < bytes;
    const std::size_t end = head() + (is_at_end ? to_end : 0) + bytes;
    if (is_beyond(end + kept, known_room_to_)) {
      known_room_to_ = tail_.load(std::memory_order_acquire) + size;
      if (is_beyond(end + kept, known_room_to_)) return false;
    }
    if (is_at_end) {
      if (to_end > 0) size_at(size - to_end) = 0;  // the reader continues at the beginning
      lap_ += size;
      at_ = memory_;
    }
    // The limit: the end of the lap, the known free space and the end of the burst; a burst may begin in the previous
    // lap.
    const std::ptrdiff_t to = std::min(
        {static_cast<std::ptrdiff_t>(size), apart(known_room_to_ - kept_, lap_), apart(published_ + burst_, lap_)});
    straight_to_ = memory_ + std::max<std::ptrdiff_t>(to, 0);
    return true;
  }
  std::size_t first_position() const noexcept { return 0 - (mask_ + 1); }
  static constexpr std::size_t fetched_ahead = 1024;
  std::uint32_t& size_at(std::size_t offset) const noexcept {
    return *reinterpret_cast<std::uint32_t*>(memory_ + offset);
  }

  const std::size_t mask_;
  const std::size_t kept_;
  const std::size_t burst_;
  std::byte* const memory_;
  // the writer's
  alignas(64) std::byte* at_;
  std::byte* straight_to_;  // records up to here lie straight, in room known to be free, and complete no burst
  std::size_t lap_ = first_position();  // position of the beginning of the memory
  std::size_t known_room_to_ = lap_ + mask_ + 1;
  std::size_t published_ = lap_;
  alignas(64) std::atomic<std::size_t> published_head_{lap_};
  // the reader's
  alignas(64) std::size_t own_tail_ = first_position();
  std::size_t known_head_ = own_tail_;
  alignas(64) std::atomic<std::size_t> tail_{own_tail_};
};

}  // namespace rtdata::detail
