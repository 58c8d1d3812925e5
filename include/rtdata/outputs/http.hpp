/// HttpActuator: an output device on the network that is set by an HTTP request.
///
///     rtdata::HttpActuator relay({.server = {.url = "http://192.168.1.40/relay/0?turn={value}"},
///                                 .method = rtdata::HttpMethod::get, .words = {{"0", "off"}, {"1", "on"}}});
///
/// A value is set when the server has answered with a status from 200 to 299, within `timeout`. Redirections are not
/// followed. Without an answer it is unknown whether the device has the value.
///
/// Library `rtdata::http`, which needs libcurl. A request runs on its own thread, which is abandoned if the name
/// servers do not answer; an abandoned thread sends nothing after the timeout.
///
/// Errors: bad-argument (an invalid URL or header); disconnected (no connection or no answer in time: an output starts
/// anyway and tries again); others according to the server's answer.
#pragma once

#include <map>
#include <memory>
#include <string>

#include "rtdata/net/http.hpp"
#include "rtdata/outputs/output.hpp"

namespace rtdata {

struct HttpActuatorConfig {
  HttpPeer server = {};  ///< `{value}` in its URL is replaced too
  HttpMethod method = HttpMethod::post;
  std::string text = "{value}";  ///< the body, except for get; `{value}`: the shortest exact number: 1, 0.5
  std::string content_type = "text/plain; charset=utf-8";
  std::map<std::string, std::string> words = {};  ///< texts to send for values: {"0": "off", "1": "on"}
  Duration timeout = std::chrono::seconds{1};     ///< from name lookup to answer

  friend constexpr auto parameters(type_tag<HttpActuatorConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        include_member(&HttpActuatorConfig::server),
        parameter("method", &HttpActuatorConfig::method, "method of the request; get has no body"),
        parameter("text", &HttpActuatorConfig::text, "the body of the request; {value} stands for the value",
                  placeholders("value")),
        parameter("content_type", &HttpActuatorConfig::content_type, "content type of the body"),
        parameter("words", &HttpActuatorConfig::words,
                  "text that replaces {value}, for each value: {\"0\": \"off\", \"1\": \"on\"}"),
        parameter("timeout", &HttpActuatorConfig::timeout, "time limit from the lookup of the host name to the answer",
                  range(Duration{10ms}, Duration{1500ms})));
  }
  friend void check_config(const HttpActuatorConfig& config, const ConfigItem& item, Problems& problems);
};
/// Sends nothing.
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
