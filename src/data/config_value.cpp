#include "rtdata/data/config_value.hpp"

#include <array>
#include <charconv>
#include <cmath>
#include <utility>

namespace rtdata {
namespace config_detail {
namespace {

bool wrong_type(const ConfigItem& item, std::string_view wanted, Problems& problems) {
  problems.add(item.problem("wrong-type", "expected " + std::string(wanted) + ", got " + item.describe()));
  return false;
}

bool out_of_range(const ConfigItem& item, const std::string& least, const std::string& most, Problems& problems) {
  problems.add(item.problem("out-of-range", item.number_text() + " is out of range: " + least + " to " + most));
  return false;
}

/// "1 GB" as a number of bytes; empty when the text is not a size.
std::string bytes_of(std::string_view text) {
  constexpr std::pair<std::string_view, double> units[] = {
      {"B", 1},           {"kB", 1e3},           {"KB", 1e3}, {"MB", 1e6}, {"GB", 1e9}, {"TB", 1e12}, {"KiB", 1024.0},
      {"MiB", 1048576.0}, {"GiB", 1073741824.0}, {"k", 1e3},  {"K", 1e3},  {"M", 1e6},  {"G", 1e9}};
  double number = 0;
  const auto [end, failed] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (failed != std::errc{}) return "";
  text.remove_prefix(static_cast<std::size_t>(end - text.data()));
  while (text.starts_with(' ')) text.remove_prefix(1);
  for (const auto& [name, bytes] : units) {
    if (text == name && number >= 0 && number * bytes < 9e15) return std::to_string(std::llround(number * bytes));
  }
  return "";
}

/// For a text such as "1 GB", suggests the number of bytes.
bool not_whole(const ConfigItem& item, Problems& problems) {
  const std::string* text = item.as_string();
  const std::string bytes = text != nullptr ? bytes_of(*text) : "";
  if (bytes.empty()) return wrong_type(item, "a whole number", problems);
  problems.add(item.problem("wrong-type", "expected a whole number, got " + item.describe() + ": write " + bytes));
  return false;
}

/// Above this limit a double loses digits, so a number with a point or exponent may not be exact.
constexpr double exact_limit = 9007199254740992.0;

/// Also a whole number with a point or exponent, when a double holds it exactly.
enum class Whole { yes, no, too_large };
Whole whole_number(double value, std::int64_t& out) {
  if (!(std::fabs(value) <= exact_limit)) return Whole::too_large;
  if (value != std::floor(value)) return Whole::no;
  out = static_cast<std::int64_t>(value);
  return Whole::yes;
}

std::string reason(const Error& error) {
  std::string text = error.why.empty() ? error.what : error.why;
  if (!error.advice.empty()) text += "; " + error.advice;
  return text;
}

}  // namespace

bool read_boolean(const ConfigItem& item, bool& out, Problems& problems) {
  const bool* value = item.as_boolean();
  if (value == nullptr) return wrong_type(item, "true or false", problems);
  out = *value;
  return true;
}

bool read_signed(const ConfigItem& item, std::int64_t least, std::int64_t most, std::int64_t& out, Problems& problems) {
  if (item.as_unsigned() != nullptr) return out_of_range(item, std::to_string(least), std::to_string(most), problems);
  if (const std::int64_t* value = item.as_signed()) {
    out = *value;
  } else if (const double* number = item.as_number()) {
    switch (whole_number(*number, out)) {
      case Whole::yes:
        break;
      case Whole::no:
        return wrong_type(item, "a whole number", problems);
      case Whole::too_large:
        return out_of_range(item, std::to_string(least), std::to_string(most), problems);
    }
  } else {
    return not_whole(item, problems);
  }
  if (out < least || out > most) return out_of_range(item, std::to_string(least), std::to_string(most), problems);
  return true;
}

bool read_unsigned(const ConfigItem& item, std::uint64_t most, std::uint64_t& out, Problems& problems) {
  std::int64_t small = 0;
  if (const std::uint64_t* value = item.as_unsigned()) {
    out = *value;
  } else if (const std::int64_t* integer = item.as_signed()) {
    if (*integer < 0) return out_of_range(item, "0", std::to_string(most), problems);
    out = static_cast<std::uint64_t>(*integer);
  } else if (const double* number = item.as_number()) {
    switch (whole_number(*number, small)) {
      case Whole::yes:
        break;
      case Whole::no:
        return wrong_type(item, "a whole number", problems);
      case Whole::too_large:
        return out_of_range(item, "0", std::to_string(most), problems);
    }
    if (small < 0) return out_of_range(item, "0", std::to_string(most), problems);
    out = static_cast<std::uint64_t>(small);
  } else {
    return not_whole(item, problems);
  }
  if (out > most) return out_of_range(item, "0", std::to_string(most), problems);
  return true;
}

namespace {

template <class Float>
bool read_floating(const ConfigItem& item, Float& out, Problems& problems) {
  const auto inexact = [&] {
    problems.add(
        item.problem("out-of-range", item.number_text() + " has more digits than the type of this value keeps"));
    return false;
  };
  if (const double* number = item.as_number()) {
    if (std::fabs(*number) > static_cast<double>(std::numeric_limits<Float>::max()))
      return out_of_range(item, "-3.4e38", "3.4e38", problems);
    out = static_cast<Float>(*number);
  } else if (const std::int64_t* integer = item.as_signed()) {
    out = static_cast<Float>(*integer);
    // 2^63 itself is not an int64: converting it back would be undefined.
    if (out >= static_cast<Float>(9223372036854775808.0) || static_cast<std::int64_t>(out) != *integer)
      return inexact();
  } else if (const std::uint64_t* large = item.as_unsigned()) {
    out = static_cast<Float>(*large);
    if (out >= static_cast<Float>(18446744073709551616.0) || static_cast<std::uint64_t>(out) != *large)
      return inexact();
  } else {
    return wrong_type(item, "a number", problems);
  }
  return true;
}

}  // namespace

bool read_float(const ConfigItem& item, float& out, Problems& problems) { return read_floating(item, out, problems); }
bool read_double(const ConfigItem& item, double& out, Problems& problems) { return read_floating(item, out, problems); }

bool read_string(const ConfigItem& item, std::string_view& out, Problems& problems) {
  const std::string* text = item.as_string();
  if (text == nullptr) return wrong_type(item, "a string", problems);
  out = *text;
  return true;
}

bool read_character(const ConfigItem& item, char& out, Problems& problems) {
  const std::string* text = item.as_string();
  if (text == nullptr || text->size() != 1) return wrong_type(item, "a string of one character", problems);
  out = text->front();
  return true;
}

bool read_duration(const ConfigItem& item, Duration& out, Sign sign, Problems& problems) {
  const std::string* text = item.as_string();
  if (text == nullptr) return wrong_type(item, "a duration with its unit, such as \"10 ms\"", problems);
  const std::size_t start = text->find_first_not_of(' ');
  const bool negative = sign == Sign::any && start != std::string::npos && (*text)[start] == '-';
  const auto parsed = parse_duration(std::string_view(*text).substr(negative ? start + 1 : 0));
  if (parsed) {
    out = negative ? -*parsed : *parsed;
    return true;
  }
  problems.add(item.problem("bad-value", item.describe() + " is not a duration: " + reason(parsed.error())));
  return false;
}

bool read_rate(const ConfigItem& item, Rate& out, Problems& problems) {
  const std::string* text = item.as_string();
  if (text == nullptr) return wrong_type(item, "a rate with its unit, such as \"100 Hz\"", problems);
  const auto parsed = parse_rate(*text);
  if (parsed) {
    out = *parsed;
    return true;
  }
  problems.add(item.problem("bad-value", item.describe() + " is not a rate: " + reason(parsed.error())));
  return false;
}

bool check_is_array(const ConfigItem& item, Problems& problems) {
  return item.is_array() || wrong_type(item, "a list", problems);
}

bool check_is_object(const ConfigItem& item, Problems& problems) {
  if (item.is_object()) return true;
  const std::string* const name = item.as_string();
  // For lists of fields, states or sensors, of which each item has at least a name.
  if (name == nullptr || !item.path().ends_with(']')) return wrong_type(item, "an object", problems);
  constexpr std::string_view before = "the string ";
  const std::string got = item.describe();
  problems.add(item.problem(
      "wrong-type", "expected an object, got " + got + "; write {\"name\": " + got.substr(before.size()) + "}"));
  return false;
}

bool check_length(const ConfigItem& item, std::size_t length, Problems& problems) {
  if (item.size() == length) return true;
  problems.add(item.problem(
      "wrong-length", "expected a list of " + std::to_string(length) + ", got one of " + std::to_string(item.size())));
  return false;
}

void add_inexact_duration(const ConfigItem& item, Problems& problems) {
  problems.add(item.problem("out-of-range", item.describe() + " is finer or longer than the type of this value keeps"));
}

}  // namespace config_detail

void ConfigValue<float>::write(float value, ConfigItem& item) {
  std::array<char, 32> buffer{};
  const auto end = std::to_chars(buffer.data(), buffer.data() + buffer.size(), value).ptr;
  double shortest = value;
  std::from_chars(buffer.data(), end, shortest);
  item.set_number(shortest);
}

void ConfigValue<Rate>::write(Rate value, ConfigItem& item) {
  if (!value)
    item.set_null();
  else if (std::string text = to_string(value); parse_rate(text) && *parse_rate(text) == value)
    item.set_string(text);
  else
    item.set_string(to_string(value.period()));
}

}  // namespace rtdata
