/// DerivedSensor: values computed by expressions from those of other topics, as a topic of their own.
///
///     rtdata::DerivedSensor norm(loop, {.name = "norm"},
///                                {.on = "imu", .fields = {{"value", "sqrt(x^2 + y^2 + z^2)", "m/s2"}}});
///
/// Each event on the topic `on` gives one event, with its time; of the topics `with`, their latest values count. What
/// expressions are: process/expression.hpp. Their names are
///   - FIELD, a field of the topic `on` by its path: `x`, `accel[0]`;
///   - TOPIC.FIELD of any of these topics, with "." for "/": `room.climate.temperature`;
///   - TOPIC of one with a single number, or with one called `value`.
/// Numbers of all kinds, booleans (1 or 0) and enumerations (their number) have values; texts have none.
///
/// The fields are doubles, and absent where the expression waits: for the second value of a rate, say, or for a field
/// that is absent itself. What becomes of an event on the topic `on`:
///   - a topic `with` has brought nothing yet, or nothing in the last `age` before it: nothing is published, the sensor
///     is faulted, and the time until the next one that can be used is a gap (disconnected);
///   - an expression fails (division by zero, a number that is not finite, a field that is not there): it is
///     unreadable, told with the reason, and the sensor is degraded until the next good one;
///   - else it is published, with the fields that have a value.
/// Memories begin anew after `start`.
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
    return parameter_list(parameter("name", &DerivedField::name, "name of the field", required, TextIs::field),
                          parameter("expression", &DerivedField::expression, "what it is", required, TextIs::recorded),
                          parameter("unit", &DerivedField::unit, "of the result; nothing is converted", TextIs::unit));
  }
};

struct DerivedConfig {
  std::string on = {};                 ///< the topic each of whose events gives one
  std::vector<std::string> with = {};  ///< other topics, of which the latest values count
  Duration age = std::chrono::seconds{10};
  std::string expression = {};  ///< of a single field called `value`; empty: `fields`
  std::string unit = {};        ///< of that field
  std::vector<DerivedField> fields = {};

  friend constexpr auto parameters(type_tag<DerivedConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("on", &DerivedConfig::on, "the topic each of whose events gives one", required, names_part("topic")),
        parameter("with", &DerivedConfig::with, "other topics, of which the latest values count", names_part("topic")),
        parameter("age", &DerivedConfig::age, "older values of the topics `with` are not used: there is a gap",
                  range(Duration{1us}, Duration{24h * 365})),
        parameter("expression", &DerivedConfig::expression, "of a single field called `value`", TextIs::recorded),
        parameter("unit", &DerivedConfig::unit, "of that field; nothing is converted", TextIs::unit),
        parameter("fields", &DerivedConfig::fields, "several fields, instead of `expression`"));
  }
};

/// Errors: bad-description (no fields, a name twice, a unit that is none).
Result<std::shared_ptr<const Description>> derived_description(const DerivedConfig& config);
/// What no parameter says by itself: expressions that can be read, and either `expression` or `fields`.
void check_config(const DerivedConfig& config, const ConfigItem& item, Problems& problems);
/// Whether the topics have the fields that the expressions name. `payload_of`: what a topic carries, null when that is
/// not known: then nothing is said of its fields.
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
