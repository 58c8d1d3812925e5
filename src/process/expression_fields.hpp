// What the names in expressions stand for: fields of topics. For all that takes its values from topics.
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

/// A field of one of several topics. Of the first of them, a path alone is enough as a name.
struct FieldName {
  std::size_t topic = 0;  ///< among the topics
  std::string path = {};  ///< of the field; empty: the topic alone was named
};

/// The topic that is evaluated on, then the others.
std::vector<std::string> topics_of(const std::string& on, const std::vector<std::string>& with);
FieldName field_named(const std::vector<std::string>& topics, const std::string& name);
/// The field that is meant, if it is a number. Null otherwise.
const Leaf* leaf_named(const Description& description, const FieldName& field, const std::string& name);
/// Of a machine's changes: the state that it came to. Null: they are none.
const Leaf* state_leaf(const Description& description) noexcept;
/// Whether a text of the payload is this one.
bool holds_text(const Leaf& leaf, const std::byte* payload, std::string_view text) noexcept;
/// All names that the texts use, each once. Of texts with a mistake, none.
std::vector<std::string> names_of(const std::vector<std::string>& texts);

/// At its column in the file, as far as no escapes are before it.
Problem problem_of(const ExpressionMistake& mistake, const ConfigItem& at);
/// Mistakes of a text by itself, whatever its names are.
void check_expression(const std::string& text, const ConfigItem& at, Problems& problems);
/// Whether the topics have the fields that a text without mistakes names. `payload_of`: what a topic carries, null when
/// that is not known: then nothing is said of its fields.
void check_field_names(const std::string& text, const std::vector<std::string>& topics,
                       const std::function<const Description*(std::string_view topic)>& payload_of,
                       const ConfigItem& at, Problems& problems);

}  // namespace rtdata::detail
