/// HttpSensor: asks a URL at its rate; each answer is one event. For Shelly, Tasmota, gateways and weather services.
///
///     rtdata::HttpSensor pump(loop, {.name = "pump", .rate = 1_Hz},
///                             {.server = {.url = "http://192.168.1.40/rpc/Switch.GetStatus?id=0"},
///                              .fields = {{.name = "power", .unit = "W", .key = "apower"},
///                                         {.name = "temperature", .unit = "Cel", .key = "temperature.tC"}}});
///
/// An answer is an object or array of JSON, from which `fields` take values by their keys ("sensors.0.t" reaches into
/// arrays); or a line of CSV: the first one after `skip_lines` that is not empty and that `only` selects; the rest is
/// not read; or rows of a label and a value. The time of the event is when the request began.
///
/// - Only status 200 brings an event. Another status, no connection, no complete answer within `timeout` are failures,
///   after which the sensor asks as other sensors read again (sensor.hpp).
/// - Redirections are not followed: the error says where they lead.
/// - An answer that cannot be decoded, or longer than `max_answer`, is unreadable. No more of it is kept in memory.
/// - An answer that `only` does not select counts as filtered.
/// - If the server marked its last answer with an ETag, the request says so. Its answer 304, nothing new, counts as
///   repeated. Not with `method` post.
///
/// Sensors at one server (scheme, host, port) share a lane: small devices serve one request at a time. One that does
/// not answer delays the others at this server, by up to `timeout`, and nothing else. The connection is kept. Stopping
/// ends a request that is under way within a second or so; closing the loop waits for that, no longer than `timeout`
/// and half a second.
///
/// Library `rtdata::http`, which needs libcurl.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/net/http.hpp"
#include "rtdata/sensors/lines.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace rtdata {

struct HttpSensorConfig {
  HttpPeer server = {};
  bool digest = false;                  ///< `user` and `password` by digest authentication (RFC 7616), not basic
  HttpMethod method = HttpMethod::get;  ///< or post
  std::string text = {};                ///< the body of the request, with post
  std::string content_type = "application/json";
  LineFormat format = LineFormat::json;  ///< json, csv, labels or pattern
  std::vector<LineField> fields = {};
  char separator = ',';  ///< CSV: between the columns; labels: between label and value; a blank: any number of blanks
  unsigned skip_lines = 0;                      ///< CSV: lines before the one that is read, such as a heading
  std::string pattern = {};                     ///< of `format` pattern, searched for in the whole answer
  std::optional<LineMatch> only = {};           ///< which answers (CSV: lines) become events
  std::optional<LineMatch> unreadable_if = {};  ///< answers that mean that the device has no value
  std::size_t max_answer = 65536;               ///< bytes; a longer one is unreadable
  Duration timeout = std::chrono::seconds{5};   ///< from name lookup to the end of the answer

  friend constexpr auto parameters(type_tag<HttpSensorConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        include_member(&HttpSensorConfig::server),
        parameter("digest", &HttpSensorConfig::digest,
                  "true: digest authentication instead of basic; newer Shelly devices need it"),
        parameter("method", &HttpSensorConfig::method, "method of the request; get has no body",
                  choices(value("get", HttpMethod::get), value("post", HttpMethod::post))),
        parameter("text", &HttpSensorConfig::text, "the body of the request", only_with("method", "post")),
        parameter("content_type", &HttpSensorConfig::content_type, "content type of the body",
                  only_with("method", "post")),
        parameter("format", &HttpSensorConfig::format, "format of an answer",
                  choices(value("json", LineFormat::json), value("csv", LineFormat::csv),
                          value("labels", LineFormat::labels), value("pattern", LineFormat::pattern))),
        parameter("fields", &HttpSensorConfig::fields, "values in an answer", rtdata::required),
        parameter("separator", &HttpSensorConfig::separator,
                  "character between the columns of CSV, or between label and value",
                  only_with("format", "csv", "labels")),
        parameter("pattern", &HttpSensorConfig::pattern, "a regular expression with a named group for each field",
                  only_with("format", "pattern")),
        parameter("skip_lines", &HttpSensorConfig::skip_lines,
                  "number of lines before the one that is read, such as a heading", range(0, 1000),
                  only_with("format", "csv")),
        parameter("only", &HttpSensorConfig::only,
                  "which answers, or lines of CSV, become events; others are skipped and count as filtered"),
        parameter("unreadable_if", &HttpSensorConfig::unreadable_if,
                  "answers by which the device says that it has no value"),
        parameter("max_answer", &HttpSensorConfig::max_answer, "a longer answer is unreadable", rtdata::unit("By"),
                  range(16, 1048576)),
        parameter("timeout", &HttpSensorConfig::timeout,
                  "time limit from the lookup of the host name to the end of the answer",
                  range(Duration{10ms}, Duration{10min})));
  }
};

/// Sends nothing.
void check_config(const HttpSensorConfig& config, const ConfigItem& item, Problems& problems);
ReadTime read_time(const HttpSensorConfig& config);

class HttpSensor : public AnySensor {
 public:
  HttpSensor() noexcept = default;
  /// SetupError: as `Sensor`; bad-argument for a configuration that cannot work; not-found (libcurl). With `required`
  /// the URL is asked once more at the start, and a failure or an unreadable answer is a SetupError.
  HttpSensor(Loop& loop, SensorConfig sensor, HttpSensorConfig config);

 private:
  explicit HttpSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
