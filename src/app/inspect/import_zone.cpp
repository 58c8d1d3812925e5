#include "app/inspect/import_zone.hpp"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <ctime>
#include <filesystem>

#include "data/lower_case.hpp"

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

std::string zone_in(std::string_view heading) {
  const std::string text = detail::lower_case(heading);
  const auto is_letter = [&](std::size_t at) { return at < text.size() && text[at] >= 'a' && text[at] <= 'z'; };
  const auto is_digit = [&](std::size_t at) { return at < text.size() && text[at] >= '0' && text[at] <= '9'; };
  const auto offset_at = [&](std::size_t at, bool has_minutes) -> std::string {
    if (at >= text.size() || (text[at] != '+' && text[at] != '-') || !is_digit(at + 1)) return {};
    const std::size_t size = is_digit(at + 2) ? 2 : 1, next = at + 1 + size;
    const bool has_mark = next < text.size() && text[next] == ':';
    const std::size_t minutes = next + (has_mark ? 1 : 0);
    const bool are_there = is_digit(minutes) && is_digit(minutes + 1);
    if (has_minutes && !(has_mark && are_there)) return {};
    return text[at] + (size == 1 ? "0" : std::string()) + text.substr(at + 1, size) + ":" +
           (are_there ? text.substr(minutes, 2) : "00");
  };
  for (const char* const name : {"utc", "gmt"}) {
    const std::size_t at = text.find(name), behind = at + 3;
    if (at == std::string::npos || (at > 0 && is_letter(at - 1)) || is_letter(behind)) continue;
    const std::string offset = offset_at(std::min(text.find_first_not_of(' ', behind), text.size()), false);
    return offset.empty() ? "Z" : offset;
  }
  for (std::size_t at = 0; at < text.size(); ++at)
    if (const std::string offset = offset_at(at, true); !offset.empty()) return offset;
  return {};
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
