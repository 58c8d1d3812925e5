#include "net/http_answer.hpp"

#include <algorithm>
#include <cerrno>
#include <iterator>
#include <system_error>
#include <utility>

#include "data/utf8.hpp"
#include "net/http_url.hpp"
#include "net/libcurl.hpp"
#include "net/tls_session.hpp"

namespace rtdata::detail {
namespace {

constexpr Duration longest_wish = std::chrono::hours{1};  // of Retry-After: more is a mistake, or malice
constexpr const char* what = "cannot send";
constexpr const char* kept = "; until then nothing is discarded";

struct Status {
  long number;
  const char* name;
  const char* advice;
  Errc code = Errc::io_failed;
};
constexpr Status statuses[] = {
    {300, "Multiple Choices", ""},
    {301, "Moved Permanently", ""},
    {302, "Found", ""},
    {303, "See Other", ""},
    {307, "Temporary Redirect", ""},
    {308, "Permanent Redirect", ""},
    {400, "Bad Request", "", Errc::bad_data},
    {401, "Unauthorized", "set the right token or password: the server does not accept this one", Errc::not_permitted},
    {403, "Forbidden", "this token or password does not permit writing: ask for the permission, or use another",
     Errc::not_permitted},
    {404, "Not Found", "correct `url`: the server has nothing there", Errc::not_found},
    {405, "Method Not Allowed", "correct `method` or `url`: the server needs another method there"},
    {406, "Not Acceptable", "correct `headers`"},
    {407, "Proxy Authentication Required", "set `proxy_user` and `proxy_password`: the proxy needs a user",
     Errc::not_permitted},
    {408, "Request Timeout",
     "set a smaller `parcel_rows`, or check the network: the server did not get the request in time", Errc::timed_out},
    {409, "Conflict", "read the answer of the server"},
    {410, "Gone", "correct `url`: the server no longer has anything there", Errc::not_found},
    {411, "Length Required", "a proxy on the way removes the header Content-Length: ask its operator"},
    {413, "Content Too Large", "", Errc::does_not_fit},
    {414, "URI Too Long", "shorten `url`"},
    {415, "Unsupported Media Type",
     "correct `format`, `content_type` or `compression`: the server does not accept this format"},
    {422, "Unprocessable Content", "", Errc::bad_data},
    {425, "Too Early", ""},
    {429, "Too Many Requests",
     "set a larger `parcel_rows`, a smaller `window` or `bytes_per_second`: the server asks for fewer requests",
     Errc::busy},
    {431, "Request Header Fields Too Large", "send fewer `headers`"},
    {500, "Internal Server Error", "see the server's log"},
    {501, "Not Implemented", "see the server's log"},
    {502, "Bad Gateway", "check the server behind the gateway: it does not answer"},
    {503, "Service Unavailable", "check the server: it is overloaded, or it restarts", Errc::busy},
    {504, "Gateway Timeout", "check the server behind the gateway: it does not answer", Errc::timed_out},
    {507, "Insufficient Storage", "free space on the server", Errc::storage_full}};

const Status& status_of(long number) {
  const auto* found = std::find_if(std::begin(statuses), std::end(statuses),
                                   [&](const Status& status) { return status.number == number; });
  static constexpr Status unknown{0, "", ""};
  return found != std::end(statuses) ? *found : unknown;
}

Error said(const HttpAnswer& answer, const std::string& origin) {
  const Status& status = status_of(answer.status);
  std::string why = "the server answers " + std::to_string(answer.status);
  if (status.number != 0) why += std::string(" ") + status.name;
  if (const std::string line = first_line_of(answer.text); !line.empty()) why += ": " + line;
  return {status.code, what, origin, std::move(why), status.advice};
}

std::string redirect_advice(const HttpAnswer& answer, const std::string& origin) {
  const auto to = answer.redirect.empty() ? Result<HttpUrl>(Error{}) : parse_http_url(answer.redirect);
  if (!to) return "ask the operator of the server: it gives no new address";
  if (to->origin != origin) return "the server redirects to " + to->origin + ": if that is right, write it into `url`";
  return "correct `url`: the server redirects to another path (`curl -i` shows it)";
}

}  // namespace

HttpJudgement judge(const HttpAnswer& answer, const std::string& origin) {
  if (answer.status >= 200 && answer.status < 300) return {};
  HttpJudgement judgement;
  judgement.why = said(answer, origin);
  if (answer.retry_after.count() > 0) judgement.after = std::min(answer.retry_after, longest_wish);
  if (answer.status == 400 || answer.status == 422) {
    judgement.verdict = HttpVerdict::refused;
  } else if (answer.status == 413) {
    judgement.verdict = HttpVerdict::too_large;
  } else if (answer.status == 408 || answer.status == 421 || answer.status == 425 || answer.status == 429 ||
             (answer.status >= 500 && answer.status != 501 && answer.status != 505 && answer.status < 600)) {
    judgement.verdict = HttpVerdict::later;
  } else {
    judgement.verdict = HttpVerdict::faulted;
    if (answer.status >= 300 && answer.status < 400) judgement.why.advice = redirect_advice(answer, origin);
    judgement.why.advice = judgement.why.advice.empty() ? "read the answer of the server" : judgement.why.advice;
    judgement.why.advice += kept;
  }
  if ((answer.status == 307 || answer.status == 308) && !answer.redirect.empty()) {
    const auto to = parse_http_url(answer.redirect);
    if (to && !to->has_login && to->origin == origin) judgement.verdict = HttpVerdict::elsewhere;
  }
  return judgement;
}

std::string first_line_of(std::string_view body) {
  constexpr std::size_t longest = 200;
  std::string line;
  while (!body.empty() && line.size() < longest) {
    const char c = body.front();
    if (c == '\n' || c == '\r') {
      if (!line.empty()) break;  // skips empty lines at the beginning
      body.remove_prefix(1);
      continue;
    }
    const std::size_t size = utf8_size(body);
    const bool is_shown = size > 0 && static_cast<unsigned char>(c) >= 0x20 && c != 0x7f;
    if (is_shown && line.size() + size > longest) break;
    line += is_shown ? body.substr(0, size) : std::string_view("?");
    body.remove_prefix(std::max<std::size_t>(size, 1));
  }
  while (line.ends_with(' ')) line.pop_back();
  return line;
}

HttpJudgement judge(const HttpFailure& failure, const std::string& origin, const std::string& proxy_origin) {
  HttpJudgement judgement{HttpVerdict::later, {Errc::disconnected, what, origin, failure.text, ""}, {}};
  Error& error = judgement.why;
  const std::string& first = proxy_origin.empty() ? origin : proxy_origin;  // the peer of the connection
  const auto say = [&](Errc code, std::string why, std::string advice) {
    error.code = code;
    if (!why.empty()) error.why = std::move(why);
    error.advice = std::move(advice);
  };
  const auto mentions = [&](std::string_view part) { return failure.text.find(part) != std::string::npos; };
  if (error.why.empty() && load_curl()) error.why = curl_easy_strerror(static_cast<CURLcode>(failure.code));
  if (failure.connect_status >= 400 && !proxy_origin.empty()) {
    const Status& status = status_of(failure.connect_status);
    error.where = origin + " by the proxy " + proxy_origin;
    say(status.code,
        "the proxy answers " + std::to_string(failure.connect_status) + (status.number != 0 ? " " : "") + status.name,
        failure.connect_status == 407 ? std::string(status.advice) + kept
                                      : "check whether the proxy allows this connection");
    if (failure.connect_status < 500) judgement.verdict = HttpVerdict::faulted;
    return judgement;
  }
  switch (static_cast<CURLcode>(failure.code)) {
    case CURLE_COULDNT_CONNECT:
      error.where = first;
      error.code = failure.error_number == ETIMEDOUT ? Errc::timed_out : Errc::disconnected;
      if (failure.error_number != 0) error.why = std::generic_category().message(failure.error_number);
      error.advice = failure.error_number == ECONNREFUSED
                         ? "check that the server runs, and that the port is right: no program listens there"
                         : "check that the computer is on, and that the network reaches it";
      break;
    case CURLE_OPERATION_TIMEDOUT:
      say(Errc::timed_out, "", "check the load of the server, and the speed of the network");
      break;
    case CURLE_COULDNT_RESOLVE_HOST:
    case CURLE_COULDNT_RESOLVE_PROXY:
      error.where = first;
      say(Errc::not_found, "", "check the host name, or use an IP address");
      break;
    case CURLE_PEER_FAILED_VERIFICATION: {
      error.code = Errc::not_permitted;
      // libcurl compares the name itself: only its text shows that this failed.
      long verified = failure.verify_result;
      for (const auto& [text, code] :
           {std::pair{"self-signed", 18L}, std::pair{"self signed", 18L}, std::pair{"does not match", 62L},
            std::pair{"subject name", 62L}, std::pair{"not yet valid", 9L}, std::pair{"expired", 10L}})
        if (mentions(text)) verified = code;
      error.advice = advice_on_certificate(verified, "url");
      break;
    }
    case CURLE_SSL_CONNECT_ERROR:
      say(Errc::io_failed, "",
          "check that the server speaks TLS at this port; it may also need a client certificate (`tls.certificate`)");
      break;
    case CURLE_SSL_CERTPROBLEM:
      say(Errc::bad_data, "", "check the files `tls.certificate` and `tls.key`, and `tls.key_password`");
      judgement.verdict = HttpVerdict::faulted;
      break;
    case CURLE_SSL_CACERT_BADFILE:
      say(Errc::bad_data, "", "check the file `tls.ca_file`: it must exist, be readable, and be PEM");
      judgement.verdict = HttpVerdict::faulted;
      break;
    case CURLE_GOT_NOTHING:
    case CURLE_PARTIAL_FILE:
    case CURLE_SEND_ERROR:
    case CURLE_RECV_ERROR:
    case CURLE_HTTP2:
    case CURLE_HTTP2_STREAM:
      error.advice = "see the server's log: the connection was closed before the answer";
      break;
    case CURLE_WEIRD_SERVER_REPLY:
    case CURLE_UNSUPPORTED_PROTOCOL:
    case CURLE_BAD_CONTENT_ENCODING:
    case CURLE_WRITE_ERROR:
      say(Errc::bad_data, "", "check the port: the answer is not HTTP, or another version of it");
      break;
    case CURLE_OUT_OF_MEMORY:
      error.advice = "free memory of this computer, or let the server answer with fewer headers";
      break;
    default:
      error.advice = "check both ends, and the network between them";
      break;
  }
  return judgement;
}

}  // namespace rtdata::detail
