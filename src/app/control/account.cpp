#include "app/control/account.hpp"

#include <algorithm>
#include <functional>
#include <iterator>
#include <map>
#include <utility>

#include "loop/runtime/final_account.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "recording/account_text.hpp"

namespace rtdata::app {

namespace {

void add(Status::Account& sum, const Status::Account& of) {
  sum.late += of.late, sum.missed += of.missed, sum.failed += of.failed, sum.unreadable += of.unreadable;
  sum.failed_unreadable += of.failed_unreadable;
  sum.lost_is_known = sum.lost_is_known || of.lost_is_known;
  sum.lost += of.lost, sum.repeated += of.repeated, sum.first_lines += of.first_lines;
  sum.outages.add(of.outages);
  if (of.health <= sum.health) return;
  sum.health = of.health;
  sum.reason = of.reason;
}

Status::Sensor shown(SensorStatus& of) {
  const SensorCounts& counts = of.counts;
  Status::Sensor sensor;
  sensor.name = std::move(of.name);
  sensor.topic = std::move(of.topic);
  sensor.loop = std::move(of.loop);
  sensor.is_running = of.running;
  sensor.published = counts.published, sensor.late = counts.late, sensor.missed = counts.missed;
  sensor.failed = counts.failed, sensor.unreadable = counts.unreadable, sensor.lost = counts.lost;
  sensor.failed_unreadable = detail::failed_unreadable(counts);
  sensor.repeated = counts.repeated, sensor.first_lines = counts.first_lines;
  sensor.lost_is_known = counts.lost_is_known;
  sensor.outages = of.outages;
  sensor.health = of.health;
  sensor.reason = std::move(of.reason);
  if (counts.has_schedule && of.period > Duration{0}) sensor.wanted_hz = 1e9 / static_cast<double>(of.period.count());
  sensor.readings = counts.has_schedule ? counts.taken : counts.received;
  sensor.first_due = of.first_due;
  if (of.running && counts.has_schedule) sensor.period = of.period;
  return sensor;
}

Status::Sink shown(SinkStatus& of, const std::map<std::string, std::string>& paths) {
  Status::Sink sink;
  const auto path = paths.find(of.name);
  sink.path = path == paths.end() ? std::string() : path->second;
  sink.name = std::move(of.name);
  sink.offered = of.counts.offered, sink.queued = of.counts.queued, sink.stored = of.counts.stored;
  std::copy(std::begin(of.counts.dropped), std::end(of.counts.dropped), sink.dropped.begin());
  sink.health = of.health;
  sink.reason = std::move(of.reason);
  sink.backlog = of.backlog;
  return sink;
}

}  // namespace

Status status_of(Runtime& runtime, const std::map<std::string, std::string>& paths) {
  Status status;
  std::map<std::string, std::size_t, std::less<>> at;
  std::vector<TopicStatus> topics = runtime.topics();
  std::erase_if(topics, [](const TopicStatus& topic) { return topic.name.starts_with('$'); });
  for (const TopicStatus& topic : topics) {
    at[topic.name] = status.topics.size();
    status.topics.push_back(
        {.name = topic.name, .published = topic.published, .handlers_dropped = topic.subscriptions.dropped});
    status.total.published += topic.published;
    status.total.handlers_dropped += topic.subscriptions.dropped;
  }
  std::vector<SensorStatus> sensors = runtime.sensors();
  const std::size_t open = sensors.size();
  for (SensorStatus& closed : detail::closed_sensors(runtime.core(), sensors)) sensors.push_back(std::move(closed));
  for (SensorStatus& of : sensors) {
    const SensorCounts counts = of.counts;
    Status::Sensor sensor = shown(of);
    if (const auto topic = at.find(sensor.topic); topic != at.end()) {
      add(status.topics[topic->second], sensor);
      add(status.total, sensor);
      sensor.description = topics[topic->second].description;
      if (counts.published == 0) {
        status.mute.push_back(sensor.name);
      } else if (!counts.has_schedule && !counts.lost_is_known) {
        status.not_detectable.push_back(sensor.name);
      }
    }
    if (status.sensors.size() < open) status.sensors.push_back(std::move(sensor));
  }
  for (SinkStatus& of : runtime.sinks()) {
    for (const TopicDrops& dropped : of.dropped)
      if (const auto topic = at.find(dropped.topic); topic != at.end())
        status.topics[topic->second].dropped += dropped.count;
    status.sinks.push_back(shown(of, paths));
    status.total.dropped += status.sinks.back().all_dropped();
    (of.backlog ? status.waiting : status.queued) += of.counts.queued;
  }
  const detail::RuntimeCore& core = runtime.core();
  for (std::size_t i = 0; i < core.closed_sinks.size(); ++i) {
    const detail::ClosedSink& closed = core.closed_sinks[i];
    Status::Sink& sink = status.sinks[i];
    if (closed.path) sink.path = core.hide(*closed.path);
    sink.recording = core.hide(closed.recording);
    sink.is_recording = closed.is_recording;
    sink.recorded = closed.recorded;
  }
  for (LoopStatus& of : runtime.loops()) {
    Status::Loop& loop = status.loops.emplace_back();
    loop.name = std::move(of.name);
    loop.is_tier = of.is_tier;
    loop.is_running = of.running;
    loop.policy = name_of(of.scheduling.policy);
    loop.priority = of.scheduling.priority;
    loop.warnings = std::move(of.warnings);
    loop.processor_time = of.processor_time;
  }
  return status;
}

std::string progress(const Status& status) {
  const Status::Account& all = status.total;
  const auto part = [](std::uint64_t count, const char* what) { return ", " + std::to_string(count) + " " + what; };
  const std::uint64_t unreadable = all.unreadable - all.failed_unreadable;
  return std::to_string(all.published) + " events" + part(all.late, "late") + part(all.missed, "missed") +
         part(all.failed, "failed") + (unreadable > 0 ? part(unreadable, "unreadable") : "") +
         (all.lost > 0 ? part(all.lost, "lost") : "") + (all.outages.number > 0 ? ", " + to_string(all.outages) : "") +
         part(all.dropped, "dropped") + part(status.queued, "queued") +
         (status.waiting > 0 ? part(status.waiting, "to be sent") : "");
}

namespace {

constexpr std::string_view deleted_unsent = "deleted by a limit of the recording";

/// True for events that a limit of the recording deleted before a sink with `through` had sent them.
bool is_deletion(const Status::Sink& sink, DropReason reason) {
  return sink.backlog && reason == DropReason::queue_full_oldest;
}

/// Why sinks dropped events: "refused", or "5 queue full, 2 refused".
std::string reasons_of(const Status& status) {
  std::uint64_t deleted = 0, refused = 0;
  for (const Status::Sink& sink : status.sinks) {
    refused += sink.dropped[static_cast<std::size_t>(DropReason::refused)];
    if (is_deletion(sink, DropReason::queue_full_oldest))
      deleted += sink.dropped[static_cast<std::size_t>(DropReason::queue_full_oldest)];
  }
  std::string text;
  for (const auto& [number, reason] :
       {std::pair{status.total.dropped - deleted - refused, std::string_view("queue full")},
        {deleted, deleted_unsent},
        {refused, std::string_view("refused")}}) {
    if (number == status.total.dropped) return std::string(reason);
    if (number > 0) text += (text.empty() ? "" : ", ") + std::to_string(number) + " " + std::string(reason);
  }
  return text;
}

}  // namespace

std::string verdict(const Status& status, const Ending& ending) {
  const Status::Account& all = status.total;
  constexpr std::size_t most_names = 2;
  std::string losses;
  const auto add = [&](const std::string& what, const std::string& names) {
    losses += (losses.empty() ? "" : ", ") + what + (names.empty() ? "" : " (" + names + ")");
  };
  // The affected topics, the worst first: `amount` gives the order, `text` the text of one.
  const auto worst = [&](const auto& amount, const auto& text) {
    std::vector<const Status::Account*> topics;
    for (const Status::Account& topic : status.topics) {
      if (amount(topic) > 0) topics.push_back(&topic);
    }
    std::stable_sort(topics.begin(), topics.end(),
                     [&](const auto* a, const auto* b) { return amount(*a) > amount(*b); });
    std::string names;
    for (std::size_t i = 0; i < topics.size() && i < most_names; ++i)
      names += (i == 0 ? "" : ", ") + topics[i]->name + (topics.size() == 1 ? "" : " " + text(*topics[i]));
    if (topics.size() > most_names) names += " and " + std::to_string(topics.size() - most_names) + " more";
    return names;
  };
  const auto topics_of = [&](std::uint64_t Status::Account::*member) {
    return worst([member](const Status::Account& topic) { return topic.*member; },
                 [member](const Status::Account& topic) { return std::to_string(topic.*member); });
  };
  const auto count = [&](std::uint64_t Status::Account::*member, std::uint64_t sum, const char* one, const char* many) {
    if (sum > 0) add(std::to_string(sum) + " " + (sum == 1 ? one : many), topics_of(member));
  };
  count(&Status::Account::missed, all.missed, "tick missed", "ticks missed");
  const std::string of_failed = all.failed_unreadable == 0 ? "" : ", " + detail::unreadable_text(all.failed_unreadable);
  count(&Status::Account::failed, all.failed, ("tick failed" + of_failed).c_str(),
        ("ticks failed" + of_failed).c_str());
  const auto unreadable = [](const Status::Account& of) { return of.unreadable - of.failed_unreadable; };
  if (unreadable(all) > 0)
    add(std::to_string(unreadable(all)) + " unreadable",
        worst(unreadable, [&](const Status::Account& topic) { return std::to_string(unreadable(topic)); }));
  count(&Status::Account::lost, all.lost, "lost by its source", "lost by their sources");
  if (all.outages.number > 0) {
    add(to_string(all.outages),
        worst(
            [](const Status::Account& topic) {
              return topic.outages.number > 0 ? std::max<Duration::rep>(topic.outages.time.count(), 1) : 0;
            },
            [](const Status::Account& topic) { return to_string(topic.outages); }));
  }
  count(&Status::Account::dropped, all.dropped, "event dropped by a sink", "events dropped by sinks");
  if (all.dropped > 0 && !status.sinks.empty()) losses += ": " + reasons_of(status);
  if (losses.empty() && ending.has_loss) losses = "events between the loops (the log names them)";

  const auto first_of = [](const std::vector<std::string>& names) {
    std::string first;
    for (std::size_t i = 0; i < names.size() && i < most_names; ++i) first += (i == 0 ? "" : ", ") + names[i];
    if (names.size() > most_names) first += " and " + std::to_string(names.size() - most_names) + " more";
    return first;
  };
  const std::string mute = first_of(status.mute);

  std::string text;
  if (!ending.unknown.empty()) text += "the account is NOT complete: " + ending.unknown + "; ";
  for (const std::string& path : ending.not_closed) text += path + " was NOT closed; ";
  if (ending.not_stored > 0)
    text += std::to_string(ending.not_stored) +
            (ending.not_stored == 1 ? " event was NOT stored; " : " events were NOT stored; ");
  if (!ending.not_made.empty()) text += "NOT made by a reload: " + ending.not_made + "; ";
  for (const std::string& sink : ending.unknown_backlogs)
    text += "the backlog in a recording is NOT known (" + sink + "); ";
  if (!mute.empty()) text += "NO EVENT ever came from " + mute + "; ";
  text += losses.empty() ? (mute.empty() && ending.unknown_backlogs.empty() && ending.unknown.empty() &&
                                    ending.not_made.empty() && ending.not_closed.empty()
                                ? "nothing lost: "
                                : "nothing lost that is known: ")
                         : "LOST: " + losses + "; taken: ";
  text += std::to_string(all.published) + (all.published == 1 ? " event" : " events");
  if (all.late > 0) text += ", " + std::to_string(all.late) + (all.late == 1 ? " read late" : " reads late");
  if (status.waiting > 0)
    text += "; " + std::to_string(status.waiting) + (status.waiting == 1 ? " waits" : " wait") +
            " in a recording to be sent";
  if (all.first_lines > 0)
    text += "; " + std::to_string(all.first_lines) +
            (all.first_lines == 1 ? " first line discarded (" : " first lines discarded (") +
            topics_of(&Status::Account::first_lines) + ")";
  if (!ending.unknown.empty()) return text;
  text += ending.balances ? "; ledger balances" : "; the ledger does NOT balance";
  if (!status.not_detectable.empty())
    text += "; not detectable: what the source of " + first_of(status.not_detectable) + " lost itself";
  return text;
}

std::string dropped_text(const Status::Sink& sink) {
  std::string text = std::to_string(sink.all_dropped());
  for (std::size_t i = 0; i < drop_reasons; ++i) {
    if (sink.dropped[i] == 0) continue;
    const auto reason = static_cast<DropReason>(i);
    text += " (" + std::string(is_deletion(sink, reason) ? deleted_unsent : name_of(reason)) + ")";
  }
  return text;
}

namespace {

/// The losses of a topic in the recordings: the sum over the runs of one sink; of several sinks, the largest.
TopicLoss held_of(const Status& status, const std::string& topic) {
  std::map<std::string, TopicLoss> by_sink;
  for (const Status::Sink& sink : status.sinks) {
    if (sink.recorded == nullptr) continue;
    for (const TopicLoss& loss : sink.recorded->losses) {
      if (loss.topic != topic) continue;
      TopicLoss& sum = by_sink[sink.name];
      sum.missed += loss.missed;
      sum.failed += loss.failed;
      sum.unreadable += loss.unreadable;
      sum.failed_unreadable += loss.failed_unreadable;
      sum.by_source += loss.by_source;
      sum.outages.add(loss.outages);
    }
  }
  TopicLoss most;
  for (const auto& [sink, sum] : by_sink) {
    most.missed = std::max(most.missed, sum.missed);
    most.failed = std::max(most.failed, sum.failed);
    most.unreadable = std::max(most.unreadable, sum.unreadable);
    most.failed_unreadable = std::max(most.failed_unreadable, sum.failed_unreadable);
    most.by_source = std::max(most.by_source, sum.by_source);
    if (sum.outages.number > most.outages.number) most.outages = sum.outages;
  }
  return most;
}

/// The losses that are in no recording.
std::vector<std::string> unrecorded_lines(const Status& status) {
  const auto beyond = [](std::uint64_t all, std::uint64_t held) { return all - std::min(all, held); };
  std::vector<TopicLoss> losses;
  for (const Status::Account& topic : status.topics) {
    const TopicLoss held = held_of(status, topic.name);
    TopicLoss left;
    left.topic = topic.name;
    left.missed = beyond(topic.missed, held.missed);
    left.failed = beyond(topic.failed, held.failed);
    left.unreadable = beyond(topic.unreadable, held.unreadable);
    left.failed_unreadable = std::min(beyond(topic.failed_unreadable, held.failed_unreadable), left.unreadable);
    left.by_source = beyond(topic.lost, held.by_source);
    left.outages.number = beyond(topic.outages.number, held.outages.number);
    if (left.outages.number != 0) left.outages.time = std::max(topic.outages.time - held.outages.time, Duration{0});
    if (left.has_loss()) losses.push_back(std::move(left));
  }
  std::vector<std::string> lines = detail::loss_lines(losses, {}, {});
  for (const Status::Sink& sink : status.sinks) {
    if (sink.recorded == nullptr && sink.all_dropped() != 0)
      lines.push_back("LOST: " + dropped_text(sink) + " events dropped by sink " + sink.name);
  }
  return lines;
}

}  // namespace

std::string recorded_text(const Status& status) {
  std::string text;
  for (const Status::Sink& of : status.sinks) {
    if (!of.is_recording) continue;
    text += of.path;
    if (of.recorded != nullptr) {
      text += ", run " + std::to_string(of.recorded->info.run) + "\n";
      detail::add_lines(text, of.recorded->lines);
    } else {
      text += "\n";
      detail::add_lines(
          text, {"NOT KNOWN: how much this recording holds, because it was not closed; the next start seals it"});
    }
  }
  if (text.empty()) return text;
  if (const std::vector<std::string> left = unrecorded_lines(status); !left.empty()) {
    text += "in no recording\n";
    detail::add_lines(text, left);
  }
  return text;
}

}  // namespace rtdata::app
