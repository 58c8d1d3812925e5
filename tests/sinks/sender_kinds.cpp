// The senders among the kinds of sinks that the contract runs over, and those whose peer answers.
#include <fcntl.h>
#include <poll.h>
#include <uv.h>

#include <atomic>
#include <cstring>
#include <mutex>
#include <optional>
#include <sstream>
#include <thread>

#include "rtdata/data/codec.hpp"
#include "rtdata/sinks/tcp.hpp"
#include "rtdata/sinks/udp.hpp"
#include "sinks/answered_senders.hpp"
#include "sinks/answering_peer.hpp"
#include "sinks/sink_kinds.hpp"
#ifdef RTDATA_WITH_HTTP
#include "rtdata/sinks/http.hpp"
#endif
#ifdef RTDATA_WITH_MQTT
#include "rtdata/sinks/mqtt.hpp"
#endif

namespace sinks {
namespace {

using namespace rtdata;
using namespace std::chrono_literals;

Row row_of(std::string_view line) {
  static const auto codec = make_json_codec();
  const auto event = codec->decode(std::as_bytes(std::span(line)), *description_of<Number>()).or_throw();
  Number number;
  std::memcpy(&number, event.payload.data(), sizeof number);
  return {event.topic, event.sequence.value(), number.value};
}

std::vector<Row> rows_of(const std::string& text) {
  std::vector<Row> all;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) all.push_back(row_of(line));
  return all;
}

/// A server that takes and answers what comes, on a thread of its own.
class AnsweredStore : public Store {
 public:
  explicit AnsweredStore(Answering answering) : peer_(std::move(answering)) {
    thread_ = std::thread([this] {
      for (; !is_over_; std::this_thread::sleep_for(200us)) {
        const std::lock_guard lock(mutex_);
        peer_.look();
      }
    });
  }
  ~AnsweredStore() override {
    is_over_ = true;
    thread_.join();
  }
  std::vector<Row> rows() override {
    const std::lock_guard lock(mutex_);
    return rows_of(peer_.got());
  }
  bool is_answered() const override { return true; }
  void settle(Loop& loop, const Sink& sink) override {
    wait(loop, [&] { return sink.counts().queued == 0; });
  }
  void close(Loop& loop, Sink& sink) override {
    sink.flush();
    settle(loop, sink);
    sink.close();
  }
  std::uint64_t close(Loop& loop) override {
    std::optional<std::uint64_t> lost;
    loop.drain(1min, [&](std::uint64_t count) { lost = count; });
    wait(loop, [&] { return lost.has_value(); });
    return lost.value_or(0);
  }

 protected:
  static SendingConfig in_order() { return {.window = 1, .timeout = 10min}; }
  Peer peer_;

 private:
  template <class Until>
  static void wait(Loop& loop, Until&& until) {
    const auto limit = std::chrono::steady_clock::now() + 30s;
    while (!until() && std::chrono::steady_clock::now() < limit) {
      pollfd ready{uv_backend_fd(loop.uv()), POLLIN, 0};
      ::poll(&ready, 1, 1);
      loop.advance(1ms);
    }
  }
  std::mutex mutex_;
  std::atomic<bool> is_over_{false};
  std::thread thread_;
};

class AcknowledgedStore final : public AnsweredStore {
 public:
  AcknowledgedStore() : AnsweredStore(answer_line) {}
  Sink make(Loop& loop, SinkConfig config) override {
    return TcpSink(loop, {.host = "127.0.0.1",
                          .port = peer_.port(),
                          .acknowledge = Acknowledge::line,
                          .sending = in_order(),
                          .sink = std::move(config)});
  }
};

#ifdef RTDATA_WITH_HTTP
class HttpStore final : public AnsweredStore {
 public:
  HttpStore() : AnsweredStore(answer_request) {}
  Sink make(Loop& loop, SinkConfig config) override {
    return HttpSink(loop, {.server = {.url = "http://127.0.0.1:" + std::to_string(peer_.port()) + "/"},
                           .format = "jsonl",
                           .sending = in_order(),
                           .sink = std::move(config)});
  }
};
#endif

#ifdef RTDATA_WITH_MQTT
class MqttStore final : public AnsweredStore {
 public:
  MqttStore() : AnsweredStore(answer_packet) {}
  Sink make(Loop& loop, SinkConfig config) override {
    MqttConfig mqtt;
    mqtt.broker.host = "127.0.0.1";
    mqtt.broker.port = peer_.port();
    mqtt.qos = 1;
    mqtt.sending.timeout = 10min;
    mqtt.sink = std::move(config);
    return MqttSink(loop, mqtt);
  }
};
#endif

/// A receiver with room for all that a test sends: what does not fit is lost, as UDP is.
class UdpStore final : public Store {
 public:
  UdpStore() {
    receiver_ = ::socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    constexpr int room = 64 << 20;
    has_room_ = ::setsockopt(receiver_, SOL_SOCKET, SO_RCVBUFFORCE, &room, sizeof room) == 0;
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    if (::bind(receiver_, reinterpret_cast<sockaddr*>(&address), size) != 0 ||
        ::getsockname(receiver_, reinterpret_cast<sockaddr*>(&address), &size) != 0)
      throw std::runtime_error("no receiver");
    port_ = ntohs(address.sin_port);
  }
  ~UdpStore() override { ::close(receiver_); }
  /// Only root may have as much.
  static bool is_possible() { return UdpStore().has_room_; }
  Sink make(Loop& loop, SinkConfig config) override {
    return UdpSink(loop, {.host = "127.0.0.1", .port = port_, .format = "jsonl", .sink = std::move(config)});
  }
  std::vector<Row> rows() override {
    char datagram[65536];
    for (ssize_t got; (got = ::recv(receiver_, datagram, sizeof datagram, 0)) > 0;)
      rows_.push_back(row_of({datagram, static_cast<std::size_t>(got)}));
    return rows_;
  }

 private:
  int receiver_ = -1;
  std::uint16_t port_ = 0;
  bool has_room_ = false;
  std::vector<Row> rows_;
};

template <class Kind>
bool add(const char* name) {
  return add_sink_kind({name, [] { return std::make_unique<Kind>(); }, true});
}

const bool are_added[] = {
    add<AcknowledgedStore>("TCP, acknowledged"),
#ifdef RTDATA_WITH_HTTP
    add<HttpStore>("HTTP"),
#endif
#ifdef RTDATA_WITH_MQTT
    add<MqttStore>("MQTT"),
#endif
    UdpStore::is_possible() && add<UdpStore>("UDP"),
};

}  // namespace

std::vector<AnsweredSender> answered_senders() {
  const SendingConfig sending{.window = 2, .parcel_rows = 5, .timeout = answer_timeout};
  std::vector<AnsweredSender> all;
  all.push_back({"tcp", answer_line, [sending](Loop& loop, const std::string& host, std::uint16_t port) -> Sink {
                   return TcpSink(loop, {.host = host,
                                         .port = port,
                                         .acknowledge = Acknowledge::line,
                                         .connect_timeout = 1s,
                                         .sending = sending,
                                         .sink = sink_config});
                 }});
#ifdef RTDATA_WITH_HTTP
  all.push_back({"http", answer_request, [sending](Loop& loop, const std::string& host, std::uint16_t port) -> Sink {
                   return HttpSink(loop, {.server = {.url = "http://" + host + ":" + std::to_string(port) + "/"},
                                          .format = "jsonl",
                                          .sending = sending,
                                          .sink = sink_config});
                 }});
#endif
#ifdef RTDATA_WITH_MQTT
  all.push_back({"mqtt", answer_packet, [sending](Loop& loop, const std::string& host, std::uint16_t port) -> Sink {
                   MqttConfig config;
                   config.broker.host = host;
                   config.broker.port = port;
                   config.topic = "t";
                   config.qos = 1;
                   config.broker.connect_timeout = 1s;
                   config.sending = sending;
                   config.sink = sink_config;
                   return MqttSink(loop, config);
                 }});
#endif
  return all;
}

}  // namespace sinks
