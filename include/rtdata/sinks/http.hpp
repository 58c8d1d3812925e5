/// HttpSink: sends events by HTTP or HTTPS to any server, one event or a batch in each request, several requests at
/// once.
///
///     rtdata::HttpSink collector(loop, {.server = {.url = "https://collector.example/ingest", .bearer = token},
///                                       .sink = {.name = "collector", .through = "recording"}});
///
/// An answer with a status from 200 to 299 confirms the events of a request. Without an answer, and after 408, 429 and
/// 5xx, the sink sends the request again, after the time in Retry-After (at most an hour) or a delay that doubles.
/// After 400, 422 and 413 it sends the events in halves, until it finds the one that the peer does not take; this event
/// is dropped as refused, with the first line of the answer as the reason. After any other answer (401 and 403 for an
/// expired token, 404 for a wrong URL) no event is dropped: the sink is faulted, gives advice, and tries again after
/// `retry_longest`. It follows redirections 307 and 308 within the same scheme, host and port; other redirections count
/// as such an answer.
///
/// An answer of 200 to 299 that is cut off does not count: the request is sent again, three times. If that does not
/// help and the request was sent completely, `cut_answer` decides: its events count as delivered, which is reported and
/// counted, or the request is sent again until there is a complete answer.
///
/// If an answer is lost, an event may arrive twice. The receiver can recognise it by run, origin and sequence, and by
/// the header Idempotency-Key, which is the same if the same events are sent again in one request. With a `window`
/// above 1 requests may overtake each other.
///
/// Lanes encode and compress the events. libcurl transfers them on the loop without blocking it; a lane looks names up.
/// The environment's proxy variables are not used: give `proxy`.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's. Errors of the constructor (SetupError):
/// bad-argument (an invalid configuration), not-found (no such format); those of `Sink`.
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

enum class HttpCompression { none, gzip };
constexpr auto describe(type_tag<HttpCompression>) {
  return enumeration("compression", value("none", HttpCompression::none), value("gzip", HttpCompression::gzip));
}

/// What to do with a request whose answer, from 200 to 299, is repeatedly cut off.
enum class HttpCutAnswer { delivered, again };
constexpr auto describe(type_tag<HttpCutAnswer>) {
  return enumeration("cut_answer", value("delivered", HttpCutAnswer::delivered), value("again", HttpCutAnswer::again));
}

struct HttpConfig {
  HttpPeer server = {};
  HttpMethod method = HttpMethod::post;  ///< or put
  /// "json" (an array of objects; with a `parcel_rows` of 1 the object alone), "jsonl" (an object per line), "cbor"
  /// (one after the other), "influx", "raw", or a name of the registry
  std::string format = "json";
  std::string content_type = {};  ///< empty: the format's
  HttpCompression compression = HttpCompression::none;
  HttpCutAnswer cut_answer = HttpCutAnswer::delivered;
  SendingConfig sending = {};
  SinkConfig sink = {.name = "http"};

  friend constexpr auto parameters(type_tag<HttpConfig>) {
    return parameter_list(
        include_member(&HttpConfig::server),
        parameter("method", &HttpConfig::method, "method of the requests",
                  choices(value("post", HttpMethod::post), value("put", HttpMethod::put))),
        parameter(
            "format", &HttpConfig::format,
            "json (an array of objects; with parcel_rows 1 one object), jsonl, cbor, influx, raw, or a format added "
            "by the program"),
        parameter("content_type", &HttpConfig::content_type,
                  "content type of the requests; default: that of the format"),
        parameter("compression", &HttpConfig::compression, "compression of the requests"),
        parameter("cut_answer", &HttpConfig::cut_answer,
                  "what to do if the server's success answer (200 to 299) is cut off four times: count the request as "
                  "delivered, or send it again"),
        include_member(&HttpConfig::sending), include_member(&HttpConfig::sink));
  }
  /// Checks rules over several parameters. Sends nothing.
  friend void check_config(const HttpConfig& config, const ConfigItem& item, Problems& problems);
};

class HttpSink : public Sink {
 public:
  HttpSink() noexcept = default;
  /// `formats` is used during the call only.
  HttpSink(Loop& loop, HttpConfig config, const CodecRegistry& formats = CodecRegistry::standard());
};

}  // namespace rtdata
