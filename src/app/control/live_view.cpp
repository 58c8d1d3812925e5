#include "app/control/live_view.hpp"

#include <algorithm>
#include <array>
#include <cstdio>
#include <utility>

#include "app/core/table.hpp"
#include "app/core/terminal_text.hpp"
#include "rtdata/data/value.hpp"

namespace rtdata::app {
namespace {

constexpr const char* hide_cursor = "\x1b[?25l";
constexpr const char* show_cursor = "\x1b[?25h";
constexpr const char* clear_line = "\x1b[K";
constexpr const char* clear_below = "\x1b[J";

std::string shown_value(const Value& value) {
  if (const double* number = std::get_if<double>(&value)) {
    std::array<char, 32> text{};
    std::snprintf(text.data(), text.size(), "%.5g", *number);
    return text.data();
  }
  return to_string(value);
}

std::string padded_right(std::string text, std::size_t width) {
  const std::size_t have = width_of(text);
  return have < width ? text + std::string(width - have, ' ') : text;
}

std::string padded_left(const std::string& text, std::size_t width) {
  const std::size_t have = width_of(text);
  return have < width ? std::string(width - have, ' ') + text : text;
}

}  // namespace

LiveView::LiveView(Loop& loop) : loop_(loop), started_(loop.now()) {
  subscription_ = loop.subscribe("#", [this](const EventView& event) { note(event); });
  subscription_.set_name("live view");
}

void LiveView::note(const EventView& event) {
  auto found = last_.find(event.topic());
  if (found == last_.end()) found = last_.emplace(std::string(event.topic()), Last{}).first;
  Last& last = found->second;
  last.description = &event.description();
  last.payload.assign(event.payload().begin(), event.payload().end());
  if (event.origin() != last.origin) {  // a topic of several
    if (!last.origin.empty()) last.other_origins[last.origin] = last.sequence;
    const auto known = last.other_origins.find(event.origin());
    last.sequence = known != last.other_origins.end() ? known->second : event.sequence() - 1;
    last.origin = event.origin();
  }
  last.events += event.sequence() - last.sequence;
  last.sequence = event.sequence();
  last.came_at = loop_.now();
}

std::string LiveView::rate_text(Last& last, MonotonicTime now) {
  constexpr Duration rate_span = std::chrono::seconds{5};
  std::deque<Last::Mark>& marks = last.marks;
  if (last.events > 0 && (marks.empty() || marks.back().events != last.events))
    marks.push_back({last.events, last.came_at});
  while (marks.size() > 2 && marks.back().came_at - marks[1].came_at >= rate_span) marks.pop_front();
  if (marks.size() < 2) return "-";
  const double events = static_cast<double>(marks.back().events - marks.front().events);
  Duration span = marks.back().came_at - marks.front().came_at;
  // Nothing came for clearly longer than from one event to the next: it has become slower, or stopped.
  const Duration since = now - marks.back().came_at;
  if (since > std::chrono::seconds{1} &&
      static_cast<double>(since.count()) * events > 2 * static_cast<double>(span.count()))
    span += since;
  if (span <= Duration{0}) return "-";
  return frequency_text(events * 1e9 / static_cast<double>(span.count()));
}

std::string LiveView::value_text(const Last& last, std::size_t width) {
  std::string text;
  if (last.description == nullptr) return text;
  for (const Leaf& leaf : last.description->leaves()) {
    std::string one = shown_value(read(leaf, last.payload.data()));
    if (!leaf.unit.empty() && leaf.unit != "1") one += " " + leaf.unit;
    if (!text.empty() && width_of(text) + 1 + width_of(one) > width) break;
    text += (text.empty() ? "" : " ") + one;
    if (width_of(text) >= width) break;
  }
  return fitted(text, width);
}

std::string LiveView::frame(const RunAccount& account, std::size_t columns, std::size_t rows, std::string_view note) {
  columns = std::max<std::size_t>(columns, 20) - 1;  // the last column makes some terminals wrap
  rows = std::max<std::size_t>(rows, 6);
  const MonotonicTime now = loop_.now();
  const auto lost = [](const TopicAccount& topic) {
    return topic.missed + topic.failed + topic.unreadable + topic.lost + topic.dropped;
  };
  std::size_t name_width = 5;
  for (const TopicAccount& topic : account.topics) name_width = std::max(name_width, width_of(topic.topic));
  name_width = std::min(name_width, std::size_t{22});
  const std::size_t before_value = name_width + 10 + 10 + 8 + 8 + 2;
  const std::size_t value_width = columns > before_value + 4 ? columns - before_value : 4;
  const auto line = [&](const std::string& name, const std::string& health, const std::string& rate,
                        const std::string& late, const std::string& gone, const std::string& value) {
    return padded_right(fitted(name, name_width), name_width) + "  " + padded_right(health, 8) + padded_left(rate, 10) +
           padded_left(late, 8) + padded_left(gone, 8) + "  " + value;
  };

  // What is worst first: faulted, degraded, with losses; within these as they are.
  std::vector<const TopicAccount*> topics;
  for (const TopicAccount& topic : account.topics) topics.push_back(&topic);
  std::stable_sort(topics.begin(), topics.end(), [&](const auto* a, const auto* b) {
    const auto rank = [&](const TopicAccount& topic) {
      const bool has_loss = lost(topic) > 0 || topic.outages.number > 0;
      return std::pair{static_cast<int>(topic.health), has_loss};
    };
    return rank(*a) > rank(*b);
  });

  std::vector<std::string> tail;
  std::string losses;
  const auto add = [&](std::uint64_t count, const char* what) {
    if (count > 0) losses += (losses.empty() ? "" : ", ") + short_count(count) + " " + what;
  };
  add(account.missed, "missed");
  add(account.failed, "failed");
  add(account.unreadable, "unreadable");
  add(account.lost, "lost by the source");
  add(account.dropped, "dropped by sinks");
  if (account.outages.number > 0) losses += (losses.empty() ? "" : ", ") + to_string(account.outages);
  const auto elapsed = std::chrono::duration_cast<std::chrono::seconds>(now - started_);
  tail.push_back(to_string(Duration(elapsed)) + ", " + short_count(account.events) + " events, " +
                 short_count(account.queued) + " queued; " + (losses.empty() ? "nothing lost" : "LOST: " + losses) +
                 "; Ctrl-C ends");
  if (!note.empty()) tail.emplace_back(note);
  std::string tail_text;
  for (const std::string& one : tail) tail_text += for_terminal(one, columns) + "\n";
  tail.clear();
  for (std::size_t begin = 0, end; (end = tail_text.find('\n', begin)) != std::string::npos; begin = end + 1)
    tail.push_back(tail_text.substr(begin, end - begin));
  constexpr std::size_t most_of_tail = 6;
  if (tail.size() > most_of_tail) tail.resize(most_of_tail);

  std::vector<std::string> lines{line("topic", "health", "rate", "late", "lost", "last value")};
  const std::size_t room = rows > tail.size() + 2 ? rows - tail.size() - 2 : 1;  // one for what is hidden, one below
  std::size_t hidden = 0;
  for (const TopicAccount* topic : topics) {
    Last& last = last_[topic->topic];
    const std::string rate = rate_text(last, now);
    const bool has_reason = topic->health != Health::ok && !topic->reason.empty();
    if (lines.size() + (has_reason ? 2 : 1) > room) {
      ++hidden;
      continue;
    }
    lines.push_back(line(topic->topic, std::string(name_of(topic->health)), rate, short_count(topic->late),
                         short_count(lost(*topic)),
                         topic->health == Health::faulted ? "-" : value_text(last, value_width)));
    if (has_reason) lines.push_back("  ! " + topic->reason);
  }
  if (hidden > 0) lines.push_back("and " + std::to_string(hidden) + (hidden == 1 ? " more topic" : " more topics"));
  lines.insert(lines.end(), tail.begin(), tail.end());

  std::string text = lines_ == 0 ? hide_cursor : "\x1b[" + std::to_string(lines_) + "A";
  text += '\r';
  for (const std::string& one : lines) text += fitted(one, columns) + clear_line + "\r\n";
  text += clear_below;
  lines_ = lines.size();
  return text;
}

std::string LiveView::end() {
  std::string text = lines_ == 0 ? "" : "\x1b[" + std::to_string(lines_) + "A\r" + clear_below;
  lines_ = 0;
  return text + show_cursor;
}

}  // namespace rtdata::app
