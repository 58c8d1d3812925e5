#include "app/inspect/event_printer.hpp"

#include <array>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <utility>

#include "app/core/table.hpp"
#include "app/inspect/stream_line.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/loop/gaps.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

std::string shown(const Json& value) {
  if (value.is_string()) return value.get<std::string>();
  if (!value.is_number_float())
    return value.is_null() ? "absent" : value.dump(-1, ' ', false, Json::error_handler_t::replace);
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%.6g", value.get<double>());
  return text.data();
}

bool is_true(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_boolean() && found->get<bool>();
}

}  // namespace

std::string EventPrinter::text(std::string_view json) {
  const Json line = Json::parse(json, nullptr, false);
  if (!line.is_object()) return "";
  if (const auto units = line.find("units"); units != line.end() && units->is_object()) {
    auto& of_topic = units_[text_in(line, "of")];
    of_topic.clear();
    for (const auto& [path, unit] : units->items())
      if (unit.is_string() && unit != "1") of_topic[path] = unit.get<std::string>();
    return "";
  }
  const std::string shown_line = line_of(line);
  if (shown_line.empty()) return "";
  std::string before = "             ";
  std::string result;
  if (line.contains("time")) {
    const std::string utc = to_iso8601(from_nanoseconds(whole_in(line, "time")));  // 2026-03-01T12:00:00.123456789Z
    if (std::string day = utc.substr(0, utc.find('T')); day != day_) {
      result = day + " UTC\n";
      day_ = std::move(day);
    }
    before = utc.substr(utc.find('T') + 1, 12) + " ";
  }
  const std::string whole = before + shown_line;
  return result + (columns_ == 0 ? fitted(whole, whole.size()) : fitted(whole, columns_)) + "\n";
}

std::string EventPrinter::line_of(const Json& line) const {
  if (line.contains("dropped"))
    return "! " + line["dropped"].dump() + " of " + text_in(line, "of") + " left out: too many to be read in time";
  if (!line.contains("topic") || !line.contains("data") || !line["data"].is_object()) return "";
  const Json& data = line["data"];
  if (text_in(line, "topic") == health_topic) {
    const std::string state = text_in(data, "state"), reason = text_in(data, "reason");
    return (state == "ok" ? "" : "! ") + text_in(data, "kind") + " " + text_in(data, "name") + " " + state +
           (reason.empty() ? "" : ": " + reason);
  }
  if (text_in(line, "topic") == gap_topic) {
    const std::string count = data.contains("count") && data["count"] != 0 ? " " + data["count"].dump() : "";
    const Duration length = from_nanoseconds(whole_in(data, "last")) - from_nanoseconds(whole_in(data, "first"));
    return "! gap of " + text_in(data, "name") + ":" + count + " " + text_in(data, "kind") + " in " +
           to_string(std::chrono::floor<std::chrono::milliseconds>(length)) + ": " + text_in(data, "reason");
  }
  return event_text(line);
}

std::string EventPrinter::event_text(const Json& line) const {
  const std::string topic = text_in(line, "topic"), origin = text_in(line, "origin");
  const Json& data = line["data"];
  std::string text = is_true(data, "is_active") && data.contains("alarm") ? "! " + topic : topic;  // of a limit
  if (!origin.empty() && origin != topic && !topic.ends_with("/" + origin) && origin != "program:" + topic)
    text += " (" + origin + ")";
  const bool is_step = line.contains("count");
  if (is_step) text += " " + line["count"].dump() + (line["count"] == 1 ? " event:" : " events:");
  for (const auto& [path, value] : data.items()) {
    text += ' ';
    if (!is_step) {
      append_value(text, topic, path, value);
      continue;
    }
    text += path + "=";
    if (!value.contains("mean")) {
      text += "absent";
      continue;
    }
    text += shown(value["mean"]) + " (" + shown(value["least"]) + " to " + shown(value["most"]) + ")";
    if (const std::string unit = unit_of(topic, path); !unit.empty()) text += " " + unit;
  }
  return text;
}

std::string EventPrinter::unit_of(std::string_view topic, const std::string& path) const {
  const auto of_topic = units_.find(topic);
  if (of_topic == units_.end()) return "";
  const auto found = of_topic->second.find(path);
  return found == of_topic->second.end() ? std::string() : found->second;
}

void EventPrinter::append_value(std::string& text, std::string_view topic, const std::string& path,
                                const Json& value) const {
  bool is_first = true;
  const auto next = [&](const std::string& inner, const Json& of) {
    if (!std::exchange(is_first, false)) text += ' ';
    append_value(text, topic, inner, of);
  };
  if (value.is_object()) {
    for (const auto& [name, inner] : value.items()) next(path + "." + name, inner);
  } else if (value.is_array()) {
    for (std::size_t i = 0; i < value.size(); ++i) next(path + "[" + std::to_string(i) + "]", value[i]);
  } else {
    text += path + "=" + shown(value);
    if (const std::string unit = unit_of(topic, path); !unit.empty() && !value.is_null()) text += " " + unit;
  }
}

}  // namespace rtdata::app
