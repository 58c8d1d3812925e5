#include "rtdata/detail/config/parameter_info.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <nlohmann/json.hpp>

#include "config/read/limits_text.hpp"
#include "rtdata/data/config_value.hpp"

namespace rtdata {
namespace {

using Json = nlohmann::ordered_json;
using TypeKind = ParameterType::Kind;

std::string number_text(double value) {
  std::array<char, 32> buffer{};
  // Whole numbers without an exponent, as people write them.
  const bool whole = value == std::floor(value) && std::fabs(value) < 1e15;
  const auto end = whole ? std::to_chars(buffer.data(), buffer.data() + buffer.size(), static_cast<std::int64_t>(value))
                               .ptr
                         : std::to_chars(buffer.data(), buffer.data() + buffer.size(), value).ptr;
  return std::string(buffer.data(), end);
}

std::string limit_text(double value, TypeKind kind, std::string_view unit) {
  if (kind == TypeKind::duration) return to_string(Duration(static_cast<std::int64_t>(value)));
  if (kind == TypeKind::rate) return number_text(value) + " Hz";
  return number_text(value) + (unit.empty() ? "" : " ") + std::string(unit);
}

std::string_view word_of(TypeKind kind) {
  constexpr std::string_view words[] = {"any",      "boolean", "integer",           "number", "character", "string",
                                        "duration", "rate",    "string or integer", "choice", "list",      "map",
                                        "object"};
  return words[static_cast<std::size_t>(kind)];
}

Json number_json(double value) {
  if (value == std::floor(value) && std::fabs(value) < 1e15) return static_cast<std::int64_t>(value);
  return value;
}

Json json_of(const ConfigItem& item) { return Json::parse(item.to_json(ConfigItem::Layout::one_line)); }

Json object_schema(const std::vector<ParameterInfo>& parameters);

/// The JSON Schema pattern of a text, a regular expression of ECMA 262; empty: none.
std::string pattern_of(TextIs is) {
  constexpr const char* level = "[A-Za-z0-9_.-]+";
  const std::string name = std::string(level) + "(/" + level + ")*";
  switch (is) {
    case TextIs::name:
      return "^[^\\u0000-\\u001f\\u007f]*$";
    case TextIs::field:
      return "^([A-Za-z_][A-Za-z0-9_]*)?$";
    case TextIs::topic:
      return "^(" + name + ")?$";
    case TextIs::topic_pattern:
      return "^(#|\\$?(\\+|" + std::string(level) + ")(/(\\+|" + level + "))*(/#)?)$";
    case TextIs::device:
      return "^[^\\u0000]*$";
    case TextIs::output_file:
      return "^[^\\u0000-\\u001f\\u007f-\\u009f]*$";
    case TextIs::permissions:
      return "^0?6[0246][0246]$";
    case TextIs::anything:
    case TextIs::recorded:
    case TextIs::unit:
      break;
  }
  return "";
}

constexpr const char* duration_pattern = "[+]?[0-9]+(\\.[0-9]+)?[ \\t]*(ns|us|\u00b5s|\u03bcs|ms|s|min|h|d)";
constexpr const char* frequency_pattern = "[+]?[0-9]+(\\.[0-9]+)?[ \\t]*(mHz|Hz|kHz|MHz|GHz|/s|/min|/h)";

Json reference_schema(const char* key, const char* doc) {
  Json json = Json::object();
  json["type"] = "object";
  json["properties"][key] = Json{{"type", "string"}, {"minLength", 1}};
  json["required"] = Json::array({key});
  json["additionalProperties"] = false;
  json["description"] = doc;
  return json;
}

/// The schema of a text, or of a reference to a secret.
Json text_schema(const ParameterType& type) {
  Json json = Json::object();
  json["type"] = "string";
  if (type.not_empty) json["minLength"] = 1;
  if (const std::string pattern = pattern_of(type.text); !pattern.empty()) json["pattern"] = pattern;
  if (type.text != TextIs::anything && type.text != TextIs::device && type.text != TextIs::output_file) return json;
  Json either = Json::object();
  either["anyOf"] = Json::array({std::move(json),
                                 reference_schema("env", "taken from this variable of the environment"),
                                 reference_schema("file", "taken from this file")});
  return either;
}

Json type_schema(const ParameterType& type) {
  Json json = Json::object();
  const auto numbers = [&](const char* name) {
    json["type"] = name;
    if (type.least) json["minimum"] = number_json(*type.least);
    if (type.most) json["maximum"] = number_json(*type.most);
    if (type.not_zero) json["not"] = Json{{"const", 0}};
  };
  switch (type.kind) {
    case TypeKind::any:
      break;
    case TypeKind::boolean:
      json["type"] = "boolean";
      break;
    case TypeKind::integer:
      numbers("integer");
      break;
    case TypeKind::number:
      numbers("number");
      break;
    case TypeKind::character:
      json["type"] = "string";
      json["minLength"] = 1;
      json["maxLength"] = 1;
      json["pattern"] = "^[\\u0000-\\u007f]$";
      break;
    case TypeKind::string:
      json = text_schema(type);
      break;
    case TypeKind::duration:
      json["type"] = "string";
      json["pattern"] = "^[ \\t]*" + std::string(type.may_be_negative ? "-?[ \\t]*" : "") + duration_pattern +
                        "[ \\t]*$";
      json["examples"] = {"10 ms", "1.5 s"};
      break;
    case TypeKind::rate:
      json["type"] = "string";
      json["pattern"] = "^[ \\t]*(" + std::string(frequency_pattern) + "|(every )?[ \\t]*" + duration_pattern +
                        ")[ \\t]*$";
      json["examples"] = {"100 Hz", "1 kHz"};
      break;
    case TypeKind::text_or_integer:
      json["type"] = {"string", "integer"};
      json["minimum"] = number_json(*type.least);
      json["maximum"] = number_json(*type.most);
      json["pattern"] = type.pattern;
      break;
    case TypeKind::choice:
      json["enum"] = type.choices;
      break;
    case TypeKind::list:
      json["type"] = "array";
      json["items"] = type_schema(type.element.at(0));
      if (type.length != 0) json["minItems"] = json["maxItems"] = type.length;
      break;
    case TypeKind::map:
      json["type"] = "object";
      json["additionalProperties"] = type_schema(type.element.at(0));
      break;
    case TypeKind::object:
      json = object_schema(type.members);
      break;
  }
  if (type.nullable && type.kind != TypeKind::any) {
    Json either = Json::object();
    either["anyOf"] = Json::array({std::move(json), Json{{"type", "null"}}});
    return either;
  }
  return json;
}

/// The description for users: the phrase, then unit and range if the schema has no keyword for them.
std::string description_of(const ParameterInfo& parameter) {
  std::string text = parameter.doc;
  if (!parameter.unit.empty()) text += " (" + parameter.unit + ")";
  const bool in_words = parameter.type.kind == TypeKind::duration || parameter.type.kind == TypeKind::rate;
  if (in_words && !parameter.type.range().empty()) text += ", " + parameter.type.range();
  return text;
}

Json object_schema(const std::vector<ParameterInfo>& parameters) {
  Json json = Json::object();
  json["type"] = "object";
  json["properties"] = Json::object();
  Json required = Json::array();
  for (const ParameterInfo& parameter : parameters) {
    Json property = type_schema(parameter.type);
    property["description"] = description_of(parameter);
    if (!parameter.default_value.is_null()) property["default"] = json_of(parameter.default_value);
    json["properties"][parameter.key] = std::move(property);
    if (parameter.required) required.push_back(parameter.key);
  }
  if (!required.empty()) json["required"] = std::move(required);
  json["additionalProperties"] = false;
  return json;
}

Json head(std::string_view title, std::string_view doc) {
  Json json = Json::object();
  json["$schema"] = "http://json-schema.org/draft-07/schema#";
  if (!title.empty()) json["title"] = title;
  if (!doc.empty()) json["description"] = doc;
  return json;
}

enum class Named { always, by_default };

Json named_schema(const TypeInfo& type, std::string_view key, Named named = Named::always) {
  Json json = object_schema(type.parameters);
  Json properties = Json::object();
  properties[std::string(key)] = Json{{"const", type.name}, {"description", type.doc}};
  properties.update(json["properties"]);
  json["properties"] = std::move(properties);
  Json required = Json::array();
  if (named == Named::always) required.push_back(std::string(key));
  if (json.contains("required"))
    for (const Json& name : json["required"]) required.push_back(name);
  json["required"] = std::move(required);
  return json;
}

std::string text_of(const Json& json) { return json.dump(2, ' ', false, Json::error_handler_t::replace); }

}  // namespace

std::string config_detail::range_text(std::optional<double> least, std::optional<double> most, TypeKind kind,
                                      std::string_view unit) {
  if (least && most) {
    std::string low = limit_text(*least, kind, unit);
    return low + " to " + limit_text(*most, kind, unit);
  }
  if (least) return "at least " + limit_text(*least, kind, unit);
  if (most) return "at most " + limit_text(*most, kind, unit);
  return "";
}

std::string ParameterType::name() const {
  if (element.empty()) return std::string(word_of(kind));
  const std::string what = element[0].name();
  if (kind == TypeKind::map) return "map of " + what;
  return length == 0 ? "list of " + what : "list of " + std::to_string(length) + " " + what;
}

std::string ParameterType::range() const {
  if (kind == TypeKind::text_or_integer) return "";  // its description contains the range
  return element.empty() ? config_detail::range_text(least, most, kind, "") : element[0].range();
}

std::string ParameterInfo::default_text() const {
  if (default_value.is_null()) return "";
  const std::string* text = default_value.as_string();
  const auto is_control = [](char c) { return static_cast<unsigned char>(c) < ' '; };
  if (text != nullptr && std::any_of(text->begin(), text->end(), is_control)) {  // as in a file: \n
    const std::string json = default_value.to_json(ConfigItem::Layout::one_line);
    return json.substr(1, json.size() - 2);
  }
  if (text != nullptr) return *text;
  return default_value.to_json(ConfigItem::Layout::one_line);
}

std::string schema(const std::vector<ParameterInfo>& parameters, std::string_view title, std::string_view doc) {
  Json json = head(title, doc);
  json.update(object_schema(parameters));
  return text_of(json);
}

std::string TypeInfo::schema(std::string_view key) const {
  Json json = head(name, doc);
  json.update(named_schema(*this, key));
  return text_of(json);
}

std::string schema(const std::vector<TypeInfo>& types, std::string_view key, std::string_view by_default) {
  const std::string name(key);
  Json json = head("", "");
  json["type"] = "object";
  if (by_default.empty()) json["required"] = {name};
  Json names = Json::array();
  Json cases = Json::array();
  for (const TypeInfo& type : types) {
    names.push_back(type.name);
    Json condition = Json::object();
    condition["properties"][name]["const"] = type.name;
    const bool is_default = type.name == by_default;
    if (!by_default.empty() && !is_default) condition["required"] = {name};
    cases.push_back(Json{{"if", std::move(condition)},
                         {"then", named_schema(type, key, is_default ? Named::by_default : Named::always)}});
  }
  json["properties"][name]["enum"] = std::move(names);
  if (!cases.empty()) json["allOf"] = std::move(cases);
  return text_of(json);
}

}  // namespace rtdata
