#include "sensors/gps/gps_report.hpp"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <utility>

#include "rtdata/data/time.hpp"

namespace rtdata::detail {
namespace {

// libgps has a parser, gps_unpack, but it accepts invalid values: docs/gps.md has examples.

/// The numbers of a fix that are used unchanged.
struct NumberKey {
  std::string_view name;
  std::optional<double> GpsFix::*member;
  double most = 0;  // of its size; 0: no limit
};
constexpr NumberKey number_keys[] = {
    {"lat", &GpsFix::lat, 90},    {"lon", &GpsFix::lon, 180},
    {"altHAE", &GpsFix::alt_hae}, {"altMSL", &GpsFix::alt_msl},
    {"speed", &GpsFix::speed},    {"track", &GpsFix::track},
    {"climb", &GpsFix::climb},    {"velN", &GpsFix::vel_n},
    {"velE", &GpsFix::vel_e},     {"velD", &GpsFix::vel_d},
    {"eph", &GpsFix::eph},        {"epx", &GpsFix::epx},
    {"epy", &GpsFix::epy},        {"epv", &GpsFix::epv},
    {"sep", &GpsFix::sep},        {"ept", &GpsFix::ept},
    {"eps", &GpsFix::eps},        {"epd", &GpsFix::epd},
    {"epc", &GpsFix::epc},        {"geoidSep", &GpsFix::geoid_sep},
    {"magvar", &GpsFix::mag_var},
};

struct Class {
  std::string_view name;
  GpsReport::Kind kind;
};
constexpr Class classes[] = {
    {"TPV", GpsReport::Kind::fix},         {"SKY", GpsReport::Kind::satellites}, {"DEVICE", GpsReport::Kind::device},
    {"DEVICES", GpsReport::Kind::devices}, {"ERROR", GpsReport::Kind::error},
};

std::string shown(std::string_view text) {
  std::string shown = "\"";
  for (const char c : text.substr(0, 60)) shown += c >= ' ' && c < 127 ? c : '?';
  return shown + (text.size() > 60 ? "...\"" : "\"");
}

/// "2016-12-31T23:59:60.000Z".
bool is_leap_second(std::string text) {
  constexpr std::string_view end = "T23:59:60";
  const std::size_t at = text.find(end);
  if (at == std::string::npos) return false;
  text.replace(at, end.size(), "T23:59:59");
  return static_cast<bool>(parse_iso8601(text));
}

Error unusable(Errc code, std::string where, std::string why) {
  return {code, "cannot use a line of gpsd", std::move(where), std::move(why), "check that gpsd serves this port"};
}

/// Follows the parser through one object.
class ReportHandler {
 public:
  using number_integer_t = nlohmann::json::number_integer_t;
  using number_unsigned_t = nlohmann::json::number_unsigned_t;
  using number_float_t = nlohmann::json::number_float_t;
  using string_t = nlohmann::json::string_t;
  using binary_t = nlohmann::json::binary_t;
  explicit ReportHandler(GpsReport& report) : report_(report) {}

  bool null() { return true; }  // no value
  bool boolean(bool is_true) {
    if (target_ == Target::satellite_used) {
      if (is_true) ++used_;
    } else if (target_ != Target::nothing) {
      refuse(Errc::not_a_number, "it is not a number");
    }
    return depth_ != 0;
  }
  bool number_integer(number_integer_t number) { return take(static_cast<double>(number)); }
  bool number_unsigned(number_unsigned_t number) { return take(static_cast<double>(number)); }
  bool number_float(number_float_t number, const string_t&) { return take(number); }
  bool string(string_t& text);
  bool binary(binary_t&) { return false; }
  bool start_object(std::size_t) {
    if (depth_ == 2 && list_ == List::satellites) ++listed_;
    if (depth_ == 1) list_ = List::other;
    ++depth_;
    target_ = Target::nothing;
    return true;
  }
  bool end_object() {
    --depth_;
    return true;
  }
  bool start_array(std::size_t) {
    if (depth_ == 1) list_ = next_list_;
    has_list_ = has_list_ || (depth_ == 1 && list_ == List::satellites);
    ++depth_;
    target_ = Target::nothing;
    return depth_ > 1;  // a line with an array is not a report
  }
  bool end_array() { return end_object(); }
  bool key(string_t& name);
  bool parse_error(std::size_t position, const std::string&, const nlohmann::detail::exception&) {
    error_ = unusable(Errc::bad_data, "", "it is not JSON from byte " + std::to_string(position) + " on");
    return false;
  }

  Result<void> end();
  Error take_error() { return error_ ? std::move(*error_) : unusable(Errc::bad_data, "", "it is not a JSON object"); }

 private:
  enum class Target {
    nothing,
    class_name,
    device,
    mode,
    status,
    time,
    number,
    altitude,
    satellites_all,
    satellites_used,
    satellite_used,
    device_path,
    activated,
    message
  };
  enum class List { other, satellites, devices };

  bool take(double number);
  template <class Number>
  void put_natural(std::optional<Number>& to, double number) {
    if (!(number >= 0 && number <= std::numeric_limits<Number>::max()) || number != std::floor(number))
      return refuse(Errc::out_of_range, "it is " + std::to_string(number));
    to = static_cast<Number>(number);
  }
  /// Valid only for reports that are used: other reports may have other things under this name.
  void refuse(Errc code, std::string why) {
    if (!error_) error_ = unusable(code, std::string(key_), std::move(why));
  }

  GpsReport& report_;
  std::size_t depth_ = 0;  // open objects and arrays
  Target target_ = Target::nothing;
  const NumberKey* number_ = nullptr;
  std::string_view key_;
  List list_ = List::other, next_list_ = List::other;
  bool has_list_ = false;  // of satellites
  std::size_t listed_ = 0, used_ = 0;
  std::optional<std::uint16_t> all_reported_, used_reported_;
  std::optional<std::uint8_t> mode_;
  std::optional<double> altitude_;
  std::optional<Error> error_;
};

bool ReportHandler::key(string_t& name) {
  target_ = Target::nothing;
  next_list_ = List::other;
  if (depth_ == 3) {
    if (list_ == List::satellites && name == "used") target_ = Target::satellite_used;
    if (list_ == List::devices && name == "path") target_ = Target::device_path;
    return true;
  }
  if (depth_ != 1) return true;
  struct Key {
    std::string_view name;
    Target target;
  };
  static constexpr Key keys[] = {
      {"class", Target::class_name},    {"device", Target::device},
      {"mode", Target::mode},           {"status", Target::status},
      {"time", Target::time},           {"nSat", Target::satellites_all},
      {"path", Target::device},         {"uSat", Target::satellites_used},
      {"activated", Target::activated}, {"message", Target::message},
      {"alt", Target::altitude},
  };
  for (const NumberKey& one : number_keys) {
    if (one.name != name) continue;
    number_ = &one;
    key_ = one.name;
    target_ = Target::number;
    return true;
  }
  for (const Key& one : keys) {
    if (one.name != name) continue;
    key_ = one.name;
    target_ = one.target;
    return true;
  }
  if (name == "satellites") next_list_ = List::satellites;
  if (name == "devices") next_list_ = List::devices;
  return true;
}

bool ReportHandler::take(double number) {
  switch (target_) {
    case Target::number:
      if (number_->most > 0 && std::abs(number) > number_->most)
        refuse(Errc::out_of_range, "it is " + std::to_string(number));
      report_.fix.*(number_->member) = number;
      break;
    case Target::altitude:
      altitude_ = number;
      break;
    case Target::mode:
      put_natural(mode_, number);
      break;
    case Target::status:
      put_natural(report_.fix.status, number);
      break;
    case Target::satellites_all:
      put_natural(all_reported_, number);
      break;
    case Target::satellites_used:
      put_natural(used_reported_, number);
      break;
    case Target::activated:
      report_.is_deactivated = number == 0;
      break;
    case Target::class_name:
    case Target::device:
    case Target::time:
    case Target::message:
      refuse(Errc::bad_data, "it is not text");
      break;
    default:
      break;
  }
  return depth_ != 0;
}

bool ReportHandler::string(string_t& text) {
  switch (target_) {
    case Target::class_name: {
      const auto known = std::find_if(std::begin(classes), std::end(classes), [&](auto& c) { return c.name == text; });
      report_.kind = known != std::end(classes) ? known->kind : GpsReport::Kind::other;
      break;
    }
    case Target::device:
      if (const auto assigned = report_.fix.device.assign(text); !assigned)
        refuse(Errc::does_not_fit, "it is longer than 128 bytes");
      break;
    case Target::time:
      if (const Result<Time> time = parse_iso8601(text)) {
        report_.fix.gps_time = to_nanoseconds(*time);
      } else if (is_leap_second(text)) {  // there is no number for it
        report_.fix.gps_time.reset();
      } else {
        refuse(Errc::bad_data, shown(text) + " is not a time");
      }
      break;
    case Target::message:
      report_.message = text;
      break;
    case Target::device_path:
      report_.devices.push_back(text);
      break;
    case Target::activated:  // the time at which gpsd opened it
    case Target::nothing:
      break;
    default:
      refuse(Errc::not_a_number, shown(text) + " is not a number");
      break;
  }
  return depth_ != 0;
}

Result<void> ReportHandler::end() {
  using Kind = GpsReport::Kind;
  if (report_.kind == Kind::none) return unusable(Errc::bad_data, "", "it has no \"class\"");
  if (report_.kind == Kind::other) return {};
  if (error_) return std::move(*error_);
  if (report_.kind == Kind::fix) {
    report_.fix.mode = mode_.value_or(std::uint8_t{0});
    // Before 3.20 gpsd had no other height; since then each release defines `alt` differently.
    if (!report_.fix.alt_msl && !report_.fix.alt_hae) report_.fix.alt_msl = altitude_;
  }
  if (report_.kind == Kind::satellites) {
    const auto counted = [&](std::size_t count) -> std::optional<std::uint16_t> {
      return has_list_ ? std::optional(static_cast<std::uint16_t>(std::min<std::size_t>(count, 0xffff))) : std::nullopt;
    };
    report_.visible = all_reported_ ? all_reported_ : counted(listed_);
    report_.used = used_reported_ ? used_reported_ : counted(used_);
  }
  return {};
}

}  // namespace

Result<void> read_report(std::string_view line, GpsReport& report) {
  report.kind = GpsReport::Kind::none;
  report.fix = {};
  report.used.reset();
  report.visible.reset();
  report.devices.clear();
  report.is_deactivated = false;
  report.message.clear();
  ReportHandler handler(report);
  Result<void> done;
  if (nlohmann::json::sax_parse(line.data(), line.data() + line.size(), &handler)) {
    done = handler.end();
  } else {
    done = handler.take_error();
  }
  if (!done && done.error().where.empty()) done.error().where = shown(line);
  return done;
}

}  // namespace rtdata::detail
