#include "data/ucum.hpp"
#include "data/lower_case.hpp"

#include <algorithm>
#include <array>
#include <utility>

namespace rtdata::detail {
namespace {

constexpr std::array<std::string_view, 24> prefixes{"Y", "Z", "E", "P", "T", "G", "M", "k", "h",  "da", "d",  "c",
                                                    "m", "u", "n", "p", "f", "a", "z", "y", "Ki", "Mi", "Gi", "Ti"};
/// They take prefixes.
constexpr std::array<std::string_view, 52> metric{
    "m", "s",  "g",   "rad", "K", "C",   "cd", "mol", "sr",  "Hz",  "N",  "Pa", "J",   "W", "A",   "V", "F",  "Ohm",
    "S", "Wb", "Cel", "T",   "H", "lm",  "lx", "Bq",  "Gy",  "Sv",  "l",  "L",  "ar",  "t", "bar", "u", "eV", "pc",
    "B", "Bd", "By",  "bit", "G", "Gal", "P",  "St",  "erg", "dyn", "Ci", "R",  "kat", "U", "cal", "Np"};
constexpr std::array<std::string_view, 31> others{
    "%",   "gon", "deg", "'",     "''",   "min", "h",  "d", "wk",  "mo", "a",  "a_j", "a_g", "mo_s", "mo_j", "mo_g",
    "har", "AU",  "atm", "bit_s", "circ", "sph", "Ao", "b", "att", "Mx", "Oe", "ph",  "osm", "eq",   "mho"};

template <class Texts>
bool is_among(const Texts& texts, std::string_view text) noexcept {
  return std::find(texts.begin(), texts.end(), text) != texts.end();
}

bool is_digit(char c) noexcept { return c >= '0' && c <= '9'; }

bool is_symbol(std::string_view symbol) noexcept {
  if (const auto bracket = symbol.find('['); bracket != std::string_view::npos) {
    std::string_view head = symbol.substr(0, bracket);  // mm[Hg], dB[SPL], k[IU]
    if (head.ends_with('m') || head.ends_with('B')) head.remove_suffix(1);
    return symbol.ends_with(']') && symbol.size() > bracket + 2 && (head.empty() || is_among(prefixes, head));
  }
  if (is_among(metric, symbol) || is_among(others, symbol)) return true;
  return std::any_of(prefixes.begin(), prefixes.end(), [&](std::string_view prefix) {
    return symbol.starts_with(prefix) && is_among(metric, symbol.substr(prefix.size()));
  });
}

class Parser {
 public:
  explicit Parser(std::string_view text) : rest_(text) {}

  bool is_unit() noexcept {
    take('/');
    return is_term(0) && rest_.empty();
  }

 private:
  bool take(char c) noexcept {
    if (!rest_.starts_with(c)) return false;
    rest_.remove_prefix(1);
    return true;
  }
  bool is_term(int depth) noexcept {
    do {
      if (!is_component(depth)) return false;
    } while (take('.') || take('/'));
    return true;
  }
  bool is_component(int depth) noexcept {
    constexpr int deepest = 16;
    if (take('(')) return depth < deepest && is_term(depth + 1) && take(')');
    const bool has_symbol = !rest_.empty() && rest_.front() != '{';
    if (has_symbol && !is_annotatable()) return false;
    const bool has_annotation = take('{');
    if (has_annotation) {
      const auto end = rest_.find('}');
      if (end == std::string_view::npos) return false;
      rest_.remove_prefix(end + 1);
    }
    return has_symbol || has_annotation;
  }
  bool is_annotatable() noexcept {
    if (rest_.starts_with("10*") || rest_.starts_with("10^")) {
      rest_.remove_prefix(3);
      skip_exponent();
      return true;
    }
    std::size_t end = 0;
    for (bool in_brackets = false; end < rest_.size(); ++end) {
      const char c = rest_[end];
      if (c == '[') in_brackets = true;
      if (c == ']') in_brackets = false;
      if (!in_brackets && std::string_view("./(){").find(c) != std::string_view::npos) break;
    }
    std::string_view symbol = rest_.substr(0, end);
    rest_.remove_prefix(end);
    const std::size_t all = symbol.size();
    while (!symbol.empty() && is_digit(symbol.back())) symbol.remove_suffix(1);
    if (symbol.empty()) return all > 0;  // a factor
    if (symbol.size() < all && (symbol.ends_with('-') || symbol.ends_with('+'))) symbol.remove_suffix(1);
    return is_symbol(symbol);
  }
  void skip_exponent() noexcept {
    if (!take('-')) take('+');
    while (!rest_.empty() && is_digit(rest_.front())) rest_.remove_prefix(1);
  }

  std::string_view rest_;
};

/// Common spellings, in lower case.
constexpr std::array<std::pair<std::string_view, std::string_view>, 96> meant{{
    {"degc", "Cel"},
    {"deg c", "Cel"},
    {"\xc2\xb0"
     "c",
     "Cel"},
    {"celsius", "Cel"},
    {"centigrade", "Cel"},
    {"cels", "Cel"},
    {"degf", "[degF]"},
    {"deg f", "[degF]"},
    {"\xc2\xb0"
     "f",
     "[degF]"},
    {"fahrenheit", "[degF]"},
    {"degk", "K"},
    {"kelvin", "K"},
    {"\xc2\xb0", "deg"},
    {"degree", "deg"},
    {"degrees", "deg"},
    {"dps", "deg/s"},
    {"radian", "rad"},
    {"radians", "rad"},
    {"sec", "s"},
    {"secs", "s"},
    {"second", "s"},
    {"seconds", "s"},
    {"msec", "ms"},
    {"usec", "us"},
    {"\xc2\xb5s", "us"},
    {"minute", "min"},
    {"minutes", "min"},
    {"hr", "h"},
    {"hrs", "h"},
    {"hour", "h"},
    {"hours", "h"},
    {"day", "d"},
    {"days", "d"},
    {"volt", "V"},
    {"volts", "V"},
    {"millivolt", "mV"},
    {"amp", "A"},
    {"amps", "A"},
    {"ampere", "A"},
    {"watt", "W"},
    {"watts", "W"},
    {"wh", "W.h"},
    {"kwh", "kW.h"},
    {"ah", "A.h"},
    {"mah", "mA.h"},
    {"va", "V.A"},
    {"ohm", "Ohm"},
    {"ohms", "Ohm"},
    {"\xce\xa9", "Ohm"},
    {"\xe2\x84\xa6", "Ohm"},
    {"hertz", "Hz"},
    {"hz", "Hz"},
    {"khz", "kHz"},
    {"mhz", "MHz"},
    {"rpm", "/min"},
    {"cpm", "/min"},
    {"bpm", "/min"},
    {"meter", "m"},
    {"meters", "m"},
    {"metre", "m"},
    {"metres", "m"},
    {"in", "[in_i]"},
    {"inch", "[in_i]"},
    {"inches", "[in_i]"},
    {"ft", "[ft_i]"},
    {"feet", "[ft_i]"},
    {"mile", "[mi_i]"},
    {"miles", "[mi_i]"},
    {"mph", "[mi_i]/h"},
    {"kph", "km/h"},
    {"kmh", "km/h"},
    {"kmph", "km/h"},
    {"kt", "[kn_i]"},
    {"kn", "[kn_i]"},
    {"knot", "[kn_i]"},
    {"knots", "[kn_i]"},
    {"lb", "[lb_av]"},
    {"lbs", "[lb_av]"},
    {"psi", "[psi]"},
    {"mmhg", "mm[Hg]"},
    {"inhg", "[in_i'Hg]"},
    {"mbars", "mbar"},
    {"pascal", "Pa"},
    {"hpa", "hPa"},
    {"kpa", "kPa"},
    {"gauss", "G"},
    {"\xc2\xb5t", "uT"},
    {"lux", "lx"},
    {"percent", "%"},
    {"%rh", "%{RH}"},
    {"rh", "%{RH}"},
    {"ppm", "[ppm]"},
    {"ppb", "[ppb]"},
    {"byte", "By"},
    {"bytes", "By"},
    {"nm", "N.m"},
}};

std::string replaced(std::string text, std::string_view what, std::string_view by) {
  for (auto at = text.find(what); at != std::string::npos; at = text.find(what, at + by.size()))
    text.replace(at, what.size(), by);
  return text;
}

}  // namespace

bool is_ucum(std::string_view unit) noexcept {
  const auto is_plain = [](char c) { return c > ' ' && c <= '~'; };
  if (!std::all_of(unit.begin(), unit.end(), is_plain)) return false;
  return unit.empty() || Parser(unit).is_unit();
}

std::string ucum_for(std::string_view unit) {
  // Other notations of signs and exponents: m/s^2, m/s**2, m/s with a superscript 2, m*s, a micro sign.
  std::string same(unit);
  for (const auto& [what, by] : {std::pair<std::string_view, std::string_view>{"**", ""},
                                 {"^", ""},
                                 {"\xc2\xb2", "2"},
                                 {"\xc2\xb3", "3"},
                                 {"\xc2\xb7", "."},
                                 {"*", "."},
                                 {" ", ""},
                                 {"\xc2\xb5", "u"},
                                 {"\xce\xbc", "u"}}) {
    same = replaced(std::move(same), what, by);
  }
  if (!same.empty() && same != unit && is_ucum(same)) return same;
  const std::string wanted = detail::lower_case(unit);
  for (const auto& [written, ucum] : meant)
    if (written == wanted) return std::string(ucum);
  for (const std::string_view symbol : metric)
    if (detail::lower_case(symbol) == wanted) return std::string(symbol);
  // A quotient of these: degC/min.
  if (const auto slash = unit.rfind('/'); slash != std::string_view::npos && slash > 0) {
    const auto part = [](std::string_view text) { return is_ucum(text) ? std::string(text) : ucum_for(text); };
    const std::string above = part(unit.substr(0, slash));
    const std::string below = part(unit.substr(slash + 1));
    if (!above.empty() && !below.empty() && is_ucum(above + "/" + below)) return above + "/" + below;
  }
  // Any other word becomes an annotation.
  const auto is_letter = [](char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_'; };
  if (!unit.empty() && std::all_of(unit.begin(), unit.end(), is_letter)) return "{" + std::string(unit) + "}";
  return "";
}

}  // namespace rtdata::detail
