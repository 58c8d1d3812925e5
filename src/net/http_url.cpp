#include "net/http_url.hpp"

#include <algorithm>
#include <cctype>
#include <memory>
#include <optional>

#include "data/lower_case.hpp"
#include "data/no_memory.hpp"
#include "net/libcurl.hpp"
#include "net/tls_mistakes.hpp"

namespace rtdata {
namespace detail {
namespace {

std::optional<std::string> part_of(CURLU* url, CURLUPart part, unsigned flags = 0) {
  char* text = nullptr;
  if (curl_url_get(url, part, &text, flags) != CURLUE_OK) return std::nullopt;
  const std::unique_ptr<char, void (*)(void*)> owned(text, curl_free);
  return std::string(text);
}

/// The characters of a header name (RFC 9110).
bool is_token(const std::string& text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](unsigned char c) {
    return (c < 0x80 && std::isalnum(c) != 0) ||
           (c != '\0' && std::string_view("!#$%&'*+-.^_`|~").find(static_cast<char>(c)) != std::string_view::npos);
  });
}

/// Why the user cannot set a header with this name; empty: the user can.
std::string owner_of(const std::string& name) {
  static constexpr struct {
    const char* name;
    const char* why;
  } owned[] = {{"authorization", "set `bearer`, or `user` and `password`"},
               {"content-type", "give `content_type`"},
               {"content-encoding", "give `compression`"},
               {"proxy-authorization", "give `proxy_user` and `proxy_password`"},
               {"content-length", "it is set already"},
               {"transfer-encoding", "it is set already"},
               {"connection", "it is set already"},
               {"expect", "it is set already"},
               {"idempotency-key", "it is set already"}};
  for (const auto& one : owned)
    if (detail::lower_case(name) == one.name) return one.why;
  return "";
}

}  // namespace

bool is_one_line(const std::string& text) {
  return std::none_of(text.begin(), text.end(), [](unsigned char c) { return (c < 0x20 && c != '\t') || c == 0x7f; });
}

Result<void> load_curl() { return libcurl.load(); }

Result<HttpUrl> parse_http_url(const std::string& text) {
  const auto wrong = [](std::string why) { return Error{Errc::bad_argument, "cannot send", "", std::move(why), ""}; };
  if (auto loaded = load_curl(); !loaded) return loaded.error();
  if (text.empty()) return wrong("there is no URL");
  if (!std::all_of(text.begin(), text.end(), [](unsigned char c) { return c > 0x20 && c < 0x7f; }))
    return wrong(
        "a URL contains only ASCII letters, and no blanks or control characters: write others as %20 and so on, and a "
        "host name in Punycode (xn--)");
  const std::unique_ptr<CURLU, void (*)(CURLU*)> url(curl_url(), curl_url_cleanup);
  if (url == nullptr) detail::no_memory();
  const std::size_t colon = text.find("://");
  if (colon == std::string::npos) return wrong("it has no scheme: begin it with http:// or https://");
  HttpUrl parsed;
  parsed.scheme = detail::lower_case(text.substr(0, colon));
  if (parsed.scheme != "http" && parsed.scheme != "https")
    return wrong("the scheme is " + text.substr(0, colon) + ", but only http and https are supported");
  if (text.find_first_of("/?#", colon + 3) == colon + 3 || text.size() == colon + 3) return wrong("it has no host");
  const CURLUcode status = curl_url_set(url.get(), CURLUPART_URL, text.c_str(), CURLU_PATH_AS_IS);
  if (status == CURLUE_BAD_PORT_NUMBER) return wrong("the port is not a number from 1 to 65535");
  const auto host = status == CURLUE_OK ? part_of(url.get(), CURLUPART_HOST) : std::nullopt;
  if (!host || host->empty()) return wrong("it is not a URL such as https://collector.example:8443/ingest");
  parsed.host = detail::lower_case(*host);
  const std::string shown = parsed.host;
  if (parsed.host.starts_with('[') && parsed.host.ends_with(']')) parsed.host = parsed.host.substr(1, shown.size() - 2);
  const auto port = part_of(url.get(), CURLUPART_PORT, CURLU_DEFAULT_PORT);
  const long number = port ? std::strtol(port->c_str(), nullptr, 10) : 0;
  if (number < 1 || number > 65535) return wrong("the port is not a number from 1 to 65535");
  parsed.port = static_cast<std::uint16_t>(number);
  const bool is_usual = number == (parsed.is_encrypted() ? 443 : 80);
  parsed.origin = parsed.scheme + "://" + shown + (is_usual ? "" : ":" + std::to_string(number));
  parsed.has_login = part_of(url.get(), CURLUPART_USER) || part_of(url.get(), CURLUPART_PASSWORD);
  parsed.has_fragment = part_of(url.get(), CURLUPART_FRAGMENT).has_value();
  return parsed;
}

std::vector<SettingMistake> mistakes_of(const HttpPeer& config) {
  std::vector<SettingMistake> mistakes = mistakes_of(config.tls);
  const auto add = [&](const char* key, std::string why) { mistakes.push_back({key, std::move(why)}); };
  const auto url = parse_http_url(config.url);
  if (!url) add("url", url.error().why);
  if (url && url->has_login)
    add("url",
        "a URL is shown in messages, with user and password in it: set `user` and `password`, or `bearer`, instead");
  if (url && url->has_fragment) add("url", "the part after # is never sent: remove it");
  if (!config.bearer.empty() && !config.user.empty()) add("bearer", "set either `bearer` or `user`, not both");
  if (config.user.empty() && !config.password.empty()) add("password", "`password` needs a `user`");
  if (config.user.find(':') != std::string::npos)
    add("user", "a user name for basic authentication cannot contain a colon");
  for (const auto& [key, text] :
       {std::pair{"bearer", &config.bearer}, std::pair{"user", &config.user}, std::pair{"password", &config.password},
        std::pair{"proxy_user", &config.proxy_user}, std::pair{"proxy_password", &config.proxy_password}})
    if (!is_one_line(*text)) add(key, "it has a line break or another control character");
  for (const auto& [name, text] : config.headers) {
    const std::string why = owner_of(name);
    if (!is_token(name)) {
      add("headers", "\"" + name + "\" is not a header name: use letters, digits and -");
    } else if (!why.empty()) {
      add("headers", "the header " + name + " cannot be set here: " + why);
    } else if (!is_one_line(text)) {
      add("headers", "the header " + name + " has a line break or another control character");
    }
  }
  if (!config.proxy.empty()) {
    const auto proxy = parse_http_url(config.proxy);
    if (!proxy) add("proxy", proxy.error().why);
    if (proxy && proxy->has_login)
      add("proxy",
          "a URL is shown in messages, with user and password in it: set `proxy_user` and `proxy_password` instead");
  } else if (!config.proxy_user.empty() || !config.proxy_password.empty()) {
    add(config.proxy_user.empty() ? "proxy_password" : "proxy_user", "there is no `proxy`");
  }
  if (url && !url->is_encrypted() && config.proxy.rfind("https", 0) != 0 &&
      (!config.tls.ca_file.empty() || !config.tls.certificate.empty()))
    add("tls", "the URL begins with http://, which is not encrypted: write https://, or remove `tls`");
  return mistakes;
}

}  // namespace detail
}  // namespace rtdata
