// How loops wake each other.
#include "loop/core/wake.hpp"

#include <doctest/doctest.h>
#include <poll.h>

#include <atomic>
#include <thread>

#include "loop/tier/byte_ring.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"

using namespace rtdata;
using namespace std::chrono_literals;

namespace {

struct Number {
  double value = 0;
  friend constexpr auto describe(type_tag<Number>) { return record("number", field("value", &Number::value)); }
};

bool is_readable(const detail::Wake& wake) {
  pollfd fd{wake.fd(), POLLIN, 0};
  return ::poll(&fd, 1, 0) == 1;
}

}  // namespace

TEST_SUITE("loop") {
  TEST_CASE("a loop that sleeps is woken through the kernel, one that turns finds what is new itself") {
    detail::Wake wake;
    REQUIRE(wake.open());
    CHECK_FALSE(wake.take_news());
    wake.send();
    CHECK_FALSE(is_readable(wake));
    CHECK_FALSE(wake.rest());  // it must not sleep over it
    CHECK(wake.take_news());
    CHECK_FALSE(wake.take_news());
    CHECK(wake.rest());
    wake.send();
    wake.send();
    CHECK(is_readable(wake));
    wake.answer();
    CHECK_FALSE(is_readable(wake));
    CHECK(wake.take_news());
    CHECK(wake.rest());
  }

  TEST_CASE("no wake-up is lost between loops that send to each other while they turn and while they sleep") {
    constexpr unsigned rounds = 20'000;
    Loop main;
    Tier fast(main, {});
    Feed<Number> feed(fast.loop(), {.name = "feed"});
    unsigned received = 0;
    std::atomic<unsigned> posted_elsewhere{0};
    const auto send_one = [&] { fast.loop().post([&] { feed.publish({1}); }); };
    const auto subscription = main.subscribe<Number>("feed", [&](const Event<Number>& event) {
      CHECK(event.sequence == ++received);
      if (received == rounds) return main.stop();
      send_one();
    });
    const Timer limit(main, 60s, [&] { main.stop(); });
    std::atomic<bool> is_over{false};
    std::thread other([&] {
      while (!is_over.load()) {
        main.post([&] { ++posted_elsewhere; });
        std::this_thread::yield();
        if (posted_elsewhere.load() % 100 == 0) std::this_thread::sleep_for(1ms);
      }
    });
    send_one();
    main.run();
    is_over = true;
    other.join();
    CHECK(received == rounds);
    CHECK(posted_elsewhere.load() > 0);
  }

  TEST_CASE("a byte ring keeps records of any size in order, and gives their room back") {
    detail::ByteRing ring(1024);
    std::uint32_t sent = 0;
    std::uint32_t taken = 0;
    std::uint32_t at_hand = 0;
    const auto bytes_of = [](std::uint32_t number) { return 16 + number % 7 * 8; };
    for (int round = 0; round < 1000; ++round) {
      using Room = detail::ByteRing::Room;
      const auto send = [&](Room which) {
        if (ring.completes_burst(bytes_of(sent))) {
          ring.publish();
          if (std::byte* room = ring.reserve(bytes_of(sent), which); room == nullptr) return false;
        }
        std::byte* room = which == Room::usual ? ring.reserve_at_hand(bytes_of(sent)) : nullptr;
        at_hand += room != nullptr ? 1 : 0;
        if (room == nullptr) room = ring.reserve(bytes_of(sent), which);
        if (room == nullptr) return false;
        reinterpret_cast<std::uint32_t*>(room)[0] = bytes_of(sent);
        reinterpret_cast<std::uint32_t*>(room)[1] = sent;
        ring.commit(bytes_of(sent++));
        return true;
      };
      CHECK(send(Room::usual));
      ring.look();
      CHECK(ring.front() == nullptr);  // not published yet
      while (send(Room::usual)) {
      }
      if (round % 3 == 0) {
        const std::uint32_t usual = sent;
        while (send(Room::all)) {
        }
        CHECK(sent > usual);
        CHECK(!send(Room::usual));
      }
      ring.publish();
      CHECK(ring.front() == nullptr);  // not looked yet
      ring.look();
      const std::uint32_t before = taken;
      for (int i = 0; i < 5 + round % 20; ++i) {
        const std::byte* front = ring.front();
        if (front == nullptr) break;
        REQUIRE(reinterpret_cast<const std::uint32_t*>(front)[1] == taken);
        CHECK(ring.straight_bytes() >= bytes_of(taken));
        if (i % 2 == 0) {
          ring.pop();
        } else {
          ring.pop(bytes_of(taken));
        }
        ++taken;
      }
      CHECK(taken > before);
      while (ring.front() != nullptr) {
        REQUIRE(reinterpret_cast<const std::uint32_t*>(ring.front())[1] == taken++);
        ring.pop();
      }
      ring.release();
    }
    CHECK(taken == sent);
    CHECK(at_hand > sent / 2);
    CHECK(at_hand < sent);
  }

  TEST_CASE("a byte ring gives room at hand for a burst at most, then what was written has to be published") {
    detail::ByteRing ring(std::size_t{1} << 16);
    constexpr std::uint32_t bytes = 64;  // records that fill the memory to its very end
    constexpr std::size_t a_burst = 8192 / bytes;
    std::size_t taken = 0;
    for (int lap = 0; lap < 100; ++lap) {
      std::byte* room = ring.reserve(bytes, detail::ByteRing::Room::usual);
      std::size_t written = 0;
      for (; room != nullptr; room = ring.reserve_at_hand(bytes)) {
        reinterpret_cast<std::uint32_t*>(room)[0] = bytes;
        reinterpret_cast<std::uint32_t*>(room)[1] = static_cast<std::uint32_t>(lap * a_burst + written);
        CHECK_FALSE(ring.completes_burst(bytes));
        ring.commit(bytes);
        CHECK(ring.has_unpublished());
        ++written;
      }
      CHECK(written == a_burst);
      CHECK(ring.completes_burst(bytes));
      ring.publish();
      CHECK_FALSE(ring.has_unpublished());
      for (ring.look(); const std::byte* front = ring.front(); ring.pop(), ++taken)
        CHECK(reinterpret_cast<const std::uint32_t*>(front)[1] == taken);
      ring.release();
    }
    CHECK(taken == 100 * a_burst);
  }
}
