#include "sinks/http/http_sender.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <limits>

#include "data/fnv.hpp"
#include "data/hidden.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "net/libz.hpp"

namespace rtdata::detail {
namespace {

constexpr Duration name_age = std::chrono::seconds{60};  // then the name is looked up again
constexpr int most_redirects = 3;
constexpr int most_cut_answers = 4;  // to a request, until it counts as delivered
constexpr Duration longest_compression = std::chrono::seconds{30};

std::string type_of(const HttpConfig& config, const Codec& codec) {
  const bool is_one = config.sending.parcel_rows == 1;
  if (!config.content_type.empty()) return config.content_type;
  if (config.format == "json") return "application/json";
  if (config.format == "jsonl") return "application/x-ndjson";
  if (config.format == "cbor") return is_one ? "application/cbor" : "application/cbor-seq";
  return codec.is_text() ? "text/plain; charset=utf-8" : "application/octet-stream";
}

std::uint64_t mixed(std::uint64_t x) noexcept {
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9;
  x = (x ^ (x >> 27)) * 0x94d049bb133111eb;
  return x ^ (x >> 31);
}

std::uint64_t mixed(std::uint64_t x, std::string_view text) noexcept { return mixed(fnv1a(text, x) ^ text.size()); }

/// As CURLOPT_RESOLVE needs it; empty when it is neither IPv4 nor IPv6.
std::string text_of(const HostLookup::Address& address) {
  char text[INET6_ADDRSTRLEN] = "";
  if (address.socket.ss_family == AF_INET) {
    in_addr number{};
    std::memcpy(&number, reinterpret_cast<const char*>(&address.socket) + offsetof(sockaddr_in, sin_addr),
                sizeof number);
    return ::inet_ntop(AF_INET, &number, text, sizeof text) != nullptr ? text : "";
  }
  if (address.socket.ss_family != AF_INET6) return "";
  in6_addr number{};
  std::memcpy(&number, reinterpret_cast<const char*>(&address.socket) + offsetof(sockaddr_in6, sin6_addr),
              sizeof number);
  return ::inet_ntop(AF_INET6, &number, text, sizeof text) != nullptr ? "[" + std::string(text) + "]" : "";
}

bool is_number(const std::string& host) {
  in6_addr number{};
  return ::inet_pton(AF_INET, host.c_str(), &number) == 1 || ::inet_pton(AF_INET6, host.c_str(), &number) == 1;
}

HttpUrl checked_url(const HttpConfig& config) {
  need_curl();
  if (config.compression == HttpCompression::gzip) libz.load().or_throw();
  for (const SettingMistake& mistake : mistakes_of(config)) throw mistake.error("cannot send by HTTP");
  return parse_http_url(config.server.url).or_throw();
}

}  // namespace

HttpKey key_of(const Parcel& parcel, std::size_t first, std::size_t last) {
  HttpKey key{0x9e3779b97f4a7c15, 0xd1b54a32d192ed03};
  const SlotInfo* info = nullptr;
  std::uint64_t source = 0;
  for (std::size_t i = first; i < last; ++i) {
    const Parcel::Row& row = parcel.rows()[i];
    if (row.info != info) {
      info = row.info;
      source = mixed(mixed(0xcbf29ce484222325, info->run), info->origin);
    }
    key[0] = mixed(key[0] + (source ^ mixed(row.sequence)));
    key[1] = mixed(key[1] ^ (source + 0x9e3779b97f4a7c15 * row.sequence));
  }
  return key;
}

/// Compresses the body of one request. Used again and again.
class HttpSender::GzipJob final : public LaneJob {
 public:
  GzipJob(HttpSender& sender, Request& request) : owner(&sender), request_(&request) {}
  ~GzipJob() override {
    if (is_ready_) deflateEnd(&stream_);
  }
  void run() noexcept override {
    constexpr int window_of_gzip = 15 + 16, memory = 8;
    try {
      is_good = false;
      if (!is_ready_ &&
          deflateInit2(&stream_, Z_DEFAULT_COMPRESSION, Z_DEFLATED, window_of_gzip, memory, Z_DEFAULT_STRATEGY) != Z_OK)
        return;
      if (std::exchange(is_ready_, true)) deflateReset(&stream_);
      if (in.size() > std::numeric_limits<uInt>::max() / 2) return;
      out.resize(deflateBound(&stream_, static_cast<uLong>(in.size())));
      stream_.next_in = reinterpret_cast<Bytef*>(in.data());
      stream_.avail_in = static_cast<uInt>(in.size());
      stream_.next_out = reinterpret_cast<Bytef*>(out.data());
      stream_.avail_out = static_cast<uInt>(out.size());
      is_good = deflate(&stream_, Z_FINISH) == Z_STREAM_END;
      out.resize(out.size() - stream_.avail_out);
    } catch (...) {
      is_good = false;
    }
  }
  void done(Outcome outcome) override;

  HttpSender* owner;  // null: nobody waits for it any more. The loop's thread
  std::string in, out;
  bool is_good = false;

 private:
  Request* const request_;
  z_stream stream_{};
  bool is_ready_ = false;
};

struct HttpSender::Request {
  Request() = default;
  Request(const Request&) = delete;
  Request& operator=(const Request&) = delete;
  ~Request() { curl_easy_cleanup(easy); }

  CURL* easy = nullptr;
  State state = State::idle;
  const Parcel* parcel = nullptr;
  Answer answer;
  HttpKey key{};  // of the parcel
  Rest rest;
  bool has_answers = false;  // to a part of the parcel
  MonotonicTime began{};     // of the parcel
  MonotonicTime deadline{};  // of this request
  int redirects = 0;
  std::string body;                  // where it is not the parcel's bytes as they are
  std::span<const std::byte> bytes;  // that are sent
  std::string idempotency;
  curl_slist first{};                  // of the headers
  std::uint64_t addresses_number = 0;  // those that libcurl has
  std::string addresses;
  curl_slist resolve{};
  bool has_own_url = false;  // after a redirection
  HttpText answered;
  std::shared_ptr<GzipJob> gzip;
  char error[CURL_ERROR_SIZE] = "";
};

void HttpSender::GzipJob::done(Outcome outcome) {
  if (owner == nullptr) return;
  HttpSender& sender = *owner;
  Request& request = *request_;
  if (outcome == Outcome::finished && is_good) {
    request.bytes = std::as_bytes(std::span(out));
    return sender.start_transfer(request);
  }
  if (outcome != Outcome::finished) owner = nullptr;  // the job may still run
  if (outcome != Outcome::finished) request.gzip = nullptr;
  sender.give_up(request,
                 {HttpVerdict::later,
                  {Errc::io_failed, "cannot compress", sender.url_.origin, "there is no memory, or no time", ""},
                  {}});
}

HttpSender::HttpSender(HttpConfig config, std::unique_ptr<Codec> codec)
    : config_(std::move(config)), codec_(std::move(codec)), url_(checked_url(config_)) {
  if (!config_.server.proxy.empty()) proxy_ = parse_http_url(config_.server.proxy).or_throw();
  is_array_ = config_.format == "json" && config_.sending.parcel_rows > 1;
  secrets_ = secrets_of(config_.server);
  append_headers(headers_, config_.server, type_of(config_, *codec_));
  if (config_.compression == HttpCompression::gzip) append(headers_, "Content-Encoding: gzip");
}

HttpSender::~HttpSender() {
  end();
  curl_slist_free_all(headers_);
}

SendingConfig HttpSender::sending() const {
  constexpr Duration spare = std::chrono::seconds{5};  // each request has its own limit; this one is for none
  SendingConfig sending = config_.sending;
  sending.timeout += spare;
  return sending;
}

void HttpSender::begin(Loop& loop) {
  loop_ = &loop;
  const std::string name = "sink " + config_.sink.name;
  const bool is_encrypted = url_.is_encrypted() || (proxy_ && proxy_->is_encrypted());
  multi_ = std::make_unique<CurlMulti>(
      loop, CurlMulti::Config{name, config_.sending.window, is_encrypted && curl_may_raise_sigpipe()},
      [this](CURL* easy, CURLcode result) { transferred(easy, result); });
  deadline_ = Timer(loop, Timer::Config{name}, [this] { deadline(); });
  if (!is_number((proxy_ ? *proxy_ : url_).host)) {
    lookup_ = std::make_unique<HostLookup>(
        loop.core(), name, [this](const Result<std::vector<HostLookup::Address>>& found) { looked_up(found); });
  }
  if (config_.compression == HttpCompression::gzip)
    gzip_lane_ = std::make_unique<Lane>(loop.core(), "compression of " + name, longest_compression);
}

Result<void> HttpSender::encode(const Record& record, std::vector<std::byte>& out) {
  auto encoded = codec_->encode(record.keyed_view(), out);
  // The elements of an array: a comma after each, of which the last one is left out.
  if (encoded && is_array_ && !out.empty() && out.back() == std::byte{'\n'}) out.back() = std::byte{','};
  return encoded;
}

HttpSender::Request& HttpSender::free_request() {
  for (const auto& request : requests_)
    if (request->state == State::idle) return *request;
  auto request = std::make_unique<Request>();
  make_easy(*request);
  return *requests_.emplace_back(std::move(request));
}

void HttpSender::make_easy(Request& request) {
  request.easy = curl_easy_init();
  if (request.easy == nullptr) throw std::bad_alloc();
  const auto set = [&](CURLoption option, auto value) { curl_easy_setopt(request.easy, option, value); };
  multi_->prepare(request.easy);
  set(CURLOPT_PRIVATE, &request);
  set_server(request.easy, config_.server, url_);
  set(CURLOPT_POST, 1L);
  if (config_.method == HttpMethod::put) set(CURLOPT_CUSTOMREQUEST, "PUT");
  request.first.next = headers_;
  set(CURLOPT_HTTPHEADER, &request.first);
  set(CURLOPT_ERRORBUFFER, request.error);
  set(CURLOPT_CONNECTTIMEOUT_MS, 0x7fffffffL);  // each request has a limit of ours, which is the loop's time
  set(CURLOPT_TCP_KEEPALIVE, 1L);
  set(CURLOPT_TCP_KEEPIDLE, 30L);
  set(CURLOPT_TCP_KEEPINTVL, 10L);
  set(CURLOPT_WRITEDATA, &request.answered);
  set(CURLOPT_WRITEFUNCTION, &HttpText::take);
}

void HttpSender::send(const Parcel& parcel, Answer answer) {
  Request& request = free_request();
  request.parcel = &parcel;
  request.answer = std::move(answer);
  request.key = key_of(parcel, 0, parcel.rows().size());
  request.began = loop_->now();
  request.redirects = 0;
  request.has_answers = false;
  request.rest = {};
  const auto known = std::find_if(rests_.begin(), rests_.end(),
                                  [&](const auto& rest) { return rest.first == request.key; });
  if (known != rests_.end()) {  // it continues where it was
    request.rest = std::move(known->second);
    request.has_answers = true;
    rests_.erase(known);
  } else {
    request.rest.ranges.push_back({0, parcel.rows().size()});
  }
  start(request);
}

void HttpSender::start(Request& request) {
  if (request.rest.ranges.empty()) return complete(request);
  const Range range = request.rest.ranges.back();
  const std::span<const std::byte> bytes = request.parcel->bytes(range.first, range.last);
  const HttpKey key = range.first == 0 && range.last == request.parcel->rows().size()
                          ? request.key
                          : key_of(*request.parcel, range.first, range.last);
  char text[64];
  std::snprintf(text, sizeof text, "Idempotency-Key: \"%016llx%016llx\"", static_cast<unsigned long long>(key[0]),
                static_cast<unsigned long long>(key[1]));
  request.idempotency = text;
  request.first.data = request.idempotency.data();
  request.deadline = later(loop_->now(), config_.sending.timeout);
  const auto put_body = [&](std::string& body) {
    body.clear();
    body.reserve(bytes.size() + 1);
    if (is_array_) body += '[';
    body.append(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    if (is_array_) body.back() = ']';
  };
  if (gzip_lane_ != nullptr) {
    request.state = State::compressing;
    if (request.gzip == nullptr) request.gzip = std::make_shared<GzipJob>(*this, request);
    put_body(request.gzip->in);
    watch_deadlines();
    if (!gzip_lane_->submit(request.gzip))
      give_up(request,
              {HttpVerdict::later, {Errc::io_failed, "cannot compress", url_.origin, "there is no thread", ""}, {}});
    return;
  }
  request.bytes = bytes;
  if (is_array_) {
    put_body(request.body);
    request.bytes = std::as_bytes(std::span(request.body));
  }
  start_transfer(request);
}

void HttpSender::start_transfer(Request& request) {
  if (lookup_ == nullptr) return transfer(request);
  if (addresses_.empty()) {
    request.state = State::waiting;
    watch_deadlines();
    if (!lookup_->is_under_way()) look_up();
    return;
  }
  if (loop_->now() - looked_up_at_ > name_age && !lookup_->is_under_way()) {
    looked_up_at_ = loop_->now();
    look_up();  // what is known serves until there is news
  }
  transfer(request);
}

void HttpSender::look_up() {
  const HttpUrl& peer = proxy_ ? *proxy_ : url_;
  lookup_->start(peer.host, peer.port);
}

void HttpSender::looked_up(const Result<std::vector<HostLookup::Address>>& found) {
  const HttpUrl& peer = proxy_ ? *proxy_ : url_;
  looked_up_at_ = loop_->now();
  const std::string why = found ? "it has no address of IPv4 or IPv6" : found.error().why;
  std::string list;
  for (const HostLookup::Address& address : found ? *found : std::vector<HostLookup::Address>{})
    if (const std::string text = text_of(address); !text.empty()) list += (list.empty() ? "" : ",") + text;
  if (!list.empty()) list.insert(0, peer.host + ":" + std::to_string(peer.port) + ":");
  if (!list.empty() && list != addresses_) {
    addresses_ = std::move(list);
    ++addresses_number_;
  }
  const std::shared_ptr<bool> alive = is_alive_;
  for (std::size_t i = 0; i < requests_.size(); ++i) {
    Request& request = *requests_[i];
    if (request.state != State::waiting) continue;
    if (!addresses_.empty()) {
      transfer(request);
    } else {
      give_up(request, {HttpVerdict::later,
                        {Errc::not_found, "cannot send", peer.origin, why, "check the host name, or use an IP address"},
                        {}});
    }
    if (!*alive || multi_ == nullptr) return;
  }
}

void HttpSender::transfer(Request& request) {
  if (request.addresses_number != addresses_number_) {
    request.addresses_number = addresses_number_;
    request.addresses = addresses_;
    request.resolve.data = request.addresses.data();
    curl_easy_setopt(request.easy, CURLOPT_RESOLVE, &request.resolve);
  } else if (request.resolve.data != nullptr) {  // libcurl keeps them
    request.resolve.data = nullptr;
    curl_easy_setopt(request.easy, CURLOPT_RESOLVE, nullptr);
  }
  curl_easy_setopt(request.easy, CURLOPT_POSTFIELDS, request.bytes.data());
  curl_easy_setopt(request.easy, CURLOPT_POSTFIELDSIZE_LARGE, static_cast<curl_off_t>(request.bytes.size()));
  if (request.redirects == 0 && request.has_own_url) {
    request.has_own_url = false;
    curl_easy_setopt(request.easy, CURLOPT_URL, config_.server.url.c_str());
  }
  request.answered.text.clear();
  request.answered.size = 0;
  request.error[0] = '\0';
  request.state = State::transferring;
  watch_deadlines();
  if (multi_->add(request.easy)) return;
  give_up(request, {HttpVerdict::later,
                    {Errc::io_failed, "cannot send", url_.origin, "libcurl does not accept the request", ""},
                    {}});
}

void HttpSender::transferred(CURL* easy, CURLcode result) {
  char* owner = nullptr;
  curl_easy_getinfo(easy, CURLINFO_PRIVATE, &owner);
  Request& request = *reinterpret_cast<Request*>(owner);
  request.state = State::waiting;  // not libcurl's any more
  HttpAnswer answer;
  curl_easy_getinfo(easy, CURLINFO_RESPONSE_CODE, &answer.status);
  // A server that refuses a request may close the connection before it has read it.
  if (result == CURLE_OK || answer.status >= 400) {
    curl_off_t seconds = 0;
    curl_easy_getinfo(easy, CURLINFO_RETRY_AFTER, &seconds);
    answer.retry_after = std::chrono::seconds{std::min<curl_off_t>(seconds, 86400)};
    char* redirect = nullptr;
    curl_easy_getinfo(easy, CURLINFO_REDIRECT_URL, &redirect);
    if (redirect != nullptr) answer.redirect = redirect;
    // As a whole: the line that is shown may end within one.
    request.answered.text = hidden(std::move(request.answered.text), secrets_);
    answer.text = request.answered.text;
    HttpJudgement judgement = judge(answer, url_.origin);
    if (judgement.verdict == HttpVerdict::elsewhere && ++request.redirects <= most_redirects) {
      request.has_own_url = true;
      curl_easy_setopt(easy, CURLOPT_URL, answer.redirect.c_str());
      return transfer(request);
    }
    if (judgement.verdict == HttpVerdict::elsewhere) {
      judgement.verdict = HttpVerdict::faulted;
      judgement.why.advice = "the server redirects the request in a circle: ask its operator";
    }
    request.redirects = 0;
    return take(request, std::move(judgement));
  }
  if (is_cut_answer(request, result, answer.status)) {
    request.has_answers = true;  // remembered for the next request
    if (++request.rest.cut_answers >= most_cut_answers && config_.cut_answer == HttpCutAnswer::delivered) {
      count_cut_answer(request);
      request.redirects = 0;
      return take(request, {});
    }
  }
  const HttpFailure failure = failure_of(easy, result, request.error);
  if (result == CURLE_COULDNT_CONNECT) addresses_.clear();  // the server may have moved
  request.redirects = 0;
  take(request, judge(failure, url_.origin, proxy_ ? proxy_->origin : ""));
}

/// True if the whole request was sent, and the success answer of the server was cut off.
bool HttpSender::is_cut_answer(const Request& request, CURLcode result, long status) const {
  curl_off_t sent = 0;
  curl_easy_getinfo(request.easy, CURLINFO_SIZE_UPLOAD_T, &sent);
  const bool is_cut = result == CURLE_PARTIAL_FILE || result == CURLE_RECV_ERROR || result == CURLE_GOT_NOTHING ||
                      result == CURLE_HTTP2_STREAM || result == CURLE_HTTP2;
  return is_cut && status >= 200 && status < 300 && static_cast<std::size_t>(sent) == request.bytes.size();
}

void HttpSender::count_cut_answer(const Request& request) {
  const Range range = request.rest.ranges.back();
  const bool is_first = cut_ == 0;
  cut_ += range.last - range.first;
  if (!is_first) return;
  loop_->core().runtime.log(LogLevel::warning, "sink " + config_.sink.name,
                            url_.origin + " accepted a request, but cut off its answer " +
                                std::to_string(most_cut_answers) +
                                " times: the events count as delivered (total at the end of the run). Check the "
                                "server's log, or set `cut_answer`");
}

void HttpSender::take(Request& request, HttpJudgement judgement) {
  const Range range = request.rest.ranges.back();
  if (judgement.verdict == HttpVerdict::later || judgement.verdict == HttpVerdict::faulted)
    return give_up(request, std::move(judgement));
  request.has_answers = true;
  request.rest.cut_answers = 0;
  request.rest.ranges.pop_back();
  if (judgement.verdict != HttpVerdict::taken) {
    if (range.last - range.first == 1) {
      request.rest.refused.emplace_back(range.first, shown(std::move(judgement.why)));
    } else {
      const std::size_t middle = range.first + (range.last - range.first) / 2;
      request.rest.ranges.push_back({middle, range.last});
      request.rest.ranges.push_back({range.first, middle});
    }
  }
  if (!request.rest.ranges.empty() && loop_->now() - request.began > config_.sending.timeout) {
    return give_up(request,
                   {HttpVerdict::later,
                    {Errc::timed_out, "cannot send", url_.origin,
                     "sending the events of a parcel one by one took longer than " + to_string(config_.sending.timeout),
                     "the remaining events are sent later; delivered ones are not sent again"},
                    Duration{0}});
  }
  start(request);
}

void HttpSender::complete(Request& request) {
  Answer answer = std::move(request.answer);
  const Refusals refused = std::move(request.rest.refused);
  request.state = State::idle;
  request.parcel = nullptr;
  for (const auto& [row, why] : refused) answer.refuse(row, why);
  answer.acknowledge();
}

void HttpSender::give_up(Request& request, HttpJudgement judgement) {
  std::optional<Duration> after = judgement.after;
  if (judgement.verdict == HttpVerdict::faulted && !after) after = config_.sink.retry_longest;
  Answer answer = std::move(request.answer);
  stop(request);
  answer.again(shown(std::move(judgement.why)), after);
}

void HttpSender::stop(Request& request) {
  if (request.state == State::idle) return;
  if (request.state == State::transferring) multi_->remove(request.easy);
  if (request.state == State::compressing && request.gzip != nullptr) {
    request.gzip->owner = nullptr;
    request.gzip = nullptr;
  }
  request.state = State::idle;
  request.parcel = nullptr;
  if (!request.has_answers) return;
  if (rests_.size() >= config_.sending.window) rests_.erase(rests_.begin());
  rests_.emplace_back(request.key, std::move(request.rest));
}

void HttpSender::watch_deadlines() {
  if (!deadline_.is_running()) deadline_.start(config_.sending.timeout);
}

void HttpSender::deadline() {
  const MonotonicTime now = loop_->now();
  const std::shared_ptr<bool> alive = is_alive_;
  for (std::size_t i = 0; i < requests_.size(); ++i) {
    Request& request = *requests_[i];
    if (request.state == State::idle || request.deadline > now) continue;
    if (!has_connected(request)) addresses_.clear();
    give_up(request, {HttpVerdict::later, where_it_stands(request), {}});
    if (!*alive || multi_ == nullptr) return;
  }
  MonotonicTime next = MonotonicTime::max();
  for (const auto& request : requests_)
    if (request->state != State::idle) next = std::min(next, request->deadline);
  if (next != MonotonicTime::max()) deadline_.start_at(next);
}

bool HttpSender::has_connected(const Request& request) {
  curl_off_t connected = 0;
  return request.state == State::transferring &&
         curl_easy_getinfo(request.easy, CURLINFO_CONNECT_TIME_T, &connected) == CURLE_OK && connected > 0;
}

Error HttpSender::where_it_stands(const Request& request) const {
  Error error{Errc::timed_out, "cannot send", url_.origin, "", ""};
  const std::string limit = " in " + to_string(config_.sending.timeout);
  const std::string& first = (proxy_ ? *proxy_ : url_).origin;
  curl_off_t encrypted = 0;
  if (request.state == State::compressing) {
    error.why = "the events were not compressed" + limit;
    error.advice = "check the load of this computer";
  } else if (request.state == State::waiting) {
    error.where = first;
    error.why = "the name was not looked up" + limit;
    error.advice = "check the name servers, or use an IP address";
  } else if (!has_connected(request)) {
    error.where = first;
    error.why = "there was no connection" + limit;
    error.advice = "check that the server is on and that the network reaches it; a firewall may drop the packets";
  } else if (url_.is_encrypted() &&
             (curl_easy_getinfo(request.easy, CURLINFO_APPCONNECT_TIME_T, &encrypted) != CURLE_OK || encrypted == 0)) {
    error.why = "the connection was not encrypted" + limit;
    error.advice = "check that the server uses TLS at this port";
  } else {
    error.why = "there was no answer" + limit;
    error.advice = "the server accepts connections but does not answer: see its log, or set a longer `timeout`";
  }
  return error;
}

Error HttpSender::shown(Error error) const {
  error.why = hidden(std::move(error.why), secrets_);
  return error;
}

void HttpSender::cancel() {
  for (const auto& request : requests_) {
    if (request->state == State::idle) continue;
    const Answer ignored = std::move(request->answer);
    stop(*request);
  }
}

void HttpSender::end() {
  if (loop_ == nullptr) return;
  *is_alive_ = false;
  if (cut_ > 0)
    loop_->core().runtime.log(
        LogLevel::warning, "sink " + config_.sink.name,
        std::to_string(cut_) + (cut_ == 1 ? " event counts as delivered though its answer was cut off"
                                          : " events count as delivered though their answers were cut off"));
  for (const auto& request : requests_) {
    request->has_answers = false;
    stop(*request);
  }
  deadline_.close();
  lookup_ = nullptr;
  if (gzip_lane_ != nullptr) gzip_lane_->abandon_thread();
  gzip_lane_ = nullptr;
  requests_.clear();
  multi_ = nullptr;
  loop_ = nullptr;
}

}  // namespace rtdata::detail
