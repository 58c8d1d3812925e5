#include "recording/replay_choice.hpp"

#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <set>

#include "data/name.hpp"
#include "data/setting_mistake.hpp"
#include "data/time_text.hpp"
#include "recording/recording_file.hpp"
#include "recording/schema.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata {
namespace detail {

Error replay_refused(std::string where, std::string why, std::string advice) {
  return {Errc::bad_argument, "cannot replay", std::move(where), std::move(why), std::move(advice)};
}

Result<std::optional<GivenTime>> given_time(const char* key, const std::string& text) {
  if (text.empty()) return std::optional<GivenTime>{};
  std::int64_t ns = 0;
  const auto [end, failed] = std::from_chars(text.data(), text.data() + text.size(), ns);
  if (failed == std::errc{} && end == text.data() + text.size())
    return std::optional<GivenTime>{{from_nanoseconds(ns), RowFilter::Times::recorded}};
  auto time = parse_iso8601(text);
  if (time) return std::optional<GivenTime>{{*time, RowFilter::Times::utc}};
  return replay_refused(std::string(key) + " \"" + text + "\"", "it is not a time",
                        "write it as 2026-03-01T12:00:00Z, or as recorded ns");
}

Result<std::pair<std::string, std::string>> renaming_of(const std::string& text) {
  const std::size_t at = text.find('=');
  if (at == std::string::npos || !is_topic_name(text.substr(0, at)) || !is_topic_name(text.substr(at + 1))) {
    return replay_refused("rename \"" + text + "\"", "it must be OLD_TOPIC=NEW_TOPIC", "write room=lab/room");
  }
  return std::pair(text.substr(0, at), text.substr(at + 1));
}

RunInfo chosen_run(const Recording& recording, const ReplayConfig& config) {
  auto runs = recording.runs().or_throw();
  std::string numbers;
  RunInfo chosen;
  for (RunInfo& run : runs) {
    if (run.state == RunState::recording && run.pid == ::getpid()) {
      throw SetupError(replay_refused(config.file,
                                      "this program records into it: the replayed events would be recorded again",
                                      "record into another file"));
    }
    numbers += (numbers.empty() ? "" : ", ") + std::to_string(run.run);
    if (config.run == 0 || run.run == config.run) chosen = std::move(run);
  }
  if (chosen.run != 0) return chosen;
  throw SetupError({Errc::not_found, "cannot replay", config.file,
                    numbers.empty() ? "it has no run" : "it has no run " + std::to_string(config.run),
                    numbers.empty() ? "" : "its runs are " + numbers});
}

Time beginning_of(const Recording& recording, const RunInfo& run, const ReplayConfig& config) {
  auto from = given_time("from", config.from).or_throw();
  if (!from) return run.started;
  Time time = from->time;
  if (from->line == RowFilter::Times::utc) {
    auto line = recording.utc_line(run.run).or_throw();
    time = line.recorded(time);
  }
  return std::max(run.started, time);
}

std::vector<RecordedTopic> chosen_topics(const Recording& recording, const ReplayConfig& config, std::int64_t run) {
  for (const std::string& pattern : config.topics) {
    if (!is_topic_pattern(pattern)) {
      throw SetupError({Errc::bad_name, "cannot replay", "topic " + pattern, "it is neither a topic nor a pattern",
                        "write room/climate, room/+ or room/#"});
    }
  }
  auto all = recording.topics().or_throw();
  std::set<std::string> all_names;  // one whose fields changed is there several times
  for (const RecordedTopic& topic : all) all_names.insert(topic.topic);
  std::string names;
  for (const std::string& name : all_names)
    if (names.size() < 200) names += (names.empty() ? "" : ", ") + name;
  std::vector<RecordedTopic> chosen;
  for (RecordedTopic& topic : all) {
    const bool is_wanted = std::any_of(config.topics.begin(), config.topics.end(),
                                       [&](const std::string& pattern) { return topic_matches(pattern, topic.topic); });
    // If the fields of a topic changed between runs: those of this run.
    auto rows = recording.file()->prepare("SELECT EXISTS(SELECT 1 FROM " + sqlite::quoted(topic.table) +
                                          " t WHERE t.run = " + std::to_string(run) + ")");
    if (!is_wanted || !rows.step() || rows.integer(0) == 0) continue;
    if (topic.description->size() > max_payload_size) {
      throw SetupError({Errc::bad_description, "cannot replay", config.file + ", topic " + topic.topic,
                        "its events have " + std::to_string(topic.description->size()) + " bytes, 4096 at most",
                        "choose the other topics"});
    }
    chosen.push_back(std::move(topic));
  }
  if (!chosen.empty()) return chosen;
  throw SetupError({Errc::not_found, "cannot replay", config.file + ", run " + std::to_string(run),
                    "it has no events on the chosen topics",
                    names.empty() ? "it has no topics" : "its topics are " + names});
}

}  // namespace detail

Result<void> check_replayable(const ReplayConfig& config) try {
  auto recording = Recording::open(config.file).or_throw();
  auto run = detail::chosen_run(recording, config);
  (void)detail::chosen_topics(recording, config, run.run);
  return {};
} catch (const SetupError& error) {
  return error.error();
}

void check_config(const ReplayConfig& config, const ConfigItem& item, Problems& problems) {
  const auto add = [&](const char* key, const Error& error) {
    detail::add_mistake({key, error.where + ": " + error.why, error.advice}, item, problems);
  };
  const auto from = detail::given_time("from", config.from), until = detail::given_time("until", config.until);
  if (!from) add("from", from.error());
  if (!until) add("until", until.error());
  if (from && until && *from && *until) {
    if ((*from)->line != (*until)->line) {
      add("until", detail::replay_refused("until", "one of from and until is UTC, the other in ns",
                                          "write both in the same way"));
    } else if ((*from)->time > (*until)->time) {
      add("until", detail::replay_refused("until", "it ends before it begins", "exchange from and until"));
    }
  }
  for (const std::string& text : config.rename) {
    if (const auto renaming = detail::renaming_of(text); !renaming) add("rename", renaming.error());
  }
  if (!config.prefix.empty() && !detail::is_name(config.prefix + "x"))
    add("prefix", detail::replay_refused("prefix", detail::name_rule, "choose another one"));
  if (const auto replayable = check_replayable(config); !replayable) {
    const Error& error = replayable.error();
    const bool is_of_run = error.code == Errc::not_found && config.run != 0 && error.where == config.file;
    add(is_of_run ? "run" : "file", error);
  }
}

}  // namespace rtdata
