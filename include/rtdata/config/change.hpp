/// PlanChange: what happens to each part of a running system when a new configuration is applied.
///
///     rtdata::SystemPlan next = rtdata::plan_system(registry, rtdata::load_config("bench.json"));
///     rtdata::PlanChange change = rtdata::plan_change(plan, next);
///     std::cout << change.text();
///     // sensor chamber: changed while it runs (rate)
///     // sensor door: restarted (it uses bus i2c1)
///     // sensor attic: removed
///     if (next.good() && change.refused() == 0) system.apply(next);
///
/// Two parts are the same if they have the same kind and name. A part is unchanged if its item has the same keys and
/// values, in any order. If only keys differ that can change while the part runs (PartPlan::live), it is changed live;
/// otherwise the part is restarted, and each part that uses it. Some things cannot change in a running system: the
/// name, the settings of the loop and the log, tiers, and the fields of a topic. `notes` are stored with the
/// configuration text.
///
/// A StepwiseChange applies a plan in steps while the loop turns, for changes of many sensors:
///
///     rtdata::StepwiseChange change(system, next);
///     while (change.step(2ms)) { /* in a later turn: loop.post(...) */ }
///
/// PlanChange: a value; any thread. StepwiseChange: the loop's.
#pragma once

#include <cstddef>
#include <memory>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/config/system.hpp"

namespace rtdata {

enum class Fate {
  unchanged,
  live,       ///< changed while it runs: nothing is lost
  restarted,  ///< closed, and made anew
  added,
  removed,
  refused,  ///< not possible in a running system: nothing is changed
};
std::string_view name_of(Fate fate) noexcept;

struct PartChange {
  std::string object;  ///< "sensor chamber", or the key of a setting: "loop"
  Fate fate = Fate::unchanged;
  std::string why = {};  ///< the keys that differ, the part it uses, or why it is refused; may be empty

  /// "sensor chamber: restarted (file)"
  std::string text() const;
};

struct PlanChange {
  /// In this order: settings that differ, the parts of the next plan in the order of creation, the removed parts.
  std::vector<PartChange> all;

  std::size_t count(Fate fate) const noexcept;
  std::size_t refused() const noexcept { return count(Fate::refused); }
  /// True if nothing changes.
  bool is_empty() const noexcept { return count(Fate::unchanged) == all.size(); }
  /// One line for each change.
  std::string text() const;
};

/// Both plans must be without problems.
PlanChange plan_change(const SystemPlan& now, const SystemPlan& next);

/// Does the same as System::apply, but in steps, so that the loop can turn between two of them. First it closes the
/// parts that are removed or restarted, in reverse order of creation; outputs release their devices while the loop
/// turns. Then it makes parts and changes others live, in the order of the plan; outputs open their devices while the
/// loop turns. A sink is closed and made in one step, so that each event goes to the old or the new one. Ticks of a
/// sensor between closing and its new schedule count as missed. If a part cannot be made, the old plan is applied in
/// the same way.
///
/// Owner: the user, as a value that does not move; destroy it before the system. `next` must outlive it. Meanwhile, do
/// not add or remove parts and do not apply another plan. If it is destroyed before its last step, the steps done so
/// far remain.
class StepwiseChange {
 public:
  /// Compares the plans, and changes nothing. ConfigError: the plan has mistakes.
  StepwiseChange(System& system, const SystemPlan& next);
  ~StepwiseChange();
  StepwiseChange(const StepwiseChange&) = delete;
  StepwiseChange& operator=(const StepwiseChange&) = delete;

  /// What happens to each part. If any is refused, do not begin.
  const PlanChange& changes() const noexcept;
  /// The names of the tiers that take part. The change is refused if one of them hangs.
  std::set<std::string> tiers() const;
  /// Works until `budget` has passed by the loop's clock, but on at least one part; returns true if there is more to
  /// do. The last step throws what System::apply throws. With Duration::max() as budget it also waits for devices.
  bool step(Duration budget);
  /// True while it waits for a slow device: the next step does nothing until the loops have turned. Call `step` again
  /// in some milliseconds.
  bool is_waiting() const noexcept;
  /// True if all parts of the plan exist, except those that the error names.
  bool is_applied() const noexcept;

 private:
  std::unique_ptr<config_detail::PlanApplication> application_;
};

}  // namespace rtdata
