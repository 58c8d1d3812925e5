/// Changes of health of the parts of a system, as events.
///
///     auto s = loop.subscribe<rtdata::HealthChange>("$rtdata/health", [](const rtdata::Event<rtdata::HealthChange>& e)
///     {
///       if (e->state == rtdata::Health::faulted) alarm(e->kind, e->name, e->reason);
///     });
///
/// One event for each change between ok, degraded and faulted, of whatever tier; its time is that of the change. `#`
/// does not match the topic; a sink records it when it names it. Recordings in SQLite keep the changes in any case, in
/// the table rtdata_health.
///
/// By kind: the name in the event, and what the states mean:
///   sensor   its name.            degraded: reads fail. faulted: closed, and tried again now and then; or stopped by
///                                 `on_overrun`.
///   sink     its name.            faulted: it cannot store.
///   lane     the device or bus.   degraded: a job was given up, its thread left behind. faulted: no thread is left to
///                                 run jobs.
///   loop     its or the tier's.   degraded: held longer than its limit in the last 10 s.
///   tier     its name.            faulted: it does not turn (see TierWatch).
///
/// Values; any thread.
#pragma once

#include "rtdata/data/describe.hpp"
#include "rtdata/data/text.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata {

inline constexpr const char* health_topic = "$rtdata/health";

constexpr auto describe(type_tag<Health>) {
  return enumeration("health_state", value("ok", Health::ok), value("degraded", Health::degraded),
                     value("faulted", Health::faulted));
}

struct HealthChange {
  text<16> kind;
  text<200> name;
  Health state = Health::ok;
  text<96> reason;  ///< what is longer ends with "..."; empty when it is ok
  friend constexpr auto describe(type_tag<HealthChange>) {
    return record("health", field("kind", &HealthChange::kind, ""), field("name", &HealthChange::name, ""),
                  field("state", &HealthChange::state, ""), field("reason", &HealthChange::reason, ""));
  }
};

}  // namespace rtdata
