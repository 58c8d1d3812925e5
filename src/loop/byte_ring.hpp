// A bounded ring of records of any size, between one thread that writes and one that reads. No lock, no allocation after it
// was made.
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
  /// `bytes` is rounded up to a power of two. An eighth of that is kept for records that have to find room.
  explicit ByteRing(std::size_t bytes)
      : mask_(std::bit_ceil(bytes) - 1),
        kept_((mask_ + 1) / 8),
        memory_(new (std::align_val_t{64}) std::byte[mask_ + 1]) {}
  ByteRing(const ByteRing&) = delete;
  ByteRing& operator=(const ByteRing&) = delete;
  ~ByteRing() { ::operator delete[](memory_, std::align_val_t{64}); }

  // ---- the writer

  /// Room for a record of `bytes` (a multiple of 8, at least 8), aligned to 8, of which the first 4 are the ring's; null
  /// when there is none.
  enum class Room { usual, all };
  std::byte* reserve(std::uint32_t bytes, Room room) noexcept {
    return find_room(bytes, room == Room::usual ? kept_ : 0) ? next(bytes) : nullptr;
  }
  /// Null, too, when the room has to be looked for: then `reserve` does.
  std::byte* reserve_at_hand(std::uint32_t bytes) noexcept {
    return head_ + bytes <= straight_to_ ? next(bytes) : nullptr;
  }
  /// The record reserved last, of as many bytes, is complete.
  void commit(std::uint32_t bytes) noexcept { head_ += bytes; }
  /// What was committed can be seen by the reader. Seldom, since each time costs both sides a line of cache.
  void publish() noexcept { published_head_.store(head_, std::memory_order_release); }

  // ---- the reader

  /// Sees what has been published up to now. Seldom, as `publish`.
  void look() noexcept { known_head_ = published_head_.load(std::memory_order_acquire); }
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
  /// Gives what was popped back to the writer.
  void release() noexcept { tail_.store(own_tail_, std::memory_order_release); }

 private:
  std::byte* next(std::uint32_t bytes) noexcept {
    size_at(head_ & mask_) = bytes;
    return memory_ + (head_ & mask_);
  }
  /// Looks how far the reader is, and goes on at the beginning when the end is too near. False when there is no room.
  bool find_room(std::uint32_t bytes, std::size_t kept) noexcept {
    const std::size_t at = head_ & mask_;
    const std::size_t to_end = mask_ + 1 - at;
    const std::size_t skipped = to_end < bytes ? to_end : 0;
    if (head_ + skipped + bytes + kept > known_room_to_) {
      known_room_to_ = tail_.load(std::memory_order_acquire) + mask_ + 1;
      if (head_ + skipped + bytes + kept > known_room_to_) return false;
    }
    if (skipped != 0) {
      size_at(at) = 0;  // the reader goes on at the beginning
      head_ += skipped;
    }
    straight_to_ = std::min(head_ - (head_ & mask_) + mask_ + 1, known_room_to_ - kept_);
    return true;
  }
  std::uint32_t& size_at(std::size_t offset) const noexcept {
    return *reinterpret_cast<std::uint32_t*>(memory_ + offset);
  }

  const std::size_t mask_;
  const std::size_t kept_;
  std::byte* const memory_;
  // the writer's
  alignas(64) std::size_t head_ = 0;
  std::size_t known_room_to_ = mask_ + 1;
  std::size_t straight_to_ = 0;  // records that end before it lie straight, in room that is known to be free
  alignas(64) std::atomic<std::size_t> published_head_{0};
  // the reader's
  alignas(64) std::size_t own_tail_ = 0;
  std::size_t known_head_ = 0;
  alignas(64) std::atomic<std::size_t> tail_{0};
};

}  // namespace rtdata::detail
