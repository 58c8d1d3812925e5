#include "app/control/account.hpp"

#include <algorithm>
#include <utility>

#include "app/core/amounts.hpp"
#include "app/core/table.hpp"
#include "loop/runtime/final_account.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "sinks/core/account_text.hpp"

namespace rtdata::app {

RunAccount account_of(Runtime& runtime) {
  RunAccount account;
  for (const TopicStatus& topic : runtime.topics()) {
    if (topic.name.starts_with('$')) continue;
    account.topics.push_back({});
    account.topics.back().topic = topic.name;
    account.topics.back().events = topic.published;
    account.events += topic.published;
  }
  std::vector<SensorStatus> sensors = runtime.sensors();
  for (SensorStatus& closed : detail::closed_sensors(runtime.core(), sensors)) sensors.push_back(std::move(closed));
  for (const SensorStatus& sensor : sensors) {
    const auto topic = std::find_if(account.topics.begin(), account.topics.end(),
                                    [&](const TopicAccount& known) { return known.topic == sensor.topic; });
    if (topic == account.topics.end()) continue;
    topic->late += sensor.counts.late;
    topic->missed += sensor.counts.missed;
    topic->failed += sensor.counts.failed;
    topic->unreadable += sensor.counts.unreadable;
    topic->lost += sensor.counts.lost;
    topic->first_lines += sensor.counts.first_lines;
    topic->outages.add(sensor.outages);
    account.outages.add(sensor.outages);
    if (sensor.counts.published + sensor.counts.repeated + sensor.counts.filtered == 0) {
      account.mute.push_back(sensor.name);
    } else if (!sensor.counts.has_schedule && !sensor.counts.lost_is_known) {
      account.not_detectable.push_back(sensor.name);
    }
    if (sensor.health > topic->health) {
      topic->health = sensor.health;
      topic->reason = sensor.reason;
    }
    account.late += sensor.counts.late;
    account.missed += sensor.counts.missed;
    account.failed += sensor.counts.failed;
    account.unreadable += sensor.counts.unreadable;
    account.lost += sensor.counts.lost;
    account.first_lines += sensor.counts.first_lines;
  }
  account.sinks = runtime.sinks();
  const detail::RuntimeCore& core = runtime.core();
  for (const detail::ClosedSink& closed : core.closed_sinks) {
    RunAccount::Files& files = account.closed_sinks.emplace_back();
    if (closed.path) files.own = core.hide(*closed.path);
    files.recording = core.hide(closed.recording);
    files.is_recording = closed.is_recording;
    files.recorded = closed.recorded;
  }
  for (const SinkStatus& sink : account.sinks) {
    account.dropped += sink.counts.all_dropped();
    for (const TopicDrops& dropped : sink.dropped) {
      for (TopicAccount& topic : account.topics) {
        if (topic.topic == dropped.topic) topic.dropped += dropped.count;
      }
    }
    (sink.backlog ? account.waiting : account.queued) += sink.counts.queued;
  }
  return account;
}

std::string progress(const RunAccount& account) {
  const auto part = [](std::uint64_t count, const char* what) { return ", " + std::to_string(count) + " " + what; };
  return std::to_string(account.events) + " events" + part(account.late, "late") + part(account.missed, "missed") +
         part(account.failed, "failed") + (account.unreadable > 0 ? part(account.unreadable, "unreadable") : "") +
         (account.lost > 0 ? part(account.lost, "lost") : "") +
         (account.outages.number > 0 ? ", " + to_string(account.outages) : "") + part(account.dropped, "dropped") +
         part(account.queued, "queued") + (account.waiting > 0 ? part(account.waiting, "to be sent") : "");
}

namespace {

constexpr std::string_view deleted_unsent = "deleted by a limit of the recording";

/// What a sink that goes through a recording lost so was there for as long as that keeps anything.
bool is_deletion(const SinkStatus& sink, DropReason reason) {
  return sink.backlog && reason == DropReason::queue_full_oldest;
}

/// Of what sinks dropped: "refused", or "5 queue full, 2 refused".
std::string reasons_of(const RunAccount& account) {
  std::uint64_t deleted = 0, refused = 0;
  for (const SinkStatus& sink : account.sinks) {
    refused += sink.counts.dropped[static_cast<std::size_t>(DropReason::refused)];
    if (is_deletion(sink, DropReason::queue_full_oldest))
      deleted += sink.counts.dropped[static_cast<std::size_t>(DropReason::queue_full_oldest)];
  }
  std::string text;
  for (const auto& [number, reason] : {std::pair{account.dropped - deleted - refused, std::string_view("queue full")},
                                       {deleted, deleted_unsent},
                                       {refused, std::string_view("refused")}}) {
    if (number == account.dropped) return std::string(reason);
    if (number > 0) text += (text.empty() ? "" : ", ") + std::to_string(number) + " " + std::string(reason);
  }
  return text;
}

}  // namespace

std::string verdict(const RunAccount& account, const Ending& ending) {
  constexpr std::size_t most_names = 2;
  std::string losses;
  const auto add = [&](const std::string& what, const std::string& names) {
    losses += (losses.empty() ? "" : ", ") + what + (names.empty() ? "" : " (" + names + ")");
  };
  // The topics that it happened to, the worst first: `amount` orders them, `text` is what is said of one.
  const auto worst = [&](const auto& amount, const auto& text) {
    std::vector<const TopicAccount*> topics;
    for (const TopicAccount& topic : account.topics) {
      if (amount(topic) > 0) topics.push_back(&topic);
    }
    std::stable_sort(topics.begin(), topics.end(),
                     [&](const auto* a, const auto* b) { return amount(*a) > amount(*b); });
    std::string names;
    for (std::size_t i = 0; i < topics.size() && i < most_names; ++i)
      names += (i == 0 ? "" : ", ") + topics[i]->topic + (topics.size() == 1 ? "" : " " + text(*topics[i]));
    if (topics.size() > most_names) names += " and " + std::to_string(topics.size() - most_names) + " more";
    return names;
  };
  const auto topics_of = [&](std::uint64_t TopicAccount::*member) {
    return worst([member](const TopicAccount& topic) { return topic.*member; },
                 [member](const TopicAccount& topic) { return std::to_string(topic.*member); });
  };
  const auto count = [&](std::uint64_t TopicAccount::*member, std::uint64_t sum, const char* one, const char* many) {
    if (sum > 0) add(std::to_string(sum) + " " + (sum == 1 ? one : many), topics_of(member));
  };
  count(&TopicAccount::missed, account.missed, "tick missed", "ticks missed");
  count(&TopicAccount::failed, account.failed, "tick failed", "ticks failed");
  count(&TopicAccount::unreadable, account.unreadable, "unreadable", "unreadable");
  count(&TopicAccount::lost, account.lost, "lost by its source", "lost by their sources");
  if (account.outages.number > 0) {
    add(to_string(account.outages),
        worst(
            [](const TopicAccount& topic) {
              return topic.outages.number > 0 ? std::max<Duration::rep>(topic.outages.time.count(), 1) : 0;
            },
            [](const TopicAccount& topic) { return to_string(topic.outages); }));
  }
  count(&TopicAccount::dropped, account.dropped, "event dropped by a sink", "events dropped by sinks");
  if (account.dropped > 0 && !account.sinks.empty()) losses += ": " + reasons_of(account);
  if (losses.empty() && ending.has_loss) losses = "events between the loops (the log names them)";

  const auto first_of = [](const std::vector<std::string>& names) {
    std::string first;
    for (std::size_t i = 0; i < names.size() && i < most_names; ++i) first += (i == 0 ? "" : ", ") + names[i];
    if (names.size() > most_names) first += " and " + std::to_string(names.size() - most_names) + " more";
    return first;
  };
  const std::string mute = first_of(account.mute);

  std::string text;
  if (!ending.unknown.empty()) text += "the account is NOT complete: " + ending.unknown + "; ";
  if (ending.not_stored > 0)
    text += std::to_string(ending.not_stored) +
            (ending.not_stored == 1 ? " event was NOT stored; " : " events were NOT stored; ");
  for (const std::string& sink : account.unknown_backlogs)
    text += "what waits in a recording is NOT known (" + sink + "); ";
  if (!mute.empty()) text += "NO EVENT ever came from " + mute + "; ";
  text += losses.empty() ? (mute.empty() && account.unknown_backlogs.empty() && ending.unknown.empty()
                                ? "nothing lost: "
                                : "nothing lost that is known: ")
                         : "LOST: " + losses + "; taken: ";
  text += std::to_string(account.events) + (account.events == 1 ? " event" : " events");
  if (account.late > 0) text += ", " + std::to_string(account.late) + " of them late";
  if (account.waiting > 0)
    text += "; " + std::to_string(account.waiting) + (account.waiting == 1 ? " waits" : " wait") +
            " in a recording to be sent";
  if (account.first_lines > 0)
    text += "; " + std::to_string(account.first_lines) +
            (account.first_lines == 1 ? " first line thrown away (" : " first lines thrown away (") +
            topics_of(&TopicAccount::first_lines) + ")";
  if (!ending.unknown.empty()) return text;
  text += ending.balances ? "; ledger balances" : "; the ledger does NOT balance";
  if (!account.not_detectable.empty())
    text += "; not detectable: what the source of " + first_of(account.not_detectable) + " lost itself";
  return text;
}

namespace {

/// Empty: it has none.
std::string path_of(const RunAccount& account, std::size_t sink, const std::map<std::string, std::string>& paths) {
  if (sink < account.closed_sinks.size() && account.closed_sinks[sink].own) return *account.closed_sinks[sink].own;
  const auto known = paths.find(account.sinks[sink].name);
  return known == paths.end() ? std::string() : known->second;
}

/// What the recordings have of a topic: the runs of one sink follow each other, and of several the one that has most.
TopicLoss held_of(const RunAccount& account, const std::string& topic) {
  std::map<std::string, TopicLoss> by_sink;
  for (std::size_t i = 0; i < account.closed_sinks.size(); ++i) {
    if (account.closed_sinks[i].recorded == nullptr) continue;
    for (const TopicLoss& loss : account.closed_sinks[i].recorded->losses) {
      if (loss.topic != topic) continue;
      TopicLoss& sum = by_sink[account.sinks[i].name];
      sum.missed += loss.missed;
      sum.failed += loss.failed;
      sum.unreadable += loss.unreadable;
      sum.by_source += loss.by_source;
      sum.outages.add(loss.outages);
    }
  }
  TopicLoss most;
  for (const auto& [sink, sum] : by_sink) {
    most.missed = std::max(most.missed, sum.missed);
    most.failed = std::max(most.failed, sum.failed);
    most.unreadable = std::max(most.unreadable, sum.unreadable);
    most.by_source = std::max(most.by_source, sum.by_source);
    if (sum.outages.number > most.outages.number) most.outages = sum.outages;
  }
  return most;
}

/// "12 (queue full, newest)"
std::string dropped_text(const SinkStatus& sink) {
  std::string text = std::to_string(sink.counts.all_dropped());
  for (std::size_t i = 0; i < drop_reasons; ++i) {
    if (sink.counts.dropped[i] == 0) continue;
    const auto reason = static_cast<DropReason>(i);
    text += " (" + std::string(is_deletion(sink, reason) ? deleted_unsent : name_of(reason)) + ")";
  }
  return text;
}

/// The losses that no recording has.
std::vector<std::string> unrecorded_lines(const RunAccount& account) {
  const auto beyond = [](std::uint64_t all, std::uint64_t held) { return all - std::min(all, held); };
  std::vector<TopicLoss> losses;
  for (const TopicAccount& topic : account.topics) {
    const TopicLoss held = held_of(account, topic.topic);
    TopicLoss left;
    left.topic = topic.topic;
    left.missed = beyond(topic.missed, held.missed);
    left.failed = beyond(topic.failed, held.failed);
    left.unreadable = beyond(topic.unreadable, held.unreadable);
    left.by_source = beyond(topic.lost, held.by_source);
    left.outages.number = beyond(topic.outages.number, held.outages.number);
    if (left.outages.number != 0) left.outages.time = std::max(topic.outages.time - held.outages.time, Duration{0});
    if (left.has_loss()) losses.push_back(std::move(left));
  }
  std::vector<std::string> lines = detail::loss_lines(losses, {}, {});
  for (std::size_t i = 0; i < account.sinks.size(); ++i) {
    const SinkStatus& sink = account.sinks[i];
    const bool has_account = i < account.closed_sinks.size() && account.closed_sinks[i].recorded != nullptr;
    if (!has_account && sink.counts.all_dropped() != 0)
      lines.push_back("LOST: " + dropped_text(sink) + " events dropped by sink " + sink.name);
  }
  return lines;
}

}  // namespace

std::string recorded_text(const RunAccount& account, const std::map<std::string, std::string>& paths) {
  std::string text;
  for (std::size_t i = 0; i < account.closed_sinks.size(); ++i) {
    const RunAccount::Files& of = account.closed_sinks[i];
    if (!of.is_recording) continue;
    text += path_of(account, i, paths);
    if (of.recorded != nullptr) {
      text += ", run " + std::to_string(of.recorded->info.run) + "\n";
      detail::add_lines(text, of.recorded->lines);
    } else {
      text += "\n";
      detail::add_lines(text, {"NOT KNOWN: what it holds, since it was not closed; the next start seals it"});
    }
  }
  if (text.empty()) return text;
  if (const std::vector<std::string> left = unrecorded_lines(account); !left.empty()) {
    text += "in no recording\n";
    detail::add_lines(text, left);
  }
  return text;
}

std::string summary(const RunAccount& account, const std::map<std::string, std::string>& paths, std::size_t columns) {
  std::string text;
  const bool has_unreadable = account.unreadable > 0, has_outages = account.outages.number > 0;
  std::vector<std::string> heading{"topic", ">events", ">late", ">missed", ">failed"};
  if (has_unreadable) heading.push_back(">unreadable");
  heading.push_back(">lost");
  if (has_outages) heading.push_back(">outages");
  heading.insert(heading.end(), {">dropped", "health"});
  Table topics(heading);
  for (const TopicAccount& topic : account.topics) {
    std::vector<std::string> row{topic.topic, std::to_string(topic.events), std::to_string(topic.late),
                                 std::to_string(topic.missed), std::to_string(topic.failed)};
    if (has_unreadable) row.push_back(std::to_string(topic.unreadable));
    row.push_back(std::to_string(topic.lost));
    if (has_outages) row.push_back(std::to_string(topic.outages.number));
    row.insert(row.end(), {std::to_string(topic.dropped), std::string(name_of(topic.health))});
    topics.add(row, topic.health == Health::ok ? "" : topic.reason);
  }
  if (!topics.empty()) text += topics.text("", columns);
  Table sinks({"sink", ">stored", ">dropped", "health", "where"});
  for (std::size_t i = 0; i < account.sinks.size(); ++i) {
    const SinkStatus& sink = account.sinks[i];
    const RunAccount::Files* const closed = i < account.closed_sinks.size() ? &account.closed_sinks[i] : nullptr;
    std::string where = path_of(account, i, paths);
    if (where.empty() || where == "-") where = where.empty() ? "-" : "standard output";
    std::string note = sink.health == Health::ok ? "" : sink.reason;
    if (sink.backlog && sink.counts.queued > 0)
      note += (note.empty() ? "" : "; ") + waiting_text({sink.counts.queued, sink.backlog->bytes, sink.backlog->age}) +
              (closed != nullptr && !closed->recording.empty() ? " in " + closed->recording : "");
    sinks.add(
        {sink.name, std::to_string(sink.counts.stored), dropped_text(sink), std::string(name_of(sink.health)), where},
        note);
  }
  if (!sinks.empty()) text += (text.empty() ? "" : "\n") + sinks.text("", columns);
  return text;
}

}  // namespace rtdata::app
