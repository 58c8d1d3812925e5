// The status of an instance, as the text of an answer.
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstring>
#include <nlohmann/json.hpp>

#include "app/control/status.hpp"
#include "loop/core/callback_survey.hpp"
#include "rtdata/data/value.hpp"
#include "rtdata/fsm/configured.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/sensors/limit.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t longest_request = 4096;
constexpr std::size_t most_callbacks = 64;                          // those that took most
constexpr Duration tier_patience = std::chrono::milliseconds{200};  // for all tiers together

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

/// Of an alarm or an output: what matters now, in place of all fields.
void add_change(Json& json, const Description& description, const std::vector<std::byte>& payload) {
  const auto named = [&](const char* path) { return short_value(read(*description.find(path), payload.data())); };
  if (description.same_meaning(*description_of<Alarm>()) && payload.size() == sizeof(Alarm)) {
    Alarm alarm;
    std::memcpy(&alarm, payload.data(), sizeof alarm);
    const std::string name = named("alarm");
    json["alarm"] = {{"alarm", name}, {"active", alarm.is_active}, {"acknowledged", alarm.acknowledged}};
    json["value"] = name + (alarm.value ? " at " + short_value(*alarm.value) : "");
  } else if (description.same_meaning(*description_of<OutputChange>()) && payload.size() == sizeof(OutputChange)) {
    OutputChange change;
    std::memcpy(&change, payload.data(), sizeof change);
    json["value"] = (change.done ? short_value(*change.done) : std::string("not set")) + ", by " + named("cause");
  }
}

std::uint64_t events_of(const SensorCounts& counts) { return counts.has_schedule ? counts.taken : counts.received; }

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

std::optional<std::string> StatusSource::refusal_of(std::string_view line) {
  if (line.size() > longest_request)
    return failure("a request has at most " + std::to_string(longest_request) + " bytes");
  const Json request = Json::parse(line, nullptr, false);
  if (request.is_discarded() || !request.is_object()) return failure("a request is an object of JSON on one line");
  const auto what = request.find("request");
  if (what == request.end() || !what->is_string()) return failure("it has no \"request\"");
  if (*what == "command") return failure("the \"words\" of a command are a list of texts, which is not empty");
  if (*what != "status")
    return failure("there is no request \"" + what->get<std::string>() + "\"; there is \"status\" and \"command\"");
  return {};
}

std::string StatusSource::text(const Snapshot& now, const Snapshot* before) {
  const double seconds = before != nullptr ? std::chrono::duration<double>(now.at - before->at).count() : 0;
  const auto per_second = [&](double count) { return seconds > 0 ? Json(count / seconds) : Json(); };
  std::map<std::string_view, std::uint64_t> events_before;
  std::map<std::string_view, Duration> processor_before;
  if (before != nullptr) {
    for (const SensorStatus& sensor : before->sensors) events_before[sensor.name] = events_of(sensor.counts);
    for (const LoopStatus& loop : before->loops) processor_before[loop.name] = loop.processor_time;
  }
  std::map<std::string_view, std::shared_ptr<const Description>> descriptions;
  for (const TopicStatus& topic : now.topics) descriptions[topic.name] = topic.description;

  Json json;
  json["instance"] = {{"name", now.info->name},
                      {"pid", ::getpid()},
                      {"started", to_iso8601(now.started)},
                      {"running_for_s", std::chrono::duration<double>(now.running_for).count()},
                      {"configuration", now.info->configuration}};
  json["interval_s"] = seconds > 0 ? Json(seconds) : Json();

  std::map<std::string_view, TimeCounts> lateness;  // of loops
  Json& sensors = json["sensors"] = Json::array();
  for (std::size_t i = 0; i < now.sensors.size(); ++i) {
    const SensorStatus& sensor = now.sensors[i];
    const SeenSensor& seen = now.seen[i];
    const SensorCounts& counts = sensor.counts;
    const auto known = events_before.find(sensor.name);
    const std::uint64_t events = events_of(counts);
    const std::uint64_t events_then = known == events_before.end() ? 0 : std::min(known->second, events);
    if (seen.lateness != nullptr) lateness[sensor.loop].add(*seen.lateness);
    const bool has_rate = counts.has_schedule && sensor.period > Duration{0};
    const auto& description = descriptions[sensor.topic];
    const bool has_value = description != nullptr && !seen.payload.empty();
    Json one{{"name", sensor.name}, {"topic", sensor.topic}, {"loop", sensor.loop}, {"running", sensor.running}};
    one["wanted_hz"] = has_rate ? Json(1e9 / static_cast<double>(sensor.period.count())) : Json();
    one["reached_hz"] = per_second(static_cast<double>(events - events_then));
    one["published"] = counts.published;
    one["late"] = counts.late;
    one["missed"] = counts.missed;
    one["failed"] = counts.failed;
    one["unreadable"] = counts.unreadable;
    one["repeated"] = counts.repeated;
    one["outages"] = sensor.outages.number;
    one["outage_time_s"] = std::chrono::duration<double>(sensor.outages.time).count();
    one["first_lines"] = counts.first_lines;
    one["lost"] = counts.lost_is_known ? Json(counts.lost) : Json();
    one["lateness_ns"] = seen.lateness != nullptr ? lateness_json(*seen.lateness) : Json();
    one["health"] = health_json(sensor.health, sensor.reason);
    one["value"] = has_value ? Json(value_text(*description, seen.payload.data())) : Json();
    if (has_value) add_change(one, *description, seen.payload);
    if (const auto machine = now.machines.find(sensor.name); machine != now.machines.end()) {
      const auto& [state, in_state] = machine->second;
      one["state"] = state;
      one["in_state_s"] = std::chrono::duration<double>(in_state).count();
      const auto tenths = std::chrono::floor<std::chrono::duration<std::int64_t, std::deci>>(in_state);
      one["value"] = state + " for " + to_string(Duration{tenths});
    }
    sensors.push_back(std::move(one));
  }

  // On the socket's thread: a tier that turns has answered by now or does so at once.
  const auto patience_ends = std::chrono::steady_clock::now() + tier_patience;
  std::map<std::string_view, const AskedTier*> silent;
  for (const AskedTier& tier : now.tiers) {
    if (!tier.asked->wait(std::max(patience_ends - std::chrono::steady_clock::now(), Duration{0})))
      silent[tier.name] = &tier;
  }

  Json& loops = json["loops"] = Json::array();
  for (const LoopStatus& loop : now.loops) {
    Json one{{"name", loop.name},
             {"tier", loop.is_tier},
             {"running", loop.running},
             {"policy", std::string(name_of(loop.scheduling.policy))},
             {"priority", loop.scheduling.priority}};
    const Duration spent = loop.processor_time - processor_before[loop.name];
    one["load_percent"] = per_second(100 * std::chrono::duration<double>(spent).count());
    const auto late = lateness.find(loop.name);
    one["lateness_ns"] = late == lateness.end() ? Json() : lateness_json(late->second);
    one["warnings"] = loop.warnings;
    const auto in = silent.find(loop.name);
    one["hangs_in"] = in == silent.end() ? Json() : Json(in->second->doing);
    loops.push_back(std::move(one));
  }

  Json& sinks = json["sinks"] = Json::array();
  for (std::size_t at = 0; at < now.sinks.size(); ++at) {
    const SinkStatus& sink = now.sinks[at];
    Json dropped;
    for (std::size_t i = 0; i < drop_reasons; ++i) {
      dropped[std::string(name_of(static_cast<DropReason>(i)))] = sink.counts.dropped[i];
    }
    const auto known = now.info->sink_paths.find(sink.name);
    std::string path = known == now.info->sink_paths.end() ? std::string() : known->second;
    if (at < now.closed_paths.size() && now.closed_paths[at]) path = *now.closed_paths[at];
    sinks.push_back({{"name", sink.name},
                     {"path", path},
                     {"offered", sink.counts.offered},
                     {"queued", sink.counts.queued},
                     {"stored", sink.counts.stored},
                     {"dropped", sink.counts.all_dropped()},
                     {"dropped_by_reason", dropped},
                     {"health", health_json(sink.health, sink.reason)}});
    Json& backlog = sinks.back()["backlog"];  // null: its events wait in memory
    if (sink.backlog) {
      backlog = {{"events", sink.counts.queued}, {"bytes", sink.backlog->bytes}};
      backlog["age_s"] = std::chrono::duration<double>(sink.backlog->age).count();
      backlog["catch_up_s"] = sink.backlog->catch_up
                                  ? Json(std::chrono::duration<double>(*sink.backlog->catch_up).count())
                                  : Json();
      backlog["oldest"] = sink.backlog->oldest == Time{} ? Json() : Json(to_nanoseconds(sink.backlog->oldest));
    }
  }

  Json& parts = json["parts"] = Json::array();
  for (std::size_t i = 0; i < now.info->parts.size(); ++i) {
    const Info::Part& part = now.info->parts[i];
    Json one{{"kind", part.kind}, {"name", part.name}, {"type", part.type}, {"users", part.users}};
    for (const auto& [place, counts] : now.places[i]) {
      one["places"].push_back({{"place", place},
                               {"transfers", counts.transfers},
                               {"failed", counts.failed},
                               {"retried", counts.retried},
                               {"busy_ns", counts.busy.count()},
                               {"longest_ns", counts.longest.count()}});
    }
    parts.push_back(std::move(one));
  }

  Json& topics = json["topics"] = Json::array();
  for (const TopicStatus& topic : now.topics) {
    topics.push_back(
        {{"name", topic.name}, {"published", topic.published}, {"handlers_dropped", topic.subscriptions.dropped}});
  }

  struct Callback {
    const CallbackStatus* status;
    std::string_view loop;
  };
  std::vector<Callback> callbacks;
  const auto add_callbacks = [&](const std::vector<CallbackStatus>& all, std::string_view loop) {
    for (const CallbackStatus& one : all) {
      if (one.times.count > 0) callbacks.push_back({&one, loop});
    }
  };
  add_callbacks(now.callbacks, now.callbacks_loop);
  for (const AskedTier& tier : now.tiers) {
    const auto& survey = silent.contains(tier.name) ? tier.answered : tier.asked;
    if (survey != nullptr) add_callbacks(survey->callbacks(), tier.name);
  }
  std::sort(callbacks.begin(), callbacks.end(),
            [](const Callback& a, const Callback& b) { return a.status->times.total > b.status->times.total; });
  callbacks.resize(std::min(callbacks.size(), most_callbacks));
  Json& callbacks_json = json["callbacks"] = Json::array();
  for (const auto& [one, loop] : callbacks) {
    callbacks_json.push_back({{"name", one->name},
                              {"loop", loop},
                              {"count", one->times.count},
                              {"total_ns", one->times.total.count()},
                              {"max_ns", one->times.max.count()}});
  }
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace rtdata::app
