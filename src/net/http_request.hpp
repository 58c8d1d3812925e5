// Common settings of libcurl for a server.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "net/http_answer.hpp"
#include "net/http_url.hpp"
#include "net/libcurl.hpp"
#include "rtdata/net/http.hpp"

namespace rtdata::detail {

/// libcurl is ready for use by any thread; the first call loads and prepares it. Throws SetupError.
void need_curl();

/// libcurl may raise SIGPIPE on encrypted connections: before 7.88 with OpenSSL.
bool curl_may_raise_sigpipe() noexcept;

/// Sets everything except the method, the headers, the timeouts and the use of the answer. `server` is not copied and
/// must outlive the handle.
void set_server(CURL* easy, const HttpPeer& server, const HttpUrl& url);

/// Throws std::bad_alloc.
void append(curl_slist*& list, const std::string& text);
/// The headers that the server needs, after Content-Type (omitted if empty).
void append_headers(curl_slist*& list, const HttpPeer& server, const std::string& content_type);

/// The secrets that must be hidden in a server's answer.
std::vector<std::string> secrets_of(const HttpPeer& server);

/// Of a transfer that has ended.
HttpFailure failure_of(CURL* easy, CURLcode result, const char* text);

/// The beginning of an answer; a longer answer than the limit is not accepted.
struct HttpText {
  std::string text = {};
  std::size_t size = 0;
  std::size_t most_kept = 1024;
  std::size_t longest = std::size_t{1} << 20;
  /// As CURLOPT_WRITEFUNCTION, with a pointer to this as CURLOPT_WRITEDATA.
  static std::size_t take(char* data, std::size_t, std::size_t size, void* to);
};

}  // namespace rtdata::detail
