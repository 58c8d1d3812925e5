#include "app/bench/bench_text.hpp"

#include <array>
#include <cstdio>
#include <sstream>

#include "data/rounded_time.hpp"

namespace rtdata::app {

using Json = nlohmann::ordered_json;

namespace {

std::string time_text(const Json& ns) { return ns.is_number() ? detail::rounded_time(ns.get<double>()) : "-"; }

std::string amount_text(const Json& amount) {
  if (!amount.is_number()) return "-";
  const double value = amount.get<double>();
  std::array<char, 32> text{};
  if (value >= 1e6) {
    std::snprintf(text.data(), text.size(), "%.2f M", value / 1e6);
  } else if (value >= 1e4) {
    std::snprintf(text.data(), text.size(), "%.0f k", value / 1e3);
  } else {
    std::snprintf(text.data(), text.size(), "%.0f", value);
  }
  return text.data();
}

/// "100 000"
std::string grouped(std::uint64_t number) {
  std::string text = std::to_string(number);
  for (std::size_t at = text.size(); at > 3;) text.insert(at -= 3, " ");
  return text;
}

template <class... Values>
std::string line(const char* format, Values... values) {
  std::array<char, 200> text{};
  std::snprintf(text.data(), text.size(), format, values...);
  return std::string(text.data()) + "\n";
}

std::string wrapped(const std::string& text) {
  constexpr std::size_t width = 74;
  std::string out = "  - ";
  std::size_t column = 0;
  std::istringstream words(text);
  for (std::string word; words >> word;) {
    if (column > 0 && column + 1 + word.size() > width) {
      out += "\n    ";
      column = 0;
    }
    out += (column > 0 ? " " : "") + word;
    column += word.size() + (column > 0 ? 1 : 0);
  }
  return out + "\n";
}

}  // namespace

std::string bench_text(const Json& json) {
  std::string out;
  const Json& machine = json.at("machine");
  out += line("machine   %s, %d processors; load %s", machine.at("system").get<std::string>().c_str(),
              machine.at("processors").get<int>(), machine.at("load").get<std::string>().c_str());
  out += line("noise     other programs used %.0f %% of the processors, the hypervisor %.0f %%",
              machine.at("others_percent").get<double>(), machine.at("stolen_percent").get<double>());
  const Json& sampling = json.at("sampling");
  const int priority = sampling.at("priority").get<int>();
  out += "\nsampling on a tier, " + sampling.at("policy").get<std::string>() +
         (priority > 0 ? " " + std::to_string(priority) : "") +
         (sampling.at("as_asked") == true ? "" : " (fifo 80 is not permitted)") + ", " +
         (sampling.at("cpu").is_number() ? "processor " + sampling.at("cpu").dump() : "any processor") +
         "; limit: timerfd and epoll alone\n";
  out += "lateness              p50       p99     p99.9       max    missed        of\n";
  for (const Json& rate : sampling.at("rates")) {
    for (const char* who : {"rtdata", "limit"}) {
      const Json& figures = rate.at(who);
      out += line("%-7s %-7s%10s%10s%10s%10s%10s%10s",
                  who == std::string("rtdata") ? rate.at("name").get<std::string>().c_str() : "", who,
                  time_text(figures.at("p50_ns")).c_str(), time_text(figures.at("p99_ns")).c_str(),
                  time_text(figures.at("p99_9_ns")).c_str(), time_text(figures.at("max_ns")).c_str(),
                  grouped(figures.at("missed").get<std::uint64_t>()).c_str(),
                  grouped(figures.at("ticks").get<std::uint64_t>()).c_str());
    }
  }
  const Json& events = json.at("events");
  out += line("\nevents through a topic to a handler: %s/s; limit (clock, copy, call) %s/s",
              amount_text(events.at("rtdata_per_s")).c_str(), amount_text(events.at("limit_per_s")).c_str());
  if (!json.at("storage").empty()) out += "\nrows of 4 numbers into SQLite, 500 a commit; limit: SQLite alone\n";
  for (const Json& storage : json.at("storage")) {
    out += "  " + storage.at("folder").get<std::string>() + (storage.at("tmpfs") == true ? " (tmpfs)" : "") + "\n";
    for (const char* who : {"rtdata", "limit"}) {
      const Json& figures = storage.at(who);
      if (figures.contains("error")) {
        out += "    " + std::string(who) + ": " + figures.at("error").get<std::string>() + "\n";
        continue;
      }
      out += line("    %-7s%9s rows/s; stored after p50 %s, p99 %s, max %s", who,
                  amount_text(figures.at("rows_per_s")).c_str(), time_text(figures.at("commit_p50_ns")).c_str(),
                  time_text(figures.at("commit_p99_ns")).c_str(), time_text(figures.at("commit_max_ns")).c_str());
    }
  }
  out += "\nverdict\n";
  for (const Json& verdict : json.at("verdict")) out += "  " + verdict.get<std::string>() + "\n";
  if (!json.at("improvements").empty()) out += "\nwhat could be improved\n";
  for (const Json& one : json.at("improvements")) out += wrapped(one.get<std::string>());
  return out;
}

Json bench_verdict(const Json& json) {
  Json verdict = Json::array();
  for (const Json& rate : json.at("sampling").at("rates")) {
    const auto missed = rate.at("rtdata").at("missed").get<std::uint64_t>();
    const auto limit = rate.at("limit").at("missed").get<std::uint64_t>();
    const std::string of = grouped(rate.at("rtdata").at("ticks").get<std::uint64_t>());
    std::string text = rate.at("name").get<std::string>() + ": ";
    text += missed == 0 ? "yes: none missed in " + of : grouped(missed) + " missed in " + of;
    if (missed > 0 || limit > 0) text += " (timerfd alone: " + grouped(limit) + ")";
    verdict.push_back(text);
  }
  for (const Json& storage : json.at("storage")) {
    const Json& figures = storage.at("rtdata");
    if (figures.contains("error")) {
      verdict.push_back("recording into " + storage.at("folder").get<std::string>() + ": failed, see above");
      continue;
    }
    verdict.push_back("recording into " + storage.at("folder").get<std::string>() + ": up to " +
                      amount_text(figures.at("rows_per_s")) + " rows/s" +
                      (figures.at("dropped") == 0 ? "" : "; " + figures.at("dropped").dump() + " rows dropped"));
  }
  return verdict;
}

}  // namespace rtdata::app
