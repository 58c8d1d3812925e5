#include "rtdata/config/registry.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "config/plan/misfit.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/config/settings.hpp"

namespace rtdata {
namespace {

using Json = nlohmann::ordered_json;

/// The schema of what a file says of the parts of a kind.
Json schema_of_kind(const PartKind& kind) {
  auto item = Json::parse(kind.types.schema());
  item.erase("$schema");
  Json json = Json::object();
  if (kind.written == PartKind::Written::list) {
    json["type"] = "array";
    json["items"] = std::move(item);
  } else {
    Json by_name = Json::object();
    by_name["type"] = "object";
    by_name["additionalProperties"] = std::move(item);
    json["anyOf"] = Json::array({std::move(by_name), Json{{"type", "array"}, {"maxItems", 0}}});
  }
  json["description"] = kind.doc;
  return json;
}

}  // namespace

void config_detail::keep_arming(PartPlan& plan, const OutputConfig& config,
                                std::function<PartPlan::Make(Arming armed)> made) {
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

void config_detail::let_the_loop_turn(PartPlan& plan) {
  plan.when_made = [](const PartObject& part, std::function<void(Result<void>)> done) {
    part.as<Output>()->when_taken(std::move(done));
  };
  plan.ending = {[](const PartObject& part, std::function<void()> done) { part.as<Output>()->finish(std::move(done)); },
                 [](const PartObject& part) { part.as<Output>()->take_back(); }};
}

PublishedTopic config_detail::published_topic(const std::string& name, const std::string& topic,
                                              Result<std::shared_ptr<const Description>> description,
                                              const Processing& processing) {
  std::shared_ptr<const Description> published = std::move(description).or_throw();
  try {
    if (published != nullptr && !processing.empty()) published = processed(published, processing, name);
  } catch (const ProcessingError& error) {
    throw MisfitError(error);
  }
  return {topic.empty() ? name : topic, std::move(published), std::nullopt, {}};
}

std::string config_detail::sink_name(const std::string& type, const std::string& path, const SinkConfig& config) {
  if (!config.name.empty()) return config.name;
  return path.empty() || path == "-" ? type : path;
}

std::string config_detail::trimmed_notes(std::string_view notes) {
  const std::size_t first = notes.find_first_not_of("\n");
  if (first == std::string_view::npos) return {};
  return std::string(notes.substr(first, notes.find_last_not_of(" \n") + 1 - first));
}

Registry::Registry() {
  add_kind("bus", "buses", "what sensors are connected to, by name; each has a `type`", PartKind::Written::by_name);
  add_kind("sink", "sinks", "where it goes; each has a `type`", PartKind::Written::list, PartKind::Does::stores);
  add_kind("sensor", "sensors", "what is read; each has a `type`", PartKind::Written::list, PartKind::Does::publishes);
  kinds_.back().common = parameters_of<config_detail::Placement>();
  add_kind("machine", "machines", "state machines", PartKind::Written::list, PartKind::Does::publishes);
  kinds_.back().common = parameters_of<config_detail::Placement>();
  kinds_.back().types.set_default("machine");
  add_kind("output", "outputs", "what is set; each has a `type`", PartKind::Written::list, PartKind::Does::publishes);
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
  if (name == "tier" || name == "topic") refuse("that is what tiers and topics are named by");
  for (const ParameterInfo& setting : parameters_of<SystemSettings>())
    if (setting.key == key) refuse("`" + key + "` is a setting of the file");
  for (const PartKind& known : kinds_)
    if (known.name == name || known.key == key) refuse("there is one of that name or key already");
  TypeRegistry<PartPlan, const std::string&> types(name);
  kinds_.push_back({std::move(name), std::move(key), std::move(doc), written, std::move(types), does, {}});
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

std::string Registry::schema() const {
  auto json = Json::parse(
      schema_of<SystemSettings>("rtdata configuration", "sensors, where their readings go, and the log"));
  for (auto kind = kinds_.rbegin(); kind != kinds_.rend(); ++kind)
    json["properties"][kind->key] = schema_of_kind(*kind);
  return json.dump(2);
}

}  // namespace rtdata
