#include "app/inspect/import_time.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>
#include <string_view>
#include <utility>

#include "app/inspect/import_time_format.hpp"
#include "app/inspect/import_zone.hpp"
#include "data/lower_case.hpp"
#include "data/number_text.hpp"
#include "data/saturating.hpp"

namespace rtdata::app {
namespace {

/// `scale` times a number such as "1795665132.554291437", exact to the nanosecond (a double would be wrong by up to 119
/// ns). Empty: another notation, or too large.
std::optional<Duration> exact_time(std::string_view text, Duration scale) {
  const bool is_negative = text.starts_with('-');
  if (is_negative || text.starts_with('+')) text.remove_prefix(1);
  const std::size_t mark = text.find('.');
  const std::string_view whole_part = text.substr(0, mark);
  std::string_view part = mark == std::string_view::npos ? std::string_view() : text.substr(mark + 1);
  const auto is_digits = [](std::string_view digits) {
    return std::all_of(digits.begin(), digits.end(), [](char c) { return c >= '0' && c <= '9'; });
  };
  std::int64_t whole = 0;
  if (!is_digits(whole_part) || !is_digits(part) || detail::read_number(whole_part, whole) != std::errc{}) return {};
  // 18 digits of the fraction and the scale, in two halves each: their products fit.
  constexpr std::int64_t half = 1'000'000'000;
  const std::string digits = (std::string(part) + std::string(18, '0')).substr(0, 18);
  const std::int64_t high = std::stoll(digits.substr(0, 9)), low = std::stoll(digits.substr(9));
  const std::int64_t scale_high = scale.count() / half, scale_low = scale.count() % half;
  if (scale_high >= half) return {};
  const std::int64_t of_high = high * scale_low, of_low = low * scale_high;
  const std::int64_t rest = of_high % half + of_low % half + low * scale_low / half;
  const std::int64_t fraction = high * scale_high + of_high / half + of_low / half + (rest + half / 2) / half;
  constexpr std::int64_t most = 9'200'000'000'000'000'000;
  if (whole > (most - fraction) / scale.count()) return {};
  const std::int64_t ns = whole * scale.count() + fraction;
  return Duration{is_negative ? -ns : ns};
}

/// Empty: the time cannot be recorded (only 1678 to 2261).
std::optional<Time> later_than(Time start, Duration by) {
  constexpr std::int64_t most = 9'200'000'000'000'000'000;
  std::int64_t sum = 0;
  if (__builtin_add_overflow(start.time_since_epoch().count(), by.count(), &sum) || sum > most || sum < -most)
    return {};
  return Time{Duration{sum}};
}

}  // namespace

std::string_view usual_number(std::string_view text, const ImportNumbers& written, std::string& buffer) {
  const std::string& between = written.thousands;
  // "-   0.512", as in fields of fixed width, and the minus sign that is not a hyphen.
  constexpr std::string_view minus = "\u2212";
  std::string with_sign;
  const bool has_minus = text.starts_with(minus);
  const bool has_blank = text.size() > 2 && (text[0] == '-' || text[0] == '+') && text[1] == ' ';
  if (has_minus || has_blank) {
    const std::string_view rest = text.substr(has_minus ? minus.size() : 1);
    with_sign = has_minus ? "-" : std::string(1, text[0]);
    with_sign += rest.substr(std::min(rest.find_first_not_of(' '), rest.size()));
    text = with_sign;
  }
  if (written.decimal == '.' && between.empty()) return with_sign.empty() ? text : (buffer = with_sign);
  if (written.decimal != '.' && between != "." && text.find('.') != std::string_view::npos) return {};
  const std::size_t mark = text.find(written.decimal);
  std::string_view whole = text.substr(0, mark);
  buffer.clear();
  for (bool is_first = true;; is_first = false) {
    const std::size_t next = between.empty() ? std::string_view::npos : whole.find(between);
    const bool is_last = next == std::string_view::npos;
    const std::string_view group = whole.substr(0, next);
    if (!is_first || !is_last) {  // "1,234" is a number, "12,34" is not
      std::string_view digits = group;
      if (is_first && (digits.starts_with('-') || digits.starts_with('+'))) digits.remove_prefix(1);
      const bool has_digits = digits.find_first_not_of("0123456789") == std::string_view::npos && !digits.empty();
      if (!has_digits || digits.size() > 3 || (!is_first && digits.size() != 3)) return {};
    }
    buffer += group;
    if (is_last) break;
    whole.remove_prefix(next + between.size());
  }
  if (mark != std::string_view::npos) (buffer += '.') += text.substr(mark + 1);
  return buffer;
}

bool is_number(std::string_view text, const ImportNumbers& written, double& number) {
  std::string buffer;
  return detail::read_number(usual_number(text, written, buffer), number) == std::errc{};
}

bool may_have_thousands(const std::string& text) {
  const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
  std::size_t at = text.starts_with('-') || text.starts_with('+') ? 1 : 0;
  const std::size_t first = at;
  while (at < text.size() && is_digit(text[at])) ++at;
  if (at == first || at - first > 3 || text[first] == '0' || at == text.size()) return false;
  for (; at < text.size(); at += 4) {
    if (text[at] != ',' || at + 4 > text.size() || !std::all_of(&text[at + 1], &text[at + 1] + 3, is_digit))
      return false;
  }
  return true;
}

void ClockDigits::look_at(std::string_view text) {
  const std::size_t size = std::min(text.find_first_not_of("0123456789"), text.size());
  const std::string_view part = text.substr(size);
  const bool has_hundredths = size == 8 && part.empty();
  const bool has_part = part.empty() || ((part[0] == '.' || part[0] == ',') &&
                                         part.find_first_not_of("0123456789", 1) == std::string_view::npos);
  std::int64_t digits = 0;
  const bool is_read = detail::read_number(text.substr(0, size), digits) == std::errc{};
  if (!is_read || !has_part || (size > 6 && !has_hundredths) || (rows_ > 0 && has_hundredths != has_hundredths_))
    can_be_ = false;
  if (!can_be_) return;
  has_hundredths_ = has_hundredths;
  double number = static_cast<double>(digits) / (has_hundredths ? 100 : 1), fraction = 0;
  if (part.size() > 1 && detail::read_number("0." + std::string(part.substr(1)), fraction) == std::errc{})
    number += fraction;
  const auto whole = static_cast<std::int64_t>(number);
  const std::int64_t hour = whole / 10'000, minute = whole / 100 % 100, second = whole % 100;
  if (hour > 23 || minute > 59 || second > 59) can_be_ = false;
  const double of_day = number - static_cast<double>(whole) + static_cast<double>(hour * 3600 + minute * 60 + second);
  has_all_digits_ = has_all_digits_ && size >= 6;
  has_zero_ = has_zero_ || (size >= 6 && text[0] == '0');
  if (whole >= 10'000 && shown_.empty()) shown_ = text.substr(0, size), shown_time_ = whole;
  if (minutes_.size() < enough_minutes) minutes_.insert(whole / 100);
  if (seconds_.size() < enough_seconds) seconds_.insert(second);
  const double step = of_day - before_, step_of_number = number - number_before_;
  // From 085958 to 090000 the step in seconds stays the same.
  constexpr double jump = 30;
  if (rows_ > 1 && step_ > 0 && std::abs(step - step_) <= step_ / 2 && step_of_number - step_of_number_ > jump)
    has_jump_ = true;
  before_ = of_day, number_before_ = number, step_ = step, step_of_number_ = step_of_number;
  ++rows_;
}

std::string ClockDigits::format(bool is_said) const {
  const bool are_many = minutes_.size() >= enough_minutes && seconds_.size() >= enough_seconds;
  // Eight digits as seconds are months.
  const bool are_some = has_hundredths_ && minutes_.size() > 1 && seconds_.size() > 2;
  if (!can_be_ || shown_.empty() || !(has_jump_ || are_some || has_zero_ || are_many || (is_said && has_all_digits_)))
    return {};
  return has_hundredths_ ? "%H%M%S%f" : "%H%M%S";
}

std::string ClockDigits::shown() const {
  std::string time = std::to_string(1'000'000 + shown_time_).substr(1);
  time.insert(4, ":").insert(2, ":");
  return shown_ + " is " + time;
}

std::string unit_in(std::string_view heading) {
  const auto is_upper = [](char c) { return c >= 'A' && c <= 'Z'; };
  const auto is_lower = [](char c) { return c >= 'a' && c <= 'z'; };
  const auto is_of_word = [&](char c) { return is_upper(c) || is_lower(c) || static_cast<unsigned char>(c) >= 0x80; };
  std::vector<std::string> words;
  bool is_in_word = false, is_last = false;
  for (std::size_t at = 0; at < heading.size(); ++at) {
    const char c = heading[at];
    const bool is_new = !is_in_word || (is_upper(c) && is_lower(heading[at - 1]));  // TimeUS, timestampMs
    is_in_word = is_of_word(c);
    if (is_in_word && is_new) words.emplace_back();
    if (is_in_word) words.back() += c;
    is_last = is_in_word;
  }
  for (std::size_t i = words.size(); i-- > 0;) {
    const std::string& word = words[i];
    if (word.size() < 2 && !(word == "h" && is_last && i + 1 == words.size())) continue;
    const auto duration = duration_of_unit(word);
    // "day of year", "min since start": a word that is not at the end may not be a unit, except these.
    const bool is_plain = (i + 1 == words.size() && is_last) || (duration && *duration < std::chrono::seconds{1}) ||
                          word.size() >= 5;
    if (duration && is_plain) return word;
  }
  return {};
}

std::optional<Duration> duration_of_unit(std::string_view unit) {
  using namespace std::chrono_literals;
  const std::string word = detail::lower_case(unit);
  static constexpr std::pair<std::string_view, Duration> words[] = {
      {"nanosecond", 1ns}, {"nanoseconds", 1ns}, {"nsec", 1ns},
      {"nanos", 1ns},      {"microsecond", 1us}, {"microseconds", 1us},
      {"usec", 1us},       {"micros", 1us},      {"\u00b5s", 1us},
      {"\u03bcs", 1us},    {"millisecond", 1ms}, {"milliseconds", 1ms},
      {"msec", 1ms},       {"msecs", 1ms},       {"millis", 1ms},
      {"cs", 10ms},        {"second", 1s},       {"seconds", 1s},
      {"sec", 1s},         {"secs", 1s},         {"minute", 1min},
      {"minutes", 1min},   {"mins", 1min},       {"hour", 1h},
      {"hours", 1h},       {"hr", 1h},           {"hrs", 1h},
      {"day", 24h},        {"days", 24h}};
  for (const auto& [name, duration] : words)
    if (word == name) return duration;
  auto usual = parse_duration("1 " + std::string(unit));
  if (!usual && unit.size() > 1) usual = parse_duration("1 " + word);  // MS
  return usual ? std::optional(*usual) : std::nullopt;
}

bool says_a_zone(std::string_view unit) {
  const std::string lower = detail::lower_case(unit);
  for (const char* const one : {"utc", "gmt", "unix", "epoch", "posix", "local"})
    if (lower.find(one) != std::string::npos) return true;
  return false;
}

bool may_be_a_day(std::string_view text) {
  const bool has_size = text.size() == 8 || text.size() == 10 || text.size() == 12 || text.size() == 14;
  if (!has_size || text.find_first_not_of("0123456789") != std::string_view::npos) return false;
  const auto part = [&](std::size_t at, std::size_t size) {
    int number = 0;
    for (const char c : text.substr(at, size)) number = 10 * number + (c - '0');
    return number;
  };
  const bool is_day = part(0, 4) >= 1900 && part(0, 4) < 2100 && part(4, 2) >= 1 && part(4, 2) <= 12 &&
                      part(6, 2) >= 1 && part(6, 2) <= 31;
  const bool has_hour = text.size() < 10 || part(8, 2) <= 24;
  return is_day && has_hour && (text.size() < 12 || part(10, 2) < 60);
}

/// A scale that gives a time in these decades, counted from 1970: "; with --scale 1ns it is 2026-03-01". Empty: none.
std::string scale_of(double number) {
  for (const auto& [scale, name] : {std::pair{1, "1ns"}, {1'000, "1us"}, {1'000'000, "1ms"}}) {
    const double seconds = number * scale / 1e9;
    if (!(seconds >= 631e6 && seconds <= 4.1e9)) continue;  // 1990 to 2099
    return std::string("; with --scale ") + name + " it is " +
           to_iso8601(Time{std::chrono::seconds{std::llround(seconds)}}).substr(0, 10);
  }
  return "";
}

Result<Time> ImportClock::read(const std::string& text) {
  if (notation_.step > 0) {
    const long double ns = notation_.step * static_cast<long double>(steps_++);
    const auto step = ns < 9.2e18L ? later_than(notation_.start, Duration{std::llround(ns)}) : std::nullopt;
    return step ? Result<Time>(*step) : import_refused("", "it is not a time that can be recorded", "check --start");
  }
  auto time = notation_.time_format.empty() ? read_usual(text) : read_formatted(text);
  if (!time) return time;
  if (before_ != Time::min()) step_ = detail::span_between(before_, *time);
  before_ = *time;
  return time;
}

Result<Time> ImportClock::read_formatted(const std::string& text) {
  auto written = read_time(text, notation_.time_format);
  if (!written) return std::move(written).error();
  if (decimals_ != 0 && written->decimals != decimals_)
    return import_refused("",
                          "its %f has " + std::to_string(written->decimals) + " digits, that of the row above " +
                              std::to_string(decimals_) + ": it seems to be a number of parts, not decimals",
                          "write %L if it counts milliseconds, %u for microseconds, %N for nanoseconds");
  decimals_ = written->decimals;
  if (!written->has_date) {
    const bool has_hour = format_has_hour(notation_.time_format);
    const Duration day = std::chrono::hours{has_hour ? 24 : 1};
    auto time = later_than(notation_.start,
                           written->time.time_since_epoch() + static_cast<std::int64_t>(midnights_) * day);
    const Duration back = time && before_ != Time::min() ? detail::span_between(*time, before_) : Duration{0};
    if (notation_.adds_days && back > day / 2) {
      ++midnights_;
      time = later_than(*time, day);
    }
    if (!notation_.adds_days && (back > day / 2 || back < -day / 2))
      return import_refused("",
                            std::string("it has no date, and is more than half ") + (has_hour ? "a day" : "an hour") +
                                " from the row above; the rows are not in time order, so its " +
                                (has_hour ? "day" : "hour") + " is unknown",
                            "sort the file, and do not use --sort; or add a column with the date");
    return time ? Result<Time>(*time)
                : import_refused("", text + " is not a time that can be recorded", "check --start");
  }
  return written->has_zone ? Result<Time>(written->time) : of_zone(written->time);
}

Result<Time> ImportClock::read_usual(const std::string& text) {
  std::string buffer;
  std::optional<Duration> since_start = exact_time(usual_number(text, notation_.numbers, buffer), notation_.scale);
  double number = 0;
  if (since_start || is_number(text, notation_.numbers, number)) {
    const double ns = number * static_cast<double>(notation_.scale.count());
    if (!since_start && std::abs(ns) < 9.2e18) since_start = Duration{std::llround(ns)};
    const auto time = since_start ? later_than(notation_.start, *since_start) : std::nullopt;
    if (time) return *time;
    return import_refused("", text + " is not a time that can be recorded", "check --scale and --start");
  }
  // The end of a day, as weather tables write it.
  constexpr std::size_t hour = 11;
  const bool is_end_of_day = text.size() > hour && text.compare(hour, 5, "24:00") == 0 &&
                             text.find_first_of("123456789", hour + 5) >= text.find_first_of("Zz+-", hour);
  std::string usual = text;
  if (is_end_of_day) usual.replace(hour, 2, "00");
  const auto on_its_day = [&](const Result<Time>& time) -> Result<Time> {
    const auto later = time && is_end_of_day ? later_than(*time, std::chrono::hours{24}) : std::nullopt;
    return later ? Result<Time>(*later) : time;
  };
  const auto time = parse_iso8601(usual);
  if (time) return on_its_day(time);
  const auto shown = parse_iso8601(usual + "Z");
  if (!shown) return usual.find_first_of("Zz+", hour) == std::string::npos ? shown : time;
  return of_zone(on_its_day(shown).or_throw());
}

Result<Time> ImportClock::of_zone(Time shown) {
  if (notation_.zone.empty())
    return import_refused("", says_no_zone,
                          "write --zone Z if it is UTC, an offset such as --zone +01:00, or --zone Europe/Berlin");
  if (!notation_.has_named_zone) {
    const auto offset = parse_iso8601("1970-01-01T00:00:00" + notation_.zone);
    const auto time = offset ? later_than(shown, offset->time_since_epoch()) : std::nullopt;
    if (time) add_offset(shown - *time);
    return time ? Result<Time>(*time) : import_refused("", "it is not a time that can be recorded", "check --zone");
  }
  const std::vector<Time> instants = instants_of(shown);
  if (instants.empty())
    return import_refused("", "there is no such time in " + notation_.zone + ", where clocks are put forward",
                          "if those of the table were not, write --zone with an offset such as +01:00");
  if (instants.size() > 1) ++twice_;
  // In a table of hours, or of longer steps, a repeated time is the second of the two.
  const bool is_next = instants.front() == before_ && step_ >= std::chrono::hours{1};
  const Time time = instants.front() < before_ || is_next ? instants.back() : instants.front();
  add_offset(shown - time);
  return time;
}

void ImportClock::add_offset(Duration offset) {
  offsets_ = offsets_ ? std::pair{std::min(offsets_->first, offset), std::max(offsets_->second, offset)}
                      : std::pair{offset, offset};
}

Error import_refused(std::string where, std::string why, std::string advice) {
  return {Errc::bad_argument, "cannot import", std::move(where), std::move(why), std::move(advice)};
}

void refuse_import(std::string where, std::string why, std::string advice) {
  throw SetupError(import_refused(std::move(where), std::move(why), std::move(advice)));
}

}  // namespace rtdata::app
