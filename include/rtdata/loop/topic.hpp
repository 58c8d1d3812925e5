/// Topics: named, typed streams of events, and subscriptions to them.
///
///     auto climate = loop.topic<Climate>("room/climate");
///     auto s = climate.subscribe(loop, [](const rtdata::Event<Climate>& e) { use(e->temperature); });
///     climate.publish(Climate{21.5, 40});
///
/// A topic belongs to the runtime and lives as long as it does; `Topic<T>` is a reference to it. Publishing copies the
/// payload into a bounded ring (made at the first subscription) and returns; handlers run after the current callback.
/// If the ring is full, the new event is dropped for the subscriptions and counted. Sinks copy the event when it is
/// published, before the ring. A subscription gets no events from before it was made.
///
/// Payloads with a description are trivially copyable and at most 4 KiB. Any other movable type may be published and
/// handled too, but not recorded.
///
/// Thread: the loop's.
#pragma once

#include <string>
#include <string_view>
#include <utility>

#include "rtdata/detail/loop/subscription_node.hpp"
#include "rtdata/loop/loop.hpp"

namespace rtdata {

namespace detail {

TopicCore& find_or_make_topic(Loop& loop, std::string_view name, PayloadType type);
const std::string& topic_name(const TopicCore& topic) noexcept;
void publish_from_program(TopicCore& topic, const void* payload);

}  // namespace detail

/// The link from topics to a handler. Destroying it unsubscribes: queued deliveries are cancelled.
class Subscription : public Handle {
 public:
  Subscription() noexcept = default;
  explicit Subscription(detail::SubscriptionNode* node) noexcept : Handle(node) {}
  /// All 0 after it is closed.
  SubscriptionCounts counts() const noexcept;
  CallbackTimes times() const noexcept;
  /// The name in reports; default: "handler of PATTERN".
  void set_name(std::string name);
};

template <class T>
class Topic {
 public:
  /// For payloads without a C++ type see `Feed`.
  explicit Topic(detail::TopicCore& core) noexcept : core_(&core) {}

  const std::string& name() const noexcept { return detail::topic_name(*core_); }
  /// The handler runs on `loop`, after the callback that published.
  [[nodiscard]] Subscription subscribe(Loop& loop, Callback<void(const Event<T>&)> handler) const {
    auto* node = new detail::TypedSubscription<T>(loop.core(), name(), std::move(handler));
    Subscription subscription(node);
    detail::attach(loop.core(), *node, core_);
    return subscription;
  }
  /// Publishes with the origin "program:TOPIC" (on a tier "program:TOPIC@TIER"); a `Feed` has an origin and a ledger of
  /// its own.
  void publish(detail::PublishedAs<T> payload) const { detail::publish_from_program(*core_, &payload); }

  detail::TopicCore& core() const noexcept { return *core_; }

 private:
  detail::TopicCore* core_;
};

template <class T>
Topic<T> Loop::topic(std::string_view name) {
  return Topic<T>(detail::find_or_make_topic(*this, name, detail::payload_type<T>()));
}

template <class T, class F>
Subscription Loop::subscribe(std::string_view pattern, F&& handler) {
  auto* node = new detail::TypedSubscription<T>(core(), pattern, std::forward<F>(handler));
  Subscription subscription(node);
  detail::attach(core(), *node, nullptr);
  return subscription;
}

/// True if `name` is a topic name: segments of [A-Za-z0-9_.-]+ joined by "/", at most 200 characters; the first may
/// begin with "$" (our own topics: "$rtdata/...").
bool is_topic_name(std::string_view name) noexcept;
/// True if `pattern` is a topic name, or has the wildcards "+" and "#" as in MQTT.
bool is_topic_pattern(std::string_view pattern) noexcept;
/// True if the pattern matches. "#" and "+" do not match names that begin with "$".
bool topic_matches(std::string_view pattern, std::string_view name) noexcept;

}  // namespace rtdata
