/// CallbackTimes: how long the callbacks of one object took, for blame.
///
///     for (const rtdata::CallbackStatus& one : loop.callbacks())
///       std::cout << one.name << ": " << rtdata::to_string(one.times.max) << '\n';
///
/// Thread: plain values, a copy made by the call that returned them; each copy belongs to the thread that has it.
#pragma once

#include <cstdint>
#include <string>

#include "rtdata/data/time.hpp"

namespace rtdata {

/// How long the callbacks of one object took. Handlers of nanoseconds are timed in groups: each group counts once.
struct CallbackTimes {
  std::uint64_t count = 0;
  Duration total{0};
  Duration max{0};
  std::uint32_t held = 0;  ///< of these, how many held the loop longer than its limit
  /// 99 of 100 took no longer: an estimate, to some 15 %, that follows what changes within some thousand calls.
  Duration p99() const noexcept { return Duration{static_cast<Duration::rep>(p99_)}; }

  void add(Duration took) noexcept {
    ++count;
    total += took;
    if (took > max) max = took;
    // Goes up by an eighth for one that is longer, and down by so little for one that is not that 99 of them even it
    // out.
    const auto ns = static_cast<float>(took.count());
    if (ns > p99_) {
      const float raised = p99_ * 1.125F + 1;
      p99_ = ns < raised || count == 1 ? ns : raised;
    } else {
      p99_ -= p99_ * (1.0F / 840);
    }
  }

 private:
  float p99_ = 0;
};

/// The callbacks of one object, with its name and, where a configuration file made it, its place there.
struct CallbackStatus {
  std::string name;   ///< "sensor chamber", "handler of room/#"
  std::string place;  ///< "bench.json:7:5"; empty: made by the program
  CallbackTimes times;
};

}  // namespace rtdata
