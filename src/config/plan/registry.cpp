#include "rtdata/config/registry.hpp"

#include <algorithm>

#include "config/plan/misfit.hpp"
#include "data/setting_mistake.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata {
namespace {

/// After a reload a disarmed output stays disarmed, and an output armed by command is not changed. `made`: makes it.
void keep_arming(PartPlan& plan, const OutputConfig& config, std::function<PartPlan::Make(Arming armed)> made) {
  plan.make_again = [made = std::move(made)](const PartObject& before) -> PartPlan::Make {
    const auto* const output = before.as<Output>();
    return output != nullptr && !output->is_armed() ? made(Arming::by_command) : PartPlan::Make{};
  };
  if (config.armed != Arming::by_command) return;
  plan.hold = {"it is armed", "disarm it first", [](const PartObject& part) {
                 const auto* const output = part.as<Output>();
                 return output != nullptr && output->is_armed();
               }};
}

/// A reload changes the settings of a controller while its output runs, also settings changed by a command.
void change_controller_live(PartPlan& plan, const OutputConfig& config) {
  if (!config.pid) return;
  const auto change = [pid = *config.pid](const PartObject& part) { part.as<Output>()->change_pid(pid).or_throw(); };
  plan.live["pid"] = change;
  plan.as_written = [change](const PartObject& part) {
    if (part.as<Output>()->is_setpoint_commanded()) change(part);
  };
}

/// A change of the configuration does not hold the loop while a device is opened or released.
void let_the_loop_turn(PartPlan& plan) {
  plan.when_made = [](const PartObject& part, std::function<void(Result<void>)> done) {
    part.as<Output>()->when_taken(std::move(done));
  };
  plan.ending = [](const PartObject& part, std::function<void()> done) { part.as<Output>()->finish(std::move(done)); };
}

/// The published topic of a sensor; an empty topic means its name.
PublishedTopic published_topic(const std::string& name, const std::string& topic,
                               Result<std::shared_ptr<const Description>> description, const Processing& processing) {
  std::shared_ptr<const Description> published = std::move(description).or_throw();
  try {
    if (published != nullptr && !processing.empty()) published = processed(published, processing, name);
  } catch (const ProcessingError& error) {
    throw config_detail::MisfitError(error);
  }
  return {topic.empty() ? name : topic, std::move(published), std::nullopt, {}};
}

/// The name of a sink: as it is given, or its path, or its type.
std::string sink_name(const std::string& type, const std::string& path, const SinkConfig& config) {
  if (!config.name.empty()) return config.name;
  return path.empty() || path == "-" ? type : path;
}

std::optional<SensorLoad> load_of(const SensorConfig& common, std::optional<ReadTime> time) {
  SensorLoad load{common.name, common.rate.period(), {}, time.value_or(ReadTime{})};
  if (common.start) load.phase = common.phase;
  if (common.read_time) (load.time.lane.empty() ? load.time.on_loop : load.time.on_lane) = common.read_time;
  return load;
}
std::optional<SensorLoad> load_of(const FeedConfig& common, std::optional<ReadTime> time) {
  if (!time) return std::nullopt;
  return SensorLoad{common.name, Duration{0}, {}, *time};
}

template <class T>
const T& config_at(const ConfigObjects& configs, std::size_t place) {
  return *static_cast<const T*>(configs[place].get());
}

/// The parameters of the type, after those common to all sensors, on one level.
template <class Common>
void plan_sensor(PartPlan& plan, const ConfigObjects& configs,
                 const std::shared_ptr<const config_detail::SensorType>& made) {
  const auto& common = config_at<Common>(configs, 0);
  const void* const own = configs[2].get();
  made->complete(plan, own);
  plan.name = common.name;
  plan.publishes = published_topic(plan.name, common.topic, made->describe(own), common.process);
  plan.publishes->load = load_of(common, made->time_of_reading(own));
  plan.publishes->sampling = made->sampling(own);
  plan.live["process"] = [process = common.process](const PartObject& part) {
    part.as<AnySensor>()->set_processing(process);
  };
  if constexpr (std::is_same_v<Common, SensorConfig>)
    plan.live["rate"] = [rate = common.rate](const PartObject& part) { part.as<AnySensor>()->set_rate(rate); };
  plan.make = [made, configs](Loop& loop, const Parts& parts) {
    return made->make(loop, configs[0].get(), configs[2].get(), parts);
  };
}

}  // namespace

std::string config_detail::trimmed_notes(std::string_view notes) {
  const std::size_t first = notes.find_first_not_of("\n");
  if (first == std::string_view::npos) return {};
  return std::string(notes.substr(first, notes.find_last_not_of(" \n") + 1 - first));
}

void config_detail::report_misfit(const Result<void>& good, const ConfigItem& item, Problems& problems) {
  if (good) return;
  const Error& error = good.error();
  detail::add_mistake({error.where, error.why, error.advice}, item, problems);
}

Registry::Registry() {
  add_kind("bus", "buses", "connections of sensors to devices, by name; each has a `type`", PartKind::Written::by_name);
  add_kind("sink", "sinks", "where the events go; each has a `type`", PartKind::Written::list, PartKind::Does::stores);
  add_kind("sensor", "sensors", "the sensors; each has a `type`", PartKind::Written::list, PartKind::Does::publishes);
  kinds_.back().common = parameters_of<config_detail::Placement>();
  add_kind("machine", "machines", "state machines", PartKind::Written::list, PartKind::Does::publishes);
  kinds_.back().common = parameters_of<config_detail::Placement>();
  kinds_.back().types.set_default("machine");
  add_kind("output", "outputs", "the outputs; each has a `type`", PartKind::Written::list, PartKind::Does::publishes);
  kinds_.back().common = parameters_of<config_detail::Placement>();
}

std::unique_ptr<Actuator> Registry::make_actuator(const std::string& guarded) const {
  return actuators_.create(parse_config(guarded, "output.json").root);
}

std::vector<const PartKind*> Registry::kinds_to_show() const {
  std::vector<const PartKind*> all;
  for (const PartKind& kind : kinds_) all.push_back(&kind);
  const auto rank = [](const PartKind* kind) { return kind->name == "sensor" ? 0 : kind->name == "sink" ? 1 : 2; };
  std::stable_sort(all.begin(), all.end(), [&](auto* a, auto* b) { return rank(a) < rank(b); });
  return all;
}

void Registry::add_kind(std::string name, std::string key, std::string doc, PartKind::Written written,
                        PartKind::Does does) {
  const auto refuse = [&](const std::string& why) {
    throw SetupError(
        {Errc::bad_argument, "cannot add a kind of parts", "\"" + name + "\"", why, "give it another name and key"});
  };
  if (name == "tier" || name == "topic") refuse("tiers and topics are named by it");
  for (const ParameterInfo& setting : parameters_of<SystemSettings>())
    if (setting.key == key) refuse("`" + key + "` is a setting of the file");
  for (const PartKind& known : kinds_)
    if (known.name == name || known.key == key) refuse("there is one of that name or key already");
  TypeRegistry<PartPlan, const std::string&> types(name);
  kinds_.push_back({std::move(name), std::move(key), std::move(doc), written, std::move(types), does, {}});
}

void Registry::add_type(std::string_view kind, const std::string& type, std::string doc,
                        std::vector<config_detail::TableOf> configs, PlanOf plan, TypePage page) {
  const auto make_plan = [kind = std::string(kind), type, plan = std::move(plan)](const std::string& name,
                                                                                  const ConfigObjects& made_of) {
    PartPlan made;
    made.kind = kind;
    made.type = type;
    made.name = name;
    plan(made, made_of);
    return made;
  };
  kind_named(kind).types.add(type, std::move(doc), std::move(configs), make_plan, std::move(page));
}

void Registry::add_sensor_type(bool is_scheduled, const std::string& type, std::string doc, config_detail::TableOf own,
                               std::shared_ptr<const config_detail::SensorType> made, TypePage page) {
  using config_detail::table_of;
  add_type(
      "sensor", type, std::move(doc),
      {is_scheduled ? &table_of<SensorConfig> : &table_of<FeedConfig>, &table_of<config_detail::Placement>, own},
      [is_scheduled, made](PartPlan& plan, const ConfigObjects& configs) {
        if (is_scheduled)
          plan_sensor<SensorConfig>(plan, configs, made);
        else
          plan_sensor<FeedConfig>(plan, configs, made);
      },
      std::move(page));
}

void Registry::add_sink_type(const std::string& type, std::string doc, config_detail::TableOf own,
                             std::shared_ptr<const config_detail::SinkType> made) {
  add_type("sink", type, std::move(doc), {own}, [made](PartPlan& plan, const ConfigObjects& configs) {
    SinkConfig& common = made->common(configs[0].get());
    StoredTopics& stores = plan.stores.emplace();
    stores.path = made->path(configs[0].get());
    common.name = plan.name = sink_name(plan.type, stores.path, common);
    stores.topics = common.topics;
    stores.close_deadline = common.close_deadline;
    stores.through = common.through;
    stores.batch_time = common.batch_time;
    stores.queue_bytes = common.queue_bytes;
    made->complete(stores, configs[0]);
    plan.make = [made, own = configs[0]](Loop& loop, const Parts& parts) { return made->make(loop, own.get(), parts); };
  });
}

void Registry::add_output_type(const std::string& type, std::string doc, config_detail::TableOf own,
                               std::shared_ptr<const config_detail::OutputType> made, TypePage page) {
  const auto plan_output = [made, type, own](PartPlan& plan, const ConfigObjects& configs) {
    const auto& common = config_at<OutputConfig>(configs, 0);
    made->complete(plan, configs[2].get());
    plan.name = common.name;
    plan.publishes = published_topic(plan.name, common.topic, Result(description_of<OutputChange>()), {});
    const std::function<std::unique_ptr<Actuator>()> make_actuator = [made, config = configs[2]] {
      return made->make(config.get());
    };
    const OutputRange range = range_of(make_actuator);
    plan.refusal = [range](double value) { return range.refusal(value); };
    plan.check_topics = [common, range](const PartPlan& part, const PartPlan::PayloadOf& payload_of,
                                        Problems& problems) {
      check_output_values(common, range, part.item, problems);
      check_output_names(common, payload_of, part.item, problems);
    };
    ConfigItem guarded;
    config_detail::write_object(own(), configs[2].get(), guarded);
    guarded.set("type", type);
    const auto make_armed = [make_actuator, common, guarded = guarded.to_json()](Arming armed) -> PartPlan::Make {
      return [make_actuator, common, guarded, armed](Loop& loop, const Parts& parts) {
        OutputConfig config = common;
        config.armed = armed;
        return PartObject::made_by<Output>(
            [&] { return Output(loop, std::move(config), make_actuator, guarded, parts.takes()); });
      };
    };
    plan.make = make_armed(common.armed);
    keep_arming(plan, common, make_armed);
    change_controller_live(plan, common);
    let_the_loop_turn(plan);
  };
  using config_detail::table_of;
  add_type("output", type, std::move(doc), {&table_of<OutputConfig>, &table_of<config_detail::Placement>, own},
           plan_output, std::move(page));
  actuators_.add(type, {}, {own}, [made](const ConfigObjects& configs) { return made->make(configs[0].get()); });
}

PartKind& Registry::kind_named(std::string_view name) {
  const auto found = std::find_if(kinds_.begin(), kinds_.end(),
                                  [&](const PartKind& known) { return known.name == name; });
  if (found != kinds_.end()) return *found;
  throw SetupError({Errc::not_found, "no such kind of parts", "\"" + std::string(name) + "\"", "", "add_kind first"});
}

const TypeRegistryBase& Registry::types(std::string_view kind) const {
  return std::find_if(kinds_.begin(), kinds_.end(), [&](const PartKind& known) { return known.name == kind; })->types;
}

}  // namespace rtdata
