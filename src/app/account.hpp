// What a run has done so far, by topic and by sink.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "rtdata/loop/runtime.hpp"

namespace rtdata::app {

struct TopicAccount {
  std::string topic;
  std::uint64_t events = 0;
  std::uint64_t late = 0;
  std::uint64_t missed = 0;
  std::uint64_t failed = 0;
  std::uint64_t unreadable = 0;
  std::uint64_t lost = 0;
  std::uint64_t dropped = 0;   ///< by sinks
  Health health = Health::ok;  ///< the worst of its sensors'
  std::string reason;
};

struct RunAccount {
  std::vector<TopicAccount> topics;
  std::vector<SinkStatus> sinks;
  std::uint64_t events = 0, late = 0, missed = 0, failed = 0, unreadable = 0, lost = 0, dropped = 0, queued = 0;
};

RunAccount account_of(const Runtime& runtime);

/// The tables printed at the end; what was unreadable has a column if there is any. `paths`: of sinks, by name.
std::string summary(const RunAccount& account, const std::map<std::string, std::string>& paths);
/// "12000 events, 0 late, 3 missed, 0 failed, 0 dropped, 12 queued"
std::string progress(const RunAccount& account);

}  // namespace rtdata::app
