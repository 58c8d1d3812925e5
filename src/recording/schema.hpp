// The tables of a recording. docs/recording.md explains them to users. All times are ns since the epoch on the run's
// line that never jumps, except those of rtdata_clock and rtdata_utc. The views "TABLE~utc" and rtdata_run_utc have UTC
// too.
//
// One table per topic, named as the topic (rtdata_topic maps the exceptions), columns:
//   run, time, origin, sequence, "checksum~", then one column per leaf of the description, named by its path
//   ("position.x", "accel[0]").
// "checksum~" is NULL, except in the last row of each transaction: there it is the sum of the hashes of the rows that
// the transaction stored in this table.
// A row's key is (run, origin, sequence). Values: bool 0/1; integers INTEGER (uint64 bit for bit as int64); float and
// double REAL, NaN as NULL where the field is not optional and as the text 'NaN' where it is; text TEXT, or a BLOB
// if it is not UTF-8 or has zero bytes; char TEXT of one character (INTEGER if it is not printable ASCII);
// enum TEXT by name, INTEGER where the number has no name; absent NULL.
//
// In addition, once it has steps (step.hpp), the tables "TABLE~1s" and "TABLE~1min" (`step_table`; `tables_of_topic`
// gives all), columns:
//   run, time (of the step's beginning), origin, events, first_sequence, last_sequence, "checksum~", then of each field
//   that is a number "PATH.count", "PATH.min", "PATH.max", "PATH.sum", "PATH.last", in the order of the topic's table.
// Key: (run, origin, time). Such a row summarises the stored rows of the origin from first_sequence to
// last_sequence, all of one second or minute; the ledger says from which sequence on all rows of an origin have one.
// NaN is not counted; all five are NULL without a number; the sum is a double, NULL where infinities of both signs are
// in it. "checksum~" is the hash of its own row, without run and checksum.
#pragma once

namespace rtdata::sqlite {

class Database;

inline constexpr int application_id = 0x72744442;  // "rtDB"
inline constexpr int schema_version = 1;           // PRAGMA user_version

inline constexpr const char* checksum_column = "checksum~";
/// Columns of a topic's table before those of its fields: run, time, origin, sequence and the checksum.
inline constexpr int columns_before_fields = 5;

/// The id of recordings from before version 0.1.0, and the messages about them.
inline constexpr int application_id_before = 0x52544441;
inline constexpr const char* written_before = "it is a recording of a version before 0.1.0, which had another format";
inline constexpr const char* advice_before = "export it with the rtdata that recorded it, or record into another file";

inline constexpr const char* schema = R"sql(
CREATE TABLE IF NOT EXISTS rtdata_run(
  run INTEGER PRIMARY KEY,
  uuid TEXT NOT NULL,
  name TEXT NOT NULL, notes TEXT NOT NULL, configuration TEXT NOT NULL,
  program TEXT NOT NULL,            -- name and version of what recorded
  host TEXT NOT NULL, boot_id TEXT NOT NULL, pid INTEGER NOT NULL,
  started INTEGER NOT NULL,         -- time of the start
  ended INTEGER,                    -- time of the last account
  clock_offset INTEGER NOT NULL,    -- recorded time minus the monotonic clock
  state TEXT NOT NULL,              -- recording, closed, sealed (not closed, or a tier hung at its beginning or end)
  lost INTEGER,                     -- of a sealed run: events published and not stored; NULL: not known
  remark TEXT NOT NULL DEFAULT '',  -- what is known of what is not known
  format INTEGER NOT NULL,          -- the version of this layout in which it was written
  "checksum~" INTEGER NOT NULL DEFAULT 0  -- sum of the hashes of the run's rows in all tables of the account, mod 2^64
);
CREATE TABLE IF NOT EXISTS rtdata_topic(
  topic TEXT NOT NULL, version INTEGER NOT NULL,
  table_name TEXT NOT NULL UNIQUE,
  description TEXT NOT NULL,        -- JSON: record name, fields with type and unit
  first_run INTEGER NOT NULL,
  PRIMARY KEY(topic, version)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS rtdata_schedule(  -- stretches of unchanged schedule
  run INTEGER NOT NULL, origin TEXT NOT NULL, topic TEXT NOT NULL,
  first_due INTEGER NOT NULL, period INTEGER NOT NULL, end INTEGER NOT NULL,
  scheduled INTEGER NOT NULL,       -- = (end - first_due) / period + 1
  late_after INTEGER NOT NULL DEFAULT 0,  -- reads that began later than that after they were due are late
  PRIMARY KEY(run, origin, first_due)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS rtdata_ledger(
  run INTEGER NOT NULL, topic TEXT NOT NULL, origin TEXT NOT NULL,
  slot INTEGER NOT NULL,
  has_schedule INTEGER NOT NULL,
  scheduled INTEGER NOT NULL, taken INTEGER NOT NULL, missed INTEGER NOT NULL, failed INTEGER NOT NULL,
  in_flight INTEGER NOT NULL, late INTEGER NOT NULL,
  received INTEGER NOT NULL, published INTEGER NOT NULL, repeated INTEGER NOT NULL, filtered INTEGER NOT NULL,
  lost INTEGER,                     -- NULL: not detectable
  offered INTEGER NOT NULL, stored INTEGER NOT NULL,
  dropped_newest INTEGER NOT NULL, dropped_oldest INTEGER NOT NULL, dropped_refused INTEGER NOT NULL,
  dropped_unsaved INTEGER NOT NULL DEFAULT 0,  -- of a sealed run: published and never committed
  first_sequence INTEGER NOT NULL, last_sequence INTEGER NOT NULL,  -- offered; 0: none
  pruned INTEGER NOT NULL DEFAULT 0,           -- rows deleted again by the size or age limit
  rows_up_to INTEGER NOT NULL DEFAULT 0,       -- the topic table's last rowid when this was written
  carried INTEGER NOT NULL DEFAULT 0,          -- reads that were under way when the recording began
  unreadable INTEGER NOT NULL DEFAULT 0,       -- received and not to be decoded
  one_a_read INTEGER NOT NULL DEFAULT 0,       -- each read taken brought one sample, with the time at which it began
  lateness INTEGER NOT NULL DEFAULT 0,         -- of what was published, time minus when its read was due, summed mod 2^64
  first_lines INTEGER,                         -- thrown away, since a port was opened in their middle; NULL: none
  made_of TEXT,                                -- the topics of whose events its own are made, with spaces between
  seconds_from INTEGER NOT NULL DEFAULT 0,     -- the sequence from which on all rows are in steps of 1 s; 0: none
  minutes_from INTEGER NOT NULL DEFAULT 0,     -- the same of 1 min
  PRIMARY KEY(run, topic, origin)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS rtdata_gap(
  run INTEGER NOT NULL, topic TEXT NOT NULL, origin TEXT NOT NULL,
  kind TEXT NOT NULL,               -- missed, failed, joined; without a schedule disconnected, silent, joined
  reason TEXT NOT NULL,
  first INTEGER NOT NULL, last INTEGER NOT NULL,  -- when the first and the last tick were due; else from and to
  count INTEGER);                   -- ticks without a reading; without a schedule NULL, or how many were joined
CREATE TABLE IF NOT EXISTS rtdata_clock(
  run INTEGER NOT NULL, monotonic INTEGER NOT NULL, realtime INTEGER NOT NULL,
  source TEXT NOT NULL,             -- system, or the name of a plugged clock
  occasion TEXT NOT NULL DEFAULT '',  -- start, step (the time of day was set), suspended (the machine was), sync (its
                                    -- accuracy changed), regular, end
  accuracy INTEGER,                 -- NULL: not known
  suspended INTEGER);               -- for how long the machine was suspended since the boot
CREATE TABLE IF NOT EXISTS rtdata_utc(  -- computed from rtdata_clock: UTC = monotonic + offset + (monotonic - since) * rate
  boot_id TEXT NOT NULL,
  since INTEGER NOT NULL,           -- monotonic; up to the next row's
  "offset" INTEGER NOT NULL, rate REAL NOT NULL,
  PRIMARY KEY(boot_id, since)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS rtdata_error(
  run INTEGER NOT NULL, time INTEGER NOT NULL, object TEXT NOT NULL, id TEXT NOT NULL, text TEXT NOT NULL,
  count INTEGER NOT NULL,
  last INTEGER NOT NULL DEFAULT 0); -- of `count` that are joined, `time` is that of the first; 0: as `time`
CREATE TABLE IF NOT EXISTS rtdata_health(  -- each change, or several of one object joined
  run INTEGER NOT NULL, time INTEGER NOT NULL,
  kind TEXT NOT NULL,               -- sensor, sink, lane, loop, tier
  name TEXT NOT NULL,
  state TEXT NOT NULL,              -- ok, degraded, faulted; of several the last
  reason TEXT NOT NULL,             -- empty when ok
  count INTEGER NOT NULL DEFAULT 1, -- changes
  last INTEGER NOT NULL DEFAULT 0); -- of `count` that are joined, `time` is that of the first; 0: as `time`
CREATE TABLE IF NOT EXISTS rtdata_checksum(
  sum INTEGER NOT NULL,             -- of the hashes of the rows of rtdata_topic, each with the columns of its table
  senders INTEGER NOT NULL);        -- of those of the rows of rtdata_refused, rtdata_refused_before, rtdata_unsent
INSERT INTO rtdata_checksum VALUES(0, 0);
CREATE TABLE IF NOT EXISTS rtdata_configuration(  -- changes since the text in rtdata_run
  run INTEGER NOT NULL, time INTEGER NOT NULL,
  object TEXT NOT NULL,             -- the part that was added, changed or removed; empty: the whole configuration
  text TEXT NOT NULL,               -- of the part or of the whole; empty: the part was removed
  count INTEGER NOT NULL DEFAULT 1);  -- changes of the object up to this one that are joined
CREATE TABLE IF NOT EXISTS rtdata_deleted(  -- sums over the runs that were deleted since none of their rows was left
  topic TEXT NOT NULL, origin TEXT NOT NULL,       -- both empty: of the runs themselves
  runs INTEGER NOT NULL,                           -- that were deleted and had it
  first_run INTEGER NOT NULL, last_run INTEGER NOT NULL,
  started INTEGER NOT NULL, ended INTEGER NOT NULL,  -- of the first, of the last
  sealed INTEGER NOT NULL,                         -- of the runs: those that were not closed
  scheduled INTEGER NOT NULL, missed INTEGER NOT NULL, failed INTEGER NOT NULL, late INTEGER NOT NULL,
  received INTEGER NOT NULL, published INTEGER NOT NULL, unreadable INTEGER NOT NULL, lost INTEGER NOT NULL,
  not_detectable INTEGER NOT NULL,                 -- runs without a schedule whose source numbered nothing
  offered INTEGER NOT NULL, stored INTEGER NOT NULL,
  dropped_newest INTEGER NOT NULL, dropped_oldest INTEGER NOT NULL, dropped_refused INTEGER NOT NULL,
  dropped_unsaved INTEGER NOT NULL,                -- of the runs: of sensors that had only begun
  pruned INTEGER NOT NULL,
  outages INTEGER NOT NULL, outage_time INTEGER NOT NULL, outages_joined INTEGER NOT NULL,
  PRIMARY KEY(topic, origin)) WITHOUT ROWID;
)sql";

/// True for a recording of before version 0.1.0 that has the present id.
bool lacks_suspensions(const Database& database);

/// Makes the tables and views of a recording in an empty file.
void make_recording(const Database& database);

}  // namespace rtdata::sqlite
