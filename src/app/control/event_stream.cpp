#include "app/control/event_stream.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <nlohmann/json.hpp>
#include <variant>

#include "app/control/request.hpp"
#include "app/control/status.hpp"
#include "app/core/figures.hpp"
#include "app/core/number_text.hpp"
#include "rtdata/loop/gaps.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

constexpr Duration step_grace = std::chrono::milliseconds{100};  // events of other tiers and lanes come a little later
constexpr Duration silence = std::chrono::seconds{1};
constexpr Duration shortest_step = std::chrono::milliseconds{1}, longest_step = std::chrono::hours{24};

/// The time from which on a step that ends at `end` is complete.
Time later_by_grace(Time end) { return end > Time::max() - step_grace ? end : end + step_grace; }

std::string quoted(std::string_view text) { return Json(text).dump(-1, ' ', false, Json::error_handler_t::replace); }

void append_real(std::string& text, double number) {
  if (std::isfinite(number)) return append_number(text, number);
  text += std::isnan(number) ? "\"NaN\"" : number > 0 ? "\"Infinity\"" : "\"-Infinity\"";
}

/// None: it is absent, or NaN.
std::optional<double> number_of(const Leaf& leaf, const std::byte* payload) {
  if (leaf.kind == Kind::f64 && leaf.optional == nullptr) {  // most numbers are such
    double real = 0;
    std::memcpy(&real, payload + leaf.offset, sizeof real);
    return std::isnan(real) ? std::nullopt : std::optional(real);
  }
  const Value value = read(leaf, payload);
  if (const auto* const real = std::get_if<double>(&value))
    return std::isnan(*real) ? std::nullopt : std::optional(*real);
  if (const auto* const number = std::get_if<std::int64_t>(&value)) return static_cast<double>(*number);
  if (const auto* const number = std::get_if<std::uint64_t>(&value)) return static_cast<double>(*number);
  if (const auto* const flag = std::get_if<bool>(&value)) return *flag ? 1 : 0;
  return std::nullopt;
}

Error refused(std::string why) { return {Errc::bad_argument, "cannot subscribe", "request", std::move(why), ""}; }

Result<Duration> step_of(const Json& given) {
  const auto wrong = [&](const std::string& why) { return refused("\"step\" " + given.dump() + ": " + why); };
  if (!given.is_string()) return wrong("it must be a text such as \"100 ms\"");
  const Result<Duration> step = parse_duration(given.get<std::string>());
  if (!step) return wrong(step.error().text());
  if (*step < shortest_step || *step > longest_step)
    return wrong("it must be from " + to_string(shortest_step) + " to " + to_string(longest_step));
  return *step;
}

/// "-10 min", an instant in ISO 8601, or ns since 1970 as events have them.
Result<void> set_beginning(const Json& given, StreamRequest& request) {
  const bool is_too_large = given.is_number_unsigned() &&
                            given.get<std::uint64_t>() > std::uint64_t{std::numeric_limits<std::int64_t>::max()};
  if (given.is_number_integer() && !is_too_large) {
    request.from = from_nanoseconds(given.get<std::int64_t>());
    return {};
  }
  const std::string text = given.is_string() ? given.get<std::string>() : "";
  if (text.starts_with('-')) {
    if (const auto ago = parse_duration(text.substr(1))) {
      request.ago = *ago;
      return {};
    }
  } else if (const auto from = parse_iso8601(text)) {
    request.from = *from;
    return {};
  }
  std::int64_t ns = 0;
  const char* const end = text.data() + text.size();
  if (const auto read = std::from_chars(text.data(), end, ns); read.ec == std::errc{} && read.ptr == end) {
    request.from = from_nanoseconds(ns);
    return {};
  }
  return refused("\"from\" " + given.dump(-1, ' ', false, Json::error_handler_t::replace) +
                 ": it is an instant such as \"2026-03-01T12:00:00Z\", a time before now such as \"-10 min\", or ns "
                 "since 1970");
}

Result<std::vector<std::string>> topics_of(const Json& given) {
  if (!given.is_array() || given.empty() || given.size() > StreamRequest::most_topics)
    return refused("\"topics\" is a list of 1 to " + std::to_string(StreamRequest::most_topics) + " patterns");
  std::vector<std::string> topics;
  for (const Json& one : given) {
    if (!one.is_string() || !is_topic_pattern(one.get_ref<const std::string&>()))
      return refused(one.dump(-1, ' ', false, Json::error_handler_t::replace) +
                     " is neither a topic nor a pattern, such as \"room/+\" or \"room/#\"");
    topics.push_back(one.get<std::string>());
  }
  return topics;
}

}  // namespace

// ---- requests

bool StreamRequest::names(std::string_view topic) const noexcept {
  return std::any_of(topics.begin(), topics.end(), [&](const auto& one) { return topic_matches(one, topic); });
}

bool StreamRequest::is_beside(std::string_view topic) noexcept { return topic == health_topic || topic == gap_topic; }

bool asks_for_events(std::string_view line) {
  const Json request = Json::parse(line, nullptr, false);
  if (!request.is_object()) return false;
  const auto what = request.find("request");
  return what != request.end() && *what == "subscribe";
}

Result<StreamRequest> stream_request(std::string_view line) {
  StreamRequest request;
  const Json given = Json::parse(line, nullptr, false);
  if (!given.is_object()) return refused("a request is an object of JSON on one line");
  if (std::string why = refusal_of_version(given); !why.empty()) return refused(std::move(why));
  for (const auto& [key, value] : given.items()) {
    if (key == "request" || key == "version") continue;
    if (key == "topics") {
      auto topics = topics_of(value);
      if (!topics) return std::move(topics).error();
      request.topics = *std::move(topics);
    } else if (key == "step") {
      const auto step = step_of(value);
      if (!step) return step.error();
      request.step = *step;
    } else if (key == "from") {
      if (auto set = set_beginning(value, request); !set) return std::move(set).error();
    } else if (key == "of" && value.is_string()) {
      request.of = value.get<std::string>();
    } else {
      return refused("there is no \"" + key + "\" like this; available: \"topics\", \"step\", \"from\" and \"of\"");
    }
  }
  if (!request.of.empty() && !request.wants_past())
    return refused("\"of\" names the recording to read first: say \"from\" which instant");
  return request;
}

// ---- origins, lines

const StreamOrigin& StreamOrigins::of(const PackedEvent& event) {
  const auto known = all_.find(event.key());
  if (known != all_.end()) return known->second;
  StreamOrigin made{all_.size(), std::string(event.topic()), quoted(event.topic()), quoted(event.origin())};
  return all_.emplace(std::string(event.key()), std::move(made)).first->second;
}

std::string_view EventLine::text() {
  if (line_.empty()) {
    const EventHeader header = event_->header();
    const EventView view(event_->topic(), header, *event_->description, {event_->payload(), event_->payload_bytes});
    if (!codec_->encode(view, line_)) return {};
  }
  return {reinterpret_cast<const char*>(line_.data()), line_.size()};
}

// ---- steps

void StepSums::set(const Description* description) {
  description_ = description;
  leaves_.clear();
  for (const Leaf& leaf : description->leaves())
    if (is_number(leaf.kind)) leaves_.push_back(&leaf);
}

bool StepSums::goes_on_with(const Description* description) {
  if (description == description_) return true;
  if (!description_->same_meaning(*description)) return false;
  set(description);
  return true;
}

void StepSums::begin(const PackedEvent& event, Time from, Time until) {
  if (description_ != event.description) set(event.description);
  numbers_.assign(leaves_.size(), {});
  from_ = from;
  until_ = until;
  count_ = 0;
  first_ = event.sequence;
  add(event);
}

void StepSums::add(const PackedEvent& event) {
  ++count_;
  last_ = event.sequence;
  for (std::size_t i = 0; i < leaves_.size(); ++i) {
    const auto value = number_of(*leaves_[i], event.payload());
    if (!value) continue;
    Number& number = numbers_[i];
    ++number.count;
    number.least = number.count == 1 ? *value : std::min(number.least, *value);
    number.most = number.count == 1 ? *value : std::max(number.most, *value);
    weigh_in(number.mean, *value, 1 / static_cast<double>(number.count));
    number.last = *value;
  }
}

void StepSums::add(const StepSums& later) {
  until_ = later.until_;
  last_ = later.last_;
  count_ += later.count_;
  for (std::size_t i = 0; i < numbers_.size(); ++i) {
    const Number& from = later.numbers_[i];
    Number& to = numbers_[i];
    if (from.count == 0) continue;
    to.least = to.count == 0 ? from.least : std::min(to.least, from.least);
    to.most = to.count == 0 ? from.most : std::max(to.most, from.most);
    to.count += from.count;
    weigh_in(to.mean, from.mean, static_cast<double>(from.count) / static_cast<double>(to.count));
    to.last = from.last;
  }
}

void StepSums::append_to(std::string& text, const StreamOrigin& origin) const {
  text.append("{\"topic\":").append(origin.quoted_topic).append(",\"time\":");
  append_number(text, to_nanoseconds(from_));
  text += ",\"until\":";
  append_number(text, to_nanoseconds(until_));
  text.append(",\"origin\":").append(origin.quoted_origin).append(",\"sequence\":[");
  append_number(text, first_);
  text += ',';
  append_number(text, last_);
  text += "],\"count\":";
  append_number(text, count_);
  text += ",\"data\":{";
  for (std::size_t i = 0; i < leaves_.size(); ++i) {
    const Number& number = numbers_[i];
    text.append(i == 0 ? "\"" : ",\"").append(leaves_[i]->path).append("\":{\"count\":");
    append_number(text, number.count);
    if (number.count > 0) {
      const auto add = [&](const char* key, double value) {
        text += key;
        append_real(text, value);
      };
      add(",\"least\":", number.least);
      add(",\"most\":", number.most);
      add(",\"mean\":", number.mean);
      add(",\"last\":", number.last);
    }
    text += '}';
  }
  text += "}}\n";
}

// ---- the stream

EventStream::EventStream(StreamRequest request, std::string_view run, std::string_view recording)
    : request_(std::move(request)), is_live_(recording.empty()) {
  Json told{{"subscribed", request_.topics}, {"version", Status::newest}};
  if (is_live_) {
    told["run"] = run_ = run;
  } else {
    told["from"] = to_nanoseconds(*request_.from);
    told["of"] = recording;
  }
  text_ = told.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n";
}

void EventStream::begin_run(std::string_view uuid) {
  if (run_ == uuid) return;
  run_ = uuid;
  for (State& state : states_) {
    if (!state.step.is_empty()) give_step(state);
    state.last = 0;
    state.told = nullptr;
  }
  text_ += Json{{"run", uuid}}.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n";
}

void EventStream::go_live(Time now) {
  is_live_ = true;
  for (State& state : states_) state.told = nullptr;  // descriptions of another source follow
  text_ += Json{{"live", to_nanoseconds(now)}}.dump() + "\n";
}

EventStream::State& EventStream::state_of(const StreamOrigin& origin) {
  if (origin.index >= states_.size()) states_.resize(origin.index + 1);
  State& state = states_[origin.index];
  if (!state.is_known) {
    state.is_known = true;
    state.is_taken = takes(origin.topic);
    state.origin = &origin;
  }
  return state;
}

void EventStream::take(const PackedEvent& event, const StreamOrigin& origin, EventLine& line) {
  State& state = state_of(origin);
  if (!state.is_taken || event.sequence <= state.last) return;
  const bool is_event = event.description != nullptr;
  const std::uint64_t before = event.sequence - (is_event ? 1 : 0);  // up to which all should have come
  if (state.last != 0 && before > state.last) {
    drop(origin, before - state.last);
  } else if (!is_event) {
    drop(origin, 1);  // at least
  }
  state.last = event.sequence;
  if (!is_event) return;
  if (request_.step > Duration{0} && !StreamRequest::is_beside(origin.topic)) {
    add_to_step(state, event);
  } else if (is_behind_) {
    drop(origin, 1);
    hold(state, event);
  } else {
    tell_units(state, *event.description);
    text_ += line.text();
    has_new_lines_ = true;
    look_whether_behind();
  }
}

void EventStream::tell_units(State& state, const Description& description) {
  if (std::exchange(state.told, &description) == &description) return;
  Json units = Json::object();
  for (const Leaf& leaf : description.leaves()) units[leaf.path] = leaf.unit;
  std::string text = units.dump(-1, ' ', false, Json::error_handler_t::replace);
  std::string& last = units_told_[state.origin->quoted_topic];
  if (text == last) return;
  last = std::move(text);
  text_ += "{\"units\":" + last + ",\"of\":" + state.origin->quoted_topic + "}\n";
}

void EventStream::drop(const StreamOrigin& origin, std::uint64_t count) {
  if (is_behind_) {
    dropped_[origin.quoted_topic] += count;
  } else {
    tell_dropped(origin.quoted_topic, count);
  }
}

void EventStream::tell_dropped(const std::string& quoted_topic, std::uint64_t count) {
  text_ += "{\"dropped\":" + std::to_string(count) + ",\"of\":" + quoted_topic + "}\n";
  has_new_lines_ = true;
  look_whether_behind();
}

void EventStream::add_to_step(State& state, const PackedEvent& event) {
  const std::int64_t length = request_.step.count();
  const std::int64_t past = event.time % length;
  const Time from = from_nanoseconds(event.time - (past < 0 ? past + length : past));
  if (!state.step.is_empty() && (state.step.from() != from || !state.step.goes_on_with(event.description)))
    give_step(state);
  if (!state.step.is_empty()) return state.step.add(event);
  state.step.begin(event, from, from + request_.step);
  next_end_ = std::min(next_end_, state.step.until());
}

void EventStream::give_step(State& state) {
  if (!is_behind_) {
    tell_units(state, *state.step.description());
    state.step.append_to(text_, *state.origin);
    has_new_lines_ = true;
    look_whether_behind();
  } else {
    drop(*state.origin, 1);
    if (state.held.is_empty() || !state.held.goes_on_with(state.step.description())) {
      state.held = state.step;
    } else {
      state.held.add(state.step);
    }
  }
  state.step.clear();
}

void EventStream::hold(State& state, const PackedEvent& event) {
  const Time time = from_nanoseconds(event.time);
  if (state.held.is_empty() || !state.held.goes_on_with(event.description)) {
    state.held.begin(event, time, time + Duration{1});
  } else {
    state.held.add(event);
    state.held.extend(time + Duration{1});
  }
}

void EventStream::turn(Time now) {
  if (is_live_ && now >= later_by_grace(next_end_)) {
    next_end_ = Time::max();
    for (State& state : states_) {
      if (state.step.is_empty()) continue;
      if (now >= later_by_grace(state.step.until())) {
        give_step(state);
      } else {
        next_end_ = std::min(next_end_, state.step.until());
      }
    }
  }
  if (is_behind_ && text_.size() - sent_ <= most_bytes / 4) catch_up();
  if (std::exchange(has_new_lines_, false)) last_line_ = now;
  if (!is_behind_ && now - last_line_ >= silence) {
    text_ += "{\"now\":" + std::to_string(to_nanoseconds(now)) + "}\n";
    last_line_ = now;
  }
}

void EventStream::catch_up() {
  is_behind_ = false;
  const auto dropped = std::exchange(dropped_, {});
  for (const auto& [topic, count] : dropped) {
    text_ += "{\"dropped\":" + std::to_string(count) + ",\"of\":" + topic + "}\n";
  }
  for (State& state : states_) {
    if (state.held.is_empty()) continue;
    tell_units(state, *state.held.description());
    state.held.append_to(text_, *state.origin);
    state.held.clear();
  }
  has_new_lines_ = true;
  look_whether_behind();
}

void EventStream::end(const char* key, std::string_view why) {
  for (State& state : states_)
    if (!state.step.is_empty()) give_step(state);
  if (is_behind_) catch_up();
  text_ += Json{{key, why}}.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n";
}

void EventStream::sent(std::size_t bytes) {
  sent_ += bytes;
  if (sent_ == text_.size()) {
    text_.clear();
    sent_ = 0;
  } else if (sent_ > most_bytes) {
    text_.erase(0, sent_);
    sent_ = 0;
  }
}

}  // namespace rtdata::app
