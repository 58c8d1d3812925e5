// A fast sensor on a real-time tier, recorded by the main loop, with a handler that may take its time.
#include <cmath>
#include <cstdio>

#include "rtdata/loop/tier.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata::literals;

struct Pressure {
  double bar = 0;
  friend constexpr auto describe(rtdata::type_tag<Pressure>) {
    return rtdata::record("pressure", rtdata::field("bar", &Pressure::bar, "bar"));
  }
};

int main() {
  rtdata::Loop loop;
  rtdata::Tier fast(loop, {.name = "fast", .policy = rtdata::SchedulingPolicy::fifo, .priority = 80});
  rtdata::Sensor<Pressure> chamber(fast.loop(), {.name = "chamber", .rate = 1_kHz},
                                   [n = 0]() mutable { return Pressure{20 + std::sin(0.01 * ++n)}; });

  rtdata::SqliteSink sink(loop, {.path = "tiers.db"});
  double highest = 0;
  const auto watch = loop.subscribe<Pressure>(
      "chamber", [&](const rtdata::Event<Pressure>& event) { highest = std::fmax(highest, event->bar); });

  loop.run_for(std::chrono::seconds{1});
  loop.close();
  const rtdata::SensorCounts counts = chamber.counts();
  std::printf("%llu samples, %llu late, %llu missed, at most %.3f bar\n", static_cast<unsigned long long>(counts.taken),
              static_cast<unsigned long long>(counts.late), static_cast<unsigned long long>(counts.missed), highest);
  return loop.runtime().balances() ? 0 : 1;
}
