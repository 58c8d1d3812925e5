// The URL of a server, and mistakes in the settings of a peer.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "data/setting_mistake.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/net/http.hpp"

namespace rtdata {

namespace detail {

struct HttpUrl {
  std::string scheme;  // "http" or "https"
  std::string host;    // without brackets
  std::uint16_t port = 0;
  std::string origin;      // "https://host:8443", to show: paths and queries may hold secrets
  bool has_login = false;  // user or password
  bool has_fragment = false;
  bool is_encrypted() const noexcept { return scheme == "https"; }
  /// The same server, and the same encryption.
  bool operator==(const HttpUrl& other) const noexcept {
    return scheme == other.scheme && host == other.host && port == other.port;
  }
};
/// libcurl can be used. Error: not-found.
Result<void> load_curl();
/// Errors: bad_argument, with the reason in `why`; not-found (libcurl).
Result<HttpUrl> parse_http_url(const std::string& text);

std::vector<SettingMistake> mistakes_of(const HttpPeer& server);
bool is_one_line(const std::string& text);

}  // namespace detail
}  // namespace rtdata
