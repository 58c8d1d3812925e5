// The rocket in C++, flown from a recording of its sensors as fast as it goes: example_rocket [FLIGHT.db
// [DECISIONS.db]]. On board, a sensor takes
// the place of the replay, and an rtdata::Output with a lease that of each line which is printed.
#include "rocket.hpp"

#include <chrono>
#include <cstdio>
#include <string>

#include "rtdata/loop/runtime.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/replay.hpp"
#include "rtdata/recording/sqlite.hpp"

int main(int argc, char** argv) {
  const std::string flight_of = argc > 1 ? argv[1] : "flight.db", decisions = argc > 2 ? argv[2] : "decided.db";
  const rtdata::Time start = rtdata::Recording::open(flight_of).or_throw().runs().or_throw().back().started;
  rtdata::ManualClock clock(start);
  rtdata::Runtime runtime({.name = "rocket", .clock = &clock});
  rtdata::Loop loop(runtime, {});
  rtdata::SqliteSink sink(loop, {.path = decisions});
  const auto tell = loop.subscribe<rtdata::fsm::StateChange>(
      "flight", [](const rtdata::Event<rtdata::fsm::StateChange>& change) {
        std::printf("%8.2f s  %s: %s\n", rocket::seconds(change.time.time_since_epoch()),
                    std::string(change->to).c_str(), std::string(change->cause).c_str());
      });
  rocket::Rocket rocket(loop, {.drogue = [] { std::puts("  drogue"); }, .backup = [] { std::puts("  backup"); }});
  rtdata::Replay replay(loop, {.file = flight_of, .topics = {"rocket"}});
  while (!replay.is_done()) loop.advance(std::chrono::seconds{1});
  return rocket.machine().state() == "landed" ? 0 : 1;
}
