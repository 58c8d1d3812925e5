/// HttpActuator: a device on the network that is set by a request of HTTP, as the device of an output.
///
///     rtdata::HttpActuator relay({.server = {.url = "http://192.168.1.40/relay/0?turn={value}"},
///                                 .method = rtdata::HttpSetMethod::get, .words = {{"0", "off"}, {"1", "on"}}});
///
/// A value is set when the server has answered with a status from 200 to 299, within `timeout`. Redirections are not
/// followed. When there is no answer, the device may have the value all the same: nobody knows.
///
/// The library `rtdata::http`, which needs libcurl. A request is done on a thread of its own, which is left behind when
/// the name servers do not answer; what is left behind sends nothing any more once the time is over.
///
/// Errors: bad-argument (a URL or header that cannot be one); disconnected (nobody was reached or answered in time: an
/// output begins all the same, and tries again); what the server's answer means.
#pragma once

#include <map>
#include <memory>
#include <string>

#include "rtdata/net/http.hpp"
#include "rtdata/outputs/output.hpp"

namespace rtdata {

enum class HttpSetMethod { get, post, put };
constexpr auto describe(type_tag<HttpSetMethod>) {
  return enumeration("method", value("get", HttpSetMethod::get), value("post", HttpSetMethod::post),
                     value("put", HttpSetMethod::put));
}

struct HttpActuatorConfig {
  HttpPeer server = {};  ///< in its URL, too, `{value}` is the value
  HttpSetMethod method = HttpSetMethod::post;
  std::string text = "{value}";  ///< the body, but of get; `{value}` is the value, as short as it is exact: 1, 0.5
  std::string content_type = "text/plain; charset=utf-8";
  std::map<std::string, std::string> words = {};  ///< what is written in place of a value: {"0": "off", "1": "on"}
  Duration timeout = std::chrono::seconds{1};     ///< from looking up the name to the answer

  friend constexpr auto parameters(type_tag<HttpActuatorConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        include_member(&HttpActuatorConfig::server),
        parameter("method", &HttpActuatorConfig::method, "of the request; get has no body"),
        parameter("text", &HttpActuatorConfig::text, "the body of the request; {value} stands for the value",
                  placeholders("value")),
        parameter("content_type", &HttpActuatorConfig::content_type, "of the body"),
        parameter("words", &HttpActuatorConfig::words, "what {value} is, by value: {\"0\": \"off\", \"1\": \"on\"}"),
        parameter("timeout", &HttpActuatorConfig::timeout, "from looking up the name to the answer",
                  range(Duration{10ms}, Duration{1500ms})));
  }
  friend void check_config(const HttpActuatorConfig& config, const ConfigItem& item, Problems& problems);
};
/// Nothing is sent.
void check_config(const HttpActuatorConfig& config, const ConfigItem& item, Problems& problems);

class HttpActuator : public Actuator {
 public:
  explicit HttpActuator(HttpActuatorConfig config);
  HttpActuator(const HttpActuator&) = delete;
  HttpActuator& operator=(const HttpActuator&) = delete;
  ~HttpActuator() override;
  Result<void> open(std::optional<double> value) override;
  Result<void> set(double value) override;

 private:
  struct Request;
  std::shared_ptr<Request> request_;
};

}  // namespace rtdata
