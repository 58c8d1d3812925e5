/// The runs of recordings, after they were recorded: found by what a person calls them, sealed, deleted, merged.
///
///     auto recording = rtdata::Recording::open("bench.db").or_throw();
///     auto last = rtdata::find_run(recording.runs().or_throw(), "-1", recording.path()).or_throw();
///     rtdata::delete_run("bench.db", last.run).or_throw();
///
/// What changes a file needs it alone: `busy` names the process that records into it. A kill in the middle leaves it as
/// it was, or changed as a whole. Thread: any; they block on the disk. Errors: also those of `Recording::open`,
/// not-permitted, storage-full.
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/recording/recording.hpp"

namespace rtdata {

/// The run that is called so: its number; -1 for the last one, -2 for the one before it and so on; or its name, where
/// one run alone has it. `path`: of the recording, for errors. Errors: not-found, with the nearest name; bad-argument
/// (several runs have that name, which are listed).
Result<RunInfo> find_run(std::span<const RunInfo> runs, std::string_view which, const std::string& path);

/// A hash of each run, by its number: of its account and of its rows, as their checksums say. Two runs are the same, in
/// the same state, if their hashes are.
Result<std::map<std::int64_t, std::uint64_t>> hashes_of_runs(const Recording& recording);

/// Seals the runs that ended without closing, as the next start of recording would. Returns a remark for each, which
/// says what it lost; none: there was nothing to seal. Errors: busy.
Result<std::vector<std::string>> seal(const std::string& path);

/// What was deleted with a run.
struct RunDeletion {
  std::uint64_t rows = 0;
  /// By sink that goes through the recording: events that its peer does not have, and will not get from here.
  std::map<std::string, std::uint64_t> unsent;
};
enum class Unsent {
  refused,  ///< a run that a peer has not all of is not deleted
  discarded,
};
/// Deletes a run: its rows and its account, of which the sums stay among those of `Recording::deleted_runs`. What the
/// recording knows of UTC stays. Errors: not-found; busy (it is recorded into); bad-argument (events wait for a peer,
/// by sink; the run is not sealed; its rows are not as many as its account says, so that sums of it would not balance).
Result<RunDeletion> delete_run(const std::string& path, std::int64_t run, Unsent unsent = Unsent::refused);

/// A run of a recording that was merged.
struct MergedRun {
  std::int64_t run = 0;  ///< its number there
  std::string source;    ///< the recording that it is from
  std::int64_t source_run = 0;
  std::uint64_t hash = 0;  ///< there: see `hashes_of_runs`
  std::uint64_t rows = 0;
  /// What another source has of the same run, a sentence each: rows that are the same, and that it adds.
  std::vector<std::string> copies = {};
  /// What it has otherwise, and is left out, a sentence each; empty: nothing.
  std::vector<std::string> differences = {};
};
struct MergeReport {
  std::vector<MergedRun> runs;
  std::vector<std::string> notes;  ///< what the new recording has not: events that wait in a source for a peer
};
/// Makes a recording of all runs of others, which stay as they are. Each is a run of it, with a number of its own, its
/// account and its clock pairs; its remark names source and hash. Of a run that several sources have (by its uuid)
/// there is one, whose account is the latest; its rows are there once, those too that only another source still has.
/// The sources are verified before, and what was made after. `path` must not exist: it is made beside, and renamed.
/// Errors: bad-argument (a run that is recorded, not sealed or not balanced; a source named twice; a `path` that is
/// there), damaged.
Result<MergeReport> merge(const std::vector<std::string>& sources, const std::string& path);

}  // namespace rtdata
