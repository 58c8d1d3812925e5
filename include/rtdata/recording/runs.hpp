/// find_run, seal, delete_run, merge: what is done to the runs of recordings after they were recorded.
///
///     auto recording = rtdata::Recording::open("bench.db").or_throw();
///     auto last = rtdata::find_run(recording.runs().or_throw(), "-1", recording.path()).or_throw();
///     rtdata::delete_run("bench.db", last.run).or_throw();
///
/// A function that changes a file locks it: `busy` names the process that records into it. After a kill the file is
/// either unchanged, or the whole change is done. Thread: any; they block on the disk. Errors: also those of
/// `Recording::open`, not-permitted, storage-full. Results are values.
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/recording/recording.hpp"

namespace rtdata {

/// Finds a run by its number; by -1 for the last one, -2 for the one before it and so on; or by its name, if only one
/// run has it. `path`: of the recording, for errors. Errors: not-found, with the nearest name; bad-argument
/// (several runs have that name, which are listed).
Result<RunInfo> find_run(std::span<const RunInfo> runs, std::string_view which, const std::string& path);

/// The hash of each run, by its number, from the checksums of its account and rows. Two runs are the same, in the same
/// state, if their hashes are.
Result<std::map<std::int64_t, std::uint64_t>> hashes_of_runs(const Recording& recording);

/// Seals the runs that ended without closing, as the next start of recording would. Returns a remark for each that
/// names its losses; none: there was nothing to seal. Errors: busy.
Result<std::vector<std::string>> seal(const std::string& path);

/// What was deleted with a run.
struct RunDeletion {
  std::uint64_t rows = 0;
  /// By sink with `through`: events that its peer does not have, and can no longer get from this recording.
  std::map<std::string, std::uint64_t> unsent;
};
enum class Unsent {
  refused,  ///< does not delete a run of which events wait for a peer
  discarded,
};
/// Deletes a run: its rows, its steps and its account, and adds the sums of the account to `Recording::deleted_runs`.
/// The UTC conversion of other runs stays. Errors: not-found; busy (it is recorded into); bad-argument (events wait for
/// a peer, by sink; the run is not sealed; its account has another number of rows than there are, so its sums cannot
/// balance).
Result<RunDeletion> delete_run(const std::string& path, std::int64_t run, Unsent unsent = Unsent::refused);

/// A run of a recording that was merged.
struct MergedRun {
  std::int64_t run = 0;  ///< its number there
  std::string source;    ///< the recording that it is from
  std::int64_t source_run = 0;
  std::uint64_t hash = 0;  ///< there: see `hashes_of_runs`
  std::uint64_t rows = 0;
  /// A sentence for each topic of the same run in another source: how many rows are the same, how many it adds.
  std::vector<std::string> copies = {};
  /// A sentence for each topic with rows that differ there and are left out; empty: none.
  std::vector<std::string> differences = {};
};
struct MergeReport {
  std::vector<MergedRun> runs;
  std::vector<std::string> notes;  ///< events that wait in a source for a peer, and are sent from there only
};
/// Makes one recording of all runs of the sources, which stay unchanged. Each run gets a new number and keeps its
/// account and its clock pairs; its remark names source and hash. It has no steps: they are made from its rows when
/// they are read. A run that several sources have (by its uuid) is there once, with the latest account; so are its
/// rows, also those that only another source still has. Verifies the sources, and the new file before it is renamed
/// to `path`, which must not exist.
/// Errors: bad-argument (a run that is recorded, not sealed or not balanced; a source named twice; a `path` that is
/// there), damaged.
Result<MergeReport> merge(const std::vector<std::string>& sources, const std::string& path);

}  // namespace rtdata
