// Connections whose other machine is gone without a word: every packet to it is dropped, none comes back, not even a
// reset. A filter on the peer's own sockets does that here, for which no right is needed.
#include <doctest/doctest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/sinks/tcp.hpp"
#include "sinks/answering_peer.hpp"
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
