#include "process/expression_fields.hpp"

#include <algorithm>
#include <cstring>

#include "rtdata/data/text.hpp"

namespace rtdata::detail {

std::vector<std::string> topics_of(const std::string& on, const std::vector<std::string>& with) {
  std::vector<std::string> topics{on};
  topics.insert(topics.end(), with.begin(), with.end());
  return topics;
}

FieldName field_named(const std::vector<std::string>& topics, const std::string& name) {
  FieldName field{0, name};
  std::size_t longest = 0;
  for (std::size_t i = 0; i < topics.size(); ++i) {
    const std::string topic = Expression::normal_name(topics[i]);
    if (topic.size() <= longest || !name.starts_with(topic)) continue;
    if (name.size() > topic.size() && name[topic.size()] != '.') continue;
    longest = topic.size();
    field = {i, name.size() == topic.size() ? "" : name.substr(topic.size() + 1)};
  }
  return field;
}

const Leaf* leaf_named(const Description& description, const FieldName& field, const std::string& name) {
  const bool is_called_as_topic = field.topic == 0 && description.find(name) != nullptr;
  return number_field(description, is_called_as_topic ? std::string_view(name) : field.path);
}

const Leaf* state_leaf(const Description& description) noexcept {
  return description.name() == "state_change" ? description.find("to") : nullptr;
}

bool holds_text(const Leaf& leaf, const std::byte* payload, std::string_view text) noexcept {
  const std::byte* const at = payload + leaf.offset;
  const std::size_t size = std::to_integer<std::size_t>(at[0]) | std::to_integer<std::size_t>(at[1]) << 8;
  return size == text.size() && size <= leaf.size - text_length_bytes &&
         std::memcmp(at + text_length_bytes, text.data(), size) == 0;
}

std::vector<std::string> names_of(const std::vector<std::string>& texts) {
  std::vector<std::string> names;
  for (const std::string& text : texts) {
    const auto used = Expression::names_in(text);
    if (!used) continue;
    for (const std::string& name : *used)
      if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
  }
  return names;
}

Problem problem_of(const ExpressionMistake& mistake, const ConfigItem& at) {
  Problem problem = at.problem("bad-value",
                               mistake.why + " (column " + std::to_string(mistake.column) + " of the expression)",
                               mistake.suggestion);
  if (problem.place.line > 0) problem.place.column += mistake.column;
  return problem;
}

void check_expression(const std::string& text, const ConfigItem& at, Problems& problems) {
  if (const auto mistake = Expression::check(text, names_of({text}))) problems.add(problem_of(*mistake, at));
}

void check_field_names(const std::string& text, const std::vector<std::string>& topics,
                       const std::function<const Description*(std::string_view topic)>& payload_of,
                       const ConfigItem& at, Problems& problems) {
  const std::vector<std::string> names = names_of({text});
  // Refuses a constant with the name of a field, because the field would silently be ignored.
  const Description* const first = topics.empty() ? nullptr : payload_of(topics[0]);
  for (const char* constant : {"e", "pi", "true", "false"}) {
    if (first == nullptr || first->find(constant) == nullptr) continue;
    const auto with_it = Expression::names_in(text, {constant});
    if (!with_it || with_it->size() == names.size()) continue;
    problems.add(at.problem("bad-value", "`" + std::string(constant) + "` is the constant here, but the topic \"" +
                                             topics[0] + "\" also has a field with this name: for the field, write '" +
                                             constant + "' in quotes, or `" + Expression::normal_name(topics[0]) + "." +
                                             constant + "`"));
  }
  std::vector<std::string> good;
  for (const std::string& name : names) {
    const FieldName field = field_named(topics, name);
    const Description* const description = topics.empty() ? nullptr : payload_of(topics[field.topic]);
    if (!topics.empty() && (description == nullptr || leaf_named(*description, field, name) != nullptr))
      good.push_back(name);
  }
  if (good.size() == names.size()) return;
  // Names for suggestions.
  for (std::size_t i = 0; i < topics.size(); ++i) {
    const Description* const description = payload_of(topics[i]);
    if (description == nullptr) continue;
    for (const Leaf& leaf : description->leaves()) {
      if (number_field(*description, leaf.path) == nullptr) continue;
      const std::string full = Expression::normal_name(topics[i]) + "." + leaf.path;
      for (const std::string& name : i == 0 ? std::vector{leaf.path, full} : std::vector{full})
        if (std::find(good.begin(), good.end(), name) == good.end()) good.push_back(name);
    }
  }
  if (const auto mistake = Expression::check(text, good)) problems.add(problem_of(*mistake, at));
}

}  // namespace rtdata::detail
