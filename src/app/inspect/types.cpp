#include <unistd.h>

#include <algorithm>
#include <iostream>

#include "app/core/configuration_commands.hpp"
#include "app/core/table.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/types_markdown.hpp"
#include "data/listed.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/sensors/host.hpp"

namespace rtdata::app {
namespace {

/// `columns`: of the terminal, so that long lists of choices do not widen their column; 0: not a terminal.
void add_parameters(Table& table, const std::vector<ParameterInfo>& parameters, const std::string& indent,
                    std::size_t columns) {
  constexpr std::size_t widest = 16;
  for (const ParameterInfo& parameter : parameters) {
    const bool is_choice = parameter.type.kind == ParameterType::Kind::choice;
    std::string type = is_choice ? detail::listed(parameter.type.choices, "|") : parameter.type.name();
    const std::string range = parameter.type.range();
    std::string fallback = parameter.required ? "required" : parameter.default_text();
    const bool has_members = !parameter.type.members.empty();
    if (has_members) fallback.clear();
    std::string doc = parameter.doc + (range.empty() ? "" : " (" + range + ")");
    if (columns != 0 && width_of(type) > widest) {
      doc += is_choice ? "; one of " + detail::listed(parameter.type.choices) : "; type: " + type;
      type = is_choice ? "choice" : "see right";
    }
    if (columns != 0 && width_of(fallback) > widest) {
      doc += "; default: " + fallback;
      fallback = "see right";
    }
    table.add({indent + parameter.key, type, parameter.unit, fallback, doc});
    add_parameters(table, parameter.type.members, indent + "  ", columns);
    for (const ParameterType& element : parameter.type.element)
      add_parameters(table, element.members, indent + "  ", columns);
  }
}

/// The notes on a type's page.
std::string notes_of(const TypeInfo& type) {
  std::string text;
  for (std::size_t at = 0; at < type.page.notes.size();) {
    const std::size_t end = std::min(type.page.notes.find('\n', at), type.page.notes.size());
    text += (end == at ? "" : "  ") + type.page.notes.substr(at, end - at) + "\n";
    at = end + 1;
  }
  return text.empty() ? text : text + "\n";
}

std::string fields_of(const TypeInfo& type) {
  const auto description = type.page.publishes != nullptr ? type.page.publishes() : nullptr;
  if (description == nullptr) return {};
  Table table({"field", "type", "unit"});
  for (const PublishedField& field : published_fields(*description)) table.add({field.name, field.type, field.unit});
  return std::string("\n  its events have") +
         (type.page.depends_on_parameters ? ", unless its parameters say otherwise,\n" : "\n") + table.text("  ");
}

enum class Page { short_one, whole };

std::string described(const TypeInfo& type, Page page) {
  Table table({"parameter", "type", "unit", "default", "meaning"});
  add_parameters(table, type.parameters, "", columns_of(STDOUT_FILENO));
  std::string text = type.name + "  " + type.doc + "\n";
  if (page == Page::whole) text += notes_of(type);
  if (!table.empty()) text += table.text("  ");
  if (page == Page::whole) text += fields_of(type);
  return text;
}

/// The `host` sensors that this machine has.
std::string on_this_machine() {
  std::string text = "  on this machine:\n";
  for (const HostSensorInfo& info : available_host_sensors()) {
    ConfigItem quantity;
    ConfigValue<HostQuantity>::write(info.quantity, quantity);
    text += "    " + *quantity.as_string();
    if (!info.device.empty()) text += ", device " + info.device;
    if (!info.name.empty() && info.name != info.device) text += " (" + info.name + ")";
    text += "\n";
  }
  return text;
}

/// One line for a type, at most 80 columns.
std::string line_of(const TypeInfo& type) {
  constexpr std::size_t name_width = 15, width = 80;
  std::string name = type.name;
  name.resize(std::max(name.size() + 1, name_width), ' ');
  return fitted("  " + name + type.doc, width) + "\n";
}

void print_lines(const Registry& registry) {
  for (const PartKind* kind : registry.kinds_to_show()) {
    std::vector<TypeInfo> types = kind->types.types();
    if (types.empty()) continue;
    std::sort(types.begin(), types.end(), [](const TypeInfo& a, const TypeInfo& b) { return a.name < b.name; });
    std::cout << kind->name << " types\n";
    for (const TypeInfo& type : types) std::cout << line_of(type);
    std::cout << "\n";
  }
  std::cout << "rtdata types NAME shows the parameters of one; a chip or a word is a NAME too:\n"
               "bme280, pt100, button, csv. rtdata types --all shows all parameters."
            << std::endl;
}

/// Prints the types for a chip or search word: a page for one type, otherwise one line each. False: no match.
bool print_types_for(const std::string& word, const Registry& registry) {
  std::vector<TypeInfo> found;  // the best match of each kind: csv is a format of serial lines and of files
  for (const PartKind* kind : registry.kinds_to_show()) {
    const std::vector<TypeInfo> types = kind->types.types();
    for (const std::size_t i : types_for_word(types, word)) found.push_back(types[i]);
  }
  if (found.size() == 1) {
    const TypeInfo& type = found[0];
    const WordFound where = find_word(type, word);
    std::cout << word << ": type " << type.name
              << (where.key.empty() ? "" : ", with \"" + where.key + "\": \"" + where.choice + "\"") << "\n\n"
              << described(type, Page::whole);
  } else if (!found.empty()) {
    std::cout << "types for " << word << "\n";
    for (const TypeInfo& type : found) std::cout << line_of(type);
    std::cout << "\nrtdata types NAME shows the parameters of one." << std::endl;
  }
  return !found.empty();
}

void print_all(const std::string& title, const std::vector<TypeInfo>& types) {
  std::cout << title << "\n\n";
  for (const TypeInfo& type : types) std::cout << described(type, Page::short_one) << "\n";
}

}  // namespace

int types(const Registry& registry, const std::string& name, TypesAs format) {
  if (name.empty() && format == TypesAs::text) {
    print_lines(registry);
    return exit_good;
  }
  if (name.empty() && format != TypesAs::all) {
    std::cout << (format == TypesAs::schema ? registry.schema() + "\n" : markdown_of(registry)) << std::flush;
    return exit_good;
  }
  if (name.empty()) {
    for (const PartKind* kind : registry.kinds_to_show())
      if (const auto types = kind->types.types(); !types.empty()) print_all(kind->name + " types", types);
    std::cout << "formats of events\n\n ";
    for (const std::string& codec : CodecRegistry::standard().names()) std::cout << " " << codec;
    std::cout << "\n\nformats of configuration files\n\n ";
    for (const std::string& extension : ConfigFormats().extensions())
      std::cout << " " << (extension.empty() ? "(none)" : extension);
    std::cout << std::endl;
    return exit_good;
  }
  std::vector<std::string> names;
  int found = 0;
  for (const PartKind& kind : registry.kinds()) {
    for (const TypeInfo& type : kind.types.types()) {
      names.push_back(type.name);
      if (type.name != name) continue;
      ++found;
      std::cout << (format == TypesAs::schema     ? type.schema() + "\n"
                    : format == TypesAs::markdown ? markdown_of(type)
                                                  : described(type, Page::whole));
      if (format != TypesAs::schema && format != TypesAs::markdown && kind.name == "sensor" && name == "host")
        std::cout << on_this_machine();
    }
  }
  if (found > 0) return exit_good;
  for (const PartKind& kind : registry.kinds()) {
    const std::string* why = kind.types.why_left_out(name);
    if (why == nullptr) continue;
    print_error(std::cerr, "there is no type \"" + name + "\": " + *why, "unknown-type");
    return exit_other;
  }
  if (format == TypesAs::text && print_types_for(name, registry)) return exit_good;
  const std::string nearest = nearest_name(name, names);
  print_error(std::cerr,
              "there is no type \"" + name + "\"" + (nearest.empty() ? "" : " (did you mean \"" + nearest + "\"?)") +
                  "; `rtdata types` lists all",
              "unknown-type");
  return exit_other;
}

}  // namespace rtdata::app
