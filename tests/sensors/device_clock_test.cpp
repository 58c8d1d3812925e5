// Times by the clock of a device: against the true ones, with delays, bundles, drifts, wraps and restarts.
#include "sensors/lines/device_clock.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <cstring>
#include <random>
#include <string>
#include <vector>

#include "has.hpp"
#include "rtdata/data/event.hpp"
#include "rtdata/sensors/serial_line.hpp"
#include "sensors/fixture.hpp"
#include "sensors/pty.hpp"
#include "sensors/termios2.hpp"

using namespace rtdata;
using rtdata::test::has;
using namespace std::chrono_literals;

namespace {

struct ClockBench {
  explicit ClockBench(Kind of, Duration step = 1us)
      : description(line_description({{.name = "t", .type = of}}).or_throw()),
        clock({.field = "t", .step = step}, *description),
        kind(of) {}
  /// Our time of a line with this count, read then; both in ns.
  std::int64_t at(double count, double arrival) {
    std::byte payload[8] = {};
    if (kind == Kind::f64) {
      std::memcpy(payload, &count, sizeof count);
    } else {
      const auto whole = static_cast<std::uint64_t>(static_cast<std::int64_t>(count));
      std::memcpy(payload, &whole, sizeof whole);
    }
    const MonotonicTime read{Duration{static_cast<std::int64_t>(arrival)}};
    const MonotonicTime time = clock.time_of(payload, read);
    CHECK(time <= read);
    return time.time_since_epoch().count();
  }
  std::shared_ptr<const Description> description;
  detail::DeviceClock clock;
  const Kind kind;
};

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-13 lines that come in bundles have the times at which the device made them") {
    // 1 kHz, 80 ppm fast, handed over each 16 ms, as FTDI's adapters do, with a delay of 1 to 3 ms more.
    ClockBench bench(Kind::u32);
    std::mt19937 random(7);
    std::uniform_real_distribution<double> more(1e6, 3e6);
    constexpr double ms = 1e6, fast = 1 + 80e-6;
    double worst = 0, worst_of_reads = 0, bundle = 0;
    for (int i = 0; i < 200'000; ++i) {
      const double made = i * ms;
      if (i % 16 == 0) bundle = made + 15 * ms + more(random);
      const double time = static_cast<double>(bench.at(std::floor(made * fast / 1e3), 1e12 + bundle));
      if (i < 5000) continue;
      worst = std::max(worst, std::fabs(time - (1e12 + made)));
      worst_of_reads = std::max(worst_of_reads, bundle - made);
    }
    INFO(worst);
    CHECK(worst < 2 * ms);  // the shortest delay of the line, which nothing shows, and 1 ms
    CHECK(worst_of_reads > 16 * ms);
    const auto drift = bench.clock.take_drift();
    REQUIRE(drift);
    CHECK(std::fabs(*drift - 80) < 20);
    CHECK_FALSE(bench.clock.take_drift());
    CHECK_FALSE(bench.clock.take_restart());
  }

  TEST_CASE("US-13 a clock that is half a percent slow is followed") {
    ClockBench bench(Kind::u32);
    constexpr double ms = 1e6, slow = 1 - 5e-3;
    double worst = 0;
    for (int i = 0; i < 30'000; ++i) {
      const double made = i * 10 * ms;
      const double time = static_cast<double>(bench.at(std::floor(made * slow / 1e3), made + ms));
      if (i > 500) worst = std::max(worst, std::fabs(time - made - ms));
    }
    INFO(worst);
    CHECK(worst < 0.1 * ms);
  }

  TEST_CASE("US-13 a device's clock wraps around, also while nothing comes, and starts again") {
    ClockBench bench(Kind::u16, 1ms);
    constexpr double s = 1e9;
    bench.at(65'000, 100 * s);
    CHECK(bench.at(464, 101 * s) == 101 * 1'000'000'000LL);  // 1000 ms later, around
    CHECK(bench.at(464, 101 * s + 65.536 * 3 * s) == static_cast<std::int64_t>(101 * s + 65.536 * 3 * s));
    CHECK_FALSE(bench.clock.take_restart());

    ClockBench wide(Kind::u32, 1ms);
    wide.at(1'000'000, 10 * s);
    wide.at(1'001'000, 11 * s);
    CHECK_FALSE(wide.clock.take_restart());
    CHECK(wide.at(20, 12 * s) == 12 * 1'000'000'000LL);
    CHECK(wide.clock.take_restart());
    CHECK(wide.at(520, 12.6 * s) == static_cast<std::int64_t>(12.5 * s));
    CHECK_FALSE(wide.clock.take_restart());
    // A wrong digit: it has "started again", twice, and the times are right behind it.
    wide.at(9'000'620, 12.7 * s);
    CHECK(wide.clock.take_restart());
    wide.at(720, 12.8 * s);
    CHECK(wide.clock.take_restart());
    CHECK(wide.at(1720, 13.9 * s) == static_cast<std::int64_t>(13.8 * s));

    ClockBench seconds(Kind::f64, 1s);
    seconds.at(0.25, 5 * s);
    CHECK(seconds.at(0.75, 5.6 * s) == static_cast<std::int64_t>(5.5 * s));
    seconds.at(std::nan(""), 6 * s);
    CHECK(seconds.clock.take_restart());
    seconds.at(7, 7 * s);
    CHECK(seconds.clock.take_restart());
    CHECK(seconds.at(8, 8.5 * s) == 8'000'000'000LL);
  }

  TEST_CASE("US-13 a clock that does not run as ours is of no use, and the times are those of the reads") {
    constexpr double s = 1e9;
    const auto worst_of = [](ClockBench& bench, double rate, double seconds) {
      double late = 0;
      for (double t = 0; t < seconds; t += 0.01)
        late = std::max(late, t * s - static_cast<double>(bench.at(std::floor(t * rate), t * s)));
      CHECK_FALSE(bench.clock.take_restart());
      return late;
    };
    ClockBench wrong_step(Kind::u32, 1us);  // it counts milliseconds
    CHECK(worst_of(wrong_step, 1e3, 4) < 3.1 * s);
    CHECK(wrong_step.clock.take_useless());
    CHECK_FALSE(wrong_step.clock.take_useless());
    CHECK(worst_of(wrong_step, 1e3, 100) < 10);  // ns: what a double loses
    ClockBench still(Kind::u32, 1ms);
    CHECK(worst_of(still, 0, 100) < 3.1 * s);
    CHECK(still.clock.take_useless());
    ClockBench slow(Kind::u32, 1ms);
    CHECK(worst_of(slow, 970, 200) < 1 * s);
    CHECK(slow.clock.take_useless());
    slow.clock.forget();                          // opened again
    CHECK(worst_of(slow, 1000, 200) < 0.01 * s);  // in the first seconds, of counts of 1 ms
    CHECK_FALSE(slow.clock.take_useless());

    // A device that sleeps between its lines, and whose clock stands still then.
    ClockBench sleeper(Kind::u32, 1ms);
    for (int i = 0; i < 5; ++i) CHECK(sleeper.at(5 * i, 8 * i * s) == static_cast<std::int64_t>(8 * i * s));
    CHECK(sleeper.clock.take_restart());
    // Lines that a network has held up for 3 s have their own times.
    ClockBench held(Kind::u32, 1ms);
    for (int i = 0; i < 1000; ++i) held.at(10 * i, i * 0.01 * s);
    for (int i = 1000; i < 1300; ++i)
      CHECK(std::fabs(static_cast<double>(held.at(10 * i, 13 * s)) - i * 0.01 * s) < 0.001 * s);
    CHECK_FALSE(held.clock.take_restart());
    CHECK_FALSE(held.clock.take_useless());
  }

  TEST_CASE("US-13 any counts and delays give times that are never later than the reads") {
    std::mt19937_64 random(11);
    for (const Kind kind : {Kind::u8, Kind::i16, Kind::u32, Kind::i64, Kind::u64, Kind::f64}) {
      ClockBench bench(kind, std::chrono::milliseconds{1 + static_cast<int>(random() % 1000)});
      double arrival = 0;
      for (int i = 0; i < 20'000; ++i) {
        arrival += static_cast<double>(random() % 3'000'000'000);
        bench.at(static_cast<double>(static_cast<std::int32_t>(random())), arrival);
      }
    }
  }

  TEST_CASE("US-13 events of a serial line have the device's times") {
    ScratchDirectory folder;
    Pty pty(folder.file("tty"));
    pty.plug_in();
    Loop loop;
    be_quiet(loop);
    std::vector<Time> times;
    const auto heard = loop.subscribe("line", [&](const EventView& event) { times.push_back(event.time()); });
    SerialLineSensor sensor(loop, {.name = "line"},
                            {.device = pty.path(),
                             .lines = {.fields = {{.name = "t", .type = Kind::u32}, {.name = "v"}},
                                       .first_line = FirstLine::keep,
                                       .device_time = DeviceTime{.field = "t", .step = 1ms}}});
    const auto send = [&](const std::string& text, std::size_t count) {
      REQUIRE(pty.send(text) == text.size());
      for (int i = 0; i < 5000 && times.size() < count; ++i) loop.run_for(1ms);
      REQUIRE(times.size() == count);
    };
    send("1000,1\n", 1);
    loop.run_for(40ms);
    send("1010,2\n1020,3\n1030,4\n", 4);
    CHECK(times[1] - times[0] == 10ms);
    CHECK(times[2] - times[1] == 10ms);
    CHECK(times[3] - times[2] == 10ms);
  }

  TEST_CASE("US-13 only a field that counts is a device's clock") {
    const auto refusal = [](std::vector<LineField> fields) {
      try {
        detail::DeviceClock({.field = "t"}, *line_description(fields).or_throw());
      } catch (const SetupError& error) {
        return error.error().why;
      }
      return std::string();
    };
    CHECK(has(refusal({{.name = "v"}}), "is not among the fields"));
    CHECK(has(refusal({{.name = "t", .type = Kind::f32}}), "cannot count"));
    CHECK(has(refusal({{.name = "t", .type = Kind::u32, .optional = true}}), "is optional"));
    CHECK(refusal({{.name = "t", .type = Kind::u32}}).empty());
  }
}
