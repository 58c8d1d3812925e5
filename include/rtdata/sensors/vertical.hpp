/// VerticalSensor: height, vertical speed and acceleration of a flying object, from a barometer and an accelerometer
/// that other sensors read, as a topic of its own.
///
///     rtdata::VerticalSensor motion(loop, {.name = "motion"},
///                                   {.barometer = "rocket", .height = "altitude",
///                                    .accelerometer = "rocket", .acceleration = "acceleration"});
///
/// The estimate: process/vertical_kalman.hpp. Each event of these topics gives one event with the same time; one topic
/// may have both fields. A height may be a pressure; units are those of the topics' fields: m, Pa, hPa, kPa, mbar or
/// bar (no unit: m); [g] or m/s2 (no unit: [g]). Another unit or a missing field is reported, and the event is
/// unreadable. Without a value (absent or NaN) the estimate continues without it. It restarts after `start`.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's. Allocates no memory after construction.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "rtdata/data/description.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/process/vertical_kalman.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata {

struct VerticalConfig {
  std::string barometer = {};      ///< a topic; empty: none
  std::string height = {};         ///< path of its field; empty: `value`, or the only number
  std::string accelerometer = {};  ///< a topic; empty: none
  std::string acceleration = {};   ///< path of its field; empty: as above
  Duration burn = std::chrono::seconds{7};
  double noise = 0.5;  ///< m
  double range = 0;    ///< g; 0: detected from repeated values

  friend constexpr auto parameters(type_tag<VerticalConfig>) {
    using namespace std::chrono_literals;
    using C = VerticalConfig;
    return parameter_list(
        parameter("barometer", &C::barometer, "topic of the barometer; empty: no barometer", names_part("topic")),
        parameter("height", &C::height,
                  "path of the field with the height or pressure; default: `value`, or the only number",
                  TextIs::recorded),
        parameter("accelerometer", &C::accelerometer, "topic of the accelerometer; empty: no accelerometer",
                  names_part("topic")),
        parameter(
            "acceleration", &C::acceleration,
            "path of the field with the acceleration along the axis, 1 g at rest; default: `value`, or the only number",
            TextIs::recorded),
        parameter("burn", &C::burn,
                  "how long the barometer is ignored after liftoff, if no accelerometer gives the speed",
                  rtdata::range(Duration{0}, Duration{1min})),
        parameter("noise", &C::noise, "least noise assumed for the barometer; more noise is detected automatically",
                  unit("m"), rtdata::range(0.01, 100.0)),
        parameter("range", &C::range, "end of the accelerometer's range; 0: detected from values that repeat there",
                  unit("[g]"), rtdata::range(0.0, 1000.0)));
  }
};

constexpr auto describe(type_tag<BarometerUse>) {
  return enumeration("barometer_use", value("none", BarometerUse::none), value("used", BarometerUse::used),
                     value("locked", BarometerUse::locked), value("refused", BarometerUse::refused));
}

/// The payload.
struct VerticalMotion {
  double height = 0;        ///< m, by the barometer's zero
  double speed = 0;         ///< m/s, upwards
  double acceleration = 0;  ///< m/s2, upwards
  double height_deviation = 0;
  double speed_deviation = 0;
  std::optional<double> above{};  ///< m, over where it stood; none: it has not stood still
  double unchanged = 0;           ///< s for which the barometer has had no new value
  BarometerUse barometer = BarometerUse::none;
  bool accelerometer = false;  ///< it measures
  bool flying = false;         ///< from the liftoff on, until it stands still

  friend constexpr auto describe(type_tag<VerticalMotion>) {
    using M = VerticalMotion;
    return record("vertical", field("height", &M::height, "m"), field("speed", &M::speed, "m/s"),
                  field("acceleration", &M::acceleration, "m/s2"), field("height_deviation", &M::height_deviation, "m"),
                  field("speed_deviation", &M::speed_deviation, "m/s"), field("above", &M::above, "m"),
                  field("unchanged", &M::unchanged, "s"), field("barometer", &M::barometer),
                  field("accelerometer", &M::accelerometer), field("flying", &M::flying));
  }
};
VerticalMotion motion_of(const VerticalState& state) noexcept;

/// Checks rules over several parameters: at least one of the two topics.
void check_config(const VerticalConfig& config, const ConfigItem& item, Problems& problems);
/// Checks that the topics have such numbers, in known units. `payload_of`: the description of a topic; null: unknown,
/// not checked.
void check_vertical_fields(const VerticalConfig& config,
                           const std::function<const Description*(std::string_view topic)>& payload_of,
                           const ConfigItem& item, Problems& problems);

class VerticalSensor : public AnySensor {
 public:
  VerticalSensor() noexcept = default;
  /// SetupError: as `Feed`; bad-argument for a configuration that cannot work.
  VerticalSensor(Loop& loop, FeedConfig feed, VerticalConfig config);

 private:
  explicit VerticalSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
