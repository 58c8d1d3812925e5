// Compares a system's plan with a new one, part by part. Private to src/config.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "rtdata/config/change.hpp"

namespace rtdata::config_detail {

/// A configuration for comparison: its parts in the order of creation, and its settings.
struct Compared {
  std::vector<const PartPlan*> parts;
  const ConfigItem& root;
};

/// The change of one part; `now` is null if it is added, `next` if it is removed.
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

/// Facts that are fixed until the end of a run.
struct RunSoFar {
  /// The description of a topic; null: unknown.
  std::function<const Description*(const std::string& topic)> carried;
  /// Where events of this name were published.
  struct Published {
    std::string topic = {};  ///< empty: there were none
    std::string tier = {};   ///< empty: on the main loop
  };
  std::function<Published(const std::string& origin)> published;
  /// Returns true if a part is held now (PartPlan::hold). Empty: unknown.
  std::function<bool(const PartPlan& part)> is_held = {};
};

ComparedPlans compare(const Compared& now, const Compared& next, const RunSoFar& run);

}  // namespace rtdata::config_detail
