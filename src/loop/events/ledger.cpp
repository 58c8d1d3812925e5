#include "rtdata/loop/ledger.hpp"

#include "data/name_in.hpp"
#include "data/rounded_time.hpp"

namespace rtdata {

std::string to_string(const Outages& outages) {
  const auto time = [](Duration duration) {
    const auto s = std::chrono::duration_cast<std::chrono::seconds>(duration).count();
    const auto parts = [](std::int64_t large, const char* unit, std::int64_t small, const char* smaller) {
      const std::string text = std::to_string(large) + " " + unit;
      return small == 0 ? text : text + " " + std::to_string(small) + " " + smaller;
    };
    if (s < 60) return detail::rounded_time(static_cast<double>(duration.count()));
    if (s < 3600) return parts(s / 60, "min", s % 60, "s");
    if (s < 86400) return parts(s / 3600, "h", s % 3600 / 60, "min");
    return parts(s / 86400, "d", s % 86400 / 3600, "h");
  };
  const std::string of = std::to_string(outages.number) + (outages.number == 1 ? " outage of " : " outages of ");
  if (outages.time <= Duration{0}) return of + "unknown length";
  return of + (outages.is_at_most ? "at most " : "") + time(outages.time) + (outages.number > 1 ? " together" : "");
}

std::string_view name_of(Gap::Kind kind) noexcept {
  constexpr std::string_view names[] = {"missed", "failed", "disconnected", "silent", "joined"};
  return detail::name_in(names, kind, "?");
}

std::string_view name_of(DropReason reason) noexcept {
  constexpr std::string_view names[] = {"queue full, newest", "queue full, oldest", "refused"};
  return detail::name_in(names, reason);
}

}  // namespace rtdata
