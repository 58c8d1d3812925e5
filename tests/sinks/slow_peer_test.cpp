// Peers that answer so slowly that it is as good as not at all.
#include <doctest/doctest.h>

#include "sinks/answered_senders.hpp"

using namespace sinks;

TEST_SUITE("sinks") {
  TEST_CASE("US-32 NFR-1 a peer that answers a byte a second is given up, and gets all once it is quick again") {
    for (const AnsweredSender& kind : answered_senders()) {
      for (const bool comes_back : {true, false}) {
        CAPTURE(kind.name);
        CAPTURE(comes_back);
        AnsweredBench bench(kind);
        bench.publish(10);
        REQUIRE(bench.wait_for([&] { return bench.sink.counts().stored == 10; }));
        bench.peer.drip(true);
        bench.publish(50);
        for (int second = 0; second < 20; ++second) {
          bench.peer.drop();
          (void)bench.wait_for([&] { return false; }, 100);
        }
        CHECK(bench.sink.health() == Health::faulted);
        CHECK_FALSE(bench.errors.empty());
        CHECK(bench.sink.counts().stored < 60);
        CHECK(bench.sink.counts().balances());
        CHECK(bench.missed == 0);
        if (comes_back) {
          bench.peer.drip(false);
          CHECK(bench.wait_for([&] { return bench.sink.counts().stored == 60; }, 6000));
          CHECK(bench.has_all());
          CHECK(bench.sink.health() == Health::ok);
        }
        bench.ticker.close();
        const std::uint64_t waiting = 60 - bench.sink.counts().stored;
        const MonotonicTime begin = bench.loop.now();
        CHECK(bench.loop.close(3s) == waiting);
        CHECK(bench.loop.now() - begin <= 3s);
      }
    }
  }
}
