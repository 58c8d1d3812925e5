#include "app/inspect/import_zone.hpp"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <ctime>
#include <filesystem>

namespace rtdata::app {

bool use_zone(const std::string& name) {
  // Without a slash they are abbreviations, which mean several zones.
  if (name.find('/') == std::string::npos || name.front() == '/' || name.find("..") != std::string::npos) return false;
  const char* const folder = std::getenv("TZDIR");
  const std::filesystem::path zones = folder != nullptr ? folder : "/usr/share/zoneinfo";
  std::error_code ignored;
  if (!std::filesystem::is_regular_file(zones / name, ignored)) return false;
  ::setenv("TZ", (":" + name).c_str(), 1);
  ::tzset();
  return true;
}

std::vector<Time> instants_of(Time shown) {
  const auto offset_at = [](Time time) {
    const std::time_t at = std::chrono::floor<std::chrono::seconds>(time).time_since_epoch().count();
    std::tm parts{};
    ::localtime_r(&at, &parts);
    return std::chrono::seconds{parts.tm_gmtoff};
  };
  constexpr std::chrono::hours day{24};
  constexpr Time least = Time::min() + 2 * day, most = Time::max() - 2 * day;
  std::vector<Time> instants;
  if (shown < least || shown > most) return instants;
  for (const Time near : {shown - day, shown + day}) {
    const auto offset = offset_at(near);
    const Time instant = shown - offset;
    const bool is_new = instants.empty() || instants.front() != instant;
    if (is_new && offset_at(instant) == offset) instants.push_back(instant);
  }
  std::sort(instants.begin(), instants.end());
  return instants;
}

}  // namespace rtdata::app
