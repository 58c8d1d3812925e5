// Writes the account of an origin from the live file of a killed run into the recording.
#pragma once

#include <cstdint>
#include <string>

#include "recording/database.hpp"
#include "recording/live_file.hpp"

namespace rtdata::sqlite {

struct KilledOrigin {
  std::int64_t run;
  const std::string& topic;
  const std::string& origin;
  std::int64_t offered;  // as is known now
};

/// Within a transaction: updates ledger, schedule and gaps of the origin to the last known state. Sets `last_time` to
/// the time of its last tick if that is later.
void seal_account(Database& database, const KilledOrigin& killed, const LiveAccount& kept, std::int64_t& last_time);

}  // namespace rtdata::sqlite
