/// Event: a payload with the time it was sampled, its number and where it came from.
///
/// A handler of one type gets `const Event<T>&`; a handler or sink of any type gets an `EventView`. Both are valid for
/// the call only: keep a copy of the payload, and of `origin` as a std::string.
///
/// Values; any thread, as long as what they point to lives.
///
///     auto s = loop.subscribe<Climate>("climate", [](const rtdata::Event<Climate>& e) {
///       print(e.time, e->temperature);
///     });
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/data/value.hpp"

namespace rtdata {

/// What every event has. `origin` is the name of the sensor or feed that made it; `sequence` counts the events of one
/// origin from 1 on.
struct EventHeader {
  Time time{};  ///< when it was sampled
  std::uint64_t sequence = 0;
  std::string_view origin{};  ///< valid as long as the event is
};

/// Where the payload of an event starts, in bytes from its header, for a payload of this alignment.
constexpr std::size_t event_payload_offset(std::size_t alignment) noexcept {
  return (sizeof(EventHeader) + alignment - 1) / alignment * alignment;
}

/// A header at offset 0, then the payload at `event_payload_offset(alignof(T))`.
template <class T>
struct Event : EventHeader {
  T data{};

  const T* operator->() const noexcept { return std::addressof(data); }
  const T& operator*() const noexcept { return data; }
};

/// An event of any type, for as long as a call lasts. Copying it copies no payload.
class EventView {
 public:
  /// `payload` has the size of the description. `run`: the uuid of the run, for events of another run; otherwise empty.
  EventView(std::string_view topic, const EventHeader& header, const Description& description,
            std::span<const std::byte> payload, std::string_view run = {}) noexcept
      : topic_(topic), header_(&header), description_(&description), payload_(payload), run_(run) {}
  template <Described T>
  EventView(std::string_view topic, const Event<T>& event)
      : EventView(topic, event, *description_of<T>(), std::as_bytes(std::span<const T, 1>(&event.data, 1))) {}

  std::string_view topic() const noexcept { return topic_; }
  const EventHeader& header() const noexcept { return *header_; }
  Time time() const noexcept { return header_->time; }
  std::uint64_t sequence() const noexcept { return header_->sequence; }
  std::string_view origin() const noexcept { return header_->origin; }
  const Description& description() const noexcept { return *description_; }
  /// Run, origin and sequence together identify the event among those of all machines. Empty: the current run.
  std::string_view run() const noexcept { return run_; }
  std::span<const std::byte> payload() const noexcept { return payload_; }

  /// The value of one of the description's leaves.
  Value value(const Leaf& leaf) const { return read(leaf, payload_.data()); }
  /// The value at a path ("position.x"). Errors: bad-name when there is none, with the nearest name.
  Result<Value> value(std::string_view path) const;

  /// The payload as a T, or null when T does not have the same meaning and the same layout in memory.
  template <Described T>
  const T* as() const noexcept {
    return matches(*description_of<T>()) ? reinterpret_cast<const T*>(payload_.data()) : nullptr;
  }

 private:
  bool matches(const Description& other) const noexcept;

  std::string_view topic_;
  const EventHeader* header_;
  const Description* description_;
  std::span<const std::byte> payload_;
  std::string_view run_;
};

}  // namespace rtdata
