#include "app/run/left_backlogs.hpp"

#include <algorithm>
#include <filesystem>

#include "app/core/amounts.hpp"
#ifdef RTDATA_WITH_SQLITE
#include "recording/recording_file.hpp"
#endif

namespace rtdata::app {
std::string sink_name(const ConfigItem& sink) {
  for (const char* key : {"name", "path", "type"}) {
    const ConfigItem* const child = sink.find(key);
    const std::string* const text = child != nullptr ? child->as_string() : nullptr;
    if (child != nullptr && (text == nullptr || !text->empty()))
      return text != nullptr ? *text : child->to_json(ConfigItem::Layout::one_line);
  }
  return "";
}

std::vector<std::string> recordings_left(const std::vector<const PartPlan*>& now, const SystemPlan& next) {
  const auto place = [](const std::string& path) {
    return std::filesystem::absolute(std::filesystem::path(path)).lexically_normal();
  };
  std::vector<std::string> lines;
  for (const PartPlan* part : now) {
    if (!part->stores || !part->stores->is_recording) continue;
    const bool has_senders = std::any_of(now.begin(), now.end(), [&](const PartPlan* other) {
      return other->stores && other->stores->through == part->name;
    });
    const bool is_written = std::any_of(next.parts.begin(), next.parts.end(), [&](const PartPlan& other) {
      return other.stores && other.stores->is_recording && place(other.stores->path) == place(part->stores->path);
    });
    const std::string& path = part->stores->path;
    if (has_senders && !is_written)
      lines.push_back("events that wait for sinks in " + path + " stay there: `rtdata info " + path +
                      "` counts them, and `rtdata forward " + path +
                      " FILE` sends them, with a FILE that has these sinks");
  }
  return lines;
}

#ifdef RTDATA_WITH_SQLITE
namespace {

bool contains(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

/// The sinks known in the recording; fast for any backlog. Older formats have none.
std::vector<std::string> known_sinks(const Recording& recording) {
  const detail::RecordingFile& file = *recording.file();
  if (file.database.integer("SELECT count(*) FROM sqlite_schema WHERE name = 'rtdata_position'") == 0) return {};
  return file.prepare("SELECT DISTINCT sink FROM rtdata_position").texts();
}

}  // namespace

Result<std::vector<RecordedBacklog>> backlogs_of_others(const Recording& recording,
                                                        const std::vector<std::string>& names) try {
  const auto known = known_sinks(recording);
  if (std::all_of(known.begin(), known.end(), [&](const std::string& name) { return contains(names, name); }))
    return std::vector<RecordedBacklog>{};
  auto backlogs = recording.backlogs();
  if (!backlogs) return backlogs;
  std::erase_if(*backlogs, [&](const RecordedBacklog& one) { return one.events == 0 || contains(names, one.sink); });
  return backlogs;
} catch (const SetupError& error) {
  return error.error();
}

void warn_of_left_backlogs(SystemPlan& plan) {
  for (const PartPlan* part : plan.of_kind("sink")) {
    if (!part->stores || !part->stores->is_recording) continue;
    const std::string& path = part->stores->path;
    std::error_code unknown;
    if (!std::filesystem::is_regular_file(path, unknown)) continue;
    const auto recording = Recording::open(path);
    if (!recording) continue;  // making it reports the error
    std::vector<std::string> senders;
    for (const PartPlan* sink : plan.of_kind("sink"))
      if (sink->stores && sink->stores->through == part->name) senders.push_back(sink->name);
    const auto backlogs = backlogs_of_others(*recording, senders);
    if (!backlogs) continue;  // as above
    for (const RecordedBacklog& backlog : *backlogs)
      plan.warnings.add(part->item.problem(
          "left-backlog", waiting_text({backlog.events, backlog.bytes, {}, {}}) + " in " + path + " for a sink \"" +
                              backlog.sink +
                              "\", but no sink of that name goes through this recording: the events are not sent"));
  }
}

#else
void warn_of_left_backlogs(SystemPlan&) {}  // nothing records
#endif

}  // namespace rtdata::app
