#include "app/core/amounts.hpp"

#include <array>
#include <cstdio>

namespace rtdata::app {

std::string bytes_text(double bytes) {
  constexpr std::array units{"B", "kB", "MB", "GB", "TB"};
  std::size_t unit = 0;
  for (; bytes >= 999.5 && unit + 1 < units.size(); ++unit) bytes /= 1000;
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), bytes < 9.95 && unit > 0 ? "%.1f %s" : "%.0f %s", bytes, units[unit]);
  return text.data();
}

std::string span_text(Duration span) {
  struct Unit {
    const char* name;
    double seconds;
    double most;
  };
  constexpr std::array units{Unit{"s", 1, 99.5}, Unit{"min", 60, 99.5}, Unit{"h", 3600, 47.95}, Unit{"d", 86400, 0}};
  const double seconds = std::chrono::duration<double>(span).count();
  std::size_t unit = 0;
  while (unit + 1 < units.size() && seconds / units[unit].seconds >= units[unit].most) ++unit;
  const double value = seconds / units[unit].seconds;
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), value < 9.95 && value >= 0.05 ? "%.1f %s" : "%.0f %s", value,
                units[unit].name);
  return text.data();
}

std::string waiting_text(const WaitingEvents& waiting) {
  std::string text = std::to_string(waiting.events) + (waiting.events == 1 ? " event (" : " events (") +
                     bytes_text(static_cast<double>(waiting.bytes)) + (waiting.events == 1 ? ") waits" : ") wait");
  if (waiting.age) text += ", the oldest for " + span_text(*waiting.age);
  return text;
}

}  // namespace rtdata::app
