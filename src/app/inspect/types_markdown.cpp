#include "app/inspect/types_markdown.hpp"

#include <algorithm>
#include <cctype>

#include "data/listed.hpp"
#include "rtdata/data/value.hpp"
#include "rtdata/io/registers.hpp"

namespace rtdata::app {
namespace {

void add_fields(const std::vector<Field>& fields, const std::string& prefix, std::vector<PublishedField>& out) {
  for (const Field& field : fields) {
    std::string name = prefix + field.name;
    if (field.is_array) name += "[" + std::to_string(field.count) + "]";
    if (field.kind == Kind::record) {
      add_fields(field.fields, name + ".", out);
      continue;
    }
    std::string type(name_of(field.kind));
    if (field.kind == Kind::enumeration)
      type = detail::listed_of(field.values, [](const EnumValue& value) { return value.name; });
    if (field.optional != nullptr) type += ", may be absent";
    out.push_back({std::move(name), std::move(type), field.unit});
  }
}

/// Text in a cell of a table.
std::string in_cell(const std::string& text) {
  std::string escaped;
  for (const char c : text) {
    if (c == '|') escaped += '\\';
    escaped += c == '\n' ? ' ' : c;
  }
  return escaped;
}

std::string code(const std::string& text) { return text.empty() ? "" : "`" + in_cell(text) + "`"; }

std::string type_text(const ParameterType& type) {
  return type.kind == ParameterType::Kind::choice ? detail::listed_of(type.choices, code) : type.name();
}

using Parameters = std::vector<ParameterInfo>;

/// The parameters that every sensor, or every sink, has.
const Parameters& common_parameters() {
  static const Parameters common = [] {
    Parameters all = parameters_of<SensorConfig>();
    for (const Parameters& more : {parameters_of<config_detail::Placement>(), parameters_of<SinkConfig>()})
      all.insert(all.end(), more.begin(), more.end());
    return all;
  }();
  return common;
}

bool is_own(const ParameterInfo& parameter) {
  const Parameters& common = common_parameters();
  return std::none_of(common.begin(), common.end(), [&](const ParameterInfo& other) {
    return other.key == parameter.key && other.doc == parameter.doc && other.default_text() == parameter.default_text();
  });
}

void add_rows(const Parameters& parameters, const std::string& prefix, std::string& text) {
  for (const ParameterInfo& parameter : parameters) {
    if (prefix.empty() && !is_own(parameter)) continue;
    const bool has_members = !parameter.type.members.empty();
    const std::string fallback = parameter.required ? "required" : has_members ? "" : code(parameter.default_text());
    text += "| " + code(prefix + parameter.key) + " | " + type_text(parameter.type) + " | " + in_cell(parameter.unit) +
            " | " + fallback + " | " + in_cell(parameter.type.range()) + " | " + in_cell(parameter.doc) + " |\n";
    add_rows(parameter.type.members, prefix + parameter.key + ".", text);
    for (const ParameterType& element : parameter.type.element)
      add_rows(element.members, prefix + parameter.key + ".", text);
  }
}

/// A table: how `rtdata scan` finds the chips of a driver; empty: it does not.
std::string chips_table(std::span<const KnownChip> chips) {
  std::string rows;
  for (const KnownChip& chip : chips) {
    std::string addresses;
    for (const std::uint8_t address : chip.addresses)
      if (address != 0) addresses += (addresses.empty() ? "" : ", ") + code(to_string(I2cAddress(address)));
    if (addresses.empty()) continue;
    rows += "| " + in_cell(std::string(chip.name)) + " | " + code(std::string(chip.model)) + " | " + addresses + " | ";
    if (const auto& identity = chip.identity) {
      rows += "register " + code(to_string(I2cAddress(identity->number))) + " is " +
              code(to_string(I2cAddress(identity->value))) +
              (detail::is_all_ones(*identity, identity->mask)
                   ? ""
                   : " in the bits " + code(to_string(I2cAddress(identity->mask))));
    } else {
      rows += "its address only";
    }
    rows += " |\n";
  }
  return rows.empty() ? rows
                      : "\n| chip | `model` | `rtdata scan` looks at | knows it by |\n|---|---|---|---|\n" + rows;
}

/// The data of the chip in tests, and the values decoded from it.
std::string sample_text(const ChipSample& sample) {
  std::string given, values;
  for (const ChipBytes& one : sample.bytes) {
    if (one.bytes.empty()) continue;
    given += (given.empty() ? "" : "; ") + code(std::string(one.at)) + (one.at.empty() ? "" : ": ") +
             code(std::string(one.bytes));
  }
  for (const ChipValue& one : sample.values)
    if (!one.field.empty())
      values += (values.empty() ? "" : ", ") + code(std::string(one.field)) + " " + to_string(Value(one.value));
  if (given.empty()) return given;
  return "\nIn its tests " + (sample.members.empty() ? "" : "with " + code(std::string(sample.members)) + " ") +
         "the chip gives, in hexadecimal: " + given + ". That is " + values + ".\n";
}

std::string sentence(std::string phrase) {
  if (phrase.empty()) return phrase;
  phrase[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(phrase[0])));
  return phrase + ".";
}

}  // namespace

std::vector<PublishedField> published_fields(const Description& description) {
  std::vector<PublishedField> all;
  add_fields(description.fields(), "", all);
  return all;
}

std::string markdown_of(const TypeInfo& type) {
  std::string text = "## `" + type.name + "`\n\n" + sentence(type.doc) + "\n";
  if (!type.page.notes.empty()) text += "\n" + type.page.notes + (type.page.notes.ends_with('\n') ? "" : "\n");
  text += chips_table(type.page.chips);
  std::string rows;
  add_rows(type.parameters, "", rows);
  if (!rows.empty()) {
    text += "\n| parameter | type | unit | default | range | meaning |\n|---|---|---|---|---|---|\n" + rows;
  }
  if (const auto description = type.page.publishes != nullptr ? type.page.publishes() : nullptr) {
    text += "\nIts events (`" + description->name() + "`)" +
            (type.page.depends_on_parameters ? ", unless its parameters say otherwise" : "") +
            ":\n\n| field | type | unit |\n|---|---|---|\n";
    for (const PublishedField& field : published_fields(*description))
      text += "| " + code(field.name) + " | " + in_cell(field.type) + " | " + in_cell(field.unit) + " |\n";
  }
  for (const ChipSample& sample : type.page.samples) text += sample_text(sample);
  return text;
}

std::string markdown_of(const Registry& registry) {
  std::string text;
  const auto add = [&](const std::string& heading, const std::vector<TypeInfo>& types, const std::string& bus) {
    std::string sections;
    for (const TypeInfo& type : types)
      if (type.page.bus == bus) sections += "\n" + markdown_of(type);
    if (!sections.empty()) text += (text.empty() ? "# " : "\n# ") + heading + "\n" + sections;
  };
  for (const PartKind* kind : registry.kinds_to_show()) {
    std::string heading = sentence(kind->key);
    if (!heading.empty()) heading.pop_back();
    const std::vector<TypeInfo> types = kind->types.types();
    add(heading, types, "");
    std::vector<std::string> buses;
    for (const TypeInfo& type : types) {
      const std::string& bus = type.page.bus;
      if (!bus.empty() && std::find(buses.begin(), buses.end(), bus) == buses.end()) buses.push_back(bus);
    }
    for (const std::string& bus : buses) add(heading + " on `" + bus + "`", types, bus);
  }
  return text;
}

}  // namespace rtdata::app
