#include "rtdata/config/system.hpp"

#include <algorithm>

#include "config/plan.hpp"
#include "config/warnings.hpp"
#include "loop/runtime_core.hpp"

namespace rtdata {
namespace {

template <class Parts>
auto& part_named(Parts& parts, const char* what, std::string_view name) {
  const auto found = std::find_if(parts.begin(), parts.end(), [&](const auto& part) { return part.name == name; });
  if (found != parts.end()) return *found;
  std::vector<std::string> names;
  for (const auto& part : parts) names.push_back(part.name);
  const std::string nearest = nearest_name(name, names);
  std::string advice = nearest.empty() ? "there is none" : "did you mean \"" + nearest + "\"?";
  if (nearest.empty() && !names.empty()) {
    advice = "there are";
    for (std::size_t i = 0; i < names.size() && i < 12; ++i) advice.append(i == 0 ? " " : ", ").append(names[i]);
  }
  throw SetupError({Errc::not_found, std::string("no such ") + what, "\"" + std::string(name) + "\"", "", advice});
}

/// Removes the part from the list before it goes, since what it does at its end may look at the list.
template <class Parts>
void remove_named(Parts& parts, const char* what, std::string_view name) {
  auto& part = part_named(parts, what, name);
  [[maybe_unused]] const auto last = std::move(part);
  parts.erase(parts.begin() + (&part - parts.data()));
}

template <class Parts>
std::vector<std::string> names_of(const Parts& parts) {
  std::vector<std::string> names;
  for (const auto& part : parts) names.push_back(part.name);
  return names;
}

/// An error of making an item says where the item is.
template <class Make>
auto made_at(const ConfigItem& item, const std::string& what, const Make& make) {
  try {
    return make();
  } catch (const SetupError& error) {
    Error placed = error.error();
    std::string where = item.place().text();
    where += (where.empty() ? "" : ": ") + what;
    placed.where = placed.where.empty() ? where : where + ": " + placed.where;
    throw SetupError(std::move(placed));
  }
}

void note_place(Loop& loop, std::string object, const ConfigItem& item) {
  if (std::string place = item.place().text(); !place.empty())
    loop.runtime().note_place(std::move(object), std::move(place));
}

/// What is made of the item on this loop may meet errors that show them.
void hide_secrets_of(Loop& loop, const TypeRegistryBase& types, const ConfigItem& item) {
  const std::string* name = item.is_object() && item.find("type") != nullptr ? item.find("type")->as_string() : nullptr;
  const std::optional<TypeInfo> type = name != nullptr ? types.find(*name) : std::nullopt;
  if (type) config_detail::collect_secrets(type->parameters, item, loop.runtime().core().reports.secrets);
}

}  // namespace

System::System(Loop& loop, const Registry& registry, const SystemPlan& plan) : loop_(loop), registry_(registry) {
  if (!plan.good()) throw ConfigError(plan.problems);
  make_tiers(plan);
  for (const SinkPlan& sink : plan.sinks) make(sink);
  for (const SensorPlan& sensor : plan.sensors) make(sensor);
}

System::System(Loop& loop, const Registry& registry, const ConfigDocument& document)
    : System(loop, registry, plan_system(registry, document)) {}

System::~System() = default;

void System::make_tiers(const SystemPlan& plan) {
  for (const auto& entry : plan.settings.tiers) {
    const std::string& name = entry.first;
    tiers_.push_back({name, made_at(*plan.document.root.find("tiers")->find(name), "tier " + name,
                                    [&] { return std::make_unique<Tier>(loop_, entry.second.tier_config(name)); })});
  }
}

Tier& System::tier(std::string_view name) { return *part_named(tiers_, "tier", name).object; }

AnySensor& System::make(const SensorPlan& plan) {
  const auto make_there = [&] {
    const auto make_on = [&](Loop& on) {
      note_place(on, "sensor " + plan.name, plan.item);
      hide_secrets_of(on, registry_.sensors(), plan.item);
      return plan.make(on);
    };
    return plan.tier.empty() ? make_on(loop_) : tier(plan.tier).call(make_on);
  };
  sensors_.push_back({plan.name, made_at(plan.item, "sensor " + plan.name, make_there)});
  return *sensors_.back().object;
}

Sink& System::make(const SinkPlan& plan) {
  note_place(loop_, "sink " + plan.name, plan.item);
  hide_secrets_of(loop_, registry_.sinks(), plan.item);
  sinks_.push_back({plan.name, made_at(plan.item, "sink " + plan.name, [&] { return plan.make(loop_); })});
  return *sinks_.back().object;
}

AnySensor& System::sensor(std::string_view name) { return *part_named(sensors_, "sensor", name).object; }
Sink& System::sink(std::string_view name) { return *part_named(sinks_, "sink", name).object; }
std::vector<std::string> System::sensor_names() const { return names_of(sensors_); }
std::vector<std::string> System::sink_names() const { return names_of(sinks_); }

AnySensor& System::add_sensor(const ConfigItem& item) {
  SensorPlan plan;
  Problems problems;
  if (!config_detail::plan_sensor(registry_, item, plan, problems)) throw ConfigError(std::move(problems));
  return make(plan);
}

Sink& System::add_sink(const ConfigItem& item) {
  SinkPlan plan;
  Problems problems;
  config_detail::plan_sink(registry_, item, plan, problems);
  const auto is_taken = [&](const auto& sink) { return sink.name == plan.name; };
  if (problems.empty() && std::any_of(sinks_.begin(), sinks_.end(), is_taken)) {
    problems.add(item.problem("duplicate-name", "there is a sink \"" + plan.name + "\" already"));
  }
  if (!problems.empty()) throw ConfigError(std::move(problems));
  return make(plan);
}

void System::remove_sensor(std::string_view name) { remove_named(sensors_, "sensor", name); }
void System::remove_sink(std::string_view name) { remove_named(sinks_, "sink", name); }

}  // namespace rtdata
