// What a live file knows of an origin of a run that was killed, written into the recording.
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

/// Within a transaction: brings ledger, schedule and gaps of the origin up to what is known of its end. `last_time`
/// becomes that of its last tick, if it is later.
void seal_account(Database& database, const KilledOrigin& killed, const LiveAccount& kept, std::int64_t& last_time);

}  // namespace rtdata::sqlite
