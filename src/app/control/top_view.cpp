#include "app/control/top_view.hpp"

#include <algorithm>
#include <array>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "app/control/instances.hpp"
#include "app/core/amounts.hpp"
#include "app/core/table.hpp"
#include "app/core/terminal_text.hpp"
#include "data/rounded_time.hpp"
#include "rtdata/loop/ledger.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;
using Lines = std::vector<std::string>;

constexpr std::size_t shown_callbacks = 5;
constexpr std::size_t most_reason_lines = 3;

std::string right(const std::string& text, std::size_t width) {
  const std::size_t have = width_of(text);
  return have < width ? std::string(width - have, ' ') + text : text;
}

std::string left(std::string_view text, std::size_t width) {
  std::string cut = fitted(text, width);
  cut.append(width - std::min(width, width_of(cut)), ' ');
  return cut;
}

/// "12.3 us"; "-" for what is not known.
std::string time_text(const Json& ns) { return ns.is_number() ? detail::rounded_time(ns.get<double>()) : "-"; }
std::string rate_text(const Json& hertz) { return hertz.is_number() ? frequency_text(hertz.get<double>()) : "-"; }
std::string count_text(const Json& count) { return count.is_number() ? short_count(count.get<std::uint64_t>()) : "-"; }

/// What is not well of it, with the reason, on as many lines as that needs; nothing when it is well.
void add_health(Lines& lines, const Json& of, std::size_t columns) {
  const Json& health = of.at("health");
  if (health.at("state") == "ok") return;
  std::string text = wrapped("  ! " + text_or_dash(health.at("state")) + ": " + text_or_dash(health.at("reason")),
                             columns);
  for (std::size_t i = 0; i < most_reason_lines && !text.empty(); ++i) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    lines.push_back(text.substr(0, end));
    text.erase(0, end + 1);
  }
}

/// Whether it has an alarm, which is said, and how to acknowledge it.
bool add_alarm(Lines& lines, const Json& of, std::size_t columns) {
  const auto alarm = of.find("alarm");
  if (alarm == of.end() || !alarm->is_object()) return false;
  const bool is_acknowledged = alarm->value("acknowledged", true);
  if (!alarm->value("active", false) && is_acknowledged) return false;
  const std::string text = wrapped(
      "  ! alarm " + alarm->value("alarm", "") +
          (is_acknowledged ? ", acknowledged" : ", not acknowledged: rtdata ctl ack " + text_or_dash(of.at("name"))),
      columns);
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    lines.push_back(text.substr(at, end - at));
    at = end + 1;
  }
  return true;
}

/// A sensor, a sink or a part with what is said of it.
struct Block {
  Lines lines;
  int badness = 0;  ///< 0: well; 1: it has lost something; 2: degraded or its like; 3: faulted
};

int badness_of(const Json& of, std::uint64_t losses) {
  const Json& state = of.at("health").at("state");
  return state == "faulted" ? 3 : state != "ok" ? 2 : losses > 0 ? 1 : 0;
}

std::size_t lines_in(const std::vector<Block>& blocks) {
  std::size_t sum = 0;
  for (const Block& block : blocks) sum += block.lines.size();
  return sum;
}

/// What is not well first. What finds no room in so many lines is counted: "and 5 more, all well".
Lines fitted_blocks(std::vector<Block> blocks, std::size_t room) {
  std::stable_sort(blocks.begin(), blocks.end(), [](const Block& a, const Block& b) { return a.badness > b.badness; });
  const bool is_all = lines_in(blocks) <= room;
  Lines lines;
  std::size_t shown = 0;
  for (const Block& block : blocks) {
    if (!is_all && lines.size() + block.lines.size() + 1 > std::max<std::size_t>(room, block.lines.size() + 1)) break;
    lines.insert(lines.end(), block.lines.begin(), block.lines.end());
    ++shown;
  }
  if (shown == blocks.size()) return lines;
  const auto hidden = std::count_if(blocks.begin() + static_cast<std::ptrdiff_t>(shown), blocks.end(),
                                    [](const Block& block) { return block.badness > 1; });
  lines.push_back("and " + std::to_string(blocks.size() - shown) + " more, " +
                  (hidden == 0 ? std::string("all well") : std::to_string(hidden) + " of them not well"));
  return lines;
}

Lines head_of(const Json& status) {
  const Json& instance = status.at("instance");
  Lines head;
  const auto seconds = std::chrono::seconds{static_cast<std::int64_t>(instance.at("running_for_s").get<double>())};
  head.push_back(text_or_dash(instance.at("name")) + "  pid " + instance.at("pid").dump() + "  running " +
                 to_string(Duration{seconds}) + "  " + text_or_dash(instance.at("configuration")));
  head.push_back("");
  head.push_back("loop          policy    load  late p50       p99       max");
  for (const Json& loop : status.at("loops")) {
    const Json& late = loop.at("lateness_ns");
    std::array<char, 16> load{"-"};
    if (loop.at("load_percent").is_number())
      std::snprintf(load.data(), load.size(), "%.1f %%", loop.at("load_percent").get<double>());
    const int priority = loop.at("priority").get<int>();
    const auto lateness = [&](const char* what) {
      return right(late.is_object() ? time_text(late.at(what)) : "-", 10);
    };
    head.push_back(left(text_or_dash(loop.at("name")), 13) + " " +
                   left(text_or_dash(loop.at("policy")) + (priority > 0 ? " " + std::to_string(priority) : ""), 6) +
                   right(load.data(), 8) + lateness("p50") + lateness("p99") + lateness("max"));
    for (const Json& warning : loop.at("warnings")) head.push_back("  ! " + text_or_dash(warning));
    if (loop.at("hangs_in").is_string())
      head.push_back("  ! it does not turn: it has not come out of " + text_or_dash(loop.at("hangs_in")));
  }
  head.push_back("");
  return head;
}

std::vector<Block> sensors_of(const Json& status, std::string& heading, std::size_t columns) {
  const auto unreadable = [](const Json& sensor) { return sensor.value("unreadable", std::uint64_t{0}); };
  const Json& all = status.at("sensors");
  const bool has_unreadable = std::any_of(all.begin(), all.end(), [&](const Json& s) { return unreadable(s) > 0; });
  heading = "sensor         loop       wanted    reached   late missed failed" +
            std::string(has_unreadable ? " unread" : "") + "  value";
  std::vector<Block> blocks;
  for (const Json& sensor : all) {
    Block& block = blocks.emplace_back();
    block.lines.push_back(left(text_or_dash(sensor.at("name")), 14) + " " + left(text_or_dash(sensor.at("loop")), 7) +
                          right(rate_text(sensor.at("wanted_hz")), 10) + right(rate_text(sensor.at("reached_hz")), 11) +
                          right(count_text(sensor.at("late")), 7) + right(count_text(sensor.at("missed")), 7) +
                          right(count_text(sensor.at("failed")), 7) +
                          (has_unreadable ? right(count_text(unreadable(sensor)), 7) : "") + "  " +
                          (sensor.at("running") == true ? text_or_dash(sensor.at("value")) : "stopped"));
    add_health(block.lines, sensor, columns);
    const bool has_alarm = add_alarm(block.lines, sensor, columns);
    const auto count = [&](const char* key) {
      const auto value = sensor.find(key);
      return value != sensor.end() && value->is_number() ? value->get<std::uint64_t>() : std::uint64_t{0};
    };
    if (const std::uint64_t lost = count("lost"); lost > 0)
      block.lines.push_back("  - " + std::to_string(lost) + " lost by the source");
    if (const std::uint64_t repeated = count("repeated"); repeated > 0)
      block.lines.push_back("  - " + std::to_string(repeated) + " repeated by the source, which is no loss");
    if (const std::uint64_t thrown = count("first_lines"); thrown > 0)
      block.lines.push_back("  - " + std::to_string(thrown) + (thrown == 1 ? " first line" : " first lines") +
                            " thrown away");
    if (const std::uint64_t number = count("outages"); number > 0) {
      const std::chrono::duration<double> time(sensor.value("outage_time_s", 0.0));
      block.lines.push_back("  - " + to_string(Outages{number, std::chrono::duration_cast<Duration>(time)}));
    }
    block.badness = badness_of(
        sensor, count("missed") + count("failed") + count("unreadable") + count("lost") + count("outages"));
    if (has_alarm) block.badness = std::max(block.badness, 2);
  }
  return blocks;
}

/// What waits in the recording that a sink goes through; empty: nothing.
std::string backlog_of(const Json& sink) {
  const auto backlog = sink.find("backlog");
  if (backlog == sink.end() || !backlog->is_object() || backlog->value("events", std::uint64_t{0}) == 0) return {};
  const auto span = [&](const char* key) -> std::optional<Duration> {
    const auto seconds = backlog->find(key);
    if (seconds == backlog->end() || !seconds->is_number()) return std::nullopt;
    return std::chrono::duration_cast<Duration>(
        std::chrono::duration<double>(std::clamp(seconds->get<double>(), 0.0, 1e9)));
  };
  const auto catch_up = span("catch_up_s");
  return waiting_text(
             {backlog->at("events").get<std::uint64_t>(), backlog->value("bytes", std::uint64_t{0}), span("age_s")}) +
         (catch_up ? "; sent in about " + span_text(*catch_up) : "; it does not become less");
}

std::vector<Block> sinks_of(const Json& status, std::size_t columns) {
  std::vector<Block> blocks;
  for (const Json& sink : status.at("sinks")) {
    Block& block = blocks.emplace_back();
    block.lines.push_back(left(text_or_dash(sink.at("name")), 30) + right(count_text(sink.at("queued")), 10) +
                          right(count_text(sink.at("stored")), 10) + right(count_text(sink.at("dropped")), 10));
    if (const std::string waits = backlog_of(sink); !waits.empty()) block.lines.push_back("  - " + waits);
    add_health(block.lines, sink, columns);
    block.badness = badness_of(sink, sink.value("dropped", std::uint64_t{0}));
  }
  return blocks;
}

Lines parts_of(const Json& status) {
  Lines tail;
  if (status.contains("parts") && !status["parts"].empty()) {
    tail.push_back("");
    tail.push_back("part                           type             used by");
    for (const Json& part : status["parts"]) {
      std::string users;
      for (const Json& user : part.at("users")) users += (users.empty() ? "" : ", ") + text_or_dash(user);
      tail.push_back(left(text_or_dash(part.at("kind")) + " " + text_or_dash(part.at("name")), 30) + " " +
                     left(text_or_dash(part.at("type")), 16) + " " + (users.empty() ? "-" : users));
      if (!part.contains("places")) continue;
      for (const Json& place : part["places"]) {
        const auto count = [&](const char* key) { return place.value(key, std::uint64_t{0}); };
        if (count("transfers") == 0) continue;
        tail.push_back("  - " + text_or_dash(place.at("place")) + ": " + std::to_string(count("transfers")) +
                       " transfers, " + std::to_string(count("failed")) + " failed, " +
                       std::to_string(count("retried")) + " retries, held it for " + time_text(place.at("busy_ns")));
      }
    }
  }
  return tail;
}

Lines callbacks_of(const Json& status) {
  Lines tail;
  if (!status.at("callbacks").empty()) {
    tail.push_back("");
    tail.push_back("callback                       loop         count     total       max");
    std::size_t shown = 0;
    for (const Json& callback : status.at("callbacks")) {
      if (++shown > shown_callbacks) break;
      tail.push_back(left(text_or_dash(callback.at("name")), 30) + " " + left(text_or_dash(callback.at("loop")), 7) +
                     right(count_text(callback.at("count")), 10) + right(time_text(callback.at("total_ns")), 10) +
                     right(time_text(callback.at("max_ns")), 10));
    }
  }
  return tail;
}

}  // namespace

Lines lines_of_status(const std::string& answer, std::size_t columns, std::size_t rows) {
  const Json status = Json::parse(answer);
  Lines lines = head_of(status);
  std::string heading;
  const std::vector<Block> sensors = sensors_of(status, heading, columns);
  lines.push_back(heading);
  const std::vector<Block> sinks = sinks_of(status, columns);
  Lines parts = parts_of(status), callbacks = callbacks_of(status);
  // Where rows are few, what says least of whether data is lost goes first.
  constexpr std::size_t least_sensor_lines = 6;
  const std::size_t sink_lines = sinks.empty() ? 0 : lines_in(sinks) + 2;
  const std::size_t needed = lines.size() + lines_in(sensors) + sink_lines;
  if (needed + parts.size() + callbacks.size() > rows) callbacks.clear();
  if (needed + parts.size() > rows) parts.clear();
  const std::size_t left_over = rows > lines.size() ? rows - lines.size() : 1;
  const std::size_t for_sensors = std::min(lines_in(sensors), least_sensor_lines);
  const std::size_t for_sinks = left_over > for_sensors + 3 ? left_over - for_sensors - 2 : 1;
  const Lines sinks_shown = fitted_blocks(sinks, for_sinks);
  const std::size_t below = (sinks.empty() ? 0 : sinks_shown.size() + 2) + parts.size() + callbacks.size();
  const Lines sensors_shown = fitted_blocks(sensors, left_over > below ? left_over - below : 1);
  lines.insert(lines.end(), sensors_shown.begin(), sensors_shown.end());
  if (!sinks.empty()) {
    lines.emplace_back();
    lines.emplace_back("sink                              queued    stored   dropped");
    lines.insert(lines.end(), sinks_shown.begin(), sinks_shown.end());
  }
  lines.insert(lines.end(), parts.begin(), parts.end());
  lines.insert(lines.end(), callbacks.begin(), callbacks.end());
  for (std::string& line : lines) line = fitted(line, columns);
  return lines;
}

}  // namespace rtdata::app
