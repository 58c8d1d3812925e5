/// verify: whether a recording agrees with itself.
///
///     auto recording = rtdata::Recording::open("run.db").or_throw();
///     rtdata::VerifyReport report = rtdata::verify(recording).or_throw();
///     std::cout << report.text();
///     return report.exit_code();
///
/// Everything is computed again from the rows, the schedule and the gaps, and compared with the account that was
/// written with the data, and with its checksums. It shows accidental loss and damage: a row, a value, a gap or an
/// account that was deleted, added or changed. It is no proof against forgery: a program that changes all
/// of it alike is not noticed.
///
/// What is compared, per run and (topic, origin):
///   rows == stored - pruned; sequences ascend, each once, from first_sequence to last_sequence; what is missing of
///   them == dropped + pruned; times ascend and lie within the run; offered == stored + dropped; published >= offered;
///   the equations of ledger.hpp; each segment's ticks == (end - first_due) / period + 1, their sum == scheduled, no
///   two segments of an origin overlap; counts of the gaps == missed and failed, and none has more ticks than its time;
///   of a closed run, where each read brings one sample: each tick is a row at its time, or in exactly one gap;
///   the checksums of values and accounts. docs/recording.md has the rules in full.
/// A run that is being recorded, or ended without closing, is compared up to its last account; offered may then be
/// ahead of stored (what was queued), and gaps, segments and equations are only held to bounds. So are those of a
/// sealed run.
///
/// Thread: that of the recording. Memory: an entry an origin. Reads each row once.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "rtdata/recording/recording.hpp"

namespace rtdata {

enum class Verdict {
  balanced,
  sealed,        ///< not closed, and a later start wrote down what was lost, or a tier hung; what is there agrees
  recording,     ///< its process is alive: agrees as far as its last account goes
  unsealed,      ///< its process is gone without closing, and nothing was sealed yet
  not_balanced,  ///< something does not agree
};
std::string_view name_of(Verdict verdict) noexcept;

/// The outages of an origin without a schedule, from its gaps.
struct OriginOutages {
  std::string topic, origin;
  Outages outages;
  std::size_t gaps = 0;  ///< of which several outages may be one
};

/// What one topic lost in a run, by the place where it was lost. An empty topic: of sensors whose names are unknown.
struct TopicLoss {
  std::string topic;
  std::uint64_t missed = 0, failed = 0;  ///< ticks of the schedule without a reading
  std::uint64_t unreadable = 0;
  std::uint64_t by_source = 0;  ///< numbered by the source, or told by it as an overflow, and never came
  std::uint64_t dropped_newest = 0, dropped_oldest = 0, refused = 0;  ///< by the recording, as DropReason
  std::uint64_t not_saved = 0;                                        ///< when the run ended without closing
  Outages outages;                                                    ///< how many samples they cost is not known
  std::vector<std::string> made_of_it = {};  ///< recorded topics, of one that is not recorded itself

  std::uint64_t ticks() const noexcept { return missed + failed; }
  std::uint64_t samples() const noexcept {
    return unreadable + by_source + dropped_newest + dropped_oldest + refused + not_saved;
  }
  bool has_loss() const noexcept { return ticks() + samples() + outages.number > 0; }
  void add(const TopicLoss& other) noexcept;
};

struct RunReport {
  RunInfo info;
  UtcLine line{{}};  ///< by which all of the report's sentences are in UTC
  Verdict verdict = Verdict::balanced;
  std::uint64_t rows = 0, offered = 0, stored = 0, dropped = 0, unsaved = 0, pruned = 0;
  std::uint64_t scheduled = 0, missed = 0, failed = 0, late = 0;
  std::uint64_t received = 0, unreadable = 0;
  std::optional<std::uint64_t> lost_by_source;       ///< none: no source numbers its data
  std::map<std::string, std::uint64_t> first_lines;  ///< by topic; no loss: as of SensorCounts
  std::uint64_t values_checked = 0;                  ///< rows whose values agree with their checksum
  std::size_t origins = 0, gaps = 0;                 ///< outages are gaps, too
  std::vector<OriginOutages> outages;                ///< of each origin that had some, the longest first
  std::vector<TopicLoss> losses;                     ///< of each topic that lost something, the most first
  std::vector<std::string> not_known;  ///< of what it is not known whether it was lost; empty: all is known
  /// Topics of which some source has no schedule and numbers nothing: what it lost itself is not detectable.
  std::vector<std::string> not_detectable;
  /// What it lost, and what is not known: as the text has it, and `rtdata run` at its end. At least one.
  std::vector<std::string> lines;
  std::vector<std::string> problems;  ///< a sentence each; the first 100
  std::vector<std::string> notes;     ///< worth knowing, no problem; the first 100
  std::uint64_t more_problems = 0;    ///< beyond these
  bool has_open_equations = false;    ///< of a sealed run: see its notes
};

/// What is left of the runs whose rows and accounts were deleted.
struct DeletedReport {
  DeletedRuns runs;
  std::uint64_t offered = 0, stored = 0, dropped = 0, unsaved = 0;
  std::vector<TopicLoss> losses;                       ///< as those of a run
  std::vector<std::string> not_known, not_detectable;  ///< as those of a run
};

struct VerifyReport {
  std::string path;
  std::vector<RunReport> runs;
  std::optional<DeletedReport> deleted;  ///< none: no run was deleted
  /// By sink that goes through it: events that a limit deleted before its peer had them.
  std::map<std::string, std::uint64_t> unsent;
  std::vector<std::string> problems;  ///< that belong to no run

  /// The verdict of the whole file: the worst of its runs (recording counts as balanced).
  Verdict verdict() const noexcept;
  /// 0: balanced, sealed or being recorded; 1: not balanced, or not sealed.
  int exit_code() const noexcept;
  /// As a person reads it, the newest run last, at most 80 columns wide where the names allow.
  std::string text() const;
  std::string to_json() const;
};

/// What the account of one run says by itself: no row is read, and nothing is compared. `rows`: those that are to be
/// there. Errors: not-found, those of `Recording`.
Result<RunReport> account_of(const Recording& recording, std::int64_t run);

/// Errors: damaged (pages that cannot be read), those of `Recording`. A program exits with 2 then.
Result<VerifyReport> verify(const Recording& recording);

}  // namespace rtdata
