// Parts of verify: scanning the rows, and comparing them with one run's account.
#pragma once

#include <array>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <unordered_map>

#include "recording/step.hpp"
#include "recording/verify_ticks.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata::detail {

/// "room/climate, origin room".
std::string place_of(std::string_view topic, std::string_view origin);
std::string plural(std::uint64_t count, std::string_view noun);

/// Data from the rows of one origin, in the order of writing.
struct OriginRows {
  struct Hole {
    std::uint64_t first, last;
  };
  static constexpr std::size_t most_holes = 5;
  static constexpr std::size_t most_sentences = 5;

  std::string topic, origin;
  std::int64_t run = 0;
  const UtcLine* line = nullptr;          // of the run; null: no account knows the origin
  std::int64_t account_ends = INT64_MAX;  // rowid after which rows came later than the account
  std::int64_t earliest = INT64_MIN, latest = INT64_MAX;
  bool is_first_carried = false;  // the first read was under way when the recording began
  bool may_begin_early = false;   // more reads may have been under way, if a tier hung
  std::array<std::uint64_t, sqlite::step_lengths.size()> steps_from{};  // as in the ledger
  std::uint64_t rows = 0;                                               // up to account_ends
  std::uint64_t rows_after = 0;
  std::uint64_t first_sequence = 0, last_sequence = 0;
  std::int64_t last_time = INT64_MIN;
  std::uint64_t missing = 0;  // between first_sequence and last_sequence
  std::vector<Hole> holes;
  std::uint64_t not_ascending = 0, times_back = 0, outside = 0;
  std::optional<TickCheck> ticks;              // of one whose rows are held to them
  std::vector<std::string> sentences;          // about order
  std::vector<std::string> outside_sentences;  // about times outside of the run
  std::vector<std::string> early_sentences;    // about those before it that may be

  void add(std::int64_t rowid, std::int64_t time, std::uint64_t sequence);
};

/// The key of what is collected: topic and origin, joined by a byte that neither has.
std::string origin_key(std::string_view topic, std::string_view origin);
using OriginMap = std::unordered_map<std::string, OriginRows>;

/// Data from the rows of one run.
struct RunRows {
  OriginMap origins;
  std::uint64_t checked = 0;         // rows that agree with their checksum
  std::uint64_t sum = 0;             // of the hashes of all rows
  std::vector<std::string> changed;  // those that do not
  std::uint64_t more_changed = 0;    // changes that are counted, but not listed
};
using RunsRows = std::map<std::int64_t, RunRows>;

/// Scans the rows of a table.
void scan_rows(const RecordingFile& file, const RecordedTopic& topic, RunsRows& runs,
               std::vector<std::string>& problems);

/// Collects the problems of a run.
struct Findings {
  static constexpr std::size_t most_sentences = 100;
  RunReport& report;
  bool is_exact;  // true for a closed run: every equation must hold; otherwise the last account may leave some open
  std::vector<std::string>& open;

  void problem(std::string text) const {
    if (report.problems.size() < most_sentences) {
      report.problems.push_back(std::move(text));
    } else {
      ++report.more_problems;
    }
  }
  void note(std::string text) const {
    if (report.notes.size() < most_sentences) report.notes.push_back(std::move(text));
  }
  std::string utc(Time recorded) const { return to_iso8601(report.line.utc(recorded)); }
  /// Adds a problem of a check that is exact only after the run is closed.
  void inexact(std::string text) const { is_exact ? problem(std::move(text)) : open.push_back(std::move(text)); }
};

/// Checks for triggers, missing views and changed columns. `are_topics_changed`: rtdata_topic or the columns of its
/// tables were changed.
void check_layout(const RecordingFile& file, const std::vector<RecordedTopic>& topics, bool are_topics_changed,
                  std::vector<std::string>& problems);

/// The state of the process that records a run, as known on this machine. `of_another_file`: this file is a copy
/// without the WAL file.
enum class Recorder { gone, there, of_another_file };
Recorder recorder_of(const RunInfo& run, const RecordingFile& file);

/// The account of a run, by origin.
struct OfRun {
  Recorder recorder = Recorder::gone;
  std::vector<LedgerEntry> ledger;
  std::vector<RecordedSegment> schedule;
  std::vector<RecordedGap> gaps;
  UtcLine line{{}};
  std::unordered_map<std::string, std::vector<const RecordedSegment*>> segments_of;
  std::unordered_map<std::string, std::vector<const RecordedGap*>> gaps_of;

  /// All but `recorder`.
  static OfRun load(const Recording& recording, std::int64_t run);
  /// In order of time; none: empty.
  const std::vector<const RecordedSegment*>& segments(const std::string& key) const;
  const std::vector<const RecordedGap*>& gaps_in(const std::string& key) const;
};

/// Compares the account of one run with its rows. Fills the report except `info`, `line` and the part of
/// `finish_account`.
void verify_run(const OfRun& of_run, const RunRows& rows, RunReport& report);

/// Adds unknown facts of the run and the report's lines.
void finish_account(const Recording& recording, const OfRun& of_run, RunReport& report);
RunReport account_of_run(const Recording& recording, const RunInfo& info);

/// Maps each topic that is not recorded to the recorded topics made from it.
std::map<std::string, std::vector<std::string>> made_of_unrecorded(const std::vector<LedgerEntry>& ledger);

TopicLoss loss_of(const LedgerEntry& entry, const Outages& outages);

/// Fills the report's part about deleted runs, if there are any, and checks their totals.
void verify_deleted(DeletedRuns runs, VerifyReport& report);

/// Checks that every run number from 1 on exists or was deleted.
void check_run_numbers(VerifyReport& report);

/// As `verify`, but without the run numbers, which are not consecutive on a server.
VerifyReport verify_contents(const Recording& recording);

/// The largest losses first; an outage counts as more than a number.
void most_first(std::vector<TopicLoss>& losses);

/// True if the account is complete: no tier hung, and nothing was lost in a power failure.
bool is_account_known(const RunInfo& run);

}  // namespace rtdata::detail
