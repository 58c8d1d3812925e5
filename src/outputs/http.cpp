#include "rtdata/outputs/http.hpp"

#include <condition_variable>
#include <mutex>
#include <system_error>
#include <thread>
#include <utility>

#include "data/hidden.hpp"
#include "data/no_memory.hpp"
#include "io/no_sigpipe.hpp"
#include "net/http_request.hpp"
#include "outputs/set_text.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_set_http = "cannot set the device at the URL";
constexpr Duration spare = std::chrono::milliseconds{100};  // beyond libcurl's own limit

/// With each word in place of the value, and with 0.
std::vector<HttpPeer> servers_of(const HttpActuatorConfig& config) {
  std::vector<HttpPeer> servers;
  const auto add = [&](const std::string& word) {
    servers.push_back(config.server);
    servers.back().url = detail::set_text(config.server.url, 0, {{"0", word}});
  };
  add("0");
  for (const auto& [value, word] : config.words) add(word);
  return servers;
}

std::vector<detail::SettingMistake> mistakes_of(const HttpActuatorConfig& config) {
  std::vector<detail::SettingMistake> mistakes;
  for (const HttpPeer& server : servers_of(config)) {
    mistakes = detail::mistakes_of(server);
    if (!mistakes.empty()) return mistakes;
  }
  if (!detail::is_one_line(config.content_type))
    mistakes.push_back({"content_type", "it has a line break or another control character"});
  if (!detail::has_value_mark(config.server.url) &&
      (config.method == HttpMethod::get || !detail::has_value_mark(config.text)))
    mistakes.push_back({config.method == HttpMethod::get ? "url" : "text",
                        "every value would send the same request: write {value} into it"});
  return mistakes;
}

}  // namespace

/// Shared with the thread of the request, which may outlive the actuator.
struct HttpActuator::Request {
  explicit Request(HttpActuatorConfig its_config) : config(std::move(its_config)) {}
  Request(const Request&) = delete;
  Request& operator=(const Request&) = delete;
  ~Request() {
    const detail::NoSigpipe guard;
    curl_easy_cleanup(easy);
    curl_slist_free_all(headers);
  }

  void make() {
    easy = curl_easy_init();
    if (easy == nullptr) detail::no_memory();
    url = detail::parse_http_url(servers_of(config).front().url).or_throw();
    secrets = detail::secrets_of(config.server);
    detail::append_headers(headers, config.server, config.method == HttpMethod::get ? "" : config.content_type);
    const auto set = [&](CURLoption option, auto value) { curl_easy_setopt(easy, option, value); };
    detail::set_server(easy, config.server, url);
    set(CURLOPT_NOSIGNAL, 1L);
    set(CURLOPT_HTTPHEADER, headers);
    set(CURLOPT_ERRORBUFFER, error);
    set(CURLOPT_WRITEDATA, &answered);
    set(CURLOPT_WRITEFUNCTION, &detail::HttpText::take);
    if (config.method != HttpMethod::get) set(CURLOPT_POST, 1L);
    if (config.method == HttpMethod::put) set(CURLOPT_CUSTOMREQUEST, "PUT");
    set(CURLOPT_TIMEOUT_MS, static_cast<long>(std::chrono::ceil<std::chrono::milliseconds>(config.timeout).count()));
  }
  void prepare(double value) {
    is_done = false;
    answered = {};
    error[0] = '\0';
    const std::string where = detail::set_text(config.server.url, value, config.words);
    curl_easy_setopt(easy, CURLOPT_URL, where.c_str());  // copied
    if (config.method == HttpMethod::get) return;
    const std::string body = detail::set_text(config.text, value, config.words);
    curl_easy_setopt(easy, CURLOPT_POSTFIELDSIZE, static_cast<long>(body.size()));
    curl_easy_setopt(easy, CURLOPT_COPYPOSTFIELDS, body.c_str());
  }
  /// On a thread of its own.
  void run() noexcept {
    const detail::NoSigpipe guard;
    const CURLcode result = curl_easy_perform(easy);
    const std::lock_guard lock(mutex);
    status = result;
    is_done = true;
    done.notify_all();
  }
  Result<void> outcome() {
    if (status == CURLE_OK) {
      long number = 0;
      curl_easy_getinfo(easy, CURLINFO_RESPONSE_CODE, &number);
      const std::string text = detail::hidden(answered.text, secrets);
      const detail::HttpJudgement judgement = detail::judge(detail::HttpAnswer{.status = number, .text = text},
                                                            url.origin);
      if (judgement.verdict == detail::HttpVerdict::taken) return {};
      return Error{judgement.why.code, cannot_set_http, url.origin, judgement.why.why,
                   "check `url`, `method` and `text`"};
    }
    const detail::HttpUrl proxy = config.server.proxy.empty() ? detail::HttpUrl{}
                                                              : detail::parse_http_url(config.server.proxy).or_throw();
    detail::HttpJudgement judgement = detail::judge(detail::failure_of(easy, status, error), url.origin, proxy.origin);
    if (status == CURLE_OPERATION_TIMEDOUT) judgement.why.why = "it did not answer within " + to_string(config.timeout);
    // A temporary failure: the server may be reachable the next time.
    const bool is_away = judgement.verdict == detail::HttpVerdict::later && judgement.why.code != Errc::not_permitted;
    return Error{is_away ? Errc::disconnected : judgement.why.code, cannot_set_http, judgement.why.where,
                 detail::hidden(std::move(judgement.why.why), secrets), judgement.why.advice};
  }

  const HttpActuatorConfig config;
  detail::HttpUrl url;
  std::vector<std::string> secrets;
  CURL* easy = nullptr;
  curl_slist* headers = nullptr;
  detail::HttpText answered;
  char error[CURL_ERROR_SIZE] = "";

  std::mutex mutex;  // protects the members below
  std::condition_variable done;
  bool is_done = false;
  CURLcode status = CURLE_OK;
};

HttpActuator::HttpActuator(HttpActuatorConfig config) : request_(std::make_shared<Request>(std::move(config))) {
  detail::need_curl();
  for (const detail::SettingMistake& mistake : mistakes_of(request_->config)) throw mistake.error(cannot_set_http);
  request_->make();
}

HttpActuator::~HttpActuator() = default;

Result<void> HttpActuator::open(std::optional<double> value) { return value ? set(*value) : Result<void>(); }

Result<void> HttpActuator::set(double value) {
  request_->prepare(value);
  std::thread thread([request = request_] { request->run(); });
  std::unique_lock lock(request_->mutex);
  const bool is_done = request_->done.wait_for(lock, request_->config.timeout + spare,
                                               [this] { return request_->is_done; });
  lock.unlock();
  if (is_done) {
    thread.join();
    return request_->outcome();
  }
  thread.detach();
  Error error{Errc::disconnected, cannot_set_http, request_->url.origin,
              "its name was not looked up within " + to_string(request_->config.timeout),
              "check the name servers, or use an IP address"};
  request_ = std::make_shared<Request>(request_->config);  // the thread has the other one
  request_->make();
  return error;
}

void check_config(const HttpActuatorConfig& config, const ConfigItem& item, Problems& problems) {
  if (!detail::add_not_installed(detail::load_curl(), item, problems)) return;
  detail::add_mistakes(mistakes_of(config), item, problems);
  detail::check_words(config.words, item, problems);
}

}  // namespace rtdata
