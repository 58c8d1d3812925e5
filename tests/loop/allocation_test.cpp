// Counts allocations on the sampling path. A program of its own, since it replaces operator new and delete.
// More stages (a sink's copy, say) are added as one more `Stage`.
#define DOCTEST_CONFIG_IMPLEMENT_WITH_MAIN
#include <doctest/doctest.h>

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <functional>
#include <limits>
#include <memory>
#include <new>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "loop/observed.hpp"
#include "rtdata/fsm/machine.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/derived.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/limit.hpp"
#include "rtdata/sinks/sink.hpp"

namespace {

std::atomic<std::uint64_t> allocations{0};
thread_local std::uint64_t own_allocations = 0;  // of this thread

void* allocate(std::size_t size, std::size_t alignment) {
  allocations.fetch_add(1, std::memory_order_relaxed);
  ++own_allocations;
  void* memory = nullptr;
  if (::posix_memalign(&memory, std::max(alignment, sizeof(void*)), std::max<std::size_t>(size, 1)) != 0)
    throw std::bad_alloc();
  return memory;
}

}  // namespace

void* operator new(std::size_t size) { return allocate(size, alignof(std::max_align_t)); }
void* operator new[](std::size_t size) { return allocate(size, alignof(std::max_align_t)); }
void* operator new(std::size_t size, std::align_val_t alignment) {
  return allocate(size, static_cast<std::size_t>(alignment));
}
void* operator new[](std::size_t size, std::align_val_t alignment) {
  return allocate(size, static_cast<std::size_t>(alignment));
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete[](void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
void operator delete[](void* memory, std::size_t) noexcept { std::free(memory); }
void operator delete(void* memory, std::align_val_t) noexcept { std::free(memory); }
void operator delete[](void* memory, std::align_val_t) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t, std::align_val_t) noexcept { std::free(memory); }
void operator delete[](void* memory, std::size_t, std::align_val_t) noexcept { std::free(memory); }

using namespace rtdata;
using namespace rtdata::literals;
using observed::Number;
using observed::Reordered;

namespace {

/// A part of the sampling path: set up on the loop, kept while it runs; returns how often it did its work.
struct Stage {
  const char* name;
  std::function<std::function<std::uint64_t()>(Loop&)> set_up;
};

class Nowhere final : public Writer {
  Result<void> open() override { return {}; }
  Result<void> write(Batch&) override { return {}; }
};

template <class T>
std::shared_ptr<T> keep(T object) {
  return std::make_shared<T>(std::move(object));
}

auto count_events(Subscription subscription) {
  return [kept = keep(std::move(subscription))] { return kept->counts().delivered; };
}

const std::vector<Stage>& stages() {
  static const std::vector<Stage> all{
      {"tick",
       [](Loop& loop) {
         auto ticker = keep(Ticker(loop, 10ms, [](const Tick&) {}));
         return std::function<std::uint64_t()>([ticker] { return ticker->fired(); });
       }},
      {"timer that starts itself again",
       [](Loop& loop) {
         auto timer = std::make_shared<Timer>();
         auto fired = std::make_shared<std::uint64_t>(0);
         *timer = Timer(loop, 1ms, [raw = timer.get(), fired] {
           ++*fired;
           raw->start(10ms);
         });
         return std::function<std::uint64_t()>([timer, fired] { return *fired; });
       }},
      {"sample and publish",
       [](Loop& loop) {
         auto sensor = keep(Sensor<Number>(loop, {.name = "sensor", .rate = 100_Hz}, [] { return Number{1, 2}; }));
         return std::function<std::uint64_t()>([sensor] { return sensor->counts().published; });
       }},
      {"sample, calibrate, filter and publish",
       [](Loop& loop) {
         const FieldProcessing steps{.calibration = Calibration{.scale = 2, .table = {{-9, 0}, {9, 1}}},
                                     .filters = {Filter::median(5), Filter::mean(7), Filter::exponential(0.5),
                                                 Filter::rate_of_change(), Filter::throttle(1ns)}};
         auto sensor = keep(
             Sensor<Number>(loop, {.name = "processed", .rate = 100_Hz, .process = {{"value", steps}}}, [] {
               return Number{1, 2};
             }));
         return std::function<std::uint64_t()>([sensor] { return sensor->counts().published; });
       }},
      {"publish by the program and by a feed",
       [](Loop& loop) {
         auto feed = keep(Feed<Number>(loop, {.name = "feed"}));
         const auto topic = loop.topic<Number>("program");
         auto ticker = keep(Ticker(loop, 10ms, [feed, topic](const Tick&) {
           feed->publish({});
           topic.publish({});
         }));
         return std::function<std::uint64_t()>([feed, ticker] { return feed->counts().published; });
       }},
      {"deliver to a typed handler",
       [](Loop& loop) {
         return std::function<std::uint64_t()>(
             count_events(loop.subscribe<Number>("sensor", [](const Event<Number>&) {})));
       }},
      {"deliver to a handler of views",
       [](Loop& loop) {
         return std::function<std::uint64_t()>(count_events(loop.subscribe("#", [](const EventView&) {})));
       }},
      {"derive by expressions with memories",
       [](Loop& loop) {
         auto derived = keep(DerivedSensor(loop, {.name = "derived"},
                                           {.on = "sensor",
                                            .fields = {{"a", "value > 0 ? highest(value) + mean(value, 0.05) : 0"},
                                                       {"b", "since(value > 0) + rate(value) + rate(value, 1)"}}}));
         return std::function<std::uint64_t()>([derived] { return derived->counts().published; });
       }},
      {"watch limits",
       [](Loop& loop) {
         auto limit = keep(LimitSensor(loop, {.name = "limit"}, {.on = "sensor", .field = "value", .high = 0.5}));
         return std::function<std::uint64_t()>(
             [seen = count_events(loop.subscribe("sensor", [](const EventView&) {})), limit] { return seen(); });
       }},
      {"change the states of a machine",
       [](Loop& loop) {
         auto machine = keep(fsm::Machine(loop, {.name = "machine", .start = "a"}));
         auto input = keep(fsm::Input<Number>(*machine, "sensor", 1s));
         for (const char* state : {"a", "b"}) machine->add_state(state, {.arrive = [] {}, .leave = [] {}});
         machine->add_transition({.from = "a", .to = "b", .when = [input] { return *input && (*input)->value > 0; }});
         machine->add_transition({.from = "b", .to = "a", .after = 5ms});
         machine->add_transition({.from = "b", .to = "a", .on = "back"});
         machine->start();
         auto ticker = keep(Ticker(loop, 70ms, [machine](const Tick&) { machine->raise("back"); }));
         return std::function<std::uint64_t()>([machine, ticker] { return machine->counts().transitions; });
       }},
      {"deliver with the fields mapped",
       [](Loop& loop) {
         auto feed = keep(Feed<Reordered>(loop, {.name = "reordered"}));
         auto ticker = keep(Ticker(loop, 10ms, [feed](const Tick&) { feed->publish({}); }));
         return std::function<std::uint64_t()>(
             [ticker, count = count_events(loop.subscribe<Number>("reordered", [](const Event<Number>&) {}))] {
               return count();
             });
       }},
      {"copy for a sink, and hand over batches",
       [](Loop& loop) {
         auto sink = keep(Sink(loop, {.name = "sink", .batch_time = 20ms}, std::make_unique<Nowhere>()));
         return std::function<std::uint64_t()>([sink] { return sink->counts().offered; });
       }},
  };
  return all;
}

/// Runs the stages into their steady state, then counts allocations in some runs more. The fewest in one of them: where
/// the machine is slow for a while, ticks are missed and queues grow, which is not the steady state.
std::uint64_t allocations_of(Loop& loop, const std::vector<Stage>& chosen, int runs, Duration run,
                             std::uint64_t at_least) {
  std::vector<std::function<std::uint64_t()>> counters;
  std::vector<std::uint64_t> before;
  for (const Stage& stage : chosen) counters.push_back(stage.set_up(loop));
  loop.run_for(100ms);
  for (const auto& counter : counters) before.push_back(counter());
  std::uint64_t fewest = std::numeric_limits<std::uint64_t>::max();
  for (int i = 0; i < runs; ++i) {
    const std::uint64_t start = allocations.load();
    loop.run_for(run);
    fewest = std::min(fewest, allocations.load() - start);
  }
  for (std::size_t i = 0; i < counters.size(); ++i) {
    INFO(chosen[i].name);
    CHECK(counters[i]() - before[i] >= at_least);
  }
  return fewest;
}

}  // namespace

TEST_SUITE("allocation") {
  TEST_CASE("NFR-4 nothing is allocated on the sampling path in its steady state, in virtual time") {
    for (std::size_t upto = 1; upto <= stages().size(); ++upto) {
      INFO("up to: ", std::string(stages()[upto - 1].name));
      Loop loop(Loop::Manual{});
      const std::vector<Stage> chosen(stages().begin(), stages().begin() + static_cast<std::ptrdiff_t>(upto));
      CHECK(allocations_of(loop, chosen, 1, 200ms, 20) == 0);
      CHECK(loop.runtime().balances());
    }
  }

  TEST_CASE("NFR-4 nor in real time") {
    Loop loop({.hold_limit = 60s});
    // run_for makes one timer for its end: a node.
    CHECK(allocations_of(loop, stages(), 10, 200ms, 10) <= 1);
  }

  /// Sensors, a feed and accounts cross from a tier; returns what its thread allocates from tick to tick, while the
  /// machine is not so slow that ticks are missed (that its gaps found no room in the ring is reported).
  struct Sending {
    std::uint64_t allocated = 0;
    unsigned ticks = 0;
    std::uint64_t received = 0;
    std::uint64_t dropped = 0;
    bool balances = false;
  };
  Sending sending(std::size_t ring_bytes, unsigned events_a_tick) {
    constexpr unsigned first = 300;
    constexpr unsigned last = 800;
    Loop loop;
    Tier fast(loop, {.lock_memory = false, .hold_limit = 60s, .ring_bytes = ring_bytes});
    Sending result;
    Sink sink(loop, {.name = "sink", .batch_time = 20ms}, std::make_unique<Nowhere>());
    auto subscription = loop.subscribe("#", [&](const EventView&) { ++result.received; });
    Sensor<Number> sensor(fast.loop(), {.name = "sensor", .rate = 1_kHz}, [] { return Number{1, 2}; });
    Feed<Number> feed(fast.loop(), {.name = "feed"});
    unsigned tick = 0;
    unsigned calm = 0;  // ticks since one was missed
    std::uint64_t missed = 0;
    std::uint64_t before = 0;
    Ticker ticker(fast.loop(), 1ms, [&](const Tick&) {
      for (unsigned i = 0; i < events_a_tick; ++i) feed.publish({});
      ++tick;
      if (tick == 10) std::this_thread::sleep_for(5ms);  // the sensor's first gap, for which there is room from then on
      calm = sensor.counts().missed == std::exchange(missed, sensor.counts().missed) ? calm + 1 : 0;
      if (tick > first && calm > 3) {
        result.allocated += own_allocations - before;
        ++result.ticks;
      }
      before = own_allocations;
      if (tick == last) loop.stop();
    });
    loop.run();
    fast.stop();
    loop.poll();
    const auto counts = subscription.counts();
    result.dropped = counts.dropped;
    result.balances = counts.balances();
    return result;
  }

  TEST_CASE("NFR-4 nothing is allocated where events are sent from a tier to another loop") {
    const Sending sent = sending(std::size_t{1} << 20, 3);
    CHECK(sent.allocated == 0);
    CHECK(sent.ticks > 0);
    CHECK(sent.received > 2000);
    CHECK(sent.balances);
  }

  TEST_CASE("NFR-4 nor where the ring between them is full, and events are dropped and counted") {
    const Sending sent = sending(4096, 200);
    CHECK(sent.allocated == 0);
    CHECK(sent.ticks > 0);
    CHECK(sent.dropped > 0);
    CHECK(sent.balances);
  }
}
