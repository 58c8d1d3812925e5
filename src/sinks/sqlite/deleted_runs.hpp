// Runs of which no row is left: their account goes too, and what it came to is added up in rtdata_deleted.
#pragma once

#include <cstdint>
#include <vector>

#include "rtdata/sinks/recording.hpp"
#include "sinks/sqlite/database.hpp"

namespace rtdata::sqlite {

/// So many runs keep their account, however little is left of them: the newest.
inline constexpr int kept_runs = 16;

inline constexpr const char* deleted_schema = R"sql(
CREATE TABLE IF NOT EXISTS rtdata_deleted(
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
  PRIMARY KEY(topic, origin)) WITHOUT ROWID
)sql";

/// Runs that have ended, of which no row is left, and which are not among the newest; the oldest first. `ended_before`:
/// only those. The newest of a boot that has older runs is none of them: it may know best what their UTC is.
std::vector<std::int64_t> runs_without_rows(const Database& database, std::int64_t ended_before);

/// Within a transaction: adds the run's account to rtdata_deleted, and deletes it.
void delete_run(Database& database, std::int64_t run);

}  // namespace rtdata::sqlite
