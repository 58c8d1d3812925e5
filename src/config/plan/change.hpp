// What becomes of the parts of a system when another plan takes the place of its own. Private to src/config.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "rtdata/config/change.hpp"

namespace rtdata::config_detail {

/// A configuration as it is compared: its parts in the order in which they are made, and its settings.
struct Compared {
  std::vector<const PartPlan*> parts;
  const ConfigItem& root;
};

/// What becomes of one part; `now` is null when it is added, `next` when it is removed.
struct PlannedChange {
  const PartPlan* now;
  const PartPlan* next;
  PartChange change;
};

struct ComparedPlans {
  std::vector<PartChange> settings;
  std::vector<PlannedChange> parts;  ///< as in PlanChange

  PlanChange all() const;
};

/// What a run has fixed until its end.
struct RunSoFar {
  /// What the topic carries; null: not known.
  std::function<const Description*(const std::string& topic)> carried;
  /// Where events of this name were published.
  struct Published {
    std::string topic = {};  ///< empty: there were none
    std::string tier = {};   ///< empty: on the main loop
  };
  std::function<Published(const std::string& origin)> published;
  /// Whether what holds a part (PartPlan::hold) is so. Empty: not known.
  std::function<bool(const PartPlan& part)> is_held = {};
};

ComparedPlans compare(const Compared& now, const Compared& next, const RunSoFar& run);

}  // namespace rtdata::config_detail
