#include "app/inspect/course.hpp"

#include <algorithm>
#include <set>
#include <string_view>

namespace rtdata::app {
namespace {

constexpr std::size_t most_kept = 1000;

/// The text of a field in the payload.
std::string word(const CourseEvent& event, std::string_view field) {
  for (const auto& [name, value] : event.values)
    if (name == field) return std::holds_alternative<std::monostate>(value) ? std::string() : to_string(value);
  return {};
}

/// False: the command is not a note, or was refused.
bool fill_note(CourseEvent& event) {
  constexpr std::string_view verb = "note ";
  const std::string command = word(event, "command");
  event.text = command.substr(std::min(verb.size(), command.size()));
  event.object = word(event, "by");
  const bool is_done = word(event, "done") == "true";
  event.values = {{"text", event.text}};
  return is_done && command.starts_with(verb);
}

/// False: it is a note, and noted.
bool fill_command(CourseEvent& event) {
  const std::string outcome = word(event, "outcome");
  const bool is_done = word(event, "done") == "true";
  event.object = word(event, "by");
  event.text = word(event, "command") + (is_done ? "" : ", refused") + (outcome.empty() ? "" : ": " + outcome);
  return !is_done || !word(event, "command").starts_with("note ");
}

bool fill_alarm(CourseEvent& event) {
  const std::string value = word(event, "value"), limit = word(event, "limit");
  const bool is_active = word(event, "is_active") == "true";
  event.text = is_active ? word(event, "alarm") : "normal";
  if (!value.empty()) event.text += ", at " + value;
  if (is_active && !limit.empty()) event.text += ", limit " + limit;
  if (is_active && word(event, "acknowledged") == "true") event.text += ", acknowledged";
  return true;
}

bool fill_state(CourseEvent& event) {
  const std::string from = word(event, "from"), cause = word(event, "cause");
  event.text = (from.empty() ? "" : from + " -> ") + word(event, "to") + (cause.empty() ? "" : " (" + cause + ")");
  return true;
}

struct Kind {
  std::string_view payload;
  std::vector<std::string> fields;
  bool (*tell)(CourseEvent&);
  CourseEvents Course::*events;
};

const std::vector<Kind>& kinds() {
  static const std::vector<Kind> all{
      {"command", {"command", "by", "done"}, fill_note, &Course::notes},
      {"command", {"command", "by", "done", "outcome"}, fill_command, &Course::commands},
      {"alarm", {"level", "alarm", "is_active", "acknowledged", "value", "limit"}, fill_alarm, &Course::alarms},
      {"state_change", {"from", "to", "cause", "lasted"}, fill_state, &Course::states}};
  return all;
}

void add(const Recording& recording, const std::string& topic, std::int64_t run, const Kind& kind,
         CourseEvents& events) {
  auto rows = recording.rows({.topic = topic, .run = run}).or_throw();
  std::size_t taken = 0;
  while (const auto* const row = rows.next().or_throw()) {
    const EventView event = row->event();
    CourseEvent one{event.time(), std::string(event.origin()), {}, {}};
    for (const std::string& field : kind.fields) {
      auto value = event.value(field);
      if (!value) break;  // another payload of that name
      one.values.emplace_back(field, *std::move(value));
    }
    if (one.values.size() != kind.fields.size() || !kind.tell(one)) continue;
    ++events.count;
    if (taken++ < most_kept) events.first.push_back(std::move(one));
  }
}

}  // namespace

bool is_of_course(const Description& description) {
  return std::any_of(kinds().begin(), kinds().end(),
                     [&](const Kind& kind) { return description.name() == kind.payload; });
}

Course course_of(const Recording& recording, const std::vector<RecordedTopic>& topics, std::int64_t run) {
  Course course;
  std::set<std::pair<std::string, const Kind*>> known;
  for (const RecordedTopic& topic : topics) {
    for (const Kind& kind : kinds()) {
      if (topic.description->name() != kind.payload || !known.emplace(topic.topic, &kind).second) continue;
      add(recording, topic.topic, run, kind, course.*kind.events);
    }
  }
  for (const Kind& kind : kinds()) {
    std::vector<CourseEvent>& first = (course.*kind.events).first;
    std::stable_sort(first.begin(), first.end(),
                     [](const CourseEvent& a, const CourseEvent& b) { return a.time < b.time; });
    if (first.size() > most_kept) first.erase(first.begin() + most_kept, first.end());
  }
  return course;
}

}  // namespace rtdata::app
