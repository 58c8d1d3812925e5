// Events as copies, one behind the other, and the ring in which they go from the main loop to the thread of the
// readers.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <new>
#include <span>
#include <string_view>

#include "rtdata/data/event.hpp"

namespace rtdata::app {

/// The head of a copy. Behind it lie the topic, a zero byte, the origin, and from the next multiple of 8 on the
/// payload.
struct PackedEvent {
  std::uint32_t bytes = 0;  ///< of all, a multiple of 8
  std::uint32_t payload_bytes = 0;
  std::uint16_t topic_bytes = 0;
  std::uint16_t origin_bytes = 0;
  std::uint32_t run = 0;  ///< number of the run in the recording that it was read from; 0: a live event
  std::int64_t time = 0;
  std::uint64_t sequence = 0;
  const Description* description = nullptr;  ///< null: not an event: all of the origin up to this one had no room

  static std::size_t bytes_of(std::string_view topic, std::string_view origin, std::size_t payload) noexcept {
    return rounded(sizeof(PackedEvent) + topic.size() + 1 + origin.size()) + rounded(payload);
  }
  /// Writes the copy to `to`, which has room for `bytes_of`.
  static void put(std::byte* to, std::string_view topic, const EventHeader& header, const Description* description,
                  std::span<const std::byte> payload, std::uint32_t run) noexcept {
    const auto size = [](std::size_t text) { return static_cast<std::uint16_t>(text); };  // names have at most 200
    auto* const head = ::new (to)
        PackedEvent{static_cast<std::uint32_t>(bytes_of(topic, header.origin, payload.size())),
                    static_cast<std::uint32_t>(payload.size()),
                    size(topic.size()),
                    size(header.origin.size()),
                    run,
                    to_nanoseconds(header.time),
                    header.sequence,
                    description};
    char* const texts = reinterpret_cast<char*>(head + 1);
    std::memcpy(texts, topic.data(), topic.size());
    texts[topic.size()] = '\0';
    std::memcpy(texts + topic.size() + 1, header.origin.data(), header.origin.size());
    if (!payload.empty()) std::memcpy(to + head->bytes - rounded(payload.size()), payload.data(), payload.size());
  }

  /// Topic and origin, to which a sequence belongs.
  std::string_view key() const noexcept { return {texts(), std::size_t{topic_bytes} + 1 + origin_bytes}; }
  bool is_mark() const noexcept { return topic_bytes == 0; }  ///< see LiveFeed::mark
  std::string_view topic() const noexcept { return {texts(), topic_bytes}; }
  std::string_view origin() const noexcept { return {texts() + topic_bytes + 1, origin_bytes}; }
  const std::byte* payload() const noexcept {
    return reinterpret_cast<const std::byte*>(this) + bytes - rounded(payload_bytes);
  }
  EventHeader header() const noexcept { return {from_nanoseconds(time), sequence, origin()}; }

 private:
  static constexpr std::size_t rounded(std::size_t bytes) noexcept { return (bytes + 7) / 8 * 8; }
  const char* texts() const noexcept { return reinterpret_cast<const char*>(this + 1); }
};

/// One thread puts, one takes; neither waits, and nothing is allocated after it was made.
class EventRing {
 public:
  static constexpr std::size_t size = std::size_t{4} << 20;
  static constexpr std::size_t near = std::size_t{64} << 10;

  /// False: there is no room.
  bool put(std::string_view topic, const EventHeader& header, const Description* description,
           std::span<const std::byte> payload) noexcept {
    const std::size_t bytes = PackedEvent::bytes_of(topic, header.origin, payload.size());
    const std::size_t head = head_.load(std::memory_order_relaxed);
    const std::size_t tail = tail_.load(std::memory_order_acquire);
    const std::size_t to_end = size - head % size;
    // When all is taken, it stays at the place that is in the processor's cache.
    const bool begins_anew = head == tail && head % size > near;
    const std::size_t skipped = begins_anew || to_end < bytes ? to_end : 0;
    if (size - (head - tail) < skipped + bytes) return false;
    if (skipped > 0)
      std::memset(memory_.get() + head % size, 0, sizeof(PackedEvent::bytes));  // continues at the beginning
    PackedEvent::put(memory_.get() + (head + skipped) % size, topic, header, description, payload, 0);
    head_.store(head + skipped + bytes, std::memory_order_release);
    return true;
  }

  /// Calls the function with each copy in the ring.
  template <class Function>
  void take(Function&& function) {
    const std::size_t head = head_.load(std::memory_order_acquire);
    std::size_t tail = tail_.load(std::memory_order_relaxed);
    while (tail != head) {
      const auto* const event = reinterpret_cast<const PackedEvent*>(memory_.get() + tail % size);
      if (event->bytes == 0) {
        tail += size - tail % size;
        continue;
      }
      function(*event);
      tail += event->bytes;
      tail_.store(tail, std::memory_order_release);
    }
    tail_.store(tail, std::memory_order_release);
  }

 private:
  const std::unique_ptr<std::byte[]> memory_{new std::byte[size]};
  alignas(64) std::atomic<std::size_t> head_{0};
  alignas(64) std::atomic<std::size_t> tail_{0};
};

}  // namespace rtdata::app
