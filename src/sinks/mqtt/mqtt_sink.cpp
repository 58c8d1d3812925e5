#include "rtdata/sinks/mqtt.hpp"

#include <fcntl.h>
#include <mosquitto.h>
#include <mqtt_protocol.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "loop/core/loop_core.hpp"
#include "loop/support/no_sigpipe.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/loop/lane.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"
#include "sinks/core/peer_config.hpp"

namespace rtdata {
namespace {

constexpr const char* what = "cannot make mqtt sink";
constexpr std::size_t most_in_a_turn = 256;   // messages given to the library
constexpr std::size_t most_under_way = 1000;  // messages in it, which it may queue
constexpr std::size_t slot_count = 4096;      // by the lower bits of their numbers
constexpr unsigned last_number = 65535;
constexpr Duration upkeep = std::chrono::milliseconds{500};

/// A client of the library, for one connection: what the library still holds ends with that.
struct Client {
  mosquitto* handle = nullptr;
  std::optional<int> answer;                   // of the broker to the connection
  std::optional<int> goodbye;                  // why the broker has ended it
  std::vector<std::pair<int, int>> published;  // number and reason
  std::string trouble;                         // what the library says of it

  Client() = default;
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;
  ~Client() {
    const detail::NoSigpipe guard;
    if (handle != nullptr) ::mosquitto_destroy(handle);
  }
  std::string reason(int status) const {
    std::string text = status == MOSQ_ERR_ERRNO ? std::generic_category().message(errno) : ::mosquitto_strerror(status);
    while (text.ends_with('.')) text.pop_back();
    return trouble.empty() ? text : text + " (" + trouble + ")";
  }
};

extern "C" {
static void on_connect(mosquitto*, void* client, int reason, int, const mosquitto_property*) {
  static_cast<Client*>(client)->answer = reason;
}
static void on_disconnect(mosquitto*, void* client, int reason, const mosquitto_property*) {
  static_cast<Client*>(client)->goodbye = reason;
}
static void on_publish(mosquitto*, void* client, int number, int reason, const mosquitto_property*) {
  static_cast<Client*>(client)->published.emplace_back(number, reason);
}
static void on_log(mosquitto*, void* client, int level, const char* text) {
  if (level == MOSQ_LOG_ERR) static_cast<Client*>(client)->trouble = text;
}
}

std::uint16_t port_of(const MqttConfig& config) {
  return config.port != 0 ? config.port : static_cast<std::uint16_t>(config.tls ? 8883 : 1883);
}

const char* or_null(const std::string& text) { return text.empty() ? nullptr : text.c_str(); }

/// Makes a client and connects it: blocks, as looking up names does. The rest is done on the loop.
class Connecting final : public detail::LaneJob {
 public:
  Connecting(const MqttConfig& config, bool is_v5, std::function<void(Connecting&, Outcome)> ended)
      : client(std::make_shared<Client>()), config_(config), is_v5_(is_v5), ended_(std::move(ended)) {
    client->published.reserve(most_under_way);
  }
  void run() noexcept override {
    try {
      const detail::NoSigpipe guard;
      status = connect();
      if (status != MOSQ_ERR_SUCCESS) why = client->reason(status);
    } catch (...) {
      status = MOSQ_ERR_NOMEM;
    }
  }
  void done(Outcome outcome) override {
    if (const auto ended = std::exchange(ended_, nullptr)) ended(*this, outcome);
  }
  /// Nobody waits for it any more. The loop's thread.
  void forget() noexcept { ended_ = nullptr; }

  std::shared_ptr<Client> client;
  int status = MOSQ_ERR_SUCCESS;
  std::string why;

 private:
  int connect() {
    static std::once_flag once;
    std::call_once(once, [] { ::mosquitto_lib_init(); });
    errno = 0;
    mosquitto* const handle = ::mosquitto_new(or_null(config_.client_id), true, client.get());
    if (handle == nullptr) return errno == ENOMEM ? MOSQ_ERR_NOMEM : MOSQ_ERR_INVAL;
    client->handle = handle;
    ::mosquitto_connect_v5_callback_set(handle, on_connect);
    ::mosquitto_disconnect_v5_callback_set(handle, on_disconnect);
    ::mosquitto_publish_v5_callback_set(handle, on_publish);
    ::mosquitto_log_callback_set(handle, on_log);
    ::mosquitto_int_option(handle, MOSQ_OPT_PROTOCOL_VERSION, is_v5_ ? MQTT_PROTOCOL_V5 : MQTT_PROTOCOL_V311);
    // A broker of version 5 says how many it takes; those of 3.1.1 get what they are used to, the library's 20.
    if (is_v5_) ::mosquitto_int_option(handle, MOSQ_OPT_SEND_MAXIMUM, static_cast<int>(most_under_way));
    ::mosquitto_int_option(handle, MOSQ_OPT_TCP_NODELAY, 1);
    int done = MOSQ_ERR_SUCCESS;
    if (!config_.user.empty())
      done = ::mosquitto_username_pw_set(handle, config_.user.c_str(), or_null(config_.password));
    if (done == MOSQ_ERR_SUCCESS && config_.will) {
      const MqttWill& will = *config_.will;
      done = ::mosquitto_will_set(handle, will.topic.c_str(), static_cast<int>(will.message.size()),
                                  will.message.data(), will.qos, will.retain);
    }
    if (done == MOSQ_ERR_SUCCESS && config_.tls) {
      const MqttTls& tls = *config_.tls;
      if (tls.ca.empty()) ::mosquitto_int_option(handle, MOSQ_OPT_TLS_USE_OS_CERTS, 1);
      if (!tls.ca.empty() || !tls.certificate.empty())
        done = ::mosquitto_tls_set(handle, or_null(tls.ca), tls.ca.empty() ? "/etc/ssl/certs" : nullptr,
                                   or_null(tls.certificate), or_null(tls.key), nullptr);
      if (done == MOSQ_ERR_INVAL) client->trouble = "a file of `tls` cannot be read";
    }
    if (done != MOSQ_ERR_SUCCESS) return done;
    const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(config_.keepalive).count();
    return ::mosquitto_connect_bind_v5(handle, config_.host.c_str(), port_of(config_), static_cast<int>(seconds),
                                       nullptr, nullptr);
  }

  const MqttConfig config_;  // a copy: the job may outlive its sink
  const bool is_v5_;
  std::function<void(Connecting&, Outcome)> ended_;  // loop
};

/// Of MQTT 5: the message will never be taken.
bool is_refusal(int reason) {
  return reason >= 0x80 && reason != MQTT_RC_QUOTA_EXCEEDED && reason != MQTT_RC_RECEIVE_MAXIMUM_EXCEEDED &&
         reason != MQTT_RC_PACKET_ID_IN_USE && reason != MQTT_RC_SERVER_BUSY;
}

/// Shared, since an answer may end the sink while one of its functions runs.
class Connection : public std::enable_shared_from_this<Connection> {
 public:
  Connection(Loop& loop, const MqttConfig& config, bool is_text)
      : config_(config),
        loop_(loop),
        name_("sink " + config.sink.name),
        is_text_(is_text),
        is_v5_(config.version != MqttVersion::v311),
        more_(loop, [this] { work(); }),
        upkeep_(loop, [this] { work(); }) {
    slots_.resize(slot_count);
  }
  ~Connection() {
    drop();
    if (lane_ != nullptr && !last_job_.expired()) lane_->leave_behind();  // a silent server holds nobody
  }

  void send(const Parcel& parcel, Answer answer) {
    under_way_.push_back({++parcels_, &parcel, std::move(answer)});
    if (client_ == nullptr) {
      if (job_ == nullptr) connect();
    } else {
      work();
    }
  }
  void cancel() {
    under_way_.clear();
    drop();
  }
  void end() {
    under_way_.clear();
    if (is_connected_) {
      const detail::NoSigpipe guard;
      ::mosquitto_disconnect_v5(client_->handle, MQTT_RC_NORMAL_DISCONNECTION, nullptr);
    }
    drop();
    more_.close();
    upkeep_.close();
  }

 private:
  struct UnderWay {
    std::uint64_t id;
    const Parcel* parcel;
    Answer answer;
    std::size_t next = 0;     // row to be given to the library
    std::size_t waiting = 0;  // rows that are with it
  };
  /// A message that is with the library.
  struct Message {
    int number = 0;  // 0: none
    std::uint64_t parcel = 0;
    std::size_t row = 0;
  };

  std::string peer() const { return config_.host + " port " + std::to_string(port_of(config_)); }

  void connect() {
    const auto self = shared_from_this();
    if (lane_ == nullptr)
      lane_ = std::make_unique<detail::Lane>(loop_.core(), "connecting of " + name_, config_.connect_timeout);
    const auto job = std::make_shared<Connecting>(config_, is_v5_, [this](Connecting& ended, auto outcome) {
      const auto alive = shared_from_this();
      job_ = nullptr;
      connecting_ended(ended, outcome);
    });
    job_ = job;
    last_job_ = job;
    if (!lane_->submit(job) && job_ == job) {
      job_ = nullptr;
      fail(Errc::timed_out, "cannot connect", "no thread can do it: earlier attempts still hang");
    }
  }
  void connecting_ended(Connecting& job, detail::LaneJob::Outcome outcome) {
    if (outcome == detail::LaneJob::Outcome::cancelled) return;
    if (outcome == detail::LaneJob::Outcome::given_up)
      return fail(Errc::timed_out, "cannot connect", "no connection in " + to_string(config_.connect_timeout));
    if (job.status != MOSQ_ERR_SUCCESS) return fail(Errc::disconnected, "cannot connect", job.why);
    client_ = std::move(job.client);
    // A descriptor of our own: the library closes its as it likes, and a watched one must not be closed.
    const int fd = ::fcntl(::mosquitto_socket(client_->handle), F_DUPFD_CLOEXEC, 3);
    if (fd < 0) return fail(Errc::io_failed, "cannot connect", std::generic_category().message(errno));
    fd_ = fd;
    wants_to_write_ = false;
    watch_ = FdWatch(loop_, fd_, FdWatch::readable, name_, [this](const FdEvent& event) {
      is_readable_ = is_readable_ || event.readable || event.hung_up;
      work();
    });
    work();
  }

  /// Calls the library for whatever there is to do, and takes what came of it. Answers bring new parcels: then again.
  void work() {
    if (std::exchange(is_working_, true)) return;
    const auto self = shared_from_this();
    std::size_t left = most_in_a_turn;
    while (client_ != nullptr) {
      if (!take_answer(call_library(left))) break;
      take_published();
      if (client_ == nullptr || left == 0 || !can_publish()) break;
    }
    is_working_ = false;
    if (client_ == nullptr) return;
    const bool wants = ::mosquitto_want_write(client_->handle);
    if (wants != wants_to_write_) {
      wants_to_write_ = wants;
      watch_.set_events(wants ? FdWatch::readable_and_writable : FdWatch::readable);
    }
    if (left == 0) more_.start(Duration{0});
    if (!upkeep_.is_running()) upkeep_.start(upkeep);
  }

  int call_library(std::size_t& left) {
    std::optional<detail::NoSigpipe> guard;
    if (config_.tls) guard.emplace();  // without TLS the library writes without the signal
    errno = 0;
    int status = MOSQ_ERR_SUCCESS;
    if (std::exchange(is_readable_, false)) status = ::mosquitto_loop_read(client_->handle, 1);
    if (status == MOSQ_ERR_SUCCESS && ::mosquitto_want_write(client_->handle))
      status = ::mosquitto_loop_write(client_->handle, 1);
    if (status == MOSQ_ERR_SUCCESS) status = ::mosquitto_loop_misc(client_->handle);
    if (status == MOSQ_ERR_SUCCESS && is_connected_) status = publish_some(left);
    return status;
  }

  /// False: the connection is over.
  bool take_answer(int status) {
    if (const auto answer = std::exchange(client_->answer, {})) {
      if (*answer == 0) {
        is_connected_ = true;
      } else {
        if (is_v5_ && config_.version == MqttVersion::newest &&
            (*answer == MQTT_RC_UNSUPPORTED_PROTOCOL_VERSION || *answer == CONNACK_REFUSED_PROTOCOL_VERSION))
          return try_older();
        const std::string why = is_v5_ ? ::mosquitto_reason_string(*answer) : ::mosquitto_connack_string(*answer);
        fail(Errc::not_permitted, "the broker refuses the connection", why,
             "look at `user`, `password` and `client_id`");
        return false;
      }
    }
    if (status == MOSQ_ERR_SUCCESS) return true;
    // Old brokers hang up on a version that they do not know.
    if (!is_connected_ && is_v5_ && config_.version == MqttVersion::newest &&
        (status == MOSQ_ERR_CONN_LOST || status == MOSQ_ERR_PROTOCOL || status == MOSQ_ERR_MALFORMED_PACKET) &&
        !std::exchange(has_tried_older_, true))
      return try_older();
    if (!is_connected_ && config_.version == MqttVersion::newest) is_v5_ = true;
    const auto goodbye = std::exchange(client_->goodbye, {});
    const std::string why = goodbye && *goodbye >= 0x80 ? ::mosquitto_reason_string(*goodbye) : client_->reason(status);
    if (is_connected_) has_tried_older_ = false;
    fail(Errc::disconnected, is_connected_ ? "lost the connection" : "cannot connect", why);
    return false;
  }
  bool try_older() {
    drop();
    is_v5_ = false;
    connect();
    return false;
  }

  bool can_publish() const noexcept {
    if (!is_connected_ || messages_ >= most_under_way || slot_of(next_number()).number != 0) return false;
    return std::any_of(under_way_.begin(), under_way_.end(),
                       [](const UnderWay& one) { return one.next < one.parcel->rows().size(); });
  }
  int next_number() const noexcept { return static_cast<int>(static_cast<unsigned>(last_number_) % last_number + 1); }
  const Message& slot_of(int number) const noexcept { return slots_[static_cast<unsigned>(number) % slot_count]; }
  Message& slot_of(int number) noexcept { return slots_[static_cast<unsigned>(number) % slot_count]; }

  int publish_some(std::size_t& left) {
    for (UnderWay& one : under_way_) {
      while (one.next < one.parcel->rows().size()) {
        if (left == 0 || messages_ >= most_under_way) return MOSQ_ERR_SUCCESS;
        const int expected = next_number();
        if (slot_of(expected).number != 0) return MOSQ_ERR_SUCCESS;  // an old one is unanswered
        const std::size_t row = one.next++;
        --left;
        auto bytes = one.parcel->bytes(row);
        if (is_text_ && !bytes.empty() && bytes.back() == std::byte{'\n'}) bytes = bytes.first(bytes.size() - 1);
        // Before the call, which may tell at once that it is done.
        slot_of(expected) = {expected, one.id, row};
        ++messages_;
        ++one.waiting;
        int number = 0;
        const int status = ::mosquitto_publish_v5(client_->handle, &number, topic_of(one.parcel->rows()[row]).c_str(),
                                                  static_cast<int>(bytes.size()), bytes.data(), config_.qos,
                                                  config_.retain, nullptr);
        if (number != 0) last_number_ = number;
        if (status == MOSQ_ERR_SUCCESS && number == expected) continue;
        slot_of(expected) = {};
        --messages_;
        --one.waiting;
        if (status == MOSQ_ERR_SUCCESS) return MOSQ_ERR_PROTOCOL;  // not as the library numbers its messages
        if (status != MOSQ_ERR_INVAL && status != MOSQ_ERR_PAYLOAD_SIZE && status != MOSQ_ERR_OVERSIZE_PACKET &&
            status != MOSQ_ERR_MALFORMED_UTF8)
          return status;
        one.answer.refuse(row, {Errc::bad_data, "cannot be sent by MQTT", topic_of(one.parcel->rows()[row]),
                                client_->reason(status), "look at the topic and the size of the event"});
      }
    }
    return MOSQ_ERR_SUCCESS;
  }

  /// What the library has told, once it has returned.
  void take_published() {
    const auto client = client_;
    bool is_short_of_room = false;
    int why = 0;
    for (const auto& [number, reason] : client->published) {
      Message& message = slot_of(number);
      if (message.number != number) continue;
      const Message ended = std::exchange(message, {});
      --messages_;
      const auto of = std::find_if(under_way_.begin(), under_way_.end(),
                                   [&](const UnderWay& one) { return one.id == ended.parcel; });
      if (of == under_way_.end()) continue;
      --of->waiting;
      if (is_refusal(reason)) {
        of->answer.refuse(ended.row,
                          {Errc::not_permitted, "the broker refuses the event", topic_of(of->parcel->rows()[ended.row]),
                           ::mosquitto_reason_string(reason), "look at its access control"});
      } else if (reason >= 0x80) {
        is_short_of_room = true;
        why = reason;
      }
    }
    client->published.clear();
    if (is_short_of_room) return fail(Errc::busy, "the broker takes no more", ::mosquitto_reason_string(why));
    for (bool is_any = true; is_any && client_ == client;) {
      const auto done = std::find_if(under_way_.begin(), under_way_.end(), [](const UnderWay& one) {
        return one.waiting == 0 && one.next == one.parcel->rows().size();
      });
      is_any = done != under_way_.end();
      if (!is_any) break;
      Answer answer = std::move(done->answer);
      under_way_.erase(done);
      answer.acknowledge();
    }
  }

  const std::string& topic_of(const Parcel::Row& row) {
    if (topics_.size() <= row.slot) topics_.resize(row.slot + 1);
    auto& [info, topic] = topics_[row.slot];
    if (info == row.info) return topic;
    info = row.info;
    topic = config_.topic;
    std::string origin = info->origin;
    std::replace_if(
        origin.begin(), origin.end(), [](char c) { return c == '+' || c == '#' || c == '\0'; }, '_');
    replace(topic, "{topic}", info->topic);
    replace(topic, "{origin}", origin);
    return topic;
  }
  static void replace(std::string& in, std::string_view mark, const std::string& by) {
    for (std::size_t at = in.find(mark); at != std::string::npos; at = in.find(mark, at + by.size()))
      in.replace(at, mark.size(), by);
  }

  void fail(Errc code, const char* failed, std::string why, const char* advice = "it is connected to again") {
    drop();
    const Error error{code, failed, peer(), std::move(why), advice};
    auto ended = std::move(under_way_);
    under_way_.clear();
    for (UnderWay& one : ended) one.answer.again(error);
  }
  void drop() {
    if (const auto job = std::exchange(job_, nullptr)) job->forget();
    if (watch_.is_open()) watch_.close();
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
    client_ = nullptr;  // closes the socket
    is_connected_ = is_readable_ = false;
    more_.stop();
    upkeep_.stop();
    std::fill(slots_.begin(), slots_.end(), Message{});
    messages_ = 0;
    last_number_ = 0;
  }

  const MqttConfig config_;
  Loop& loop_;
  const std::string name_;
  const bool is_text_;
  bool is_v5_;
  bool has_tried_older_ = false;
  Timer more_;    // goes on in the next turn of the loop
  Timer upkeep_;  // what the library does by time
  std::unique_ptr<detail::Lane> lane_;
  std::shared_ptr<Connecting> job_;     // that is waited for
  std::weak_ptr<Connecting> last_job_;  // also one that is not, and still runs
  std::shared_ptr<Client> client_;
  int fd_ = -1;
  FdWatch watch_;
  bool is_connected_ = false;
  bool is_readable_ = false;
  bool is_working_ = false;
  bool wants_to_write_ = false;
  std::vector<UnderWay> under_way_;
  std::uint64_t parcels_ = 0;
  std::vector<Message> slots_;
  std::size_t messages_ = 0;  // in them
  int last_number_ = 0;
  std::vector<std::pair<const SlotInfo*, std::string>> topics_;  // by slot
};

class MqttSender final : public Sender {
 public:
  MqttSender(MqttConfig config, std::unique_ptr<Codec> codec) : config_(std::move(config)), codec_(std::move(codec)) {}

  SendingConfig sending() const override { return config_.sending; }
  void begin(Loop& loop) override { connection_ = std::make_shared<Connection>(loop, config_, codec_->is_text()); }
  void send(const Parcel& parcel, Answer answer) override { connection_->send(parcel, std::move(answer)); }
  void cancel() override { connection_->cancel(); }
  void end() override {
    const auto connection = std::move(connection_);
    connection->end();
  }
  Result<void> encode(const Record& record, std::vector<std::byte>& out) override {
    return codec_->encode(record.keyed_view(), out);
  }

 private:
  const MqttConfig config_;
  const std::unique_ptr<Codec> codec_;  // lane
  std::shared_ptr<Connection> connection_;
};

/// Why messages cannot go there; empty: they can.
std::string obstacle_of_topic(const std::string& topic) {
  if (topic.empty()) return "there is no topic";
  if (topic.find_first_of(std::string_view("+#\0", 3)) != std::string::npos)
    return "a topic of MQTT to publish to has no + and no #";
  return topic.size() > 1000 ? "it is too long" : "";
}

std::string obstacle_of_tls(const MqttConfig& config) {
  return config.tls && config.tls->certificate.empty() != config.tls->key.empty()
             ? "`certificate` and `key` go together"
             : "";
}

MqttConfig named(MqttConfig config) {
  if (config.sink.name.empty()) config.sink.name = "mqtt";
  return config;
}

std::unique_ptr<Sender> sender_of(const MqttConfig& config, const CodecRegistry& formats) {
  detail::require_host(what, config.host, port_of(config));
  const auto require = [](const std::string& where, const std::string& why) {
    if (!why.empty()) throw SetupError({Errc::bad_argument, what, where, why, ""});
  };
  require(config.topic, obstacle_of_topic(config.topic));
  if (config.will) require(config.will->topic, obstacle_of_topic(config.will->topic));
  if (config.qos > 2 || (config.will && config.will->qos > 2)) require("qos", "it is 0, 1 or 2");
  require("tls", obstacle_of_tls(config));
  return std::make_unique<MqttSender>(named(config), detail::codec_to_send(what, config.format, formats));
}

}  // namespace

void check_config(const MqttConfig& config, const ConfigItem& item, Problems& problems) {
  detail::add_obstacle(detail::obstacle_of_host(config.host), "host", item, problems);
  detail::add_obstacle(detail::obstacle_of_format(config.format), "format", item, problems);
  detail::add_obstacle(obstacle_of_topic(config.topic), "topic", item, problems);
  if (config.will) detail::add_obstacle(obstacle_of_topic(config.will->topic), "will", item, problems);
  detail::add_obstacle(obstacle_of_tls(config), "tls", item, problems);
}

MqttSink::MqttSink(Loop& loop, MqttConfig config, const CodecRegistry& formats)
    : Sink(loop, named(config).sink, sender_of(config, formats)) {}

}  // namespace rtdata
