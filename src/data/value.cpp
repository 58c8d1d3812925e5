#include "rtdata/data/value.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <type_traits>
#include <utility>

#include "data/character.hpp"
#include "data/load.hpp"
#include "data/nearest.hpp"
#include "rtdata/data/text.hpp"

namespace rtdata {
namespace {

using detail::for_integer;
using detail::load;

template <class T>
void store(std::byte* to, T value) {
  std::memcpy(to, &value, sizeof value);
}

std::string place(const Leaf& leaf) { return "field " + leaf.path; }

Error wrong_type(const Leaf& leaf, const Value& value) {
  const char* const given[] = {"absent", "a bool", "a char", "an integer", "an integer", "a number", "a text"};
  return {Errc::bad_argument, "the value has the wrong type", place(leaf),
          std::string(given[value.index()]) + " was given, " + std::string(name_of(leaf.kind)) + " is needed",
          std::holds_alternative<std::monostate>(value) ? "give it a value, or make the field optional" : ""};
}

Error out_of_range(const Leaf& leaf, const Value& value, std::string why) {
  return {Errc::out_of_range, "the value does not fit", place(leaf), to_string(value) + " " + std::move(why), ""};
}

template <class T>
Result<T> to_integer(const Leaf& leaf, Kind kind, const Value& value) {
  const auto range = [&] {
    return out_of_range(leaf, value,
                        "is outside " + std::string(name_of(kind)) + " (" +
                            std::to_string(std::numeric_limits<T>::min()) + " to " +
                            std::to_string(std::numeric_limits<T>::max()) + ")");
  };
  if (const auto* number = std::get_if<std::int64_t>(&value)) {
    if (!std::in_range<T>(*number)) return range();
    return static_cast<T>(*number);
  }
  if (const auto* number = std::get_if<std::uint64_t>(&value)) {
    if (!std::in_range<T>(*number)) return range();
    return static_cast<T>(*number);
  }
  if (const auto* number = std::get_if<double>(&value)) {
    if (!(std::trunc(*number) == *number)) return out_of_range(leaf, value, "is not an integer");
    // 2^digits is exact as a double, the largest T is not always.
    const double end = std::ldexp(1.0, std::numeric_limits<T>::digits);
    const double begin = std::is_signed_v<T> ? -end : 0.0;
    if (*number < begin || *number >= end) return range();
    return static_cast<T>(*number);
  }
  return wrong_type(leaf, value);
}

Value read_integer(Kind kind, const std::byte* from) {
  return for_integer(kind, [from](auto zero) -> Value {
    const auto number = load<decltype(zero)>(from);
    if constexpr (std::is_signed_v<decltype(zero)>) {
      return std::int64_t{number};
    } else {
      return std::uint64_t{number};
    }
  });
}

template <class T>
Result<T> to_floating(const Leaf& leaf, const Value& value) {
  const auto exact = [&](auto number) -> Result<T> {
    const T converted = static_cast<T>(number);
    const double limit = std::ldexp(1.0, std::numeric_limits<decltype(number)>::digits);
    if (static_cast<double>(converted) >= limit || static_cast<decltype(number)>(converted) != number) {
      return out_of_range(leaf, value,
                          "is an integer that " + std::string(name_of(leaf.kind)) + " cannot hold exactly");
    }
    return converted;
  };
  if (const auto* number = std::get_if<std::int64_t>(&value)) return exact(*number);
  if (const auto* number = std::get_if<std::uint64_t>(&value)) return exact(*number);
  if (const auto* number = std::get_if<double>(&value)) {
    if constexpr (std::is_same_v<T, float>) {
      // Beyond the largest float by half a step or more, rounding would make it infinite.
      constexpr double end = 0x1.ffffffp127;
      if (std::isfinite(*number) && std::fabs(*number) >= end)
        return out_of_range(leaf, value, "is too large for a float");
    }
    return static_cast<T>(*number);
  }
  return wrong_type(leaf, value);
}

Result<void> put(const Leaf& leaf, std::byte* to, const Value& value) {
  switch (leaf.kind) {
    case Kind::boolean: {
      const auto* flag = std::get_if<bool>(&value);
      if (flag == nullptr) return wrong_type(leaf, value);
      store(to, *flag);
      return {};
    }
    case Kind::character: {
      if (const auto* c = std::get_if<char>(&value)) {
        store(to, *c);
        return {};
      }
      const auto* text = std::get_if<std::string>(&value);
      if (text == nullptr) return wrong_type(leaf, value);
      const auto c = detail::character_of(*text);
      if (!c) return out_of_range(leaf, value, "is not one character from U+0000 to U+00FF");
      store(to, *c);
      return {};
    }
    case Kind::f32: {
      auto number = to_floating<float>(leaf, value);
      if (!number) return std::move(number).error();
      store(to, *number);
      return {};
    }
    case Kind::f64: {
      auto number = to_floating<double>(leaf, value);
      if (!number) return std::move(number).error();
      store(to, *number);
      return {};
    }
    case Kind::text: {
      const auto* text = std::get_if<std::string>(&value);
      if (text == nullptr) return wrong_type(leaf, value);
      const std::size_t capacity = leaf.size - text_length_bytes;
      if (text->size() > capacity) {
        Error error = detail::text_too_long(*text, capacity);
        error.where = place(leaf) + ", " + error.where;
        return error;
      }
      std::memset(to, 0, leaf.size);
      to[0] = static_cast<std::byte>(text->size() & 0xff);
      to[1] = static_cast<std::byte>(text->size() >> 8);
      if (!text->empty()) std::memcpy(to + text_length_bytes, text->data(), text->size());
      return {};
    }
    case Kind::enumeration: {
      if (const auto* name = std::get_if<std::string>(&value)) {
        std::vector<std::string_view> known;
        for (const EnumValue& candidate : leaf.field->values) {
          if (candidate.name == *name) {
            for_integer(leaf.enum_base, [&](auto zero) { store(to, static_cast<decltype(zero)>(candidate.value)); });
            return {};
          }
          known.push_back(candidate.name);
        }
        return Error{Errc::bad_argument, "the value has no such name", place(leaf), *name + " is not one of its values",
                     detail::suggestion(*name, known)};
      }
      break;
    }
    case Kind::record:
      return wrong_type(leaf, value);
    default:
      break;
  }
  const Kind kind = leaf.kind == Kind::enumeration ? leaf.enum_base : leaf.kind;
  return for_integer(kind, [&](auto zero) -> Result<void> {
    auto number = to_integer<decltype(zero)>(leaf, kind, value);
    if (!number) return std::move(number).error();
    store(to, *number);
    return {};
  });
}

template <class T>
std::string digits(T number) {
  char buffer[32];
  return {buffer, std::to_chars(buffer, buffer + sizeof buffer, number).ptr};
}

}  // namespace

bool is_present(const Leaf& leaf, const std::byte* payload) noexcept {
  return leaf.optional == nullptr || leaf.optional->has_value(payload + leaf.offset);
}

const std::byte* find_value(const Leaf& leaf, const std::byte* payload) noexcept {
  const std::byte* at = payload + leaf.offset;
  if (leaf.optional == nullptr) return at;
  return leaf.optional->has_value(at) ? leaf.optional->value(at) : nullptr;
}

Value read(const Leaf& leaf, const std::byte* payload) {
  const std::byte* at = find_value(leaf, payload);
  if (at == nullptr) return std::monostate{};
  switch (leaf.kind) {
    case Kind::boolean:
      return *at != std::byte{0};
    case Kind::character:
      return load<char>(at);
    case Kind::f32:
      return static_cast<double>(load<float>(at));
    case Kind::f64:
      return load<double>(at);
    case Kind::text: {
      const auto length = static_cast<std::size_t>(at[0]) | static_cast<std::size_t>(at[1]) << 8;
      return std::string(reinterpret_cast<const char*>(at) + text_length_bytes,
                         std::min(length, leaf.size - text_length_bytes));
    }
    case Kind::enumeration: {
      Value number = read_integer(leaf.enum_base, at);
      const auto* given = std::get_if<std::uint64_t>(&number);
      const std::int64_t code = given != nullptr ? static_cast<std::int64_t>(*given) : std::get<std::int64_t>(number);
      for (const EnumValue& value : leaf.field->values) {
        if (value.value == code) return value.name;
      }
      return number;
    }
    case Kind::record:
      return std::monostate{};
    default:
      return read_integer(leaf.kind, at);
  }
}

Result<void> write(const Leaf& leaf, std::byte* payload, const Value& value) {
  std::byte* to = payload + leaf.offset;
  if (leaf.optional == nullptr) return put(leaf, to, value);
  if (std::holds_alternative<std::monostate>(value)) {
    leaf.optional->set(to, false);
    return {};
  }
  // An optional is its value followed by a flag, which is set after the value is written.
  auto done = put(leaf, to, value);
  if (done) to[leaf.optional->value_size] = std::byte{1};
  return done;
}

std::string to_string(const Value& value) {
  struct Visitor {
    std::string operator()(std::monostate) const { return "absent"; }
    std::string operator()(bool flag) const { return flag ? "true" : "false"; }
    std::string operator()(char c) const { return detail::utf8_of(c); }
    std::string operator()(const std::string& text) const { return text; }
    std::string operator()(double number) const { return digits(number); }
    std::string operator()(std::int64_t number) const { return digits(number); }
    std::string operator()(std::uint64_t number) const { return digits(number); }
  };
  return std::visit(Visitor{}, value);
}

}  // namespace rtdata
