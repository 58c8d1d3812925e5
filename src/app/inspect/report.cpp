#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <ostream>
#include <set>
#include <string_view>

#include "app/core/amounts.hpp"
#include "app/core/figures.hpp"
#include "app/core/recording_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/recorded_curves.hpp"
#include "app/inspect/report_page.hpp"
#include "rtdata/config/format.hpp"

namespace rtdata::app {
namespace {

/// The field that a limit watches by default: `value`, or the only number.
std::string watched_field(const Description& of) {
  if (of.find("value") != nullptr) return "value";
  std::string only;
  for (const Leaf& leaf : of.leaves()) {
    if (!is_number(leaf.kind)) continue;
    if (!only.empty()) return "";
    only = leaf.path;
  }
  return only;
}

/// The limits of a configuration, by "TOPIC.FIELD". A configuration that cannot be read has none.
std::map<std::string, std::vector<LimitSettings>> limits_of(const std::string& configuration,
                                                            const std::vector<RecordedTopic>& topics) {
  std::map<std::string, std::vector<LimitSettings>> limits;
  const ConfigDocument document = parse_config(configuration);
  const ConfigItem* const sensors = document.root.find("sensors");
  for (std::size_t i = 0; sensors != nullptr && i < sensors->size(); ++i) {
    const ConfigItem& sensor = *sensors->find(i);
    const auto text = [&](const char* key) {
      const ConfigItem* const item = sensor.find(key);
      auto value = item == nullptr ? Result<std::string>(std::string()) : item->try_get<std::string>();
      return value ? *std::move(value) : std::string();
    };
    const auto number = [&](const char* key) -> std::optional<double> {
      const ConfigItem* const item = sensor.find(key);
      if (item == nullptr) return std::nullopt;
      const auto value = item->try_get<double>();
      return value ? std::optional(*value) : std::nullopt;
    };
    if (text("type") != "limit") continue;
    std::string field = text("field");
    for (const RecordedTopic& topic : topics)
      if (field.empty() && topic.topic == text("on")) field = watched_field(*topic.description);
    limits[text("on") + "." + field].push_back({number("low_low"), number("low"), number("high"), number("high_high")});
  }
  return limits;
}

bool are_same(const LimitSettings& a, const LimitSettings& b) {
  return a.low_low == b.low_low && a.low == b.low && a.high == b.high && a.high_high == b.high_high;
}

/// The limits of a run, with those of the configurations that reloads brought. `changes`: in order of time.
std::map<std::string, std::vector<TimedLimits>> limits_of(const RecordedRange& range,
                                                          const std::vector<RecordedConfiguration>& changes,
                                                          const std::vector<RecordedTopic>& topics) {
  std::vector<std::pair<Time, const std::string*>> texts{{range.from, &range.run.configuration}};
  for (const RecordedConfiguration& change : changes)
    if (change.object.empty() && !change.text.empty()) texts.emplace_back(range.line.utc(change.time), &change.text);
  std::map<std::string, std::vector<TimedLimits>> all;
  for (std::size_t i = 0; i < texts.size(); ++i) {
    const Time from = texts[i].first, until = i + 1 < texts.size() ? texts[i + 1].first : range.until;
    for (const auto& [field, limits] : limits_of(*texts[i].second, topics)) {
      std::vector<TimedLimits>& of = all[field];
      for (const LimitSettings& one : limits) {
        const auto before = std::find_if(of.begin(), of.end(), [&](const TimedLimits& known) {
          return known.until == from && are_same(known.limits, one);
        });
        before == of.end() ? of.push_back({one, from, until}) : static_cast<void>(before->until = until);
      }
    }
  }
  return all;
}

/// Fields without a curve, except those that the course of the run shows.
std::vector<std::string> fields_without_curve(const std::vector<RecordedTopic>& topics,
                                              const std::vector<LedgerEntry>& ledger) {
  std::set<std::string> names, fields;
  for (const LedgerEntry& entry : ledger) names.insert(entry.topic);
  for (const RecordedTopic& topic : topics) {
    if (!names.contains(topic.topic) || is_of_course(*topic.description)) continue;
    for (const Leaf& leaf : topic.description->leaves())
      if (!is_number(leaf.kind))
        fields.insert(topic.topic + "." + leaf.path + " (" + std::string(name_of(leaf.kind)) + ")");
  }
  return {fields.begin(), fields.end()};
}

ReportContent content_of(const Recording& recording, const RecordedRange& range) {
  constexpr std::size_t columns = 740;  // for a day: 2 min each
  ReportContent content;
  content.file = std::filesystem::path(recording.path()).filename().string();
  content.range = range;
  const std::int64_t run = content.range.run.run;
  content.report = verify(recording).or_throw();
  content.report.path = content.file;
  content.report.deleted.reset();
  std::erase_if(content.report.runs, [&](const RunReport& one) { return one.info.run != run; });
  if (content.report.runs.empty())
    throw SetupError({Errc::not_found, "cannot report", recording.path(), "run " + std::to_string(run) + " was deleted",
                      "the program that records has just deleted it; see max_age and max_bytes"});
  const auto topics = recording.topics().or_throw();
  content.plot = curves_of_run(recording, content.range, content.report.runs[0], columns);
  content.course = course_of(recording, topics, run);
  content.ledger = recording.ledger(run).or_throw();
  content.not_drawn = fields_without_curve(topics, content.ledger);
  content.schedule = recording.schedule(run).or_throw();
  content.gaps = recording.gaps(run).or_throw();
  content.clock = recording.clock(run).or_throw();
  content.errors = recording.errors(run).or_throw();
  content.health = recording.health(run).or_throw();
  content.changes = recording.configurations(run).or_throw();
  content.limits = limits_of(content.range, content.changes, topics);
  content.made = wall_clock_now();
  return content;
}

[[noreturn]] void cannot_write(const std::string& file, int error) {
  throw SetupError(system_error(error, "cannot write the report", file, "name another file: -o FILE"));
}

/// Removes a file that cannot be written completely.
void write_file(const std::string& file, std::string_view text, ReportOptions::Existing existing) {
  std::error_code ignored;
  if (std::filesystem::is_regular_file(file, ignored)) {
    const auto there = Recording::open(file);
    if (there || there.error().code == Errc::damaged || there.error().code == Errc::newer_version)
      throw SetupError({Errc::bad_argument, "cannot write the report", file, "this file is a recording",
                        "name another file: -o FILE"});
  }
  const int how = existing == ReportOptions::Existing::refuse ? O_EXCL : O_TRUNC;
  const int to = ::open(file.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC | how, 0666);
  if (to < 0) cannot_write(file, errno);
  int failed = 0;
  while (!text.empty() && failed == 0) {
    const ssize_t written = ::write(to, text.data(), text.size());
    if (written >= 0) {
      text.remove_prefix(static_cast<std::size_t>(written));
    } else if (errno != EINTR) {
      failed = errno;
    }
  }
  struct stat status {};
  const bool is_file = ::fstat(to, &status) == 0 && S_ISREG(status.st_mode);
  if (::close(to) != 0 && failed == 0) failed = errno;
  if (failed == 0) return;
  if (is_file) ::unlink(file.c_str());
  cannot_write(file, failed);
}

}  // namespace

int report(const ReportOptions& options, std::ostream& out, std::ostream& err) try {
  const Recording recording = Recording::open(options.database).or_throw();
  const bool is_stream = options.file == "-";
  const std::filesystem::path name = std::filesystem::path(options.database).filename();
  const std::string file = options.file.empty() ? std::filesystem::path(name).replace_extension(".html").string()
                                                : options.file;
  const RecordedRange range = range_of(recording, {.run = options.run}, "cannot report");
  std::error_code ignored;
  if (!is_stream && options.existing == ReportOptions::Existing::refuse &&
      std::filesystem::exists(std::filesystem::symlink_status(file, ignored)))
    throw SetupError({Errc::bad_argument, "cannot write the report", file, "the file exists",
                      "name another with -o, or replace it with --overwrite"});
  const ReportContent content = content_of(recording, range);
  const std::string page = page_of(content);
  if (is_stream) {
    out << page;
    return 0;
  }
  write_file(file, page, options.existing);
  const RunReport& run = content.report.runs[0];
  out << file << " (" << bytes_text(static_cast<double>(page.size())) << "): run " << run.info.run << ", "
      << name_of(run.verdict) << "\n";
  for (const std::string& line : run.lines) out << "  " << line << "\n";
  return 0;
} catch (const SetupError& error) {
  print_error(err, error.error());
  return status_after(error.error());
}

}  // namespace rtdata::app
