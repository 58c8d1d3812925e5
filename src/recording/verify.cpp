#include "rtdata/recording/verify.hpp"

#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <map>
#include <set>

#include "data/name_in.hpp"
#include "data/saturating.hpp"
#include "recording/live_file.hpp"
#include "recording/recording_file.hpp"
#include "recording/recording_lock.hpp"
#include "recording/utc_line.hpp"
#include "recording/verify_run.hpp"
#include "recording/verify_steps.hpp"
#include "recording/verify_sums.hpp"

namespace rtdata {
namespace detail {

std::string place_of(std::string_view topic, std::string_view origin) {
  return std::string(topic) + ", origin " + std::string(origin);
}

std::string plural(std::uint64_t count, std::string_view noun) {
  return std::to_string(count) + " " + std::string(noun) + (count == 1 ? "" : "s");
}

std::string origin_key(std::string_view topic, std::string_view origin) {
  std::string key(topic);
  key += '\n';
  return key.append(origin);
}

namespace {

bool is_alive(const RunInfo& run) {
  std::ifstream file("/proc/sys/kernel/random/boot_id");
  std::string boot_id;
  std::getline(file, boot_id);
  // A clock for tests may have no real boot id. Then only the check of the process id counts.
  const bool is_machine = run.boot_id.size() == boot_id.size();
  if (boot_id.empty() || (is_machine && boot_id != run.boot_id) || run.pid <= 0) return false;
  return ::kill(static_cast<pid_t>(run.pid), 0) == 0 || errno == EPERM;
}

}  // namespace

Recorder recorder_of(const RunInfo& run, const RecordingFile& file) {
  if (run.state != RunState::recording || !is_alive(run)) return Recorder::gone;
  const char* const path = sqlite3_db_filename(file.database.raw(), "main");  // without symbolic links
  std::error_code none;
  const auto log_bytes = std::filesystem::file_size(std::string(path) + "-wal", none);
  const bool is_copy = !file.is_of_server && run.pid != ::getpid() && (none || log_bytes == 0) &&
                       sqlite::RecordingLock::is_free(path);
  return is_copy ? Recorder::of_another_file : Recorder::there;
}

bool is_account_known(const RunInfo& run) {
  return run.state == RunState::recording ? run.remark.empty() : run.state == RunState::closed || run.lost.has_value();
}

void OriginRows::add(std::int64_t rowid, std::int64_t time, std::uint64_t sequence) {
  const auto utc = [this](std::int64_t recorded) {
    const Time at = from_nanoseconds(recorded);
    return to_iso8601(line != nullptr ? line->utc(at) : at);
  };
  const auto say = [](std::vector<std::string>& to, std::string text) {
    if (to.size() < most_sentences) to.push_back(std::move(text));
  };
  if (rowid > account_ends) {
    ++rows_after;
  } else {
    ++rows;
  }
  if (first_sequence == 0 && last_sequence == 0) {
    first_sequence = sequence;
    last_sequence = sequence;
  } else if (sequence == last_sequence + 1) [[likely]] {
    last_sequence = sequence;
  } else if (sequence > last_sequence) {
    if (rowid <= account_ends) {
      missing += sequence - last_sequence - 1;
      if (holes.size() < most_holes) holes.push_back({last_sequence + 1, sequence - 1});
    }
    last_sequence = sequence;
  } else {
    if (not_ascending++ < most_sentences) {
      say(sentences, "sequence " + std::to_string(sequence) + " follows " + std::to_string(last_sequence) +
                         (sequence == last_sequence ? ": it is there twice" : ", but sequences ascend"));
    }
  }
  if (time <= last_time) {
    if (times_back++ < most_sentences) {
      say(sentences, "the time of sequence " + std::to_string(sequence) + ", " + utc(time) +
                         ", is not after that of the row before, " + utc(last_time));
    }
  }
  last_time = time;
  if (ticks) ticks->add(time, sequence);
  const bool is_early = time < earliest && !(is_first_carried && rows + rows_after == 1);
  if (!is_early && (time <= latest || rowid > account_ends)) return;
  const std::string text = "the time of sequence " + std::to_string(sequence) + ", " + utc(time) +
                           ", lies outside of the run";
  if (is_early && may_begin_early) return say(early_sentences, text);
  ++outside;
  say(outside_sentences, text);
}

void scan_rows(const RecordingFile& file, const RecordedTopic& topic, RunsRows& runs,
               std::vector<std::string>& problems) {
  auto statement = file.prepare("SELECT t._rowid_, t.* FROM " + sqlite::quoted(topic.table) + " t ORDER BY t._rowid_");
  OriginRows* current = nullptr;
  ValueSums sums(topic.table);
  StepCheck steps(file, topic, runs, problems);
  std::map<std::int64_t, std::uint64_t> strays;  // rows of missing runs
  std::unordered_map<std::string, OriginRows*> known;
  std::int64_t known_run = 0;
  std::string name;
  while (statement.step()) {
    sums.add(statement.raw(), 1, runs);
    const std::int64_t run = statement.integer(1);
    if (sqlite3_column_type(statement.raw(), 1) != SQLITE_INTEGER) [[unlikely]] {
      problems.push_back(topic.topic + ": row " + std::to_string(statement.integer(0)) + " has no number as its run.");
      if (problems.size() > 100) break;
      continue;
    }
    if (sqlite3_column_type(statement.raw(), 3) != SQLITE_TEXT) [[unlikely]] {
      // Reading it as a text would convert it, also for its hash.
      problems.push_back(topic.topic + ": row " + std::to_string(statement.integer(0)) + " has no text as its origin.");
      if (problems.size() > 100) break;
      continue;
    }
    const std::string_view origin = statement.text(3);
    const auto sequence = static_cast<std::uint64_t>(statement.integer(4));
    if (current == nullptr || current->run != run || current->origin != origin) {
      if (run != known_run) known.clear();
      known_run = run;
      name.assign(origin);
      OriginRows*& found = known[name];
      if (found == nullptr) {
        const auto of_run = runs.find(run);
        if (of_run == runs.end()) {
          ++strays[run];
          known.erase(name);
          current = nullptr;
          continue;
        }
        OriginRows& rows = of_run->second.origins[origin_key(topic.topic, name)];
        if (rows.topic.empty()) {  // no account knows it
          rows.topic = topic.topic;
          rows.origin = name;
          rows.run = run;
        }
        found = &rows;
      }
      current = found;
    }
    current->add(statement.integer(0), statement.integer(2), sequence);
    steps.add(statement.raw(), 1, *current);
  }
  steps.end();
  if (sums.rest() != 0)
    problems.push_back(
        topic.topic + ": " + plural(sums.rest(), "row") +
        " at its end have no checksum: there are rows after the last transaction, or its end is not there.");
  for (const auto& [run, rows] : strays) {
    problems.push_back(topic.topic + ": " + plural(rows, "row") + " of run " + std::to_string(run) +
                       ", which is not in the list of runs.");
  }
}

OfRun OfRun::load(const Recording& recording, std::int64_t run) {
  OfRun loaded;
  loaded.line = utc_line_of(*recording.file(), run);
  loaded.ledger = recording.ledger(run).or_throw();
  loaded.schedule = recording.schedule(run).or_throw();
  loaded.gaps = recording.gaps(run).or_throw();
  for (const RecordedSegment& one : loaded.schedule)
    loaded.segments_of[origin_key(one.topic, one.origin)].push_back(&one);
  for (const RecordedGap& one : loaded.gaps) loaded.gaps_of[origin_key(one.topic, one.origin)].push_back(&one);
  return loaded;
}

const std::vector<const RecordedSegment*>& OfRun::segments(const std::string& key) const {
  static const std::vector<const RecordedSegment*> none;
  const auto found = segments_of.find(key);
  return found != segments_of.end() ? found->second : none;
}

const std::vector<const RecordedGap*>& OfRun::gaps_in(const std::string& key) const {
  static const std::vector<const RecordedGap*> none;
  const auto found = gaps_of.find(key);
  return found != gaps_of.end() ? found->second : none;
}

void most_first(std::vector<TopicLoss>& losses) {
  std::stable_sort(losses.begin(), losses.end(), [](const TopicLoss& a, const TopicLoss& b) {
    return std::pair(a.outages.time, a.samples() + a.ticks()) > std::pair(b.outages.time, b.samples() + b.ticks());
  });
}

}  // namespace detail

void TopicLoss::add(const TopicLoss& other) noexcept {
  missed += other.missed;
  failed += other.failed;
  unreadable += other.unreadable;
  failed_unreadable += other.failed_unreadable;
  by_source += other.by_source;
  dropped_newest += other.dropped_newest;
  dropped_oldest += other.dropped_oldest;
  refused += other.refused;
  not_saved += other.not_saved;
  outages.add(other.outages);
}

std::string_view name_of(Verdict verdict) noexcept {
  constexpr std::string_view names[] = {"balanced", "sealed", "recording", "not sealed", "not balanced"};
  return detail::name_in(names, verdict);
}

namespace detail {

VerifyReport verify_contents(const Recording& recording) {
  const Snapshot snapshot(recording.file());
  auto checked = recording.file()->prepare("PRAGMA quick_check(1)");
  checked.step();
  if (checked.text(0) != "ok")
    throw SetupError(recording.file()->damaged("", "SQLite says: " + std::string(checked.text(0))));

  VerifyReport report;
  report.path = recording.path();
  auto infos = recording.runs().or_throw();
  RunsRows rows;
  std::map<std::int64_t, OfRun> accounts;
  for (RunInfo& info : infos) {
    const bool has_ticks = info.state == RunState::closed;
    auto loaded = OfRun::load(recording, info.run);
    loaded.recorder = recorder_of(info, *recording.file());
    const OfRun& of_run = accounts.emplace(info.run, std::move(loaded)).first->second;
    OriginMap& origins = rows[info.run].origins;
    const bool is_ended = info.state != RunState::recording;
    for (const LedgerEntry& entry : of_run.ledger) {
      OriginRows& origin = origins[origin_key(entry.topic, entry.origin)];
      origin.topic = entry.topic;
      origin.origin = entry.origin;
      origin.run = info.run;
      origin.line = &of_run.line;
      if (!is_ended) origin.account_ends = entry.rows_up_to;
      constexpr Duration tolerance = std::chrono::milliseconds{1};  // events at one time are put 1 ns apart
      origin.earliest = to_nanoseconds(later(info.started, -tolerance));
      origin.may_begin_early = !is_account_known(info);
      if (is_ended && info.ended) origin.latest = to_nanoseconds(later(*info.ended, tolerance));
      origin.is_first_carried = entry.carried != 0;
      origin.steps_from = {entry.seconds_from, entry.minutes_from};
      if (has_ticks && TickCheck::is_held(entry)) {
        const std::string key = origin_key(entry.topic, entry.origin);
        origin.ticks.emplace(entry, of_run.segments(key), of_run.gaps_in(key), of_run.line);
      }
    }
    RunReport& run = report.runs.emplace_back();
    run.info = std::move(info);
    run.line = of_run.line;
  }
  auto topics = recording.topics().or_throw();
  for (const RecordedTopic& topic : topics) scan_rows(*recording.file(), topic, rows, report.problems);
  auto odd = recording.file()->database.integer(
      "SELECT count(*) FROM rtdata_utc WHERE typeof(since) <> 'integer' OR typeof(\"offset\") <> 'integer' OR "
      "typeof(rate) <> 'real'");
  if (odd != 0) report.problems.push_back("The UTC line (rtdata_utc) has values that are not numbers.");
  std::set<std::string> boots;
  for (const RunReport& run : report.runs) boots.insert(run.info.boot_id);
  for (const std::string& boot : boots) {
    if (!sqlite::utc_line_agrees(recording.file()->database, boot))
      report.problems.push_back("The UTC line of boot " + boot + " (rtdata_utc) does not agree with rtdata_clock.");
  }
  auto are_topics_changed = check_account_sums(*recording.file(), topics, report);
  check_layout(*recording.file(), topics, are_topics_changed, report.problems);
  auto deleted = recording.deleted_runs().or_throw();
  verify_deleted(std::move(deleted), report);
  auto unsent = recording.file()->prepare("SELECT sink, sum(count) FROM rtdata_unsent GROUP BY sink");
  while (unsent.step())
    if (unsent.integer(1) > 0) report.unsent.emplace(unsent.text(0), static_cast<std::uint64_t>(unsent.integer(1)));
  for (RunReport& run : report.runs) {
    verify_run(accounts.at(run.info.run), rows[run.info.run], run);
    finish_account(recording, accounts.at(run.info.run), run);
  }
  return report;
}

}  // namespace detail

Result<RunReport> account_of(const Recording& recording, std::int64_t run) try {
  const detail::Snapshot snapshot(recording.file());
  auto infos = recording.runs().or_throw();
  for (const RunInfo& info : infos)
    if (info.run == run) return detail::account_of_run(recording, info);
  return Error{Errc::not_found, "cannot read the account", recording.path(), "there is no run " + std::to_string(run),
               ""};
} catch (const SetupError& error) {
  return error.error();
}

Result<VerifyReport> verify(const Recording& recording) try {
  VerifyReport report = detail::verify_contents(recording);
  detail::check_run_numbers(report);
  for (const sqlite::LiveFile& live : sqlite::LiveFile::without_row(recording.path(), "")) {
    const std::string uuid = live.run().uuid;
    const auto is_it = [&](const RunReport& run) { return run.info.uuid == uuid; };
    if (std::none_of(report.runs.begin(), report.runs.end(), is_it))
      report.problems.emplace_back(
          "A run was killed before it had opened this file, and is not in it: `rtdata seal` or the next start counts "
          "what it lost.");
  }
  return report;
} catch (const SetupError& error) {
  return error.error();
}

Verdict VerifyReport::verdict() const noexcept {
  Verdict worst = problems.empty() ? Verdict::balanced : Verdict::not_balanced;
  for (const RunReport& run : runs) worst = std::max(worst, run.verdict);
  return worst;
}

int VerifyReport::exit_code() const noexcept { return verdict() >= Verdict::unsealed ? 1 : 0; }

}  // namespace rtdata
