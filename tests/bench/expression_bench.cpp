// expression: what one evaluation costs over three values with a function that remembers, its values set before, beside
// the same by hand in C++, without a look at what is not finite.
#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

#include "harness.hpp"
#include "rtdata/process/expression.hpp"

namespace bench {
namespace {

constexpr unsigned events = 200'000;
constexpr const char* text = "altitude + 0.5 * speed < highest(altitude) - 5 * scale";

/// A flight up and down with noise.
const std::vector<double>& altitudes() {
  static const std::vector<double> all = [] {
    std::vector<double> made(1000);
    std::uint32_t noise = 1;
    for (std::size_t i = 0; i < made.size(); ++i) {
      noise = noise * 1664525u + 1013904223u;
      const double t = static_cast<double>(i) - 500;
      made[i] = 15000 - 0.06 * t * t + static_cast<double>(noise >> 8) / (1 << 24);
    }
    return made;
  }();
  return all;
}

double ns_per_event(std::int64_t begin) { return static_cast<double>(thread_cpu_ns() - begin) / events; }

class Ours {
 public:
  double measure() {
    const auto& all = altitudes();
    const std::int64_t begin = thread_cpu_ns();
    unsigned true_ones = 0;
    for (unsigned i = 0; i < events; ++i) {
      expression_.set(0, all[i % all.size()]);
      expression_.set(1, -3);
      expression_.set(2, 1.5);
      true_ones += expression_.evaluate(time_ += rtdata::Duration{10'000'000}).is_true() ? 1 : 0;
    }
    keep(true_ones);
    return ns_per_event(begin);
  }

 private:
  rtdata::Expression expression_{text, {"altitude", "speed", "scale"}};
  rtdata::Time time_{};
};

class Bare {
 public:
  double measure() {
    const auto& all = altitudes();
    const std::int64_t begin = thread_cpu_ns();
    unsigned true_ones = 0;
    for (unsigned i = 0; i < events; ++i) {
      double altitude = all[i % all.size()], speed = -3, scale = 1.5;
      keep(speed);
      keep(scale);
      highest_ = std::max(highest_, altitude);
      true_ones += altitude + 0.5 * speed < highest_ - 5 * scale ? 1 : 0;
    }
    keep(true_ones);
    return ns_per_event(begin);
  }

 private:
  double highest_ = -1e300;
};

}  // namespace

void bench_expression(Report& report) {
  if (!report.wants("expression")) return;
  Ours ours;
  Bare bare;
  report.add(measure_pair(
      {.name = "expression", .unit = "ns/event", .reach = 15}, [&] { return ours.measure(); },
      [&] { return bare.measure(); }, 15));
}

}  // namespace bench
