#include "rtdata/recording/export.hpp"
#include "app/core/terminal_text.hpp"

#include <algorithm>
#include <cctype>
#include <chrono>
#include <optional>
#include <ostream>
#include <set>
#include <utility>

#include "app/core/recording_commands.hpp"
#include "app/inspect/export_table.hpp"
#include "app/inspect/names.hpp"
#include "app/inspect/recorded_range.hpp"
#include "app/inspect/separator.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/recording/runs.hpp"

namespace rtdata::app {
namespace {

/// Throws SetupError if the recording has no such run, topic or origin at any time.
void find(const Recording& recording, const RowFilter& filter) {
  const auto missing = [&](std::string why) {
    throw SetupError({Errc::not_found, "cannot export", recording.path(), std::move(why),
                      "see `rtdata info " + recording.path() + "`"});
  };
  std::set<std::string> topics, origins;
  bool is_there = false;
  for (const RunInfo& run : recording.runs().or_throw()) {
    if (filter.run && run.run != *filter.run) continue;
    for (const LedgerEntry& entry : recording.ledger(run.run).or_throw()) {
      topics.insert(entry.topic);
      if (!topic_matches(filter.topic, entry.topic)) continue;
      origins.insert(entry.origin);
      is_there = is_there || !filter.origin || entry.origin == *filter.origin;
    }
  }
  const std::string of_run = filter.run ? "run " + std::to_string(*filter.run) : "it";
  if (is_there || (filter.topic == "#" && !filter.origin)) return;
  // A running or killed run may have rows before its first account.
  auto rows = recording.rows({.topic = filter.topic, .run = filter.run, .origin = filter.origin}).or_throw();
  if (rows.next().or_throw() != nullptr) return;
  if (origins.empty()) missing(of_run + " has no topic " + filter.topic + "; available: " + list_of(topics));
  missing(of_run + " has nothing of origin " + *filter.origin + " on topic " + filter.topic +
          "; available: " + list_of(origins));
}

/// Reports refused rows, which is an error.
int report_refused(std::ostream& err, const ExportCount& count) {
  if (count.refused == 0) return 0;
  print_error(err,
              std::to_string(count.refused) + (count.refused == 1 ? " row was" : " rows were") +
                  " left out, the first: " + count.refusal.text(),
              count.refusal.id());
  return 1;
}

/// For rows of several runs: explains which column shows the run.
void report_runs(std::ostream& err, const Recording& recording, const ExportOptions& options) {
  const auto runs = recording.runs();
  if (!runs || runs->size() < 2 || options.run || options.format == "raw") return;
  err << "rtdata: rows of " << runs->size() << " runs: `run` says to which one a row belongs"
      << (options.format == "csv" ? "" : ", by its uuid") << "; --run takes one\n";
}

/// The options of a formatted table; none: plain export. Throws SetupError.
std::optional<TableFormat> table_format_of(const ExportOptions& options) {
  const auto refuse_option = [](std::string option, std::string why, std::string advice) {
    throw SetupError({Errc::bad_argument, "cannot export", std::move(option), std::move(why), std::move(advice)});
  };
  TableFormat format;
  format.has_seconds = options.time == "seconds";
  if (!options.start.empty() && !format.has_seconds)
    refuse_option("--start " + options.start, "it works only with --time seconds", "");
  if (!options.within.empty() && options.join.empty())
    refuse_option("--within " + options.within, "it works only with --join", "");
  const std::string option = !options.join.empty()        ? "--join"
                             : !options.separator.empty() ? "--separator"
                             : !options.decimal.empty()   ? "--decimal"
                             : options.digits >= 0        ? "--digits"
                             : format.has_seconds         ? "--time"
                                                          : "";
  if (option.empty()) return {};
  if (options.format != "csv") refuse_option(option, "it needs --format csv, not " + options.format, "remove --format");
  if (!options.folder.empty())
    refuse_option(option, "this option needs one topic, but --folder exports all", "choose one by --topic");
  if (!options.step.empty()) refuse_option(option, "it does not work together with --step", "remove one of the two");
  const std::string& said = options.separator;
  const char separator = said.empty() ? ',' : separator_of(said);
  const bool is_wrong = separator != '\t' && (separator < ' ' || separator == '"' || separator == '-' ||
                                              separator == '.' || std::isalnum(static_cast<unsigned char>(separator)));
  if (is_wrong)
    refuse_option("--separator " + said, "it must be one character, which separates cells",
                  "write one such as \";\", or tab");
  format.separator = separator;
  if (options.decimal == ",") format.decimal = ',';
  if (said.empty() && format.decimal == ',') format.separator = ';';
  if (format.separator == format.decimal)
    refuse_option("--separator " + said, "it is the decimal mark, too", "write one such as \";\", or tab");
  format.digits = static_cast<int>(options.digits);
  if (!options.start.empty()) format.start = parse_time(options.start);
  format.join = options.join;
  if (!options.within.empty()) format.within = parse_duration(options.within).or_throw();
  return format;
}

/// A progress line on the terminal, shown after one second.
class Progress {
 public:
  Progress(std::ostream& err, bool is_shown)
      : err_(err), is_shown_(is_shown), next_(Clock::now() + std::chrono::seconds{1}) {}
  void show(const ExportProgress& at) {
    if (!is_shown_ || Clock::now() < next_) return;
    next_ = Clock::now() + std::chrono::milliseconds{200};
    err_ << "\r" << at.rows << " rows, up to " << to_iso8601(at.at) << "\x1b[K" << std::flush;
    has_line_ = true;
  }
  void clear() {
    if (std::exchange(has_line_, false)) err_ << "\r\x1b[K" << std::flush;
  }

 private:
  using Clock = std::chrono::steady_clock;
  std::ostream& err_;
  const bool is_shown_;
  Clock::time_point next_;
  bool has_line_ = false;
};

}  // namespace

int export_recording(const ExportOptions& options, std::ostream& out, std::ostream& err) try {
  const Recording recording = Recording::open(options.database).or_throw();
  const auto from = parse_time(options.from), until = parse_time(options.until);
  if (from && until && *from > *until)
    throw SetupError({Errc::bad_argument, "cannot export", "--from " + options.from + " --until " + options.until,
                      "it ends before it begins", "exchange them"});
  const bool is_utc = options.times == ExportOptions::Times::utc;
  ExportConfig config;
  config.format = options.format;
  std::optional<std::int64_t> run;
  if (options.run) run = find_run(recording.runs().or_throw(), *options.run, recording.path()).or_throw().run;
  config.filter = {options.topic, run, options.origin, from, until, options.limit, options.every};
  if (is_utc) config.filter.times = RowFilter::Times::utc;
  if (!options.step.empty()) {
    config.step = parse_duration(options.step).or_throw();
    if (config.step <= Duration{0})
      throw SetupError(
          {Errc::bad_argument, "cannot export", "--step " + options.step, "it is not above 0", "write one such as 1s"});
  }
  const std::optional<TableFormat> table_format = table_format_of(options);
  Progress progress(err, options.progress == ExportOptions::Progress::shown);
  config.on_progress = [&](const ExportProgress& at) { progress.show(at); };
  config.existing = options.existing == ExportOptions::Existing::replace ? ExportConfig::Existing::replace
                                                                         : ExportConfig::Existing::refuse;
  config.time = is_utc ? ExportTime::utc : ExportTime::recorded;
  config.time_text = is_utc ? ExportConfig::TimeText::iso8601 : ExportConfig::TimeText::nanoseconds;
  config.header = options.header == ExportOptions::Header::names ? ExportConfig::Header::names
                                                                 : ExportConfig::Header::names_and_units;
  find(recording, config.filter);
  if (options.folder.empty()) {
    auto made = table_format ? export_table(recording, config, *table_format, out)
                             : export_rows(recording, config, out);
    progress.clear();
    if (!made && !out) return 1;
    const ExportCount& count = made.or_throw();
    if (count.rows != 0) report_runs(err, recording, options);
    if (count.rows + count.refused == 0)
      err << "rtdata: no rows: " << recording.path() << " has none of what was asked for\n";
    return report_refused(err, count);
  }
  auto made = export_files(recording, config, options.folder);
  progress.clear();
  const auto& counts = made.or_throw();
  int status = 0;
  if (!counts.empty()) report_runs(err, recording, options);
  for (const ExportCount& count : counts) {
    out << count.path << ": " << count.rows << (count.rows == 1 ? " row\n" : " rows\n");
    status = std::max(status, report_refused(err, count));
  }
  return status;
} catch (const SetupError& error) {
  print_error(err, error.error());
  return status_after(error.error());
}

}  // namespace rtdata::app
