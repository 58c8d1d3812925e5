// Payloads of the benchmarks.
#pragma once

#include <vector>

#include "rtdata/data/describe.hpp"

namespace bench {

struct Eight {
  double a = 0, b = 0, c = 0, d = 0, e = 0, f = 0, g = 0, h = 0;
  friend constexpr auto describe(rtdata::type_tag<Eight>) {
    using rtdata::field;
    return rtdata::record("eight", field("a", &Eight::a, "m"), field("b", &Eight::b, "m"), field("c", &Eight::c, "m"),
                          field("d", &Eight::d, "m"), field("e", &Eight::e, "m"), field("f", &Eight::f, "m"),
                          field("g", &Eight::g, "m"), field("h", &Eight::h, "m"));
  }
};

/// As readings are: some digits, not all. Made before, as what the limits send is: making them is not measured.
inline const Eight& reading(unsigned i) {
  constexpr unsigned count = 1000;
  static const std::vector<Eight> all = [] {
    std::vector<Eight> made;
    for (unsigned k = 0; k < count; ++k) {
      const double x = k;
      made.push_back({21.5 + x / 100, 1013.25 - x / 8, x / 3, -9.80665, x, 0.001 * x, 1e-5 * x + 3, 40 + x / 10});
    }
    return made;
  }();
  return all[i % count];
}

struct Single {
  double value = 0;
  friend constexpr auto describe(rtdata::type_tag<Single>) {
    return rtdata::record("single", rtdata::field("value", &Single::value, "V"));
  }
};

}  // namespace bench
