/// GpsSensor: a GPS receiver (of any satellites) behind gpsd.
///
///     rtdata::GpsSensor gps(loop, {.name = "gps"}, {});  // gpsd on this machine, port 2947
///     auto heard = loop.subscribe<rtdata::GpsFix>("gps", [](const rtdata::Event<rtdata::GpsFix>& fix) {
///       if (fix->lat && fix->lon) std::printf("%.7f %.7f\n", *fix->lat, *fix->lon);
///     });
///
/// Each report of a fix (TPV) becomes one event. Its time is the time of the read that completed the report; the
/// receiver's own time is a field. The numbers of satellites are from the receiver's last SKY report.
///
/// - A value that gpsd does not give is absent, never 0.
/// - A report with the same text and time as the receiver's last one is counted as repeated and not published. A line
///   that is not a report, or longer than 64 KiB, is counted as unreadable and reported; other lines are not affected.
///   Reports of other kinds, and of other receivers than `device`, are not counted.
/// - If gpsd is missing or goes away, the sensor is faulted and connects again after `retry_first`, doubling to
///   `retry_longest`; also at the start, unless it is `required`. The time without gpsd is a gap (disconnected).
/// - Without a report of a fix for longer than `silence` the sensor is degraded until one comes, with a gap (silent).
///   It then polls gpsd; without an answer for the same time again, the connection counts as lost.
/// - The receiver's time does not change schedules. When five consecutive reports of a fix agree and nothing
///   contradicts them, the sensor records it as a time source ("gps", see Runtime::note_wall_clock).
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/data/problem.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata {

/// The position report of a receiver. The names are gpsd's, which explains them: `man gpsd_json`. Uncertainties are of
/// 95 % confidence.
struct GpsFix {
  text<128> device = {};                      ///< the receiver, as gpsd names it
  std::uint8_t mode = 0;                      ///< of the fix: 0 not known, 1 none, 2 without height, 3 with height
  std::optional<std::uint8_t> status = {};    ///< of the fix: 1 GPS, 2 DGPS, 3 RTK fixed, 4 RTK floating, ...
  std::optional<std::int64_t> gps_time = {};  ///< of the fix, by the receiver: ns since the Unix epoch (UTC)
  std::optional<double> lat = {};             ///< degrees, north is positive
  std::optional<double> lon = {};             ///< degrees, east is positive
  std::optional<double> alt_hae = {};         ///< m above the ellipsoid (WGS 84)
  std::optional<double> alt_msl = {};         ///< m above mean sea level
  std::optional<double> speed = {};           ///< m/s over ground
  std::optional<double> track = {};           ///< degrees from true north
  std::optional<double> climb = {};           ///< m/s, up is positive
  std::optional<double> vel_n = {};           ///< m/s to the north
  std::optional<double> vel_e = {};           ///< m/s to the east
  std::optional<double> vel_d = {};           ///< m/s down
  std::optional<double> eph = {};             ///< uncertainty of the position, horizontal, m
  std::optional<double> epx = {};             ///< of the longitude, m
  std::optional<double> epy = {};             ///< of the latitude, m
  std::optional<double> epv = {};             ///< of the altitude, m
  std::optional<double> sep = {};             ///< of the position in space, m
  std::optional<double> ept = {};             ///< of the time, s
  std::optional<double> eps = {};             ///< of the speed, m/s
  std::optional<double> epd = {};             ///< of the track, degrees
  std::optional<double> epc = {};             ///< of the climb, m/s
  std::optional<double> geoid_sep = {};       ///< of the ellipsoid and mean sea level, m
  std::optional<double> mag_var = {};         ///< from true to magnetic north, degrees
  std::optional<std::uint16_t> satellites_used = {};
  std::optional<std::uint16_t> satellites_visible = {};

  friend bool operator==(const GpsFix&, const GpsFix&) = default;
  friend constexpr auto describe(type_tag<GpsFix>) {
    return record("gps_fix", field("device", &GpsFix::device), field("mode", &GpsFix::mode),
                  field("status", &GpsFix::status), field("gps_time", &GpsFix::gps_time, "ns"),
                  field("lat", &GpsFix::lat, "deg"), field("lon", &GpsFix::lon, "deg"),
                  field("alt_hae", &GpsFix::alt_hae, "m"), field("alt_msl", &GpsFix::alt_msl, "m"),
                  field("speed", &GpsFix::speed, "m/s"), field("track", &GpsFix::track, "deg"),
                  field("climb", &GpsFix::climb, "m/s"), field("vel_n", &GpsFix::vel_n, "m/s"),
                  field("vel_e", &GpsFix::vel_e, "m/s"), field("vel_d", &GpsFix::vel_d, "m/s"),
                  field("eph", &GpsFix::eph, "m"), field("epx", &GpsFix::epx, "m"), field("epy", &GpsFix::epy, "m"),
                  field("epv", &GpsFix::epv, "m"), field("sep", &GpsFix::sep, "m"), field("ept", &GpsFix::ept, "s"),
                  field("eps", &GpsFix::eps, "m/s"), field("epd", &GpsFix::epd, "deg"),
                  field("epc", &GpsFix::epc, "m/s"), field("geoid_sep", &GpsFix::geoid_sep, "m"),
                  field("mag_var", &GpsFix::mag_var, "deg"), field("satellites_used", &GpsFix::satellites_used),
                  field("satellites_visible", &GpsFix::satellites_visible));
  }
};

struct GpsConfig {
  std::string host = "localhost";                   ///< host name or IP address of the computer with gpsd
  std::uint16_t port = 2947;                        ///< of gpsd
  std::string device = {};                          ///< gpsd's name of the receiver; empty: any
  Duration silence = std::chrono::seconds{10};      ///< without a fix report for longer: a gap; 0: no limit
  Duration report_delay = std::chrono::seconds{1};  ///< longest delay of a report; 0: not a time source
  Duration retry_first = std::chrono::milliseconds{
      100};                                           ///< first delay before the program connects to a lost gpsd again
  Duration retry_longest = std::chrono::seconds{10};  ///< the delay doubles up to this
  bool required = false;                              ///< gpsd that does not answer at the start throws
  bool start = true;                                  ///< start when made

  friend constexpr auto parameters(type_tag<GpsConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("host", &GpsConfig::host, "host name or IP address of the computer that runs gpsd"),
        parameter("port", &GpsConfig::port, "port of gpsd", range(1, 65535)),
        parameter("device", &GpsConfig::device, "name of the receiver in gpsd; empty: the only one that gpsd has"),
        parameter("silence", &GpsConfig::silence,
                  "after this time without a report, the sensor is degraded and has a gap; 0: never",
                  range(Duration{0}, Duration{24h})),
        parameter("report_delay", &GpsConfig::report_delay,
                  "longest delay from a fix to its report; this is the accuracy of the receiver's time of day; 0: its "
                  "time is not used",
                  range(Duration{0}, Duration{1min})),
        parameter("retry_first", &GpsConfig::retry_first,
                  "first delay before the program connects to a lost gpsd again", range(Duration{1ms}, Duration{1h})),
        parameter("retry_longest", &GpsConfig::retry_longest, "the delay doubles up to this",
                  range(Duration{1ms}, Duration{24h})),
        parameter("required", &GpsConfig::required, "true: the program ends if gpsd cannot be reached at the start"),
        parameter("start", &GpsConfig::start, "start it with the system"));
  }
};

/// Checks that there is a host.
void check_config(const GpsConfig& config, const ConfigItem& item, Problems& problems);
/// How long the longest read takes: 4 KiB of short reports.
ReadTime read_time(const GpsConfig& config);

class GpsSensor : public AnySensor {
 public:
  GpsSensor() noexcept = default;
  /// SetupError: as `Feed`; bad-argument for a configuration that cannot work; the error of connecting when it is
  /// required, for which this waits 2 s at most.
  GpsSensor(Loop& loop, FeedConfig feed, GpsConfig config);

 private:
  explicit GpsSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
