#include "net/http_request.hpp"

#include <algorithm>
#include <cstring>

#include "data/no_memory.hpp"

namespace rtdata::detail {
namespace {

/// Where libcurl finds the trusted authorities of this computer. From the folder, OpenSSL reads only what it needs;
/// reading one file with all of them takes 50 ms.
const char* folder_of_authorities() {
  const curl_version_info_data* const about = curl_version_info(CURLVERSION_NOW);
  const bool is_openssl = about->ssl_version != nullptr && std::strstr(about->ssl_version, "OpenSSL") != nullptr;
  return is_openssl && about->age >= CURLVERSION_SEVENTH ? about->capath : nullptr;
}

/// Parameters of InfluxDB's URLs that are shown in errors, because their values help.
bool is_known_parameter(std::string_view key) {
  constexpr std::string_view known[] = {"org", "orgID", "bucket", "db", "rp", "precision", "consistency"};
  return std::find(std::begin(known), std::end(known), key) != std::end(known);
}

/// Decodes as most servers do in their answers.
std::string decoded(std::string_view text) {
  std::string out;
  const auto digit = [](char c) {
    constexpr std::string_view digits = "0123456789abcdef";
    return digits.find(static_cast<char>(c >= 'A' && c <= 'F' ? c - 'A' + 'a' : c));
  };
  for (std::size_t i = 0; i < text.size(); ++i) {
    const bool is_escape = text[i] == '%' && i + 2 < text.size() && digit(text[i + 1]) != text.npos &&
                           digit(text[i + 2]) != text.npos;
    if (is_escape) {
      out += static_cast<char>(digit(text[i + 1]) << 4 | digit(text[i + 2]));
      i += 2;
    } else {
      out += text[i];
    }
  }
  return out;
}

/// As it is, decoded, and decoded as a form's query is.
void add_forms_of(std::string_view part, std::vector<std::string>& secrets) {
  secrets.emplace_back(part);
  if (part.find('%') != part.npos) secrets.push_back(decoded(part));
  if (part.find('+') == part.npos) return;
  std::string form(part);
  std::replace(form.begin(), form.end(), '+', ' ');
  secrets.push_back(decoded(form));
}

/// Short parts of a path are words, such as "api", unless they have digits among letters, as tokens do.
bool may_be_token(std::string_view part) {
  constexpr std::size_t least = 12, least_mixed = 6;
  const auto has = [&](auto is) { return std::any_of(part.begin(), part.end(), is); };
  return part.size() >= least || (part.size() >= least_mixed && has([](char c) { return c >= '0' && c <= '9'; }) &&
                                  has([](char c) { return (c | 0x20) >= 'a' && (c | 0x20) <= 'z'; }));
}

/// Adds the possible secrets of a URL, which a server's answer may repeat: everything after the host, the query, its
/// values, and parts of the path that may be tokens; each also decoded.
void add_secrets_of(std::string_view url, std::vector<std::string>& secrets) {
  constexpr std::size_t least_value = 4;  // shorter texts are not hidden
  const std::size_t host = url.find("://");
  const std::size_t target = host == url.npos ? url.npos : url.find_first_of("/?", host + 3);
  if (target == url.npos) return;
  const std::string_view whole = url.substr(target);
  const std::size_t question = std::min(whole.find('?'), whole.size());
  add_forms_of(whole, secrets);
  if (question < whole.size()) add_forms_of(whole.substr(question), secrets);
  for (std::string_view path = whole.substr(0, question); !path.empty();) {
    const std::size_t end = std::min(path.find('/'), path.size());
    if (may_be_token(decoded(path.substr(0, end)))) add_forms_of(path.substr(0, end), secrets);
    path.remove_prefix(std::min(end + 1, path.size()));
  }
  for (std::string_view query = whole.substr(question); !query.empty();) {
    if (query.front() == '?') query.remove_prefix(1);
    const std::size_t end = std::min(query.find_first_of("&;"), query.size());
    const std::string_view one = query.substr(0, end);
    const std::size_t equals = std::min(one.find('='), one.size());
    const std::string_view key = one.substr(0, equals), value = one.substr(std::min(equals + 1, one.size()));
    if (may_be_token(key)) add_forms_of(key, secrets);
    if (value.size() >= least_value && (may_be_token(value) || !is_known_parameter(key))) add_forms_of(value, secrets);
    query.remove_prefix(std::min(end + 1, query.size()));
  }
}

std::string base64(const std::string& text) {
  static constexpr char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  for (std::size_t i = 0; i < text.size(); i += 3) {
    std::uint32_t bits = 0;
    for (std::size_t k = 0; k < 3; ++k)
      bits = bits << 8 | (i + k < text.size() ? static_cast<unsigned char>(text[i + k]) : 0U);
    for (std::size_t k = 0; k < 4; ++k) out += i + k > text.size() ? '=' : digits[bits >> (18 - 6 * k) & 63];
  }
  return out;
}

}  // namespace

void need_curl() {
  load_curl().or_throw();
  static const CURLcode status = curl_global_init(CURL_GLOBAL_DEFAULT);
  if (status != CURLE_OK)
    throw SetupError({Errc::io_failed, "cannot prepare libcurl", "", curl_easy_strerror(status), ""});
}

bool curl_may_raise_sigpipe() noexcept {
  constexpr unsigned without_signals = 0x075800;  // from 7.88 on, it writes with MSG_NOSIGNAL
  return curl_version_info(CURLVERSION_NOW)->version_num < without_signals;
}

void append(curl_slist*& list, const std::string& text) {
  curl_slist* const longer = curl_slist_append(list, text.c_str());
  if (longer == nullptr) detail::no_memory();
  list = longer;
}

void append_headers(curl_slist*& list, const HttpPeer& server, const std::string& content_type) {
  if (!content_type.empty()) append(list, "Content-Type: " + content_type);
  append(list, "Expect:");  // without asking the server first
  if (!server.bearer.empty()) append(list, "Authorization: Bearer " + server.bearer);
  for (const auto& [name, text] : server.headers) append(list, name + (text.empty() ? ";" : ": " + text));
}

std::vector<std::string> secrets_of(const HttpPeer& server) {
  std::vector<std::string> secrets{server.bearer, server.password, server.tls.key_password, server.proxy_password};
  if (!server.user.empty()) secrets.push_back(base64(server.user + ":" + server.password));
  if (!server.proxy_user.empty()) secrets.push_back(base64(server.proxy_user + ":" + server.proxy_password));
  for (const auto& [name, text] : server.headers)
    if (constexpr std::size_t least = 4; text.size() >= least) secrets.push_back(text);  // as `hidden` hides
  add_secrets_of(server.url, secrets);
  return secrets;
}

void set_server(CURL* easy, const HttpPeer& server, const HttpUrl& url) {
  const auto set = [&](CURLoption option, auto value) { curl_easy_setopt(easy, option, value); };
  set(CURLOPT_URL, server.url.c_str());
#if LIBCURL_VERSION_NUM >= 0x075500
  set(CURLOPT_PROTOCOLS_STR, "http,https");
#else
  set(CURLOPT_PROTOCOLS, static_cast<long>(CURLPROTO_HTTP | CURLPROTO_HTTPS));
#endif
  set(CURLOPT_USERAGENT, "rtdata/" RTDATA_VERSION);
  const bool may_be_two = server.http_version == HttpVersion::two ||
                          (server.http_version == HttpVersion::automatic && url.is_encrypted());
  set(CURLOPT_HTTP_VERSION, static_cast<long>(!may_be_two          ? CURL_HTTP_VERSION_1_1
                                              : url.is_encrypted() ? CURL_HTTP_VERSION_2TLS
                                                                   : CURL_HTTP_VERSION_2_PRIOR_KNOWLEDGE));
  if (may_be_two) set(CURLOPT_PIPEWAIT, 1L);  // one connection for all
  if (!server.user.empty()) {
    set(CURLOPT_HTTPAUTH, static_cast<long>(CURLAUTH_BASIC));
    set(CURLOPT_USERNAME, server.user.c_str());
    set(CURLOPT_PASSWORD, server.password.c_str());
  }
  set(CURLOPT_PROXY, server.proxy.c_str());  // an empty one: no proxy, also if environment variables name one
  if (!server.proxy_user.empty()) {
    set(CURLOPT_PROXYAUTH, static_cast<long>(CURLAUTH_BASIC));
    set(CURLOPT_PROXYUSERNAME, server.proxy_user.c_str());
    set(CURLOPT_PROXYPASSWORD, server.proxy_password.c_str());
  }
  const TlsConfig& tls = server.tls;
  set(CURLOPT_SSL_VERIFYPEER, tls.verify ? 1L : 0L);
  set(CURLOPT_SSL_VERIFYHOST, tls.verify ? 2L : 0L);
  if (!tls.ca_file.empty()) {
    set(CURLOPT_CAINFO, tls.ca_file.c_str());
    set(CURLOPT_CAPATH, static_cast<const char*>(nullptr));
  } else if (const char* folder = folder_of_authorities(); folder != nullptr) {
    set(CURLOPT_CAINFO, static_cast<const char*>(nullptr));
    set(CURLOPT_CAPATH, folder);
  }
  if (!tls.certificate.empty()) {
    set(CURLOPT_SSLCERT, tls.certificate.c_str());
    set(CURLOPT_SSLKEY, tls.key.c_str());
    set(CURLOPT_KEYPASSWD, tls.key_password.c_str());  // also an empty one, or OpenSSL would ask at the terminal
  }
}

HttpFailure failure_of(CURL* easy, CURLcode result, const char* text) {
  HttpFailure failure{.code = result, .text = text};
  long error_number = 0;
  curl_easy_getinfo(easy, CURLINFO_SSL_VERIFYRESULT, &failure.verify_result);
  curl_easy_getinfo(easy, CURLINFO_HTTP_CONNECTCODE, &failure.connect_status);
  curl_easy_getinfo(easy, CURLINFO_OS_ERRNO, &error_number);
  failure.error_number = static_cast<int>(error_number);
  if (result == CURLE_WRITE_ERROR) failure.text = "the answer is longer than 1 MiB";
  return failure;
}

std::size_t HttpText::take(char* data, std::size_t, std::size_t size, void* to) {
  auto& into = *static_cast<HttpText*>(to);
  into.size += size;
  into.text.append(data, std::min(size, into.most_kept - std::min(into.text.size(), into.most_kept)));
  return into.size > into.longest ? std::size_t{0} : size;
}

}  // namespace rtdata::detail
