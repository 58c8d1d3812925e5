#include "rtdata/sensors/vertical.hpp"

#include <array>
#include <cmath>
#include <vector>

#include "data/setting_mistake.hpp"
#include "loop/events/made_of.hpp"
#include "process/number_field.hpp"
#include "rtdata/data/config_value.hpp"
#include "rtdata/loop/topic.hpp"
#include "sensors/core/feed_node.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_estimate = "cannot estimate the motion";

enum class Quantity { height, pressure, acceleration };
/// How a unit is read: the value in m, Pa or g is `factor` times that of the field.
struct VerticalUnit {
  std::string_view name;
  Quantity quantity;
  double factor;
};
constexpr std::array vertical_units = {
    VerticalUnit{"", Quantity::height, 1},          VerticalUnit{"m", Quantity::height, 1},
    VerticalUnit{"Pa", Quantity::pressure, 1},      VerticalUnit{"hPa", Quantity::pressure, 1e2},
    VerticalUnit{"mbar", Quantity::pressure, 1e2},  VerticalUnit{"kPa", Quantity::pressure, 1e3},
    VerticalUnit{"bar", Quantity::pressure, 1e5},   VerticalUnit{"", Quantity::acceleration, 1},
    VerticalUnit{"[g]", Quantity::acceleration, 1}, VerticalUnit{"m/s2", Quantity::acceleration, 1 / 9.80665}};

const VerticalUnit* vertical_unit(std::string_view name, bool is_acceleration) {
  for (const VerticalUnit& unit : vertical_units)
    if (unit.name == name && (unit.quantity == Quantity::acceleration) == is_acceleration) return &unit;
  return nullptr;
}

/// m in the standard atmosphere.
double height_of_pressure(double pascals) { return 44330.77 * (1 - std::pow(pascals / 101325, 0.190263)); }

/// Why a field cannot be used; empty: it can.
std::string vertical_refusal(const Description& payload, const std::string& topic, const std::string& field,
                             bool is_acceleration) {
  const Leaf* const leaf = detail::number_field(payload, field);
  if (leaf == nullptr) return "the topic \"" + topic + "\" has no number `" + (field.empty() ? "value" : field) + "`";
  if (vertical_unit(leaf->unit, is_acceleration) == nullptr)
    return "`" + leaf->path + "` of the topic \"" + topic + "\" is in " + std::string(leaf->unit) + "; " +
           (is_acceleration ? "use [g] or m/s2" : "use m, Pa, hPa, kPa, mbar or bar");
  return "";
}

std::string vertical_mistake(const VerticalConfig& config) {
  if (config.barometer.empty() && config.accelerometer.empty())
    return "set `barometer`, `accelerometer`, or both, to a topic";
  for (const std::string* const topic : {&config.barometer, &config.accelerometer})
    if (!topic->empty() && !is_topic_name(*topic)) return "\"" + *topic + "\" is not a topic";
  return "";
}

}  // namespace

namespace detail {

class VerticalNode final : public FeedNode {
 public:
  VerticalNode(Loop& loop, const FeedConfig& feed, const VerticalConfig& config)
      : FeedNode(loop.core(), feed, payload_type<VerticalMotion>()),
        config_(config),
        estimate_({.burn = config.burn, .noise = config.noise, .range = config.range}) {
    set_numbered();  // it makes its events itself
  }

  /// Separate, because a subscription may fail.
  void subscribe(Loop& loop) {
    std::vector<std::string> sources;
    for (const std::string* const topic : {&config_.barometer, &config_.accelerometer}) {
      if (topic->empty() || (topic == &config_.accelerometer && config_.barometer == *topic)) continue;
      subscriptions_.push_back(loop.subscribe(*topic, [this, topic](const EventView& event) { take(*topic, event); }));
      subscriptions_.back().set_name("sensor " + origin_.name + " on " + *topic);
      sources.push_back(*topic);
    }
    set_made_of(origin_, std::move(sources));
  }

  void start() override {
    if (is_running() || !is_open()) return;
    FeedNode::start();
    estimate_.reset();
  }

 private:
  struct Field {
    std::uint64_t description = 0;  // serial of its description; 0: none yet
    const Leaf* leaf = nullptr;
    const VerticalUnit* unit = nullptr;
  };

  void take(const std::string& topic, const EventView& event) {
    if (!is_running()) return;
    Call call(*this);
    VerticalReadings readings;
    if (topic == config_.barometer) {
      if (!read(height_, config_.barometer, config_.height, false, event, readings.height)) return;
      if (height_.unit != nullptr && height_.unit->quantity == Quantity::pressure)
        readings.height = readings.height > 0 ? height_of_pressure(readings.height) : VerticalReadings::none;
    }
    if (topic == config_.accelerometer &&
        !read(acceleration_, config_.accelerometer, config_.acceleration, true, event, readings.acceleration))
      return;
    estimate_.take(event.time(), readings);
    VerticalMotion motion = motion_of(estimate_.now());
    publish(&motion, event.time());
  }

  /// False: the unit is unknown, which is reported. A payload without the field, such as from an import with an empty
  /// column, gives no value, which is reported once; the other sensor continues.
  bool read(Field& field, const std::string& topic, const std::string& path, bool is_acceleration,
            const EventView& event, double& value) {
    const bool is_new = field.description != event.description().serial();
    if (is_new) {
      field.description = event.description().serial();
      field.leaf = number_field(event.description(), path);
      field.unit = field.leaf != nullptr ? vertical_unit(field.leaf->unit, is_acceleration) : nullptr;
    }
    if (field.unit != nullptr) {
      value = number_in(*field.leaf, event.payload().data()).value_or(VerticalReadings::none) * field.unit->factor;
      return true;
    }
    const Error error{Errc::not_found, cannot_estimate, object_name(),
                      vertical_refusal(event.description(), topic, path, is_acceleration),
                      "check the fields of the topic; a derived topic converts units"};
    if (field.leaf != nullptr) {
      fail(error);
      return false;
    }
    if (is_new) complain(error, Health::degraded);
    return true;
  }

  void on_close() noexcept override {
    subscriptions_.clear();
    FeedNode::on_close();
  }

  const VerticalConfig config_;
  VerticalKalman estimate_;
  Field height_, acceleration_;
  std::vector<Subscription> subscriptions_;
};

}  // namespace detail

VerticalMotion motion_of(const VerticalState& state) noexcept {
  VerticalMotion motion{
      state.height, state.speed,     state.acceleration, state.height_deviation, state.speed_deviation,
      {},           state.unchanged, state.barometer,    state.accelerometer,    state.is_flying};
  if (std::isfinite(state.ground)) motion.above = state.height - state.ground;
  return motion;
}

void check_config(const VerticalConfig& config, const ConfigItem& item, Problems& problems) {
  if (const std::string why = vertical_mistake(config); !why.empty()) problems.add(item.problem("bad-value", why));
}

void check_vertical_fields(const VerticalConfig& config,
                           const std::function<const Description*(std::string_view topic)>& payload_of,
                           const ConfigItem& item, Problems& problems) {
  const auto check = [&](const std::string& topic, const std::string& field, const char* topic_key,
                         const char* field_key, bool is_acceleration) {
    const Description* const payload = topic.empty() ? nullptr : payload_of(topic);
    if (payload == nullptr) return;
    const std::string why = vertical_refusal(*payload, topic, field, is_acceleration);
    if (why.empty()) return;
    std::vector<std::string> numbers;
    for (const Leaf& leaf : payload->leaves())
      if (detail::number_field(*payload, leaf.path) != nullptr) numbers.push_back(leaf.path);
    const bool is_missing = detail::number_field(*payload, field) == nullptr;
    problems.add(detail::item_of(item, field.empty() ? topic_key : field_key)
                     .problem(is_missing ? "unknown-field" : "bad-value", why,
                              is_missing ? nearest_name(field, numbers) : std::string()));
  };
  check(config.barometer, config.height, "barometer", "height", false);
  check(config.accelerometer, config.acceleration, "accelerometer", "acceleration", true);
}

VerticalSensor::VerticalSensor(Loop& loop, FeedConfig feed, VerticalConfig config) {
  if (const std::string why = vertical_mistake(config); !why.empty())
    throw SetupError({Errc::bad_argument, cannot_estimate, "sensor " + feed.name, why, ""});
  auto* const node = new detail::VerticalNode(loop, feed, config);
  *this = VerticalSensor(node);
  node->subscribe(loop);
}

}  // namespace rtdata
