// Rule 7 of handle.hpp: on somebody else's uv_loop_t we are a guest.
#include <doctest/doctest.h>
#include <unistd.h>
#include <uv.h>

#include <csignal>
#include <map>

#include "data/payloads.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/sensors/feed.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;
using payloads::Climate;

namespace {

/// A host with a handle of each common kind, its data pointers set.
struct Host {
  uv_loop_t loop;
  uv_timer_t timer;
  uv_idle_t idle;
  uv_poll_t poll;
  uv_signal_t signal;
  uv_async_t async;
  int pipe_fds[2];
  int marks[6] = {};
  int timer_calls = 0;
  int poll_calls = 0;

  Host() {
    REQUIRE(uv_loop_init(&loop) == 0);
    loop.data = &marks[0];
    uv_timer_init(&loop, &timer);
    uv_idle_init(&loop, &idle);
    REQUIRE(::pipe(pipe_fds) == 0);
    uv_poll_init(&loop, &poll, pipe_fds[0]);
    uv_signal_init(&loop, &signal);
    uv_async_init(&loop, &async, [](uv_async_t*) {});
    timer.data = this;
    idle.data = &marks[2];
    poll.data = this;
    signal.data = &marks[4];
    async.data = &marks[5];
    uv_poll_start(&poll, UV_READABLE,
                  [](uv_poll_t* handle, int, int) { ++static_cast<Host*>(handle->data)->poll_calls; });
    uv_signal_start(
        &signal, [](uv_signal_t*, int) {}, SIGUSR2);
    for (auto* handle : {reinterpret_cast<uv_handle_t*>(&poll), reinterpret_cast<uv_handle_t*>(&signal),
                         reinterpret_cast<uv_handle_t*>(&async)}) {
      uv_unref(handle);
    }
  }
  ~Host() {
    uv_timer_stop(&timer);
    uv_run(&loop, UV_RUN_DEFAULT);  // once more after our objects are gone, as Loop asks for
    uv_walk(
        &loop, [](uv_handle_t* handle, void*) { uv_close(handle, nullptr); }, nullptr);
    uv_run(&loop, UV_RUN_DEFAULT);
    CHECK(uv_loop_close(&loop) == 0);
    ::close(pipe_fds[0]);
    ::close(pipe_fds[1]);
  }
  struct Seen {
    void* data;
    bool active;
    bool closing;
    bool has_ref;
    bool operator==(const Seen&) const = default;
  };
  std::map<uv_handle_t*, Seen> walk() {
    std::map<uv_handle_t*, Seen> seen;
    uv_walk(
        &loop,
        [](uv_handle_t* handle, void* to) {
          static_cast<std::map<uv_handle_t*, Seen>*>(to)->insert(
              {handle, {handle->data, uv_is_active(handle) != 0, uv_is_closing(handle) != 0, uv_has_ref(handle) != 0}});
        },
        &seen);
    return seen;
  }
  void work_for(unsigned milliseconds) {
    uv_timer_start(
        &timer, [](uv_timer_t* handle) { ++static_cast<Host*>(handle->data)->timer_calls; }, milliseconds, 0);
  }
};

}  // namespace

TEST_SUITE("contract") {
  TEST_CASE("handle rule 7: nothing of the host's is closed, stopped or given data, whatever our handles do") {
    std::signal(SIGUSR1, SIG_IGN);
    Host host;
    const auto before = host.walk();
    int fds[2];
    REQUIRE(::pipe(fds) == 0);
    REQUIRE(::write(fds[1], "x", 1) == 1);
    int ticks = 0;
    int ready = 0;
    int delivered = 0;
    int reads = 0;
    {
      Loop loop(&host.loop);
      Timer timer(loop, 1ms, [] {});
      Ticker ticker(loop, 1ms, [&](const Tick&) { ++ticks; });
      FdWatch watch(loop, fds[0], FdWatch::readable, [&](const FdEvent&) {
        ++ready;
        watch.close();
      });
      SignalWatch signal(loop, SIGUSR1, [] {});
      auto subscription = loop.subscribe("#", [&](const EventView&) { ++delivered; });
      Sensor<Climate> sensor(loop, {.name = "s", .rate = 500_Hz}, [&] {
        ++reads;
        return Climate{};
      });
      Feed<Climate> feed(loop, {.name = "f"});
      feed.publish({});
      loop.stop();  // nothing, on an attached loop
      REQUIRE(::write(host.pipe_fds[1], "x", 1) == 1);
      host.work_for(10);
      while (host.timer_calls == 0 || host.poll_calls == 0 || ready == 0 || ticks == 0 || delivered < 2)
        uv_run(&host.loop, UV_RUN_ONCE);
      for (const auto& [handle, seen] : before) {
        auto now = host.walk();
        REQUIRE(now.count(handle) == 1);
        CHECK(now[handle] == seen);
      }
      CHECK(host.loop.data == &host.marks[0]);
      CHECK_THROWS_AS(loop.run(), SetupError);
      CHECK_THROWS_AS(loop.run_for(1ms), SetupError);
      CHECK_THROWS_AS(loop.close(), SetupError);
    }
    CHECK(uv_run(&host.loop, UV_RUN_DEFAULT) == 0);
    CHECK(host.walk() == before);
    CHECK(host.loop.data == &host.marks[0]);
    CHECK(uv_loop_alive(&host.loop) == 0);
    CHECK(host.timer_calls == 1);
    CHECK(host.poll_calls > 0);
    CHECK(ticks > 0);
    CHECK(ready == 1);
    CHECK(reads > 0);
    CHECK(delivered >= 2);
    ::close(fds[0]);
    ::close(fds[1]);
  }

  TEST_CASE(
      "handle rule 7: the host's uv_run returns when only its own work is done and nothing of ours is left to do") {
    Host host;
    Loop loop(&host.loop);
    CHECK(uv_loop_alive(&host.loop) == 0);
    SUBCASE("without any of our objects") {}
    SUBCASE("with a subscription, a signal watch and a feed, which wait for others") {
      auto subscription = loop.subscribe("#", [](const EventView&) {});
      SignalWatch signal(loop, SIGUSR1, [] {});
      Feed<Climate> feed(loop, {.name = "f"});
      host.work_for(1);
      CHECK(uv_run(&host.loop, UV_RUN_DEFAULT) == 0);
    }
    SUBCASE("with a timer of ours that fires later, and a ticker that is closed") {
      int fired = 0;
      Timer timer(loop, 5ms, [&] { ++fired; });
      Ticker ticker(loop, 1ms, [](const Tick&) {});
      CHECK(uv_loop_alive(&host.loop) != 0);
      ticker.close();
      CHECK(uv_run(&host.loop, UV_RUN_DEFAULT) == 0);
      CHECK(fired == 1);
    }
    host.work_for(1);
    CHECK(uv_run(&host.loop, UV_RUN_DEFAULT) == 0);
    CHECK(host.timer_calls >= 1);
  }

  TEST_CASE("handle rule 7: uv_stop of the host's still ends its run") {
    Host host;
    Loop loop(&host.loop);
    Ticker ticker(loop, 1ms, [&](const Tick&) { uv_stop(&host.loop); });
    CHECK(uv_run(&host.loop, UV_RUN_DEFAULT) != 0);
    CHECK(ticker.fired() >= 1);
  }

  TEST_CASE("two loops on one host, and objects that outlive both") {
    Host host;
    const auto before = host.walk();
    Ticker ticker;
    Timer timer;
    {
      Loop first(&host.loop);
      Loop second(&host.loop);
      ticker = Ticker(first, 1ms, [](const Tick&) {});
      timer = Timer(second, 1h, [] {});
      uv_run(&host.loop, UV_RUN_NOWAIT);
    }
    uv_run(&host.loop, UV_RUN_DEFAULT);
    CHECK(host.walk() == before);
    CHECK_FALSE(ticker.is_open());
    CHECK_FALSE(timer.is_open());
  }
}
