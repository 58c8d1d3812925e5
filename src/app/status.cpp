#include "app/status.hpp"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "rtdata/data/value.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t most_callbacks = 64;  // those that took most

std::string short_value(const Value& value) {
  if (const double* number = std::get_if<double>(&value)) {
    std::array<char, 32> text{};
    std::snprintf(text.data(), text.size(), "%.6g", *number);
    return text.data();
  }
  return to_string(value);
}

std::string value_text(const Description& description, const std::byte* payload) {
  constexpr std::size_t longest = 200;
  std::string text;
  for (const Leaf& leaf : description.leaves()) {
    if (text.size() > longest) return text + " ...";
    text += (text.empty() ? "" : " ") + short_value(read(leaf, payload));
    if (!leaf.unit.empty() && leaf.unit != "1") text += " " + leaf.unit;
  }
  return text;
}

double hertz(std::uint64_t events, double seconds) { return static_cast<double>(events) / seconds; }

Json lateness_json(const TimeCounts& counts) {
  if (counts.total() == 0) return nullptr;
  return {{"p50", counts.percentile(0.5).count()},
          {"p99", counts.percentile(0.99).count()},
          {"max", counts.largest().count()}};
}

Json health_json(Health health, const std::string& reason) {
  return {{"state", std::string(name_of(health))}, {"reason", reason}};
}

std::string failure(const std::string& why) {
  return Json{{"error", why}}.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace

// Eight steps for each power of two: 0 to 7 ns one by one, then 8, 9 ... 15, 16, 18 ...
void TimeCounts::add(Duration time) noexcept {
  const auto ns = static_cast<std::uint64_t>(std::max<Duration::rep>(time.count(), 0));
  std::size_t index = ns;
  if (ns >= 8) {
    const auto shift = static_cast<std::size_t>(std::bit_width(ns)) - 4;
    index = 8 * (shift + 1) + ((ns >> shift) & 7);
  }
  ++counts_[std::min(index, counts_.size() - 1)];
  ++total_;
  largest_ = std::max(largest_, time);
}

void TimeCounts::add(const TimeCounts& other) noexcept {
  for (std::size_t i = 0; i < counts_.size(); ++i) counts_[i] += other.counts_[i];
  total_ += other.total_;
  largest_ = std::max(largest_, other.largest_);
}

Duration TimeCounts::percentile(double fraction) const noexcept {
  const auto wanted = static_cast<std::uint64_t>(fraction * static_cast<double>(total_));
  std::uint64_t below = 0;
  for (std::size_t i = 0; i < counts_.size(); ++i) {
    below += counts_[i];
    if (below <= wanted) continue;
    const std::size_t next = i + 1;  // its smallest is the first that is above
    const std::uint64_t end = next < 8 ? next : (8 + (next & 7)) << (next / 8 - 1);
    return std::min(largest_, Duration{static_cast<Duration::rep>(end)});
  }
  return largest_;
}

StatusSource::StatusSource(Loop& loop, Info info)
    : loop_(loop), info_(std::move(info)), started_(loop.time()), started_at_(loop.now()) {}

std::string StatusSource::answer(std::uint64_t client, std::string_view line) {
  const Json request = Json::parse(line, nullptr, false);
  if (request.is_discarded() || !request.is_object()) return failure("a request is an object of JSON on one line");
  const auto what = request.find("request");
  if (what == request.end() || !what->is_string()) return failure("it has no \"request\"");
  if (*what == "status") return status(client);
  return failure("there is no request \"" + what->get<std::string>().substr(0, 100) + "\"; there is \"status\"");
}

void StatusSource::forget(std::uint64_t client) {
  clients_.erase(client);
  if (!clients_.empty()) return;
  subscription_.close();
  seen_.clear();
}

void StatusSource::begin_watching() {
  if (subscription_) return;
  subscription_ = loop_.subscribe("#", [this](const EventView& event) {
    const auto found = seen_.find(event.origin());
    if (found == seen_.end()) return;  // made since the last request
    Seen& seen = found->second;
    seen.description = &event.description();
    seen.payload.assign(event.payload().begin(), event.payload().end());
    if (seen.period > Duration{0} && event.time() >= seen.first_due)
      seen.now.add((event.time() - seen.first_due) % seen.period);
  });
  subscription_.set_name("status");
}

void StatusSource::take_schedules(const std::vector<SensorStatus>& sensors) {
  constexpr Duration span = std::chrono::milliseconds{900};
  const MonotonicTime now = loop_.now();
  const bool turns = now - turned_ >= span;
  if (turns) turned_ = now;
  for (const SensorStatus& sensor : sensors) {
    Seen& seen = seen_[sensor.name];
    if (seen.first_due != sensor.first_due || seen.period != sensor.period) seen.now = seen.before = {};
    seen.first_due = sensor.first_due;
    seen.period = sensor.running && sensor.counts.has_schedule ? sensor.period : Duration{0};
    if (!turns) continue;
    seen.before = std::move(seen.now);
    seen.now = {};
  }
}

std::string StatusSource::status(std::uint64_t client) {
  begin_watching();
  const std::vector<SensorStatus> sensors = loop_.runtime().sensors();
  take_schedules(sensors);
  const MonotonicTime now = loop_.now();
  Baseline& last = clients_[client];
  const bool knows_before = last.at != MonotonicTime{};
  const double seconds = std::chrono::duration<double>(now - last.at).count();
  const auto counted = [&](const Json& value) { return knows_before && seconds > 0 ? value : Json(); };

  Json json;
  json["instance"] = {{"name", info_.name},
                      {"pid", ::getpid()},
                      {"started", to_iso8601(started_)},
                      {"running_for_s", std::chrono::duration<double>(now - started_at_).count()},
                      {"configuration", info_.configuration}};
  json["interval_s"] = counted(seconds);

  std::map<std::string, TimeCounts> lateness;  // of loops
  Json& sensors_json = json["sensors"] = Json::array();
  for (const SensorStatus& sensor : sensors) {
    const SensorCounts& counts = sensor.counts;
    const std::uint64_t events = counts.has_schedule ? counts.taken : counts.received;
    std::uint64_t& before = last.events[sensor.name];
    const Seen& seen = seen_[sensor.name];
    TimeCounts late = seen.before;
    if (late.total() == 0) late = seen.now;
    if (late.total() > 0) lateness[sensor.loop].add(late);
    Json one{{"name", sensor.name}, {"topic", sensor.topic}, {"loop", sensor.loop}, {"running", sensor.running}};
    one["wanted_hz"] = counts.has_schedule && sensor.period > Duration{0}
                           ? Json(1e9 / static_cast<double>(sensor.period.count()))
                           : Json();
    one["reached_hz"] = counted(hertz(events - std::min(before, events), seconds));
    before = events;
    one["published"] = counts.published;
    one["late"] = counts.late;
    one["missed"] = counts.missed;
    one["failed"] = counts.failed;
    one["lost"] = counts.lost_is_known ? Json(counts.lost) : Json();
    one["lateness_ns"] = lateness_json(late);
    one["health"] = health_json(sensor.health, sensor.reason);
    one["value"] = seen.description == nullptr ? Json() : Json(value_text(*seen.description, seen.payload.data()));
    sensors_json.push_back(std::move(one));
  }

  Json& loops_json = json["loops"] = Json::array();
  for (const LoopStatus& loop : loop_.runtime().loops()) {
    Duration& before = last.processor[loop.name];
    Json one{{"name", loop.name},
             {"tier", loop.is_tier},
             {"running", loop.running},
             {"policy", std::string(name_of(loop.scheduling.policy))},
             {"priority", loop.scheduling.priority}};
    one["load_percent"] = counted(100 * std::chrono::duration<double>(loop.processor_time - before).count() / seconds);
    before = loop.processor_time;
    const auto late = lateness.find(loop.name);
    one["lateness_ns"] = late == lateness.end() ? Json() : lateness_json(late->second);
    one["warnings"] = loop.warnings;
    loops_json.push_back(std::move(one));
  }

  Json& sinks_json = json["sinks"] = Json::array();
  for (const SinkStatus& sink : loop_.runtime().sinks()) {
    Json dropped;
    for (std::size_t i = 0; i < drop_reasons; ++i)
      dropped[std::string(name_of(static_cast<DropReason>(i)))] = sink.counts.dropped[i];
    const auto path = info_.sink_paths.find(sink.name);
    sinks_json.push_back({{"name", sink.name},
                          {"path", path == info_.sink_paths.end() ? "" : path->second},
                          {"offered", sink.counts.offered},
                          {"queued", sink.counts.queued},
                          {"stored", sink.counts.stored},
                          {"dropped", sink.counts.all_dropped()},
                          {"dropped_by_reason", dropped},
                          {"health", health_json(sink.health, sink.reason)}});
  }

  Json& topics_json = json["topics"] = Json::array();
  for (const TopicStatus& topic : loop_.runtime().topics()) {
    topics_json.push_back(
        {{"name", topic.name}, {"published", topic.published}, {"handlers_dropped", topic.subscriptions.dropped}});
  }

  std::vector<CallbackStatus> callbacks = loop_.callbacks();
  std::erase_if(callbacks, [](const CallbackStatus& one) { return one.times.count == 0; });
  const std::size_t shown = std::min(callbacks.size(), most_callbacks);
  std::partial_sort(callbacks.begin(), callbacks.begin() + static_cast<std::ptrdiff_t>(shown), callbacks.end(),
                    [](const CallbackStatus& a, const CallbackStatus& b) { return a.times.total > b.times.total; });
  callbacks.resize(shown);
  Json& callbacks_json = json["callbacks"] = Json::array();
  for (const CallbackStatus& one : callbacks) {
    callbacks_json.push_back({{"name", one.name},
                              {"loop", loop_.config().name},
                              {"count", one.times.count},
                              {"total_ns", one.times.total.count()},
                              {"max_ns", one.times.max.count()}});
  }
  last.at = now;
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace rtdata::app
