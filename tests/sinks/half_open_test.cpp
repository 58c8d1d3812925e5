// Connections whose other machine is gone without a word: every packet to it is dropped, none comes back, not even a
// reset. A filter on the peer's own sockets does that here, for which no right is needed.
#include <doctest/doctest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <string_view>
#include <vector>

#include "rtdata/loop/watch.hpp"
#include "sinks/answered_senders.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

TEST_SUITE("sinks") {
  TEST_CASE(
      "US-32 a connection whose packets are dropped is given up after answer_timeout, and all is sent by another") {
    for (const AnsweredSender& kind : answered_senders()) {
      CAPTURE(kind.name);
      AnsweredBench bench(kind);
      bench.publish(50);
      REQUIRE(bench.wait_for([&] { return bench.sink.counts().stored == 50; }));
      bench.peer.lose_connections();
      const std::size_t before = bench.peer.connections();
      const MonotonicTime begin = bench.loop.now();
      bench.publish(50);
      CHECK(bench.wait_for([&] { return bench.sink.counts().stored == 100; }));
      CHECK(bench.peer.connections() > before);
      CHECK(bench.loop.now() - begin >= answer_timeout);
      CHECK(bench.loop.now() - begin < 10 * answer_timeout);
      CHECK(bench.has_all());
      CHECK_FALSE(bench.errors.empty());
      CHECK(bench.sink.health() == Health::ok);
      CHECK(bench.sink.counts().balances());
      CHECK(bench.missed == 0);
    }
  }

  TEST_CASE("US-32 a peer that has vanished keeps nobody from closing in time, and gets all when it is back") {
    for (const AnsweredSender& kind : answered_senders()) {
      // libmosquitto connects on the lane, which in virtual time would block here until the kernel gives up.
      if (kind.name == std::string_view("mqtt")) continue;
      for (const bool comes_back : {false, true}) {
        CAPTURE(kind.name);
        CAPTURE(comes_back);
        AnsweredBench bench(kind);
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
    const auto all = answered_senders();
    AnsweredBench bench(all[1]);
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
