// Long runs on the kernel's own timers in simulated time, where the same happens in every run.
#include <doctest/doctest.h>

#include <ctime>

#include "kernel/bench.hpp"

using namespace bench;

namespace {

struct Sample {
  std::int64_t monotonic = 0;  ///< when it was taken
  RTDATA_FIELDS(Sample, (monotonic, "ns"))
};

/// A sensor whose ticks must all come, in their order, each on its grid.
struct Watched {
  Watched(Loop& loop, const char* name, Duration period_)
      : period(period_),
        sensor(loop, {.name = name, .rate = Rate::from_period(period)},
               [] { return Sample{SystemClock().monotonic().time_since_epoch().count()}; }),
        heard(loop.topic<Sample>(name).subscribe(loop, [this](const Event<Sample>& event) {
          const Duration taken{event->monotonic};
          if (events++ == 0) first = taken - taken % 1ms;  // schedules begin on whole milliseconds
          const Duration late = taken - first - period * static_cast<std::int64_t>(events - 1);
          if (late < Duration{0} || late > 200us || event.sequence != events) ++wrong;
          latest = std::max(latest, late);
        })) {}

  /// After a run up to `end`.
  void check(MonotonicTime end) const {
    const SensorCounts counts = sensor.counts();
    const auto ticks = static_cast<std::uint64_t>((end.time_since_epoch() - first) / period) + 1;
    CAPTURE(sensor.status().name);
    CHECK(counts.scheduled == ticks);
    CHECK(counts.taken == ticks);
    CHECK(counts.missed == 0);
    CHECK(counts.failed == 0);
    CHECK(counts.late == 0);
    CHECK(events == ticks);
    CHECK(wrong == 0);
    MESSAGE(sensor.status().name << ": " << ticks << " ticks, the latest " << to_string(latest) << " after it was due");
  }

  Duration period;
  Sensor<Sample> sensor;
  std::uint64_t events = 0, wrong = 0;
  Duration first{0}, latest{0};
  Subscription heard;
};

/// Runs it, and hands out what was read last. Returns the end.
MonotonicTime run(Loop& loop, Duration duration) {
  const MonotonicTime end = loop.now() + duration;
  loop.run_for(duration);
  loop.poll();
  return end;
}

}  // namespace

TEST_SUITE("long run") {
  TEST_CASE("NFR-4 two minutes at 1 kHz on the kernel's timer: each tick comes, on its grid" *
            doctest::skip(!is_time_simulated())) {
    Loop loop;
    Watched fast(loop, "fast", 1ms), odd(loop, "odd", 333ms), slow(loop, "slow", 10s);
    const MonotonicTime end = run(loop, 2min);
    for (const Watched* one : {&fast, &odd, &slow}) one->check(end);
    close_balanced(loop);
  }

  TEST_CASE("NFR-4 thirty days at one tick a minute on the kernel's timer: each tick comes, on its grid" *
            doctest::skip(!is_time_simulated())) {
    Loop loop;
    Watched slow(loop, "slow", 1min), slower(loop, "slower", 24h);
    const MonotonicTime end = run(loop, 30 * 24h);
    for (const Watched* one : {&slow, &slower}) one->check(end);
    close_balanced(loop);
  }

  TEST_CASE("US-26 NFR-4 an hour of recording at 20 Hz: each tick is in the recording, and it verifies" *
            doctest::skip(!is_time_simulated())) {
    recordings::Folder folder;
    const std::string path = folder / "run.db";
    std::int64_t ticks = 0;
    {
      Loop loop;
      SqliteSink sink(loop, {.path = path});
      Watched sensor(loop, "sensor", 50ms);
      sensor.check(run(loop, 1h));
      ticks = static_cast<std::int64_t>(sensor.events);
      close_balanced(loop);
    }
    CHECK(ticks >= 72'000);
    CHECK(recordings::number(path, "SELECT count(*) FROM sensor") == ticks);
    CHECK(recordings::number(path, "SELECT max(sequence) FROM sensor") == ticks);
    check_verifies(path);
  }
}
