// What a run has done so far, by topic and by sink.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/loop/runtime.hpp"
#include "rtdata/sinks/verify.hpp"

namespace rtdata::app {

struct TopicAccount {
  std::string topic;
  std::uint64_t events = 0;
  std::uint64_t late = 0;
  std::uint64_t missed = 0;
  std::uint64_t failed = 0;
  std::uint64_t unreadable = 0;
  std::uint64_t lost = 0;
  std::uint64_t dropped = 0;      ///< by sinks
  std::uint64_t first_lines = 0;  ///< no loss
  Outages outages = {};
  Health health = Health::ok;  ///< the worst of its sensors'
  std::string reason = {};
};

struct RunAccount {
  std::vector<TopicAccount> topics;
  std::vector<SinkStatus> sinks;
  /// Of the first of these, which were closed: their own file, where the one of their name may have another now, and
  /// that of the recording that they went through. Empty: none.
  struct Files {
    std::optional<std::string> own;
    std::string recording;
    bool is_recording = false;
    std::shared_ptr<const RunReport> recorded = {};  ///< what that says of its run; null: it was not closed
  };
  std::vector<Files> closed_sinks;
  std::uint64_t events = 0, late = 0, missed = 0, failed = 0, unreadable = 0, lost = 0, dropped = 0, queued = 0;
  std::uint64_t waiting = 0;      ///< in recordings, to be sent
  std::uint64_t first_lines = 0;  ///< no loss
  Outages outages = {};
  std::vector<std::string> mute;  ///< sensors that never gave an event
  /// Sinks that go through a recording and could not look into it, with the reason: what waits for them is not known.
  std::vector<std::string> unknown_backlogs;
  /// Sensors without a schedule whose source numbers nothing: what it lost itself cannot be known.
  std::vector<std::string> not_detectable;
};

/// Up to now, also of sensors that were removed while it ran.
RunAccount account_of(Runtime& runtime);

/// The tables printed at the end, at most `columns` wide where names allow (0: as wide as they are); what was
/// unreadable has a column if there is any. `paths`: of the sinks that are there last, by name.
std::string summary(const RunAccount& account, const std::map<std::string, std::string>& paths, std::size_t columns);

/// What each recording says of its run, in the lines of `rtdata verify`, and what none of them holds.
///
///     run.db, run 3
///       LOST: 660 ticks of host/process (missed 660)
///     in no recording
///       LOST: 12 samples of board (lost by the source 12)
std::string recorded_text(const RunAccount& account, const std::map<std::string, std::string>& paths);

/// What the verdict says beside the account.
struct Ending {
  bool balances = true;          ///< every equation of the ledger
  bool has_loss = false;         ///< as the runtime says
  std::string unknown = {};      ///< what is not in the account; empty: it is complete
  std::uint64_t not_stored = 0;  ///< when the time to close was over
};
/// One sentence: what was lost and of whom, what is there, whether the ledger balances.
///
///     nothing lost: 4177 events, 131 of them late; ledger balances
///     LOST: 666 ticks missed (host/process 660, host/cpu 6), 1 outage of 6.3 s (board); taken: 4177 events; ledger
///     balances
std::string verdict(const RunAccount& account, const Ending& ending);
/// "12000 events, 0 late, 3 missed, 0 failed, 0 dropped, 12 queued"
std::string progress(const RunAccount& account);

}  // namespace rtdata::app
