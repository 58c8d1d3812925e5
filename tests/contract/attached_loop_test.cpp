// Rule 7 of handle.hpp: on somebody else's uv_loop_t we are a guest.
#include <doctest/doctest.h>
#include <unistd.h>

#include <csignal>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <semaphore>

#include "contract/host.hpp"
#include "data/payloads.hpp"
#include "rtdata/detail/sensors/transaction.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sinks/recording_writer.hpp"
#include "rtdata/sinks/sink.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;
using payloads::Climate;
using rtdata::test::Host;

namespace {

/// What openings on lanes wait for.
struct Gate {
  std::counting_semaphore<> may_open{0};
  std::atomic<int> opened{0};
  std::atomic<int> held{0};  // of these, those which nobody let go
  void pass() {
    if (!may_open.try_acquire_for(10s)) ++held;
    ++opened;
  }
};

struct GateWriter final : RecordingWriter {
  GateWriter(Gate& gate_, bool fails_) : gate(gate_), fails(fails_) {}
  Opening opening() const override { return Opening::at_set_up; }
  Result<void> open() override {
    gate.pass();
    if (fails) return Error{Errc::not_permitted, "cannot open", "gate", "it is locked", ""};
    return {};
  }
  Result<void> write(Batch&) override { return {}; }
  Gate& gate;
  const bool fails;
};

struct GateDevice final : detail::LaneDevice {
  explicit GateDevice(Gate& gate_) : gate(gate_) {}
  struct Open final : detail::Transaction {
    explicit Open(Gate& gate_) : gate(gate_) {}
    void transact() noexcept override { gate.pass(); }
    Gate& gate;
  };
  struct Read final : detail::Transaction {
    void transact() noexcept override {}
  };
  std::shared_ptr<detail::Transaction> make_opening() override { return std::make_shared<Open>(gate); }
  Result<void> take_opening(detail::Transaction&) override { return {}; }
  std::shared_ptr<detail::Transaction> make_transaction() override { return std::make_shared<Read>(); }
  detail::Sampled decode(detail::Transaction&, detail::SamplePort& port) override {
    Climate climate{};
    port.publish(&climate);
    return detail::Sampled::value;
  }
  std::string lane_key() const override { return "gate"; }
  Duration give_up_after() const override { return 30s; }
  Error given_up_error() const override { return {Errc::timed_out, "no answer", "gate", "", ""}; }
  Gate& gate;
};

struct GateSensor : AnySensor {
  GateSensor(Loop& loop, Gate& gate)
      : AnySensor(detail::make_sensor(loop, {.name = "gate", .rate = 1_kHz}, detail::payload_type<Climate>(),
                                      std::make_unique<GateDevice>(gate))) {}
};

/// A function that the host calls in a timer of its own, once its loop has turned.
struct HostCall {
  HostCall(Host& host, std::function<void()> function_) : function(std::move(function_)) {
    uv_timer_init(&host.loop, &timer);
    timer.data = this;
    uv_timer_start(
        &timer, [](uv_timer_t* handle) { static_cast<HostCall*>(handle->data)->function(); }, 2, 0);
  }
  std::function<void()> function;
  uv_timer_t timer;
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

  TEST_CASE("before the host has run an attached loop, sensors and sinks wait for their opening, and failures throw") {
    Host host;
    Gate gate;
    gate.may_open.release(3);
    {
      Loop loop(&host.loop);
      GateSensor sensor(loop, gate);
      CHECK(gate.opened == 1);
      Sink sink(loop, {.name = "good"}, std::make_unique<GateWriter>(gate, false));
      CHECK(gate.opened == 2);
      CHECK_THROWS_AS(Sink(loop, {.name = "bad"}, std::make_unique<GateWriter>(gate, true)), SetupError);
      CHECK(gate.opened == 3);
      CHECK(loop.runtime().sinks().size() == 1);
      while (sensor.counts().taken < 2) uv_run(&host.loop, UV_RUN_ONCE);
      CHECK(sink.counts().offered >= 2);
    }
    CHECK(gate.held == 0);
  }

  TEST_CASE(
      "in a callback of the host's, once its loop has turned, neither a sensor nor a sink waits for its opening") {
    Host host;
    Gate gate;
    std::optional<HostCall> adds, lets_go;
    {
      Loop loop(&host.loop);
      std::vector<std::string> errors;
      loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
      std::optional<GateSensor> sensor;
      std::optional<Sink> sink, bad;
      uv_run(&host.loop, UV_RUN_NOWAIT);
      adds.emplace(host, [&] {
        sensor.emplace(loop, gate);
        sink.emplace(loop, SinkConfig{.name = "good"}, std::make_unique<GateWriter>(gate, false));
        bad.emplace(loop, SinkConfig{.name = "bad"}, std::make_unique<GateWriter>(gate, true));
        CHECK(gate.opened == 0);
        lets_go.emplace(host, [&] { gate.may_open.release(1000); });  // the bad one is tried again
      });
      while (errors.empty() || !sensor || sensor->counts().taken < 2 || sink->counts().offered < 2 || gate.opened < 3)
        uv_run(&host.loop, UV_RUN_ONCE);
      CHECK(gate.opened >= 3);
      CHECK(gate.held == 0);
      CHECK(errors[0].find("it is locked") != std::string::npos);
      CHECK(bad->is_open());
      bad->close();
    }
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
