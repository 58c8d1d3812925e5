#include "config/plan.hpp"

#include <algorithm>
#include <filesystem>
#include <map>
#include <utility>

#include "config/warnings.hpp"
#include "config/written_file.hpp"
#include "loop/name.hpp"
#include "rtdata/config/secret.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata {
namespace {

/// Keys of the design that this version does not know yet: said so, instead of "unknown key".
constexpr std::string_view later_sensor_keys[] = {"bus"};
constexpr std::string_view later_document_keys[] = {"buses"};

void refuse_later_key(ConfigItem& item, std::string_view key, Problems& problems) {
  for (const ConfigChild& child : item.children()) {
    if (child.key != key) continue;
    Problem problem = child.item.problem("not-available",
                                         "\"" + std::string(key) + "\" is not available in this version");
    problem.place = child.item.key_place();
    problems.add(std::move(problem));
    break;
  }
  if (item.is_object()) item.remove(key);
}

/// The child of an item that a problem is best shown at: that of the key, or the item itself.
const ConfigItem& child_or_self(const ConfigItem& item, std::string_view key) {
  for (const ConfigChild& child : item.children())
    if (child.key == key) return child.item;
  return item;
}

template <class Plan>
bool plan_item(const TypeRegistry<Plan>& types, const ConfigItem& item, Plan& plan, Problems& problems) {
  try {
    plan = types.create(item);
  } catch (const ConfigError& error) {
    problems.append(error.problems());
    return false;
  } catch (const SetupError& error) {  // it cannot say what it will publish
    const Error& e = error.error();
    Error rest{e.code, e.what, "", e.why, e.advice};
    problems.add(item.problem("bad-value", rest.text()));
    return false;
  }
  plan.item = item;
  return true;
}

std::string place_of(const ConfigItem& item) {
  const std::string place = item.place().text();
  return place.empty() ? item.path() : place;
}

std::string topic_advice(std::string_view topic) {
  return "\"" + std::string(topic) +
         "\" is no topic name: letters, digits, _ . - in levels joined by /, such as \"room/climate\"";
}

bool check_topic(const SensorPlan& plan, Problems& problems) {
  // A topic that is written was checked when it was read.
  std::string mistake;
  if (!is_topic_name(plan.topic)) mistake = topic_advice(plan.topic) + "; give the sensor a `topic`, or another name";
  if (plan.topic.starts_with("$"))
    mistake = "topics that begin with $ are the library's own; give the sensor a `topic`";
  if (!mistake.empty()) problems.add(child_or_self(plan.item, "name").problem("bad-name", mistake));
  return mistake.empty();
}

void check_tier_names(const ConfigItem& tiers, const std::string& main, Problems& problems) {
  if (!tiers.is_object()) return;
  for (const ConfigChild& tier : tiers.children()) {
    if (detail::is_name(tier.key) && tier.key != main) continue;
    Problem problem = tier.item.problem(
        "bad-name", tier.key == main ? "the main loop has that name; give the tier another" : detail::name_rule);
    problem.place = tier.item.key_place();
    problems.add(std::move(problem));
  }
}

/// What items of this one's type can be configured with; nothing when there is no such type.
std::vector<ParameterInfo> parameters_in(const TypeRegistryBase& types, const ConfigItem& item) {
  const std::string* name = child_or_self(item, "type").as_string();
  const std::optional<TypeInfo> type = name != nullptr ? types.find(*name) : std::nullopt;
  return type ? type->parameters : std::vector<ParameterInfo>();
}

std::string text_or_empty(const ConfigItem& item, std::string_view key) {
  const std::string* text = child_or_self(item, key).as_string();
  return text != nullptr ? *text : "";
}

/// What is known of an item with mistakes, to be compared with the others.
SensorPlan raw_sensor(const ConfigItem& item) {
  SensorPlan plan;
  plan.item = item;
  plan.name = text_or_empty(item, "name");
  plan.topic = text_or_empty(item, "topic");
  if (plan.topic.empty()) plan.topic = plan.name;
  plan.tier = text_or_empty(item, "tier");
  return plan;
}

SinkPlan raw_sink(const ConfigItem& item) {
  SinkPlan plan;
  plan.item = item;
  plan.name = text_or_empty(item, "name");
  plan.path = text_or_empty(item, "path");
  return plan;
}

std::string lower(std::string_view text) {
  std::string result(text);
  for (char& c : result)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c | 0x20);
  return result;
}

/// What must hold between the items of a document.
class AcrossItems {
 public:
  explicit AcrossItems(SystemPlan& plan) : plan_(plan) {}

  /// Items with mistakes of their own are among them, as far as they are known.
  void check(const std::vector<SensorPlan>& sensors, const std::vector<SinkPlan>& sinks) {
    for (const SensorPlan& sensor : sensors) {
      if (detail::is_name(sensor.name)) check_name("sensor", sensor.name, sensor.item, sensor_names_);
      check_topic(sensor);
      check_tier(sensor);
    }
    for (const SinkPlan& sink : sinks) {
      if (!sink.path.empty() && sink.path != "-") check_path(sink);
    }
    check_files_of_topics(sinks);
    for (const SinkPlan& sink : sinks) {
      if (!sink.name.empty()) check_name("sink", sink.name, sink.item, sink_names_);
    }
  }

  /// The log is a file of its own.
  void check_log(const ConfigItem& log) {
    const ConfigItem& file = child_or_self(log, "file");
    const std::string& path = plan_.settings.log.file;
    if (path.empty()) return;
    const LogSettings& settings = plan_.settings.log;
    const config_detail::WrittenFile written{path, "the log", [&](const std::string& full, const std::string& other) {
                                               return config_detail::is_rotated_log(settings, full, other);
                                             }};
    if (const std::string why = conflict_with_configuration(written); !why.empty()) {
      plan_.problems.add(file.problem("duplicate-path", why));
      return;
    }
    for (const SinkFile& known : files_) {
      const std::string why = conflict(written, known.file);
      if (why.empty()) continue;
      plan_.problems.add(file.problem("duplicate-path", why + " for the log"));
      return;
    }
  }

  /// Topics that a sink's patterns match and that it cannot take.
  void check_taken(const std::vector<SinkPlan>& sinks) {
    for (const SinkPlan& sink : sinks) {
      if (!sink.refused_topics) continue;
      std::vector<TopicToRecord> wanted;
      for (const auto& [name, sensor] : topics_) {
        if (wants(sink, name)) wanted.push_back({name, sensor->description.get()});
      }
      for (const Error& error : sink.refused_topics(wanted)) {
        plan_.problems.add(child_or_self(sink.item, "path").problem("cannot-record", error.text()));
      }
    }
  }

  void warn_of_patterns(const std::vector<SinkPlan>& sinks) {
    for (const SinkPlan& sink : sinks) {
      if (const ConfigItem* topics = sink.item.find("topics"); topics != nullptr && sink.topics.empty() && sink.make) {
        plan_.warnings.add(topics->problem("matches-nothing", "the list is empty: nothing goes to this sink"));
        continue;
      }
      const bool is_idle = std::none_of(sink.topics.begin(), sink.topics.end(), [&](const std::string& pattern) {
        return pattern.starts_with("$") || std::any_of(topics_.begin(), topics_.end(), [&](const auto& topic) {
                 return topic_matches(pattern, topic.first);
               });
      });
      const ConfigItem& list = child_or_self(sink.item, "topics");
      for (std::size_t i = 0; i < sink.topics.size(); ++i) {
        const std::string& pattern = sink.topics[i];
        const auto matches = [&](const auto& topic) { return topic_matches(pattern, topic.first); };
        if (pattern.starts_with("$") || std::any_of(topics_.begin(), topics_.end(), matches)) continue;
        const ConfigItem* element = list.is_array() ? list.find(i) : nullptr;
        std::vector<std::string> names;
        for (const auto& [name, sensor] : topics_) names.push_back(name);
        plan_.warnings.add((element != nullptr ? *element : list)
                               .problem("matches-nothing",
                                        "no sensor of this file publishes on \"" + pattern + "\"" +
                                            (is_idle ? ", and nothing goes to this sink" : ""),
                                        nearest_name(pattern, names)));
      }
    }
  }

  /// C and F are coulomb and farad, which no temperature has.
  void warn_of_units(const std::vector<SensorPlan>& sensors) {
    for (const SensorPlan& sensor : sensors) {
      if (sensor.description == nullptr) continue;
      for (const Leaf& leaf : sensor.description->leaves()) {
        const bool is_coulomb = leaf.unit == "C";
        const std::string names = lower(sensor.name + " " + sensor.topic + " " + leaf.path);
        if ((!is_coulomb && leaf.unit != "F") || names.find("temp") == std::string::npos) continue;
        const ConfigItem& fields = child_or_self(sensor.item, "fields");
        const ConfigItem& unit = child_or_self(sensor.item, "unit");
        plan_.warnings.add((fields.path() != sensor.item.path() ? fields : unit)
                               .problem("unlikely-unit", std::string("the unit ") + (is_coulomb ? "C of " : "F of ") +
                                                             leaf.path + " is the " +
                                                             (is_coulomb ? "coulomb" : "farad") + "; degrees are " +
                                                             (is_coulomb ? "Cel" : "[degF]")));
        break;
      }
    }
  }

  void warn_of_tiers(const std::vector<SensorPlan>& sensors, const ConfigItem& root) {
    for (const auto& entry : plan_.settings.tiers) {
      const std::string& name = entry.first;
      const auto is_here = [&](const SensorPlan& sensor) { return sensor.tier == name; };
      if (std::any_of(sensors.begin(), sensors.end(), is_here)) continue;
      plan_.warnings.add(child_or_self(child_or_self(root, "tiers"), name)
                             .problem("unused-tier", "no sensor runs on tier \"" + name + "\""));
    }
  }

 private:
  using Names = std::map<std::string, const ConfigItem*>;

  void check_tier(const SensorPlan& sensor) {
    if (sensor.tier.empty() || plan_.settings.tiers.contains(sensor.tier)) return;
    std::vector<std::string> names;
    for (const auto& [name, tier] : plan_.settings.tiers) names.push_back(name);
    plan_.problems.add(child_or_self(sensor.item, "tier")
                           .problem("unknown-tier",
                                    "there is no tier " + ConfigItem::of(sensor.tier).to_json() + " in `tiers`",
                                    nearest_name(sensor.tier, names)));
  }

  void check_name(const char* what, const std::string& name, const ConfigItem& item, Names& names) {
    const auto [known, is_new] = names.try_emplace(name, &item);
    if (is_new) return;
    const ConfigItem& named = child_or_self(item, "name");
    const ConfigItem& first = child_or_self(*known->second, "name");
    if (named.path() == item.path() && first.path() == known->second->path() && refused_paths_.contains(item.path()))
      return;
    plan_.problems.add(named.problem("duplicate-name", std::string("there is a ") + what + " \"" + name +
                                                           "\" already, at " + place_of(first) +
                                                           "; give each a `name` of its own"));
  }

  void check_topic(const SensorPlan& sensor) {
    if (!is_topic_name(sensor.topic)) return;
    const auto [other_case, is_new_case] = topic_by_lower_case_.try_emplace(lower(sensor.topic), &sensor);
    if (!is_new_case && other_case->second->topic != sensor.topic) {
      plan_.problems.add(topic_item(sensor).problem(
          "bad-name", "the topic \"" + sensor.topic + "\" differs in case only from \"" + other_case->second->topic +
                          "\", at " + place_of(topic_item(*other_case->second))));
      return;
    }
    const auto [known, is_new] = topics_.try_emplace(sensor.topic, &sensor);
    if (!is_new && known->second->description == nullptr) known->second = &sensor;
    if (is_new || known->second == &sensor || sensor.description == nullptr) return;
    const SensorPlan& first = *known->second;
    if (first.description->same_meaning(*sensor.description)) return;
    std::string message = "the topic \"" + sensor.topic + "\" carries \"" + first.description->name() +
                          "\" of sensor " + first.name + ", at " + place_of(topic_item(first)) + ", and \"" +
                          sensor.description->name() + "\" of this one";
    for (const std::string& difference : first.description->differences(*sensor.description))
      message += "; " + difference;
    message += "; give one of them a topic of its own";
    plan_.problems.add(topic_item(sensor).problem("description-differs", std::move(message)));
  }

  struct SinkFile {
    config_detail::WrittenFile file;
    const SinkPlan* sink;
  };

  static SinkFile file_of(const SinkPlan& sink, const std::string& path) {
    return {{path, "the sink at " + place_of(sink.item), sink.is_beside}, &sink};
  }

  /// Why it cannot be written; empty: it can.
  std::string conflict_with_configuration(const config_detail::WrittenFile& written) const {
    if (plan_.document.file.empty()) return "";
    const config_detail::FileIdentity configuration(plan_.document.file);
    if (written.identity.is_same(configuration)) return "this is the configuration; choose another file";
    if (configuration.is_beside(written.identity, written.is_beside))
      return "the configuration would be taken for a file beside \"" + written.path + "\"; choose another file";
    return "";
  }

  /// The same with all that are known. A sink has several topics in one file, but none in one beside another.
  std::string conflict_with_files(const SinkFile& written) const {
    if (std::string why = conflict_with_configuration(written.file); !why.empty()) return why;
    for (const SinkFile& known : files_) {
      if (known.sink == written.sink && known.file.path == written.file.path) continue;
      if (std::string why = conflict(written.file, known.file); !why.empty()) return why;
    }
    return "";
  }

  static bool wants(const SinkPlan& sink, std::string_view topic) {
    return std::any_of(sink.topics.begin(), sink.topics.end(),
                       [&](const std::string& pattern) { return topic_matches(pattern, topic); });
  }

  /// Where a sink writes a file for each topic: none of them is another sink's.
  void check_files_of_topics(const std::vector<SinkPlan>& sinks) {
    for (const SinkPlan& sink : sinks) {
      if (!sink.file_of_topic || refused_paths_.contains(sink.item.path())) continue;
      for (const auto& [topic, sensor] : topics_) {
        const std::string file = wants(sink, topic) ? sink.file_of_topic(topic) : "";
        if (file.empty() || file == sink.path) continue;
        SinkFile written = file_of(sink, file);
        if (const std::string why = conflict_with_files(written); !why.empty()) {
          plan_.problems.add(
              child_or_self(sink.item, "path")
                  .problem("duplicate-path", "the events of topic \"" + topic + "\" go to \"" + file + "\": " + why));
        } else {
          files_.push_back(std::move(written));
        }
      }
    }
  }

  void check_path(const SinkPlan& sink) {
    SinkFile written = file_of(sink, sink.path);
    if (const std::string why = conflict_with_files(written); !why.empty()) {
      refused_paths_.try_emplace(sink.item.path(), &sink.item);
      plan_.problems.add(child_or_self(sink.item, "path").problem("duplicate-path", why));
    } else {
      files_.push_back(std::move(written));
    }
  }

  /// Where a sensor's topic is said: its `topic`, or else its `name`.
  static const ConfigItem& topic_item(const SensorPlan& sensor) {
    const ConfigItem& topic = child_or_self(sensor.item, "topic");
    return topic.path() == sensor.item.path() ? child_or_self(sensor.item, "name") : topic;
  }

  SystemPlan& plan_;
  Names sensor_names_;
  Names sink_names_;
  Names refused_paths_;
  std::map<std::string, const SensorPlan*> topics_;
  std::map<std::string, const SensorPlan*> topic_by_lower_case_;
  std::vector<SinkFile> files_;
};

std::vector<SensorLoad> loads_on(const std::string& tier, const std::vector<SensorPlan>& sensors) {
  std::vector<SensorLoad> loads;
  for (const SensorPlan& sensor : sensors) {
    if (sensor.tier == tier && sensor.load) loads.push_back(*sensor.load);
  }
  return loads;
}

/// The sensor that takes the largest part, as `part` says it of a load.
template <class Part>
const SensorPlan& largest(const std::string& tier, const std::vector<SensorPlan>& sensors, const Part& part) {
  const SensorPlan* found = nullptr;
  for (const SensorPlan& sensor : sensors) {
    if (sensor.tier != tier || !sensor.load) continue;
    if (found == nullptr || part(*sensor.load) > part(*found->load)) found = &sensor;
  }
  return *found;
}

void warn_of_load(const std::string& tier, const std::string& name, const std::vector<SensorPlan>& sensors,
                  Problems& warnings) {
  const LoopLoad load = estimate_load(name, loads_on(tier, sensors));
  const std::string where = tier.empty() ? "the main loop" : "tier \"" + tier + "\"";
  if (load.is_overloaded()) {
    const auto held = [](const SensorLoad& sensor) { return sensor.time.on_loop.value_or(Duration{0}); };
    const ConfigItem& longest = child_or_self(largest(tier, sensors, held).item, "rate");
    if (load.is_too_busy()) {
      warnings.add(longest.problem("overloaded-loop",
                                   "the readings of " + where + " take too much of its time (" + load.text() +
                                       "), this one most; lower the rates, or move sensors to another tier or lane"));
    } else {
      warnings.add(longest.problem(
          "late-readings", "readings that come due together on " + where +
                               " may take longer than its shortest period (" + load.text() +
                               "), so that its fastest sensors begin late or miss ticks now and then; give sensors of "
                               "one longer period different phases, or the fastest a tier of its own"));
    }
  }
  for (const LaneLoad& lane : load.lanes) {
    if (!lane.is_overloaded()) continue;
    const auto share = [&](const SensorLoad& sensor) {
      if (sensor.time.lane != lane.lane || !sensor.time.on_lane) return -1.0;
      return static_cast<double>(sensor.time.on_lane->count()) / static_cast<double>(sensor.period.count());
    };
    warnings.add(
        child_or_self(largest(tier, sensors, share).item, "rate")
            .problem("overloaded-lane", "a device cannot be read so often (" + lane.text() +
                                            "), this sensor reads it most; lower the rates of those that share it"));
  }
}

std::string stem_of(const std::string& file) { return std::filesystem::path(file).stem().string(); }

}  // namespace

namespace config_detail {

bool plan_sensor(const Registry& registry, const ConfigItem& item, SensorPlan& plan, Problems& problems) {
  ConfigItem known = item;
  const std::size_t before = problems.size();
  for (const std::string_view key : later_sensor_keys) {
    if (&child_or_self(item, key) == &item) continue;  // it is not there
    std::optional<TypeInfo> type;
    if (const std::string* name = child_or_self(item, "type").as_string()) type = registry.sensors().find(*name);
    const auto has_key = [&](const ParameterInfo& parameter) { return parameter.key == key; };
    if (type && std::any_of(type->parameters.begin(), type->parameters.end(), has_key)) continue;
    refuse_later_key(known, key, problems);
  }
  if (!plan_item(registry.sensors(), known, plan, problems)) return false;
  return check_topic(plan, problems) && problems.size() == before;
}

bool plan_sink(const Registry& registry, const ConfigItem& item, SinkPlan& plan, Problems& problems) {
  const std::size_t before = problems.size();
  // A sink is called as its path by default, unless that is a secret: names are shown.
  ConfigItem named = item;
  const ConfigItem& path = child_or_self(item, "path");
  const std::string* type = child_or_self(item, "type").as_string();
  if (is_secret_reference(path) && type != nullptr && &child_or_self(item, "name") == &item) named.set("name", *type);
  if (!plan_item(registry.sinks(), named, plan, problems)) return false;
  check_output_files(parameters_in(registry.sinks(), item), item, problems);
  return problems.size() == before;
}

}  // namespace config_detail

namespace {

/// What the declarations of all parameters say of the file.
void look_at_items(const Registry& registry, const ConfigItem& root, SystemPlan& plan) {
  const auto look_at = [&](const std::vector<ParameterInfo>& parameters, const ConfigItem& item) {
    config_detail::warn_of(parameters, item, plan.warnings);
    config_detail::collect_secrets(parameters, item, plan.secrets);
  };
  const std::vector<ParameterInfo> settings = parameters_of<SystemSettings>();
  look_at(settings, root);
  for (const ConfigItem& item : plan.settings.sensors) look_at(parameters_in(registry.sensors(), item), item);
  for (const ConfigItem& item : plan.settings.sinks) look_at(parameters_in(registry.sinks(), item), item);
  config_detail::warn_of_plain_secrets(root, plan.warnings);
}

}  // namespace

SystemPlan plan_system(const Registry& registry, ConfigDocument document) {
  SystemPlan plan;
  plan.document = std::move(document);
  plan.problems = plan.document.problems;
  if (plan.document.root.is_null() && !plan.problems.empty()) return plan;  // there is nothing to look at

  ConfigItem root = plan.document.root;
  for (const std::string_view key : later_document_keys) refuse_later_key(root, key, plan.problems);
  const std::size_t before = plan.problems.size();
  read_config(root, plan.settings, plan.problems);
  if (!root.is_object()) return plan;
  const bool has_lists = child_or_self(root, "sensors").is_array() && plan.problems.size() == before;
  if (plan.settings.name.empty()) plan.settings.name = stem_of(plan.document.file);

  check_tier_names(child_or_self(root, "tiers"), plan.loop_config().name, plan.problems);

  bool all_sensors_known = true;
  std::vector<SensorPlan> sensors;
  for (const ConfigItem& item : plan.settings.sensors) {
    SensorPlan sensor;
    const bool good = config_detail::plan_sensor(registry, item, sensor, plan.problems);
    all_sensors_known = all_sensors_known && good;
    sensors.push_back(good ? std::move(sensor) : raw_sensor(item));
  }
  std::vector<SinkPlan> sinks;
  for (const ConfigItem& item : plan.settings.sinks) {
    SinkPlan sink;
    const bool good = config_detail::plan_sink(registry, item, sink, plan.problems);
    sinks.push_back(good ? std::move(sink) : raw_sink(item));
  }
  AcrossItems across(plan);
  across.check(sensors, sinks);
  across.check_log(child_or_self(root, "log"));
  across.check_taken(sinks);
  if (all_sensors_known && !sensors.empty()) {
    across.warn_of_patterns(sinks);
    across.warn_of_units(sensors);
    across.warn_of_tiers(sensors, root);
  }
  look_at_items(registry, root, plan);
  if (plan.settings.sinks.empty() && !sensors.empty() && plan.problems.empty()) {
    plan.warnings.add(
        child_or_self(root, "sinks").problem("no-sinks", "there are no sinks: what the sensors read is kept nowhere"));
  }
  if (plan.settings.sensors.empty() && (has_lists || plan.problems.empty())) {
    plan.warnings.add(
        child_or_self(root, "sensors").problem("no-sensors", "there are no sensors: nothing will be recorded"));
  }
  const auto has_mistakes = [](const auto& part) { return !part.make; };
  std::erase_if(sensors, has_mistakes);
  std::erase_if(sinks, has_mistakes);
  plan.sensors = std::move(sensors);
  plan.sinks = std::move(sinks);
  warn_of_load("", plan.loop_config().name, plan.sensors, plan.warnings);
  for (const auto& entry : plan.settings.tiers) warn_of_load(entry.first, entry.first, plan.sensors, plan.warnings);
  plan.problems.sort();
  plan.warnings.sort();
  plan.hide_secrets();
  return plan;
}

void check_config(const LogSettings& settings, const ConfigItem& item, Problems& problems) {
  if (settings.max_bytes == 0 || settings.max_bytes >= 4096) return;
  problems.add(
      child_or_self(item, "max_bytes")
          .problem("out-of-range", std::to_string(settings.max_bytes) + " is out of range: give 4096 at least, or 0"));
}

void check_config(const TierSettings& settings, const ConfigItem& item, Problems& problems) {
  const auto complain = [&](const char* key, std::string message) {
    problems.add(child_or_self(item, key).problem("bad-value", std::move(message)));
  };
  if (settings.cpu && !settings.cpus.empty()) complain("cpu", "give `cpu` or `cpus`, not both");
  const bool is_real_time = settings.policy != SchedulingPolicy::other;
  if (is_real_time && settings.priority == 0) {
    complain("policy", "policy \"" + std::string(name_of(settings.policy)) + "\" needs a `priority` from 1 to 99");
  } else if (!is_real_time && settings.priority != 0) {
    complain("priority", "a priority goes with the policies \"fifo\" and \"rr\" only");
  }
}

Tier::Config TierSettings::tier_config(const std::string& name) const {
  Tier::Config config;
  config.name = name;
  config.policy = policy;
  config.priority = priority;
  config.cpus = cpus;
  if (cpu) config.cpus.push_back(*cpu);
  config.lock_memory = lock_memory;
  config.keep_cpu_awake = keep_cpu_awake;
  config.spin = spin;
  config.hold_limit = hold_limit;
  config.delivery_budget = delivery_budget;
  config.phase_grid = phase_grid;
  return config;
}

void SystemPlan::hide_secrets() {
  for (Problems* list : {&problems, &warnings}) {
    Problems shown;
    for (Problem problem : *list) {
      problem.message = rtdata::hide_secrets(std::move(problem.message), secrets);
      shown.add(std::move(problem));
    }
    *list = std::move(shown);
  }
}

std::string SystemPlan::report() const {
  std::string text;
  for (const Problem& problem : problems) text += problem.text() + "\n" + document.excerpt(problem);
  return text;
}

std::vector<LoopLoad> SystemPlan::loads() const {
  std::vector<LoopLoad> all;
  const auto add = [&](const std::string& tier, const std::string& name) {
    if (const auto loads = loads_on(tier, sensors); !loads.empty()) all.push_back(estimate_load(name, loads));
  };
  add("", loop_config().name);
  for (const auto& entry : settings.tiers) add(entry.first, entry.first);
  return all;
}

Runtime::Config SystemPlan::runtime_config() const {
  Runtime::Config config;
  config.name = settings.name;
  config.notes = settings.notes;
  config.configuration = document.text;
  config.secrets = secrets;
  return config;
}

Loop::Config SystemPlan::loop_config() const {
  Loop::Config config;
  config.hold_limit = settings.loop.hold_limit;
  config.delivery_budget = settings.loop.delivery_budget;
  config.phase_grid = settings.loop.phase_grid;
  return config;
}

}  // namespace rtdata
