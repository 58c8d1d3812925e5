// The subcommands of rtdata that read recordings. Each prints to `out`, its errors to `err`, and returns the exit code.
// What `out` does not take is the caller's to tell.
#pragma once

#include <cstdint>
#include <iosfwd>
#include <optional>
#include <string>
#include <vector>

#include "app/core/show_as.hpp"
#include "rtdata/config/registry.hpp"
#include "rtdata/recording/replay.hpp"
#include "rtdata/recording/runs.hpp"

namespace rtdata::app {

// A run is named as `find_run` has it: by its number, from the end by -1, or by its name.

struct VerifyOptions {
  std::string database;
  std::optional<std::string> run = {};  // all of them unless given
  ShowAs show_as = ShowAs::text;
};
/// 0 balanced, sealed or being recorded; 1 a run is not balanced or not sealed, or there is no such run; 2 unreadable.
int verify(const VerifyOptions& options, std::ostream& out, std::ostream& err);

struct InfoOptions {
  std::string database;
  std::optional<std::string> run = {};  // the last one unless given
  ShowAs show_as = ShowAs::text;
  enum class Gaps { counted, listed };
  Gaps gaps = Gaps::counted;  // listed: --gaps, each with UTC
};
/// 0; 1 when there is no such run; 2 unreadable.
int info(const InfoOptions& options, std::ostream& out, std::ostream& err);

struct RunsOptions {
  std::string database;
  ShowAs show_as = ShowAs::text;
};
/// A line a run. 0; 2 unreadable.
int runs(const RunsOptions& options, std::ostream& out, std::ostream& err);

/// 0: what ended without closing is sealed, if anything; 1 it cannot be, as while it is recorded; 2 unreadable.
int seal(const std::string& database, std::ostream& out, std::ostream& err);

struct RemoveOptions {
  std::string database;
  std::string run;
  Unsent unsent = Unsent::refused;  // discarded: --discard-backlog
};
/// 0; 1 nothing was deleted: refused, or there is no such run; 2 unreadable.
int remove_run(const RemoveOptions& options, std::ostream& out, std::ostream& err);

struct MergeOptions {
  std::vector<std::string> sources;
  std::string database;  // that is made
};
/// 0; 1 not merged, or something that differs was left out; 2 a source is unreadable.
int merge(const MergeOptions& options, std::ostream& out, std::ostream& err);

struct CompareOptions {
  std::string database;
  std::string first, second;  // runs
  std::string from = {};      // TOPIC: its first event; MACHINE=STATE: the first that goes to it; empty: the start
  std::string length = {};    // a duration; empty: to the end
  ShowAs show_as = ShowAs::text;
};
/// 0; 1 there is no such run or instant; 2 unreadable.
int compare(const CompareOptions& options, std::ostream& out, std::ostream& err);

struct ExportOptions {
  std::string database;
  std::string topic = "#";
  std::string format = "csv";  // a name of CodecRegistry::standard(), or jsonl
  std::string folder = {};     // a file a topic in it; empty: everything to `out`
  enum class Existing { refuse, replace };
  Existing existing = Existing::refuse;  // replace: --overwrite
  std::optional<std::string> run = {};
  std::optional<std::string> origin = {};
  std::string from = {};   // first time taken, ISO 8601 or ns, as recorded or (--utc) UTC; empty: from the start
  std::string until = {};  // first time not taken
  std::uint64_t limit = 0;
  std::uint64_t every = 1;
  std::string step = {};  // --step: reduced to steps of this length; empty: each event
  enum class Progress { hidden, shown };
  Progress progress = Progress::hidden;  // shown: on `err`, which is a terminal
  enum class Times { recorded, utc };
  Times times = Times::recorded;  // utc: --utc, after the clock was set right, as ISO 8601 in CSV
  enum class Header { names, names_and_units };
  Header header = Header::names;
};
/// 0; 1 when it cannot be exported so, or there is no such run, topic or origin; 2 unreadable.
int export_recording(const ExportOptions& options, std::ostream& out, std::ostream& err);

struct ImportOptions {
  std::string file;             // CSV whose first row names the columns, with units as "speed [m/s]"
  std::string time_column;      // its heading
  std::string scale = "1 s";    // what 1 in that column is; times in ISO 8601 need none
  std::string start = {};       // ISO 8601: what 0 there is; empty: 1970
  std::string separator = ",";  // a character, or "tab"
  std::string decimal = {};     // "." or ","; empty: the former, and what looks like the latter is refused
  std::string zone = {};        // "Z", "+01:00": of times that say none; empty: they are refused
  std::string topic = {};       // empty: the file's name
  std::string origin = {};      // empty: the file's name
  std::string database = {};    // empty: FILE.db; one that exists is added to
};
/// 0; 1 when nothing, or not all, was imported: the error says which row.
int import_table(const ImportOptions& options, std::ostream& out, std::ostream& err);

struct ReplayOptions {
  ReplayConfig config;                  // its run is set by the next
  std::optional<std::string> run = {};  // all of them, one after the other, unless given
  std::string configuration = {};       // whose sinks get the events; empty: the terminal
  bool is_virtual = false;              // --speed max: as fast as it goes, in virtual time
  bool is_quiet = false;
};
/// 0; 1 not all was replayed, or stored; 2 unreadable, or mistakes in the configuration.
int replay(const Registry& registry, const ReplayOptions& options);

}  // namespace rtdata::app
