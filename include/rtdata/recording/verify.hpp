/// verify: checks a recording against its own account.
///
///     auto recording = rtdata::Recording::open("run.db").or_throw();
///     rtdata::VerifyReport report = rtdata::verify(recording).or_throw();
///     std::cout << report.text();
///     return report.exit_code();
///
/// It recomputes all counts from the rows, the schedule and the gaps, and compares them with the recorded account and
/// its checksums. It detects accidental loss and damage: a row, a value, a gap or an account that was deleted, added or
/// changed. It does not protect against forgery: consistent changes of all parts are not detected.
///
/// It checks, for each run and (topic, origin):
///   rows == stored - pruned; sequences ascend, each once, from first_sequence to last_sequence; what is missing of
///   them == dropped + pruned; times ascend and lie within the run; offered == stored + dropped; published >= offered;
///   the equations of ledger.hpp; each segment's ticks == (end - first_due) / period + 1, their sum == scheduled, no
///   two segments of an origin overlap; counts of the gaps == missed and failed, and none has more ticks than its time;
///   of a closed run, where each read brings one sample: each tick is a row at its time, or in exactly one gap;
///   the checksums of values and accounts. docs/recording.md has the rules in full.
/// A run that is still being recorded, or that ended without closing, is checked up to its last account. Offered may
/// then exceed stored by the queued events, and gaps, segments and equations are checked only against bounds. The same
/// holds for a sealed run.
///
/// The report is a value. Thread: that of the recording. Memory: one entry for each origin. Reads each row once.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "rtdata/recording/recording.hpp"

namespace rtdata {

enum class Verdict {
  balanced,
  sealed,        ///< not closed; a later start recorded the losses, or a tier hung; the rest agrees
  recording,     ///< its process is alive; it agrees up to its last account
  unsealed,      ///< its process ended without closing, and it is not sealed yet
  not_balanced,  ///< something does not agree
};
std::string_view name_of(Verdict verdict) noexcept;

/// The outages of an origin without a schedule, from its gaps.
struct OriginOutages {
  std::string topic, origin;
  Outages outages;
  std::size_t gaps = 0;  ///< of which several outages may be one
};

/// The losses of one topic in a run, by place. An empty topic: sensors with unknown names.
struct TopicLoss {
  std::string topic;
  std::uint64_t missed = 0, failed = 0;  ///< ticks of the schedule without a reading
  std::uint64_t unreadable = 0;
  std::uint64_t by_source = 0;  ///< numbered by the source, or reported by it as an overflow, but never received
  std::uint64_t dropped_newest = 0, dropped_oldest = 0, refused = 0;  ///< by the recording, as DropReason
  std::uint64_t not_saved = 0;                                        ///< when the run ended without closing
  Outages outages;                                                    ///< the number of lost samples is unknown
  std::vector<std::string> made_of_it = {};  ///< recorded topics made from this one, if it is not recorded itself
  /// The part of failed whose sample is in unreadable, too. 0 where reads bring several samples: then it is unknown.
  std::uint64_t failed_unreadable = 0;

  std::uint64_t ticks() const noexcept { return missed + failed; }
  /// Without those of failed ticks.
  std::uint64_t samples() const noexcept {
    return unreadable - failed_unreadable + by_source + dropped_newest + dropped_oldest + refused + not_saved;
  }
  bool has_loss() const noexcept { return ticks() + samples() + outages.number > 0; }
  void add(const TopicLoss& other) noexcept;
};

struct RunReport {
  RunInfo info;
  UtcLine line{{}};  ///< converts the times of the report to UTC
  Verdict verdict = Verdict::balanced;
  std::uint64_t rows = 0, offered = 0, stored = 0, dropped = 0, unsaved = 0, pruned = 0;
  std::uint64_t scheduled = 0, missed = 0, failed = 0, late = 0;
  std::uint64_t received = 0, unreadable = 0;
  std::optional<std::uint64_t> lost_by_source;       ///< none: no source numbers its data
  std::map<std::string, std::uint64_t> first_lines;  ///< by topic; not a loss: see SensorCounts
  std::uint64_t values_checked = 0;                  ///< rows whose values agree with their checksum
  /// The sum of the hashes of the run's account and of all its rows, mod 2^64. Recordings of equal content have the
  /// same; a row that is added, changed or deleted changes it. Set only by `verify`.
  std::uint64_t checksum = 0;
  std::string checksum_text() const;   ///< 16 hexadecimal digits
  std::size_t origins = 0, gaps = 0;   ///< outages are gaps, too
  std::vector<OriginOutages> outages;  ///< of each origin that had some, the longest first
  std::vector<TopicLoss> losses;       ///< of each topic that lost something, the most first
  std::vector<std::string> not_known;  ///< data for which a loss is unknown; empty: all is known
  /// Topics with a source that has no schedule and no numbers: its own losses cannot be detected.
  std::vector<std::string> not_detectable;
  std::vector<std::string> mute;  ///< origins from which no event ever came; topics of "$" are not among them
  /// The losses and unknowns as lines of text, also shown by `rtdata run` at its end. At least one line.
  std::vector<std::string> lines;
  std::vector<std::string> problems;  ///< a sentence each; the first 100
  std::vector<std::string> notes;     ///< not problems; the first 100
  std::uint64_t more_problems = 0;    ///< number of further problems
  bool has_open_equations = false;    ///< of a sealed run: see its notes
};

/// The totals of runs whose rows and accounts were deleted.
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
  /// For each sink with `through`: events deleted by a limit before they were sent.
  std::map<std::string, std::uint64_t> unsent;
  std::vector<std::string> problems;  ///< problems of no particular run

  /// The verdict of the whole file: the worst of its runs (`recording` counts as balanced).
  Verdict verdict() const noexcept;
  /// 0: balanced, sealed or being recorded; 1: not balanced, or not sealed.
  int exit_code() const noexcept;
  /// The report as text for users, the newest run last; at most 80 columns wide if the names allow.
  std::string text() const;
  std::string to_json() const;
};

/// The account of one run alone; reads no rows and compares nothing. `rows`: the expected number. Errors: not-found,
/// those of `Recording`.
Result<RunReport> account_of(const Recording& recording, std::int64_t run);

/// Errors: damaged (pages that cannot be read), those of `Recording`. A program exits with 2 then.
Result<VerifyReport> verify(const Recording& recording);

}  // namespace rtdata
