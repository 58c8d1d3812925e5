#include "app/control/status_view.hpp"

#include <algorithm>
#include <array>
#include <cstdio>
#include <functional>

#include "app/control/account.hpp"
#include "app/core/amounts.hpp"
#include "app/core/table.hpp"
#include "app/core/terminal_text.hpp"
#include "data/listed.hpp"
#include "data/rounded_time.hpp"

namespace rtdata::app {
namespace {

using Lines = std::vector<std::string>;

constexpr std::size_t shown_callbacks = 5;

std::string right(const std::string& text, std::size_t width) {
  const std::size_t have = width_of(text);
  return have < width ? std::string(width - have, ' ') + text : text;
}

std::string left(std::string_view text, std::size_t width) {
  std::string cut = fitted(text, width);
  cut.append(width - std::min(width, width_of(cut)), ' ');
  return cut;
}

std::string time_text(Duration time) { return detail::rounded_time(static_cast<double>(time.count())); }
std::string rate_text(const std::optional<double>& hertz) { return hertz ? frequency_text(*hertz) : "-"; }

/// Adds the lines that the text needs, up to `most`.
void add_wrapped(Lines& lines, const std::string& text, std::size_t columns, std::size_t most) {
  std::string rest = wrapped(text, columns);
  for (; most > 0 && !rest.empty(); --most) {
    const std::size_t end = std::min(rest.find('\n'), rest.size());
    lines.push_back(rest.substr(0, end));
    rest.erase(0, end + 1);
  }
}

void add_health(Lines& lines, Health health, const std::string& reason, std::size_t columns) {
  if (health != Health::ok) add_wrapped(lines, "  ! " + std::string(name_of(health)) + ": " + reason, columns, 3);
}

/// The lines of one object, made if there is space for them.
struct Block {
  int badness = 0;  ///< 0: ok; 1: has losses; 2: degraded or similar; 3: faulted
  std::function<Lines()> lines;
};

int badness_of(Health health, bool has_loss) {
  return health != Health::ok ? static_cast<int>(health) + 1 : has_loss ? 1 : 0;
}

/// The lines of all blocks, problems first. Blocks without space are counted: "and 5 more, all well".
Lines fitted_blocks(const std::vector<Block>& all, std::size_t room) {
  std::vector<const Block*> blocks;
  for (const Block& block : all) blocks.push_back(&block);
  std::stable_sort(blocks.begin(), blocks.end(), [](const auto* a, const auto* b) { return a->badness > b->badness; });
  std::vector<Lines> made;
  std::size_t size = 0;
  while (made.size() < blocks.size() && size <= room) size += made.emplace_back(blocks[made.size()]->lines()).size();
  const bool is_all = made.size() == blocks.size() && size <= room;
  Lines lines;
  std::size_t shown = 0;
  for (const Lines& block : made) {
    if (!is_all && lines.size() + block.size() + 1 > std::max(room, block.size() + 1)) break;
    lines.insert(lines.end(), block.begin(), block.end());
    ++shown;
  }
  if (shown == blocks.size()) return lines;
  const auto hidden = std::count_if(blocks.begin() + static_cast<std::ptrdiff_t>(shown), blocks.end(),
                                    [](const Block* block) { return block->badness > 1; });
  lines.push_back("and " + std::to_string(blocks.size() - shown) + " more, " +
                  (hidden == 0 ? std::string("all well") : std::to_string(hidden) + " of them not well"));
  return lines;
}

/// "nothing lost", "LOST: 5 missed, 1 outage of 6.3 s"
std::string losses_text(const Status::Account& all) {
  std::string losses;
  for (const auto& [count, what] : {std::pair{all.missed, "missed"},
                                    {all.failed, "failed"},
                                    {all.unreadable - all.failed_unreadable, "unreadable"},
                                    {all.lost, "lost by the source"},
                                    {all.dropped, "dropped by sinks"}})
    if (count > 0) losses += (losses.empty() ? "" : ", ") + short_count(count) + " " + what;
  if (all.outages.number > 0) losses += (losses.empty() ? "" : ", ") + to_string(all.outages);
  return losses.empty() ? "nothing lost" : "LOST: " + losses;
}

Lines head_of(const Status& status, std::size_t columns) {
  const Status::Instance& instance = status.instance;
  const auto seconds = std::chrono::floor<std::chrono::seconds>(instance.running_for);
  Lines head{instance.name + "  pid " + std::to_string(instance.pid) + "  running " + to_string(Duration{seconds}) +
             "  " + instance.configuration};
  add_wrapped(head,
              short_count(status.total.published) + " events, " + short_count(status.queued) + " queued; " +
                  losses_text(status.total),
              columns, 3);
  head.emplace_back();
  head.emplace_back("loop          policy    load  late p50       p99       max");
  for (const Status::Loop& loop : status.loops) {
    std::array<char, 16> load{"-"};
    if (loop.load_percent) std::snprintf(load.data(), load.size(), "%.1f %%", *loop.load_percent);
    const auto late = [&](Duration Status::Lateness::*of) {
      return right(loop.lateness ? time_text((*loop.lateness).*of) : "-", 10);
    };
    head.push_back(left(loop.name, 13) + " " +
                   left(loop.policy + (loop.priority > 0 ? " " + std::to_string(loop.priority) : ""), 6) +
                   right(load.data(), 8) + late(&Status::Lateness::p50) + late(&Status::Lateness::p99) +
                   late(&Status::Lateness::max));
    for (const std::string& warning : loop.warnings) head.push_back("  ! " + warning);
    if (loop.hangs_in) head.push_back("  ! the loop does not turn: it has not returned from " + *loop.hangs_in);
  }
  head.emplace_back();
  return head;
}

Lines lines_of(const Status::Sensor& sensor, bool has_unreadable, std::size_t columns) {
  const auto count = [](std::uint64_t number) { return right(short_count(number), 7); };
  Lines lines{left(sensor.name, 14) + " " + left(sensor.loop, 7) + right(rate_text(sensor.wanted_hz), 10) +
              right(rate_text(sensor.reached_hz), 11) + count(sensor.late) + count(sensor.missed) +
              count(sensor.failed) + (has_unreadable ? count(sensor.unreadable) : "") + "  " +
              (sensor.is_running ? sensor.shown().value_or("-") : "stopped")};
  add_health(lines, sensor.health, sensor.reason, columns);
  if (sensor.alarm && (sensor.alarm->is_active || !sensor.alarm->is_acknowledged))
    add_wrapped(
        lines,
        "  ! alarm " + sensor.alarm->name +
            (sensor.alarm->is_acknowledged ? ", acknowledged" : ", not acknowledged: rtdata ctl ack " + sensor.name),
        columns, 3);
  if (sensor.lost > 0) lines.push_back("  - " + std::to_string(sensor.lost) + " lost by the source");
  if (sensor.repeated > 0)
    lines.push_back("  - " + std::to_string(sensor.repeated) + " repeated by the source, which is not a loss");
  if (sensor.first_lines > 0)
    lines.push_back("  - " + std::to_string(sensor.first_lines) +
                    (sensor.first_lines == 1 ? " first line" : " first lines") + " discarded");
  if (sensor.outages.number > 0) lines.push_back("  - " + to_string(sensor.outages));
  return lines;
}

std::vector<Block> sensors_of(const Status& status, std::string& heading, std::size_t columns) {
  const bool has_unreadable = status.total.unreadable > 0;
  heading = "sensor         loop       wanted    reached   late missed failed" +
            std::string(has_unreadable ? " unread" : "") + "  value";
  std::vector<Block> blocks;
  for (const Status::Sensor& sensor : status.sensors) {
    int badness = badness_of(sensor.health, sensor.has_loss());
    if (sensor.alarm && (sensor.alarm->is_active || !sensor.alarm->is_acknowledged)) badness = std::max(badness, 2);
    blocks.push_back(
        {badness, [&sensor, has_unreadable, columns] { return lines_of(sensor, has_unreadable, columns); }});
  }
  return blocks;
}

std::string backlog_text(const Status::Sink& sink) {
  return waiting_text({sink.queued, sink.backlog->bytes, sink.backlog->age});
}

std::vector<Block> sinks_of(const Status& status, std::size_t columns) {
  std::vector<Block> blocks;
  for (const Status::Sink& sink : status.sinks) {
    blocks.push_back({badness_of(sink.health, sink.all_dropped() > 0), [&sink, columns] {
                        Lines lines{left(sink.name, 30) + right(short_count(sink.queued), 10) +
                                    right(short_count(sink.stored), 10) + right(short_count(sink.all_dropped()), 10)};
                        if (sink.backlog && sink.queued > 0)
                          lines.push_back("  - " + backlog_text(sink) +
                                          (sink.backlog->catch_up
                                               ? "; sent in about " + span_text(*sink.backlog->catch_up)
                                               : "; the backlog does not become less"));
                        add_health(lines, sink.health, sink.reason, columns);
                        return lines;
                      }});
  }
  return blocks;
}

Lines parts_of(const Status& status) {
  if (status.parts.empty()) return {};
  Lines tail{"", "part                           type             used by"};
  for (const Status::Part& part : status.parts) {
    const std::string users = detail::listed(part.users);
    tail.push_back(left(part.kind + " " + part.name, 30) + " " + left(part.type, 16) + " " +
                   (users.empty() ? "-" : users));
    for (const Status::Place& place : part.places)
      if (place.transfers > 0)
        tail.push_back("  - " + place.place + ": " + std::to_string(place.transfers) + " transfers, " +
                       std::to_string(place.failed) + " failed, " + std::to_string(place.retried) +
                       " retries, held it for " + time_text(place.busy) +
                       (place.skipped_bytes > 0 ? ", " + std::to_string(place.skipped_bytes) + " bytes skipped" : ""));
  }
  return tail;
}

Lines callbacks_of(const Status& status) {
  if (status.callbacks.empty()) return {};
  Lines tail{"", "callback                       loop         count     total       max"};
  for (std::size_t i = 0; i < std::min(shown_callbacks, status.callbacks.size()); ++i) {
    const Status::Callback& callback = status.callbacks[i];
    tail.push_back(left(callback.name, 30) + " " + left(callback.loop, 7) + right(short_count(callback.count), 10) +
                   right(time_text(callback.total), 10) + right(time_text(callback.max), 10));
  }
  return tail;
}

}  // namespace

Lines lines_of(const Status& status, std::size_t columns, std::size_t rows) {
  constexpr std::size_t few_rows = 20;
  Lines lines = head_of(status, columns);
  if (rows < few_rows) std::erase(lines, std::string());
  std::string heading;
  const std::vector<Block> sensors = sensors_of(status, heading, columns);
  lines.push_back(heading);
  const std::vector<Block> sinks = sinks_of(status, columns);
  Lines parts = parts_of(status), callbacks = callbacks_of(status);
  // If there are few rows, the lines that are least important for data loss are left out first.
  constexpr std::size_t least_sensor_lines = 6;
  const std::size_t sensor_lines = fitted_blocks(sensors, rows).size();
  const std::size_t needed = lines.size() + sensor_lines + (sinks.empty() ? 0 : fitted_blocks(sinks, rows).size() + 2);
  if (needed + parts.size() + callbacks.size() > rows) callbacks.clear();
  if (needed + parts.size() > rows) parts.clear();
  const std::size_t left_over = rows > lines.size() ? rows - lines.size() : 1;
  const std::size_t for_sensors = std::min(sensor_lines, least_sensor_lines);
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

std::string summary(const Status& status, std::size_t columns) {
  std::string text;
  const Status::Account& all = status.total;
  const bool has_unreadable = all.unreadable > 0, has_outages = all.outages.number > 0;
  std::vector<std::string> heading{"topic", ">events", ">late", ">missed", ">failed"};
  if (has_unreadable) heading.push_back(">unreadable");
  heading.push_back(">lost");
  if (has_outages) heading.push_back(">outages");
  heading.insert(heading.end(), {">dropped", "health"});
  Table topics(heading);
  for (const Status::Account& topic : status.topics) {
    std::vector<std::string> row{topic.name, std::to_string(topic.published), std::to_string(topic.late),
                                 std::to_string(topic.missed), std::to_string(topic.failed)};
    if (has_unreadable) row.push_back(std::to_string(topic.unreadable));
    row.push_back(std::to_string(topic.lost));
    if (has_outages) row.push_back(std::to_string(topic.outages.number));
    row.insert(row.end(), {std::to_string(topic.dropped), std::string(name_of(topic.health))});
    topics.add(row, topic.health == Health::ok ? "" : topic.reason);
  }
  if (!topics.empty()) text += topics.text("", columns);
  Table sinks({"sink", ">stored", ">dropped", "health", "where"});
  for (const Status::Sink& sink : status.sinks) {
    const std::string where = sink.path.empty() ? "-" : sink.path == "-" ? "standard output" : sink.path;
    std::string note = sink.health == Health::ok ? "" : sink.reason;
    if (sink.backlog && sink.queued > 0)
      note += (note.empty() ? "" : "; ") + backlog_text(sink) + (sink.recording.empty() ? "" : " in " + sink.recording);
    sinks.add({sink.name, std::to_string(sink.stored), dropped_text(sink), std::string(name_of(sink.health)), where},
              note);
  }
  if (!sinks.empty()) text += (text.empty() ? "" : "\n") + sinks.text("", columns);
  return text;
}

}  // namespace rtdata::app
