// Runs without rows: deletes their account and adds its totals to rtdata_deleted.
#pragma once

#include <cstdint>
#include <vector>

#include "recording/database.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::sqlite {

/// The number of newest runs that always keep their account.
inline constexpr int kept_runs = 16;

/// Ended runs without rows that are not among the newest; the oldest first. `ended_before`: only those that ended
/// earlier. Skips the newest run of a boot with older runs, because it may have the best UTC data.
std::vector<std::int64_t> runs_without_rows(const Database& database, std::int64_t ended_before);

/// Within a transaction: adds the run's account to rtdata_deleted, and deletes it.
void delete_run(Database& database, std::int64_t run);

/// Adds a row of another recording's rtdata_deleted, the numbers of whose runs become larger by `base`.
void add_deleted(Database& database, const Statement& row, std::int64_t base);

}  // namespace rtdata::sqlite
