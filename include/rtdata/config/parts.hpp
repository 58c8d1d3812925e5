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
///         [](Loop& loop, const SinkConfig& common, const LinesConfig& config) {
///           return Sink(loop, common, std::make_unique<Lines>(config));
///         });
///
/// A factory may return any class derived from AnySensor or Sink. One that takes a FeedConfig instead of a SensorConfig
/// makes sensors without a schedule: they have no `rate` and what belongs to it.
///
/// Owner: the program; nothing is global. Filled by one thread, then read by any.
/// Errors: adding a type twice throws SetupError (bad_argument).
#pragma once

#include <concepts>
#include <functional>
#include <memory>
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
  Owned(Owned&& other) noexcept
      : holder_(std::move(other.holder_)), object_(std::exchange(other.object_, nullptr)) {}
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

/// An amount of memory: "32 MB", "512 KiB", "4096 B" in a file; k, M, G are powers of 1000, Ki, Mi, Gi of 1024.
struct ByteSize {
  std::size_t bytes = 0;
  bool operator==(const ByteSize&) const = default;
};
Result<ByteSize> parse_byte_size(std::string_view text);
/// The shortest exact text that `parse_byte_size` reads back.
std::string to_string(ByteSize size);

template <>
struct ConfigValue<ByteSize> {
  static bool read(const ConfigItem& item, ByteSize& out, Problems& problems);
  static void write(ByteSize value, ConfigItem& item);
};

/// What all sinks have in common, as a file names it; see SinkConfig.
struct SinkKeys {
  std::string name = {};
  std::vector<std::string> topics = SinkConfig{}.topics;
  std::size_t batch_rows = SinkConfig{}.batch_rows;
  Duration batch_time = SinkConfig{}.batch_time;
  ByteSize queue = {SinkConfig{}.queue_bytes};
  WhenFull when_full = SinkConfig{}.when_full;
  Duration retry_first = SinkConfig{}.retry_first;
  Duration retry_longest = SinkConfig{}.retry_longest;
  Duration close_deadline = SinkConfig{}.close_deadline;

  SinkConfig config() const;

  friend constexpr auto parameters(type_tag<SinkKeys>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("name", &SinkKeys::name, "in reports and the ledger; default: its path or type"),
        parameter("topics", &SinkKeys::topics,
                  "topics it takes; + stands for one level, # at the end for all below"),
        parameter("batch_rows", &SinkKeys::batch_rows, "events that are stored together", range(1, 1000000)),
        parameter("batch_time", &SinkKeys::batch_time, "a batch is stored after so long, however small it is",
                  range(1ms, 1h)),
        parameter("queue", &SinkKeys::queue, "memory for events that wait, such as 32 MB"),
        parameter("when_full", &SinkKeys::when_full, "what is dropped when the queue is full; it is counted",
                  choices(value("drop_newest", WhenFull::drop_newest), value("drop_oldest", WhenFull::drop_oldest))),
        parameter("retry_first", &SinkKeys::retry_first, "wait after a failed batch", range(1ms, 1h)),
        parameter("retry_longest", &SinkKeys::retry_longest, "the wait doubles up to this", range(1ms, 24h)),
        parameter("close_deadline", &SinkKeys::close_deadline, "how long closing waits for what is queued",
                  range(0s, 1h)));
  }
};

/// A sensor as its item says, checked and not made yet.
struct SensorPlan {
  std::string type;
  std::string name;
  std::string topic;                               ///< never empty
  std::shared_ptr<const Description> description;  ///< of its events; null: known only once it is made
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
  std::function<Owned<Sink>(Loop&)> make;
};

namespace config_detail {

/// A type's own parameters behind those of all its kind, on one level.
template <class Common, class Own>
struct Joined {
  Common common{};
  Own own{};
  friend constexpr auto parameters(type_tag<Joined>) {
    return parameter_list(include_member(&Joined::common), include_member(&Joined::own));
  }
  friend void check_config(const Joined& joined, const ConfigItem& item, Problems& problems) {
    if constexpr (requires { check_config(joined.own, item, problems); }) check_config(joined.own, item, problems);
  }
};

SensorPlan sensor_plan(const std::string& name, const std::string& topic,
                       Result<std::shared_ptr<const Description>> description);

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
      plan.make = [make, all](Loop& loop) { return Owned<AnySensor>(make(loop, all.common, all.own)); };
      return plan;
    });
  }

  /// `path(const C&)`: the file that the sink writes, so that two sinks on one are found; "-" for standard output, ""
  /// for none. `make(Loop&, const SinkConfig&, const C&)`.
  template <Configurable C, class Path, class Make>
  void add_sink(const std::string& type, std::string doc, Path path, Make make) {
    using All = config_detail::Joined<SinkKeys, C>;
    sinks_.add<All>(type, std::move(doc), [type, path, make](const All& all) {
      SinkPlan plan;
      plan.type = type;
      plan.path = path(all.own);
      plan.name = !all.common.name.empty() ? all.common.name : plan.path.empty() || plan.path == "-" ? type : plan.path;
      plan.topics = all.common.topics;
      plan.close_deadline = all.common.close_deadline;
      plan.make = [make, all, name = plan.name](Loop& loop) {
        SinkConfig common = all.common.config();
        common.name = name;
        return Owned<Sink>(make(loop, std::as_const(common), all.own));
      };
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
