// NMEA 0183 as defined in IEC 61162-1: "$", talker and sentence, fields separated by commas, "*", checksum.
#include "sensors/lines/nmea.hpp"

#include <algorithm>
#include <charconv>
#include <chrono>
#include <cmath>
#include <utility>

#include "data/number_text.hpp"

namespace rtdata::detail {
namespace {

constexpr const char* what = "cannot use a sentence";
constexpr double knot = 1852.0 / 3600;  // m/s
constexpr double kilometre_per_hour = 1 / 3.6;
constexpr std::int64_t second = 1'000'000'000;
constexpr std::int64_t day_length = 86400 * second;

Error failure(Errc code, std::string_view sentence, std::string why) {
  std::string shown;
  for (const char c : sentence.substr(0, 8)) shown += c >= ' ' && c < 127 ? c : '?';
  return {code, what, std::move(shown), std::move(why), "check `baud_rate`, and the receiver"};
}

int hex_digit(char c) noexcept {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1;
}

}  // namespace

struct NmeaFixes::Columns {
  std::string_view name;  // "GPGGA"
  std::array<std::string_view, 32> text{};
  std::size_t count = 0;

  std::string_view at(std::size_t i) const noexcept { return i < count ? text[i] : std::string_view(); }
  Error bad(std::size_t i, const std::string& why) const {
    return failure(Errc::bad_data, name, "\"" + std::string(at(i).substr(0, 20)) + "\" " + why);
  }
  /// An unreadable field counts as empty and is reported; other fields are not affected.
  mutable std::optional<Error> odd = {};
  std::nullopt_t refuse(std::size_t i, const std::string& why) const {
    if (!odd) odd = bad(i, why);
    return std::nullopt;
  }
  std::optional<double> number(std::size_t i) const {
    const std::string_view word = at(i);
    if (word.empty()) return std::nullopt;
    double value = 0;
    if (read_number(word, value) != std::errc{} || !std::isfinite(value)) return refuse(i, "is not a number");
    return value;
  }
  std::optional<unsigned> whole(std::size_t i, unsigned most) const {
    const std::string_view word = at(i);
    if (word.empty()) return std::nullopt;
    unsigned value = 0;
    if (read_number(word, value) != std::errc{} || value > most)
      return refuse(i, "is not a number from 0 to " + std::to_string(most));
    return value;
  }
  /// "4804.14539" and the hemisphere after it: degrees and minutes.
  std::optional<double> angle(std::size_t i, double most, char positive, char negative) const {
    const std::optional<double> value = number(i);
    if (!value) return std::nullopt;
    const std::string_view side = at(i + 1);
    if (side.size() != 1 || (side[0] != positive && side[0] != negative)) return refuse(i + 1, "is not a hemisphere");
    const double degrees = std::floor(*value / 100), minutes = *value - 100 * degrees;
    const double angle = degrees + minutes / 60;
    if (*value < 0 || minutes >= 60 || angle > most) return refuse(i, "is not an angle");
    return side[0] == positive ? angle : -angle;
  }
  /// Latitude and longitude, from column `i` on. Empty: one of the two is missing.
  std::optional<std::pair<double, double>> position(std::size_t i) const {
    const std::optional<double> lat = angle(i, 90, 'N', 'S'), lon = angle(i + 2, 180, 'E', 'W');
    if (!lat || !lon) return std::nullopt;
    return std::pair(*lat, *lon);
  }
  bool has_position(std::size_t i) const noexcept { return !at(i).empty() || !at(i + 2).empty(); }
  /// "092835.00": ns since midnight. A leap second is 23:59:60.
  Result<std::optional<std::int64_t>> time_of_day(std::size_t i) const {
    const std::string_view word = at(i);
    if (word.empty()) return std::optional<std::int64_t>();
    const bool is_time = word.size() >= 6 &&
                         std::all_of(word.begin(), word.begin() + 6, [](char c) { return c >= '0' && c <= '9'; });
    if (!is_time || (word.size() > 6 && word[6] != '.')) return bad(i, "is not a time");
    const auto pair = [&](std::size_t at_) { return (word[at_] - '0') * 10 + (word[at_ + 1] - '0'); };
    if (pair(0) > 23 || pair(2) > 59 || pair(4) > 60) return bad(i, "is not a time");
    std::int64_t fraction = 0, unit = second;
    for (std::size_t j = 7; j < word.size(); ++j) {
      if (word[j] < '0' || word[j] > '9') return bad(i, "is not a time");
      unit /= 10;
      fraction += unit * (word[j] - '0');
    }
    return std::optional<std::int64_t>((pair(0) * 3600 + pair(2) * 60 + pair(4)) * second + fraction);
  }
  /// "210615": the start of the day, ns since the Unix epoch. Years of two digits: 1980 to 2079.
  std::optional<std::int64_t> date(std::size_t i) const {
    const std::string_view word = at(i);
    if (word.empty()) return std::nullopt;
    if (word.size() != 6 || !std::all_of(word.begin(), word.end(), [](char c) { return c >= '0' && c <= '9'; }))
      return refuse(i, "is not a date");
    const auto pair = [&](std::size_t at_) {
      return static_cast<unsigned>((word[at_] - '0') * 10 + (word[at_ + 1] - '0'));
    };
    const int year = static_cast<int>(pair(4)) + (pair(4) >= 80 ? 1900 : 2000);
    const std::chrono::year_month_day day{std::chrono::year(year), std::chrono::month(pair(2)),
                                          std::chrono::day(pair(0))};
    if (!day.ok()) return refuse(i, "is not a date");
    return std::chrono::sys_days(day).time_since_epoch().count() * day_length;
  }
};

std::uint8_t NmeaFixes::checksum(std::string_view text) noexcept {
  unsigned sum = 0;
  for (const char c : text) sum ^= static_cast<unsigned char>(c);
  return static_cast<std::uint8_t>(sum);
}

NmeaFixes::NmeaFixes(std::string_view device) {
  if (device.size() <= decltype(device_)::capacity()) device_ = device;  // longer paths are ignored
}

void NmeaFixes::reset() noexcept {
  draft_ = {};
  seen_ = {};
  ends_with_.reset();
  without_end_ = 0;
  published_.reset();
  is_begun_ = is_without_time_ = false;
  visible_ = {};
}

Result<void> NmeaFixes::read_gga(const Columns& columns, Draft& draft) const {
  const auto time = columns.time_of_day(1);
  if (!time) return time.error();
  const auto quality = columns.whole(6, 9);
  const auto used = columns.whole(7, 999);
  if (*time) draft.time_of_day = *time;
  draft.fix.satellites_used.reset();
  if (used) draft.fix.satellites_used = static_cast<std::uint16_t>(*used);
  if (!quality)
    return columns.has_position(2) ? columns.bad(6, "is not a fix quality") : Result<void>();  // it says nothing
  if (*quality == 0) {  // the position is not valid
    draft.is_void = true;
    return {};
  }
  const auto altitude = columns.number(9), geoid = columns.number(11);
  if (const auto position = columns.position(2)) {
    draft.fix.lat = position->first;
    draft.fix.lon = position->second;
  }
  draft.fix.alt_msl = altitude;
  draft.fix.geoid_sep = geoid;
  if (altitude && geoid) draft.fix.alt_hae = *altitude + *geoid;
  // The same numbers as gpsd's status: 1 GPS, 2 DGPS, 3 RTK, 4 floating RTK, 5 dead reckoning, 8 simulated.
  constexpr std::uint8_t status_of[] = {0, 1, 2, 0, 3, 4, 5, 0, 8, 0};
  if (status_of[*quality] != 0) draft.fix.status = status_of[*quality];
  return {};
}

Result<void> NmeaFixes::read_rmc(const Columns& columns, Draft& draft) const {
  const auto time = columns.time_of_day(1);
  if (!time) return time.error();
  const auto date = columns.date(9);
  if (*time) draft.time_of_day = *time;
  draft.fix.gps_time.reset();
  // A leap second has no number.
  if (*time && date && **time < day_length) draft.fix.gps_time = *date + **time;
  const std::string_view status = columns.at(2);
  if (status.empty() && !columns.has_position(3)) return {};  // it says nothing
  if (status == "V") {
    draft.is_void = true;
    return {};
  }
  if (status != "A") return columns.bad(2, "is not a fix status");
  const auto position = columns.position(3);
  if (position && (!draft.fix.lat || !draft.fix.lon)) {  // GGA may have more digits
    draft.fix.lat = position->first;
    draft.fix.lon = position->second;
  }
  if (const auto speed = columns.number(7)) draft.fix.speed = *speed * knot;
  draft.fix.track = columns.number(8);
  const std::string_view side = columns.at(11);
  // Some receivers omit the direction of the variation.
  if (const auto variation = columns.number(10); variation && (side == "E" || side == "W"))
    draft.fix.mag_var = side == "E" ? *variation : -*variation;
  draft.has_rmc_velocity = true;
  return {};
}

Result<void> NmeaFixes::read_vtg(const Columns& columns, Draft& draft) const {
  if (draft.has_rmc_velocity || columns.at(9) == "N") return {};  // RMC's velocity has a time, so it is preferred
  const auto knots = columns.number(5), kilometres = columns.number(7);
  if (const auto track = columns.number(1)) draft.fix.track = track;
  if (knots) draft.fix.speed = *knots * knot;
  if (kilometres && !knots) draft.fix.speed = *kilometres * kilometre_per_hour;
  return {};
}

Result<void> NmeaFixes::read_gsa(const Columns& columns, Draft& draft) const {
  if (const auto mode = columns.whole(2, 3); mode && *mode > 0)
    draft.gsa_mode = static_cast<std::uint8_t>(std::max<unsigned>(*mode, draft.gsa_mode.value_or(0)));
  return {};
}

/// Handles another talker's sentence for the same instant: GLGGA beside GPGGA.
Result<void> NmeaFixes::read_other_talker(const Columns& columns, Sentence sentence, Draft& draft) const {
  Draft other;
  const bool is_gga = sentence == Sentence::gga;
  if (auto read = is_gga ? read_gga(columns, other) : read_rmc(columns, other); !read) return read;
  if (other.is_void || !other.fix.lat) return {};
  if (draft.is_void || !draft.fix.lat) {
    other.gsa_mode = draft.gsa_mode;
    if (!other.fix.gps_time) other.fix.gps_time = draft.fix.gps_time;
    draft = other;
  } else if (is_gga && draft.fix.satellites_used && other.fix.satellites_used) {
    draft.fix.satellites_used = static_cast<std::uint16_t>(*draft.fix.satellites_used + *other.fix.satellites_used);
  }
  return {};
}

/// Satellites are listed once for each of their signals, and once more if no signal is received; since NMEA 4.10 the
/// signal's number follows them.
Result<void> NmeaFixes::take_gsv(const Columns& columns) {
  const auto message = columns.whole(2, 99);
  const auto count = columns.whole(3, 999);
  const std::array<char, 2> talker{columns.name[0], columns.name[1]};
  const bool has_signal = columns.count > 4 && (columns.count - 4) % 4 == 1;
  const std::string_view word = has_signal ? columns.at(columns.count - 1) : std::string_view();
  const int digit = word.size() == 1 ? hex_digit(word[0]) : 0;
  const auto signal = static_cast<std::uint16_t>(1u << std::max(digit, 0));
  for (Visible& one : visible_) {
    if (one.talker != talker && one.talker != std::array<char, 2>{}) continue;
    one.talker = talker;
    if (message && *message == 1) {
      if ((one.signals & signal) != 0) {  // a new round
        one.last_signals = one.signals;
        one.last_count = one.count();
        one.signals = 0;
        one.told = 0;
        one.numbers.reset();
      }
      one.signals = static_cast<std::uint16_t>(one.signals | signal);
      one.told = std::max(one.told, static_cast<std::uint16_t>(count.value_or(0)));
    }
    for (std::size_t i = 4; i + (has_signal ? 1 : 0) < columns.count; i += 4)
      if (const auto number = columns.whole(i, 999)) one.numbers.set(*number);
    break;
  }
  if (columns.odd) return *columns.odd;
  return {};
}

GpsFix NmeaFixes::completed() const {
  GpsFix fix = draft_.fix;
  fix.device = device_;
  if (draft_.is_void || draft_.gsa_mode == 1) {
    fix.mode = 1;
    fix.lat = fix.lon = fix.alt_msl = fix.alt_hae = fix.geoid_sep = fix.speed = fix.track = fix.mag_var = std::nullopt;
    fix.status.reset();
  } else if (draft_.gsa_mode) {
    fix.mode = *draft_.gsa_mode;
  } else if (fix.lat) {
    fix.mode = fix.alt_msl ? 3 : 2;
  }
  unsigned visible = 0;
  bool is_known = false;
  for (const Visible& one : visible_) {
    is_known = is_known || one.talker != std::array<char, 2>{};
    // A round without all signals does not have all satellites yet.
    visible += (one.signals & one.last_signals) == one.last_signals ? one.count() : one.last_count;
  }
  if (is_known) fix.satellites_visible = static_cast<std::uint16_t>(visible);
  return fix;
}

void NmeaFixes::publish_now(const Publish& publish) {
  const GpsFix fix = completed();
  if (published_ == fix) return;
  published_ = fix;
  publish(fix, time_);
}

void NmeaFixes::finish(const Publish& publish) {
  if (!is_begun_) return;
  is_begun_ = false;
  // A single missing or broken sentence does not change the learned last sentence.
  constexpr unsigned enough = 3;
  if (!is_without_time_ && (!ends_with_ || published_ || ++without_end_ == enough)) {
    ends_with_ = last_;
    without_end_ = 0;
  }
  publish_now(publish);
}

Result<void> NmeaFixes::take(std::string_view line, Time time, const Publish& publish) {
  const auto bad = [&](const char* why) { return failure(Errc::bad_data, line, why); };
  if (line.size() < 4 || (line[0] != '$' && line[0] != '!')) return bad("this is not an NMEA sentence");
  const std::size_t star = line.size() - 3;
  if (line[star] != '*') return bad("it has no checksum");
  const int high = hex_digit(line[star + 1]), low = hex_digit(line[star + 2]);
  const std::string_view body = line.substr(1, star - 1);
  if (high < 0 || low < 0 || checksum(body) != high * 16 + low) return bad("its checksum is wrong");

  Columns columns;
  for (std::size_t begin = 0; begin <= body.size() && columns.count < columns.text.size();) {
    const std::size_t end = std::min(body.find(',', begin), body.size());
    columns.text[columns.count++] = body.substr(begin, end - begin);
    begin = end + 1;
  }
  columns.name = columns.text[0];
  const std::string_view name = columns.name;
  const bool is_standard = name.size() == 5 && name[0] != 'P';  // "P": a manufacturer's own sentence
  const std::string_view kind = is_standard ? name.substr(2) : std::string_view();
  if (kind == "GSV") return take_gsv(columns);
  SentencePosition step;
  if (kind == "GGA") {
    step.sentence = Sentence::gga;
  } else if (kind == "RMC") {
    step.sentence = Sentence::rmc;
  } else if (kind == "VTG") {
    step.sentence = Sentence::vtg;
  } else if (kind == "GSA") {
    step.sentence = Sentence::gsa;
  } else {
    return {};
  }

  const bool has_time = step.sentence == Sentence::gga || step.sentence == Sentence::rmc;
  std::size_t place = static_cast<std::size_t>(step.sentence);
  const std::array<char, 2> talker{name[0], name[1]};
  bool is_other_talker = false;  // of the same instant
  bool begins = !is_begun_;      // by a sentence without a time: the rest of a fix whose start was not received
  if (has_time) {
    const auto said = columns.time_of_day(1);
    if (!said) return said.error();
    is_other_talker = seen_[place] > 0 && *said && *said == draft_.time_of_day && talker != talkers_[place];
    begins = begins || is_without_time_ || (seen_[place] > 0 && !is_other_talker) ||
             (*said && draft_.time_of_day && *said != draft_.time_of_day);
  }
  Draft draft = begins ? Draft{} : draft_;
  Result<void> read = is_other_talker && !begins       ? read_other_talker(columns, step.sentence, draft)
                      : step.sentence == Sentence::gga ? read_gga(columns, draft)
                      : step.sentence == Sentence::rmc ? read_rmc(columns, draft)
                      : step.sentence == Sentence::vtg ? read_vtg(columns, draft)
                                                       : read_gsa(columns, draft);
  if (!read) return read;
  if (begins) {
    finish(publish);
    seen_ = {};
    is_begun_ = true;
    is_without_time_ = !has_time;
    published_.reset();
  }
  // The talker whose sentences are counted: the first, or the first with a fix.
  if (seen_[place] == 0 || (!draft_.fix.lat && draft.fix.lat)) talkers_[place] = talker;
  draft_ = draft;
  step.number = ++seen_[place];
  last_ = step;
  time_ = time;
  if (ends_with_ == step && !published_) publish_now(publish);
  if (columns.odd) return std::move(*columns.odd);
  return {};
}

}  // namespace rtdata::detail
