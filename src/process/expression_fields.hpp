// Maps names in expressions to fields of topics.
#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "process/number_field.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/data/description.hpp"
#include "rtdata/process/expression.hpp"

namespace rtdata::detail {

/// A field of one of several topics. For the first topic, the path alone is enough as a name.
struct FieldName {
  std::size_t topic = 0;  ///< among the topics
  std::string path = {};  ///< of the field; empty: the topic alone was named
};

/// The topic that is evaluated on, then the others.
std::vector<std::string> topics_of(const std::string& on, const std::vector<std::string>& with);
FieldName field_named(const std::vector<std::string>& topics, const std::string& name);
/// The named field if it is a number, otherwise null.
const Leaf* leaf_named(const Description& description, const FieldName& field, const std::string& name);
/// For a machine's changes: the field with the new state; null for other descriptions.
const Leaf* state_leaf(const Description& description) noexcept;
/// True if a text of the payload equals `text`.
bool holds_text(const Leaf& leaf, const std::byte* payload, std::string_view text) noexcept;
/// All names in the texts, each once; none of texts with a mistake.
std::vector<std::string> names_of(const std::vector<std::string>& texts);

/// The problem at its column in the file, exact if no escapes precede it.
Problem problem_of(const ExpressionMistake& mistake, const ConfigItem& at);
/// Checks a text without regard to its names.
void check_expression(const std::string& text, const ConfigItem& at, Problems& problems);
/// Checks that the topics have the fields of a valid text. `payload_of`: the description of a topic; null if unknown,
/// then its fields are not checked.
void check_field_names(const std::string& text, const std::vector<std::string>& topics,
                       const std::function<const Description*(std::string_view topic)>& payload_of,
                       const ConfigItem& at, Problems& problems);

}  // namespace rtdata::detail
