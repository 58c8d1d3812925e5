#include "config/read/parameter_table.hpp"

#include <algorithm>

namespace rtdata::config_detail {
namespace {

/// A parameter of an object.
struct MemberOf {
  const ParameterEntry& entry;
  RulesOf rules;
  void* value;
};

/// Every parameter of the object, those it includes as well, in order.
void add_members(const ParameterTable& table, void* config, std::vector<MemberOf>& members) {
  for (std::size_t i = 0; i < table.entries.size(); ++i) {
    const ParameterEntry& entry = table.entries[i];
    void* const owner = table.owners == nullptr ? config : table.owners[i](config);
    void* const value = static_cast<char*>(owner) +
                        (static_cast<const char*>(entry.member) - static_cast<const char*>(entry.owner));
    if (entry.is_included)
      add_members(entry.kind().table(), value, members);
    else
      members.push_back({entry, {entry.rules, table.words + entry.first_word}, value});
  }
}
std::vector<MemberOf> members_of(const ParameterTable& table, void* config) {
  std::vector<MemberOf> members;
  add_members(table, config, members);
  return members;
}

std::vector<std::string_view> texts_of(std::span<const Word> words) {
  std::vector<std::string_view> texts;
  for (const Word& word : words) texts.push_back(word.text);
  return texts;
}

ParameterType type_of(const ValueKind& kind, const RulesOf& rules) {
  using Kind = ParameterType::Kind;
  if (kind.is_optional) {
    ParameterType type = type_of(kind.element(), rules);
    type.nullable = true;
    return type;
  }
  ParameterType type;
  type.kind = kind.kind;
  type.length = kind.length;
  if (kind.element != nullptr) {
    type.element.push_back(type_of(kind.element(), rules));
  } else if (kind.table != nullptr) {
    type.members = list_parameters(kind.table());
  } else if (const auto choices = rules.choices().empty() ? kind.choices : rules.choices(); !choices.empty()) {
    type.kind = Kind::choice;
    type.choices = names_among(choices);
  } else {
    type.pattern = kind.pattern;
    if (kind.has_least) type.least = kind.least;
    if (kind.has_most) type.most = kind.most;
    type.not_zero = rules.rules.not_zero;
    type.may_be_negative = rules.rules.negative;
    if (kind.kind == Kind::string) {
      type.text = rules.rules.text;
      type.not_empty = rules.rules.required;
    }
    if (rules.rules.has_least) type.least = rules.rules.least;
    if (rules.rules.has_most) type.most = rules.rules.most;
  }
  return type;
}

}  // namespace

std::shared_ptr<void> make_config(const ParameterTable& table) { return {table.make(), table.destroy}; }

bool read_object(std::span<const ConfigPart> parts, const ConfigItem& item, UnknownKeys unknown,
                 const std::vector<std::string>& others, Problems& problems) {
  if (!check_is_object(item, problems)) return false;
  std::vector<MemberOf> members;
  for (const ConfigPart& part : parts) add_members(*part.table, part.config, members);
  std::vector<KnownKey> known;
  for (const std::string& key : others) known.push_back({key, "", false});
  for (const MemberOf& member : members)
    known.push_back({member.entry.key, member.entry.doc, member.entry.rules.required});
  bool good = check_keys(item, known, unknown, problems);
  const auto children = item.children();
  for (const MemberOf& member : members) {
    const auto child = std::find_if(children.begin(), children.end(),
                                    [&](const ConfigChild& c) { return c.key == member.entry.key; });
    if (child == children.end()) continue;
    good = member.entry.kind().read(child->item, member.value, member.rules, problems) && good;
  }
  if (!good) return false;
  const std::size_t before = problems.size();
  for (const ConfigPart& part : parts)
    if (part.table->check != nullptr) part.table->check(part.config, item, problems);
  return problems.size() == before;
}

void write_object(const ParameterTable& table, const void* config, ConfigItem& item) {
  item.set_item(ConfigItem::object());
  for (const MemberOf& member : members_of(table, const_cast<void*>(config))) {
    ConfigItem child;
    member.entry.kind().write(member.value, member.rules, child);
    if (!child.is_null()) item.set(member.entry.key, child);
  }
}

std::vector<ParameterInfo> list_parameters(const ParameterTable& table) {
  std::vector<ParameterInfo> list;
  const std::shared_ptr<void> defaults = make_config(table);
  for (const MemberOf& member : members_of(table, defaults.get())) {
    const ParameterRules& rules = member.entry.rules;
    ParameterInfo info;
    info.key = member.entry.key;
    info.type = type_of(member.entry.kind(), member.rules);
    info.unit = rules.unit;
    info.required = rules.required;
    info.only_with = {rules.only_with, texts_of(member.rules.range(rules.only_with_values))};
    info.names_part = {rules.names_part, texts_of(member.rules.range(rules.part_types))};
    for (const Word& word : member.rules.range(rules.placeholders)) info.placeholders.emplace_back(word.text);
    info.doc = member.entry.doc;
    if (!info.required) member.entry.kind().write(member.value, member.rules, info.default_value);
    list.push_back(std::move(info));
  }
  return list;
}

}  // namespace rtdata::config_detail
