#include "app/account.hpp"

#include <algorithm>

#include "app/table.hpp"

namespace rtdata::app {

RunAccount account_of(const Runtime& runtime) {
  RunAccount account;
  for (const TopicStatus& topic : runtime.topics()) {
    if (topic.name.starts_with('$')) continue;
    account.topics.push_back({});
    account.topics.back().topic = topic.name;
    account.topics.back().events = topic.published;
    account.events += topic.published;
  }
  for (const SensorStatus& sensor : runtime.sensors()) {
    const auto topic = std::find_if(account.topics.begin(), account.topics.end(),
                                    [&](const TopicAccount& known) { return known.topic == sensor.topic; });
    if (topic == account.topics.end()) continue;
    topic->late += sensor.counts.late;
    topic->missed += sensor.counts.missed;
    topic->failed += sensor.counts.failed;
    topic->unreadable += sensor.counts.unreadable;
    topic->lost += sensor.counts.lost;
    if (sensor.health > topic->health) {
      topic->health = sensor.health;
      topic->reason = sensor.reason;
    }
    account.late += sensor.counts.late;
    account.missed += sensor.counts.missed;
    account.failed += sensor.counts.failed;
    account.unreadable += sensor.counts.unreadable;
    account.lost += sensor.counts.lost;
  }
  account.sinks = runtime.sinks();
  for (const SinkStatus& sink : account.sinks) {
    account.dropped += sink.counts.all_dropped();
    for (const TopicDrops& dropped : sink.dropped) {
      for (TopicAccount& topic : account.topics) {
        if (topic.topic == dropped.topic) topic.dropped += dropped.count;
      }
    }
    account.queued += sink.counts.queued;
  }
  return account;
}

std::string progress(const RunAccount& account) {
  const auto part = [](std::uint64_t count, const char* what) { return ", " + std::to_string(count) + " " + what; };
  return std::to_string(account.events) + " events" + part(account.late, "late") + part(account.missed, "missed") +
         part(account.failed, "failed") + (account.unreadable > 0 ? part(account.unreadable, "unreadable") : "") +
         (account.lost > 0 ? part(account.lost, "lost") : "") + part(account.dropped, "dropped") +
         part(account.queued, "queued");
}

std::string summary(const RunAccount& account, const std::map<std::string, std::string>& paths) {
  std::string text;
  const bool has_unreadable = account.unreadable > 0;
  std::vector<std::string> columns{"topic", ">events", ">late", ">missed", ">failed", ">lost", ">dropped", "health"};
  if (has_unreadable) columns.insert(columns.begin() + 5, ">unreadable");
  Table topics(columns);
  for (const TopicAccount& topic : account.topics) {
    std::vector<std::string> row{
        topic.topic,
        std::to_string(topic.events),
        std::to_string(topic.late),
        std::to_string(topic.missed),
        std::to_string(topic.failed),
        std::to_string(topic.lost),
        std::to_string(topic.dropped),
        std::string(name_of(topic.health)) + (topic.reason.empty() ? "" : ": " + fitted(topic.reason, 60))};
    if (has_unreadable) row.insert(row.begin() + 5, std::to_string(topic.unreadable));
    topics.add(row);
  }
  if (!topics.empty()) text += topics.text();
  Table sinks({"sink", ">stored", ">dropped", "where", "health"});
  for (const SinkStatus& sink : account.sinks) {
    const auto path = paths.find(sink.name);
    std::string dropped = std::to_string(sink.counts.all_dropped());
    for (std::size_t i = 0; i < drop_reasons; ++i) {
      if (sink.counts.dropped[i] == 0) continue;
      dropped += " (" + std::string(name_of(static_cast<DropReason>(i))) + ")";
    }
    sinks.add({sink.name, std::to_string(sink.counts.stored), dropped,
               path == paths.end() || path->second.empty() ? "-"
               : path->second == "-"                       ? "standard output"
                                                           : path->second,
               std::string(name_of(sink.health)) + (sink.reason.empty() ? "" : ": " + fitted(sink.reason, 60))});
  }
  if (!sinks.empty()) text += (text.empty() ? "" : "\n") + sinks.text();
  return text;
}

}  // namespace rtdata::app
