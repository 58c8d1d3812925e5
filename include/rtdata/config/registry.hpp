/// Registry: the types of sensors, sinks, buses and outputs that configurations can use, and how each is made from its
/// item.
///
///     rtdata::Registry registry;
///     registry.add_sensor<rtdata::AnalogConfig>(
///         "analog", "a sensor behind a converter of the kernel",
///         [](const rtdata::AnalogConfig& config) { return rtdata::analog_description(config.unit); },
///         rtdata::makes<rtdata::AnalogSensor>);   // or a function (Loop&, const SensorConfig&, const AnalogConfig&)
///     registry.add_sink<LinesConfig>(
///         "lines", "one line per event", [](const LinesConfig& config) { return config.path; },
///         [](rtdata::Loop& loop, const LinesConfig& config) {
///           return rtdata::Sink(loop, config.sink, std::make_unique<Lines>(config));
///         });
///     registry.add_bus<WireConfig>(
///         "wire", "one wire",
///         [](rtdata::Runtime&, const std::string&, const WireConfig& config) { return Wire(config); });
///
/// A factory may return any class derived from AnySensor or Sink; for a bus, any class. A factory that takes a
/// FeedConfig instead of a SensorConfig makes sensors without a schedule and without `rate`. A function `ReadTime
/// read_time(const AnalogConfig&)` next to the Config tells how long one reading takes (loop.hpp); without it the time
/// is unknown.
///
/// A part uses another part by its name: a parameter declared with `names_part("bus", "wire")` holds the name of a bus
/// of that type. That part exists when the factory is called, which takes `const Parts&` as its last argument:
///
///     const auto make_probe = [](rtdata::Loop& loop, const rtdata::SensorConfig& common, const ProbeConfig& config,
///                                const rtdata::Parts& parts) {
///       return Probe(loop, common, parts.get<Wire>("bus", config.bus));
///     };
///
/// Owner: the program; nothing is global. Filled by one thread, then read by any.
/// Errors: adding a type or a kind twice throws SetupError (bad-argument).
#pragma once

#include <concepts>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include "rtdata/config/parts.hpp"
#include "rtdata/detail/config/type_registry.hpp"
#include "rtdata/io/bus.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/sensors/driver.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata {

/// A kind of part that a configuration lists: its key in the file and its types.
struct PartKind {
  enum class Written {
    list,     ///< a list of objects, each with a `name`, given or by default
    by_name,  ///< an object; its keys are the names
  };
  /// What parts of this kind do. It is used in checks against other parts, even if their items have mistakes.
  enum class Does {
    nothing_known,
    publishes,  ///< on `topic`, or else on the topic of its name
    stores,     ///< what `topics` match, in the file `path`
  };
  std::string name;  ///< "sensor"
  std::string key;   ///< "sensors"
  std::string doc;
  Written written = Written::list;
  /// Makes a plan from the item and, for kinds written by name, the name.
  TypeRegistry<PartPlan, const std::string&> types;
  Does does = Does::nothing_known;
  /// The parameters that every type of this kind has. An item of unknown type is checked with these alone.
  std::vector<ParameterInfo> common = {};
};

namespace config_detail {

/// Which loop an object is made on.
struct Placement {
  std::string tier;
  friend constexpr auto parameters(type_tag<Placement>) {
    return parameter_list(parameter("tier", &Placement::tier, "the tier that it runs on; default: the main loop",
                                    TextIs::recorded, names_part("tier")));
  }
};

/// What is specific to one type of sensor, behind one interface; the code that uses it is common.
class SensorType {
 public:
  virtual ~SensorType() = default;
  virtual Result<std::shared_ptr<const Description>> describe(const void* own) const = 0;
  virtual void complete(PartPlan& plan, const void* own) const = 0;
  virtual std::optional<ReadTime> time_of_reading(const void* own) const = 0;
  virtual Sampling sampling(const void* own) const = 0;
  virtual PartObject make(Loop& loop, const void* common, const void* own, const Parts& parts) const = 0;
};
/// The same of sinks.
class SinkType {
 public:
  virtual ~SinkType() = default;
  virtual SinkConfig& common(void* own) const = 0;
  virtual std::string path(const void* own) const = 0;
  virtual void complete(StoredTopics& stores, std::shared_ptr<const void> own) const = 0;
  virtual PartObject make(Loop& loop, const void* own, const Parts& parts) const = 0;
};
/// The same of outputs.
class OutputType {
 public:
  virtual ~OutputType() = default;
  virtual void complete(PartPlan& plan, const void* own) const = 0;
  virtual std::unique_ptr<Actuator> make(const void* own) const = 0;
};

/// The device's own sampling. The functions are next to the Config, or in the driver.
template <class C>
Sampling sampling_of(const C& config) {
  Sampling sampling;
  if constexpr (requires { typename C::OfDriver; }) {
    using D = typename C::OfDriver;
    if constexpr (requires { D::sample_rate(config.own); }) sampling.hertz = D::sample_rate(config.own);
    if constexpr (requires { D::fifo_samples(config.own); }) sampling.kept = D::fifo_samples(config.own);
    if constexpr (requires { D::reading_time(config.own); }) sampling.reading_time = D::reading_time(config.own);
  } else if constexpr (requires { double{sample_rate(config)}; }) {
    sampling.hertz = sample_rate(config);
  }
  return sampling;
}

/// Removes the empty lines at the begin and end of raw strings.
std::string trimmed_notes(std::string_view notes);

/// True if a factory of sensors takes these settings, with or without `Parts`.
template <class Make, class Common, class C>
inline constexpr bool makes_sensor_of = std::is_invocable_v<const Make&, Loop&, const Common&, const C&> ||
                                        std::is_invocable_v<const Make&, Loop&, const Common&, const C&, const Parts&>;

/// Calls a factory, with `Parts` if it takes them.
template <class Make, class... Arguments>
decltype(auto) call_factory(const Make& make, const Parts& parts, Arguments&... arguments) {
  if constexpr (std::is_invocable_v<const Make&, Arguments&..., const Parts&>)
    return make(arguments..., parts);
  else
    return make(arguments...);
}

template <class Common, class C, class Describe, class Make, class Complete>
class SensorTypeOf final : public SensorType {
 public:
  SensorTypeOf(Describe describe, Make make, Complete complete)
      : describe_(std::move(describe)), make_(std::move(make)), complete_(std::move(complete)) {}
  Result<std::shared_ptr<const Description>> describe(const void* own) const override { return describe_(of(own)); }
  void complete(PartPlan& plan, const void* own) const override { complete_(plan, of(own)); }
  std::optional<ReadTime> time_of_reading([[maybe_unused]] const void* own) const override {
    if constexpr (requires(const C& config) { ReadTime{read_time(config)}; })
      return read_time(of(own));
    else
      return std::nullopt;
  }
  Sampling sampling(const void* own) const override { return sampling_of(of(own)); }
  PartObject make(Loop& loop, const void* common, const void* own, const Parts& parts) const override {
    return PartObject::made_by<AnySensor>(
        [&] { return call_factory(make_, parts, loop, *static_cast<const Common*>(common), of(own)); });
  }

 private:
  static const C& of(const void* own) { return *static_cast<const C*>(own); }
  Describe describe_;
  Make make_;
  Complete complete_;
};

template <class C, class Path, class Make>
class SinkTypeOf final : public SinkType {
 public:
  SinkTypeOf(Path path, Make make) : path_(std::move(path)), make_(std::move(make)) {}
  SinkConfig& common(void* own) const override { return static_cast<C*>(own)->sink; }
  std::string path(const void* own) const override { return path_(of(own)); }
  void complete(StoredTopics& stores, std::shared_ptr<const void> own) const override {
    const auto shared = std::static_pointer_cast<const C>(std::move(own));
    const C& config = *shared;
    if constexpr (requires { batch_time(config); }) stores.batch_time = batch_time(config);
    if constexpr (requires { C::is_recording; }) stores.is_recording = C::is_recording;
    stores.is_sender = requires { config.sending; };
    if constexpr (requires { C::is_sender; }) stores.is_sender = C::is_sender;
    if constexpr (requires(std::span<const TopicToRecord> topics) { refused_topics(config, topics); }) {
      stores.refused_topics = [shared](std::span<const TopicToRecord> topics) {
        return refused_topics(*shared, topics);
      };
    }
    if constexpr (requires(std::string_view topic) { file_of_topic(config, topic); })
      stores.file_of_topic = [shared](std::string_view topic) { return file_of_topic(*shared, topic); };
    if constexpr (requires(const std::string& file) { is_companion_file(config, file, file); })
      stores.is_companion_file = [shared](const std::string& file, const std::string& other) {
        return is_companion_file(*shared, file, other);
      };
    if constexpr (requires(const std::string& file) { check_openable(config, file); })
      stores.check_openable = [shared](const std::string& file) { return check_openable(*shared, file); };
  }
  PartObject make(Loop& loop, const void* own, const Parts& parts) const override {
    return PartObject::made_by<Sink>([&] { return call_factory(make_, parts, loop, of(own)); });
  }

 private:
  static const C& of(const void* own) { return *static_cast<const C*>(own); }
  Path path_;
  Make make_;
};

template <class C, class Make, class Complete>
class OutputTypeOf final : public OutputType {
 public:
  OutputTypeOf(Make make, Complete complete) : make_(std::move(make)), complete_(std::move(complete)) {}
  void complete(PartPlan& plan, const void* own) const override { complete_(plan, *static_cast<const C*>(own)); }
  std::unique_ptr<Actuator> make(const void* own) const override { return make_(*static_cast<const C*>(own)); }

 private:
  Make make_;
  Complete complete_;
};

/// The parameter that names the bus of a driver, which may be of several types.
template <class BusOf>
constexpr auto names_bus() {
  if constexpr (requires { BusOf::type; }) {  // an I2cBus has that, and the types of its base
    return names_part("bus", BusOf::type);
  } else {
    return std::apply([](auto... types) { return names_part("bus", types...); }, BusOf::types);
  }
}
/// Reports a driver's error about its settings at their place in the file.
void report_misfit(const Result<void>& good, const ConfigItem& item, Problems& problems);
/// The bus as the class that the driver uses: its own class, or a base.
template <class BusOf>
BusOf& bus_named(const Parts& parts, const std::string& name) {
  if constexpr (std::is_base_of_v<Bus, BusOf>) {
    if (Bus* bus = parts.find<Bus>("bus", name)) {
      if (auto* wanted = dynamic_cast<BusOf*>(bus)) return *wanted;
    }
  }
  return parts.get<BusOf>("bus", name);
}

}  // namespace config_detail

/// The settings of a sensor with a driver: the place of its chip, and the driver's own settings.
template <Driver D>
struct DriverConfig {
  using OfDriver = D;
  std::string bus = {};
  typename D::Device::Place place = default_place<D>();
  typename D::Config own = {};
  friend constexpr auto parameters(type_tag<DriverConfig>) {
    return parameter_list(parameter("bus", &DriverConfig::bus, "the bus that it is on", required,
                                    config_detail::names_bus<typename D::Device::Bus>()),
                          include_member(&DriverConfig::place), include_member(&DriverConfig::own));
  }
  friend void check_config(const DriverConfig& config, const ConfigItem& item, Problems& problems) {
    if constexpr (requires { check_config(config.own, item, problems); }) check_config(config.own, item, problems);
    if constexpr (requires { check_config(config.place, item, problems); }) check_config(config.place, item, problems);
    config_detail::report_misfit(check_driver<D>(config.own), item, problems);
    config_detail::report_misfit(check_place<D>(config.own, config.place), item, problems);
  }
};

/// A factory of T, which is constructed from the loop and the settings.
template <class T>
inline constexpr auto makes = [
]<class... Arguments>(Arguments&... arguments) -> T requires std::is_constructible_v<T, Arguments&...> {
  return T(arguments...);
};

/// For a type without parameters of its own.
struct NoParameters {
  friend constexpr auto parameters(type_tag<NoParameters>) { return parameter_list(); }
};

class Registry {
 public:
  Registry();

  /// `doc`: a phrase in lower case. `describe(const C&)` returns the description of the events, or a Result with it. It
  /// returns null if the description is known only after the sensor is made. `make(Loop&, const SensorConfig& or const
  /// FeedConfig&, const C&)` makes the sensor.
  template <Configurable C, class Describe, class Make>
  void add_sensor(const std::string& type, std::string doc, Describe describe, Make make) {
    add_sensor<C>(type, std::move(doc), std::move(describe), std::move(make), [](PartPlan&, const C&) {});
  }
  /// `complete(PartPlan&, const C&)`: fills in more of the plan. `page`: the documentation for `rtdata types`.
  template <Configurable C, class Describe, class Make, class Complete>
  void add_sensor(const std::string& type, std::string doc, Describe describe, Make make, Complete complete,
                  TypePage page = {}) {
    constexpr bool is_scheduled = config_detail::makes_sensor_of<Make, SensorConfig, C>;
    static_assert(is_scheduled || config_detail::makes_sensor_of<Make, FeedConfig, C>,
                  "rtdata: a sensor type is made by (Loop&, const SensorConfig&, const Config&) or, without a "
                  "schedule, by (Loop&, const FeedConfig&, const Config&); const Parts& may follow");
    using Common = std::conditional_t<is_scheduled, SensorConfig, FeedConfig>;
    using Type = config_detail::SensorTypeOf<Common, C, Describe, Make, Complete>;
    add_sensor_type(
        is_scheduled, type, std::move(doc), &config_detail::table_of<C>,
        std::unique_ptr<config_detail::SensorType>(new Type(std::move(describe), std::move(make), std::move(complete))),
        std::move(page));
  }

  /// A driver (driver.hpp) that has its own type name and description.
  template <Driver D>
  requires requires { std::string(D::type), std::string(D::description); }
  void add_driver() { add_driver<D>(std::string(D::type), std::string(D::description)); }
  /// A driver. Its parameters are those of all sensors, `bus`, the place on the bus, and those of D::Config. A driver
  /// may declare `static constexpr std::string_view notes`: Markdown about wiring, addresses and limits, for `rtdata
  /// types`; and `static constexpr std::string_view aliases`: further search words (its description and models are
  /// search words already). `chips` and `samples` describe its chips for `rtdata scan` and tests (chip.hpp). Three
  /// functions let `check` warn of settings that lose data and estimate the growth of files: `static double
  /// sample_rate(const Config&)`, samples a second that the device takes by itself; `static std::size_t
  /// fifo_samples(const Config&)`, how many samples its FIFO holds; `static Duration reading_time(const Config&)`, the
  /// minimum duration of a reading.
  template <Driver D>
  void add_driver(const std::string& type, std::string doc) {
    using C = DriverConfig<D>;
    using BusOf = typename D::Device::Bus;
    TypePage page;
    if constexpr (requires { BusOf::type; }) {
      page.bus = std::string(BusOf::type);
    } else {
      page.bus = std::string(BusOf::types[0]);
      page.other_buses.assign(BusOf::types.begin() + 1, BusOf::types.end());
    }
    if constexpr (requires { std::string(D::notes); }) page.notes = config_detail::trimmed_notes(D::notes);
    if constexpr (requires { std::string(D::aliases); }) page.aliases = std::string(D::aliases);
    if constexpr (requires { D::chips; }) page.chips = D::chips;
    if constexpr (requires { D::samples; }) page.samples = D::samples;
    if constexpr (requires(const typename D::Config& own) { D::describe(own); }) {
      page.depends_on_parameters = true;
      page.publishes = []() -> std::shared_ptr<const Description> {
        const auto described = D::describe(typename D::Config{});
        return described ? *described : nullptr;
      };
    } else {
      page.publishes = []() -> std::shared_ptr<const Description> { return description_of<typename D::Value>(); };
    }
    add_sensor<C>(
        type, std::move(doc), [](const C& config) { return driver_description<D>(config.own); },
        [](Loop& loop, const SensorConfig& common, const C& config, const Parts& parts) {
          return DriverSensor<D>(loop, common, config_detail::bus_named<BusOf>(parts, config.bus), config.place,
                                 config.own);
        },
        [](PartPlan& plan, const C& config) {
          plan.place.bus = config.bus;
          plan.place.text = BusOf::text_of(config.place);
          if constexpr (requires { BusOf::type_of(config.place); }) {
            plan.place.bus_type = BusOf::type_of(config.place);
            plan.place.advice_on_other = BusOf::advice_on_other(config.place);
          }
          plan.holds_bus = bus_time_of<D>(config.own);
        },
        std::move(page));
  }

  /// A type of sinks. C has a member `sink`, a SinkConfig whose parameters are included (`include_member(&C::sink)`).
  /// `path(const C&)`: the file that the sink writes, so that `check` finds two sinks on one file; "-" for standard
  /// output, "" for none. `make(Loop&, const C&)` makes it. Optional functions next to the Config:
  /// `refused_topics(const C&, std::span<const TopicToRecord>)` returns the topics that the sink cannot store; such a
  /// configuration is refused before anything is made. `file_of_topic(const C&, std::string_view)` returns the file of
  /// a topic, if it is not `path`. `is_companion_file(const C&, const std::string& file, const std::string& other)`
  /// tells whether `other` belongs to `file`, such as a log or a lock, so that no other sink may use it.
  /// `check_openable(const C&, const std::string& file)` tells whether a file can be opened and locked now; otherwise a
  /// reload that would open it is refused. `batch_time(const C&)` returns the time after which the sink stores, if
  /// SinkConfig does not. A C with a member `sending` (sender.hpp) or a static `is_sender` sends to a peer across a
  /// network.
  template <Configurable C, class Path, class Make>
  void add_sink(const std::string& type, std::string doc, Path path, Make make) {
    static_assert(
        requires(const C& config) { static_cast<const SinkConfig&>(config.sink); },
        "rtdata: the Config of a sink type has a member `sink`, a SinkConfig");
    using Type = config_detail::SinkTypeOf<C, Path, Make>;
    add_sink_type(type, std::move(doc), &config_detail::table_of<C>,
                  std::unique_ptr<config_detail::SinkType>(new Type(std::move(path), std::move(make))));
  }

  /// A type of buses. `make(Runtime&, const std::string& name, const C&)` returns the bus, of any class; sensors get it
  /// with `parts.get<ThatClass>("bus", name)`. A function `Duration give_up_after(const C&)` next to the Config returns
  /// the limit of a job on the bus: `check` then refuses sensors that hold it for longer (driver.hpp). The bus belongs
  /// to the runtime: sensors of all loops may use it, from the threads of all loops and lanes at once. It is made
  /// before the sensors and destroyed after them. A reading that hung may outlive the bus on its abandoned thread: what
  /// it uses must be shared (a shared_ptr in both).
  template <Configurable C, class Make>
  void add_bus(const std::string& type, std::string doc, Make make) {
    add_part<C>("bus", type, std::move(doc), [make](PartPlan& plan, const C& config) {
      if constexpr (requires { std::string(config.device); }) plan.place = {"", config.device, ""};
      if constexpr (requires { Duration{give_up_after(config)}; }) plan.give_up_after = give_up_after(config);
      plan.make = [make, config, name = plan.name](Loop& loop, const Parts& parts) {
        using Made = decltype(config_detail::call_factory(make, parts, loop.runtime(), name, config));
        using Base = std::conditional_t<std::is_base_of_v<Bus, Made>, Bus, Made>;
        return PartObject::made_by<Base>(
            [&] { return config_detail::call_factory(make, parts, loop.runtime(), name, config); });
      };
    });
  }

  /// A type of outputs. `make(const C&)` returns its device, a unique_ptr of an Actuator; it runs in the guard process
  /// if there is one, so it cannot use other parts. `complete(PartPlan&, const C&)` adds the places that the output
  /// takes.
  template <Configurable C, class Make>
  void add_output(const std::string& type, std::string doc, Make make) {
    add_output<C>(type, std::move(doc), std::move(make), [](PartPlan&, const C&) {});
  }
  template <Configurable C, class Make, class Complete>
  void add_output(const std::string& type, std::string doc, Make make, Complete complete, TypePage page = {}) {
    using Type = config_detail::OutputTypeOf<C, Make, Complete>;
    add_output_type(type, std::move(doc), &config_detail::table_of<C>,
                    std::unique_ptr<config_detail::OutputType>(new Type(std::move(make), std::move(complete))),
                    std::move(page));
  }
  /// For the guard (outputs/guard.hpp): the device of an output of a configuration. Throws ConfigError, and what `make`
  /// throws.
  std::unique_ptr<Actuator> make_actuator(const std::string& guarded) const;

  /// Adds a kind of parts, made after the existing kinds. `key`: its key in the file. `doc`: a phrase.
  void add_kind(std::string name, std::string key, std::string doc, PartKind::Written written,
                PartKind::Does does = PartKind::Does::nothing_known);
  /// Adds a type of any kind. `plan(PartPlan&, const C&)` gets a plan with kind, type, item and, for kinds written by
  /// name, the name; it fills in the rest; `make` is required.
  template <Configurable C>
  void add_part(std::string_view kind, const std::string& type, std::string doc,
                std::function<void(PartPlan&, const C&)> plan) {
    add_type(kind, type, std::move(doc), {&config_detail::table_of<C>},
             [plan = std::move(plan)](PartPlan& part, const ConfigObjects& configs) {
               plan(part, *static_cast<const C*>(configs[0].get()));
             });
  }

  /// A type that this program lacks (TypeRegistryBase::leave_out).
  void leave_out(std::string_view kind, std::string type, std::string why) {
    kind_named(kind).types.leave_out(std::move(type), std::move(why));
  }

  const TypeRegistryBase& sensors() const { return types("sensor"); }
  const TypeRegistryBase& sinks() const { return types("sink"); }
  const TypeRegistryBase& buses() const { return types("bus"); }
  const TypeRegistryBase& outputs() const { return types("output"); }
  /// In the order in which the parts are made.
  const std::vector<PartKind>& kinds() const noexcept { return kinds_; }
  /// The order for listings: sensors, sinks, then the others.
  std::vector<const PartKind*> kinds_to_show() const;
  /// The JSON Schema (draft-07) of a whole configuration file.
  std::string schema() const;

 private:
  const TypeRegistryBase& types(std::string_view kind) const;
  /// SetupError (not-found).
  PartKind& kind_named(std::string_view name);
  using PlanOf = std::function<void(PartPlan&, const ConfigObjects&)>;
  void add_type(std::string_view kind, const std::string& type, std::string doc,
                std::vector<config_detail::TableOf> configs, PlanOf plan, TypePage page = {});
  void add_sensor_type(bool is_scheduled, const std::string& type, std::string doc, config_detail::TableOf own,
                       std::shared_ptr<const config_detail::SensorType> made, TypePage page);
  void add_sink_type(const std::string& type, std::string doc, config_detail::TableOf own,
                     std::shared_ptr<const config_detail::SinkType> made);
  void add_output_type(const std::string& type, std::string doc, config_detail::TableOf own,
                       std::shared_ptr<const config_detail::OutputType> made, TypePage page);

  std::vector<PartKind> kinds_;
  TypeRegistry<std::unique_ptr<Actuator>> actuators_{"output"};  // the devices of its outputs alone
};

}  // namespace rtdata
