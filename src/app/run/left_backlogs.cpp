#include "app/run/left_backlogs.hpp"

#include <algorithm>
#include <array>
#include <filesystem>
#include <optional>

#include "app/core/amounts.hpp"
#include "app/run/peer_form.hpp"
#include "sinks/sqlite/recording_file.hpp"

namespace rtdata::app {
namespace {

constexpr std::size_t most_runs = 100;  // that are looked at for the peer of a sink
/// The keys that say who the peer is.
constexpr std::array peer_keys{"type", "url", "host", "port", "database", "path"};

bool contains(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

/// Those that have come to the recording; fast, however much waits. Of formats without them: none.
Result<std::vector<std::string>> known_sinks(const Recording& recording) {
  std::vector<std::string> names;
  auto has_table = recording.file()->database.integer(
      "SELECT count(*) FROM sqlite_schema WHERE name = 'rtdata_position'");
  if (!has_table) return std::move(has_table).error();
  if (*has_table == 0) return names;
  auto query = recording.file()->prepare("SELECT DISTINCT sink FROM rtdata_position");
  if (!query) return std::move(query).error();
  for (;;) {
    auto row = query->step();
    if (!row) return std::move(row).error();
    if (!*row) return names;
    names.emplace_back(query->text(0));
  }
}

const ConfigItem* sink_in(const ConfigItem& root, const std::string& name) {
  const ConfigItem* const sinks = root.find("sinks");
  if (sinks == nullptr) return nullptr;
  for (const ConfigChild& sink : sinks->children())
    if (sink_name(sink.item) == name) return &sink.item;
  return nullptr;
}

/// The sink as the latest run that had it was configured, with its changes while that ran.
std::optional<ConfigItem> recorded_sink(const Recording& recording, const std::string& name) {
  const auto runs = recording.runs();
  if (!runs) return std::nullopt;
  std::size_t looked_at = 0;
  for (auto run = runs->rbegin(); run != runs->rend() && looked_at < most_runs; ++run, ++looked_at) {
    std::vector<std::string> texts{run->configuration};  // of the whole, and of the sink
    std::vector<bool> is_whole{true};
    if (const auto changes = recording.configurations(run->run)) {
      for (const RecordedConfiguration& change : *changes) {
        if (change.text.empty() || (!change.object.empty() && change.object != "sink " + name)) continue;
        texts.push_back(change.text);
        is_whole.push_back(change.object.empty());
      }
    }
    for (std::size_t i = texts.size(); i-- > 0;) {
      if (texts[i].empty()) continue;
      try {
        const ConfigDocument document = parse_config(texts[i]);
        if (!is_whole[i]) return document.root;
        if (const ConfigItem* found = sink_in(document.root, name)) return *found;
      } catch (const std::exception&) {  // the program made it from another kind of file
      }
    }
  }
  return std::nullopt;
}

/// The key by which the peers of the two differ; empty: by none that is known. What is secret is not compared.
std::string different_key(const ConfigItem& before, const ConfigItem& now) {
  for (const char* key : peer_keys) {
    const bool is_hidden = [&] {
      const ConfigItem* const child = before.find(key);
      return (child != nullptr && child->is_object()) || text_of(before, key).find("(secret)") != std::string::npos;
    }();
    if (!is_hidden && peer_form(before, key) != peer_form(now, key)) return key;
  }
  return "";
}

class Look {
 public:
  Look(SystemPlan& plan, const PartPlan& recording) : plan_(plan), recording_(recording) {
    for (const PartPlan* sink : plan.of_kind("sink"))
      if (sink->stores && sink->stores->through == recording.name) senders_.push_back(sink);
  }

  void warn() {
    const std::string& path = recording_.stores->path;
    std::error_code unknown;
    if (!std::filesystem::is_regular_file(path, unknown)) return;
    const auto opened = Recording::open(path);
    if (!opened) return;  // it is refused when it is made
    std::vector<std::string> names;
    for (const PartPlan* sender : senders_) names.push_back(sender->name);
    const auto sinks = known_sinks(*opened);
    if (!sinks) return;  // as above
    const std::vector<std::string>& known = *sinks;
    std::vector<const PartPlan*> moved;
    std::vector<std::string> keys;
    for (const PartPlan* sender : senders_) {
      if (!contains(known, sender->name)) continue;
      const auto before = recorded_sink(*opened, sender->name);
      const std::string key = before ? different_key(*before, sender->item) : "";
      if (key.empty()) continue;
      moved.push_back(sender);
      keys.push_back(key);
    }
    const bool has_others = std::any_of(known.begin(), known.end(),
                                        [&](const std::string& name) { return !contains(names, name); });
    if (moved.empty() && !has_others) return;  // counting may take long
    const auto backlogs = opened->backlogs();
    if (!backlogs) return;
    for (const RecordedBacklog& backlog : *backlogs) {
      if (backlog.events == 0) continue;
      if (!contains(names, backlog.sink)) warn_of_left(backlog, path);
      for (std::size_t i = 0; i < moved.size(); ++i)
        if (moved[i]->name == backlog.sink) warn_of_peer(*moved[i], keys[i], backlog, path);
    }
  }

 private:
  void warn_of_left(const RecordedBacklog& backlog, const std::string& path) {
    plan_.warnings.add(recording_.item.problem(
        "left-backlog", waiting_text({backlog.events, backlog.bytes, {}, {}}) + " in " + path + " for a sink \"" +
                            backlog.sink + "\", and no sink of that name goes through it: nobody sends them"));
  }
  void warn_of_peer(const PartPlan& sender, const std::string& key, const RecordedBacklog& backlog,
                    const std::string& path) {
    const ConfigItem* const at = sender.item.find(key);
    plan_.warnings.add((at != nullptr ? *at : sender.item)
                           .problem("other-peer", "`" + key + "` is another than when " + path + " was recorded: " +
                                                      waiting_text({backlog.events, backlog.bytes, {}, {}}) +
                                                      ", and are sent to the new one"));
  }

  SystemPlan& plan_;
  const PartPlan& recording_;
  std::vector<const PartPlan*> senders_;
};

}  // namespace

std::string sink_name(const ConfigItem& sink) {
  for (const char* key : {"name", "path", "type"})
    if (std::string text = text_of(sink, key); !text.empty()) return text;
  return "";
}

Result<std::vector<RecordedBacklog>> backlogs_of_others(const Recording& recording,
                                                        const std::vector<std::string>& names) {
  const auto known = known_sinks(recording);
  if (!known) return known.error();
  if (std::all_of(known->begin(), known->end(), [&](const std::string& name) { return contains(names, name); }))
    return std::vector<RecordedBacklog>{};
  auto backlogs = recording.backlogs();
  if (!backlogs) return backlogs;
  std::erase_if(*backlogs, [&](const RecordedBacklog& one) { return one.events == 0 || contains(names, one.sink); });
  return backlogs;
}

std::vector<std::string> recordings_left(const std::vector<const PartPlan*>& now, const SystemPlan& next) {
  const auto place = [](const std::string& path) {
    return std::filesystem::absolute(std::filesystem::path(path)).lexically_normal();
  };
  std::vector<std::string> left;
  for (const PartPlan* part : now) {
    if (!part->stores || !part->stores->is_recording) continue;
    const bool is_written = std::any_of(next.parts.begin(), next.parts.end(), [&](const PartPlan& other) {
      return other.stores && other.stores->is_recording && place(other.stores->path) == place(part->stores->path);
    });
    if (!is_written) left.push_back(part->stores->path);
  }
  return left;
}

std::vector<std::string> left_behind(const std::string& recording, const SystemPlan& next, const std::string& file) {
  std::vector<std::string> lines;
  std::error_code unknown;
  if (!std::filesystem::is_regular_file(recording, unknown)) return lines;
  const auto opened = Recording::open(recording);
  const auto backlogs = opened ? backlogs_of_others(*opened, {}) : opened.error();
  if (!backlogs) {
    lines.push_back("what waits in " + recording + " for sinks is not known: " + backlogs.error().text());
    return lines;
  }
  for (const RecordedBacklog& backlog : *backlogs) {
    const std::vector<const PartPlan*> sinks = next.of_kind("sink");
    const bool has_sender = std::any_of(sinks.begin(), sinks.end(), [&](const PartPlan* sink) {
      return sink->name == backlog.sink && sink->stores && !sink->stores->through.empty();
    });
    lines.push_back(waiting_text({backlog.events, backlog.bytes, {}, {}}) + " in " + recording + " for sink \"" +
                    backlog.sink + "\", and no sink goes through that file any more: `rtdata forward " + recording +
                    " " + (has_sender ? file + "` sends them" : "FILE` sends them, with a FILE that has this sink"));
  }
  return lines;
}

void warn_of_left_backlogs(SystemPlan& plan) {
  for (const PartPlan* part : plan.of_kind("sink"))
    if (part->stores && part->stores->is_recording) Look(plan, *part).warn();
}

}  // namespace rtdata::app
