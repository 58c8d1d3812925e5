// Another plan takes the place of the one that a system was made of. Private to src/config.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "config/plan/change.hpp"

namespace rtdata::config_detail {

/// Does what was compared, in one call on the main loop's thread, or undoes what it has done.
class PlanApplication {
 public:
  PlanApplication(System& system, const SystemPlan& next, const ComparedPlans& changes)
      : system_(system), next_(next), changes_(changes) {}

  /// SetupError: what making or changing a part threw; then the parts are those of before.
  void run();

 private:
  /// Those that end: what stores, then the others, of each the last one made first.
  void close();
  /// While there are those before: they say what those that follow take over.
  void keep_what_is_taken_over();
  /// Of a sink that sends over a network, which needs a loop that turns.
  void finish(std::unique_ptr<Parts::Part> part);
  void make();
  /// By `make` if it is not empty.
  void make_part(const PartPlan& plan, PartPlan::Make make);
  void change_live();
  /// The plans of all others are those of the next one from here on.
  void settle();
  /// Reports for how long a sensor that is made again was none.
  void report_absence(const PartPlan& plan);
  /// Adds to the advice of the error what could not be made again.
  void undo(Error& error);

  System& system_;
  const SystemPlan& next_;
  const ComparedPlans& changes_;
  std::map<std::string, MonotonicTime> closed_at_;         // by object
  std::map<std::string, PartPlan::Make> again_;            // those that are made anew, by object
  std::map<std::string, PartPlan::Make> back_;             // those that are closed, should they have to be made again
  std::vector<PartPlan> closed_;                           // in the order in which they were made
  std::vector<std::pair<std::string, std::string>> made_;  // kind and name
  using Live = std::function<void(const PartObject& part)>;
  std::vector<std::pair<Parts::Part*, const Live*>> changed_;  // with what changes it back
};

}  // namespace rtdata::config_detail
