#include "rtdata/sensors/http.hpp"

#include <algorithm>
#include <atomic>
#include <utility>

#include "data/hidden.hpp"
#include "data/lower_case.hpp"
#include "data/no_memory.hpp"
#include "io/no_sigpipe.hpp"
#include "net/http_request.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/detail/sensors/transaction.hpp"
#include "sensors/core/sensor_node.hpp"
#include "sensors/core/sysfs_file.hpp"
#include "sensors/lines/line_config.hpp"
#include "sensors/lines/line_decoder.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_ask = "cannot read from the URL";
constexpr const char* cannot_use = "cannot use an answer";
constexpr Duration spare = std::chrono::milliseconds{500};  // beyond libcurl's own limit
constexpr std::size_t longest_etag = 256;                   // one that is longer is not sent back
constexpr std::size_t most_shown = 1024;                    // of an answer, in errors

/// An answer, or a line of it, as a line that comes by itself.
LineConfig as_lines(const HttpSensorConfig& config) {
  LineConfig lines;
  lines.format = config.format;
  lines.fields = config.fields;
  lines.separator = config.separator;
  lines.comment = "";
  lines.pattern = config.pattern;
  lines.only = config.only;
  lines.unreadable_if = config.unreadable_if;
  return lines;
}

detail::LineDecoder decoder_of(const HttpSensorConfig& config) {
  return detail::LineDecoder(as_lines(config), {.what = "answer"});
}

std::vector<detail::SettingMistake> mistakes_of(const HttpSensorConfig& config) {
  std::vector<detail::SettingMistake> mistakes = detail::mistakes_of(config.server);
  const auto add = [&](const char* key, const char* message) { mistakes.push_back({key, message}); };
  for (const auto& [name, text] : config.server.headers)
    if (detail::lower_case(name) == "if-none-match")
      add("headers", "the header If-None-Match cannot be set here: it is set already");
  if (config.digest && config.server.user.empty()) add("digest", "it needs `user` and `password`");
  if (!detail::is_one_line(config.content_type))
    add("content_type", "it has a line break or another control character");
  if (config.method == HttpMethod::put) add("method", "it must be get or post");
  if (config.timeout <= Duration{0}) add("timeout", "it is not positive");
  if (config.format == LineFormat::nmea || config.format == LineFormat::binary)
    add("format", "an answer is json, csv, labels or pattern");
  return mistakes;
}

const char* name_of(LineFormat format) {
  return format == LineFormat::json ? "JSON" : format == LineFormat::csv ? "CSV" : "rows of labels";
}

/// The format of an unexpected answer, such as a page for browsers.
const char* other_format(std::string_view answer) {
  const std::string begin = detail::lower_case(
      answer.substr(std::min(answer.find_first_not_of(" \t\r\n"), answer.size()), 15));
  if (begin.starts_with("<!doctype html") || begin.starts_with("<html")) return "HTML";
  return begin.starts_with("<?xml") ? "XML" : nullptr;
}

const char* advice_on_status(long status) {
  switch (status) {
    case 401:
      return "set the right `user` and `password`, or `bearer`; some devices need `digest`";
    case 403:
      return "ask for the permission to read this URL, or use another user or token";
    case 404:
    case 410:
      return "correct `url`: the server has nothing there";
    case 405:
      return "correct `method` or `url`: the server needs another method there";
    case 407:
      return "set `proxy_user` and `proxy_password`: the proxy needs a user";
    case 429:
      return "set a smaller `rate`: the server asks for fewer requests";
    default:
      return status >= 500 ? "see the log of the server or device" : "check `url` and `method`";
  }
}

/// Sends one request and decodes the answer. Everything except the constructor runs on the lane.
class HttpRequest final : public detail::Transaction {
 public:
  enum class Ended { value, unchanged, left_out, unreadable, failed };

  explicit HttpRequest(HttpSensorConfig config)
      : config_(std::move(config)),
        url_(detail::parse_http_url(config_.server.url).or_throw()),
        secrets_(detail::secrets_of(config_.server)),
        decoder_(decoder_of(config_)) {}
  HttpRequest(const HttpRequest&) = delete;
  HttpRequest& operator=(const HttpRequest&) = delete;
  ~HttpRequest() override { close(); }

  void transact() noexcept override {
    const detail::NoSigpipe guard;
    try {
      ended_ = Ended::failed;
      ask();
    } catch (...) {
      error_.reset();  // no memory: reported as such
    }
  }
  void close() noexcept override {
    const detail::NoSigpipe guard;
    if (easy_ != nullptr) curl_easy_cleanup(std::exchange(easy_, nullptr));
    if (headers_ != nullptr) curl_slist_free_all(std::exchange(headers_, nullptr));
  }
  void given_up() noexcept override { abandon(); }
  /// Ends a transfer that is under way. Any thread.
  void abandon() noexcept { is_abandoned_.store(true, std::memory_order_relaxed); }

  // ---- on the loop, when it has run
  Ended ended() const noexcept { return ended_; }
  std::byte* payload() noexcept { return decoder_.payload(); }
  /// Its value was published: the server need not send the same answer again.
  void keep_etag() {
    if (config_.method == HttpMethod::get) etag_ = new_etag_;
  }
  Error error() const { return error_ ? *error_ : Error{Errc::io_failed, cannot_ask, url_.origin, "no memory", ""}; }

 private:
  void make() {
    easy_ = curl_easy_init();
    if (easy_ == nullptr) detail::no_memory();
    const auto set = [&](CURLoption option, auto value) { curl_easy_setopt(easy_, option, value); };
    detail::set_server(easy_, config_.server, url_);
    if (config_.digest) set(CURLOPT_HTTPAUTH, static_cast<long>(CURLAUTH_DIGEST));
    set(CURLOPT_NOSIGNAL, 1L);
    set(CURLOPT_ERRORBUFFER, error_text_);
    set(CURLOPT_WRITEDATA, &answer_);
    set(CURLOPT_WRITEFUNCTION, &detail::HttpText::take);
    set(CURLOPT_HEADERDATA, this);
    set(CURLOPT_HEADERFUNCTION, &take_header);
    set(CURLOPT_XFERINFODATA, this);
    set(CURLOPT_XFERINFOFUNCTION, &is_to_end);
    set(CURLOPT_NOPROGRESS, 0L);
    set(CURLOPT_TIMEOUT_MS, static_cast<long>(std::chrono::ceil<std::chrono::milliseconds>(config_.timeout).count()));
    if (config_.method == HttpMethod::post) {
      set(CURLOPT_POST, 1L);
      set(CURLOPT_POSTFIELDS, config_.text.c_str());  // not copied
      set(CURLOPT_POSTFIELDSIZE, static_cast<long>(config_.text.size()));
    }
  }
  void set_headers() {
    curl_slist_free_all(std::exchange(headers_, nullptr));
    const bool is_post = config_.method == HttpMethod::post;
    detail::append_headers(headers_, config_.server, is_post ? config_.content_type : "");
    if (!etag_.empty()) detail::append(headers_, "If-None-Match: " + etag_);
    curl_easy_setopt(easy_, CURLOPT_HTTPHEADER, headers_);
  }

  void ask() {
    if (easy_ == nullptr) make();
    set_headers();
    answer_.text.clear();
    answer_.size = 0;
    new_etag_.clear();
    error_text_[0] = '\0';
    const CURLcode result = curl_easy_perform(easy_);
    long status = 0;
    curl_easy_getinfo(easy_, CURLINFO_RESPONSE_CODE, &status);
    const bool is_too_long = answer_.size > config_.max_answer;
    if (result != CURLE_OK && !is_too_long) return fail(error_of(result));
    if (status == 304 && !etag_.empty()) {
      ended_ = Ended::unchanged;
      return;
    }
    if (status != 200) return fail(error_of_status(status));
    if (is_too_long)
      return cannot_be_read(Errc::does_not_fit, "it is longer than " + std::to_string(config_.max_answer) + " bytes",
                            "set a larger `max_answer`, or check `url`");
    take(answer_.text);
  }

  void take(std::string_view answer) {
    if (config_.format != LineFormat::csv) {
      if (!decoder_.is_meant(answer)) return leave_out(answer);
      return decode(answer, answer);
    }
    bool has_lines = false;
    std::string_view rest = answer;
    for (unsigned number = 0; !rest.empty(); ++number) {
      const std::size_t end = std::min(rest.find('\n'), rest.size());
      std::string_view line = rest.substr(0, end);
      rest.remove_prefix(std::min(end + 1, rest.size()));
      if (line.ends_with('\r')) line.remove_suffix(1);
      if (number < config_.skip_lines || decoder_.is_skipped(line)) continue;
      has_lines = true;
      if (decoder_.is_meant(line)) return decode(line, answer);
    }
    if (has_lines) return leave_out(answer);
    cannot_be_read(Errc::bad_data, config_.skip_lines > 0 ? "there is no line after `skip_lines`" : "it is empty",
                   "check that `url` leads to the data");
  }
  void leave_out(std::string_view answer) {
    if (is_other_format(answer)) return;
    ended_ = Ended::left_out;
  }
  void decode(std::string_view line, std::string_view answer) {
    const Result<void> done = decoder_.decode(line);
    if (done) {
      ended_ = Ended::value;
      return;
    }
    if (is_other_format(answer)) return;
    const Error& error = done.error();
    cannot_be_read(static_cast<Errc>(error.code.value()),
                   answer.empty() ? "it is empty" : (error.where.empty() ? "" : error.where + ": ") + error.why,
                   error.advice.empty() ? "check `url` and `fields`" : error.advice);
  }
  /// True: it was reported.
  bool is_other_format(std::string_view answer) {
    const char* const other = config_.format == LineFormat::pattern ? nullptr : other_format(answer);
    if (other == nullptr) return false;
    cannot_be_read(Errc::bad_data, std::string("the answer is ") + other + ", not " + name_of(config_.format),
                   "check that `url` leads to the data: HTML is a page for browsers, such as a login");
    return true;
  }

  void cannot_be_read(Errc code, std::string why, std::string advice) {
    ended_ = Ended::unreadable;
    error_ = Error{code, cannot_use, url_.origin, detail::hidden(std::move(why), secrets_), std::move(advice)};
  }
  void fail(Error error) {
    error.why = detail::hidden(std::move(error.why), secrets_);
    error_ = std::move(error);
  }

  Error error_of_status(long status) const {
    const std::string text = detail::hidden(answer_.text.substr(0, most_shown), secrets_);
    detail::HttpJudgement judgement = detail::judge(detail::HttpAnswer{.status = status, .text = text}, url_.origin);
    Error error{judgement.why.code, cannot_ask, url_.origin, std::move(judgement.why.why), advice_on_status(status)};
    if (judgement.verdict == detail::HttpVerdict::taken) {
      error.code = Errc::bad_data;
      error.why = "the server answers " + std::to_string(status) + ", but an answer with data must have status 200";
    }
    if (status == 304) error.advice = "the request did not ask for changes only: this is an error of the server";
    if (status >= 300 && status < 400 && status != 304) error.advice = advice_on_redirection();
    return error;
  }
  std::string advice_on_redirection() const {
    const char* to = nullptr;
    curl_easy_getinfo(easy_, CURLINFO_REDIRECT_URL, &to);
    const auto url = detail::parse_http_url(to != nullptr ? to : "");
    if (!url) return "check `url`: the server gives no new address";
    if (url->origin == url_.origin) return "correct `url`: the server redirects to another path (`curl -i` shows it)";
    return "the server redirects to " + url->origin + ": if that is right, write it into `url`";
  }
  Error error_of(CURLcode result) const {
    const detail::HttpFailure failure = detail::failure_of(easy_, result, error_text_);
    const HttpPeer& server = config_.server;
    const std::string proxy = server.proxy.empty() ? "" : detail::parse_http_url(server.proxy).or_throw().origin;
    Error error = detail::judge(failure, url_.origin, proxy).why;
    error.what = cannot_ask;
    if (failure.connect_status == 407) error.advice = advice_on_status(407);
    if (result == CURLE_OPERATION_TIMEDOUT)
      error.why = std::string(answer_.size > 0 ? "its answer was not complete" : "it did not answer") + " within " +
                  to_string(config_.timeout);
    return error;
  }

  static std::size_t take_header(char* data, std::size_t, std::size_t size, void* to) {
    const std::string_view header(data, size);
    std::string& etag = static_cast<HttpRequest*>(to)->new_etag_;
    constexpr std::string_view name = "etag:";
    if (header.starts_with("HTTP/")) etag.clear();  // of an answer before
    if (detail::lower_case(header.substr(0, name.size())) != name) return size;
    const std::string_view text = detail::trimmed(header.substr(name.size()));
    if (text.size() <= longest_etag && detail::is_one_line(std::string(text))) etag = text;
    return size;
  }
  static int is_to_end(void* of, curl_off_t, curl_off_t, curl_off_t, curl_off_t) {
    return static_cast<HttpRequest*>(of)->is_abandoned_.load(std::memory_order_relaxed) ? 1 : 0;
  }

  const HttpSensorConfig config_;
  const detail::HttpUrl url_;
  const std::vector<std::string> secrets_;
  detail::LineDecoder decoder_;
  std::atomic<bool> is_abandoned_{false};
  CURL* easy_ = nullptr;
  curl_slist* headers_ = nullptr;
  detail::HttpText answer_{.most_kept = config_.max_answer, .longest = config_.max_answer};
  std::string etag_;      // of the last answer whose value was published
  std::string new_etag_;  // of this one
  char error_text_[CURL_ERROR_SIZE] = "";
  Ended ended_ = Ended::failed;
  std::optional<Error> error_;
};

class HttpDevice final : public detail::LaneDevice {
 public:
  HttpDevice(HttpSensorConfig config, bool is_required)
      : config_(std::move(config)),
        origin_(detail::parse_http_url(config_.server.url).or_throw().origin),
        is_required_(is_required) {}

  std::shared_ptr<detail::Transaction> make_opening() override { return is_required_ ? make_transaction() : nullptr; }
  Result<void> take_opening(detail::Transaction& opening) override {
    const auto& request = static_cast<HttpRequest&>(opening);
    const bool has_failed = request.ended() == HttpRequest::Ended::failed ||
                            request.ended() == HttpRequest::Ended::unreadable;
    if (has_failed) return request.error();
    return {};
  }
  std::shared_ptr<detail::Transaction> make_transaction() override {
    auto request = std::make_shared<HttpRequest>(config_);
    current_ = request;
    return request;
  }
  detail::Sampled decode(detail::Transaction& transaction, detail::SamplePort& port) override {
    auto& request = static_cast<HttpRequest&>(transaction);
    switch (request.ended()) {
      case HttpRequest::Ended::value:
        if (detail::SensorNode::is_published(port, request.payload())) request.keep_etag();
        return detail::Sampled::value;
      case HttpRequest::Ended::unchanged:
        return detail::Sampled::nothing_new;
      case HttpRequest::Ended::left_out:
        detail::SensorNode::leave_out(port);
        return detail::Sampled::value;
      case HttpRequest::Ended::unreadable:
        return port.unreadable(request.error());
      default:
        return port.fail(request.error());
    }
  }
  std::string lane_key() const override { return "http " + origin_; }
  Duration give_up_after() const override { return config_.timeout + spare; }
  ReadTime read_time() const override { return rtdata::read_time(config_); }
  Error given_up_error() const override {
    return {Errc::timed_out, cannot_ask, origin_,
            "it took longer than " + to_string(config_.timeout) +
                ": the name servers do not answer, or the machine is too busy",
            "check the host name, or use an IP address"};
  }
  std::uint64_t stopped(MonotonicTime) override {
    if (const auto request = current_.lock()) request->abandon();
    return 0;
  }

 private:
  const HttpSensorConfig config_;
  const std::string origin_;
  const bool is_required_;
  std::weak_ptr<HttpRequest> current_;
};

}  // namespace

void check_config(const HttpSensorConfig& config, const ConfigItem& item, Problems& problems) {
  if (!detail::add_not_installed(detail::load_curl(), item, problems)) return;
  detail::add_mistakes(mistakes_of(config), item, problems);
  detail::check_lines_of(as_lines(config), detail::FrameCutter::Stream::of_one, item, problems);
}

ReadTime read_time(const HttpSensorConfig& config) {
  const auto url = detail::parse_http_url(config.server.url);
  return {.on_loop = detail::lane_read_on_loop, .on_lane = {}, .lane = "http " + (url ? url->origin : "")};
}

HttpSensor::HttpSensor(Loop& loop, SensorConfig sensor, HttpSensorConfig config) {
  detail::need_curl();
  for (const detail::SettingMistake& mistake : mistakes_of(config)) throw mistake.error(cannot_ask);
  detail::PayloadType type = detail::described_type(decoder_of(config).description());
  const bool is_required = sensor.required;
  *this = HttpSensor(detail::make_sensor(loop, std::move(sensor), std::move(type),
                                         std::make_unique<HttpDevice>(std::move(config), is_required)));
}

}  // namespace rtdata
