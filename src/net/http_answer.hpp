// Interprets a server's answer, or the failure to get one, for the sent request.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::detail {

struct HttpAnswer {
  long status = 0;
  std::string_view text{};  // how the body begins
  Duration retry_after{0};  // 0: the server did not say
  std::string redirect{};   // target of the redirection, absolute; empty: none
};

enum class HttpVerdict {
  taken,
  refused,  // at least one event was refused; sending halves shows which one
  too_large,
  elsewhere,  // to be sent to `redirect`
  later,
  faulted,  // like later, but the user must change something
};

struct HttpJudgement {
  HttpVerdict verdict = HttpVerdict::taken;
  Error why{};  // except for taken and elsewhere
  std::optional<Duration> after{};
};

/// `origin` is the server's.
HttpJudgement judge(const HttpAnswer& answer, const std::string& origin);

/// The first line of a body for display: at most 200 bytes, without control characters.
std::string first_line_of(std::string_view body);

/// A transfer that has failed, of libcurl.
struct HttpFailure {
  int code = 0;             // CURLcode
  long verify_result = 0;   // OpenSSL's, of the peer's certificate
  long connect_status = 0;  // of the proxy
  int error_number = 0;     // of the operating system
  std::string text{};       // of libcurl
};
HttpJudgement judge(const HttpFailure& failure, const std::string& origin, const std::string& proxy_origin);

}  // namespace rtdata::detail
