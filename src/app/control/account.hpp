// What a run came to, in sentences.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "app/control/status.hpp"

namespace rtdata::app {

/// What each recording says of its run, in the lines of `rtdata verify`, and what none of them holds.
///
///     run.db, run 3
///       LOST: 660 ticks of host/process (missed 660)
///     in no recording
///       LOST: 12 samples of board (lost by the source 12)
std::string recorded_text(const Status& status);

/// What the verdict says beside the account.
struct Ending {
  bool balances = true;          ///< every equation of the ledger
  bool has_loss = false;         ///< as the runtime says
  std::string unknown = {};      ///< what is not in the account; empty: it is complete
  std::uint64_t not_stored = 0;  ///< when the time to close was over
  std::string not_made = {};     ///< parts that a reload has not made, or not made again: "sink far"
  /// Sinks that go through a recording and could not look into it, with the reason: what waits for them is not known.
  std::vector<std::string> unknown_backlogs = {};
};
/// One sentence: what was lost and of whom, what is there, whether the ledger balances.
///
///     nothing lost: 4177 events, 131 of them late; ledger balances
///     LOST: 666 ticks missed (host/process 660, host/cpu 6), 1 outage of 6.3 s (board); taken: 4177 events; ledger
///     balances
std::string verdict(const Status& status, const Ending& ending);
/// What a sink dropped, and why: "12 (queue full, newest)".
std::string dropped_text(const Status::Sink& sink);
/// "12000 events, 0 late, 3 missed, 0 failed, 0 dropped, 12 queued"
std::string progress(const Status& status);

}  // namespace rtdata::app
