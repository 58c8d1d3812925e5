/// Feed: a sensor without a schedule, fed by the program.
///
///     rtdata::Feed<Estimate> estimate(loop, {.name = "estimate", .topic = "state/estimate"});
///     estimate.publish(Estimate{...});
///
/// It has an origin, an account and health like every sensor; each input ends as published, repeated, filtered or
/// unreadable.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <string>

#include "rtdata/data/parameter.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace rtdata {

struct FeedConfig {
  std::string name;         ///< unique in the runtime, and not of one that had a schedule; the origin of its events
  std::string topic = {};   ///< empty: the name
  Processing process = {};  ///< calibration and filters of its fields
  Duration warm_up{0};      ///< samples in this time after opening are discarded (filtered)
};

constexpr auto parameters(type_tag<FeedConfig>) {
  using namespace std::chrono_literals;
  return parameter_list(
      parameter("name", &FeedConfig::name, "the origin of its events, unique in the file", required, TextIs::name),
      parameter("topic", &FeedConfig::topic, "topic of its events; empty: its name", TextIs::topic),
      parameter("process", &FeedConfig::process, "calibration and filters of each field"),
      parameter("warm_up", &FeedConfig::warm_up,
                "samples in this time after opening the source are discarded (counted as filtered)",
                range(Duration{0}, Duration{24h})));
}

namespace detail {

class FeedNode;
Node* make_feed(Loop& loop, FeedConfig config, PayloadType type);
/// Moves from `payload` if its type is not trivially copyable. Does nothing without a feed or if it is stopped.
void feed_publish(Node* feed, const void* payload);
void feed_publish(Node* feed, const void* payload, Time time);

}  // namespace detail

/// The part that does not depend on the payload's type; also for payloads with only a description.
class AnyFeed : public AnySensor {
 public:
  AnyFeed() noexcept = default;
  /// A feed of payloads without a C++ type. SetupError (bad-description) without a description.
  AnyFeed(Loop& loop, FeedConfig config, std::shared_ptr<const Description> description);

  /// `payload` has the description's size and layout. Does nothing on a closed or stopped feed.
  void publish_bytes(std::span<const std::byte> payload);
  void publish_bytes(std::span<const std::byte> payload, Time time);
  /// Reports an unusable input: counts it as unreadable; the feed is degraded until the next good input.
  void fail(const Error& error);
  /// Reports that the source cannot be reached: the feed is faulted until the next good input, and that time is a
  /// `disconnected` gap. Counts no input.
  void fault(const Error& error);
  /// Counts an input that the source had sent before.
  void repeated();
  /// Counts inputs that the source numbered but that never arrived; unusable inputs do not belong to them.
  void lost(std::uint64_t count);
  /// Declares that the source numbers its data, so that `lost` is known.
  void set_numbered();

 protected:
  using AnySensor::AnySensor;
  explicit AnyFeed(detail::Node* node) noexcept : AnySensor(node) {}
};

template <class T>
class Feed : public AnyFeed {
 public:
  Feed() noexcept = default;
  Feed(Loop& loop, FeedConfig config)
      : AnyFeed(detail::make_feed(loop, std::move(config), detail::payload_type<T>())) {}

  /// Publishes with the current time, or the given one. A time that is not after the last event's is moved to just
  /// after it; one in the last day that `Time` can represent is clamped to the beginning of that day.
  void publish(detail::PublishedAs<T> payload) { detail::feed_publish(node(), &payload); }
  void publish(detail::PublishedAs<T> payload, Time time) { detail::feed_publish(node(), &payload, time); }
};

}  // namespace rtdata
