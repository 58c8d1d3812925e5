/// read_config: from a configuration item to a component's `Config`, by its parameters.
///
///     Problems problems;
///     UartConfig config;
///     if (!read_config(item, config, problems)) ...   // every mistake is in `problems`
///
///     auto config = read_config<UartConfig>(item);      // or throws ConfigError with all of them
///     for (const ParameterInfo& p : parameters_of<UartConfig>()) ...
///     std::cout << schema_of<UartConfig>("uart", "a serial line");
///
/// Reported are: unknown keys (with the nearest known one), required keys that are missing, values of the wrong type,
/// out of range, of the wrong length or not among the choices. What one parameter cannot say by itself (a minimum below
/// a maximum) goes into a function beside the Config, which is called when everything else is right:
///
///     void check_config(const UartConfig& config, const ConfigItem& item, Problems& problems);
///
/// Any thread.
#pragma once

#include <algorithm>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "rtdata/config/parameter_info.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/data/text_or_number.hpp"

namespace rtdata {

/// What to do with keys that no parameter has.
enum class UnknownKeys { report, ignore };

namespace config_detail {

bool check_number(const ConfigItem& item, double value, const ParameterRules& rules, Problems& problems);
bool check_duration(const ConfigItem& item, Duration value, const ParameterRules& rules, Problems& problems);
bool check_rate(const ConfigItem& item, Rate value, const ParameterRules& rules, Problems& problems);
bool read_text(const ConfigItem& item, std::string& out, const ParameterRules& rules, Problems& problems);
struct KnownKey {
  std::string_view key;
  std::string_view doc;
  bool required;
};
/// Reports unknown and missing keys.
bool check_keys(const ConfigItem& item, const std::vector<KnownKey>& known, UnknownKeys unknown, Problems& problems);

template <class E, std::size_t N>
std::vector<std::string> names_of(const std::array<ValueSpec<E>, N>& choices) {
  std::vector<std::string> names;
  for (const auto& choice : choices) names.emplace_back(choice.name);
  return names;
}
template <std::size_t N>
std::vector<std::string> names_of(const std::array<std::string_view, N>& choices) {
  return {choices.begin(), choices.end()};
}

/// The choices of a value: those of its parameter, or of its enumeration.
template <class T, class Choices>
constexpr auto choices_of(const Choices& choices) {
  if constexpr (!std::is_same_v<Choices, NoChoices>)
    return choices;
  else if constexpr (DescribedEnum<T>)
    return describe(type_tag<T>{}).values;
  else
    return NoChoices{};
}

template <class T>
bool read_object(const ConfigItem& item, T& out, UnknownKeys unknown, const std::vector<KnownKey>& others,
                 Problems& problems);

template <class T, class Choices>
bool read_member(const ConfigItem& item, T& out, const ParameterRules& rules, const Choices& choices,
                 Problems& problems) {
  if constexpr (is_optional<T>) {
    out.reset();
    return item.is_null() || read_member(item, out.emplace(), rules, choices, problems);
  } else if constexpr (is_std_array<T>) {
    if (!check_is_array(item, problems) || !check_length(item, out.size(), problems)) return false;
    bool good = true;
    for (std::size_t i = 0; i < out.size(); ++i)
      good = read_member(*item.find(i), out[i], rules, choices, problems) && good;
    return good;
  } else if constexpr (List<T>) {
    out.clear();
    bool good = check_is_array(item, problems);
    for (const auto& child : item.children()) {
      if (!item.is_array()) break;
      typename T::value_type element{};
      good = read_member(child.item, element, rules, choices, problems) && good;
      out.push_back(std::move(element));
    }
    return good;
  } else if constexpr (Map<T>) {
    out.clear();
    bool good = check_is_object(item, problems);
    for (const auto& child : item.children()) {
      if (!item.is_object()) break;
      typename T::mapped_type value{};
      good = read_member(child.item, value, rules, choices, problems) && good;
      out.emplace(child.key, std::move(value));
    }
    return good;
  } else if constexpr (Configurable<T>) {
    return read_object(item, out, UnknownKeys::report, {}, problems);
  } else if constexpr (!std::is_same_v<decltype(choices_of<T>(choices)), NoChoices>) {
    const auto table = choices_of<T>(choices);
    const int index = choose(item, names_of(table), problems);
    if (index < 0) return false;
    if constexpr (std::is_enum_v<T>)
      out = table[static_cast<std::size_t>(index)].value;
    else
      out = table[static_cast<std::size_t>(index)];
    return true;
  } else {
    static_assert(
        !std::is_enum_v<T> || DescribedEnum<T>,
        "rtdata: a parameter is an enumeration without names: give it a `describe`, or the parameter `choices`");
    if constexpr (std::is_same_v<T, std::string>) return read_text(item, out, rules, problems);
    if (!ConfigValue<T>::read(item, out, problems)) return false;
    if constexpr (std::is_same_v<T, Rate>)
      return check_rate(item, out, rules, problems);
    else if constexpr (is_duration<T>)
      return check_duration(item, std::chrono::duration_cast<Duration>(out), rules, problems);
    else if constexpr (quantity_of<T>() == Quantity::number)
      return check_number(item, static_cast<double>(out), rules, problems);
    else
      return true;
  }
}

/// Calls `use(object, parameter)` for every parameter of T, those it includes as well, in order.
template <class T, class Use>
void for_each_parameter(T& object, const Use& use) {
  const auto visit = [&]<class Entry>(const Entry& entry) {
    if constexpr (requires { entry.key; })
      use(object, entry);
    else if constexpr (requires { entry.member; })
      for_each_parameter(object.*entry.member, use);
    else
      [&]<class Base>(const IncludedBase<Base>&) {
        if constexpr (std::is_const_v<T>)
          for_each_parameter(static_cast<const Base&>(object), use);
        else
          for_each_parameter(static_cast<Base&>(object), use);
      }(entry);
  };
  std::apply([&](const auto&... entry) { (visit(entry), ...); },
             parameters(type_tag<std::remove_const_t<T>>{}).entries);
}

template <class T>
bool read_object(const ConfigItem& item, T& out, UnknownKeys unknown, const std::vector<KnownKey>& others,
                 Problems& problems) {
  if (!check_is_object(item, problems)) return false;
  std::vector<KnownKey> known = others;
  for_each_parameter(out, [&](auto&, const auto& parameter) {
    known.push_back({parameter.key, parameter.doc, parameter.rules.required});
  });
  bool good = check_keys(item, known, unknown, problems);
  const auto children = item.children();
  for_each_parameter(out, [&](auto& object, const auto& parameter) {
    const auto child = std::find_if(children.begin(), children.end(),
                                    [&](const auto& c) { return c.key == parameter.key; });
    if (child == children.end()) return;
    good = read_member(child->item, object.*parameter.member, parameter.rules, parameter.choices, problems) && good;
  });
  if constexpr (requires { check_config(std::as_const(out), item, problems); }) {
    if (good) {
      const std::size_t before = problems.size();
      check_config(std::as_const(out), item, problems);
      good = problems.size() == before;
    }
  }
  return good;
}

template <class T, class Choices>
void write_member(const T& value, const Choices& choices, ConfigItem& item) {
  if constexpr (is_optional<T>) {
    if (value)
      write_member(*value, choices, item);
    else
      item.set_null();
  } else if constexpr (is_std_array<T> || List<T>) {
    item.set_item(ConfigItem::array());
    for (const typename T::value_type& element : value) write_member(element, choices, item.push_back(nullptr));
  } else if constexpr (Map<T>) {
    item.set_item(ConfigItem::object());
    for (const auto& [key, element] : value) {
      item.set(key, nullptr);
      write_member(element, choices, *item.find(key));
    }
  } else if constexpr (Configurable<T>) {
    item.set_item(ConfigItem::object());
    for_each_parameter(value, [&](const auto& object, const auto& parameter) {
      ConfigItem child;
      write_member(object.*parameter.member, parameter.choices, child);
      if (!child.is_null()) item.set(parameter.key, child);
    });
  } else if constexpr (std::is_enum_v<T>) {
    for (const auto& choice : choices_of<T>(choices))
      if (choice.value == value) item.set(choice.name);
  } else {
    item.set(value);
  }
}

template <class T>
std::vector<ParameterInfo> list_parameters();

template <class T, class Choices>
ParameterType type_of(const ParameterRules& rules, const Choices& choices) {
  using Kind = ParameterType::Kind;
  ParameterType type;
  if constexpr (is_optional<T>) {
    type = type_of<typename T::value_type>(rules, choices);
    type.nullable = true;
  } else if constexpr (is_std_array<T> || List<T>) {
    type.kind = Kind::list;
    if constexpr (is_std_array<T>) type.length = std::tuple_size_v<T>;
    type.element.push_back(type_of<typename T::value_type>(rules, choices));
  } else if constexpr (Map<T>) {
    type.kind = Kind::map;
    type.element.push_back(type_of<typename T::mapped_type>(rules, choices));
  } else if constexpr (Configurable<T>) {
    type.kind = Kind::object;
    type.members = list_parameters<T>();
  } else if constexpr (!std::is_same_v<decltype(choices_of<T>(choices)), NoChoices>) {
    type.kind = Kind::choice;
    type.choices = names_of(choices_of<T>(choices));
  } else {
    if constexpr (std::is_same_v<T, bool>) type.kind = Kind::boolean;
    if constexpr (std::is_same_v<T, char>) type.kind = Kind::character;
    if constexpr (std::is_same_v<T, std::string>) type.kind = Kind::string;
    if constexpr (std::is_same_v<T, Rate>) type.kind = Kind::rate;
    if constexpr (std::is_floating_point_v<T>) type.kind = Kind::number;
    if constexpr (is_duration<T>) type.kind = Kind::duration;
    if constexpr (requires { ConfigValue<T>::accepts; }) {
      constexpr TextOrNumber accepts = ConfigValue<T>::accepts;
      type.kind = Kind::text_or_integer;
      type.least = accepts.least;
      type.most = accepts.most;
      type.pattern = accepts.pattern;
    }
    if constexpr (Integer<T>) {
      type.kind = Kind::integer;
      if constexpr (sizeof(T) <= 4) {  // the limits of larger ones are of no use in a message
        type.least = static_cast<double>(std::numeric_limits<T>::min());
        type.most = static_cast<double>(std::numeric_limits<T>::max());
      } else if constexpr (std::is_unsigned_v<T>) {
        type.least = 0.0;
      }
    }
    type.not_zero = rules.not_zero;
    type.may_be_negative = rules.negative;
    if constexpr (std::is_same_v<T, std::string>) {
      type.text = rules.text;
      type.not_empty = rules.required;
    }
    if (rules.has_least) type.least = rules.least;
    if (rules.has_most) type.most = rules.most;
  }
  return type;
}

template <class T>
std::vector<ParameterInfo> list_parameters() {
  std::vector<ParameterInfo> list;
  const T defaults{};
  for_each_parameter(defaults, [&](const auto& object, const auto& parameter) {
    using Member = std::remove_cvref_t<decltype(object.*parameter.member)>;
    ParameterInfo info;
    info.key = parameter.key;
    info.type = type_of<Member>(parameter.rules, parameter.choices);
    info.unit = parameter.rules.unit;
    info.required = parameter.rules.required;
    info.only_with = parameter.rules.only_with;
    info.names_part = parameter.rules.names_part;
    for (const std::string_view name : parameter.rules.placeholders)
      if (!name.empty()) info.placeholders.emplace_back(name);
    info.doc = parameter.doc;
    if (!info.required) write_member(object.*parameter.member, parameter.choices, info.default_value);
    list.push_back(std::move(info));
  });
  return list;
}

}  // namespace config_detail

/// Reads an item into a Config. True when there was no mistake; else all of them are added to `problems`, and the
/// members they are about are unspecified. Members whose keys are not there stay as they are. `others`: keys that are
/// known though no parameter of T, because other code reads them.
template <Configurable T>
bool read_config(const ConfigItem& item, T& out, Problems& problems, UnknownKeys unknown = UnknownKeys::report,
                 const std::vector<std::string>& others = {}) {
  std::vector<config_detail::KnownKey> known;
  for (const std::string& key : others) known.push_back({key, "", false});
  return config_detail::read_object(item, out, unknown, known, problems);
}

/// The same as a value; throws ConfigError with every mistake.
template <Configurable T>
T read_config(const ConfigItem& item) {
  T config{};
  Problems problems;
  if (!read_config(item, config, problems)) throw ConfigError(std::move(problems));
  return config;
}

/// An object that `read_config` reads as this Config; absent optionals are left out.
template <Configurable T>
ConfigItem write_config(const T& config) {
  ConfigItem item;
  config_detail::write_member(config, config_detail::NoChoices{}, item);
  return item;
}

/// Every parameter of T, in the order of its declaration.
template <Configurable T>
std::vector<ParameterInfo> parameters_of() {
  return config_detail::list_parameters<T>();
}

/// The JSON Schema (draft-07) of T.
template <Configurable T>
std::string schema_of(std::string_view title, std::string_view doc) {
  return schema(parameters_of<T>(), title, doc);
}

}  // namespace rtdata
