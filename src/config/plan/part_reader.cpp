#include "config/plan/part_reader.hpp"

#include "config/plan/misfit.hpp"
#include "config/plan/warnings.hpp"
#include "config/read/mistakes.hpp"
#include "data/name.hpp"
#include "rtdata/config/read.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::config_detail {
namespace {

/// The plan of an item without mistakes; with one, a plan without `make`.
PartPlan created(const PartKind& kind, const std::string& name, const ConfigItem& item, Problems& problems) {
  try {
    return kind.types.create(item, name);
  } catch (const MisfitError& error) {  // the fields of the sensor are known only now
    const ConfigItem& process = child_or_self(item, "process");
    for (const ProcessingMistake& mistake : error.mistakes) {
      const ConfigItem& field = child_or_self(process, mistake.field);
      const std::string why = mistake.why + "; " + mistake.advice;
      problems.add(mistake.key.empty() ? problem_at_key(field, "bad-value", why)
                                       : child_or_self(field, mistake.key).problem("bad-value", why));
    }
  } catch (const ConfigError& error) {
    problems.append(error.problems());
  } catch (const SetupError& error) {  // its description is invalid
    const Error& e = error.error();
    Error rest{e.code, e.what, "", e.why, e.advice};
    problems.add(item.problem("bad-value", rest.text()));
  }
  return {};
}

/// The known data of an item with mistakes.
PartPlan raw_plan(const PartKind& kind, const std::string& name, const ConfigItem& item) {
  PartPlan plan;
  plan.kind = kind.name;
  plan.type = kind.types.type_named_by(item);
  plan.name = kind.written == PartKind::Written::by_name ? name : text_or_empty(item, "name");
  plan.item = item;
  if (kind.does == PartKind::Does::publishes) {
    std::string topic = text_or_empty(item, "topic");
    plan.publishes = PublishedTopic{topic.empty() ? plan.name : std::move(topic), nullptr, std::nullopt, {}};
  }
  if (kind.does == PartKind::Does::stores) plan.stores.emplace().path = text_or_empty(item, "path");
  return plan;
}

/// A written topic was checked when it was read; a topic that comes from the part's name is checked here.
void check_topic(const PartPlan& plan, Problems& problems) {
  const std::string& topic = plan.publishes->topic;
  std::string mistake;
  if (!is_topic_name(topic)) mistake = topic_advice(topic) + "; give the " + plan.kind + " a `topic`, or another name";
  if (topic.starts_with("$"))
    mistake = "topics that begin with $ are reserved for the library; give the " + plan.kind + " a `topic`";
  if (topic == "rtdata/commands")
    mistake = "on this topic the program records commands; give the " + plan.kind + " another `topic` or name";
  if (!mistake.empty()) problems.add(child_or_self(plan.item, "name").problem("bad-name", mistake));
}

/// Reports `retry_longest` below `retry_first` if both are written; adjusts a default otherwise.
void check_retries(const ConfigItem& item, Problems& problems) {
  const auto written = [&](std::string_view key) -> std::optional<Duration> {
    const ConfigItem* value = child_of(item, key);
    const std::string* text = value != nullptr ? value->as_string() : nullptr;
    if (text == nullptr) return {};
    const auto parsed = parse_duration(*text);
    return parsed ? std::optional(*parsed) : std::nullopt;
  };
  const auto first = written("retry_first"), longest = written("retry_longest");
  if (!first || !longest || *first <= *longest) return;
  problems.add(child_or_self(item, "retry_longest")
                   .problem("bad-value", "it must not be shorter than `retry_first` (" + to_string(*first) +
                                             "): the wait grows from that one to this one"));
}

void check_from(const PartPlan& plan, Problems& problems) {
  const ConfigItem* const from = child_of(plan.item, "from");
  if (!plan.stores || !plan.stores->through.empty() || from == nullptr || text_or_empty(plan.item, "from") == "now")
    return;
  problems.add(
      from->problem("bad-value", "it has no effect without `through`: give the name of a recording, or remove it"));
}

/// The parts that the item names.
void collect_uses(const std::vector<ParameterInfo>& parameters, const ConfigItem& item, std::vector<PartUse>& uses) {
  const auto add = [&](const NamesPart& names, const std::string& name, const ConfigItem& at) {
    if (name.empty()) return;
    uses.push_back({std::string(names.kind), name, {names.types.begin(), names.types.end()}, at});
  };
  for_each_text(parameters, item, [&](const ParameterInfo& parameter, const std::string& text, const ConfigItem& leaf) {
    if (!parameter.names_part.kind.empty()) add(parameter.names_part, text, leaf);
  });
  for (const ParameterInfo& parameter : parameters) {
    const std::string* text = parameter.default_value.as_string();
    if (!parameter.names_part.kind.empty() && text != nullptr && child_of(item, parameter.key) == nullptr)
      add(parameter.names_part, *text, item);
  }
}

}  // namespace

const PartKind* find_kind(const Registry& registry, std::string_view name) {
  for (const PartKind& kind : registry.kinds())
    if (kind.name == name) return &kind;
  return nullptr;
}

const std::vector<ParameterInfo>& PartReader::parameters_of_item(const PartKind& kind, const ConfigItem& item) {
  const auto [known, is_new] = parameters_.try_emplace({kind.name, kind.types.type_named_by(item)});
  if (!is_new) return known->second;
  if (const std::optional<TypeInfo> type = kind.types.find(known->first.second)) {
    known->second = type->parameters;
  } else {
    known->second = kind.common;
  }
  return known->second;
}

PartPlan PartReader::read(const PartKind& kind, const std::string& name, const ConfigItem& item, Problems& problems) {
  const std::size_t before = problems.size();
  const std::vector<ParameterInfo>& parameters = parameters_of_item(kind, item);
  if (kind.written == PartKind::Written::by_name && !detail::is_name(name))
    problems.add(problem_at_key(item, "bad-name", detail::name_rule));
  // A sink's default name is its path, unless that is a secret, because names are shown.
  ConfigItem named = item;
  const ConfigItem* path = child_of(item, "path");
  const std::string type = text_or_empty(item, "type");
  if (kind.does == PartKind::Does::stores && path != nullptr && is_secret_reference(*path) && !type.empty() &&
      child_of(item, "name") == nullptr)
    named.set("name", type);

  PartPlan plan = created(kind, name, named, problems);
  if (plan.make) {
    plan.item = item;
    if (plan.publishes) check_topic(plan, problems);
    check_output_files(parameters, item, problems);
    check_retries(item, problems);
    check_from(plan, problems);
  }
  if (problems.size() != before) plan = raw_plan(kind, name, item);
  collect_uses(parameters, item, plan.uses);
  collect_secrets(parameters, item, plan.secrets);
  return plan;
}

}  // namespace rtdata::config_detail
