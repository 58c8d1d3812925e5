/// Registry: the sensor and sink types that configurations can name, and what each makes of its item.
///
///     Registry registry;
///     registry.add_sensor<AnalogConfig>(
///         "analog", "a sensor behind a converter of the kernel",
///         [](const AnalogConfig& config) { return analog_description(config.unit); },
///         [](Loop& loop, const SensorConfig& common, const AnalogConfig& config) {
///           return AnalogSensor(loop, common, config);
///         });
///     registry.add_sink<LinesConfig>(
///         "lines", "one line an event", [](const LinesConfig& config) { return config.path; },
///         [](Loop& loop, const LinesConfig& config) {
///           return Sink(loop, config.sink, std::make_unique<Lines>(config));
///         });
///
/// A factory may return any class derived from AnySensor or Sink. One that takes a FeedConfig instead of a SensorConfig
/// makes sensors without a schedule: they have no `rate` and what belongs to it. A function `ReadTime read_time(const
/// AnalogConfig&)` beside the Config says how long one reading takes (load.hpp); without it that is not known.
///
/// Owner: the program; nothing is global. Filled by one thread, then read by any.
/// Errors: adding a type twice throws SetupError (bad_argument).
#pragma once

#include <concepts>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "rtdata/config/registry.hpp"
#include "rtdata/sensors/sensor_parameters.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata {

/// Owns an object of a class derived from Base. Move-only; empty when default-made or moved from.
template <class Base>
class Owned {
 public:
  Owned() noexcept = default;
  template <std::derived_from<Base> T>
  Owned(T object) : holder_(std::make_unique<HolderOf<T>>(std::move(object))), object_(holder_->object()) {}
  Owned(Owned&& other) noexcept : holder_(std::move(other.holder_)), object_(std::exchange(other.object_, nullptr)) {}
  Owned& operator=(Owned&& other) noexcept {
    object_ = std::exchange(other.object_, nullptr);
    holder_ = std::move(other.holder_);
    return *this;
  }

  explicit operator bool() const noexcept { return object_ != nullptr; }
  Base& operator*() const noexcept { return *object_; }
  Base* operator->() const noexcept { return object_; }

 private:
  struct Holder {
    virtual ~Holder() = default;
    virtual Base* object() noexcept = 0;
  };
  template <class T>
  struct HolderOf final : Holder {
    explicit HolderOf(T held) : object_(std::move(held)) {}
    Base* object() noexcept override { return &object_; }
    T object_;
  };
  std::unique_ptr<Holder> holder_;
  Base* object_ = nullptr;
};

/// A sensor as its item says, checked and not made yet.
struct SensorPlan {
  std::string type;
  std::string name;
  std::string topic;                               ///< never empty
  std::string tier;                                ///< empty: the main loop
  std::shared_ptr<const Description> description;  ///< of its events; null: known only once it is made
  std::optional<SensorLoad> load;                  ///< null: there is nothing to read, the program feeds it
  ConfigItem item;                                 ///< it was made from
  std::function<Owned<AnySensor>(Loop&)> make;
};

/// A sink as its item says, checked and not made yet.
struct SinkPlan {
  std::string type;
  std::string name;
  std::string path;  ///< the file it writes; "-" for standard output, empty for none
  std::vector<std::string> topics;
  Duration close_deadline{0};  ///< how long closing may wait for it
  ConfigItem item;
  /// Of the topics that it is to take, an error for each that it cannot; empty: not known before it is made.
  std::function<std::vector<Error>(std::span<const TopicToRecord>)> refused_topics;
  /// The file that a topic's events go to; empty: all go to `path`.
  std::function<std::string(std::string_view topic)> file_of_topic;
  /// Whether it makes, renames or removes `other` beside `file`, which it writes; both paths absolute. Empty: it has the
  /// files that it writes and no others.
  std::function<bool(const std::string& file, const std::string& other)> is_beside;
  std::function<Owned<Sink>(Loop&)> make;
};

namespace config_detail {

/// Which loop an object is made on.
struct Placement {
  std::string tier;
  friend constexpr auto parameters(type_tag<Placement>) {
    return parameter_list(
        parameter("tier", &Placement::tier, "the tier that it runs on; default: the main loop", TextIs::recorded));
  }
};

/// A sensor type's own parameters behind those of all sensors, on one level.
template <class Common, class Own>
struct Joined {
  Common common{};
  Placement placement{};
  Own own{};
  friend constexpr auto parameters(type_tag<Joined>) {
    return parameter_list(include_member(&Joined::common), include_member(&Joined::placement),
                          include_member(&Joined::own));
  }
  friend void check_config(const Joined& joined, const ConfigItem& item, Problems& problems) {
    if constexpr (requires { check_config(joined.own, item, problems); }) check_config(joined.own, item, problems);
  }
};

SensorPlan sensor_plan(const std::string& name, const std::string& topic,
                       Result<std::shared_ptr<const Description>> description);
template <class C>
std::optional<SensorLoad> load_of(const SensorConfig& common, const C& config) {
  SensorLoad load{common.name, common.rate.period(), {}, {}};
  if (common.start) load.phase = common.phase;
  if constexpr (requires { ReadTime{read_time(config)}; }) load.time = read_time(config);
  if (common.read_time) (load.time.lane.empty() ? load.time.on_loop : load.time.on_lane) = common.read_time;
  return load;
}
template <class C>
std::optional<SensorLoad> load_of(const FeedConfig& common, const C& config) {
  if constexpr (requires { ReadTime{read_time(config)}; }) {
    return SensorLoad{common.name, Duration{0}, {}, read_time(config)};
  } else {
    return std::nullopt;
  }
}

SinkPlan sink_plan(const std::string& type, std::string path, const SinkConfig& config);

}  // namespace config_detail

/// For a type without parameters of its own.
struct NoParameters {
  friend constexpr auto parameters(type_tag<NoParameters>) { return parameter_list(); }
};

class Registry {
 public:
  Registry() : sensors_("sensor"), sinks_("sink") {}

  /// `doc`: a phrase in lower case. `describe(const C&)`: the description of its events, or a Result of one; null when
  /// it is not known before the sensor is made. `make(Loop&, const SensorConfig& or const FeedConfig&, const C&)`.
  template <Configurable C, class Describe, class Make>
  void add_sensor(const std::string& type, std::string doc, Describe describe, Make make) {
    constexpr bool is_scheduled = std::is_invocable_v<const Make&, Loop&, const SensorConfig&, const C&>;
    static_assert(is_scheduled || std::is_invocable_v<const Make&, Loop&, const FeedConfig&, const C&>,
                  "rtdata: a sensor type is made by (Loop&, const SensorConfig&, const Config&) or, without a "
                  "schedule, by (Loop&, const FeedConfig&, const Config&)");
    using Common = std::conditional_t<is_scheduled, SensorConfig, FeedConfig>;
    using All = config_detail::Joined<Common, C>;
    sensors_.add<All>(type, std::move(doc), [type, describe, make](const All& all) {
      SensorPlan plan = config_detail::sensor_plan(all.common.name, all.common.topic, describe(all.own));
      plan.type = type;
      plan.tier = all.placement.tier;
      plan.load = config_detail::load_of(all.common, all.own);
      plan.make = [make, all](Loop& loop) { return Owned<AnySensor>(make(loop, all.common, all.own)); };
      return plan;
    });
  }

  /// C has a member `sink`, a SinkConfig whose parameters are among its own (`include_member(&C::sink)`).
  /// `path(const C&)`: the file that the sink writes, so that two sinks on one are found; "-" for standard output, ""
  /// for none. `make(Loop&, const C&)`. A function `refused_topics(const C&, std::span<const TopicToRecord>)` beside the
  /// Config says which topics such a sink cannot take: then a configuration with one is refused, before anything is made. A
  /// function `file_of_topic(const C&, std::string_view)` there says which file a topic's events go to, where `path` does
  /// not: then two sinks on one are found too. A function `is_beside(const C&, const std::string& file, const std::string&
  /// other)` there says which files go with one that it writes, such as a log or a lock: then they are no other sink's.
  template <Configurable C, class Path, class Make>
  void add_sink(const std::string& type, std::string doc, Path path, Make make) {
    static_assert(
        requires(const C& config) { static_cast<const SinkConfig&>(config.sink); },
        "rtdata: the Config of a sink type has a member `sink`, a SinkConfig");
    sinks_.add<C>(type, std::move(doc), [type, path, make](const C& config) {
      SinkPlan plan = config_detail::sink_plan(type, path(config), config.sink);
      C named = config;
      named.sink.name = plan.name;
      if constexpr (requires(std::span<const TopicToRecord> topics) { refused_topics(config, topics); }) {
        plan.refused_topics = [config](std::span<const TopicToRecord> topics) {
          return refused_topics(config, topics);
        };
      }
      if constexpr (requires(std::string_view topic) { file_of_topic(config, topic); })
        plan.file_of_topic = [config](std::string_view topic) { return file_of_topic(config, topic); };
      if constexpr (requires(const std::string& file) { is_beside(config, file, file); })
        plan.is_beside = [config](const std::string& file, const std::string& other) {
          return is_beside(config, file, other);
        };
      plan.make = [make, named](Loop& loop) { return Owned<Sink>(make(loop, named)); };
      return plan;
    });
  }

  const TypeRegistry<SensorPlan>& sensors() const noexcept { return sensors_; }
  const TypeRegistry<SinkPlan>& sinks() const noexcept { return sinks_; }
  /// The JSON Schema (draft-07) of a whole configuration file.
  std::string schema() const;

 private:
  TypeRegistry<SensorPlan> sensors_;
  TypeRegistry<SinkPlan> sinks_;
};

}  // namespace rtdata
