// The positions of sinks with `through` in a recording. The sinks set their positions; the recording's writer stores
// them with its next transaction, so that the file has one writer. After a kill, rows acknowledged since then are sent
// again.
#pragma once

#include <compare>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "recording/account_sums.hpp"
#include "recording/database.hpp"

namespace rtdata::sqlite {

/// The last processed row of a topic's table, with its key, because VACUUM renumbers the rows.
struct Position {
  std::int64_t row = 0;  ///< 0: before the first
  std::int64_t run = 0;
  std::string origin = {};
  std::int64_t sequence = 0;
};

/// A row that a sink's peer has refused.
struct Refusal {
  std::string sink;
  std::string topic;
  std::string run;
  std::string origin;
  std::int64_t sequence = 0;
  auto operator<=>(const Refusal&) const = default;
};

/// The table name in the row of rtdata_position that registers a sink. Its `origin` has the sink's topic patterns, a
/// line each; all rows of matching tables without a position wait.
inline constexpr const char* no_table = "";
std::string lines_of(const std::vector<std::string>& topics);
/// True if a topic matches one of these.
bool has_topic(std::string_view lines, std::string_view topic) noexcept;

/// The host name of this computer.
std::string host_name();

inline constexpr const char* position_schema = R"sql(
CREATE TABLE IF NOT EXISTS rtdata_position(
  sink TEXT NOT NULL,
  table_name TEXT NOT NULL,         -- of a topic; empty: the sink has been here, and origin has its topics
  row INTEGER NOT NULL,             -- rowid of the last row that the sink is done with, and its key
  run INTEGER NOT NULL, origin TEXT NOT NULL, sequence INTEGER NOT NULL,
  host TEXT NOT NULL,               -- the machine whose sink it is
  PRIMARY KEY(sink, table_name)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS rtdata_refused(
  sink TEXT NOT NULL, topic TEXT NOT NULL, run TEXT NOT NULL, origin TEXT NOT NULL, sequence INTEGER NOT NULL,
  reason TEXT NOT NULL,
  PRIMARY KEY(sink, topic, run, origin, sequence)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS rtdata_refused_before(  -- how many more a sink was refused, whose keys are not kept
  sink TEXT NOT NULL PRIMARY KEY, count INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS rtdata_unsent(  -- rows that a limit, or somebody, deleted before the sink's peer had them
  sink TEXT NOT NULL, topic TEXT NOT NULL, count INTEGER NOT NULL,
  PRIMARY KEY(sink, topic)) WITHOUT ROWID;
)sql";

/// The number that the row of the position has now: VACUUM changes them. 0: all rows come after it.
std::int64_t row_of(const Database& database, std::string_view table, const Position& position);

/// The position of a sink with `through` in a table of one of its topics.
struct SinkPosition {
  std::string sink;
  Position position;
};
/// The positions of all sinks that take the topic, as stored in the file.
std::vector<SinkPosition> sink_positions(Database& database, const std::string& topic, const std::string& table);

/// In a transaction: adds to the count of events that were deleted before the sink's peer had them. `sums` gets the
/// change.
void add_unsent(Database& database, AccountSums& sums, const std::string& sink, const std::string& topic,
                std::int64_t count);

/// Thread: any, except the calls of the recording's writer.
class Positions {
 public:
  /// The sink continues after that row, whether or not its peer has the earlier rows.
  void set(const std::string& sink, const std::string& table, Position position);
  /// The sink has processed all rows up to this one: its peer has or refused them.
  void settle(const std::string& sink, const std::string& table, Position position);
  /// Registers a sink for these topics. The next transaction stores the sink and its begin; with `From::now` it begins
  /// with the rows of that transaction.
  void begin(const std::string& sink, std::string topics, bool at_beginning, const void* owner);
  void leave(const std::string& sink, const void* owner) noexcept;
  /// Adds a refusal; it may be added again.
  void add(Refusal refusal, std::string reason);
  /// True if too many refusals wait to be written; the sink then reads no more rows.
  bool is_full() const;

  /// The last commit of the recording's writer.
  struct Committed {
    std::string topic;
    std::int64_t last_row = 0;
    std::size_t payload_bytes = 0;  ///< of a row
    std::int64_t deleted_to = 0;    ///< the last row that a limit deleted, with all before it; 0: none
  };
  /// By table; those whose rows have changed since it was opened.
  std::map<std::string, Committed> last_rows() const;
  std::int64_t run() const;

  /// To be called when the recording is closed.
  void at_end(std::function<std::string()> call);

  // ---- the recording's writer
  /// Limits the bytes of the keys of refused rows: older ones are only counted. 0: no limit.
  void limit_refusals(std::uint64_t bytes) noexcept { most_refused_bytes_ = static_cast<std::int64_t>(bytes); }
  void begin_run(std::int64_t run);
  void set_last_row(const std::string& table, const std::string& topic, std::int64_t row, std::size_t payload_bytes);
  void set_deleted_to(const std::string& table, const std::string& topic, std::int64_t row);
  /// Calls these functions; returns their texts.
  std::vector<std::string> end();
  bool is_dirty() const;
  /// In a transaction, before its rows: stores the begin of new sinks.
  void write_begins(Database& database);
  /// In a transaction, before a limit deletes the table's rows up to this one: counts them for the sinks that have not
  /// processed them.
  void count_unsent(Database& database, AccountSums& sums, const std::string& topic, const std::string& table,
                    std::int64_t up_to);
  /// In a transaction: stores what has changed. `sums` gets what changes in `sender_tables`.
  void write(Database& database, AccountSums& sums);
  void committed() noexcept;
  void rolled_back() noexcept;
  /// Sinks that have started to lose rows since the last call, separated by commas; empty: none.
  std::string take_losing() noexcept { return std::exchange(losing_, {}); }

  /// Marks that a sink reads the recording, while it lives.
  class Reading {
   public:
    explicit Reading(Positions& of);
    ~Reading();
    Reading(const Reading&) = delete;
    Reading& operator=(const Reading&) = delete;

   private:
    Positions& of_;
  };
  /// While it lives, no sink of this process reads, so the WAL file can restart. Waits for readers for a limited time.
  class HoldOff {
   public:
    explicit HoldOff(Positions& of);
    ~HoldOff();
    HoldOff(const HoldOff&) = delete;
    HoldOff& operator=(const HoldOff&) = delete;

   private:
    Positions& of_;
  };

 private:
  void forget_refusals(Database& database, AccountSums& sums);

  using Key = std::pair<std::string, std::string>;
  /// Rows of a table that were counted as unsent; those that are under way may be settled yet.
  struct Unsent {
    std::string topic;
    std::int64_t after = 0, up_to = 0;  // row numbers
    std::int64_t settled = 0;           // of these rows, to be subtracted again
    bool is_new = false;                // not committed yet
  };
  struct GoingThrough {
    std::string topics;  // lines
    bool at_beginning = false;
    const void* owner = nullptr;
    bool is_known = false;    // the file knows it
    bool is_written = false;  // in this transaction
  };
  void write_begin(Database& database, const std::string& name, const GoingThrough& sink);
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::map<Key, Position> dirty_;
  std::map<Key, Position> in_transaction_;
  std::map<std::string, GoingThrough> sinks_;
  std::map<Refusal, std::string> refusals_;  // and their reasons
  std::map<Refusal, std::string> refusals_in_transaction_;
  std::map<std::string, Committed> last_rows_;
  std::map<Key, Unsent> unsent_;
  std::map<Key, std::int64_t> settled_in_transaction_;
  std::map<std::string, std::int64_t> unsent_in_transaction_;  // by sink; 0: all that was deleted was sent
  std::set<std::string> are_losing_;                           // sinks
  std::string losing_;                                         // sinks for which this was not reported yet
  std::int64_t run_ = 0;
  std::int64_t most_refused_bytes_ = 0;
  std::int64_t refused_bytes_ = -1;  // about, of those that are stored; -1: not known
  std::vector<std::function<std::string()>> at_end_;
  int readers_ = 0;
  bool is_held_off_ = false;
};

}  // namespace rtdata::sqlite
