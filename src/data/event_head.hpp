// The constant parts around time and sequence of an event, for one origin on one topic in one run.
#pragma once

#include <string>
#include <string_view>

#include "data/copy.hpp"
#include "rtdata/data/event.hpp"

namespace rtdata::detail {

/// The texts of the last event's topic, origin and run, as a codec writes them.
struct EventHead {
  std::string before_time, before_sequence, before_data;

  /// Calls `make` to set the texts if they belong to another event.
  template <class Make>
  void set(const EventView& event, Make&& make) {
    if (is_made_ && equal_short(topic_, event.topic()) && equal_short(origin_, event.origin()) &&
        equal_short(run_, event.run()))
      return;
    is_made_ = false;
    topic_ = event.topic();
    origin_ = event.origin();
    run_ = event.run();
    make();
    is_made_ = true;
  }

 private:
  std::string topic_, origin_, run_;
  bool is_made_ = false;
};

}  // namespace rtdata::detail
