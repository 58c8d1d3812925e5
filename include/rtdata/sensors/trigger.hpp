/// TriggerSensor: the events of a topic, but only while a condition holds, and from some time before that on.
///
///     rtdata::TriggerSensor burn(loop, {.name = "burn/thrust"},
///                                {.on = "thrust", .with = {"sequence"}, .when = "sequence.ignition", .before = 10s});
///
/// A recording that takes "burn/thrust" and not "thrust" has every value from 10 s before the ignition on, and none of
/// the hours of waiting. The topic "thrust" has all of them all the time, for machines, limits and the screen.
///
/// Each event goes into a ring. When the condition holds, what is in it is published in its order, with the times that
/// it has, and then each event as it comes, until the condition holds no more; from then on the ring fills again. An
/// event is published once, however often the condition begins to hold. What becomes older than `before`, and what is
/// in the ring at the end, is *filtered* in the ledger: held back on purpose, no loss.
///
/// The condition (process/expression.hpp) is over the fields of `on` and `with`, and is looked at with each event of
/// these. Without a value it does not hold; why is told, and the sensor is degraded meanwhile.
///
/// The ring has room for `events`, which is set aside at the start. When it is full before the oldest is `before` old,
/// that one leaves it all the same; the sensor is degraded then, and says how far back the ring goes. Many events are
/// published in parts of 500, one each millisecond.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's. Takes no memory once it is made.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/description.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata {

struct TriggerConfig {
  std::string on = {};                 ///< the topic whose events it passes on
  std::vector<std::string> with = {};  ///< other topics, of which the condition has the latest values
  std::string when = {};               ///< the condition
  Duration before{0};                  ///< events that came so long before it are passed on, too
  std::uint32_t events = 10'000;       ///< the ring has room for so many
  Duration age = std::chrono::seconds{10};

  friend constexpr auto parameters(type_tag<TriggerConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("on", &TriggerConfig::on, "the topic whose events it passes on", required, names_part("topic")),
        parameter("with", &TriggerConfig::with, "other topics, of which `when` has the latest values",
                  names_part("topic")),
        parameter("when", &TriggerConfig::when, "while this expression is true, events are passed on", required,
                  TextIs::recorded),
        parameter("before", &TriggerConfig::before, "events that came so long before that are passed on, too",
                  range(Duration{0}, Duration{24h})),
        parameter("events", &TriggerConfig::events, "room for so many, taken at the start; a full ring is told",
                  range(1, 100'000'000)),
        parameter("age", &TriggerConfig::age, "older values of the topics `with` are not used: `when` does not hold",
                  range(Duration{1us}, Duration{24h * 365})));
  }
};

/// What no parameter says by itself: topics, and an expression that can be read.
void check_config(const TriggerConfig& config, const ConfigItem& item, Problems& problems);
/// Whether the topics have the fields that `when` names. `payload_of`: what a topic carries, null when that is not
/// known: then nothing is said of its fields.
void check_trigger_names(const TriggerConfig& config,
                         const std::function<const Description*(std::string_view topic)>& payload_of,
                         const ConfigItem& item, Problems& problems);

class TriggerSensor : public AnySensor {
 public:
  TriggerSensor() noexcept = default;
  /// SetupError: as `Feed`; ExpressionError; not-found (there is no topic `on` yet); bad-description (what it carries
  /// has none); bad-argument for a configuration that cannot work; io-failed (no memory for the ring).
  TriggerSensor(Loop& loop, FeedConfig feed, TriggerConfig config);

 private:
  explicit TriggerSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
