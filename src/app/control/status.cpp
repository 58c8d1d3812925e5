#include "app/control/status.hpp"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstdio>
#include <cstring>
#include <nlohmann/json.hpp>

#include "loop/core/callback_survey.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/tier_core.hpp"
#include "rtdata/data/value.hpp"
#include "rtdata/fsm/configured.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/sensors/limit.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t most_callbacks = 64;  // those that took most
constexpr std::size_t longest_request = 4096;
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

// Eight steps for each power of two: 0 to 7 ns one by one, then 8, 9 ... 15, 16, 18 ...
void TimeCounts::add(Duration time) noexcept {
  const auto ns = static_cast<std::uint64_t>(std::max<Duration::rep>(time.count(), 0));
  auto index = static_cast<std::size_t>(ns);
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
    : loop_(loop),
      info_(std::make_shared<const Info>(std::move(info))),
      started_(loop.time()),
      started_at_(loop.now()) {
  keep_changes();
}

void StatusSource::set(Info info) {
  info_ = std::make_shared<const Info>(std::move(info));
  keep_changes();
}

void StatusSource::keep_changes() {
  change_subscriptions_.clear();
  for (const std::string& topic : info_->changes) {
    change_subscriptions_.push_back(loop_.subscribe(topic, [this](const EventView& event) {
      auto kept = changes_.find(event.origin());
      if (kept == changes_.end()) kept = changes_.emplace(event.origin(), std::vector<std::byte>{}).first;
      kept->second.assign(event.payload().begin(), event.payload().end());
    }));
    change_subscriptions_.back().set_name("status");
  }
}

std::function<std::string()> StatusSource::answer(std::uint64_t client, std::string_view line) {
  const auto refused = [](std::string why) { return [why = std::move(why)] { return failure(why); }; };
  if (line.size() > longest_request)
    return refused("a request has at most " + std::to_string(longest_request) + " bytes");
  const Json request = Json::parse(line, nullptr, false);
  if (request.is_discarded() || !request.is_object()) return refused("a request is an object of JSON on one line");
  const auto what = request.find("request");
  if (what == request.end() || !what->is_string()) return refused("it has no \"request\"");
  if (*what == "command") return refused("the \"words\" of a command are a list of texts, which is not empty");
  if (*what != "status")
    return refused("there is no request \"" + what->get<std::string>() + "\"; there is \"status\" and \"command\"");
  auto& last = clients_[client];
  const auto before = std::exchange(last, take());
  return [now = last, before] { return text(*now, before.get()); };
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
    seen.payload.assign(event.payload().begin(), event.payload().end());
    if (seen.period > Duration{0} && event.time() >= seen.first_due) {
      seen.now.add((event.time() - seen.first_due) % seen.period);
    }
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
    const Duration period = sensor.running && sensor.counts.has_schedule ? sensor.period : Duration{0};
    if (seen.first_due != sensor.first_due || seen.period != period) {
      seen.now = {};
      seen.before = nullptr;
    }
    seen.first_due = sensor.first_due;
    seen.period = period;
    if (!turns) continue;
    seen.before = seen.now.total() > 0 ? std::make_shared<const TimeCounts>(std::move(seen.now)) : nullptr;
    seen.now = {};
  }
}

std::shared_ptr<const StatusSource::Snapshot> StatusSource::take() {
  begin_watching();
  auto shot = std::make_shared<Snapshot>();
  const Runtime& runtime = loop_.runtime();
  shot->info = info_;
  for (const Info::Part& part : info_->parts)
    shot->places.push_back(part.bus != nullptr ? part.bus->place_counts() : std::vector<PlaceCounts>{});
  shot->started = started_;
  shot->at = loop_.now();
  shot->running_for = shot->at - started_at_;
  shot->sensors = runtime.sensors();
  take_schedules(shot->sensors);
  shot->seen.reserve(shot->sensors.size());
  for (const SensorStatus& sensor : shot->sensors) {
    const Seen& seen = seen_[sensor.name];
    auto lateness = seen.before;
    if (lateness == nullptr && seen.now.total() > 0) lateness = std::make_shared<const TimeCounts>(seen.now);
    const auto kept = changes_.find(sensor.name);
    const bool is_kept = seen.payload.empty() && kept != changes_.end();
    shot->seen.push_back({is_kept ? kept->second : seen.payload, std::move(lateness)});
  }
  shot->loops = runtime.loops();
  shot->sinks = runtime.sinks();
  const detail::RuntimeCore& core = loop_.core().runtime;
  for (const detail::ClosedSink& closed : core.closed_sinks) {
    std::optional<std::string>& path = shot->closed_paths.emplace_back();
    if (closed.path) path = core.hide(*closed.path);
  }
  shot->topics = runtime.topics();
  if (info_->made != nullptr) {
    for (const std::string& name : info_->made->names("machine")) {
      const auto* machine = info_->made->find<fsm::ConfiguredMachine>("machine", name);
      if (machine == nullptr) continue;
      const auto [state, since] = machine->now();
      shot->machines[name] = {std::string(state), std::max(shot->at - since, Duration{0})};
    }
  }
  shot->callbacks = loop_.callbacks();
  shot->callbacks_loop = loop_.config().name;
  ask_tiers(*shot);
  return shot;
}

void StatusSource::ask_tiers(Snapshot& shot) {
  const auto& running = loop_.core().runtime.tiers;
  std::erase_if(tiers_, [&](const AskedTier& known) {
    return std::none_of(running.begin(), running.end(),
                        [&](const auto* tier) { return tier->config.name == known.name; });
  });
  for (detail::TierCore* tier : running) {
    if (!tier->is_running()) continue;
    auto known = std::find_if(tiers_.begin(), tiers_.end(),
                              [&](const AskedTier& one) { return one.name == tier->config.name; });
    if (known == tiers_.end()) known = tiers_.insert(tiers_.end(), AskedTier{tier->config.name, {}, {}, {}});
    if (known->asked != nullptr && known->asked->is_done()) known->answered = std::move(known->asked);
    if (known->asked == nullptr)
      known->asked = tier->loop.core().nodes.begin_survey();  // else it hangs: one question is enough
    known->doing = tier->where();
    shot.tiers.push_back(*known);
  }
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
    one["outages"] = sensor.outages.number;
    one["outage_time_s"] = std::chrono::duration<double>(sensor.outages.time).count();
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
