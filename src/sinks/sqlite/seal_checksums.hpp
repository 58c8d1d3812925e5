// The checksums of a run that ended without closing, from what it has left in its live file.
#pragma once

#include <cstdint>
#include <string>

#include "sinks/sqlite/account_sums.hpp"
#include "sinks/sqlite/database.hpp"
#include "sinks/sqlite/live_file.hpp"

namespace rtdata::sqlite {

/// The last row of a data table that is of an earlier run than this; 0: there is none. Found by halving, since runs
/// follow each other: sealing need not look at rows of others.
Result<std::int64_t> rows_before(const Database& database, const std::string& table, std::int64_t run);

/// In the transaction that seals, before it changes the run's account: how many rows at the end of their origins had
/// been committed, as the live file says, and are not there. A disk that is taken away, or fails, may lose the last
/// transactions although it said that it had them. `live`: null when nothing survived; then it is not known, and 0.
Result<std::uint64_t> rows_lost_by_disk(Database& database, std::int64_t run, LiveFile* live);

/// In the transaction that seals, before it changes the run's account: goes on with the sums that the run had. `live`:
/// null when nothing survived; then they are those of what is there, as they are
/// where the disk has lost the last transactions.
Result<void> take_over_sums(Database& database, std::int64_t run, LiveFile* live, AccountSums& sums,
                            std::uint64_t lost_by_disk);

/// When the ledger has been brought in line with the rows: gives those that no checksum covers theirs, from the live
/// file, or a line that says that it is not known.
Result<void> seal_ranges(Database& database, std::int64_t run, LiveFile* live);

}  // namespace rtdata::sqlite
