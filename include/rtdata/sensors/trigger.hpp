/// TriggerSensor: passes on the events of a topic while a condition is true, and those from some time before.
///
///     rtdata::TriggerSensor burn(loop, {.name = "burn/thrust"},
///                                {.on = "thrust", .with = {"sequence"}, .when = "sequence.ignition", .before = 10s});
///
/// A recording of "burn/thrust" instead of "thrust" has every value from 10 s before the ignition on, but not the hours
/// of waiting. The topic "thrust" always has all values, for machines, limits and the screen.
///
/// Each event goes into a ring. When the condition becomes true, the events in the ring are published in order, with
/// their times, and then each new event, until the condition becomes false; then the ring fills again. An event is
/// published only once. Events that become older than `before`, and those in the ring at the end, count as *filtered*:
/// held back on purpose, not lost.
///
/// The condition (process/expression.hpp) uses the fields of `on` and `with`, and is evaluated at each event of these.
/// Without a value it counts as false; the reason is reported, and the sensor is degraded meanwhile.
///
/// The ring holds `events` events; its memory is allocated at the start. If it is full before the oldest event reaches
/// the age `before`, that event is removed anyway; the sensor is then degraded and reports how far back the ring
/// reaches. Many events are published in parts of 500, one part each millisecond.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's. Allocates no memory after construction.
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
  std::vector<std::string> with = {};  ///< other topics; the condition uses their latest values
  std::string when = {};               ///< the condition
  Duration before{0};                  ///< how long before the condition events are passed on
  std::uint32_t events = 10'000;       ///< capacity of the ring
  Duration age = std::chrono::seconds{10};

  friend constexpr auto parameters(type_tag<TriggerConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("on", &TriggerConfig::on, "the topic whose events it passes on", required, names_part("topic")),
        parameter("with", &TriggerConfig::with, "other topics; `when` uses their latest values", names_part("topic")),
        parameter("when", &TriggerConfig::when, "events are passed on while this expression is true", required,
                  TextIs::recorded),
        parameter("before", &TriggerConfig::before, "events of this time before `when` became true are passed on, too",
                  range(Duration{0}, Duration{24h})),
        parameter(
            "events", &TriggerConfig::events,
            "number of events in the ring for `before`; its memory is allocated at the start; a full ring is reported",
            range(1, 100'000'000)),
        parameter("age", &TriggerConfig::age, "older values of the topics `with` are not used; `when` is then false",
                  range(Duration{1us}, Duration{24h * 365})));
  }
};

/// Checks rules over several parameters: topics, and a valid expression.
void check_config(const TriggerConfig& config, const ConfigItem& item, Problems& problems);
/// Checks that the topics have the fields in `when`. `payload_of`: the description of a topic; null if unknown, then
/// its fields are not checked.
void check_trigger_names(const TriggerConfig& config,
                         const std::function<const Description*(std::string_view topic)>& payload_of,
                         const ConfigItem& item, Problems& problems);

class TriggerSensor : public AnySensor {
 public:
  TriggerSensor() noexcept = default;
  /// SetupError: as `Feed`; ExpressionError; not-found (there is no topic `on` yet); bad-description (its payload has
  /// no description); bad-argument for a configuration that cannot work; io-failed (no memory for the ring).
  TriggerSensor(Loop& loop, FeedConfig feed, TriggerConfig config);

 private:
  explicit TriggerSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
