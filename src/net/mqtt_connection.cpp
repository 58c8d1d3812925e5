#include "net/mqtt_connection.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <mqtt_protocol.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <iterator>
#include <mutex>
#include <system_error>

#include "io/no_sigpipe.hpp"
#include "loop/core/loop_core.hpp"
#include "net/host_lookup.hpp"
#include "net/tls_mistakes.hpp"
#include "net/tls_session.hpp"

namespace rtdata::detail {
namespace {

constexpr Duration upkeep = std::chrono::milliseconds{500};

MqttClient& of(void* client) noexcept { return *static_cast<MqttClient*>(client); }

extern "C" {
static void on_connect(mosquitto*, void* client, int reason, int, const mosquitto_property*) {
  of(client).answer = reason;
}
static void on_disconnect(mosquitto*, void* client, int reason, const mosquitto_property*) {
  of(client).goodbye = reason;
}
static void on_publish(mosquitto*, void* client, int number, int reason, const mosquitto_property*) {
  of(client).published.emplace_back(number, reason);
}
static void on_subscribe(mosquitto*, void* client, int, int count, const int* granted, const mosquitto_property*) {
  of(client).granted.emplace(granted, granted + count);
}
static void on_message(mosquitto*, void* client, const mosquitto_message* message, const mosquitto_property*) {
  MqttClient& to = of(client);
  if (to.arrived == to.messages.size()) to.messages.emplace_back();
  MqttClient::Message& copy = to.messages[to.arrived++];
  copy.topic = message->topic;
  const std::size_t length = std::min(static_cast<std::size_t>(std::max(message->payloadlen, 0)),
                                      to.longest_message + 1);
  copy.payload.assign(length != 0 ? static_cast<const char*>(message->payload) : "", length);
  copy.is_retained = message->retain;
}
/// Without it, OpenSSL would ask at the terminal.
static int password_of_key(char* to, int size, int, void* handle) {
  const std::string& password = of(mosquitto_userdata(static_cast<mosquitto*>(handle))).key_password;
  if (password.size() > static_cast<std::size_t>(size)) return -1;
  password.copy(to, password.size());
  return static_cast<int>(password.size());
}
/// Only here the library tells which check failed; afterwards its TLS session no longer exists.
static void on_log(mosquitto* handle, void* client, int level, const char* text) {
  if (level != MOSQ_LOG_ERR) return;
  MqttClient& to = of(client);
  to.trouble = text;
  if (!to.verifies || to.distrust != 0) return;
  // It compares the name itself.
  const bool is_other_name = std::string_view(text).find("host name verification failed") != std::string_view::npos;
  to.distrust = is_other_name ? other_host_name : verify_result_of(mosquitto_ssl_get(handle));
}
}

const char* or_null(const std::string& text) { return text.empty() ? nullptr : text.c_str(); }

/// libmosquitto sets up its TLS in the first connection that uses it, without a lock: two connections at once would
/// leak, and one of them could refuse a certificate that is good. A connection to a socket of our own that answers
/// nothing does it beforehand.
void initialize_tls() {
  const int listening = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  const auto generic = reinterpret_cast<sockaddr*>(&address);
  mosquitto* const handle = mosquitto_new(nullptr, true, nullptr);
  if (handle != nullptr && ::bind(listening, generic, size) == 0 && ::listen(listening, 1) == 0 &&
      ::getsockname(listening, generic, &size) == 0) {
    mosquitto_int_option(handle, MOSQ_OPT_TLS_USE_OS_CERTS, 1);
    mosquitto_connect(handle, "127.0.0.1", ntohs(address.sin_port), 60);
  }
  mosquitto_destroy(handle);
  if (listening >= 0) ::close(listening);
}

/// True if the peer has closed or reset it and all data was read.
bool has_ended(int socket) noexcept {
  char byte = 0;
  const ssize_t got = ::recv(socket, &byte, 1, MSG_PEEK | MSG_DONTWAIT);
  return got == 0 || (got < 0 && errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR);
}

}  // namespace

MqttClient::~MqttClient() {
  const NoSigpipe guard;
  if (handle != nullptr) mosquitto_destroy(handle);
}

std::string MqttClient::reason(int status) const {
  if (status == MOSQ_ERR_TLS && distrust != 0) return "certificate verify failed: " + text_of_verify_result(distrust);
  std::string text = status == MOSQ_ERR_ERRNO ? std::generic_category().message(errno) : mosquitto_strerror(status);
  while (text.ends_with('.')) text.pop_back();
  return trouble.empty() ? text : text + " (" + trouble + ")";
}

Error MqttClient::failure(int status, bool is_connected) const {
  Error error{Errc::disconnected, is_connected ? "lost the connection" : "cannot connect", "", reason(status),
              "the program connects to it again"};
  if (status == MOSQ_ERR_TLS && distrust != 0) {
    error.code = Errc::not_permitted;
    error.advice = advice_on_certificate(distrust, "host");
  } else if ((status == MOSQ_ERR_TLS || (status == MOSQ_ERR_CONN_LOST && is_encrypted)) && !is_connected) {
    error.advice =
        "check that the broker speaks TLS at this port; it may also need a client certificate (`tls.certificate`), or "
        "not trust that";
  } else if (status == MOSQ_ERR_CONN_LOST && !is_connected) {
    error.advice = "the program connects to it again; if the broker speaks TLS at this port, set `tls`";
  }
  return error;
}

std::uint16_t port_of(const MqttBroker& broker) noexcept {
  return broker.port != 0 ? broker.port : static_cast<std::uint16_t>(broker.tls ? 8883 : 1883);
}

int connect_client(MqttClient& client, const MqttBroker& broker, const MqttOptions& options, bool is_v5) {
  static std::once_flag once;
  std::call_once(once, [] { mosquitto_lib_init(); });
  static std::once_flag once_with_tls;
  if (broker.tls) std::call_once(once_with_tls, initialize_tls);
  errno = 0;
  const bool is_new_session = options.session <= Duration{0};
  mosquitto* const handle = mosquitto_new(or_null(broker.client_id), is_new_session, &client);
  if (handle == nullptr) return errno == ENOMEM ? MOSQ_ERR_NOMEM : MOSQ_ERR_INVAL;
  client.handle = handle;
  mosquitto_connect_v5_callback_set(handle, on_connect);
  mosquitto_disconnect_v5_callback_set(handle, on_disconnect);
  mosquitto_publish_v5_callback_set(handle, on_publish);
  mosquitto_subscribe_v5_callback_set(handle, on_subscribe);
  mosquitto_message_v5_callback_set(handle, on_message);
  mosquitto_log_callback_set(handle, on_log);
  mosquitto_int_option(handle, MOSQ_OPT_PROTOCOL_VERSION, is_v5 ? MQTT_PROTOCOL_V5 : MQTT_PROTOCOL_V311);
  // A broker of version 5 gives its limit; for 3.1.1 the library's usual 20 is used.
  if (is_v5 && options.most_sent != 0) mosquitto_int_option(handle, MOSQ_OPT_SEND_MAXIMUM, options.most_sent);
  if (is_v5 && options.most_received != 0)
    mosquitto_int_option(handle, MOSQ_OPT_RECEIVE_MAXIMUM, options.most_received);
  mosquitto_int_option(handle, MOSQ_OPT_TCP_NODELAY, 1);
  // As for programs with threads, the library then queues its packets, and writes them only when it is told to.
  mosquitto_threaded_set(handle, true);
  client.longest_message = options.longest_message.value_or(0);
  client.inlet = std::make_unique<MqttInlet>(
      MqttInlet::Config{.expected = {.is_v5 = is_v5, .takes_messages = options.longest_message.has_value()},
                        .longest_message = client.longest_message,
                        .is_encrypted = broker.tls.has_value()});
  int done = MOSQ_ERR_SUCCESS;
  if (!broker.user.empty()) done = mosquitto_username_pw_set(handle, broker.user.c_str(), or_null(broker.password));
  if (done == MOSQ_ERR_SUCCESS && options.will) {
    const MqttOptions::Will& will = *options.will;
    done = mosquitto_will_set(handle, will.topic.c_str(), static_cast<int>(will.message.size()), will.message.data(),
                              will.qos, will.retain);
  }
  if (done == MOSQ_ERR_SUCCESS && broker.tls) {
    const TlsConfig& tls = *broker.tls;
    client.key_password = tls.key_password;
    client.is_encrypted = true;
    client.verifies = tls.verify;
    if (tls.ca_file.empty()) mosquitto_int_option(handle, MOSQ_OPT_TLS_USE_OS_CERTS, 1);
    if (!tls.ca_file.empty() || !tls.certificate.empty())
      done = mosquitto_tls_set(handle, or_null(tls.ca_file), tls.ca_file.empty() ? "/etc/ssl/certs" : nullptr,
                               or_null(tls.certificate), or_null(tls.key), password_of_key);
    if (done == MOSQ_ERR_INVAL) client.trouble = "a file of `tls` cannot be read";
    if (done == MOSQ_ERR_SUCCESS && !tls.verify) {
      constexpr int verify_none = 0;  // SSL_VERIFY_NONE
      done = mosquitto_tls_opts_set(handle, verify_none, nullptr, nullptr);
    }
  }
  if (done != MOSQ_ERR_SUCCESS) return done;
  mosquitto_property* properties = nullptr;
  if (is_v5 && !is_new_session) {
    const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(options.session).count();
    done = mosquitto_property_add_int32(&properties, MQTT_PROP_SESSION_EXPIRY_INTERVAL,
                                        static_cast<std::uint32_t>(std::clamp<std::int64_t>(seconds, 1, UINT32_MAX)));
  }
  if (done == MOSQ_ERR_SUCCESS) {
    const auto keepalive = std::chrono::duration_cast<std::chrono::seconds>(broker.keepalive).count();
    done = mosquitto_connect_bind_v5(handle, broker.host.c_str(), port_of(broker), static_cast<int>(keepalive), nullptr,
                                     properties);
  }
  mosquitto_property_free_all(&properties);
  return done;
}

std::string obstacle_of_topic(const std::string& topic) {
  if (topic.empty()) return "there is no topic";
  if (topic.find_first_of(std::string_view("+#\0", 3)) != std::string::npos)
    return "an MQTT topic to publish to cannot contain + or #";
  return topic.size() > 1000 ? "it is too long" : "";
}

std::vector<SettingMistake> mistakes_of(const MqttBroker& broker) {
  std::vector<SettingMistake> mistakes;
  const auto add = [&](const char* key, std::string why) { mistakes.push_back({key, std::move(why)}); };
  if (std::string why = obstacle_of_host(broker.host); !why.empty()) add("host", std::move(why));
  if (broker.tls) std::ranges::move(mistakes_of(*broker.tls), std::back_inserter(mistakes));
  constexpr std::size_t longest_text = 65535;  // MQTT 3.1.1 section 1.5.3, MQTT 5 section 1.5.4
  const auto is_control = [](char c) { return static_cast<unsigned char>(c) < ' ' || c == 0x7f; };
  for (const auto& [key, text] : {std::pair{"client_id", &broker.client_id}, std::pair{"user", &broker.user}}) {
    if (std::any_of(text->begin(), text->end(), is_control))
      add(key, "it has a control character, which brokers do not accept");
    if (text->size() > longest_text)
      add(key, "it has " + std::to_string(text->size()) + " bytes, but a text in MQTT has at most " +
                   std::to_string(longest_text));
  }
  if (broker.password.find('\0') != std::string::npos) add("password", "it contains a NUL byte, which would end it");
  if (broker.user.empty() && !broker.password.empty()) add("password", "`password` needs a `user`");
  return mistakes;
}

std::string topic_of_both(std::string_view one, std::string_view other) {
  const auto without_share = [](std::string_view filter) {
    constexpr std::string_view share = "$share/";
    if (!filter.starts_with(share)) return filter;
    return filter.substr(std::min(filter.find('/', share.size()), filter.size() - 1) + 1);
  };
  one = without_share(one);
  other = without_share(other);
  const auto is_wildcard = [](std::string_view level) { return level == "+" || level == "#"; };
  std::string topic;
  for (bool is_first = true, has_one = true, has_other = true;; is_first = false) {
    if (!has_one && !has_other) return topic;
    const auto next = [](std::string_view& filter, bool& has) {
      const std::size_t end = filter.find('/');
      const std::string_view level = filter.substr(0, end);
      has = end != std::string_view::npos;
      filter = has ? filter.substr(end + 1) : std::string_view();
      return level;
    };
    if (!has_one || !has_other) {  // "a/#" matches "a", too
      return next(has_one ? one : other, has_one ? has_one : has_other) == "#" ? topic : "";
    }
    const std::string_view a = next(one, has_one), b = next(other, has_other);
    // What begins with a wildcard does not match the broker's own topics.
    if (is_first && ((a.starts_with('$') && is_wildcard(b)) || (b.starts_with('$') && is_wildcard(a)))) return "";
    if (a != b && !is_wildcard(a) && !is_wildcard(b)) return "";
    if (a == "#" || b == "#") {  // the rest of the other filter is below it
      const std::string_view level = a == "#" ? b : a;
      const std::string_view rest = a == "#" ? other : one;
      topic += (is_first ? "" : "/") + std::string(is_wildcard(level) ? "x" : level);
      if (!rest.empty()) topic += "/" + std::string(rest);
      for (char& c : topic)
        if (is_wildcard({&c, 1})) c = 'x';
      return topic;
    }
    topic += (is_first ? "" : "/") + std::string(!is_wildcard(a) ? a : !is_wildcard(b) ? b : "x");
  }
}

bool is_older(int answer) noexcept {
  return answer == MQTT_RC_UNSUPPORTED_PROTOCOL_VERSION || answer == CONNACK_REFUSED_PROTOCOL_VERSION;
}

bool may_be_older(int status) noexcept {
  return status == MOSQ_ERR_CONN_LOST || status == MOSQ_ERR_PROTOCOL || status == MOSQ_ERR_MALFORMED_PACKET;
}

std::string refusal_of(int answer, bool is_v5) {
  return is_v5 ? mosquitto_reason_string(answer) : mosquitto_connack_string(answer);
}

/// Runs on a lane; everything else on the loop.
class MqttConnecting final : public LaneJob {
 public:
  MqttConnecting(const MqttBroker& broker, const MqttOptions& options, bool is_v5,
                 std::function<void(MqttConnecting&, Outcome)> ended)
      : client(std::make_shared<MqttClient>()),
        broker_(broker),
        options_(options),
        is_v5_(is_v5),
        ended_(std::move(ended)) {
    client->published.reserve(static_cast<std::size_t>(options.most_sent));
  }
  void run() noexcept override {
    try {
      const NoSigpipe guard;
      status = connect_client(*client, broker_, options_, is_v5_);
      if (status != MOSQ_ERR_SUCCESS) why = client->failure(status, false);
    } catch (...) {
      status = MOSQ_ERR_NOMEM;
    }
  }
  void done(Outcome outcome) override {
    if (const auto ended = std::exchange(ended_, nullptr)) ended(*this, outcome);
  }
  /// Stops waiting for it. The loop's thread.
  void forget() noexcept { ended_ = nullptr; }

  std::shared_ptr<MqttClient> client;
  int status = MOSQ_ERR_SUCCESS;
  Error why;

 private:
  const MqttBroker broker_;  // copies: the job may outlive its owner
  const MqttOptions options_;
  const bool is_v5_;
  std::function<void(MqttConnecting&, Outcome)> ended_;  // loop
};

MqttConnection::MqttConnection(Loop& loop, std::string name, const MqttBroker& broker, MqttOptions options)
    : broker_(broker),
      options_(std::move(options)),
      loop_(loop),
      name_(std::move(name)),
      is_v5_(broker.version != MqttVersion::v311),
      more_(loop, [this] { work(); }),
      upkeep_(loop, [this] { work(); }) {}

MqttConnection::~MqttConnection() {
  if (job_ != nullptr) job_->forget();
  if (watch_.is_open()) watch_.close();
  if (fd_ >= 0) ::close(fd_);
  end_lane();
}

std::string MqttConnection::peer() const { return broker_.host + " port " + std::to_string(port_of(broker_)); }

void MqttConnection::connect() {
  const auto self = shared_from_this();
  if (lane_ == nullptr) lane_ = std::make_unique<Lane>(loop_.core(), "connecting of " + name_, broker_.connect_timeout);
  const auto job = std::make_shared<MqttConnecting>(broker_, options_, is_v5_, [this](auto& ended, auto outcome) {
    const auto alive = shared_from_this();
    job_ = nullptr;
    connecting_ended(ended, outcome);
  });
  job_ = job;
  last_job_ = job;
  if (!lane_->submit(job) && job_ == job) {
    job_ = nullptr;
    fail(Errc::timed_out, "cannot connect", "no thread is free for connecting: earlier attempts still hang");
  }
}

void MqttConnection::connecting_ended(MqttConnecting& job, LaneJob::Outcome outcome) {
  if (outcome == LaneJob::Outcome::cancelled) return;
  if (outcome == LaneJob::Outcome::given_up)
    return fail(Errc::timed_out, "cannot connect", "no connection within " + to_string(broker_.connect_timeout));
  if (job.status != MOSQ_ERR_SUCCESS) return fail(std::move(job.why));
  client_ = std::move(job.client);
  // A descriptor of our own: the library closes its as it likes, and a watched one must not be closed.
  const int fd = ::fcntl(mosquitto_socket(client_->handle), F_DUPFD_CLOEXEC, 3);
  if (fd < 0) return fail(Errc::io_failed, "cannot connect", std::generic_category().message(errno));
  fd_ = fd;
  work();
}

void MqttConnection::watch() {
  const unsigned wanted = (may_read() ? FdWatch::readable : 0U) |
                          (may_write() && mosquitto_want_write(client_->handle) ? FdWatch::writable : 0U);
  if (std::exchange(watched_, wanted) == wanted) return;
  if (wanted == 0) {
    watch_.close();
  } else if (watch_.is_open()) {
    watch_.set_events(static_cast<FdWatch::Events>(wanted));
  } else {
    watch_ = FdWatch(loop_, fd_, static_cast<FdWatch::Events>(wanted), name_, [this](const FdEvent& event) {
      is_readable_ = is_readable_ || event.readable || event.hung_up;
      work();
    });
  }
}

void MqttConnection::work() {
  if (client_ == nullptr || std::exchange(is_working_, true)) return;
  const auto self = shared_from_this();
  std::size_t left = most_in_a_turn;
  while (client_ != nullptr) {
    if (!take_answer(call_library(left))) break;
    take();
    if (client_ == nullptr || left == 0 || !is_connected_ || !has_more()) break;
  }
  is_working_ = false;
  if (client_ == nullptr) return;
  watch();
  if (left == 0) more_.start(Duration{0});
  if (!upkeep_.is_running()) upkeep_.start(upkeep);
}

int MqttConnection::call_library(std::size_t& left) {
  std::optional<NoSigpipe> guard;
  if (broker_.tls) guard.emplace();  // without TLS the library writes without the signal
  errno = 0;
  int status = MOSQ_ERR_SUCCESS;
  const auto write = [&] {
    if (status == MOSQ_ERR_SUCCESS && may_write() && mosquitto_want_write(client_->handle))
      status = mosquitto_loop_write(client_->handle, 1);
  };
  // Writing comes first: what is read now may have to wait for its answers, which `take` says.
  write();
  if (status == MOSQ_ERR_SUCCESS && is_readable_ && may_read()) {
    bool is_empty = true;
    status = client_->inlet->read(*client_, fd_, left, is_empty);
    is_readable_ = status == MOSQ_ERR_SUCCESS && !is_empty;  // otherwise the watch reports it
  }
  // The library does not report a connection that is reset during the TLS handshake.
  const bool is_shaking_hands = broker_.tls && !is_connected_ && !client_->answer;
  if (status == MOSQ_ERR_SUCCESS && is_shaking_hands && has_ended(fd_)) status = MOSQ_ERR_CONN_LOST;
  if (status == MOSQ_ERR_SUCCESS) status = mosquitto_loop_misc(client_->handle);
  if (status == MOSQ_ERR_SUCCESS && is_connected_) {
    const std::size_t before = left;
    status = give(left);
    if (left != before) write();
  }
  return status;
}

/// False: the connection is over.
bool MqttConnection::take_answer(int status) {
  if (const auto answer = std::exchange(client_->answer, {})) {
    if (*answer == 0) {
      is_connected_ = true;
      // The library formats a log line for each message, which costs time, so the callback is removed without TLS.
      if (!broker_.tls) mosquitto_log_callback_set(client_->handle, nullptr);
      connected();
      if (client_ == nullptr) return false;
    } else {
      if (is_v5_ && broker_.version == MqttVersion::newest && is_older(*answer)) return try_older();
      const std::string why = refusal_of(*answer, is_v5_);
      fail(Errc::not_permitted, "the broker refuses the connection", why, "check `user`, `password` and `client_id`");
      return false;
    }
  }
  if (status == MOSQ_ERR_SUCCESS) return true;
  // Old brokers hang up on a version that they do not know.
  if (!is_connected_ && is_v5_ && broker_.version == MqttVersion::newest && may_be_older(status) &&
      !std::exchange(has_tried_older_, true))
    return try_older();
  if (!is_connected_ && broker_.version == MqttVersion::newest) is_v5_ = true;
  const auto goodbye = std::exchange(client_->goodbye, {});
  Error error = client_->failure(status, is_connected_);
  if (goodbye && *goodbye >= 0x80) error.why = mosquitto_reason_string(*goodbye);
  if (is_connected_) has_tried_older_ = false;
  fail(std::move(error));
  return false;
}

bool MqttConnection::try_older() {
  drop();
  is_v5_ = false;
  connect();
  return false;
}

void MqttConnection::fail(Errc code, const char* failed, std::string why, const char* advice) {
  fail({code, failed, "", std::move(why), advice});
}

void MqttConnection::fail(Error error) {
  error.where = peer();
  drop();
  lost(error);
}

void MqttConnection::drop() {
  if (const auto job = std::exchange(job_, nullptr)) job->forget();
  if (watch_.is_open()) watch_.close();
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
  client_ = nullptr;  // closes the socket
  is_connected_ = is_readable_ = false;
  watched_ = 0;
  more_.stop();
  upkeep_.stop();
  forget();
}

void MqttConnection::leave() {
  if (is_connected_) {
    const NoSigpipe guard;
    mosquitto_disconnect_v5(client_->handle, MQTT_RC_NORMAL_DISCONNECTION, nullptr);
    if (may_write()) mosquitto_loop_write(client_->handle, 1);
  }
  drop();
}

void MqttConnection::end() {
  leave();
  more_.close();
  upkeep_.close();
  end_lane();  // it must not outlive the loop
}

void MqttConnection::end_lane() noexcept {
  if (lane_ != nullptr && !last_job_.expired()) lane_->abandon_thread();  // does not wait for a silent server
  lane_ = nullptr;
}

}  // namespace rtdata::detail
