// What `rtdata bench` measures: rt-data, and beside it what the machine gives without.
#pragma once

#include <chrono>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/data/time.hpp"
#include "rtdata/loop/scheduling.hpp"

namespace rtdata::app {

/// Thrown by what measures throughput, soon after SIGINT, SIGTERM or SIGHUP, once `catch_interrupts` was called.
struct Interrupted {};
void catch_interrupts();
void throw_if_interrupted();

// ---- sampling

/// The ticks of a timer.
struct Ticks {
  std::vector<std::int64_t> lateness;  // ns; room for all is made before
  std::uint64_t missed = 0;
  void add(const Ticks& other) {
    lateness.insert(lateness.end(), other.lateness.begin(), other.lateness.end());
    missed += other.missed;
  }
  std::uint64_t all() const { return lateness.size() + missed; }
};

/// A ticker on a tier with a real-time policy, where that is permitted. `cpu`: where it runs; nothing: anywhere.
struct TierMeasurement {
  Ticks ticks;
  Scheduling scheduling;
  std::vector<std::string> warnings;
};
TierMeasurement measure_tier(Duration period, Duration duration, std::optional<int> cpu);

/// What the kernel gives: an absolute timerfd and epoll, on a thread with the same priority.
Ticks measure_bare_timer(Duration period, Duration duration, Scheduling scheduling, std::optional<int> cpu);

// ---- throughput

/// Events a second through a topic to a handler; each has its time and its copy.
double measure_topic(Duration duration);

/// The same by hand: a clock, a copy into a ring, a call for each.
double measure_bare_ring(Duration duration);

#ifdef RTDATA_WITH_SQLITE
/// Rows into SQLite in that folder: {"rtdata": ..., "limit": ...}, each with rates and the times of commits, or an
/// "error". Leaves nothing there. Throws SetupError when the folder cannot be written.
nlohmann::ordered_json measure_storage(const std::string& parent, Duration duration);
#endif

}  // namespace rtdata::app
