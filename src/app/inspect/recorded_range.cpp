#include "app/inspect/recorded_range.hpp"

#include <time.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <ctime>
#include <utility>

#include "rtdata/recording/runs.hpp"

namespace rtdata::app {
namespace {

/// "+01:00": the offset of this computer's zone at that local time.
std::string zone_at(Time time) {
  const auto seconds = static_cast<std::time_t>(to_nanoseconds(time) / 1'000'000'000);
  std::tm here{};
  std::array<char, 8> text{};
  if (::localtime_r(&seconds, &here) == nullptr || std::strftime(text.data(), text.size(), "%z", &here) != 5)
    return "+00:00";
  return std::string(text.data(), 3) + ":" + std::string(text.data() + 3, 2);
}

}  // namespace

Time last_instant(const Recording& recording, const RunInfo& run) {
  Time end = run.ended.value_or(run.started);
  if (run.state != RunState::recording) return end;
  // The account is at most a second old: few rows came after it.
  constexpr Duration step = std::chrono::milliseconds{10};
  auto steps = recording.steps({.run = run.run, .from = end}, step).or_throw();
  while (const RecordedRow* row = steps.next().or_throw()) end = std::max(end, row->header().time + step);
  return end;
}

std::optional<Time> parse_time(const std::string& text) {
  if (text.empty()) return std::nullopt;
  std::int64_t ns = 0;
  if (const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), ns);
      status == std::errc{} && end == text.data() + text.size())
    return from_nanoseconds(ns);
  auto time = parse_iso8601(text);
  if (const auto utc = parse_iso8601(text + "Z"); !time && utc)
    throw SetupError({Errc::bad_argument, "not a time", "\"" + text + "\"", "its time zone is missing",
                      "write \"" + text + "Z\" for UTC, or \"" + text + zone_at(*utc) + "\", as this machine's is"});
  return time.or_throw();
}

RecordedRange range_of(const Recording& recording, const PartOptions& options, const char* command) {
  const auto refuse = [&](Errc id, std::string where, std::string why, std::string advice) {
    throw SetupError({id, command, std::move(where), std::move(why), std::move(advice)});
  };
  const auto runs = recording.runs().or_throw();
  if (runs.empty()) refuse(Errc::not_found, recording.path(), "no run was recorded yet", "");
  RecordedRange range;
  range.run = find_run(runs, options.run.value_or("-1"), recording.path()).or_throw();
  range.line = recording.utc_line(range.run.run).or_throw();
  const Time start = range.line.utc(range.run.started), end = range.line.utc(last_instant(recording, range.run));
  const auto from = parse_time(options.from), until = parse_time(options.until);
  range.until = until.value_or(end + Duration{1});
  range.from = from.value_or(std::min(start, range.until));
  if (!options.last.empty()) {
    const Duration last = parse_duration(options.last).or_throw();
    if (from)
      refuse(Errc::bad_argument, "--last " + options.last, "--from says where it begins, too", "remove one of the two");
    if (last <= Duration{0})
      refuse(Errc::bad_argument, "--last " + options.last, "it is not above 0", "write one such as 10s");
    const Duration all = range.until - std::min(start, range.until);
    range.from = range.until - std::min(last, std::max(all, Duration{1}));
  }
  if (range.until <= range.from)
    refuse(Errc::bad_argument, to_iso8601(range.from) + " to " + to_iso8601(range.until), "it ends before it begins",
           "the run is from " + to_iso8601(start) + " to " + to_iso8601(end));
  constexpr Duration longest = std::chrono::hours{100 * 365 * 24};  // 64 bits of ns reach 292 years
  if (range.from < range.until - longest)
    refuse(Errc::bad_argument, to_iso8601(range.from) + " to " + to_iso8601(range.until), "it is longer than 100 years",
           "the run is from " + to_iso8601(start) + " to " + to_iso8601(end));
  range.is_whole = range.from <= start && range.until > end;
  return range;
}

}  // namespace rtdata::app
