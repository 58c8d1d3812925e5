/// Parameters: declare once what a configurable component takes, beside its `Config`.
///
///     struct UartConfig {
///       std::string device;
///       std::uint32_t baud = 9600;
///       Parity parity = Parity::none;
///       Duration timeout = 100ms;
///       std::optional<double> scale;
///       friend constexpr auto parameters(rtdata::type_tag<UartConfig>) {
///         return rtdata::parameter_list(
///             rtdata::parameter("device", &UartConfig::device, "the serial device", rtdata::required),
///             rtdata::parameter("baud", &UartConfig::baud, "speed", rtdata::unit("Bd"), rtdata::range(50, 4000000)),
///             rtdata::parameter("parity", &UartConfig::parity, "parity bit"),   // an enumeration with a `describe`
///             rtdata::parameter("timeout", &UartConfig::timeout, "wait for an answer", rtdata::range(1ms, 1h)),
///             rtdata::parameter("scale", &UartConfig::scale, "factor"));
///       }
///     };
///
/// From it follow reading that reports every mistake (`read_config`), the list for people (`parameters_of`), the JSON
/// Schema (`schema_of`) and writing (`write_config`), all in read.hpp.
///
/// A member may be bool, char, an integer, float, double, std::string, Duration or another std::chrono duration, Rate,
/// an enumeration with a `describe` or with `choices`, a struct with `parameters` of its own, a ConfigItem (anything,
/// left for later), any type with a `ConfigValue`, and std::optional, std::array, std::vector, std::map<std::string,
/// ...> of these; unit, range and choices are then those of the elements. The `Config` is default constructible: what
/// it holds then are the defaults. Parameters of a base come with `include<Base>`, those of a member, without a level
/// of their own, with `include_member(&Config::member)`.
///
/// A text may be written as {"env": "NAME"} or {"file": "path"}: it is then taken from the environment or from a file,
/// and never shown; see secret.hpp. Not so one that recordings hold (TextIs: recorded, name, field, topic, unit), nor
/// permissions.
///
/// A mistake in a declaration is a compile error of one sentence. Values; any thread.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>
#include <tuple>
#include <type_traits>

#include "rtdata/data/config_value.hpp"
#include "rtdata/data/describe.hpp"

namespace rtdata {

/// What a text stands for, which says more about it than its type does. An option of `parameter`: a mistake in such a
/// text is reported when it is read, and the schema has a pattern for it. An empty text stands for none, where it need
/// not be there.
enum class TextIs : std::uint8_t {
  anything,
  recorded,       ///< written into recordings, such as notes
  name,           ///< of a sensor or sink: 1 to 200 characters, no control characters
  field,          ///< of a payload
  topic,          ///< see is_topic_name
  topic_pattern,  ///< see is_topic_pattern
  unit,           ///< UCUM; another one is a warning
  device,         ///< the path of what is opened
  output_file,    ///< the path of a file that is written: no folder, in a folder that is there
  permissions,    ///< of a file that is made, in octal digits: "0640"
};

/// The parameter means something only while another one, beside it, has one of these values.
struct OnlyWith {
  std::string_view key;  ///< empty: always
  std::array<std::string_view, 12> values{};
};

/// The text is the name of another part of the configuration, which must be there.
struct NamesPart {
  std::string_view kind;                    ///< "bus", "tier", "sink" ...; empty: it names no part
  std::array<std::string_view, 4> types{};  ///< that the part may be of; none: of any
};

/// What a value must keep to, without its type.
struct ParameterRules {
  bool required = false;  ///< a required text is not empty either
  bool not_zero = false;
  TextIs text = TextIs::anything;
  OnlyWith only_with;
  NamesPart names_part;
  std::array<std::string_view, 4> placeholders{};  ///< that may stand in the text, in braces
  bool negative = false;                           ///< a duration may be
  bool has_least = false;
  bool has_most = false;
  double least = 0;  ///< numbers as they are, durations in ns, rates in Hz
  double most = 0;
  std::string_view unit;
};

namespace config_detail {

struct Required {};
struct MayBeNegative {};
struct NotZero {};
struct Placeholders {
  std::array<std::string_view, 4> names;
};
struct Unit {
  std::string_view text;
};
enum class Quantity { number, duration, rate, none };
struct Range {
  Quantity quantity;
  bool has_least, has_most;
  double least, most;
};
/// Ranges carry their quantity in the type, so that a wrong one is found when compiling.
template <Quantity Q>
struct TypedRange : Range {};
struct NoChoices {};
template <class Base>
struct IncludedBase {};
template <class Owner, class Member>
struct IncludedMember {
  Member Owner::*member;
};

template <class T>
inline constexpr bool is_duration = false;
template <class Rep, class Period>
inline constexpr bool is_duration<std::chrono::duration<Rep, Period>> = true;

template <class T>
constexpr Quantity quantity_of() {
  if constexpr (std::is_same_v<T, Rate>)
    return Quantity::rate;
  else if constexpr (is_duration<T>)
    return Quantity::duration;
  else if constexpr (std::is_floating_point_v<T> || Integer<T>)
    return Quantity::number;
  else
    return Quantity::none;
}

template <class T>
constexpr double magnitude(const T& value) {
  if constexpr (std::is_same_v<T, Rate>)
    return value.hertz();
  else if constexpr (is_duration<T>)
    return static_cast<double>(std::chrono::duration_cast<Duration>(value).count());
  else
    return static_cast<double>(value);
}

/// What is left of a type without optional, containers and arrays around it.
template <class T>
struct LeafOf {
  using type = T;
};
template <class T>
requires is_optional<T> || is_std_array<T> || List<T>
struct LeafOf<T> : LeafOf<typename T::value_type> {
};
template <Map T>
struct LeafOf<T> : LeafOf<typename T::mapped_type> {};
template <class T>
using Leaf = typename LeafOf<T>::type;

template <class T>
inline constexpr bool is_choices = false;
template <class E, std::size_t N>
inline constexpr bool is_choices<std::array<ValueSpec<E>, N>> = true;
template <std::size_t N>
inline constexpr bool is_choices<std::array<std::string_view, N>> = true;

template <class Leaf, class Option>
constexpr void apply(ParameterRules& rules, const Option& option) {
  if constexpr (std::is_same_v<Option, Required>) {
    rules.required = true;
  } else if constexpr (std::is_same_v<Option, MayBeNegative>) {
    static_assert(is_duration<Leaf>, "rtdata: may_be_negative is for durations; bound a number with range or at_least");
    rules.negative = true;
  } else if constexpr (std::is_same_v<Option, NotZero>) {
    static_assert(quantity_of<Leaf>() == Quantity::number, "rtdata: not_zero is for numbers");
    rules.not_zero = true;
  } else if constexpr (std::is_same_v<Option, TextIs>) {
    static_assert(std::is_same_v<Leaf, std::string>, "rtdata: TextIs is for texts");
    rules.text = option;
  } else if constexpr (std::is_same_v<Option, Placeholders>) {
    static_assert(std::is_same_v<Leaf, std::string>, "rtdata: placeholders are for texts");
    rules.placeholders = option.names;
  } else if constexpr (std::is_same_v<Option, OnlyWith>) {
    rules.only_with = option;
  } else if constexpr (std::is_same_v<Option, NamesPart>) {
    static_assert(std::is_same_v<Leaf, std::string>, "rtdata: names_part is for texts");
    rules.names_part = option;
    if (rules.text == TextIs::anything) rules.text = TextIs::recorded;  // a name is shown, and so no secret
  } else if constexpr (std::is_same_v<Option, Unit>) {
    static_assert(quantity_of<Leaf>() == Quantity::number,
                  "rtdata: a unit is for a number; durations and rates are written with theirs");
    rules.unit = option.text;
  } else if constexpr (std::is_base_of_v<Range, Option>) {
    static_assert(std::is_same_v<Option, TypedRange<quantity_of<Leaf>()>>,
                  "rtdata: the range of a parameter must be of its kind: numbers, durations or rates");
    if (option.has_least) rules.least = option.least;
    if (option.has_most) rules.most = option.most;
    rules.has_least = rules.has_least || option.has_least;
    rules.has_most = rules.has_most || option.has_most;
  } else {
    static_assert(is_choices<Option>,
                  "rtdata: parameter(key, member, doc, ...) takes required, unit(...), range(...), "
                  "at_least(...), at_most(...), choices(...), may_be_negative, not_zero, TextIs::..., "
                  "placeholders(...), only_with(...) and names_part(...)");
  }
}

constexpr NoChoices choices_among() { return {}; }
template <class First, class... Rest>
constexpr auto choices_among(const First& first, const Rest&... rest) {
  if constexpr (is_choices<First>)
    return first;
  else
    return choices_among(rest...);
}

}  // namespace config_detail

/// One parameter. Made by `parameter`.
template <class Owner, class Member, class Choices>
struct Parameter {
  std::string_view key;
  Member Owner::*member;
  std::string_view doc;
  ParameterRules rules;
  Choices choices;
};

template <class... Entries>
struct ParameterList {
  std::tuple<Entries...> entries;
};

/// The key must be there; a text must not be empty.
inline constexpr config_detail::Required required{};
/// The duration may be negative ("-5 ms").
inline constexpr config_detail::MayBeNegative may_be_negative{};
/// The number may not be 0.
inline constexpr config_detail::NotZero not_zero{};
/// What may stand in the text in braces, such as {topic}; anything else in braces is a warning.
template <class... Names>
constexpr config_detail::Placeholders placeholders(Names... names) {
  return {{std::string_view(names)...}};
}
/// The parameter means something only while that of `key`, beside it, has one of these values ("true" and "false" for a
/// boolean): elsewhere it is a warning.
template <class... Values>
constexpr OnlyWith only_with(std::string_view key, Values... values) {
  return {key, {std::string_view(values)...}};
}
/// The text is the name of another part of the configuration: one of `kind` ("bus", "tier", "sensor", "sink" or
/// "topic", which is what any part publishes), and, if they are given, of one of these types. A part that is not there,
/// or is of another type, is a mistake; one that is there is made first and closed last.
template <class... Types>
constexpr NamesPart names_part(std::string_view kind, Types... types) {
  return {kind, {std::string_view(types)...}};
}
/// The UCUM unit of a number, for people and schema; it is not written in the file.
constexpr config_detail::Unit unit(std::string_view text) { return {text}; }

/// Both ends belong to it. Numbers, durations or rates, as the member.
template <class T, class U>
constexpr auto range(T least, U most) {
  using config_detail::magnitude;
  static_assert(config_detail::quantity_of<T>() == config_detail::quantity_of<U>(),
                "rtdata: both ends of a range are of one kind");
  return config_detail::TypedRange<config_detail::quantity_of<T>()>{
      {config_detail::quantity_of<T>(), true, true, magnitude(least), magnitude(most)}};
}
template <class T>
constexpr auto at_least(T least) {
  return config_detail::TypedRange<config_detail::quantity_of<T>()>{
      {config_detail::quantity_of<T>(), true, false, config_detail::magnitude(least), 0}};
}
template <class T>
constexpr auto at_most(T most) {
  return config_detail::TypedRange<config_detail::quantity_of<T>()>{
      {config_detail::quantity_of<T>(), false, true, 0, config_detail::magnitude(most)}};
}

/// Names for an enumeration that has no `describe`: choices(value("none", Parity::none), ...).
template <class E, class... More>
constexpr std::array<ValueSpec<E>, 1 + sizeof...(More)> choices(ValueSpec<E> first, More... more) {
  return {{first, more...}};
}
/// The texts that a string may be.
// clang-format off
template <class... More>
  requires(std::is_convertible_v<More, std::string_view> && ...)
constexpr std::array<std::string_view, 1 + sizeof...(More)> choices(std::string_view first, More... more) {
  return {{first, std::string_view(more)...}};
}
// clang-format on

/// `key` as in the file, `doc` a phrase in lower case without a full stop; both live as long as the program.
template <class Owner, class Member, class... Options>
constexpr auto parameter(std::string_view key, Member Owner::*member, std::string_view doc, const Options&... options) {
  ParameterRules rules;
  (config_detail::apply<config_detail::Leaf<Member>>(rules, options), ...);
  auto choices = config_detail::choices_among(options...);
  return Parameter<Owner, Member, decltype(choices)>{key, member, doc, rules, choices};
}

/// All parameters of a base (or of anything that the Config converts to by reference).
template <class Base>
inline constexpr config_detail::IncludedBase<Base> include{};
/// All parameters of a member, as if they were the Config's own.
template <class Owner, class Member>
constexpr config_detail::IncludedMember<Owner, Member> include_member(Member Owner::*member) {
  return {member};
}

template <class... Entries>
constexpr ParameterList<Entries...> parameter_list(Entries... entries) {
  return {{entries...}};
}

namespace config_detail {
template <class T>
inline constexpr bool is_parameter_list = false;
template <class... Entries>
inline constexpr bool is_parameter_list<ParameterList<Entries...>> = true;
}  // namespace config_detail

/// A struct with `parameters`.
template <class T>
concept Configurable = std::is_class_v<T> && requires {
  requires config_detail::is_parameter_list<std::remove_cvref_t<decltype(parameters(type_tag<T>{}))>>;
};

}  // namespace rtdata
