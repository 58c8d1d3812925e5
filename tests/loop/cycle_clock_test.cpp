#include "loop/core/cycle_clock.hpp"

#include <doctest/doctest.h>

using namespace rtdata;
using namespace std::chrono_literals;
using detail::CycleClock;

TEST_SUITE("loop") {
  TEST_CASE("NFR-1 the clock read through the processor's counter agrees with the kernel's and never goes back") {
    constexpr Duration agreement = 2us;
    CycleClock clock;
    MonotonicTime last = clock.now();
    std::uint64_t readings = 0;
    std::uint64_t apart = 0;
    std::uint64_t backwards = 0;
    const MonotonicTime end = CycleClock::kernel_time() + 100ms;  // some comparisons of the two rates
    for (MonotonicTime after{}; after < end; ++readings) {
      const MonotonicTime before = CycleClock::kernel_time();
      const MonotonicTime now = clock.now();
      after = CycleClock::kernel_time();
      apart += now < before - agreement || now > after + agreement ? 1 : 0;
      backwards += now < last ? 1 : 0;
      last = now;
    }
    CHECK(readings > 10);
    CHECK(apart == 0);
    CHECK(backwards == 0);
  }
}
