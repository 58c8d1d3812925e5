// The subcommands of rtdata that read recordings. Each prints to `out`, prints errors to `err`, and returns the exit
// code. The caller reports failed writes to `out`.
#pragma once

#include <cstdint>
#include <iosfwd>
#include <optional>
#include <string>
#include <vector>

#include "app/core/show_as.hpp"
#include "rtdata/config/registry.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/recording/replay.hpp"
#include "rtdata/recording/runs.hpp"

namespace rtdata::app {

/// The status of each command after an error: 2 when the recording cannot be read, 1 after any other.
inline int status_after(const Error& error) {
  const bool is_of_file = error.what == "cannot read the recording" || error.what == "cannot use the recording";
  return is_of_file || error.code == Errc::damaged || error.code == Errc::not_a_recording ||
                 error.code == Errc::newer_version
             ? 2
             : 1;
}

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
/// One line per run. 0; 2 unreadable.
int runs(const RunsOptions& options, std::ostream& out, std::ostream& err);

/// 0: runs that ended without closing are sealed, if any; 1 not possible, for example during recording; 2 unreadable.
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
/// 0; 1 not merged, or differing rows were skipped; 2 a source is unreadable.
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

struct ViewOptions {
  std::string database;
  std::optional<std::string> run = {};  // the last one unless given
  std::string listen = {};              // a PageAddress; empty: the next free port from 8080 on
};
/// Serves the page of a recording until a signal. 0; 1 when there is no such run, or the port is taken; 2 unreadable.
int view(const Registry& registry, const ViewOptions& options, std::ostream& err);

struct ExportOptions {
  std::string database;
  std::string topic = "#";
  std::string format = "csv";  // a name of CodecRegistry::standard(), or jsonl
  std::string folder = {};     // folder for one file per topic; empty: everything goes to `out`
  enum class Existing { refuse, replace };
  Existing existing = Existing::refuse;  // replace: --overwrite
  std::optional<std::string> run = {};
  std::optional<std::string> origin = {};
  std::string from = {};   // first time exported, ISO 8601 or ns, recorded or (--utc) UTC; empty: from the start
  std::string until = {};  // first time not exported
  std::uint64_t limit = 0;
  std::uint64_t every = 1;
  std::string step = {};  // --step: length of steps; empty: each event
  enum class Progress { hidden, shown };
  Progress progress = Progress::hidden;  // shown: on `err`, which is a terminal
  enum class Times { recorded, utc };
  Times times = Times::recorded;  // utc: --utc, corrected times, as ISO 8601 in CSV
  enum class Header { names, names_and_units };
  Header header = Header::names;
  // Only for CSV of one topic, written to `out`.
  std::vector<std::string> join = {};  // topics whose last event at or before each row is in the row
  std::string within = {};             // how old that may be; empty: any age
  std::string separator = {};          // a character, or "tab"; empty: ","
  std::string decimal = {};            // "." or ","; empty: "."
  std::int64_t digits = -1;            // of numbers after the decimal mark; -1: as many as they have
  std::string time = {};               // "seconds": since `start`; empty: ns, or with `times` ISO 8601
  std::string start = {};              // ISO 8601 or ns; empty: the time of each run's first row
};
/// 0; 1 if the export is not possible, or there is no such run, topic or origin; 2 unreadable.
int export_recording(const ExportOptions& options, std::ostream& out, std::ostream& err);

/// Which part of one run. Times are UTC, as ISO 8601 or ns.
struct PartOptions {
  std::optional<std::string> run = {};  // the last one unless given
  std::string from = {};                // first time taken; empty: from the start
  std::string until = {};               // first time not taken; empty: to the end
  std::string last = {};                // a duration before the end, instead of `from`
};

struct PlotOptions {
  std::string database;
  std::vector<std::string> fields;  // TOPIC.FIELD, or TOPIC: all its numbers; none: lists what there is
  std::optional<std::string> origin = {};
  PartOptions part = {};
};
/// For the terminal of standard output, else for one of 80 x 24. 0; 1 when it cannot be plotted so, or there is no such
/// run, topic or field; 2 unreadable.
int plot(const PlotOptions& options, std::ostream& out, std::ostream& err);

struct ReportOptions {
  std::string database;
  std::optional<std::string> run = {};  // the last one unless given
  std::string file = {};                // "-": to `out`; empty: the recording's name with .html, in this folder
  enum class Existing { refuse, replace };
  Existing existing = Existing::refuse;  // replace: --overwrite
};
/// 0, whatever the verdict; 1 when there is no such run, or the file cannot be written; 2 unreadable.
int report(const ReportOptions& options, std::ostream& out, std::ostream& err);

struct RecordedTailOptions {
  std::string database;
  std::vector<std::string> topics = {};  // names or patterns; none: all
  PartOptions part = {};
  std::size_t lines = 20;  // the newest, unless the part has a begin
  std::string step = {};   // reduced to steps of this length; empty: each event
  ShowAs show_as = ShowAs::text;
  std::size_t columns = 0;  // lines of text are cut to this many; 0: they are not cut
};
/// 0; 1 when it cannot be shown so, or there is no such run or topic; 2 unreadable.
int tail_recording(const RecordedTailOptions& options, std::ostream& out, std::ostream& err);

struct ImportOptions {
  std::string file;                       // CSV with column names in the first row, and units as in "speed [m/s]"
  std::vector<std::string> time_columns;  // its heading, or those of its parts in order, such as date and time
  std::string time_format = {};           // as strptime has it; empty: ISO 8601 and numbers
  std::string scale = {};                 // duration of 1 in that column; empty: 1 s; not used for ISO 8601
  double rate = 0;                        // Hz, for a table without a time column; 0: it has one, or a step
  std::string step = {};                  // the time between its rows
  std::string start = {};                 // time of 0 in that column, ISO 8601; empty: 1970
  std::string separator = {};             // a character, "tab" or "blanks"; empty: that of a line "sep=;", or ","
  std::string decimal = {};               // "." or ","; empty: ".", and numbers that look like "," are refused
  std::string thousands = {};             // between groups of three digits; empty: nothing is
  std::string zone = {};   // "Z", "+01:00", "Europe/Berlin": for times without a zone; empty: these are refused
  std::uint64_t skip = 0;  // lines before the heading
  std::vector<std::string> comments = {};  // texts at the begin of lines that are skipped
  std::uint64_t head = 1;                  // rows of the heading, 1 or 2
  std::string units = {};                  // "row": a row after the heading has them; else they are in the heading
  std::string columns = {};                // the names, as a row of CSV, of a table without heading; empty: it has one
  std::vector<std::string> only =
      {};  // the rows taken: KIND, the text of their first cell, or COLUMN=TEXT; all of these
  std::vector<std::string> none = {};   // texts, and numbers in any notation, that mean "no value"
  std::vector<std::string> strip = {};  // texts to remove from the begin or end of cells with numbers
  std::vector<std::string> texts = {};  // headings of columns that are texts, whatever their cells are
  enum class Order { refused, sorted };
  Order order = Order::refused;  // for rows that are not in time order; sorted: --sort
  enum class Partial { refused, taken };
  Partial partial = Partial::refused;  // of rows that end early; taken: --partial
  std::string topic = {};              // empty: the file's name
  std::string origin = {};             // empty: the file's name
  std::string database = {};           // empty: FILE.db; adds to an existing one
};
/// 0; 1 if nothing, or not all, was imported: the error names the row.
int import_table(const ImportOptions& options, std::ostream& out, std::ostream& err);

struct ReplayOptions {
  ReplayConfig config;                  // `run` below sets its run
  std::optional<std::string> run = {};  // all of them, one after the other, unless given
  std::string configuration = {};       // its sinks get the events; empty: the terminal
  bool is_virtual = false;              // --speed max: as fast as it goes, in virtual time
  bool is_quiet = false;
};
/// 0; 1 not everything was replayed or stored; 2 unreadable, or mistakes in the configuration.
int replay(const Registry& registry, const ReplayOptions& options);

}  // namespace rtdata::app
