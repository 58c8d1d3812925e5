// Amounts as readable text.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "rtdata/data/time.hpp"

namespace rtdata::app {

/// "950 B", "4.2 kB", "24 GB"
std::string bytes_text(double bytes);
/// Two digits or three: "45 s", "12 min", "3.5 h", "2.1 d".
std::string span_text(Duration span);

/// Events in a recording that wait for a sink to send them.
struct WaitingEvents {
  std::uint64_t events = 0;
  std::uint64_t bytes = 0;
  std::optional<Duration> age = {};       ///< of the oldest
  std::optional<Duration> catch_up = {};  ///< empty: the backlog does not shrink, or it is unknown
};
/// "12 events (950 B) wait, the oldest for 12 min"
std::string waiting_text(const WaitingEvents& waiting);

}  // namespace rtdata::app
