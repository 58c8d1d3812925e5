/// PlanChange: what becomes of each part of a running system when another configuration takes the place of its own.
///
///     SystemPlan next = plan_system(registry, load_config("bench.json"));
///     PlanChange change = plan_change(plan, next);
///     std::cout << change.text();
///     // sensor chamber: changed while it runs (rate)
///     // sensor door: restarted (it uses bus i2c1)
///     // sensor attic: removed
///     if (next.good() && change.refused() == 0) system.apply(next);
///
/// Parts are the same when their kind and name are. An item that says the same, in whatever order, is unchanged. One
/// that differs in what a part can take while it runs (PartPlan::live) is changed live; otherwise the part is made
/// anew, and so is each that uses it. What the runtime or the recordings are made with cannot change: the name, the
/// settings of the loop and the log, tiers, and the values that a topic carries. `notes` are kept with the text.
///
/// A StepwiseChange applies a plan while the loop turns, for one that adds or removes many sensors:
///
///     StepwiseChange change(system, next);
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
  refused,  ///< cannot be done in a running system: then nothing is done
};
std::string_view name_of(Fate fate) noexcept;

struct PartChange {
  std::string object;  ///< "sensor chamber", or the key of a setting: "loop"
  Fate fate = Fate::unchanged;
  std::string why = {};  ///< the keys that differ, what it uses, why it is refused; empty where the fate says all

  /// "sensor chamber: restarted (file)"
  std::string text() const;
};

struct PlanChange {
  /// Settings that differ, then the parts of the next plan in the order in which they are made, then those removed.
  std::vector<PartChange> all;

  std::size_t count(Fate fate) const noexcept;
  std::size_t refused() const noexcept { return count(Fate::refused); }
  /// Nothing is to be done.
  bool is_empty() const noexcept { return count(Fate::unchanged) == all.size(); }
  /// A line for each that is not unchanged.
  std::string text() const;
};

/// Both without problems.
PlanChange plan_change(const SystemPlan& now, const SystemPlan& next);

/// Does what System::apply does, a part of it at a time, so that a turn of the loop can come between two steps. Parts
/// that end or are made anew are closed, the last one made first; outputs give their devices back while the loop turns.
/// Then parts are made and changed live, in the order of the plan; outputs take their devices while the loop turns.
/// What stores is closed and made in one step: so what is published meanwhile goes to one or the other. Ticks of a
/// sensor from when it is closed until its schedule begins again are missed, and counted. When a part cannot be made,
/// the plan of before is applied in the same way.
///
/// Owner: the user, as a value that stays where it is; gone before the system. `next` must outlive it. Meanwhile no
/// part may be added to the system or removed from it, and no other plan applied. When it goes before its last step,
/// what it has done so far stays.
class StepwiseChange {
 public:
  /// Compares the plans, and changes nothing. ConfigError: the plan has mistakes.
  StepwiseChange(System& system, const SystemPlan& next);
  ~StepwiseChange();
  StepwiseChange(const StepwiseChange&) = delete;
  StepwiseChange& operator=(const StepwiseChange&) = delete;

  /// What becomes of each part. When any is refused, do not begin.
  const PlanChange& changes() const noexcept;
  /// The names of the tiers that have to turn for it: one that hangs refuses it.
  std::set<std::string> tiers() const;
  /// Goes on until `budget` has passed by the loop's clock, with a single part if that is at once; returns whether
  /// there is more to do. Throws as System::apply, in the last step; then there is no more to do. With an endless
  /// budget from the first step on it waits for devices itself.
  bool step(Duration budget);
  /// A device is slow: the next step does nothing until the loops have turned. Call it again in some milliseconds.
  bool is_waiting() const noexcept;
  /// All parts of the plan are there, but for those that the error names.
  bool is_applied() const noexcept;

 private:
  std::unique_ptr<config_detail::PlanApplication> application_;
};

}  // namespace rtdata
