#include "sensors/kernel/pps_time.hpp"

#include "data/number_text.hpp"
#include "data/saturating.hpp"
#include "io/kernel_file.hpp"

namespace rtdata::detail {
namespace {

constexpr Duration second = std::chrono::seconds{1};

Duration size_of(Duration duration) noexcept { return duration < Duration{0} ? -duration : duration; }

}  // namespace

Result<PpsStamp> parse_pps(std::string_view text) {
  const std::string_view all = trimmed(text);
  const std::size_t point = all.find('.'), hash = all.find('#');
  std::int64_t seconds = 0, nanoseconds = 0, count = 0;
  constexpr std::int64_t most = 9'000'000'000;  // the year 2255: what 64-bit ns hold
  const bool is_stamp = point != std::string_view::npos && hash != std::string_view::npos && hash == point + 10 &&
                        read_number(all.substr(0, point), seconds) == std::errc{} &&
                        read_number(all.substr(point + 1, 9), nanoseconds) == std::errc{} && nanoseconds >= 0 &&
                        read_number(all.substr(hash + 1), count) == std::errc{} && seconds >= 0 && seconds <= most &&
                        count >= INT32_MIN && count <= UINT32_MAX;
  if (!is_stamp) {
    return Error{Errc::bad_data, "cannot read the pulses", "",
                 all.empty() ? "its driver does not report this edge"
                             : "\"" + std::string(all.substr(0, 40)) + "\" is not a time",
                 all.empty() ? "set `edge` to the other edge" : "check `device`"};
  }
  return PpsStamp{Time{std::chrono::seconds{seconds} + Duration{nanoseconds}}, static_cast<std::uint32_t>(count)};
}

Duration from_second(Time time) noexcept {
  const Duration after = time.time_since_epoch() % second;  // times of pulses are not before 1970
  return after > second / 2 ? after - second : after;
}

PpsTimeCheck::Verdict PpsTimeCheck::look_at(MonotonicTime at, Time time, std::optional<Duration> clock_accuracy,
                                            Duration accuracy) noexcept {
  constexpr int enough = 5;
  const Duration most_unsteady = std::chrono::milliseconds{1} + 2 * accuracy;  // each of two pulses may be inexact
  constexpr Duration most_unsure = std::chrono::milliseconds{400};
  // A clock that is set in between cannot tell which second it is.
  const Duration apart = span_between(last_, at);
  const bool is_steady = in_a_row_ > 0 && size_of(apart - second) <= most_unsteady &&
                         size_of(span_between(last_time_, time) - apart) <= most_unsteady;
  last_ = at;
  last_time_ = time;
  in_a_row_ = is_steady ? (in_a_row_ < enough ? in_a_row_ + 1 : enough) : 1;
  if (in_a_row_ < enough) return Verdict::too_few;
  if (!clock_accuracy || *clock_accuracy > most_unsure) return Verdict::unkept_clock;
  return size_of(from_second(time)) <= *clock_accuracy + accuracy ? Verdict::accepted : Verdict::not_a_second;
}

}  // namespace rtdata::detail
