// The checksums of a run that ended without closing, from what it has left in its live file.
#pragma once

#include "sinks/sqlite/account_sums.hpp"
#include "sinks/sqlite/database.hpp"
#include "sinks/sqlite/live_file.hpp"

namespace rtdata::sqlite {

/// In the transaction that seals, before it changes the run's account: goes on with the sums that the run had. `live`: null
/// when nothing survived; then they are those of what is there.
Result<void> take_over_sums(Database& database, std::int64_t run, LiveFile* live, AccountSums& sums);

/// When the ledger has been brought in line with the rows: gives those that no checksum covers theirs, from the live file,
/// or a line that says that it is not known.
Result<void> seal_ranges(Database& database, std::int64_t run, LiveFile* live);

}  // namespace rtdata::sqlite
