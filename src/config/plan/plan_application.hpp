// Applies a new plan to a system. Private to src/config.
#pragma once

#include <exception>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "config/plan/change.hpp"
#include "loop/runtime/configurations.hpp"
#include "loop/runtime/exchange.hpp"

namespace rtdata::config_detail {

/// The error of making a part, with the place of its item.
Error error_at(const PartPlan& plan, Error error);

/// Applies the compared changes, a part at a time: closes removed parts in reverse order of creation, then makes new
/// parts in the order of the plan. If that fails, applies the old plan in the same way. On the main loop's thread.
class PlanApplication {
 public:
  /// Compares. `next` must outlive it.
  PlanApplication(System& system, const SystemPlan& next);
  /// If it is destroyed before its last step, parts that are closed and not yet made again are missing.
  ~PlanApplication();

  const PlanChange& changes() const noexcept { return all_; }
  /// The names of the tiers that take part; call before the first step.
  std::set<std::string> tiers() const;
  /// Works for `budget`, on at least one part; returns true if there is more to do. SetupError: something is refused,
  /// and nothing was changed; or, in the last step, the error of a part; not-turning: parts that a tier has not made.
  bool step(Duration budget);
  bool is_applied() const noexcept { return is_applied_; }
  /// True while it waits for a slow device: the next step does nothing until the loops have turned.
  bool is_waiting() const noexcept { return is_waiting_; }

 private:
  enum class Stage { beginning, closing, making, taking, finishing, done };

  void refuse() const;
  /// Refuses the change if a needed tier does not turn.
  void refuse_hanging() const;
  /// Refuses the change if a part is held, also if this began after the comparison.
  void refuse_held(const PartPlan& part) const;
  void begin();
  /// Lists the parts to close.
  void list_ending();
  void close_one();
  /// Keeps the state for the part's successor. A stopped sensor stays stopped.
  void begin_to_close(const PlannedChange& planned);
  void close(const PartPlan& plan);
  /// Lets a sink store its queue while the loop turns.
  void finish(std::unique_ptr<Parts::Part> part);
  /// Recordings store the text of the next plan from here on.
  void take_text();
  void make_one();
  void make(const PartPlan& plan);
  /// Wraps `make` so that the ticks since closing count as missed, on its loop's thread.
  PartPlan::Make counting_absence(const PartPlan& plan, PartPlan::Make make);
  void change_live(const PlannedChange& planned);
  /// Ends a stage in which new parts have opened their devices.
  void take();
  /// Puts the parts in the order of the next plan.
  void settle();
  void finish_one();
  void end();
  /// Applies the old plan instead.
  void go_back(std::exception_ptr why);
  /// Notes a difference from the plan, for the error and for System::not_made.
  void note_missing(const std::string& object, const std::string& why);

  System& system_;
  const SystemPlan* next_;
  ComparedPlans compared_;
  const PlanChange all_;
  Stage stage_ = Stage::beginning;
  bool is_applied_ = false;
  bool may_wait_ = false;  // the loop turns between two steps
  bool is_waiting_ = false;
  std::optional<detail::Exchange::Standstill> switching_;  // set while a sink is closed and not all sinks are made
  std::size_t place_ = 0;                                  // in the list of this stage
  std::vector<const PlannedChange*> ending_;               // the last one made first
  std::vector<const PartPlan*> released_;                  // parts that need time to end
  std::shared_ptr<std::size_t> releasing_;                 // how many of these are not ready
  const PartPlan* last_sink_ = nullptr;                    // the last sink that is made
  std::vector<const PartPlan*> order_;                     // of before
  std::unordered_map<const PartPlan*, PartPlan> changed_;  // parts of the old plan that no longer exist
  std::unique_ptr<detail::Configurations::State> before_;  // the old text, while the next plan's text is set
  std::map<std::string, PartPlan::Make> again_;            // parts to restart, by object
  std::map<std::string, PartPlan::Make> back_;             // closed parts, in case they must be made again
  std::set<std::string> stopped_;                          // sensors that were stopped, by object
  struct Away {
    MonotonicTime since{};
    Duration period{0};  // 0: it has no schedule
  };
  std::map<std::string, Away> away_;  // sensors that were running, by object
  struct Taking {
    std::size_t left = 0;  // parts whose devices are still being opened
    std::optional<Error> failed = {};
  };
  std::shared_ptr<Taking> taking_ = std::make_shared<Taking>();
  std::optional<SystemPlan> old_;                             // the plan to go back to
  std::exception_ptr failure_;                                // the error that caused it
  std::vector<std::pair<std::string, std::string>> missing_;  // differences from the plan, with the reason
};

}  // namespace rtdata::config_detail
