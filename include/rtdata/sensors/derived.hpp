/// DerivedSensor: values computed by expressions from those of other topics, as a topic of their own.
///
///     rtdata::DerivedSensor norm(loop, {.name = "norm"},
///                                {.on = "imu", .fields = {{"value", "sqrt(x^2 + y^2 + z^2)", "m/s2"}}});
///
/// Each event on the topic `on` gives one event with the same time; for the topics `with`, the latest values are used.
/// Expressions: process/expression.hpp. Their names are
///   - FIELD, a field of the topic `on` by its path: `x`, `accel[0]`;
///   - TOPIC.FIELD of any of these topics, with "." for "/": `room.climate.temperature`;
///   - TOPIC, if it has a single number or a field called `value`.
/// Numbers of all kinds, booleans (1 or 0) and enumerations (their number) have values; texts have none.
///
/// The fields are doubles; a field is absent while its expression waits, for example for the second value of a rate or
/// for an absent field. An event on the topic `on` has one of these results:
///   - a topic `with` has no event yet, or none within `age` before it: nothing is published, the sensor is faulted,
///     and the time until the next usable event is a gap (disconnected);
///   - an expression fails (division by zero, a number that is not finite, a missing field): the event is unreadable,
///     the reason is reported, and the sensor is degraded until the next good event;
///   - otherwise it is published, with the fields that have a value.
/// Functions with a memory restart after `start`.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/description.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/process/expression.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata {

struct DerivedField {
  std::string name;
  std::string expression;
  std::string unit = {};  ///< UCUM, of the result; nothing is converted

  friend constexpr auto parameters(type_tag<DerivedField>) {
    return parameter_list(
        parameter("name", &DerivedField::name, "name of the field", required, TextIs::field),
        parameter("expression", &DerivedField::expression, "expression that gives its value", required,
                  TextIs::recorded),
        parameter("unit", &DerivedField::unit, "unit of the result; the value is not converted", TextIs::unit));
  }
};

struct DerivedConfig {
  std::string on = {};                 ///< each event of this topic gives one event
  std::vector<std::string> with = {};  ///< other topics; their latest values are used
  Duration age = std::chrono::seconds{10};
  std::string expression = {};  ///< of a single field called `value`; empty: `fields`
  std::string unit = {};        ///< of that field
  std::vector<DerivedField> fields = {};

  friend constexpr auto parameters(type_tag<DerivedConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("on", &DerivedConfig::on, "the topic; each of its events gives one event of this sensor", required,
                  names_part("topic")),
        parameter("with", &DerivedConfig::with, "other topics; their latest values are used", names_part("topic")),
        parameter("age", &DerivedConfig::age, "older values of the topics `with` are not used; this makes a gap",
                  range(Duration{1us}, Duration{24h * 365})),
        parameter("expression", &DerivedConfig::expression, "expression of a single field called `value`",
                  TextIs::recorded),
        parameter("unit", &DerivedConfig::unit, "unit of that field; the value is not converted", TextIs::unit),
        parameter("fields", &DerivedConfig::fields, "several fields, instead of `expression`"));
  }
};

/// Errors: bad-description (no fields, a duplicate name, an invalid unit).
Result<std::shared_ptr<const Description>> derived_description(const DerivedConfig& config);
/// Checks rules over several parameters: the expressions are valid, and there is either `expression` or `fields`.
void check_config(const DerivedConfig& config, const ConfigItem& item, Problems& problems);
/// Checks that the topics have the fields in the expressions. `payload_of`: the description of a topic; null if
/// unknown, then its fields are not checked.
void check_derived_names(const DerivedConfig& config,
                         const std::function<const Description*(std::string_view topic)>& payload_of,
                         const ConfigItem& item, Problems& problems);

class DerivedSensor : public AnySensor {
 public:
  DerivedSensor() noexcept = default;
  /// SetupError: as `Feed`; ExpressionError; bad-argument for a configuration that cannot work.
  DerivedSensor(Loop& loop, FeedConfig feed, DerivedConfig config);

 private:
  explicit DerivedSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
