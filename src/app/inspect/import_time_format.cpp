#include "app/inspect/import_time_format.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <cstdint>
#include <optional>
#include <system_error>

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

/// Reads one text by one format.
class TimeReader {
 public:
  TimeReader(std::string_view text, std::string_view format) : rest_(text), format_(format) {}

  /// False: the text does not match.
  bool read() {
    for (std::size_t i = 0; i < format_.size(); ++i) {
      const char c = format_[i];
      if (c == ' ') {
        while (take(' ')) {
        }
      } else if (c != '%' || format_[++i] == '%') {
        if (!take(c)) return false;
      } else if (!read_part(format_[i], format_.substr(i + 1))) {
        return false;
      }
    }
    return rest_.empty();
  }
  Result<WrittenTime> time() const {
    const auto refused = [](const char* why) { return import_refused("", why, ""); };
    WrittenTime made{.has_date = year_ || seconds_, .has_zone = offset_ || seconds_};
    std::chrono::nanoseconds since = std::chrono::nanoseconds{fraction_};
    if (seconds_) {
      made.time = Time{std::chrono::seconds{*seconds_} + since};
      return made;
    }
    const bool is_end_of_day = hour_ == 24 && minute_ == 0 && second_ == 0 && fraction_ == 0;
    if (has_half_ && (hour_ < 1 || hour_ > 12)) return refused("hours before noon or after it are 1 to 12");
    const int hour = has_half_ ? hour_ % 12 + (is_afternoon_ ? 12 : 0) : hour_;
    if (second_ > 59) return refused("seconds go up to 59");
    if (minute_ > 59 || (hour > 23 && !is_end_of_day)) return refused("there is no such time of day");
    since += std::chrono::hours{hour} + std::chrono::minutes{minute_} + std::chrono::seconds{second_};
    if (year_) {
      using namespace std::chrono;
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
  /// Up to `most` digits. False: there is none.
  bool number(std::size_t most, int& to) {
    std::size_t size = 0;
    while (size < std::min(most, rest_.size()) && is_digit(rest_[size])) ++size;
    std::from_chars(rest_.data(), rest_.data() + size, to);
    rest_.remove_prefix(size);
    return size > 0;
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
  bool month_name() {
    constexpr std::array<std::string_view, 12> names{"january",   "february", "march",    "april",
                                                     "may",       "june",     "july",     "august",
                                                     "september", "october",  "november", "december"};
    const std::string name = word();
    const auto found = std::find_if(names.begin(), names.end(), [&](std::string_view one) {
      return name == one || (name.size() >= 3 && one.starts_with(name));
    });
    month_ = static_cast<int>(found - names.begin()) + 1;
    return found != names.end();
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
        return number(2, hour_);
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
      case 'f':
        return fraction();
      case 'L':
        if (!number(3, number_read)) return false;
        fraction_ = std::int64_t{1'000'000} * number_read;
        return true;
      case 'z':
        return zone();
      case 's':
        return seconds_since_1970();
      default:
        return !word().empty();  // a or A
    }
  }

  std::string_view rest_, format_;
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
    if (std::string_view("YymbBdjHIpMSfLzsaA").find(all[i]) == std::string_view::npos)
      return std::string("it has %") + all[i] + ", and there is %Y %y %m %b %d %j %H %I %p %M %S %f %L %z %s %a %F %T";
    parts += all[i];
  }
  const auto has = [&](std::string_view any) { return parts.find_first_of(any) != std::string::npos; };
  if (!has("sHISfLjd")) return "it has neither a day nor a time of day";
  if (has("s")) return {};
  const bool has_date = has("Yy") && (has("j") || (has("mbB") && has("d")));
  if (has("YymbBdj") && !has_date) return "its date is not whole: %Y or %y, with %m or %b and %d, or with %j";
  if (has("I") != has("p")) return "%I and %p go together";
  return {};
}

}  // namespace rtdata::app
