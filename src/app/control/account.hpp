// The result of a run, as text.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "app/control/status.hpp"

namespace rtdata::app {

/// The losses in each recording of the run, with the lines of `rtdata verify`, and those in no recording.
///
///     run.db, run 3
///       LOST: 660 ticks of host/process (missed 660)
///     in no recording
///       LOST: 12 samples of board (lost by the source 12)
std::string recorded_text(const Status& status);

/// Further facts for the verdict.
struct Ending {
  bool balances = true;                      ///< every equation of the ledger
  bool has_loss = false;                     ///< from the runtime
  std::string unknown = {};                  ///< what the account does not contain; empty: it is complete
  std::uint64_t not_stored = 0;              ///< events still queued at the deadline of closing
  std::string not_made = {};                 ///< parts that a reload could not make: "sink far"
  std::vector<std::string> not_closed = {};  ///< recordings, which the next start seals
  /// Sinks with `through` that could not read their recording, with the reason; their backlog is unknown.
  std::vector<std::string> unknown_backlogs = {};
};
/// One sentence: the losses by origin, the events taken, and whether the ledger balances.
///
///     nothing lost: 4177 events, 131 of them late; ledger balances
///     LOST: 666 ticks missed (host/process 660, host/cpu 6), 1 outage of 6.3 s (board); taken: 4177 events; ledger
///     balances
std::string verdict(const Status& status, const Ending& ending);
/// The number and reason of a sink's drops: "12 (queue full, newest)".
std::string dropped_text(const Status::Sink& sink);
/// "12000 events, 0 late, 3 missed, 0 failed, 0 dropped, 12 queued"
std::string progress(const Status& status);

}  // namespace rtdata::app
