// filter: what a field costs that is scaled, goes through a polynomial of degree 3 and a median of 5, with its raw
// value kept, beside the same written by hand for these fields; both are published by a feed to which nobody listens.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "harness.hpp"
#include "rtdata/data/describe.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/sensors/feed.hpp"

namespace bench {
namespace {

constexpr std::size_t fields = 8;
constexpr unsigned samples = 100'000;
constexpr double scale = 1.02, offset = -0.3;
constexpr std::array<double, 4> coefficients{0.5, 1.25, -0.001, 1e-5};

struct Raw {
  std::array<double, fields> value{};
  friend constexpr auto describe(rtdata::type_tag<Raw>) {
    return rtdata::record("levels", rtdata::field("value", &Raw::value, "V"));
  }
};
struct Both {
  std::array<double, fields> value{};
  std::array<double, fields> raw{};
  friend constexpr auto describe(rtdata::type_tag<Both>) {
    return rtdata::record("levels", rtdata::field("value", &Both::value, "V"), rtdata::field("raw", &Both::raw, "V"));
  }
};

/// A level with noise: a median has something to choose.
const std::vector<Raw>& readings() {
  static const std::vector<Raw> all = [] {
    std::vector<Raw> made(1000);
    std::uint32_t noise = 1;
    for (Raw& one : made) {
      for (double& value : one.value) {
        noise = noise * 1664525u + 1013904223u;
        value = 20 + static_cast<double>(noise >> 8) / (1 << 24);
      }
    }
    return made;
  }();
  return all;
}

double ns_per_field(std::int64_t begin) {
  return static_cast<double>(thread_cpu_ns() - begin) / (samples * static_cast<double>(fields));
}

class Processed {
 public:
  double measure() {
    const auto& all = readings();
    const std::int64_t begin = thread_cpu_ns();
    rtdata::Time time = loop_.time();
    for (unsigned i = 0; i < samples; ++i) feed_.publish(all[i % all.size()], time += rtdata::Duration{1000});
    return ns_per_field(begin);
  }

 private:
  static rtdata::Processing process() {
    rtdata::Calibration calibration{.scale = scale, .offset = offset};
    calibration.polynomial.assign(coefficients.begin(), coefficients.end());
    return {{"value", {.calibration = calibration, .filters = {rtdata::Filter::median(5)}}}};
  }
  rtdata::Loop loop_{rtdata::Loop::Manual{}};
  rtdata::Feed<Raw> feed_{loop_, {.name = "levels", .process = process()}};
};

class ByHand {
 public:
  double measure() {
    const auto& all = readings();
    const std::int64_t begin = thread_cpu_ns();
    rtdata::Time time = loop_.time();
    for (unsigned i = 0; i < samples; ++i) {
      Both both;
      both.raw = all[i % all.size()].value;
      for (std::size_t field = 0; field < fields; ++field) {
        const double x = both.raw[field] * scale + offset;
        const double y = coefficients[0] + x * (coefficients[1] + x * (coefficients[2] + x * coefficients[3]));
        if (std::isfinite(y)) both.value[field] = median(field, y);
      }
      at_ = at_ == 4 ? 0 : at_ + 1;
      feed_.publish(both, time += rtdata::Duration{1000});
    }
    return ns_per_field(begin);
  }

 private:
  double median(std::size_t field, double newest) {
    auto& window = windows_[field];
    window[at_] = newest;
    auto [a, b, c, d, e] = window;
    const auto sort = [](double& low, double& high) {
      const double least = std::min(low, high);
      high = std::max(low, high);
      low = least;
    };
    sort(a, b);
    sort(c, d);
    sort(a, c);  // a is not the median
    sort(b, d);  // nor is d
    sort(b, c);
    return std::max(b, std::min(c, e));
  }
  std::array<std::array<double, 5>, fields> windows_{};
  std::size_t at_ = 0;
  rtdata::Loop loop_{rtdata::Loop::Manual{}};
  rtdata::Feed<Both> feed_{loop_, {.name = "levels"}};
};

}  // namespace

void bench_filter(Report& report) {
  if (!report.wants("filter")) return;
  Processed ours;
  ByHand limit;
  report.add(measure_pair(
      {.name = "filter", .unit = "ns/field", .reach = 2}, [&] { return ours.measure(); },
      [&] { return limit.measure(); }, 15));
}

}  // namespace bench
