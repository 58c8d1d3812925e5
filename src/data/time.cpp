#include "rtdata/data/time.hpp"

#include <charconv>
#include <limits>

#include "data/time_text.hpp"

namespace rtdata {
namespace {

constexpr std::int64_t longest = std::numeric_limits<std::int64_t>::max();
constexpr std::uint64_t second = 1'000'000'000;

struct Unit {
  std::string_view name;
  std::uint64_t nanoseconds;
};
constexpr Unit units[] = {
    {"ns", 1},     {"us", 1000},         {"\u00b5s", 1000},    {"\u03bcs", 1000},    {"ms", 1'000'000},
    {"s", second}, {"min", 60 * second}, {"h", 3600 * second}, {"d", 86400 * second}};

bool is_digit(char c) { return c >= '0' && c <= '9'; }
bool is_space(char c) { return c == ' ' || c == '\t'; }

std::string_view trim(std::string_view text) {
  while (!text.empty() && is_space(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_space(text.back())) text.remove_suffix(1);
  return text;
}

/// The parts of "12.50 ms"; the digits are views into the text.
struct Quantity {
  std::string_view whole;
  std::string_view fraction;  ///< without trailing zeros
  std::string_view unit;
  bool negative = false;
  bool is_number = false;
};

constexpr const char* decimal_comma = "its decimals come after a comma";
constexpr const char* decimal_advice = "write a point, such as 2.5";
bool has_decimal_comma(const Quantity& q) {
  return q.fraction.empty() && q.unit.size() > 1 && q.unit[0] == ',' && q.unit[1] >= '0' && q.unit[1] <= '9';
}

Quantity take_apart(std::string_view text) {
  Quantity q;
  text = trim(text);
  if (!text.empty() && (text.front() == '-' || text.front() == '+')) {
    q.negative = text.front() == '-';
    text.remove_prefix(1);
  }
  std::size_t i = 0;
  while (i < text.size() && is_digit(text[i])) ++i;
  q.whole = text.substr(0, i);
  std::size_t begin = i;
  if (i < text.size() && text[i] == '.') {
    begin = ++i;
    while (i < text.size() && is_digit(text[i])) ++i;
    if (i == begin) return q;  // "1." has no fraction
  }
  q.fraction = text.substr(begin, i - begin);
  while (!q.fraction.empty() && q.fraction.back() == '0') q.fraction.remove_suffix(1);
  while (q.whole.size() > 1 && q.whole.front() == '0') q.whole.remove_prefix(1);
  q.unit = trim(text.substr(i));
  q.is_number = !q.whole.empty();
  return q;
}

std::string quoted(std::string_view text) {
  std::string quoted = "\"";
  return quoted.append(text.substr(0, 60)).append(text.size() > 60 ? "...\"" : "\"");
}

/// value * factor + more, false when it does not fit into 63 bits.
bool multiply(std::uint64_t value, std::uint64_t factor, std::uint64_t more, std::uint64_t& result) {
  constexpr auto most = static_cast<std::uint64_t>(longest);
  if (factor != 0 && value > (most - more) / factor) return false;
  result = value * factor + more;
  return result <= most;
}

bool to_number(std::string_view digits, std::uint64_t& number) {
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), number);
  return error == std::errc{} && end == digits.data() + digits.size();
}

Error not_a_duration(std::string_view text, Errc code, std::string why, std::string advice) {
  return {code, "not a duration", quoted(text), std::move(why), std::move(advice)};
}

Error not_a_rate(std::string_view text, Errc code, std::string why, std::string advice) {
  return {code, "not a rate", quoted(text), std::move(why), std::move(advice)};
}

Error not_a_time(std::string_view text, std::string why) {
  return {Errc::bad_argument, "not a time", quoted(text), std::move(why), "write it as 2026-03-01T12:00:00.5Z"};
}

void append_padded(std::string& text, std::uint64_t number, int width) {
  char digits[20];
  for (int i = width; i-- > 0; number /= 10) digits[i] = static_cast<char>('0' + number % 10);
  text.append(digits, static_cast<std::size_t>(width));
}

/// "1.5": `value` counted in `unit`, exactly; unit is a power of ten.
std::string decimal(std::uint64_t value, std::uint64_t unit) {
  std::string text = std::to_string(value / unit);
  int width = 0;
  for (std::uint64_t u = unit; u > 1; u /= 10) ++width;
  if (const std::uint64_t rest = value % unit; rest != 0) {
    text += '.';
    append_padded(text, rest, width);
    while (text.back() == '0') text.pop_back();
  }
  return text;
}

/// Reads a fixed number of digits.
bool take_digits(std::string_view& text, std::size_t count, unsigned& number) {
  if (text.size() < count) return false;
  number = 0;
  for (std::size_t i = 0; i < count; ++i) {
    if (!is_digit(text[i])) return false;
    number = number * 10 + static_cast<unsigned>(text[i] - '0');
  }
  text.remove_prefix(count);
  return true;
}

bool take(std::string_view& text, std::string_view any_of) {
  if (text.empty() || any_of.find(text.front()) == std::string_view::npos) return false;
  text.remove_prefix(1);
  return true;
}

}  // namespace

Time wall_clock_now() noexcept { return std::chrono::time_point_cast<Duration>(std::chrono::system_clock::now()); }

char* detail::put_iso8601(char* to, Time time) noexcept {
  const std::int64_t total = to_nanoseconds(time);
  constexpr auto per_day = static_cast<std::int64_t>(86400 * second);
  std::int64_t days = total / per_day;
  std::int64_t rest = total % per_day;
  if (rest < 0) {
    rest += per_day;
    --days;
  }
  const std::chrono::year_month_day date{std::chrono::sys_days(std::chrono::days(days))};
  const auto within = static_cast<std::uint64_t>(rest);
  const auto put = [&to](std::uint64_t number, int digits, char after) {
    for (int i = digits - 1; i >= 0; --i, number /= 10) to[i] = static_cast<char>('0' + number % 10);
    to += digits;
    *to++ = after;
  };
  put(static_cast<std::uint64_t>(int{date.year()}), 4, '-');
  put(unsigned{date.month()}, 2, '-');
  put(unsigned{date.day()}, 2, 'T');
  put(within / (3600 * second), 2, ':');
  put(within / (60 * second) % 60, 2, ':');
  put(within / second % 60, 2, '.');
  put(within % second, 9, 'Z');
  return to;
}

std::string to_iso8601(Time time) {
  char text[detail::iso8601_size];
  return {text, detail::put_iso8601(text, time)};
}

Result<Time> parse_iso8601(std::string_view text) {
  const std::string_view all = text;
  text = trim(text);
  unsigned year = 0, month = 0, day = 0, hour = 0, minute = 0, seconds = 0;
  if (!take_digits(text, 4, year) || !take(text, "-") || !take_digits(text, 2, month) || !take(text, "-") ||
      !take_digits(text, 2, day)) {
    return not_a_time(all, "it does not start with a date such as 2026-03-01");
  }
  if (!take(text, "Tt ") || !take_digits(text, 2, hour) || !take(text, ":") || !take_digits(text, 2, minute))
    return not_a_time(all, "no time of day such as T12:00 or T12:00:00 follows the date");
  const bool has_seconds = take(text, ":");
  if (has_seconds && !take_digits(text, 2, seconds)) return not_a_time(all, "no seconds such as 00 follow the minutes");
  std::uint64_t fraction = 0;
  if (has_seconds && take(text, ".,")) {
    std::size_t count = 0;
    for (; count < text.size() && is_digit(text[count]); ++count) {
      if (count == 9) return not_a_time(all, "it has more than nine decimals");
      fraction = fraction * 10 + static_cast<unsigned>(text[count] - '0');
    }
    if (count == 0) return not_a_time(all, "no digit follows the decimal point");
    text.remove_prefix(count);
    for (; count < 9; ++count) fraction *= 10;
  }
  std::int64_t offset = 0;
  if (!take(text, "Zz")) {
    if (text.empty()) return not_a_time(all, "the time zone is missing");
    const bool west = text.front() == '-';
    unsigned hours = 0, minutes = 0;
    if (!take(text, "+-") || !take_digits(text, 2, hours))
      return not_a_time(all, "the time zone is neither Z nor +02:00");
    take(text, ":");
    if (!take_digits(text, 2, minutes) || hours > 23 || minutes > 59) {
      return not_a_time(all, "the time zone is neither Z nor +02:00");
    }
    offset = static_cast<std::int64_t>(hours) * 3600 + minutes * 60;
    if (west) offset = -offset;
  }
  if (!text.empty()) return not_a_time(all, "something follows the time");
  const std::chrono::year_month_day date{std::chrono::year(static_cast<int>(year)), std::chrono::month(month),
                                         std::chrono::day(day)};
  if (!date.ok()) return not_a_time(all, "there is no such day");
  if (hour > 23 || minute > 59) return not_a_time(all, "there is no such time of day");
  if (seconds > 59) return not_a_time(all, "seconds go up to 59 (leap seconds are not counted)");
  const std::int64_t since_epoch = std::int64_t{std::chrono::sys_days(date).time_since_epoch().count()} * 86400 +
                                   static_cast<std::int64_t>(hour * 3600 + minute * 60 + seconds) - offset;
  // Counted from the second above zero for times before 1970, so that the sum stays in range at both ends.
  const bool before = since_epoch < 0;
  const std::int64_t whole = before ? since_epoch + 1 : since_epoch;
  const std::int64_t part = static_cast<std::int64_t>(fraction) - (before ? static_cast<std::int64_t>(second) : 0);
  constexpr auto scale = static_cast<std::int64_t>(second);
  if (whole > longest / scale || whole < -(longest / scale) || (whole > 0 && whole * scale > longest - part) ||
      (whole < 0 && whole * scale < std::numeric_limits<std::int64_t>::min() - part)) {
    return not_a_time(all, "64-bit nanoseconds reach from 1677-09-21 to 2262-04-11");
  }
  return from_nanoseconds(whole * scale + part);
}

Result<Duration> parse_duration(std::string_view text) {
  constexpr const char* known = "the units are ns, us, ms, s, min, h, d";
  const Quantity q = take_apart(text);
  if (!q.is_number) {
    return not_a_duration(text, Errc::not_a_number, "it does not start with a number", "write one such as \"10 ms\"");
  }
  if (q.negative) return not_a_duration(text, Errc::out_of_range, "it is negative", "write one such as \"10 ms\"");
  if (q.unit.empty()) {
    const std::string number(trim(text).substr(0, 20));
    return not_a_duration(text, Errc::bad_argument, "it has no unit",
                          "write a unit, such as \"" + number + " s\" or \"" + number + " ms\"");
  }
  for (const Unit& unit : units) {
    if (unit.name != q.unit) continue;
    const auto too_long = [&] {
      return not_a_duration(text, Errc::out_of_range, "it is longer than 292 years", "write a shorter one");
    };
    std::uint64_t part = 0;  // from the last digit; a division with a remainder means less than a nanosecond
    for (std::size_t i = q.fraction.size(); i-- > 0;) {
      part += static_cast<std::uint64_t>(q.fraction[i] - '0') * unit.nanoseconds;
      if (part % 10 != 0) {
        return not_a_duration(text, Errc::out_of_range, "it is finer than a nanosecond", "write fewer decimals");
      }
      part /= 10;
    }
    std::uint64_t whole = 0;
    std::uint64_t result = 0;
    if (!to_number(q.whole, whole) || !multiply(whole, unit.nanoseconds, part, result)) return too_long();
    return Duration{static_cast<std::int64_t>(result)};
  }
  if (has_decimal_comma(q)) return not_a_duration(text, Errc::bad_argument, decimal_comma, decimal_advice);
  return not_a_duration(text, Errc::bad_argument, "the unit " + quoted(q.unit) + " is not known", known);
}

std::string to_string(Duration duration) {
  const std::int64_t count = duration.count();
  if (count == 0) return "0 s";
  const std::uint64_t value = count < 0 ? std::uint64_t{0} - static_cast<std::uint64_t>(count)
                                        : static_cast<std::uint64_t>(count);
  std::string text = count < 0 ? "-" : "";
  for (const auto& [name, unit] : {Unit{"d", 86400 * second}, Unit{"h", 3600 * second}, Unit{"min", 60 * second}}) {
    if (value % unit == 0) return text + std::to_string(value / unit) + " " + std::string(name);
  }
  for (const auto& [name, unit] : {Unit{"s", second}, Unit{"ms", 1'000'000}, Unit{"us", 1000}, Unit{"ns", 1}}) {
    if (value >= unit) return text + decimal(value, unit) + " " + std::string(name);
  }
  return text;
}

Result<Rate> parse_rate(std::string_view text) {
  const char* advice = "write a rate such as \"100 Hz\", \"2 kHz\" or \"6 /min\", or a period such as \"10 ms\"";
  std::string_view rest = trim(text);
  const bool is_period = rest.starts_with("every ");
  if (is_period) rest.remove_prefix(6);
  const Quantity q = take_apart(rest);
  if (!q.is_number) return not_a_rate(text, Errc::not_a_number, "it does not start with a number", advice);
  if (q.negative) return not_a_rate(text, Errc::out_of_range, "it is negative", advice);
  if (q.unit.empty()) {
    return not_a_rate(text, Errc::bad_argument, "it has no unit",
                      "write a unit, such as \"" + std::string(trim(rest).substr(0, 20)) + " Hz\"");
  }
  struct Frequency {
    std::string_view name;
    std::uint64_t seconds;  ///< that the number is counted in
    int exponent;           ///< of its power of ten
  };
  constexpr Frequency frequencies[] = {{"mHz", 1, -3}, {"Hz", 1, 0}, {"kHz", 1, 3},   {"MHz", 1, 6},
                                       {"GHz", 1, 9},  {"/s", 1, 0}, {"/min", 60, 0}, {"/h", 3600, 0}};
  for (const Frequency& frequency : frequencies) {
    if (is_period || frequency.name != q.unit) continue;
    std::string digits(q.whole);
    digits += q.fraction;
    std::uint64_t number = 0;
    if (digits.size() > 18 || !to_number(digits, number)) {
      return not_a_rate(text, Errc::out_of_range, "it has more than 18 digits", advice);
    }
    if (number == 0) return not_a_rate(text, Errc::out_of_range, "nothing happens at a rate of zero", advice);
    // period in ns = seconds * 10^(9 + decimals - exponent) / number, by long division; rounded to the nearest.
    std::uint64_t quotient = frequency.seconds / number;
    std::uint64_t remainder = frequency.seconds % number;
    for (int e = 9 + static_cast<int>(q.fraction.size()) - frequency.exponent; e > 0; --e) {
      remainder *= 10;
      if (!multiply(quotient, 10, remainder / number, quotient)) {
        return not_a_rate(text, Errc::out_of_range, "its period is longer than 292 years", advice);
      }
      remainder %= number;
    }
    if (remainder * 2 >= number) ++quotient;
    if (quotient == 0) return not_a_rate(text, Errc::out_of_range, "it is faster than 1 GHz", advice);
    return Rate::from_period(Duration{static_cast<std::int64_t>(quotient)});
  }
  auto period = parse_duration(rest);
  if (!period) {
    const Error& error = period.error();
    if (error.code == Errc::bad_argument) {
      if (has_decimal_comma(q)) return not_a_rate(text, Errc::bad_argument, decimal_comma, decimal_advice);
      return not_a_rate(text, Errc::bad_argument, "the unit " + quoted(q.unit) + " is not known",
                        "the units are Hz, kHz, MHz, /s, /min, /h, or those of a period: ns, us, ms, s, min, h, d");
    }
    return not_a_rate(text, static_cast<Errc>(error.code.value()), error.why, advice);
  }
  if (period->count() == 0) return not_a_rate(text, Errc::out_of_range, "a period of zero is not a rate", advice);
  return Rate::from_period(*period);
}

std::string to_string(Rate rate) {
  if (!rate) return "no rate";
  const double hertz = rate.hertz();
  const auto& [name, scale] = hertz >= 1e6   ? std::pair{" MHz", 1e6}
                              : hertz >= 1e3 ? std::pair{" kHz", 1e3}
                                             : std::pair{" Hz", 1.0};
  // A round rate: few digits give the same period when read back.
  for (int digits = 1; digits <= 4; ++digits) {
    char buffer[32];
    const auto end = std::to_chars(buffer, buffer + sizeof buffer, hertz / scale, std::chars_format::general, digits)
                         .ptr;
    double rounded = 0;
    std::from_chars(buffer, end, rounded);
    // Without an exponent, which the general format uses for small and for large numbers.
    const auto plain = std::to_chars(buffer, buffer + sizeof buffer, rounded, std::chars_format::fixed);
    if (plain.ec != std::errc{}) continue;
    std::string text(buffer, plain.ptr);
    text += name;
    if (text.size() > 12) continue;
    const auto read = parse_rate(text);
    if (read && *read == rate) return text;
  }
  return "every " + to_string(rate.period());
}

}  // namespace rtdata
