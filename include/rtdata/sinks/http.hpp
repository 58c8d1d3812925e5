/// HttpSink: events by HTTP or HTTPS to any server: an event or a batch a request, several requests under way.
///
///     rtdata::HttpSink collector(loop, {.server = {.url = "https://collector.example/ingest", .bearer = token},
///                                       .sink = {.name = "collector", .through = "recording"}});
///
/// The peer has the events of a request once it answers with a status from 200 to 299. Without an answer, and after
/// 408, 429 and 5xx, the request is sent again, after the time that the peer asks for (Retry-After, an hour at most) or
/// a delay that doubles. After 400 and 422 its events are sent in halves, down to the one that the peer does not take,
/// which is dropped as refused, with the first line of the answer as the reason; after 413 in halves, too. After any
/// other answer (401 and 403 of a token that has expired, 404 of a URL that is wrong) nothing is thrown away: the sink
/// is faulted, says what to do, and tries again after `retry_longest`. Redirections by 307 and 308 within the same
/// scheme, host and port are followed, others are such an answer.
///
/// An answer of 200 to 299 that is cut off before its end is no answer: the request is sent again, three times. If that
/// does not help, and the request itself was sent whole, its events count as delivered, which is told and counted; or
/// it is sent again and again, as `cut_answer` says.
///
/// An event may arrive twice, when an answer gets lost. Its run, origin and sequence tell; so does the header
/// Idempotency-Key, which is the same whenever the same events are sent again in one request. With a `window` above 1
/// requests may overtake each other.
///
/// Events are encoded, and compressed, on lanes. Transfers are done by libcurl on the loop, without blocking it; names
/// are looked up on a lane. The environment's proxy variables are not used: give `proxy`.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's. Errors of the constructor (SetupError):
/// bad_argument (what `check` says of the configuration), not_found (no such format); those of `Sink`.
#pragma once

#include <string>

#include "rtdata/data/codec.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/net/http.hpp"
#include "rtdata/sinks/sender.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata {

class ConfigItem;
class Problems;

enum class HttpMethod { post, put };
constexpr auto describe(type_tag<HttpMethod>) {
  return enumeration("method", value("post", HttpMethod::post), value("put", HttpMethod::put));
}

enum class HttpCompression { none, gzip };
constexpr auto describe(type_tag<HttpCompression>) {
  return enumeration("compression", value("none", HttpCompression::none), value("gzip", HttpCompression::gzip));
}

/// What a request counts as whose answer, from 200 to 299, is cut off, time after time.
enum class HttpCutAnswer { delivered, again };
constexpr auto describe(type_tag<HttpCutAnswer>) {
  return enumeration("cut_answer", value("delivered", HttpCutAnswer::delivered), value("again", HttpCutAnswer::again));
}

struct HttpConfig {
  HttpPeer server = {};
  HttpMethod method = HttpMethod::post;
  /// "json" (an array of objects; with a `parcel_rows` of 1 the object alone), "jsonl" (an object a line), "cbor" (one
  /// after the other), "influx", "raw", or a name of the registry
  std::string format = "json";
  std::string content_type = {};  ///< empty: the format's
  HttpCompression compression = HttpCompression::none;
  HttpCutAnswer cut_answer = HttpCutAnswer::delivered;
  SendingConfig sending = {};
  SinkConfig sink = {.name = "http"};

  friend constexpr auto parameters(type_tag<HttpConfig>) {
    return parameter_list(
        include_member(&HttpConfig::server), parameter("method", &HttpConfig::method, "of the requests"),
        parameter(
            "format", &HttpConfig::format,
            "json (an array of objects; with parcel_rows 1 one object), jsonl, cbor, influx, raw, or a format added "
            "by the program"),
        parameter("content_type", &HttpConfig::content_type, "in place of the format's own"),
        parameter("compression", &HttpConfig::compression, "of what is sent"),
        parameter(
            "cut_answer", &HttpConfig::cut_answer,
            "what a request counts as that was sent whole, and whose answer of 200 to 299 was cut off four times: "
            "delivered, or sent again and again"),
        include_member(&HttpConfig::sending), include_member(&HttpConfig::sink));
  }
  /// Checks rules over several parameters. Nothing is sent.
  friend void check_config(const HttpConfig& config, const ConfigItem& item, Problems& problems);
};

class HttpSink : public Sink {
 public:
  HttpSink() noexcept = default;
  /// `formats` is used during the call only.
  HttpSink(Loop& loop, HttpConfig config, const CodecRegistry& formats = CodecRegistry::standard());
};

}  // namespace rtdata
