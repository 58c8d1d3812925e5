// Copies the account of a recording's runs to the server: rtdata_ledger, _schedule, _gap, _clock, _error, _health,
// _configuration and what rtdata_run has, of the topics that the sink takes.
//
// An account is sent when the server has all rows that it counts, so that both can be compared. The account of a
// running run is replaced by the next one; the last account of an ended run stays. Each table has a checksum of its
// rows (rtdata_checksum), as in a recording.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "postgresql/connection.hpp"
#include "recording/checksum.hpp"
#include "recording/database.hpp"

namespace rtdata::postgresql {

/// The columns of the tables of the account, in the order of `sqlite::account_tables`, as this version has them; their
/// first is the run.
struct AccountColumn {
  std::string name, type;  ///< the type on the server
};
std::vector<std::vector<AccountColumn>> account_columns();
/// Their names, as SQL lists them.
std::string names_of(const std::vector<AccountColumn>& columns);

/// The columns that only the server has for a run: its machine, its positions, and the run of each table. For an ended
/// run they stay, in rtdata_checksum as rtdata_position.
constexpr int position_columns = 10;
sqlite::RowSum sum_of_positions(Connection& connection, std::int64_t run);

struct AccountCopy {
  std::string recording;            ///< path
  std::string machine;              ///< of runs that the server does not know yet
  std::string sink;                 ///< its name: that of its position in the recording
  std::vector<std::string> topics;  ///< patterns
};

void copy_accounts(Connection& connection, const AccountCopy& copy);

}  // namespace rtdata::postgresql
