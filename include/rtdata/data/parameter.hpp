/// Parameters: declare the settings of a component once, next to its `Config`.
///
///     struct UartConfig {
///       std::string device;
///       std::uint32_t baud = 9600;
///       rtdata::Parity parity = rtdata::Parity::none;
///       rtdata::Duration timeout = 100ms;
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
/// The declaration gives reading with a report of every mistake (`read_config`), the list for users (`parameters_of`),
/// the JSON Schema (`schema_of`) and writing (`write_config`), all in read.hpp.
///
/// A member may be bool, char, an integer, float, double, std::string, Duration or another std::chrono duration, Rate,
/// an enumeration with a `describe` or with `choices`, a struct with `parameters` of its own, a ConfigItem (anything,
/// left for later), any type with a `ConfigValue`, and std::optional, std::array, std::vector, std::map<std::string,
/// ...> of these; unit, range and choices are then those of the elements. The `Config` is default constructible; its
/// values are then the defaults. Parameters of a base come with `include<Base>`, those of a member, without a level of
/// their own, with `include_member(&Config::member)`.
///
/// A text may be written as {"env": "NAME"} or {"file": "path"}: it is then read from the environment or from a file
/// and never shown; see read.hpp. This does not work for texts that are stored in recordings (TextIs: recorded, name,
/// field, topic, unit) and for permissions.
///
/// A mistake in a declaration is a compile error of one sentence. Values; any thread.
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "rtdata/data/config_value.hpp"
#include "rtdata/data/describe.hpp"

namespace rtdata {

/// The meaning of a text. An option of `parameter`: reading then reports a mistake in the text, and the schema has a
/// pattern for it. If the parameter is not required, an empty text means none.
enum class TextIs : std::uint8_t {
  anything,
  recorded,       ///< written into recordings, such as notes
  name,           ///< of a sensor or sink: 1 to 200 characters, no control characters
  field,          ///< of a payload
  topic,          ///< see is_topic_name
  topic_pattern,  ///< see is_topic_pattern
  unit,           ///< UCUM; another one is a warning
  device,         ///< the path of a device or file to open
  output_file,    ///< the path of a file to write, in an existing folder
  permissions,    ///< of a file that is made, in octal digits: "0640"
};

/// The parameter has an effect only if another parameter of the same object has one of these values.
struct OnlyWith {
  std::string_view key = {};  ///< empty: always
  std::vector<std::string_view> values = {};
};

/// The text is the name of another part of the configuration, which must be there.
struct NamesPart {
  std::string_view kind = {};                ///< "bus", "tier", "sink" ...; empty: it does not name a part
  std::vector<std::string_view> types = {};  ///< types that the part may have; empty: any
};

namespace config_detail {

struct ValueKind;
/// How values of a type are read, written and described. The definition is in read.hpp, so that a mere declaration
/// compiles nothing of it.
template <class T>
const ValueKind& value_kind();

/// A word of a rule, or a choice.
struct Word {
  std::string_view text;
  std::int64_t value = 0;  ///< the enumerator, of a choice of an enumeration
};
/// Some of the words of a parameter.
struct WordRange {
  std::uint8_t first = 0;
  std::uint8_t count = 0;
};

/// The rules of a value, without its type.
struct ParameterRules {
  bool required = false;  ///< a required text is not empty either
  bool not_zero = false;
  bool negative = false;  ///< a duration may be negative
  bool has_least = false;
  bool has_most = false;
  TextIs text = TextIs::anything;
  WordRange only_with_values, part_types, choices;
  WordRange placeholders;  ///< allowed in braces in the text
  double least = 0;        ///< numbers as they are, durations in ns, rates in Hz
  double most = 0;
  std::string_view unit;
  std::string_view only_with;   ///< see OnlyWith
  std::string_view names_part;  ///< see NamesPart
};

/// One parameter or, with `is_included`, all parameters of a base or member. The entry has no C++ type, which only
/// `kind` knows, so that one function can read all entries.
struct ParameterEntry {
  std::string_view key;
  std::string_view doc;
  const ValueKind& (*kind)() = nullptr;
  const void* owner = nullptr;   ///< an object that is never constructed
  const void* member = nullptr;  ///< the member in it
  bool is_included = false;      ///< the parameters of the member, not the member itself
  std::uint16_t first_word = 0;  ///< among those of the list
  ParameterRules rules;
};

/// Memory of a T that was never made, to ask where its members lie.
template <class T>
union Unmade {
  char none;
  T made;
  constexpr Unmade() : none{} {}
  constexpr ~Unmade() {}
};
template <class T>
inline constinit Unmade<T> unmade{};

struct Required {};
struct MayBeNegative {};
struct NotZero {};
template <std::size_t N>
struct Placeholders {
  std::array<std::string_view, N> names;
};
template <std::size_t N>
struct OnlyWithValues {
  std::string_view key;
  std::array<std::string_view, N> values;
};
template <std::size_t N>
struct PartNamed {
  std::string_view kind;
  std::array<std::string_view, N> types;
};
struct Unit {
  std::string_view text;
};
enum class Quantity { number, duration, rate, none };
/// A range has its quantity in the type, so that the compiler finds a wrong one.
template <Quantity Q>
struct Range {
  bool has_least, has_most;
  double least, most;
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

/// The type without optional, containers and arrays around it.
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

/// How many texts an option has.
template <class Option>
inline constexpr std::size_t words_in = 0;
template <std::size_t N>
inline constexpr std::size_t words_in<Placeholders<N>> = N;
template <std::size_t N>
inline constexpr std::size_t words_in<OnlyWithValues<N>> = N;
template <std::size_t N>
inline constexpr std::size_t words_in<PartNamed<N>> = N;
template <class Choice, std::size_t N>
inline constexpr std::size_t words_in<std::array<Choice, N>> = N;

template <class Option>
inline constexpr bool is_choices = false;
template <class Choice, std::size_t N>
inline constexpr bool is_choices<std::array<Choice, N>> = true;

/// Adds options to the rules of a parameter whose values, without optional and containers, are of type Leaf.
template <class Leaf>
struct RulesFor {
  ParameterRules& rules;
  Word* words;
  std::uint8_t used = 0;

  constexpr void add(Required) { rules.required = true; }
  constexpr void add(MayBeNegative) {
    static_assert(is_duration<Leaf>, "rtdata: may_be_negative is for durations; bound a number with range or at_least");
    rules.negative = true;
  }
  constexpr void add(NotZero) {
    static_assert(quantity_of<Leaf>() == Quantity::number, "rtdata: not_zero is for numbers");
    rules.not_zero = true;
  }
  constexpr void add(TextIs is) {
    static_assert(std::is_same_v<Leaf, std::string>, "rtdata: TextIs is for texts");
    rules.text = is;
  }
  constexpr void add(Unit unit) {
    static_assert(quantity_of<Leaf>() == Quantity::number,
                  "rtdata: a unit is for a number; durations and rates are written with theirs");
    rules.unit = unit.text;
  }
  template <Quantity Q>
  constexpr void add(const Range<Q>& range) {
    static_assert(Q == quantity_of<Leaf>(),
                  "rtdata: the range of a parameter must be of its kind: numbers, durations or rates");
    if (range.has_least) rules.least = range.least;
    if (range.has_most) rules.most = range.most;
    rules.has_least = rules.has_least || range.has_least;
    rules.has_most = rules.has_most || range.has_most;
  }
  template <std::size_t N>
  constexpr void add(const Placeholders<N>& option) {
    static_assert(std::is_same_v<Leaf, std::string>, "rtdata: placeholders are for texts");
    rules.placeholders = add_words(option.names.data(), N);
  }
  template <std::size_t N>
  constexpr void add(const OnlyWithValues<N>& option) {
    rules.only_with = option.key;
    rules.only_with_values = add_words(option.values.data(), N);
  }
  template <std::size_t N>
  constexpr void add(const PartNamed<N>& option) {
    static_assert(std::is_same_v<Leaf, std::string>, "rtdata: names_part is for texts");
    rules.names_part = option.kind;
    rules.part_types = add_words(option.types.data(), N);
    if (rules.text == TextIs::anything) rules.text = TextIs::recorded;  // a name is shown, so it cannot be a secret
  }
  template <std::size_t N>
  constexpr void add(const std::array<std::string_view, N>& choices) {
    static_assert(std::is_same_v<Leaf, std::string>,
                  "rtdata: choices of texts are for texts; an enumeration has choices(value(name, enumerator), ...)");
    rules.choices = add_words(choices.data(), N);
  }
  template <class E, std::size_t N>
  constexpr void add(const std::array<ValueSpec<E>, N>& choices) {
    static_assert(std::is_same_v<Leaf, E>, "rtdata: the choices of a parameter must be of its enumeration");
    rules.choices = {used, static_cast<std::uint8_t>(N)};
    for (const ValueSpec<E>& choice : choices) words[used++] = {choice.name, static_cast<std::int64_t>(choice.value)};
  }
  template <class Other>
  constexpr void add(const Other&) {
    static_assert(always_false<Other>,
                  "rtdata: parameter(key, member, doc, ...) takes required, unit(...), range(...), "
                  "at_least(...), at_most(...), choices(...), may_be_negative, not_zero, TextIs::..., "
                  "placeholders(...), only_with(...) and names_part(...)");
  }

 private:
  constexpr WordRange add_words(const std::string_view* texts, std::size_t count) {
    const WordRange range{used, static_cast<std::uint8_t>(count)};
    for (std::size_t i = 0; i < count; ++i) words[used++].text = texts[i];
    return range;
  }
};

}  // namespace config_detail

/// A parameter of an Owner, or all of those of a base or member. Made by `parameter` and its like.
template <class Owner, std::size_t Words>
struct Parameter {
  config_detail::ParameterEntry entry;
  std::array<config_detail::Word, Words> words = {};
};

template <std::size_t Words, class... Owners>
struct ParameterList {
  std::array<config_detail::ParameterEntry, sizeof...(Owners)> entries;
  std::array<config_detail::Word, Words> words = {};
};

/// The key must be there; a text must not be empty.
inline constexpr config_detail::Required required{};
/// The duration may be negative ("-5 ms").
inline constexpr config_detail::MayBeNegative may_be_negative{};
/// The number may not be 0.
inline constexpr config_detail::NotZero not_zero{};
/// Names that the text may use in braces, such as {topic}; any other name in braces is a warning.
template <class... Names>
constexpr config_detail::Placeholders<sizeof...(Names)> placeholders(Names... names) {
  return {{std::string_view(names)...}};
}
/// The parameter has an effect only if `key` in the same object has one of these values ("true" and "false" for a
/// boolean); otherwise it is a warning.
template <class... Values>
constexpr config_detail::OnlyWithValues<sizeof...(Values)> only_with(std::string_view key, Values... values) {
  return {key, {std::string_view(values)...}};
}
/// The text is the name of another part of the configuration: one of `kind` ("bus", "tier", "sensor", "sink" or
/// "topic", which is what any part publishes), and, if given, of one of these types. A missing part, or one of another
/// type, is a mistake. The named part is made before this one and closed after it.
template <class... Types>
constexpr config_detail::PartNamed<sizeof...(Types)> names_part(std::string_view kind, Types... types) {
  return {kind, {std::string_view(types)...}};
}
/// The UCUM unit of a number, for users and the schema; the file does not contain it.
constexpr config_detail::Unit unit(std::string_view text) { return {text}; }

/// Both ends belong to it. Numbers, durations or rates, as the member.
template <class T, class U>
constexpr config_detail::Range<config_detail::quantity_of<T>()> range(T least, U most) {
  static_assert(config_detail::quantity_of<T>() == config_detail::quantity_of<U>(),
                "rtdata: both ends of a range are of one kind");
  return {true, true, config_detail::magnitude(least), config_detail::magnitude(most)};
}
template <class T>
constexpr config_detail::Range<config_detail::quantity_of<T>()> at_least(T least) {
  return {true, false, config_detail::magnitude(least), 0};
}
template <class T>
constexpr config_detail::Range<config_detail::quantity_of<T>()> at_most(T most) {
  return {false, true, 0, config_detail::magnitude(most)};
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
  using namespace config_detail;
  using Type = config_detail::Leaf<Member>;
  static_assert(
      !std::is_enum_v<Type> || DescribedEnum<Type> || (is_choices<Options> || ...),
      "rtdata: a parameter is an enumeration without names: give it a `describe`, or the parameter `choices`");
  Parameter<Owner, (words_in<Options> + ... + 0)> made{
      {key, doc, &value_kind<Member>, &unmade<Owner>, &(unmade<Owner>.made.*member), false, 0, {}}};
  [[maybe_unused]] RulesFor<Type> rules{made.entry.rules, made.words.data()};
  (rules.add(options), ...);
  return made;
}

/// All parameters of a base (or of anything that the Config converts to by reference).
template <class Base>
inline constexpr Parameter<Base, 0> include{
    {{}, {}, &config_detail::value_kind<Base>, &config_detail::unmade<Base>, &config_detail::unmade<Base>, true, 0, {}}};
/// All parameters of a member, as if they were the Config's own.
template <class Owner, class Member>
constexpr Parameter<Owner, 0> include_member(Member Owner::*member) {
  using namespace config_detail;
  return {{{}, {}, &value_kind<Member>, &unmade<Owner>, &(unmade<Owner>.made.*member), true, 0, {}}};
}

template <class... Owners, std::size_t... Words>
constexpr ParameterList<(Words + ... + 0), Owners...> parameter_list(const Parameter<Owners, Words>&... parameters) {
  ParameterList<(Words + ... + 0), Owners...> list{{parameters.entry...}};
  std::uint16_t used = 0;
  auto* entry = list.entries.data();
  [[maybe_unused]] const auto add_words = [&](const config_detail::Word* words, std::size_t count) {
    entry++->first_word = used;
    for (std::size_t i = 0; i < count; ++i) list.words[used++] = words[i];
  };
  (add_words(parameters.words.data(), Words), ...);
  return list;
}

namespace config_detail {
template <class T>
inline constexpr bool is_parameter_list = false;
template <std::size_t Words, class... Owners>
inline constexpr bool is_parameter_list<ParameterList<Words, Owners...>> = true;
}  // namespace config_detail

/// A struct with `parameters`.
template <class T>
concept Configurable = std::is_class_v<T> && requires {
  requires config_detail::is_parameter_list<std::remove_cvref_t<decltype(parameters(type_tag<T>{}))>>;
};

}  // namespace rtdata
