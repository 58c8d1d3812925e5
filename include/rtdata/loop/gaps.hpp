/// GapEvent: what a sensor or feed did not bring, as an event, as soon as that is over.
///
///     auto s = loop.subscribe<rtdata::GapEvent>("$rtdata/gaps", [](const rtdata::Event<rtdata::GapEvent>& e) {
///       show(e->name, e->reason, e->count);
///     });
///
/// One event for each gap that a recording has, of whatever tier; its time is when the gap was closed: with the next
/// reading, or when the device was back. `#` does not match the topic. It is published once something has subscribed to
/// it, so earlier gaps are not published; recordings have all of them, in the table rtdata_gap.
///
/// A value. Thread: the main loop's.
#pragma once

#include <cstdint>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/text.hpp"
#include "rtdata/loop/ledger.hpp"

namespace rtdata {

namespace detail {
class OriginCore;
/// On the main loop, if anything needs it.
void publish_gap(const OriginCore& origin, const Gap& gap) noexcept;
}  // namespace detail

inline constexpr const char* gap_topic = "$rtdata/gaps";

struct GapEvent {
  text<200> name;           ///< of the sensor or feed: the origin of its events
  text<200> topic;          ///< topic that it publishes on
  text<16> kind;            ///< as name_of(Gap::Kind)
  text<96> reason;          ///< a longer one ends with "..."
  std::int64_t first = 0;   ///< ns since 1970: when the first of its ticks was due; without a schedule, when it began
  std::int64_t last = 0;    ///< the last of them; without a schedule, when it ended
  std::uint64_t count = 0;  ///< as Gap::count
  friend constexpr auto describe(type_tag<GapEvent>) {
    return record("gap", field("name", &GapEvent::name, ""), field("topic", &GapEvent::topic, ""),
                  field("kind", &GapEvent::kind, ""), field("reason", &GapEvent::reason, ""),
                  field("first", &GapEvent::first, "ns"), field("last", &GapEvent::last, "ns"),
                  field("count", &GapEvent::count, ""));
  }
};

}  // namespace rtdata
