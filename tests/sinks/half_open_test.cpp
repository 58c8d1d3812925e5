// Connections whose other machine is gone without a word: every packet to it is dropped, none comes back, not even a
// reset. A filter on the peer's own sockets does that here, for which no right is needed.
#include <arpa/inet.h>
#include <doctest/doctest.h>
#include <linux/filter.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/sinks/tcp.hpp"
#include "sinks/sink_kinds.hpp"
#ifdef RTDATA_WITH_HTTP
#include "rtdata/sinks/http.hpp"
#endif
#ifdef RTDATA_WITH_MQTT
#include "rtdata/sinks/mqtt.hpp"
#endif

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

/// From now on the kernel drops whatever comes for this socket, before TCP sees it.
void go_silent(int fd) {
  sock_filter drop{BPF_RET | BPF_K, 0, 0, 0};
  const sock_fprog program{1, &drop};
  REQUIRE(::setsockopt(fd, SOL_SOCKET, SO_ATTACH_FILTER, &program, sizeof program) == 0);
}

void hear_again(int fd) {
  const int unused = 0;
  REQUIRE(::setsockopt(fd, SOL_SOCKET, SO_DETACH_FILTER, &unused, sizeof unused) == 0);
}

/// Takes what is whole out of the bytes that have come: the answer to it, empty when there is nothing whole.
using Answering = std::function<std::string(std::string& in, std::string& got)>;

class Peer {
 public:
  explicit Peer(Answering answering) : answering_(std::move(answering)) {
    listener_ = ::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    REQUIRE(::bind(listener_, reinterpret_cast<sockaddr*>(&address), size) == 0);
    REQUIRE(::listen(listener_, 16) == 0);
    ::getsockname(listener_, reinterpret_cast<sockaddr*>(&address), &size);
    port_ = ntohs(address.sin_port);
  }
  Peer(const Peer&) = delete;
  Peer& operator=(const Peer&) = delete;
  ~Peer() {
    for (const Connection& one : connections_) ::close(one.fd);
    ::close(listener_);
  }
  std::uint16_t port() const { return port_; }
  std::size_t connections() const { return connections_.size(); }
  const std::string& got() const { return got_; }
  void look() {
    for (int fd = accept(); fd >= 0; fd = accept()) connections_.push_back({fd, ""});
    for (Connection& one : connections_) {
      char bytes[65536];
      for (ssize_t size = 0; (size = ::recv(one.fd, bytes, sizeof bytes, MSG_DONTWAIT)) > 0;)
        one.in.append(bytes, static_cast<std::size_t>(size));
      for (;;) {
        const std::string answer = answering_(one.in, got_);
        if (answer.empty()) break;
        (void)::send(one.fd, answer.data(), answer.size(), MSG_NOSIGNAL);
      }
    }
  }
  /// The connections that there are.
  void lose_connections() {
    for (const Connection& one : connections_) go_silent(one.fd);
  }
  /// Nor does a new one come about.
  void vanish() {
    lose_connections();
    go_silent(listener_);
  }
  void return_() { hear_again(listener_); }

 private:
  struct Connection {
    int fd;
    std::string in;
  };
  int accept() const {
    const int fd = ::accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC), on = 1;
    // In virtual time nothing waits for the kernel to send a small answer.
    if (fd >= 0) ::setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    return fd;
  }

  const Answering answering_;
  int listener_ = -1;
  std::uint16_t port_ = 0;
  std::vector<Connection> connections_;
  std::string got_;
};

std::string take(std::string& in, std::size_t size) {
  std::string taken = in.substr(0, size);
  in.erase(0, size);
  return taken;
}

std::string answer_line(std::string& in, std::string& got) {
  const std::size_t end = in.find('\n');
  if (end == std::string::npos) return "";
  got += take(in, end + 1);
  return "ok\n";
}

#ifdef RTDATA_WITH_HTTP
std::string answer_request(std::string& in, std::string& got) {
  constexpr std::string_view end_of_head = "\r\n\r\n", length = "Content-Length: ";
  const std::size_t head = in.find(end_of_head), at = in.find(length);
  if (head == std::string::npos || at == std::string::npos) return "";
  const std::size_t size = head + end_of_head.size() + std::strtoul(in.c_str() + at + length.size(), nullptr, 10);
  if (in.size() < size) return "";
  got += take(in, size);
  return "HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n";
}
#endif

#ifdef RTDATA_WITH_MQTT
/// As much of a broker of MQTT 5 as a sender with QoS 1 needs.
std::string answer_packet(std::string& in, std::string& got) {
  for (;;) {
    std::size_t size = 0, used = 1;
    for (unsigned shift = 0;; shift += 7) {
      if (in.size() <= used) return "";
      const auto byte = static_cast<unsigned char>(in[used++]);
      size |= std::size_t{byte & 127U} << shift;
      if ((byte & 128) == 0) break;
    }
    if (in.size() < used + size) return "";
    const std::string packet = take(in, used + size);
    switch (static_cast<unsigned char>(packet[0]) >> 4) {
      case 1:
        return {"\x20\x03\0\0\0", 5};
      case 3: {
        got += packet;
        const std::size_t topic = std::size_t{static_cast<unsigned char>(packet[used])} * 256 +
                                  static_cast<unsigned char>(packet[used + 1]);
        return std::string("\x40\x02") + packet.substr(used + 2 + topic, 2);
      }
      case 12:
        return {"\xd0\0", 2};
      default:
        break;
    }
  }
}
#endif

constexpr Duration timeout = std::chrono::seconds{2};
const SinkConfig sink_config{.name = "peer", .batch_time = 10ms, .retry_longest = 1s};

struct SenderKind {
  const char* name;
  Answering answering;
  std::function<Sink(Loop&, std::uint16_t port)> make;
};

std::vector<SenderKind> kinds() {
  const SendingConfig sending{.window = 2, .parcel_rows = 5, .timeout = timeout};
  std::vector<SenderKind> all;
  all.push_back({"tcp", answer_line, [sending](Loop& loop, std::uint16_t port) -> Sink {
                   return TcpSink(loop, {.host = "127.0.0.1",
                                         .port = port,
                                         .acknowledge = Acknowledge::line,
                                         .connect_timeout = 1s,
                                         .sending = sending,
                                         .sink = sink_config});
                 }});
#ifdef RTDATA_WITH_HTTP
  all.push_back({"http", answer_request, [sending](Loop& loop, std::uint16_t port) -> Sink {
                   return HttpSink(loop, {.url = "http://127.0.0.1:" + std::to_string(port) + "/",
                                          .format = "jsonl",
                                          .sending = sending,
                                          .sink = sink_config});
                 }});
#endif
#ifdef RTDATA_WITH_MQTT
  all.push_back({"mqtt", answer_packet, [sending](Loop& loop, std::uint16_t port) -> Sink {
                   MqttConfig config;
                   config.host = "127.0.0.1";
                   config.port = port;
                   config.topic = "t";
                   config.qos = 1;
                   config.connect_timeout = 1s;
                   config.sending = sending;
                   config.sink = sink_config;
                   return MqttSink(loop, config);
                 }});
#endif
  return all;
}

struct Bench {
  explicit Bench(const SenderKind& kind) : peer(kind.answering) {
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    sink = kind.make(loop, peer.port());
  }
  void publish(int count) {
    for (int i = 0; i < count; ++i) loop.topic<Number>("a").publish({++published});
  }
  template <class Done>
  bool wait_for(Done&& done, int turns = 3000) {
    for (int i = 0; i < turns && !done(); ++i) {
      loop.advance(10ms);
      loop.poll();
      peer.look();
    }
    return done();
  }
  bool has_all() const {
    for (int i = 1; i <= static_cast<int>(published); ++i) {
      if (peer.got().find("\"value\":" + std::to_string(i)) == std::string::npos) return false;
    }
    return true;
  }

  std::vector<std::string> errors;
  Loop loop{Loop::Manual{}};
  Peer peer;
  Sink sink;
  double published = 0;
  std::uint64_t missed = 0;
  Ticker ticker{loop, 10ms, [this](const Tick& tick) { missed += tick.missed; }};
};

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("US-32 a connection whose packets are dropped is given up after timeout, and all is sent by another") {
    for (const SenderKind& kind : kinds()) {
      CAPTURE(kind.name);
      Bench bench(kind);
      bench.publish(50);
      REQUIRE(bench.wait_for([&] { return bench.sink.counts().stored == 50; }));
      bench.peer.lose_connections();
      const std::size_t before = bench.peer.connections();
      const MonotonicTime begin = bench.loop.now();
      bench.publish(50);
      CHECK(bench.wait_for([&] { return bench.sink.counts().stored == 100; }));
      CHECK(bench.peer.connections() > before);
      CHECK(bench.loop.now() - begin >= timeout);
      CHECK(bench.loop.now() - begin < 10 * timeout);
      CHECK(bench.has_all());
      CHECK_FALSE(bench.errors.empty());
      CHECK(bench.sink.health() == Health::ok);
      CHECK(bench.sink.counts().balances());
      CHECK(bench.missed == 0);
    }
  }

  TEST_CASE("US-32 a peer that has vanished keeps nobody from closing in time, and gets all when it is back") {
    for (const SenderKind& kind : kinds()) {
      // libmosquitto connects on the lane, which in virtual time would block here until the kernel gives up.
      if (kind.name == std::string_view("mqtt")) continue;
      for (const bool comes_back : {false, true}) {
        CAPTURE(kind.name);
        CAPTURE(comes_back);
        Bench bench(kind);
        bench.publish(10);
        REQUIRE(bench.wait_for([&] { return bench.sink.counts().stored == 10; }));
        bench.peer.vanish();
        bench.publish(50);
        REQUIRE(bench.wait_for([&] { return bench.sink.health() == Health::faulted; }));
        (void)bench.wait_for([&] { return false; }, 500);
        CHECK(bench.sink.counts().stored == 10);
        CHECK(bench.missed == 0);
        if (comes_back) {
          bench.peer.return_();
          CHECK(bench.wait_for([&] { return bench.sink.counts().stored == 60; }, 6000));
          CHECK(bench.has_all());
        }
        bench.ticker.close();
        const MonotonicTime begin = bench.loop.now();
        CHECK(bench.loop.close(3s) == (comes_back ? 0 : 50));
        CHECK(bench.loop.now() - begin <= 3s);
      }
    }
  }

#ifdef RTDATA_WITH_HTTP
  TEST_CASE("a connection of HTTP that never came about leaves no watch on its descriptor's number") {
    const auto all = kinds();
    Bench bench(all[1]);
    bench.peer.vanish();
    bench.publish(5);
    for (int round = 0; round < 3; ++round) {
      const std::size_t before = bench.errors.size();
      REQUIRE(bench.wait_for([&] { return bench.errors.size() > before; }));
      // Whoever opens something now gets that number.
      std::vector<FdWatch> watches;
      std::vector<int> sockets;
      for (int i = 0; i < 8; ++i) {
        sockets.push_back(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
        REQUIRE(sockets.back() >= 0);
        CHECK_NOTHROW(
            watches.emplace_back(bench.loop, sockets.back(), FdWatch::readable, "other", [](const FdEvent&) {}));
      }
      watches.clear();
      for (const int fd : sockets) ::close(fd);
    }
  }
#endif
}
