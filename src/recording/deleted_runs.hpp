// Runs of which no row is left: their account goes too, and what it came to is added up in rtdata_deleted.
#pragma once

#include <cstdint>
#include <vector>

#include "recording/database.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::sqlite {

/// So many runs keep their account, however little is left of them: the newest.
inline constexpr int kept_runs = 16;

/// Runs that have ended, of which no row is left, and which are not among the newest; the oldest first. `ended_before`:
/// only those. The newest of a boot that has older runs is none of them: it may know best what their UTC is.
std::vector<std::int64_t> runs_without_rows(const Database& database, std::int64_t ended_before);

/// Within a transaction: adds the run's account to rtdata_deleted, and deletes it.
void delete_run(Database& database, std::int64_t run);

/// Adds a row of another recording's rtdata_deleted, the numbers of whose runs become larger by `base`.
void add_deleted(Database& database, const Statement& row, std::int64_t base);

}  // namespace rtdata::sqlite
