// What cannot be refused by an exception ends the program, which says why; and running a loop in any of its callbacks
// is refused, called while it runs or not.
#include <doctest/doctest.h>
#include <signal.h>
#include <sys/eventfd.h>
#include <sys/wait.h>
#include <unistd.h>
#include <uv.h>

#include <atomic>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "contract/at_end.hpp"
#include "has.hpp"
#include "loop/virtual_time.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sinks/sink.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;
using sinks::Number;

namespace {

/// What a program that does this says on standard error, with the signal that ended it; "0" and its code otherwise.
std::string end_of(const std::function<void()>& program) {
  int ends[2];
  REQUIRE(::pipe(ends) == 0);
  const pid_t child = ::fork();
  REQUIRE(child >= 0);
  if (child == 0) {
    ::signal(SIGABRT, SIG_DFL);  // doctest's and the sanitizers' would say more
    ::dup2(ends[1], 2);
    ::close(ends[0]);
    ::alarm(60);
    program();
    ::_exit(7);
  }
  ::close(ends[1]);
  std::string said;
  char some[512];
  for (ssize_t got = 0; (got = ::read(ends[0], some, sizeof some)) > 0;)
    said.append(some, static_cast<std::size_t>(got));
  ::close(ends[0]);
  int status = 0;
  ::waitpid(child, &status, 0);
  return "signal " + std::to_string(WIFSIGNALED(status) ? WTERMSIG(status) : 0) + ": " + said;
}

using rtdata::test::has;

/// Fails at the first opening if asked for, and lets a test do something in each of its calls.
struct Device {
  std::function<void()> in_open, in_read, in_close;
  Result<void> open() {
    if (in_open) in_open();
    return {};
  }
  Result<Number> read() {
    if (in_read) in_read();
    return Number{1};
  }
  void close() {
    if (in_close) in_close();
  }
};

class DoingWriter final : public Writer {
 public:
  explicit DoingWriter(std::function<void()> doing) : doing_(std::move(doing)) {}
  Result<void> open() override { return {}; }
  Result<void> write(Batch&) override {
    doing_();
    return {};
  }

 private:
  std::function<void()> doing_;
};

struct Meddler {
  std::function<void()>* moved;
  explicit Meddler(std::function<void()>* m) : moved(m) {}
  Meddler(Meddler&& other) : moved(other.moved) { (*moved)(); }
};

/// A loop, own or attached, of which each kind of callback does something.
struct Place {
  std::unique_ptr<Loop> loop;
  uv_loop_t* host = nullptr;
  std::vector<std::unique_ptr<Handle>> handles = {};
  int event = ::eventfd(1, EFD_NONBLOCK);

  template <class T>
  void keep(T handle) {
    handles.push_back(std::make_unique<T>(std::move(handle)));
  }
  void turn() {
    if (loop != nullptr && host == nullptr) {
      if (is_manual) {
        loop->advance(20ms);
      } else {
        loop->run_for(20ms);
      }
    }
    if (host != nullptr) {
      Timer end(*loop, 20ms, [] {});
      while (loop != nullptr && end.is_running()) uv_run(host, UV_RUN_ONCE);
    }
  }
  bool is_manual = false;
};

const char* const callbacks[] = {
    "timer",           "ticker",        "watch",         "signal",         "posted",
    "handler",         "sensor's open", "sensor's read", "sensor's close", "loop's report",
    "sensor's report", "log",           "payload",       "drained",        "captures of a sensor",
};

/// Makes the callback of that name do something once.
void do_in(const std::string& name, Place& place, const std::function<void()>& something) {
  Loop& loop = *place.loop;
  const auto throws = [] { throw std::runtime_error("told"); };
  if (name == "timer") place.keep(Timer(loop, 0s, something));
  if (name == "ticker") place.keep(Ticker(loop, 1ms, [=](const Tick&) { something(); }));
  if (name == "watch") place.keep(FdWatch(loop, place.event, FdWatch::readable, [=](const FdEvent&) { something(); }));
  if (name == "signal") {
    place.keep(SignalWatch(loop, SIGUSR2, something));
    ::raise(SIGUSR2);
  }
  if (name == "posted") loop.post(something);
  if (name == "handler") {
    place.keep(loop.topic<Number>("a").subscribe(loop, [=](const Event<Number>&) { something(); }));
    loop.topic<Number>("a").publish({1});
  }
  Device device;
  if (name == "sensor's open") device.in_open = something;
  if (name == "sensor's read") device.in_read = something;
  if (name == "sensor's close") device.in_close = something;
  if (name.find("sensor's ") == 0 && name != "sensor's report") {
    Sensor<Number> sensor(loop, {.name = "s", .rate = 1_kHz}, std::move(device));
    if (name == "sensor's close") sensor.stop();
    place.keep(std::move(sensor));
  }
  if (name == "sensor's report") {
    Feed<Number> feed(loop, {.name = "f"});
    feed.on_error([=](const ErrorReport&) { something(); });
    feed.fail({Errc::bad_data, "bad", "", "", ""});
  }
  if (name == "loop's report") {
    loop.on_error([=](const ErrorReport&) { something(); });
    place.keep(Timer(loop, 0s, throws));
  }
  if (name == "log") {
    loop.runtime().on_log([=](const LogRecord&) { something(); });
    Feed<Number> feed(loop, {.name = "f"});
    feed.fault({Errc::bad_data, "bad", "", "", ""});
  }
  if (name == "payload") {
    std::function<void()> moved = something;
    const Subscription subscription = loop.topic<Meddler>("m").subscribe(loop, [](const Event<Meddler>&) {});
    loop.topic<Meddler>("m").publish(Meddler(&moved));
  }
  if (name == "drained") loop.drain(1s, [=](std::uint64_t) { something(); });
  if (name == "captures of a sensor") {  // which go while the loop goes on with its turn
    auto* timer = new Timer;
    *timer = Timer(loop, 0s, [timer, end = AtEnd(something)] { delete timer; });
  }
}

constexpr const char* kinds[] = {"manual", "owned", "attached"};

void make_place(Place& place, const std::string& kind, uv_loop_t& host) {
  if (kind == "manual") place.loop = std::make_unique<Loop>(Loop::Manual{});
  if (kind == "owned") place.loop = std::make_unique<Loop>();
  if (kind == "attached") {
    REQUIRE(uv_loop_init(&host) == 0);
    place.host = &host;
    place.loop = std::make_unique<Loop>(&host);
  }
  place.is_manual = kind == "manual";
}

}  // namespace

TEST_SUITE("contract") {
  TEST_CASE("a loop that is destroyed in a callback of its own ends the program, which says so") {
    for (const std::string kind : kinds) {
      for (const std::string name : callbacks) {
        CAPTURE(kind);
        CAPTURE(name);
        const std::string end = end_of([&] {
          auto* place = new Place;
          auto* host = new uv_loop_t;
          make_place(*place, kind, *host);
          do_in(name, *place, [place] { place->loop.reset(); });
          place->turn();
        });
        CHECK(has(end, "signal " + std::to_string(SIGABRT)));
        CHECK(
            has(end, "rtdata: fatal: a loop is destroyed too early: loop main: this happens in one of its callbacks"));
      }
    }
  }

  TEST_CASE("a loop is not run in any of its callbacks, not even in those of setting it up") {
    for (const std::string kind : kinds) {
      for (const std::string name : callbacks) {
        CAPTURE(kind);
        CAPTURE(name);
        uv_loop_t host;
        int refused = 0;
        int called = 0;
        {
          Place place;
          make_place(place, kind, host);
          Loop& loop = *place.loop;
          loop.on_error([](const ErrorReport&) {});
          const auto refuses = [&](const auto& verb) {
            try {
              verb();
            } catch (const SetupError& e) {
              refused += e.error().code == Errc::busy ? 1 : 0;
            }
          };
          do_in(name, place, [&] {
            if (called++ > 0) return;
            refuses([&] { loop.poll(); });
            if (place.host != nullptr) return;
            refuses([&] { loop.run(); });
            refuses([&] { loop.run_for(1ms); });
            refuses([&] { loop.close(1ms); });
            if (place.is_manual) refuses([&] { loop.advance(1ms); });
          });
          place.turn();
          CHECK(called > 0);
          CHECK(refused == (place.host != nullptr ? 1 : place.is_manual ? 5 : 4));
          place.handles.clear();
          ::close(place.event);
        }
        if (kind == "attached") {
          uv_run(&host, UV_RUN_DEFAULT);
          CHECK(uv_loop_close(&host) == 0);
        }
      }
    }
  }

  TEST_CASE("a loop that captures own goes with them, where nothing of it is under way") {
    auto owner = std::make_shared<Loop>(Loop::Manual{});
    std::weak_ptr<Loop> seen = owner;
    Timer timer(*owner, 1s, [owner] {});
    Timer other(*owner, 1s, [] {});
    owner.reset();
    timer.close();
    CHECK(seen.expired());
    CHECK(!other.is_open());
  }

  TEST_CASE("a loop or tier that is destroyed in a writer's call ends the program, which says so") {
    for (const char* kind : {"manual", "owned"}) {
      CAPTURE(kind);
      const std::string end = end_of([&] {
        auto* place = new Place;
        make_place(*place, kind, *new uv_loop_t);
        place->keep(Sink(*place->loop, {.name = "s", .topics = {"#"}, .batch_rows = 1},
                         std::make_unique<DoingWriter>([place] { std::destroy_at(place->loop.get()); })));
        place->loop->topic<Number>("a").publish({1});
        for (int i = 0; i < 100; ++i) place->turn();
      });
      CHECK(has(end, "signal " + std::to_string(SIGABRT)));
      CHECK(has(end, "rtdata: fatal: a loop is destroyed too early: loop main"));
    }
    for (const bool while_running : {true, false}) {
      CAPTURE(while_running);
      const std::string end = end_of([&] {
        auto* loop = new Loop;
        auto tier = std::make_unique<Tier>(*loop, Tier::Config{});
        std::atomic<bool> is_time{while_running};
        Sink sink(*loop, {.name = "s", .topics = {"#"}, .batch_rows = 1}, std::make_unique<DoingWriter>([&] {
          while (!is_time) std::this_thread::sleep_for(1ms);
          tier.reset();
        }));
        loop->topic<Number>("a").publish({1});
        loop->run_for(while_running ? 30s : 50ms);
        is_time = true;
        std::this_thread::sleep_for(30s);
      });
      CHECK(has(end, "rtdata: fatal: a tier is destroyed where it may not be: tier fast"));
    }
  }

  TEST_CASE("a tier that is destroyed in a callback of its own ends the program; one that is stopped there stops") {
    const std::string end = end_of([&] {
      auto* loop = new Loop;
      auto tier = std::make_unique<Tier>(*loop, Tier::Config{});
      Timer timer(tier->loop(), 0s, [&] { tier.reset(); });
      loop->run_for(30s);
    });
    CHECK(has(end, "signal " + std::to_string(SIGABRT)));
    CHECK(has(end, "rtdata: fatal: a tier is destroyed where it may not be: tier fast"));
    const std::string set_up = end_of([&] {
      auto* loop = new Loop;
      auto tier = std::make_unique<Tier>(*loop, Tier::Config{});
      Device device;
      device.in_open = [&] { tier.reset(); };
      Sensor<Number> sensor(tier->loop(), {.name = "s", .rate = 1_kHz}, std::move(device));
    });
    CHECK(has(set_up, "rtdata: fatal: a loop is destroyed too early: loop fast"));

    Loop loop;
    Tier tier(loop, {});
    int stops = 0;
    Timer timer(tier.loop(), 0s, [&] {
      tier.stop();
      CHECK(!tier.stop_within(1h));
      ++stops;
      loop.stop();
    });
    loop.run();
    CHECK(tier.stop_within(10s));
    CHECK(stops == 1);
    CHECK(!tier.is_running());
  }

  TEST_CASE("a tier may be destroyed in any callback of its main loop") {
    for (const std::string name : callbacks) {
      CAPTURE(name);
      Place place{.loop = std::make_unique<Loop>()};
      Loop& loop = *place.loop;
      loop.on_error([](const ErrorReport&) {});
      auto tier = std::make_unique<Tier>(loop, Tier::Config{});
      Sensor<Number> sensor(tier->loop(), {.name = "t", .rate = 1_kHz}, [] { return Number{1}; });
      tier->start();
      int called = 0;
      do_in(name, place, [&] {
        tier.reset();
        ++called;
      });
      place.turn();
      CHECK(called > 0);
      CHECK(!tier);
      CHECK(!sensor.is_open());
      place.handles.clear();
      static_cast<void>(loop.close());
      CHECK(loop.runtime().balances());
      ::close(place.event);
    }
  }

  TEST_CASE("a loop that goes before its tier, and a runtime that goes before its loop, end the program with a word") {
    const std::string main = end_of([] {
      auto loop = std::make_unique<Loop>();
      const Tier tier(*loop, {});
      loop.reset();
    });
    CHECK(has(main, "rtdata: fatal: a loop is destroyed too early: loop main: tier fast still uses it"));
    const std::string runtime = end_of([] {
      auto of_loop = std::make_unique<Runtime>(Runtime::Config{.name = "set-up"});
      const Loop loop(*of_loop, {});
      of_loop.reset();
    });
    CHECK(has(runtime, "rtdata: fatal: a runtime is destroyed too early: \"set-up\": loop main still uses it"));
    const std::string in_log = end_of([] {
      auto of_loop = std::make_unique<Runtime>();
      of_loop->on_log([&](const LogRecord&) { of_loop.reset(); });
      auto loop = std::make_unique<Loop>(*of_loop, Loop::Config{});
      Timer timer(*loop, 0s, [] { throw std::runtime_error("told"); });
      loop->poll();
    });
    CHECK(has(in_log, "rtdata: fatal: a runtime is destroyed too early"));
  }

  TEST_CASE("a watch of tiers may be destroyed in its own report") {
    Loop loop{virtual_time()};
    Tier tier(loop, {});
    auto watch = std::make_unique<TierWatch>(loop, 1ms);
    bool is_reported = false;
    loop.on_error([&](const ErrorReport& report) {
      if (report.error.code != Errc::not_turning) return;
      watch.reset();
      is_reported = true;
      loop.stop();
    });
    Timer hangs(tier.loop(), 0s, [&] {
      while (!is_reported) loop.manual_clock().pass(1ms);  // as a callback that does not return would
    });
    Timer limit(loop, 30s, [&] { loop.stop(); });
    loop.run();
    CHECK(is_reported);
    CHECK(!watch);
    is_reported = true;
    tier.stop();
  }
}
