/// describe: declare a payload once, in its struct; everything else follows from it.
///
///     struct Climate {
///       double temperature = 0;
///       double humidity = 0;
///       friend constexpr auto describe(rtdata::type_tag<Climate>) {
///         return rtdata::record("climate", rtdata::field("temperature", &Climate::temperature, "Cel"),
///                               rtdata::field("humidity", &Climate::humidity, "%RH"));
///       }
///     };
///
/// or, the same with less to write (the record is then called as the struct, "Imu"):
///
///     struct Imu {
///       float ax, ay;
///       std::uint32_t seq;
///       RTDATA_FIELDS(Imu, (ax, "m/s2"), (ay, "m/s2"), (seq))
///     };
///
/// A field may be: bool, char, an integer of 8 to 64 bits, float, double, `rtdata::text<N>`, a described enumeration, a
/// `std::optional` of one of these, a described struct, or a `std::array` of any of these. An enumeration is described
/// next to it (in a class: as a friend of the class):
///
///     enum class State { idle, running };
///     constexpr auto describe(rtdata::type_tag<State>) {
///       return rtdata::enumeration("state", rtdata::value("idle", State::idle),
///                                  rtdata::value("running", State::running));
///     }
///
/// Units are UCUM strings. A missing `describe`, a member left out of it, a name used twice and a type that cannot be
/// described are compile errors of one sentence. (Only members of aggregates can be counted: in a struct with a
/// constructor or private members, a forgotten member is not detected.)
///
/// Values; any thread.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>
#include <tuple>
#include <type_traits>
#include <utility>

#include "rtdata/data/description.hpp"
#include "rtdata/data/text.hpp"

namespace rtdata {

/// What `describe` takes: it names the type that is meant.
template <class T>
struct type_tag {};

/// A member in a `describe`. `Owner` is the struct (or its base) that the member belongs to.
template <class Owner, class Member>
struct FieldSpec {
  std::string_view name;
  Member Owner::*member;
  std::string_view unit;
};

template <class... Fields>
struct RecordSpec {
  std::string_view name;
  std::tuple<Fields...> fields;
  bool has_changes = false;
  /// See `Description::is_of_changes`.
  constexpr RecordSpec of_changes() const {
    RecordSpec spec = *this;
    spec.has_changes = true;
    return spec;
  }
};

/// A named value in the `describe` of an enumeration.
template <class E>
struct ValueSpec {
  std::string_view name;
  E value;
};

template <class E, std::size_t N>
struct EnumSpec {
  std::string_view name;
  std::array<ValueSpec<E>, N> values;
};

template <class Owner, class Member>
constexpr FieldSpec<Owner, Member> field(std::string_view name, Member Owner::*member, std::string_view unit = {}) {
  return {name, member, unit};
}

template <class... Owners, class... Members>
constexpr RecordSpec<FieldSpec<Owners, Members>...> record(std::string_view name,
                                                           FieldSpec<Owners, Members>... fields) {
  return {name, {fields...}, false};
}

template <class E>
constexpr ValueSpec<E> value(std::string_view name, E number) {
  static_assert(std::is_enum_v<E>, "rtdata: value(name, number) takes an enumerator");
  return {name, number};
}

template <class E, class... More>
constexpr EnumSpec<E, 1 + sizeof...(More)> enumeration(std::string_view name, ValueSpec<E> first, More... more) {
  return {name, {{first, more...}}};
}

namespace detail {

template <class T>
inline constexpr bool is_record_spec = false;
template <class... Fields>
inline constexpr bool is_record_spec<RecordSpec<Fields...>> = true;
template <class T>
inline constexpr bool is_enum_spec = false;
template <class E, std::size_t N>
inline constexpr bool is_enum_spec<EnumSpec<E, N>> = true;

}  // namespace detail

/// A struct with a `describe`.
template <class T>
concept Described = std::is_class_v<T> && requires {
  requires detail::is_record_spec<std::remove_cvref_t<decltype(describe(type_tag<T>{}))>>;
};

/// An enumeration with a `describe`.
template <class T>
concept DescribedEnum = std::is_enum_v<T> && requires {
  requires detail::is_enum_spec<std::remove_cvref_t<decltype(describe(type_tag<T>{}))>>;
};

/// The description of T. Made at the first call; lives to the end of the program. The first call throws `SetupError`
/// (bad-description) if the description is invalid, for example too large.
template <class T>
const std::shared_ptr<const Description>& description_of();

/// Implementation of `description_of`; not for use.
namespace detail {

struct RawEnumValue {
  std::string_view name;
  std::int64_t value;
};

/// A `Field` without memory of its own, so that little is compiled per type.
struct RawField {
  std::string_view name;
  std::string_view unit;
  Kind kind = Kind::record;
  std::size_t offset = 0;
  std::size_t size = 0;
  std::size_t stride = 0;
  std::size_t alignment = 1;
  std::size_t count = 1;
  bool is_array = false;
  bool is_optional = false;
  bool optional_layout_known = true;
  Kind enum_base = Kind::i32;
  const RawEnumValue* values = nullptr;
  std::size_t value_count = 0;
  const std::shared_ptr<const Description>& (*record)() = nullptr;
};

/// Throws SetupError.
std::shared_ptr<const Description> make_description(std::string_view name, const RawField* fields, std::size_t count,
                                                    std::size_t size, std::size_t alignment, bool is_of_changes);

template <class T>
inline constexpr bool is_optional = false;
template <class T>
inline constexpr bool is_optional<std::optional<T>> = true;
template <class T>
inline constexpr bool is_array = false;
template <class T, std::size_t N>
inline constexpr bool is_array<std::array<T, N>> = N != 0;
template <class T>
inline constexpr bool is_text = false;
template <std::size_t N>
inline constexpr bool is_text<text<N>> = true;

template <class T>
inline constexpr bool is_integer = std::is_integral_v<T> && !std::is_same_v<T, bool> && !std::is_same_v<T, char> &&
                                   !std::is_same_v<T, wchar_t> && !std::is_same_v<T, char8_t> &&
                                   !std::is_same_v<T, char16_t> && !std::is_same_v<T, char32_t> && sizeof(T) <= 8;

template <class T>
constexpr Kind integer_kind() {
  constexpr int log = sizeof(T) == 1 ? 0 : sizeof(T) == 2 ? 1 : sizeof(T) == 4 ? 2 : 3;
  const Kind first = std::is_signed_v<T> ? Kind::i8 : Kind::u8;
  return static_cast<Kind>(static_cast<int>(first) + log);
}

/// True if T is a single value: not optional, not an array, not a struct.
template <class T>
inline constexpr bool is_scalar = std::is_same_v<T, bool> || std::is_same_v<T, char> || is_integer<T> ||
                                  std::is_same_v<T, float> || std::is_same_v<T, double> || is_text<T> ||
                                  DescribedEnum<T>;

template <class T>
struct Element {
  static constexpr bool supported = is_scalar<T> || Described<T>;
};
template <class T>
struct Element<std::optional<T>> {
  static constexpr bool supported = is_scalar<T>;
};
template <class T>
inline constexpr bool is_supported = Element<T>::supported;
template <class T, std::size_t N>
inline constexpr bool is_supported<std::array<T, N>> = N != 0 && Element<T>::supported;

template <class T>
struct UndescribedEnum {
  static constexpr bool value = std::is_enum_v<T> && !DescribedEnum<T>;
};
template <class T>
struct UndescribedEnum<std::optional<T>> : UndescribedEnum<T> {};
template <class T, std::size_t N>
struct UndescribedEnum<std::array<T, N>> : UndescribedEnum<T> {};

template <class T>
struct UndescribedStruct {
  static constexpr bool value = std::is_class_v<T> && !Described<T> && !is_optional<T> && !is_array<T> && !is_text<T>;
};
template <class T, std::size_t N>
struct UndescribedStruct<std::array<T, N>> : UndescribedStruct<T> {};

template <class Spec>
struct Members;
template <class... Owners, class... Types>
struct Members<RecordSpec<FieldSpec<Owners, Types>...>> {
  static constexpr std::size_t count = sizeof...(Types);
  static constexpr bool supported = (is_supported<Types> && ...);
  static constexpr bool enums_described = !(UndescribedEnum<Types>::value || ...);
  static constexpr bool structs_described = !(UndescribedStruct<Types>::value || ...);
};

/// Converts to any member type, but not to T or a base of T. The operator is const so that the constructor of
/// std::optional is not ambiguous.
template <class T>
struct AnyMember {
  template <class U>
  requires(!std::is_base_of_v<U, T>) operator U() const noexcept;
};
template <class T, std::size_t>
using AnyMemberAt = AnyMember<T>;
template <class T, class Indices>
inline constexpr bool takes = false;
template <class T, std::size_t... I>
inline constexpr bool takes<T, std::index_sequence<I...>> = requires {
  T{AnyMemberAt<T, I>{}...};
};

/// True if an aggregate has more members than `N`.
template <class T, std::size_t N>
constexpr bool has_more_members_than() {
  if constexpr (std::is_aggregate_v<T>) {
    return takes<T, std::make_index_sequence<N + 1>>;
  } else {
    return false;
  }
}

constexpr char lower(char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; }
constexpr bool equal_but_for_case(std::string_view a, std::string_view b) {
  if (a.size() != b.size()) return false;
  for (std::size_t i = 0; i < a.size(); ++i) {
    if (lower(a[i]) != lower(b[i])) return false;
  }
  return true;
}

constexpr bool is_good_name(std::string_view name) {
  if (name.empty() || (name[0] >= '0' && name[0] <= '9')) return false;
  for (const char c : name) {
    if (!((lower(c) >= 'a' && lower(c) <= 'z') || (c >= '0' && c <= '9') || c == '_')) return false;
  }
  return true;
}

template <class... Fields>
constexpr std::array<std::string_view, sizeof...(Fields)> names_in(const RecordSpec<Fields...>& spec) {
  return std::apply([](const auto&... field) { return std::array<std::string_view, sizeof...(Fields)>{field.name...}; },
                    spec.fields);
}

template <std::size_t N>
constexpr bool good_names(const std::array<std::string_view, N>& names) {
  for (const auto name : names) {
    if (!is_good_name(name)) return false;
  }
  return true;
}

template <std::size_t N>
constexpr bool different_names(const std::array<std::string_view, N>& names) {
  for (std::size_t i = 0; i < N; ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      if (equal_but_for_case(names[i], names[j])) return false;
    }
  }
  return true;
}

template <class E, std::size_t N>
constexpr std::array<RawEnumValue, N> raw_values(const EnumSpec<E, N>& spec) {
  std::array<RawEnumValue, N> raw{};
  for (std::size_t i = 0; i < N; ++i) {
    raw[i] = {spec.values[i].name, static_cast<std::int64_t>(spec.values[i].value)};
  }
  return raw;
}
template <class E>
inline constexpr auto enum_values = raw_values(describe(type_tag<E>{}));

/// Fills in what follows from the type of one element.
template <class T>
void fill(RawField& raw) {
  raw.size = raw.stride = sizeof(T);
  raw.alignment = alignof(T);
  if constexpr (is_text<T>) {
    raw.kind = Kind::text;
  } else if constexpr (std::is_enum_v<T>) {
    raw.kind = Kind::enumeration;
    using Base = std::underlying_type_t<T>;
    if constexpr (std::is_same_v<Base, bool>) {
      raw.enum_base = Kind::u8;
    } else {
      raw.enum_base = integer_kind<Base>();
    }
    raw.values = enum_values<T>.data();
    raw.value_count = enum_values<T>.size();
  } else if constexpr (std::is_same_v<T, bool>) {
    raw.kind = Kind::boolean;
  } else if constexpr (std::is_same_v<T, char>) {
    raw.kind = Kind::character;
  } else if constexpr (std::is_same_v<T, float>) {
    raw.kind = Kind::f32;
  } else if constexpr (std::is_same_v<T, double>) {
    raw.kind = Kind::f64;
  } else if constexpr (std::is_integral_v<T>) {
    raw.kind = integer_kind<T>();
  } else {
    raw.record = &description_of<T>;
  }
}

/// True if a std::optional<T> lies in memory as OptionalAccess reads it: the value, then one byte that is 1 or 0.
template <class T>
bool optional_lies_as_expected() {
  std::optional<T> optional;
  const auto* bytes = reinterpret_cast<const unsigned char*>(&optional);
  if (bytes[sizeof(T)] != 0) return false;
  optional.emplace();
  return bytes[sizeof(T)] == 1 && reinterpret_cast<const unsigned char*>(&*optional) == bytes;
}

template <class T>
struct Shape {
  static void fill_in(RawField& raw) { fill<T>(raw); }
};
template <class T>
struct Shape<std::optional<T>> {
  static_assert(sizeof(std::optional<T>) == (sizeof(T) + 1 + alignof(T) - 1) / alignof(T) * alignof(T),
                "rtdata: this standard library lays out std::optional in a way that rtdata does not know");
  static void fill_in(RawField& raw) {
    fill<T>(raw);
    raw.stride = sizeof(std::optional<T>);
    raw.is_optional = true;
    raw.optional_layout_known = optional_lies_as_expected<T>();
  }
};
template <class T, std::size_t N>
struct Shape<std::array<T, N>> {
  static void fill_in(RawField& raw) {
    Shape<T>::fill_in(raw);
    raw.count = N;
    raw.is_array = true;
  }
};

/// Memory of a T that is never constructed, to compute the offsets of its members.
template <class T>
union Unmade {
  char none;
  T made;
  constexpr Unmade() : none{} {}
};

template <class T, class Owner, class Member>
RawField raw_field(const FieldSpec<Owner, Member>& spec) {
  RawField raw;
  raw.name = spec.name;
  raw.unit = spec.unit;
  static const Unmade<T> unmade;
  raw.offset = static_cast<std::size_t>(reinterpret_cast<const char*>(&(unmade.made.*spec.member)) - &unmade.none);
  Shape<Member>::fill_in(raw);
  return raw;
}

template <class T, class... Fields>
std::shared_ptr<const Description> describe_type(const RecordSpec<Fields...>& spec) {
  if constexpr (sizeof...(Fields) == 0) {
    return make_description(spec.name, nullptr, 0, sizeof(T), alignof(T), spec.has_changes);
  } else {
    return std::apply(
        [&spec](const auto&... field) {
          const RawField raw[] = {raw_field<T>(field)...};
          return make_description(spec.name, raw, sizeof...(Fields), sizeof(T), alignof(T), spec.has_changes);
        },
        spec.fields);
  }
}

/// The checks, with one sentence each; a check runs only if the earlier ones pass.
template <class T>
constexpr bool check_describe() {
  constexpr bool described = Described<T>;
  constexpr bool told = requires { rtdata_fields(type_tag<T>{}); };  // what is wrong with its RTDATA_FIELDS
  static_assert(described || told,
                "rtdata: this type has no `describe`: write RTDATA_FIELDS(Type, (member, \"unit\"), ...) in it, see "
                "rtdata/data/describe.hpp");
  if constexpr (described) {
    static_assert(
        std::is_trivially_copyable_v<T>,
        "rtdata: a payload must be trivially copyable: use rtdata::text<N> for a string and std::array for a list");
    if constexpr (std::is_trivially_copyable_v<T>) {
      using Spec = std::remove_cvref_t<decltype(describe(type_tag<T>{}))>;
      constexpr bool enums = Members<Spec>::enums_described;
      static_assert(enums,
                    "rtdata: a field is an enumeration without a `describe`: write one next to it that returns "
                    "rtdata::enumeration(name, rtdata::value(name, enumerator), ...)");
      constexpr bool structs = Members<Spec>::structs_described;
      static_assert(structs,
                    "rtdata: a field is a struct without a `describe`: write RTDATA_FIELDS in that struct as well");
      constexpr bool supported = Members<Spec>::supported || !enums || !structs;
      static_assert(supported,
                    "rtdata: a field has a type that cannot be described: use bool, char, an integer, float, double, "
                    "rtdata::text<N>, a described enum or struct, or a std::optional or std::array of these");
      if constexpr (supported && enums && structs) {
        constexpr bool complete = !has_more_members_than<T, Members<Spec>::count>();
        static_assert(complete, "rtdata: `describe` leaves out a member of the struct: list every one, in any order");
        if constexpr (complete) {
          constexpr auto names = names_in(describe(type_tag<T>{}));
          static_assert(good_names(names) && is_good_name(describe(type_tag<T>{}).name),
                        "rtdata: the name of a record or field may have letters, digits and underscores and must not "
                        "start with a digit");
          static_assert(!good_names(names) || different_names(names),
                        "rtdata: `describe` has two fields of one name (upper and lower case count as the same)");
          return good_names(names) && different_names(names);
        }
      }
    }
  }
  return false;
}

/// A separate function, so that `description_of` stays small enough to be inlined.
template <class T>
[[gnu::noinline]] std::shared_ptr<const Description> make_description() {
  return describe_type<T>(describe(type_tag<T>{}));
}

}  // namespace detail

template <class T>
inline const std::shared_ptr<const Description>& description_of() {
  if constexpr (constexpr bool good = detail::check_describe<T>(); good) {
    static const std::shared_ptr<const Description> description = detail::make_description<T>();
    return description;
  } else {
    static const std::shared_ptr<const Description> none;
    return none;
  }
}

}  // namespace rtdata

/// RTDATA_FIELDS(Type, (member, "unit"), (member), ...): the `describe` of a struct; inside the struct, naming every
/// member, 100 at most. The record and its fields are called as they are written.
// `describe` is a template so that g++ reports a misspelt member once. The commas stand for 100 absent fields.
// clang-format off
#define RTDATA_FIELDS(Type, ...) \
  [[maybe_unused]] friend void rtdata_fields(::rtdata::type_tag<Type>) {} \
  template <int = 0> \
  friend constexpr auto describe(::rtdata::type_tag<Type>) { \
    using RtdataOwner [[maybe_unused]] = Type; \
    return ::rtdata::record(#Type \
      RTDATA_DETAIL_EACH(__VA_ARGS__ __VA_OPT__(,) , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , \
      , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , , \
      , , , , , , , , , , ,)); \
  }
#define RTDATA_DETAIL_EACH(f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18, f19, \
                           f20, f21, f22, f23, f24, f25, f26, f27, f28, f29, f30, f31, f32, f33, f34, f35, f36, f37, \
                           f38, f39, f40, f41, f42, f43, f44, f45, f46, f47, f48, f49, f50, f51, f52, f53, f54, f55, \
                           f56, f57, f58, f59, f60, f61, f62, f63, f64, f65, f66, f67, f68, f69, f70, f71, f72, f73, \
                           f74, f75, f76, f77, f78, f79, f80, f81, f82, f83, f84, f85, f86, f87, f88, f89, f90, f91, \
                           f92, f93, f94, f95, f96, f97, f98, f99, more, ...) \
  RTDATA_DETAIL_ONE(f0) RTDATA_DETAIL_ONE(f1) RTDATA_DETAIL_ONE(f2) RTDATA_DETAIL_ONE(f3) RTDATA_DETAIL_ONE(f4) \
  RTDATA_DETAIL_ONE(f5) RTDATA_DETAIL_ONE(f6) RTDATA_DETAIL_ONE(f7) RTDATA_DETAIL_ONE(f8) RTDATA_DETAIL_ONE(f9) \
  RTDATA_DETAIL_ONE(f10) RTDATA_DETAIL_ONE(f11) RTDATA_DETAIL_ONE(f12) RTDATA_DETAIL_ONE(f13) RTDATA_DETAIL_ONE(f14) \
  RTDATA_DETAIL_ONE(f15) RTDATA_DETAIL_ONE(f16) RTDATA_DETAIL_ONE(f17) RTDATA_DETAIL_ONE(f18) RTDATA_DETAIL_ONE(f19) \
  RTDATA_DETAIL_ONE(f20) RTDATA_DETAIL_ONE(f21) RTDATA_DETAIL_ONE(f22) RTDATA_DETAIL_ONE(f23) RTDATA_DETAIL_ONE(f24) \
  RTDATA_DETAIL_ONE(f25) RTDATA_DETAIL_ONE(f26) RTDATA_DETAIL_ONE(f27) RTDATA_DETAIL_ONE(f28) RTDATA_DETAIL_ONE(f29) \
  RTDATA_DETAIL_ONE(f30) RTDATA_DETAIL_ONE(f31) RTDATA_DETAIL_ONE(f32) RTDATA_DETAIL_ONE(f33) RTDATA_DETAIL_ONE(f34) \
  RTDATA_DETAIL_ONE(f35) RTDATA_DETAIL_ONE(f36) RTDATA_DETAIL_ONE(f37) RTDATA_DETAIL_ONE(f38) RTDATA_DETAIL_ONE(f39) \
  RTDATA_DETAIL_ONE(f40) RTDATA_DETAIL_ONE(f41) RTDATA_DETAIL_ONE(f42) RTDATA_DETAIL_ONE(f43) RTDATA_DETAIL_ONE(f44) \
  RTDATA_DETAIL_ONE(f45) RTDATA_DETAIL_ONE(f46) RTDATA_DETAIL_ONE(f47) RTDATA_DETAIL_ONE(f48) RTDATA_DETAIL_ONE(f49) \
  RTDATA_DETAIL_ONE(f50) RTDATA_DETAIL_ONE(f51) RTDATA_DETAIL_ONE(f52) RTDATA_DETAIL_ONE(f53) RTDATA_DETAIL_ONE(f54) \
  RTDATA_DETAIL_ONE(f55) RTDATA_DETAIL_ONE(f56) RTDATA_DETAIL_ONE(f57) RTDATA_DETAIL_ONE(f58) RTDATA_DETAIL_ONE(f59) \
  RTDATA_DETAIL_ONE(f60) RTDATA_DETAIL_ONE(f61) RTDATA_DETAIL_ONE(f62) RTDATA_DETAIL_ONE(f63) RTDATA_DETAIL_ONE(f64) \
  RTDATA_DETAIL_ONE(f65) RTDATA_DETAIL_ONE(f66) RTDATA_DETAIL_ONE(f67) RTDATA_DETAIL_ONE(f68) RTDATA_DETAIL_ONE(f69) \
  RTDATA_DETAIL_ONE(f70) RTDATA_DETAIL_ONE(f71) RTDATA_DETAIL_ONE(f72) RTDATA_DETAIL_ONE(f73) RTDATA_DETAIL_ONE(f74) \
  RTDATA_DETAIL_ONE(f75) RTDATA_DETAIL_ONE(f76) RTDATA_DETAIL_ONE(f77) RTDATA_DETAIL_ONE(f78) RTDATA_DETAIL_ONE(f79) \
  RTDATA_DETAIL_ONE(f80) RTDATA_DETAIL_ONE(f81) RTDATA_DETAIL_ONE(f82) RTDATA_DETAIL_ONE(f83) RTDATA_DETAIL_ONE(f84) \
  RTDATA_DETAIL_ONE(f85) RTDATA_DETAIL_ONE(f86) RTDATA_DETAIL_ONE(f87) RTDATA_DETAIL_ONE(f88) RTDATA_DETAIL_ONE(f89) \
  RTDATA_DETAIL_ONE(f90) RTDATA_DETAIL_ONE(f91) RTDATA_DETAIL_ONE(f92) RTDATA_DETAIL_ONE(f93) RTDATA_DETAIL_ONE(f94) \
  RTDATA_DETAIL_ONE(f95) RTDATA_DETAIL_ONE(f96) RTDATA_DETAIL_ONE(f97) RTDATA_DETAIL_ONE(f98) RTDATA_DETAIL_ONE(f99) \
  RTDATA_DETAIL_TOO_MANY(more)
// clang-format on
#define RTDATA_DETAIL_ONE(...) __VA_OPT__(, RTDATA_DETAIL_FIELD __VA_ARGS__)
#define RTDATA_DETAIL_FIELD(Member, ...) ::rtdata::field(#Member, &RtdataOwner::Member __VA_OPT__(, ) __VA_ARGS__)
#define RTDATA_DETAIL_TOO_MANY(...) __VA_OPT__(, RTDATA_FIELDS_takes_at_most_100_fields)
