/// ConfigValue: how each type is read from a configuration item and written to one.
///
/// `ConfigItem::get`, `ConfigItem::set` and parameter lists all go through it. `read` returns false if the item does
/// not hold such a value, and adds at least one problem, for a list all of them; `out` is then unspecified. Specialise
/// it for a type of your own:
///
///     template <> struct rtdata::ConfigValue<Colour> {
///       static bool read(const ConfigItem& item, Colour& out, Problems& problems);
///       static void write(const Colour& value, ConfigItem& item);
///     };
///
/// What is read from what:
/// - bool from true and false only;
/// - an integer from a whole number in its range; 3.0 and 1e3 are whole, 3.7 is not;
/// - float and double from any number that is not too large for them, and from an integer only when it is exact;
/// - char from a string of one byte; strings from strings;
/// - durations and rates from strings with a unit, "10 ms", "100 Hz"; a duration that its type cannot hold exactly is
/// an
///   error (1500 us as milliseconds);
/// - an enumeration with a `describe` from the name of a value;
/// - std::optional from null or its value; std::array, std::vector, std::deque, std::list from an array;
///   std::map and std::unordered_map with string keys from an object; ConfigItem from anything, as it is.
///
/// Any thread.
#pragma once

#include <array>
#include <chrono>
#include <concepts>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "rtdata/data/config_item.hpp"
#include "rtdata/data/describe.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata {

/// The allowed values of a setting that is a text or a whole number, for the schema:
///
///     template <>
///     struct rtdata::ConfigValue<Address> {
///       static constexpr TextOrNumber accepts{8, 119, "^0x[0-7][0-9a-f]$"};  // "0x76", or 118
///       static bool read(const ConfigItem&, Address&, Problems&);
///       static void write(const Address&, ConfigItem&);
///     };
struct TextOrNumber {
  double least, most;        ///< of a whole number
  std::string_view pattern;  ///< of a text: a regular expression of JSON Schema
};

namespace config_detail {

bool read_boolean(const ConfigItem& item, bool& out, Problems& problems);
bool read_signed(const ConfigItem& item, std::int64_t least, std::int64_t most, std::int64_t& out, Problems& problems);
bool read_unsigned(const ConfigItem& item, std::uint64_t most, std::uint64_t& out, Problems& problems);
bool read_float(const ConfigItem& item, float& out, Problems& problems);
bool read_double(const ConfigItem& item, double& out, Problems& problems);
bool read_string(const ConfigItem& item, std::string_view& out, Problems& problems);
bool read_character(const ConfigItem& item, char& out, Problems& problems);
/// `sign`: says if the duration may be negative.
enum class Sign { positive, any };
bool read_duration(const ConfigItem& item, Duration& out, Sign sign, Problems& problems);
bool read_rate(const ConfigItem& item, Rate& out, Problems& problems);
/// The index of the item's text in `names`; -1, with a problem, if it is not one of them.
int choose(const ConfigItem& item, const std::vector<std::string>& names, Problems& problems);
bool check_is_array(const ConfigItem& item, Problems& problems);
bool check_is_object(const ConfigItem& item, Problems& problems);
bool check_length(const ConfigItem& item, std::size_t length, Problems& problems);
void add_inexact_duration(const ConfigItem& item, Problems& problems);

template <class T>
inline constexpr bool always_false = false;

template <class T>
concept Integer = std::integral<T> && !std::same_as<T, bool> && !std::same_as<T, char> && !std::same_as<T, wchar_t> &&
                  !std::same_as<T, char8_t> && !std::same_as<T, char16_t> && !std::same_as<T, char32_t>;

template <class T>
concept List = !std::is_convertible_v<T, std::string_view> && requires(T list, typename T::value_type value) {
  list.clear();
  list.push_back(value);
  list.begin();
};

template <class T>
concept Map = std::same_as<typename T::key_type, std::string> && requires(T map, typename T::mapped_type value) {
  map.clear();
  map.emplace(std::string(), value);
};

template <class T>
inline constexpr bool is_std_array = false;
template <class T, std::size_t N>
inline constexpr bool is_std_array<std::array<T, N>> = true;
template <class T>
inline constexpr bool is_optional = false;
template <class T>
inline constexpr bool is_optional<std::optional<T>> = true;

}  // namespace config_detail

template <class T>
struct ConfigValue {
  static_assert(
      config_detail::always_false<T>,
      "a configuration item cannot be read as this type: use a standard type, or specialise rtdata::ConfigValue");
  static bool read(const ConfigItem&, T&, Problems&);
  static void write(const T&, ConfigItem&);
};

template <>
struct ConfigValue<bool> {
  static bool read(const ConfigItem& item, bool& out, Problems& problems) {
    return config_detail::read_boolean(item, out, problems);
  }
  static void write(bool value, ConfigItem& item) { item.set_boolean(value); }
};

template <config_detail::Integer T>
struct ConfigValue<T> {
  static bool read(const ConfigItem& item, T& out, Problems& problems) {
    using Limits = std::numeric_limits<T>;
    if constexpr (std::is_signed_v<T>) {
      std::int64_t value = 0;
      if (!config_detail::read_signed(item, Limits::min(), Limits::max(), value, problems)) return false;
      out = static_cast<T>(value);
    } else {
      std::uint64_t value = 0;
      if (!config_detail::read_unsigned(item, Limits::max(), value, problems)) return false;
      out = static_cast<T>(value);
    }
    return true;
  }
  static void write(T value, ConfigItem& item) {
    if constexpr (std::is_signed_v<T>)
      item.set_integer(static_cast<std::int64_t>(value));
    else
      item.set_integer(static_cast<std::uint64_t>(value));
  }
};

template <>
struct ConfigValue<double> {
  static bool read(const ConfigItem& item, double& out, Problems& problems) {
    return config_detail::read_double(item, out, problems);
  }
  static void write(double value, ConfigItem& item) { item.set_number(value); }
};

template <>
struct ConfigValue<float> {
  static bool read(const ConfigItem& item, float& out, Problems& problems) {
    return config_detail::read_float(item, out, problems);
  }
  static void write(float value, ConfigItem& item);  ///< the shortest decimals that read back as this float
};

template <>
struct ConfigValue<char> {
  static bool read(const ConfigItem& item, char& out, Problems& problems) {
    return config_detail::read_character(item, out, problems);
  }
  static void write(char value, ConfigItem& item) { item.set_string(std::string_view(&value, 1)); }
};

template <>
struct ConfigValue<std::string_view> {
  static bool read(const ConfigItem& item, std::string_view& out, Problems& problems) {
    return config_detail::read_string(item, out, problems);
  }
  static void write(std::string_view value, ConfigItem& item) { item.set_string(value); }
};

template <>
struct ConfigValue<std::string> {
  static bool read(const ConfigItem& item, std::string& out, Problems& problems) {
    std::string_view text;
    if (!config_detail::read_string(item, text, problems)) return false;
    out = text;
    return true;
  }
  static void write(const std::string& value, ConfigItem& item) { item.set_string(value); }
};

template <class Rep, class Period>
struct ConfigValue<std::chrono::duration<Rep, Period>> {
  using Span = std::chrono::duration<Rep, Period>;
  static bool read(const ConfigItem& item, Span& out, Problems& problems) {
    Duration exact{};
    if (!config_detail::read_duration(item, exact, config_detail::Sign::any, problems)) return false;
    out = std::chrono::duration_cast<Span>(exact);
    if (std::chrono::treat_as_floating_point_v<Rep> || std::chrono::duration_cast<Duration>(out) == exact) return true;
    config_detail::add_inexact_duration(item, problems);
    return false;
  }
  static void write(Span value, ConfigItem& item) {
    item.set_string(to_string(std::chrono::duration_cast<Duration>(value)));
  }
};

template <>
struct ConfigValue<Rate> {
  static bool read(const ConfigItem& item, Rate& out, Problems& problems) {
    return config_detail::read_rate(item, out, problems);
  }
  static void write(Rate value, ConfigItem& item);  ///< "100 Hz", or its period; null for no rate
};

template <DescribedEnum T>
struct ConfigValue<T> {
  static bool read(const ConfigItem& item, T& out, Problems& problems) {
    const auto values = describe(type_tag<T>{}).values;
    std::vector<std::string> names;
    for (const auto& entry : values) names.emplace_back(entry.name);
    const int index = config_detail::choose(item, names, problems);
    if (index < 0) return false;
    out = values[static_cast<std::size_t>(index)].value;
    return true;
  }
  /// A number without a name becomes null.
  static void write(T value, ConfigItem& item) {
    item.set_null();
    for (const auto& entry : describe(type_tag<T>{}).values)
      if (entry.value == value) item.set_string(entry.name);
  }
};

template <>
struct ConfigValue<ConfigItem> {
  static bool read(const ConfigItem& item, ConfigItem& out, Problems&) {
    out = item;
    return true;
  }
  static void write(const ConfigItem& value, ConfigItem& item) { item.set_item(value); }
};

template <class T>
struct ConfigValue<std::optional<T>> {
  static bool read(const ConfigItem& item, std::optional<T>& out, Problems& problems) {
    out.reset();
    if (item.is_null()) return true;
    return ConfigValue<T>::read(item, out.emplace(), problems);
  }
  static void write(const std::optional<T>& value, ConfigItem& item) {
    if (value)
      item.set(*value);
    else
      item.set_null();
  }
};

template <class T, std::size_t N>
struct ConfigValue<std::array<T, N>> {
  static bool read(const ConfigItem& item, std::array<T, N>& out, Problems& problems) {
    if (!config_detail::check_is_array(item, problems) || !config_detail::check_length(item, N, problems)) return false;
    bool good = true;
    for (std::size_t i = 0; i < N; ++i) good = ConfigValue<T>::read(*item.find(i), out[i], problems) && good;
    return good;
  }
  static void write(const std::array<T, N>& value, ConfigItem& item) {
    item.set_item(ConfigItem::array());
    for (const T& element : value) item.push_back(element);
  }
};

template <config_detail::List T>
struct ConfigValue<T> {
  static bool read(const ConfigItem& item, T& out, Problems& problems) {
    out.clear();
    if (!config_detail::check_is_array(item, problems)) return false;
    bool good = true;
    for (const auto& child : item.children()) {
      typename T::value_type element{};
      good = ConfigValue<typename T::value_type>::read(child.item, element, problems) && good;
      out.push_back(std::move(element));
    }
    return good;
  }
  static void write(const T& value, ConfigItem& item) {
    item.set_item(ConfigItem::array());
    for (const typename T::value_type& element : value) item.push_back(element);
  }
};

template <config_detail::Map T>
struct ConfigValue<T> {
  static bool read(const ConfigItem& item, T& out, Problems& problems) {
    out.clear();
    if (!config_detail::check_is_object(item, problems)) return false;
    bool good = true;
    for (const auto& child : item.children()) {
      typename T::mapped_type value{};
      good = ConfigValue<typename T::mapped_type>::read(child.item, value, problems) && good;
      out.emplace(child.key, std::move(value));
    }
    return good;
  }
  static void write(const T& value, ConfigItem& item) {
    item.set_item(ConfigItem::object());
    for (const auto& [key, element] : value) item.set(key, element);
  }
};

}  // namespace rtdata
