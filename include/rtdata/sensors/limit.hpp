/// LimitSensor: alarms of one number of a topic, as a topic of their own.
///
///     rtdata::LimitSensor alarm(loop, {.name = "tank_alarm"},
///                               {.on = "tank", .field = "pressure", .high = 5e5, .hysteresis = 1e4, .latched = true});
///     alarm.acknowledge();
///
/// process/limits.hpp defines levels, alarms and acknowledgement. The sensor publishes an event for the first value and
/// for each change. An unknown value (the field is absent, the topic has no such number, no event for `silence`) is a
/// level too; without events the sensor is also faulted, with a gap. `stop` publishes an unknown value, because nothing
/// is watched then; closing the limit and the end of its run publish nothing.
///
/// Frequent changes are joined: after an event, changes within `join` are held back and counted, and the result is
/// published when `join` is over. A worse alarm, or one on the other side, is published at once. So a value that
/// oscillates around a limit gives few events, and an alarm is never late.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <functional>
#include <string>
#include <string_view>

#include "rtdata/data/description.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/process/limits.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata {

struct LimitConfig {
  std::string on = {};
  std::string field = {};  ///< its path; empty: `value`, or the only number
  std::optional<double> low_low = {}, low = {}, high = {}, high_high = {};
  double hysteresis = 0;
  Duration delay{0};
  bool latched = false;
  Duration silence = std::chrono::seconds{10};  ///< 0: the topic may be silent
  Duration join = std::chrono::seconds{1};      ///< 0: each change is an event

  LimitSettings settings() const { return {low_low, low, high, high_high, hysteresis, delay, latched}; }

  friend constexpr auto parameters(type_tag<LimitConfig>) {
    using namespace std::chrono_literals;
    using C = LimitConfig;
    constexpr Duration longest{24h * 365};
    return parameter_list(
        parameter("on", &C::on, "the topic", required, names_part("topic")),
        parameter("field", &C::field, "path of the field; default: `value`, or the only number", TextIs::recorded),
        parameter("low_low", &C::low_low, "smaller values are critical"),
        parameter("low", &C::low, "smaller values are a warning"),
        parameter("high", &C::high, "larger values are a warning"),
        parameter("high_high", &C::high_high, "larger values are critical"),
        parameter("hysteresis", &C::hysteresis, "a level ends when the value is back inside the limit by this much",
                  range(0.0, 1e300)),
        parameter("delay", &C::delay, "a level begins when the value has been beyond the limit for this time",
                  range(Duration{0}, longest)),
        parameter("latched", &C::latched, "the alarm stays until it is acknowledged"),
        parameter("silence", &C::silence, "after this time without an event, the value is unknown; 0: never",
                  range(Duration{0}, longest)),
        parameter("join", &C::join,
                  "further changes within this time become one event, except changes to a worse alarm",
                  range(Duration{0}, Duration{1h})));
  }
};

/// Checks rules over several parameters.
void check_config(const LimitConfig& config, const ConfigItem& item, Problems& problems);
/// Checks that the topic has such a number. `payload_of`: the description of a topic; null: unknown, not checked.
void check_limit_field(const LimitConfig& config,
                       const std::function<const Description*(std::string_view topic)>& payload_of,
                       const ConfigItem& item, Problems& problems);

/// The payload: what has changed.
struct Alarm {
  LimitLevel level = LimitLevel::normal;  ///< of the value
  LimitLevel alarm = LimitLevel::normal;  ///< the state to signal
  bool is_active = false;                 ///< the alarm is not normal
  bool acknowledged = true;               ///< also true without an alarm
  std::optional<double> value{};          ///< unit of the field; none: unknown
  std::optional<double> limit{};          ///< that of the alarm, unit of the field
  std::uint32_t joined = 0;               ///< changes since the last event that were joined into this one

  friend constexpr auto describe(type_tag<Alarm>) {
    return record("alarm", field("level", &Alarm::level), field("alarm", &Alarm::alarm),
                  field("is_active", &Alarm::is_active), field("acknowledged", &Alarm::acknowledged),
                  field("value", &Alarm::value), field("limit", &Alarm::limit), field("joined", &Alarm::joined))
        .of_changes();
  }
};

class LimitSensor : public AnySensor {
 public:
  LimitSensor() noexcept = default;
  /// SetupError: as `Feed`; bad-argument for limits that cannot work.
  LimitSensor(Loop& loop, FeedConfig feed, LimitConfig config);

  /// Acknowledges the alarm and publishes that. False: there is nothing to acknowledge.
  bool acknowledge();
  /// Changes limits, delay, latch, silence and joining, from the next event on; until then the alarm does not change.
  /// `on` and `field` cannot change. SetupError: as the constructor.
  void change(const LimitConfig& config);
  /// As it is now; normal when it is closed.
  LimitState state() const;

 private:
  explicit LimitSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
