/// The implementation of topics and subscriptions. Not for use by programs; the templates of topic.hpp need it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <exception>
#include <memory>
#include <new>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/event.hpp"
#include "rtdata/loop/callback.hpp"
#include "rtdata/loop/handle.hpp"
#include "rtdata/loop/ledger.hpp"

namespace rtdata {

inline constexpr std::size_t max_payload_size = 4096;

namespace detail {

class TopicCore;
class OriginCore;
class RuntimeCore;
class SubscriptionNode;

/// What the ring must know of a payload's type.
struct PayloadType {
  std::size_t size = 0;
  std::size_t alignment = 1;
  std::shared_ptr<const Description> description;  ///< null: cannot be recorded
  const void* type_key = nullptr;                  ///< identity of a C++ type
  const char* type_name = "";
  /// Null for trivially copyable ones.
  void (*move_construct)(void* to, void* from) = nullptr;
  void (*destroy)(void* payload) = nullptr;
};

template <class T>
inline constexpr char type_key_of = 0;

template <class T>
PayloadType payload_type() {
  PayloadType type;
  type.size = sizeof(T);
  type.alignment = alignof(T);
  type.type_key = &type_key_of<T>;
  type.type_name = __PRETTY_FUNCTION__;
  if constexpr (Described<T>) {
    static_assert(sizeof(T) <= max_payload_size, "rtdata: a described payload has at most 4 KiB (max_payload_size)");
    type.description = description_of<T>();
  } else if constexpr (!std::is_trivially_copyable_v<T>) {
    static_assert(std::is_nothrow_destructible_v<T>, "rtdata: a payload must not throw when it is destroyed");
    type.move_construct = [](void* to, void* from) { ::new (to) T(std::move(*static_cast<T*>(from))); };
    type.destroy = [](void* payload) { static_cast<T*>(payload)->~T(); };
  }
  return type;
}

/// The parameter type for publishing a payload: a reference if its bytes are copied, a value to move otherwise.
template <class T>
using PublishedAs = std::conditional_t<std::is_trivially_copyable_v<T>, const T&, T>;

/// A run of consecutive events in a ring, as delivered to a subscription.
struct EventRun {
  const TopicCore& topic;
  std::byte* slots;
  std::size_t stride;
  std::uint64_t first;  ///< position of the first one
  std::uint64_t count;
  const std::uint8_t* cancelled;         ///< one flag an event
  const std::uint64_t& cancelled_until;  ///< position up to which the flags hold; moves when a handler stops a sensor
  bool is_cancelled(std::uint64_t i) const noexcept { return first + i < cancelled_until && cancelled[i] != 0; }
};

class SubscriptionNode : public Node {
 public:
  SubscriptionNode(LoopCore& loop, std::string_view pattern);
  /// Calls the handler with the events of the run until it is closed; returns the number of events processed.
  struct Delivered {
    std::uint64_t seen = 0;
    std::uint64_t cancelled = 0;  ///< of these, not delivered
  };
  virtual Delivered deliver(const EventRun& run, const void* field_map) = 0;
  /// Checks that it can take this topic; returns a map of fields if the layouts differ. Errors: description-differs.
  virtual Result<std::shared_ptr<const void>> accept(const TopicCore& topic) = 0;

  const std::string& pattern() const noexcept { return pattern_; }
  SubscriptionCounts counts() const noexcept;
  void report_exception(std::string_view what) noexcept;
  bool report_times(CallbackStatus& status) const override;
  std::string callback_name() const override { return name; }

  std::string name;
  CallbackTimes times;

 protected:
  void on_close() noexcept override;
  /// Calls the function with each event of the run until the node is closed. What it throws is reported.
  template <class Function>
  Delivered for_each(const EventRun& given, const Function& function) noexcept {
    const EventRun run = given;  // in registers
    Delivered result;
    std::byte* slot = run.slots;
    for (; result.seen < run.count && is_open(); ++result.seen, slot += run.stride) {
      if (run.is_cancelled(result.seen)) [[unlikely]] {
        ++result.cancelled;
        continue;
      }
      try {
        function(slot);
      } catch (const std::exception& e) {
        report_exception(reason_of(e));
      } catch (...) {
        report_exception("an exception that is not a std::exception");
      }
    }
    return result;
  }

 private:
  /// Calls the function with each topic that it may be linked to.
  template <class Function>
  void for_each_topic(const Function& function) const;

  std::string pattern_;
  RuntimeCore* runtime_;
};

EventView view_of(const TopicCore& topic, const std::byte* slot);
/// Copies the leaves named in the map from a payload of the topic to one of the handler's type.
void apply_field_map(const void* map, const std::byte* from, std::byte* to);
Result<std::shared_ptr<const void>> make_field_map(const TopicCore& topic, const PayloadType& wanted);
void attach(LoopCore& loop, SubscriptionNode& node, TopicCore* only);

template <class T>
class TypedSubscription final : public SubscriptionNode {
 public:
  TypedSubscription(LoopCore& loop, std::string_view pattern, Callback<void(const Event<T>&)> handler)
      : SubscriptionNode(loop, pattern), handler_(std::move(handler)) {
    if (!handler_) refuse_empty("cannot subscribe", pattern);
  }
  Delivered deliver(const EventRun& run, const void* field_map) override {
    if constexpr (Described<T>) {
      if (field_map != nullptr) [[unlikely]] {
        return for_each(run, [&](std::byte* slot) {
          Event<T> mapped;
          static_cast<EventHeader&>(mapped) = *reinterpret_cast<Event<T>*>(slot);
          apply_field_map(field_map, view_of(run.topic, slot).payload().data(),
                          reinterpret_cast<std::byte*>(&mapped.data));
          handler_(mapped);
        });
      }
    }
    return for_each(run, [this](std::byte* slot) { handler_(*reinterpret_cast<Event<T>*>(slot)); });
  }
  Result<std::shared_ptr<const void>> accept(const TopicCore& topic) override {
    return make_field_map(topic, payload_type<T>());
  }

 private:
  void drop_callbacks() noexcept override { handler_.reset(); }
  Callback<void(const Event<T>&)> handler_;
};

}  // namespace detail
}  // namespace rtdata
