#include "app/live_view.hpp"

#include <algorithm>
#include <array>
#include <cstdio>

#include "app/table.hpp"
#include "rtdata/data/value.hpp"

namespace rtdata::app {
namespace {

constexpr const char* hide_cursor = "\x1b[?25l";
constexpr const char* show_cursor = "\x1b[?25h";
constexpr const char* clear_line = "\x1b[K";
constexpr const char* clear_below = "\x1b[J";

std::string short_value(const Value& value) {
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
  subscription_ = loop.subscribe("#", [this](const EventView& event) {
    auto found = last_.find(event.topic());
    if (found == last_.end()) found = last_.emplace(std::string(event.topic()), Last{}).first;
    found->second.description = &event.description();
    found->second.payload.assign(event.payload().begin(), event.payload().end());
  });
  subscription_.set_name("live view");
}

std::string LiveView::value_text(const Last& last, std::size_t width) {
  std::string text;
  if (last.description == nullptr) return text;
  for (const Leaf& leaf : last.description->leaves()) {
    std::string one = short_value(read(leaf, last.payload.data()));
    if (!leaf.unit.empty() && leaf.unit != "1") one += " " + leaf.unit;
    if (!text.empty() && width_of(text) + 1 + width_of(one) > width) break;
    text += (text.empty() ? "" : " ") + one;
    if (width_of(text) >= width) break;
  }
  return fitted(text, width);
}

std::string LiveView::frame(const RunAccount& account, std::size_t columns, std::size_t rows, std::string_view note) {
  columns = std::max<std::size_t>(columns, 20) - 1;  // the last column makes some terminals wrap
  const MonotonicTime now = loop_.now();
  const double seconds = drawn_ == MonotonicTime{} ? std::chrono::duration<double>(now - started_).count()
                                                   : std::chrono::duration<double>(now - drawn_).count();
  drawn_ = now;
  std::vector<std::string> lines;
  std::size_t name_width = 5;
  for (const TopicAccount& topic : account.topics) name_width = std::max(name_width, width_of(topic.topic));
  name_width = std::min(name_width, std::size_t{22});
  const bool has_unreadable = account.unreadable > 0;
  const std::size_t numbers = 10 + (has_unreadable ? 6 : 5) * 8;  // rate, late, missed, failed, lost, dropped
  const std::size_t value_width = columns > name_width + numbers + 6 ? columns - name_width - numbers - 2 : 4;

  const auto line = [&](const std::string& name, const std::string& rate, const std::string& late,
                        const std::string& missed, const std::string& failed, const std::string& unreadable,
                        const std::string& lost, const std::string& dropped, const std::string& value) {
    lines.push_back(padded_right(fitted(name, name_width), name_width) + padded_left(rate, 10) + padded_left(late, 8) +
                    padded_left(missed, 8) + padded_left(failed, 8) +
                    (has_unreadable ? padded_left(unreadable, 8) : std::string()) + padded_left(lost, 8) +
                    padded_left(dropped, 8) + "  " + value);
  };
  line("topic", "rate", "late", "missed", "failed", "unread", "lost", "dropped", "last value");
  const std::size_t most = std::max<std::size_t>(rows, 6) - 4;
  std::size_t hidden = 0;
  for (const TopicAccount& topic : account.topics) {
    Last& last = last_[topic.topic];
    const double rate = seconds > 0 ? static_cast<double>(topic.events - last.events_before) / seconds : 0;
    last.events_before = topic.events;
    if (lines.size() > most) {
      ++hidden;
      continue;
    }
    std::string value = value_text(last, value_width);
    if (topic.health == Health::faulted) value = fitted(topic.reason, value_width);
    line(topic.topic, frequency_text(rate), short_count(topic.late), short_count(topic.missed),
         short_count(topic.failed), short_count(topic.unreadable), short_count(topic.lost), short_count(topic.dropped),
         value);
  }
  if (hidden > 0) lines.push_back("and " + std::to_string(hidden) + " more topics");
  const auto elapsed = std::chrono::duration_cast<std::chrono::seconds>(now - started_);
  lines.push_back(to_string(Duration(elapsed)) + ", " + short_count(account.events) + " events, " +
                  short_count(account.dropped) + " dropped, " + short_count(account.queued) + " queued; Ctrl-C ends");
  if (!note.empty()) lines.push_back(std::string(note));

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
