#include "app/run/peer_form.hpp"
#include "data/lower_case.hpp"

#include <algorithm>
#include <filesystem>
#include <vector>

namespace rtdata::app {

std::string text_of(const ConfigItem& item, std::string_view key) {
  const ConfigItem* const child = item.find(key);
  if (child == nullptr) return "";
  const std::string* const text = child->as_string();
  return text != nullptr ? *text : child->to_json(ConfigItem::Layout::one_line);
}

namespace {

std::string_view usual_port(std::string_view scheme) {
  if (scheme == "http") return "80";
  if (scheme == "https") return "443";
  return scheme == "postgresql" ? "5432" : "";
}

/// Of "a=1&b=2", what says where the server is: PostgreSQL's other parameters say how it is spoken to.
std::string places_of(std::string_view parameters) {
  std::vector<std::string> places;
  while (!parameters.empty()) {
    const std::string_view one = parameters.substr(0, parameters.find('&'));
    parameters.remove_prefix(std::min(one.size() + 1, parameters.size()));
    const std::string_view name = one.substr(0, one.find('='));
    if (one == "port=5432") continue;
    if (name == "host" || name == "hostaddr" || name == "port" || name == "dbname") places.emplace_back(one);
  }
  std::sort(places.begin(), places.end());
  std::string text;
  for (const std::string& place : places) text += (text.empty() ? "?" : "&") + place;
  return text;
}

/// What cannot be taken apart stays as it is.
std::string url_form(const std::string& url) {
  const std::size_t colon = url.find("://");
  if (colon == std::string::npos) return url;
  std::string scheme = detail::lower_case(url.substr(0, colon));
  if (scheme == "postgres") scheme = "postgresql";
  const std::size_t begin = colon + 3, end = std::min(url.find_first_of("/?#", begin), url.size());
  std::string place = url.substr(begin, end - begin), rest = url.substr(end);
  std::string user;
  if (const std::size_t at = place.rfind('@'); at != std::string::npos) {
    user = place.substr(0, at + 1);
    place.erase(0, at + 1);
  }
  place = detail::lower_case(place);
  const std::string port = ":" + std::string(usual_port(scheme));
  if (place.ends_with(':')) {
    place.pop_back();
  } else if (port.size() > 1 && place.ends_with(port)) {
    place.erase(place.size() - port.size());
  }
  if (scheme == "postgresql") {
    const std::size_t question = rest.find('?');
    const std::string parameters = question == std::string::npos ? "" : rest.substr(question + 1);
    rest = rest.substr(0, question) + places_of(parameters);
  }
  if (!rest.starts_with('/')) rest.insert(0, "/");
  return scheme + "://" + user + place + rest;
}

std::string port_form(const ConfigItem& sink, const std::string& port) {
  if (!port.empty() && port != "0") return port;
  const std::string type = text_of(sink, "type");
  if (type == "mqtt") {
    const ConfigItem* const tls = sink.find("tls");
    return tls != nullptr && tls->is_object() ? "8883" : "1883";
  }
  if (type == "postgresql") return "5432";
  return type == "udp" ? "9870" : port;
}

}  // namespace

std::string peer_form(const ConfigItem& sink, std::string_view key) {
  const std::string text = text_of(sink, key);
  if (key == "url") return url_form(text);
  if (key == "port") return port_form(sink, text);
  if (key == "path") return std::filesystem::path(text).lexically_normal().string();
  if (key != "host") return text;
  const std::string type = text_of(sink, "type");
  const bool has_default = type == "mqtt" || type == "udp";
  return text.empty() && has_default ? "localhost" : detail::lower_case(text);
}

}  // namespace rtdata::app
