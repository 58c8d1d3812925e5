/// read_config: from a configuration item to a component's `Config`, by its parameters.
///
///     rtdata::Problems problems;
///     UartConfig config;
///     if (!rtdata::read_config(item, config, problems)) show(problems);   // all mistakes
///
///     auto good = rtdata::read_config<UartConfig>(item);                  // or throws ConfigError with all of them
///     for (const rtdata::ParameterInfo& p : rtdata::parameters_of<UartConfig>()) std::cout << p.key << "\n";
///     std::cout << rtdata::schema_of<UartConfig>("uart", "a serial line");
///
/// It reports unknown keys (with the nearest known one), missing required keys, and values of the wrong type, out of
/// range, of the wrong length or not among the choices. Rules over several parameters (a minimum below a maximum) go
/// into a function next to the Config, which is called if everything else is right:
///
///     void check_config(const UartConfig& config, const rtdata::ConfigItem& item, rtdata::Problems& problems);
///
/// Functions without state; any thread.
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include "rtdata/data/config_item.hpp"
#include "rtdata/data/config_value.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/detail/config/parameter_info.hpp"

namespace rtdata {

/// What to do with keys that no parameter has.
enum class UnknownKeys { report, ignore };

/// The compiler makes one table for each Config and one ValueKind for each member type. The code that reads, writes and
/// lists the values is the same for all (src/config/read/parameter_table.cpp).
namespace config_detail {

/// The rules of a parameter, with their texts.
struct RulesOf {
  const ParameterRules& rules;
  const Word* words;
  std::span<const Word> range(WordRange part) const { return {words + part.first, part.count}; }
  std::span<const Word> choices() const { return range(rules.choices); }
};

/// The parameters of a Config.
struct ParameterTable {
  std::span<const ParameterEntry> entries;
  const Word* words;
  using Owner = void* (*)(void* config);
  const Owner* owners;  ///< the base that each entry is a member of; null: all are members of the Config
  /// `check_config`; null: there is none.
  void (*check)(const void* config, const ConfigItem& item, Problems& problems);
  void* (*make)();  ///< a Config with its defaults
  void (*destroy)(void* config);
};
using TableOf = const ParameterTable& (*)();

struct ValueKind {
  ParameterType::Kind kind = ParameterType::Kind::any;
  /// False, with problems, if the item does not hold such a value.
  bool (*read)(const ConfigItem& item, void* out, const RulesOf& rules, Problems& problems);
  void (*write)(const void* value, const RulesOf& rules, ConfigItem& item);
  const ValueKind& (*element)() = nullptr;  ///< of an optional, list or map
  TableOf table = nullptr;                  ///< of an object
  bool is_optional = false;
  std::size_t length = 0;              ///< of a list; 0: any
  std::span<const Word> choices = {};  ///< of an enumeration with a `describe`
  bool has_least = false, has_most = false;
  double least = 0, most = 0;
  std::string_view pattern = {};  ///< of a text_or_integer
};

/// A Config with the table of its parameters.
struct ConfigPart {
  const ParameterTable* table;
  void* config;
};
/// Reads an object into several Configs, as if they were one.
bool read_object(std::span<const ConfigPart> parts, const ConfigItem& item, UnknownKeys unknown,
                 const std::vector<std::string>& others, Problems& problems);
void write_object(const ParameterTable& table, const void* config, ConfigItem& item);
std::vector<ParameterInfo> list_parameters(const ParameterTable& table);
std::shared_ptr<void> make_config(const ParameterTable& table);

bool read_choice(const ConfigItem& item, std::span<const Word> choices, std::int64_t& out, Problems& problems);
void write_choice(std::int64_t value, std::span<const Word> choices, ConfigItem& item);
/// A text, or one of the choices if there are any.
bool read_text(const ConfigItem& item, std::string& out, const RulesOf& rules, Problems& problems);
bool check_number(const ConfigItem& item, double value, const ParameterRules& rules, Problems& problems);
bool check_duration(const ConfigItem& item, Duration value, const ParameterRules& rules, Problems& problems);
bool check_rate(const ConfigItem& item, Rate value, const ParameterRules& rules, Problems& problems);

template <class T>
inline constexpr std::span<const Word> choices_of = {};
template <DescribedEnum T>
inline constexpr auto choice_words = [] {
  constexpr auto values = describe(type_tag<T>{}).values;
  std::array<Word, values.size()> words{};
  for (std::size_t i = 0; i < values.size(); ++i)
    words[i] = {values[i].name, static_cast<std::int64_t>(values[i].value)};
  return words;
}();
template <DescribedEnum T>
inline constexpr std::span<const Word> choices_of<T> = choice_words<T>;

template <class T, class Owner>
void* owner_of(void* config) {
  if constexpr (std::is_same_v<T, Owner>)
    return config;
  else
    return std::addressof(static_cast<Owner&>(*static_cast<T*>(config)));
}

template <class T, class... Owners>
inline constexpr std::array<ParameterTable::Owner, sizeof...(Owners)> owners_of{&owner_of<T, Owners>...};

template <class T, std::size_t Words, class... Owners>
constexpr ParameterTable make_table(const ParameterList<Words, Owners...>& list) {
  ParameterTable table{{list.entries.data(), sizeof...(Owners)},
                       list.words.data(),
                       nullptr,
                       nullptr,
                       [] { return static_cast<void*>(new T{}); },
                       [](void* config) { delete static_cast<T*>(config); }};
  if constexpr (!(std::is_same_v<T, Owners> && ...)) table.owners = owners_of<T, Owners...>.data();
  if constexpr (requires(const T& config, const ConfigItem& item, Problems& problems) {
                  check_config(config, item, problems);
                }) {
    table.check = [](const void* config, const ConfigItem& item, Problems& problems) {
      check_config(*static_cast<const T*>(config), item, problems);
    };
  }
  return table;
}
template <class T>
const ParameterTable& table_of() {
  static const auto list = parameters(type_tag<T>{});
  static const ParameterTable table = make_table<T>(list);
  return table;
}

template <class T>
struct ValueOf {
  static bool read(const ConfigItem& item, void* out, const RulesOf& rules, Problems& problems) {
    T& value = *static_cast<T*>(out);
    if constexpr (is_optional<T>) {
      value.reset();
      return item.is_null() || ValueOf<typename T::value_type>::read(item, &value.emplace(), rules, problems);
    } else if constexpr (is_std_array<T>) {
      if (!check_is_array(item, problems) || !check_length(item, value.size(), problems)) return false;
      bool good = true;
      for (std::size_t i = 0; i < value.size(); ++i)
        good = ValueOf<typename T::value_type>::read(*item.find(i), &value[i], rules, problems) && good;
      return good;
    } else if constexpr (List<T>) {
      value.clear();
      if (!check_is_array(item, problems)) return false;
      bool good = true;
      for (const ConfigChild& child : item.children()) {
        typename T::value_type element{};
        good = ValueOf<typename T::value_type>::read(child.item, &element, rules, problems) && good;
        value.push_back(std::move(element));
      }
      return good;
    } else if constexpr (Map<T>) {
      value.clear();
      if (!check_is_object(item, problems)) return false;
      bool good = true;
      for (const ConfigChild& child : item.children()) {
        typename T::mapped_type element{};
        good = ValueOf<typename T::mapped_type>::read(child.item, &element, rules, problems) && good;
        value.emplace(child.key, std::move(element));
      }
      return good;
    } else if constexpr (Configurable<T>) {
      const ConfigPart part{&table_of<T>(), out};
      return read_object({&part, 1}, item, UnknownKeys::report, {}, problems);
    } else if constexpr (std::is_enum_v<T>) {
      std::int64_t chosen = 0;
      const auto choices = rules.choices().empty() ? choices_of<T> : rules.choices();
      if (!read_choice(item, choices, chosen, problems)) return false;
      value = static_cast<T>(chosen);
      return true;
    } else if constexpr (std::is_same_v<T, std::string>) {
      return read_text(item, value, rules, problems);
    } else {
      if (!ConfigValue<T>::read(item, value, problems)) return false;
      if constexpr (std::is_same_v<T, Rate>)
        return check_rate(item, value, rules.rules, problems);
      else if constexpr (is_duration<T>)
        return check_duration(item, std::chrono::duration_cast<Duration>(value), rules.rules, problems);
      else if constexpr (quantity_of<T>() == Quantity::number)
        return check_number(item, static_cast<double>(value), rules.rules, problems);
      else
        return true;
    }
  }

  static void write(const void* in, const RulesOf& rules, ConfigItem& item) {
    const T& value = *static_cast<const T*>(in);
    if constexpr (is_optional<T>) {
      if (value)
        ValueOf<typename T::value_type>::write(&*value, rules, item);
      else
        item.set_null();
    } else if constexpr (is_std_array<T> || List<T>) {
      item.set_item(ConfigItem::array());
      for (const typename T::value_type& element : value)
        ValueOf<typename T::value_type>::write(&element, rules, item.push_back(nullptr));
    } else if constexpr (Map<T>) {
      item.set_item(ConfigItem::object());
      for (const auto& [key, element] : value) {
        item.set(key, nullptr);
        ValueOf<typename T::mapped_type>::write(&element, rules, *item.find(key));
      }
    } else if constexpr (Configurable<T>) {
      write_object(table_of<T>(), in, item);
    } else if constexpr (std::is_enum_v<T>) {
      write_choice(static_cast<std::int64_t>(value), rules.choices().empty() ? choices_of<T> : rules.choices(), item);
    } else {
      item.set(value);
    }
  }

  static constexpr ValueKind kind() {
    using Kind = ParameterType::Kind;
    ValueKind kind{Kind::any, &read, &write};
    if constexpr (is_optional<T>) {
      kind.is_optional = true;
      kind.element = &value_kind<typename T::value_type>;
    } else if constexpr (is_std_array<T> || List<T>) {
      kind.kind = Kind::list;
      if constexpr (is_std_array<T>) kind.length = std::tuple_size_v<T>;
      kind.element = &value_kind<typename T::value_type>;
    } else if constexpr (Map<T>) {
      kind.kind = Kind::map;
      kind.element = &value_kind<typename T::mapped_type>;
    } else if constexpr (Configurable<T>) {
      kind.kind = Kind::object;
      kind.table = &table_of<T>;
    } else if constexpr (std::is_enum_v<T>) {
      kind.kind = Kind::choice;
      kind.choices = choices_of<T>;
    } else if constexpr (std::is_same_v<T, bool>) {
      kind.kind = Kind::boolean;
    } else if constexpr (std::is_same_v<T, char>) {
      kind.kind = Kind::character;
    } else if constexpr (std::is_same_v<T, std::string>) {
      kind.kind = Kind::string;
    } else if constexpr (std::is_same_v<T, Rate>) {
      kind.kind = Kind::rate;
    } else if constexpr (is_duration<T>) {
      kind.kind = Kind::duration;
    } else if constexpr (std::is_floating_point_v<T>) {
      kind.kind = Kind::number;
    } else if constexpr (Integer<T>) {
      kind.kind = Kind::integer;
      kind.has_most = sizeof(T) <= 4;  // the limits of larger types do not help in a message
      kind.has_least = kind.has_most || std::is_unsigned_v<T>;
      if (kind.has_least) kind.least = static_cast<double>(std::numeric_limits<T>::min());
      if (kind.has_most) kind.most = static_cast<double>(std::numeric_limits<T>::max());
    } else if constexpr (requires { ConfigValue<T>::accepts; }) {
      constexpr TextOrNumber accepts = ConfigValue<T>::accepts;
      kind.kind = Kind::text_or_integer;
      kind.has_least = kind.has_most = true;
      kind.least = accepts.least;
      kind.most = accepts.most;
      kind.pattern = accepts.pattern;
    }
    return kind;
  }
};

template <class T>
const ValueKind& value_kind() {
  static constexpr ValueKind kind = ValueOf<T>::kind();
  return kind;
}

}  // namespace config_detail

/// Reads an item into a Config. Returns true without mistakes; otherwise adds all mistakes to `problems`, and the
/// values of those members are unspecified. Members without a key in the item stay as they are. `others`: further keys
/// that are allowed because other code reads them.
template <Configurable T>
bool read_config(const ConfigItem& item, T& out, Problems& problems, UnknownKeys unknown = UnknownKeys::report,
                 const std::vector<std::string>& others = {}) {
  const config_detail::ConfigPart part{&config_detail::table_of<T>(), &out};
  return config_detail::read_object({&part, 1}, item, unknown, others, problems);
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
  config_detail::write_object(config_detail::table_of<T>(), &config, item);
  return item;
}

/// Every parameter of T, in the order of its declaration.
template <Configurable T>
std::vector<ParameterInfo> parameters_of() {
  return config_detail::list_parameters(config_detail::table_of<T>());
}

/// The JSON Schema (draft-07) of T.
template <Configurable T>
std::string schema_of(std::string_view title, std::string_view doc) {
  return schema(parameters_of<T>(), title, doc);
}

/// True if the item is a reference to a secret: a text that is read from elsewhere and never shown.
///
///     {"type": "...", "password": {"env": "BROKER_PASSWORD"}}
///     {"type": "...", "token": {"file": "/run/credentials/token"}}
///
/// Any text parameter may be a reference, except those that are stored in recordings. Reading the configuration
/// resolves it, which may block on the file system; a line end at the end of the file is removed. A recorded
/// configuration keeps the reference, not the secret; errors, the log and the status show "(secret)" instead
/// (Runtime::Config::secrets). A secret shorter than 4 bytes is not hidden, because it would match everywhere.
///
/// Errors: cannot-resolve (no such variable, file, or nothing in it), not-a-secret (a parameter that recordings hold).
///
/// An object with one key, "env" or "file".
bool is_secret_reference(const ConfigItem& item) noexcept;
/// Reads the secret. Returns false, with a problem, if it cannot be read.
bool resolve_secret(const ConfigItem& reference, std::string& out, Problems& problems);
/// The text with each of the secrets, of at least 4 bytes, replaced by "(secret)".
std::string hide_secrets(std::string text, const std::vector<std::string>& secrets);

}  // namespace rtdata
