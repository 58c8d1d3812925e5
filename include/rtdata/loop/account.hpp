/// The final account: an event for each sensor and feed with what became of its data, published on `$rtdata/account`
/// when a loop closes, after the last event of all others and before sinks close.
///
///     "sinks": [{"type": "http", "url": "https://collector.example/in", "topics": ["#", "$rtdata/account"]}]
///
/// So the receiver of what a sink sends can tell whether it has everything: of each origin, the events with sequences
/// up to `published`; and what the machine itself knows to be missing. `#` does not match the topic. With `through`,
/// the recording has to name it, too; then it waits there as all else does, when the peer is away at the end. It is
/// published only where a sink or a subscription names the topic, and a program that is killed publishes none.
///
/// Values; any thread.
#pragma once

#include <cstdint>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/text.hpp"

namespace rtdata {

inline constexpr const char* account_topic = "$rtdata/account";

struct FinalCounts {
  text<200> name;                ///< of the sensor or feed: the origin of its events
  text<200> topic;               ///< that it published on
  std::uint64_t published = 0;   ///< events, which is the sequence of the last one
  std::uint64_t late = 0;        ///< of its ticks
  std::uint64_t missed = 0;      ///< ticks at which nothing was begun
  std::uint64_t failed = 0;      ///< ticks whose read brought nothing usable
  std::uint64_t unreadable = 0;  ///< samples that came and could not be decoded
  std::uint64_t lost = 0;        ///< samples that the source numbered and that never came
  bool lost_is_known = false;    ///< the source numbers its data
  friend constexpr auto describe(type_tag<FinalCounts>) {
    return record("account", field("name", &FinalCounts::name, ""), field("topic", &FinalCounts::topic, ""),
                  field("published", &FinalCounts::published, ""), field("late", &FinalCounts::late, ""),
                  field("missed", &FinalCounts::missed, ""), field("failed", &FinalCounts::failed, ""),
                  field("unreadable", &FinalCounts::unreadable, ""), field("lost", &FinalCounts::lost, ""),
                  field("lost_is_known", &FinalCounts::lost_is_known, ""));
  }
};

}  // namespace rtdata
