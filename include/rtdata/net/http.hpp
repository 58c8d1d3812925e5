/// HttpPeer: the address and connection settings of an HTTP server, for the sink, the sensor and the output.
///
///     rtdata::HttpPeer relay{.url = "http://relay.local/relay/0", .user = "admin", .password = secret};
///
/// A value; any thread.
#pragma once

#include <map>
#include <string>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/net/tls.hpp"

namespace rtdata {

/// The version of HTTP. `automatic`: 2 if the connection is encrypted and the peer supports it, otherwise 1.1. `two`:
/// always 2, also without encryption.
enum class HttpVersion { automatic, one, two };
constexpr auto describe(type_tag<HttpVersion>) {
  return enumeration("http_version", value("auto", HttpVersion::automatic), value("1.1", HttpVersion::one),
                     value("2", HttpVersion::two));
}

/// Not every user of a peer supports each.
enum class HttpMethod { get, post, put };
constexpr auto describe(type_tag<HttpMethod>) {
  return enumeration("method", value("get", HttpMethod::get), value("post", HttpMethod::post),
                     value("put", HttpMethod::put));
}

/// The environment's proxy variables are not used.
struct HttpPeer {
  std::string url;                                  ///< http:// or https://, without user and password
  std::map<std::string, std::string> headers = {};  ///< sent with each request
  std::string bearer = {};                          ///< sent as "Authorization: Bearer ..."
  std::string user = {};                            ///< with `password`: basic authentication
  std::string password = {};
  HttpVersion http_version = HttpVersion::automatic;
  TlsConfig tls = {};      ///< of https
  std::string proxy = {};  ///< URL of an HTTP proxy; empty: none
  std::string proxy_user = {};
  std::string proxy_password = {};

  friend constexpr auto parameters(type_tag<HttpPeer>) {
    return parameter_list(
        parameter("url", &HttpPeer::url, "the URL: http:// or https://, without user and password", required),
        parameter("headers", &HttpPeer::headers, "headers of each request, by name"),
        parameter("bearer", &HttpPeer::bearer, "token for the header Authorization"),
        parameter("user", &HttpPeer::user, "user name for basic authentication"),
        parameter("password", &HttpPeer::password, "password of the user"),
        parameter("http_version", &HttpPeer::http_version,
                  "auto: 2 with https if the peer supports it, else 1.1; 2: also without encryption"),
        parameter("tls", &HttpPeer::tls, "how https checks the peer's identity"),
        parameter("proxy", &HttpPeer::proxy,
                  "URL of an HTTP proxy; default: none, also if environment variables name one"),
        parameter("proxy_user", &HttpPeer::proxy_user, "user name for the proxy"),
        parameter("proxy_password", &HttpPeer::proxy_password, "password of `proxy_user`"));
  }
};

}  // namespace rtdata
