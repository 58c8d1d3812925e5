#include "app/inspect/import_time_format.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <cstdint>
#include <optional>
#include <span>
#include <system_error>
#include <utility>

#include "app/inspect/import_time.hpp"

namespace rtdata::app {
namespace {

/// The format with %F and %T written out.
std::string written_out(std::string_view format) {
  std::string all;
  for (std::size_t i = 0; i < format.size(); ++i) {
    const bool is_conversion = format[i] == '%' && i + 1 < format.size();
    if (!is_conversion) {
      all += format[i];
      continue;
    }
    const char c = format[++i];
    if (c == 'F') {
      all += "%Y-%m-%d";
    } else if (c == 'T') {
      all += "%H:%M:%S";
    } else {
      (all += '%') += c;
    }
  }
  return all;
}

bool is_digit(char c) { return c >= '0' && c <= '9'; }
bool is_letter(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); }

/// The number of digits of a part with leading zeros. 0: any number, or none.
std::size_t width_of(char part) {
  switch (part) {
    case 'N':
      return 9;
    case 'u':
      return 6;
    case 'Y':
      return 4;
    case 'j':
    case 'L':
      return 3;
    default:
      return std::string_view("ymdHIMS").find(part) != std::string_view::npos ? 2 : 0;
  }
}

/// Reads one text by one format.
class TimeReader {
 public:
  TimeReader(std::string_view text, std::string_view format) : text_(text), rest_(text), format_(format) {}

  /// False: the text does not match.
  bool read() {
    bool is_in_run = false;  // of numbers with nothing between them
    for (std::size_t i = 0; i < format_.size(); ++i) {
      const char c = format_[i];
      const bool is_part = c == '%' && format_[i + 1] != '%';
      if (c == ' ') {
        if (is_within_digits()) return false;  // "112" is not "%d %H"
        while (take(' ')) {
        }
      } else if (!is_part) {
        if (!take(c)) return false;
        if (c == '%') ++i;
      } else {
        if (!is_in_run) take_zeros_left_out(format_.substr(i));
        is_behind_mark_ = i > 0 && (format_[i - 1] == '.' || format_[i - 1] == ',');
        if (!read_part(format_[i + 1], format_.substr(i + 2))) return false;
        ++i;
      }
      is_in_run = is_part && width_of(format_[i]) > 0;
    }
    return rest_.empty();
  }
  Result<WrittenTime> time() const {
    const auto refused = [](const char* why) { return import_refused("", why, ""); };
    WrittenTime made{.has_date = year_ || seconds_, .has_zone = offset_ || seconds_, .decimals = decimals_};
    std::chrono::nanoseconds since = std::chrono::nanoseconds{fraction_};
    if (seconds_) {
      made.time = Time{std::chrono::seconds{*seconds_} + since};
      return made;
    }
    const bool is_end_of_day = hour_ == 24 && minute_ == 0 && second_ == 0 && fraction_ == 0;
    if (has_half_ && (hour_ < 1 || hour_ > 12)) return refused("hours before noon or after it are 1 to 12");
    const int hour = has_half_ ? hour_ % 12 + (is_afternoon_ ? 12 : 0) : hour_;
    if (second_ > 59) return refused("seconds go up to 59");
    const bool may_be_long = !made.has_date && !has_half_;  // since the start, not of a day
    if (minute_ > 59 || (hour > 23 && !is_end_of_day && !may_be_long)) return refused("there is no such time of day");
    since += std::chrono::hours{hour} + std::chrono::minutes{minute_} + std::chrono::seconds{second_};
    if (year_) {
      using namespace std::chrono;
      if (*year_ < 100) return import_refused("", "a year of two digits is %y, not %Y", "write %y");
      if (*year_ < 1678 || *year_ > 2261) return refused("times that can be recorded are those from 1678 to 2261");
      const year_month_day date{year{*year_}, month{static_cast<unsigned>(month_)}, day{static_cast<unsigned>(day_)}};
      const bool is_by_number = day_of_year_ > 0;
      if (!is_by_number && !date.ok()) return refused("there is no such day");
      if (is_by_number && day_of_year_ > (year{*year_}.is_leap() ? 366 : 365)) return refused("there is no such day");
      since += is_by_number ? (sys_days{year{*year_} / January / 1} + days{day_of_year_ - 1}).time_since_epoch()
                            : sys_days{date}.time_since_epoch();
    }
    if (offset_) since -= std::chrono::minutes{*offset_};
    made.time = Time{since};
    return made;
  }

 private:
  bool take(char c) {
    if (!rest_.starts_with(c)) return false;
    rest_.remove_prefix(1);
    return true;
  }
  bool is_within_digits() const {
    const std::size_t at = text_.size() - rest_.size();
    return at > 0 && at < text_.size() && is_digit(text_[at - 1]) && is_digit(text_[at]);
  }
  /// Loggers and spreadsheets write 09:05 as 905, like any number: the first of several parts with nothing between them
  /// lacks its zeros.
  void take_zeros_left_out(std::string_view parts) {
    std::size_t width = 0, digits = 0;
    for (; parts.size() > 1 && parts[0] == '%' && width_of(parts[1]) > 0; parts.remove_prefix(2))
      width += width_of(parts[1]);
    while (digits < rest_.size() && is_digit(rest_[digits])) ++digits;
    zeros_ = digits > 0 && digits < width ? width - digits : 0;
  }
  /// Up to `most` digits, after the omitted zeros. False: there is none.
  bool number(std::size_t most, int& to) {
    const std::size_t zeros = std::min(most, zeros_);
    zeros_ -= zeros;
    std::size_t size = 0;
    to = 0;
    while (size < std::min(most - zeros, rest_.size()) && is_digit(rest_[size])) ++size;
    std::from_chars(rest_.data(), rest_.data() + size, to);
    rest_.remove_prefix(size);
    return zeros + size > 0;
  }
  /// A whole number of `unit` nanoseconds.
  bool whole_fraction(std::size_t most, std::int64_t unit) {
    int count = 0;
    if (!number(most, count)) return false;
    fraction_ = unit * count;
    return true;
  }
  /// Decimals of a second.
  bool fraction() {
    std::int64_t unit = 100'000'000;
    bool is_there = false;
    for (fraction_ = 0; !rest_.empty() && is_digit(rest_.front()); rest_.remove_prefix(1), unit /= 10) {
      fraction_ += unit * (rest_.front() - '0');
      is_there = true;
    }
    return is_there;
  }
  std::string word() {
    std::string letters;
    for (; !rest_.empty() && is_letter(rest_.front()); rest_.remove_prefix(1))
      letters += static_cast<char>(rest_.front() | 0x20);  // in lower case
    return letters;
  }
  /// The number of a name, whole or shortened; 0: it is none of them.
  int name_among(std::span<const std::string_view> names, std::size_t least) {
    const std::string name = word();
    const auto found = std::find_if(names.begin(), names.end(), [&](std::string_view one) {
      return name == one || (name.size() >= least && one.starts_with(name));
    });
    return found == names.end() ? 0 : static_cast<int>(found - names.begin()) + 1;
  }
  bool month_name() {
    constexpr std::array<std::string_view, 12> names{"january",   "february", "march",    "april",
                                                     "may",       "june",     "july",     "august",
                                                     "september", "october",  "november", "december"};
    month_ = name_among(names, 3);
    return month_ != 0;
  }
  bool day_name() {
    constexpr std::array<std::string_view, 7> names{"monday", "tuesday",  "wednesday", "thursday",
                                                    "friday", "saturday", "sunday"};
    return name_among(names, 2) != 0;
  }
  bool zone() {
    offset_ = 0;
    if (take('Z') || take('z')) return true;
    const bool is_named = rest_.starts_with("UTC") || rest_.starts_with("GMT");
    if (is_named) rest_.remove_prefix(3);
    if (is_named && !rest_.starts_with('+') && !rest_.starts_with('-')) return true;
    const bool is_west = rest_.starts_with('-');
    if (!take('+') && !take('-')) return false;
    int hours = 0, minutes = 0;
    if (!number(2, hours) || hours > 23) return false;
    if ((take(':') || (!rest_.empty() && is_digit(rest_.front()))) && (!number(2, minutes) || minutes > 59))
      return false;
    offset_ = (is_west ? -1 : 1) * (hours * 60 + minutes);
    return true;
  }
  bool seconds_since_1970() {
    std::size_t size = rest_.starts_with('-') ? 1 : 0;
    while (size < rest_.size() && is_digit(rest_[size])) ++size;
    std::int64_t seconds = 0;
    constexpr std::int64_t most = 9'200'000'000;
    const bool is_number = std::from_chars(rest_.data(), rest_.data() + size, seconds).ec == std::errc{};
    if (!is_number || seconds > most || seconds < -most) return false;
    seconds_ = seconds;
    rest_.remove_prefix(size);
    return true;
  }
  bool read_part(char part, std::string_view then) {
    int number_read = 0;
    switch (part) {
      case 'Y':
        if (!number(4, number_read)) return false;
        year_ = number_read;
        return true;
      case 'y':
        if (!number(2, number_read)) return false;
        year_ = number_read + (number_read < 69 ? 2000 : 1900);
        return true;
      case 'm':
        return number(2, month_);
      case 'b':
      case 'B':
        return month_name();
      case 'd':
        return take(' '), number(2, day_);
      case 'j':
        return number(3, day_of_year_) && day_of_year_ > 0;
      case 'H':
        return number(has_date_ || then.starts_with('%') ? 2 : 5, hour_);
      case 'I':
        return has_half_ = true, number(2, hour_);
      case 'p': {
        std::string half = word();  // also "a" and "p.m."
        if (half.size() == 1 && take('.')) {
          half += word();
          take('.');
        }
        is_afternoon_ = half == "pm" || half == "p";
        return is_afternoon_ || half == "am" || half == "a";
      }
      case 'M':
        return number(2, minute_);
      case 'S': {
        if (!number(2, second_)) return false;
        const bool has_mark = rest_.size() > 1 && (rest_[0] == '.' || rest_[0] == ',') && is_digit(rest_[1]);
        if (!has_mark || then.starts_with(rest_[0])) return true;
        rest_.remove_prefix(1);
        return fraction();
      }
      case 'f': {
        const std::size_t before = rest_.size();
        const bool is_there = fraction();
        if (!is_behind_mark_) decimals_ = before - rest_.size();
        return is_there;
      }
      case 'L':
        return whole_fraction(3, 1'000'000);
      case 'u':
        return whole_fraction(6, 1'000);
      case 'N':
        return whole_fraction(9, 1);
      case 'z':
        return zone();
      case 's':
        return seconds_since_1970();
      default:
        return day_name();  // a or A
    }
  }

  std::string_view text_, rest_, format_;
  const bool has_date_ = format_has_date(format_);
  std::size_t zeros_ = 0;             // omitted at the begin of `rest_`
  std::size_t decimals_ = 0;          // see WrittenTime
  bool is_behind_mark_ = false;       // the part that is read follows a decimal mark
  std::optional<int> year_, offset_;  // offset: minutes
  std::optional<std::int64_t> seconds_;
  int month_ = 1, day_ = 1, day_of_year_ = 0, hour_ = 0, minute_ = 0, second_ = 0;
  std::int64_t fraction_ = 0;  // ns
  bool has_half_ = false, is_afternoon_ = false;
};

}  // namespace

Result<WrittenTime> read_time(std::string_view text, std::string_view format) {
  const std::string all = written_out(format);
  TimeReader reader(text, all);
  if (!reader.read()) return import_refused("", "it is not written as --time-format has it", "");
  return reader.time();
}

std::string format_mistake(std::string_view format) {
  const std::string all = written_out(format);
  std::string parts;
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (all[i] != '%') continue;
    if (++i == all.size()) return "it ends with %";
    if (all[i] == '%') continue;
    if (std::string_view("YymbBdjHIpMSfLuNzsaA").find(all[i]) == std::string_view::npos)
      return std::string("it has %") + all[i] +
             "; available: %Y %y %m %b %d %j %H %I %p %M %S %f %L %u %N %z %s %a %F %T";
    parts += all[i];
  }
  const auto has = [&](std::string_view any) { return parts.find_first_of(any) != std::string::npos; };
  if (!has("sHIMSfLuNjd")) return "it has neither a day nor a time of day";
  for (const auto& [all_of, what] : {std::pair("Yy", "year"),
                                     {"mbB", "month (%M is the minute)"},
                                     {"d", "day"},
                                     {"j", "day"},
                                     {"HI", "hour"},
                                     {"M", "minute (%m is the month)"},
                                     {"S", "second (%s are seconds since 1970)"},
                                     {"fLuN", "fraction of a second"},
                                     {"p", "half of the day"},
                                     {"z", "zone"},
                                     {"s", "time"}}) {
    const auto count = std::count_if(parts.begin(), parts.end(),
                                     [of = std::string_view(all_of)](char c) { return of.find(c) != of.npos; });
    if (count > 1) return std::string("it has two parts for the ") + what;
  }
  if (has("s") && has("YymbBdjHIpMSz")) return "it has %s, the seconds since 1970, beside a date or a time of day";
  if (has("s")) return {};
  if (has("j") && has("mbBd")) return "it has %j, the day of the year, beside a month or a day";
  const bool has_date = has("Yy") && (has("j") || (has("mbB") && has("d")));
  if (has("YymbBdj") && !has_date) return "its date is not whole: %Y or %y, with %m or %b and %d, or with %j";
  if (has("I") != has("p")) return "%I and %p go together";
  return {};
}

std::string format_in(std::string_view heading) {
  for (std::size_t begin = 0; begin < heading.size(); ++begin) {
    if (begin > 0 && is_letter(heading[begin - 1])) continue;
    std::string format, between;
    bool has_hour = false, has_month = false;
    for (std::size_t at = begin; at < heading.size();) {
      const char c = static_cast<char>(heading[at] | 0x20);
      std::size_t end = at;
      while (end < heading.size() && (heading[end] | 0x20) == c) ++end;
      const std::size_t size = end - at;
      const bool is_again = end < heading.size() && is_letter(heading[end]);
      if (!is_letter(heading[at])) {
        between += heading[at++];
        continue;
      }
      if (c == 't' && size == 1 && !format.empty() && end < heading.size() && (heading[end] | 0x20) == 'h') {
        between += heading[at++];
        continue;
      }
      if (std::string_view("dmyhs").find(c) == std::string_view::npos || size > 4 || (size == 1 && is_again)) break;
      format += between + (c == 'd'                ? "%d"
                           : c == 'y'              ? (size == 4 ? "%Y" : "%y")
                           : c == 'h'              ? "%H"
                           : c == 's'              ? "%S"
                           : has_hour || has_month ? "%M"
                           : size == 3             ? "%b"
                                                   : "%m");
      has_hour = has_hour || c == 'h';
      has_month = has_month || c == 'm';
      between.clear();
      at = end;
    }
    if (!order_of_date(format).empty()) return format;
  }
  return {};
}

std::string order_of_date(std::string_view format) {
  const std::string all = written_out(format);
  std::string order;
  for (std::size_t i = 0; i + 1 < all.size(); ++i) {
    if (all[i] != '%') continue;
    const char part = all[++i];
    if (part == 'd' || part == 'm' || part == 'y') order += part;
    if (part == 'Y') order += 'y';
    if (part == 'b' || part == 'B') order += 'm';
  }
  return order.size() == 3 ? order : std::string();
}

/// True if it has one of these parts.
static bool has_part(std::string_view format, std::string_view parts) {
  for (std::size_t i = 0; i + 1 < format.size(); ++i)
    if (format[i] == '%' && parts.find(format[++i]) != std::string_view::npos) return true;
  return false;
}

bool format_has_date(std::string_view format) { return has_part(format, "YysF"); }
bool format_has_hour(std::string_view format) { return has_part(format, "HIT"); }

}  // namespace rtdata::app
