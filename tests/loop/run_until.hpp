// Running a loop, in real or in virtual time, until something has happened.
#pragma once

#include <chrono>

#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"

/// True when the condition holds; it is looked at every millisecond, for a minute at most.
template <class Condition>
bool run_until(rtdata::Loop& loop, Condition condition) {
  bool held = false;
  unsigned looks = 0;
  rtdata::Ticker look(loop, std::chrono::milliseconds{1}, [&](const rtdata::Tick&) {
    held = condition();
    if (held || ++looks == 60'000) loop.stop();
  });
  loop.run();
  return held;
}
