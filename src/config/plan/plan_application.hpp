// Another plan takes the place of the one that a system was made of. Private to src/config.
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

/// Of making a part, with where its item is.
Error error_at(const PartPlan& plan, Error error);

/// Does what was compared, a part at a time: closes what ends, the last one made first, then makes what is new, in the
/// order of the plan. When that fails, it does the same with the plan of before. On the main loop's thread.
class PlanApplication {
 public:
  /// Compares. `next` must outlive it.
  PlanApplication(System& system, const SystemPlan& next);
  /// Before its last step: what it has closed, and not made again, is missing.
  ~PlanApplication();

  const PlanChange& changes() const noexcept { return all_; }
  /// The names of the tiers that have to turn for it, before the first step.
  std::set<std::string> tiers() const;
  /// Goes on for so long, or with one part; returns whether there is more to do. SetupError: what is refused, and
  /// nothing was changed; what making or changing a part threw, in the last step; not-turning: what a tier has not
  /// made.
  bool step(Duration budget);
  bool is_applied() const noexcept { return is_applied_; }
  /// The next step does nothing until the loops have turned, since a device is slow.
  bool is_waiting() const noexcept { return is_waiting_; }

 private:
  enum class Stage { beginning, closing, making, taking, finishing, done };

  void refuse() const;
  /// Each tier that the change needs turns.
  void refuse_hanging() const;
  /// Also what has begun to hold since it was compared.
  void refuse_held(const PartPlan& part) const;
  void begin();
  /// Which parts are to be closed.
  void list_ending();
  void close_one();
  /// Keeps what the part in its place takes over. A sensor that is stopped stays so.
  void begin_to_close(const PlannedChange& planned);
  void close(const PartPlan& plan);
  /// Of a sink: it stores what it has queued while the loop turns.
  void finish(std::unique_ptr<Parts::Part> part);
  /// Recordings keep the text of the next plan from here on.
  void take_text();
  void make_one();
  void make(const PartPlan& plan);
  /// Its ticks since it was closed are missed, from its loop's thread.
  PartPlan::Make counting_absence(const PartPlan& plan, PartPlan::Make make);
  void change_live(const PlannedChange& planned);
  /// What is made has its devices.
  void take();
  /// The parts stand in the order of the next plan from here on.
  void settle();
  void finish_one();
  void end();
  /// The plan of before is applied instead.
  void go_back(std::exception_ptr why);
  /// For the error, and for System::not_made: what is not as the plan says.
  void note_missing(const std::string& object, const std::string& why);

  System& system_;
  const SystemPlan* next_;
  ComparedPlans compared_;
  const PlanChange all_;
  Stage stage_ = Stage::beginning;
  bool is_applied_ = false;
  bool may_wait_ = false;  // the loop turns between two steps
  bool is_waiting_ = false;
  std::optional<detail::Exchange::Standstill> switching_;  // a sink is closed, and not all are made
  std::size_t place_ = 0;                                  // in the list of this stage
  std::vector<const PlannedChange*> ending_;               // the last one made first
  std::vector<const PartPlan*> released_;                  // of these, what is given its time to end
  std::shared_ptr<std::size_t> releasing_;                 // how many of these are not ready
  const PartPlan* last_sink_ = nullptr;                    // that is made
  std::vector<const PartPlan*> order_;                     // of before
  std::unordered_map<const PartPlan*, PartPlan> changed_;  // of these, those that are not there any more
  std::unique_ptr<detail::Configurations::State> before_;  // while the text of the next plan is there
  std::map<std::string, PartPlan::Make> again_;            // those that are made anew, by object
  std::map<std::string, PartPlan::Make> back_;             // those that are closed, should they have to be made again
  std::set<std::string> stopped_;                          // sensors that somebody has stopped, by object
  struct Away {
    MonotonicTime since{};
    Duration period{0};  // 0: it has no schedule
  };
  std::map<std::string, Away> away_;  // sensors that were running, by object
  struct Taking {
    std::size_t left = 0;  // parts whose devices are being taken
    std::optional<Error> failed = {};
  };
  std::shared_ptr<Taking> taking_ = std::make_shared<Taking>();
  std::optional<SystemPlan> old_;                             // it goes back to
  std::exception_ptr failure_;                                // for which it does
  std::vector<std::pair<std::string, std::string>> missing_;  // what is not as the plan says, and why
};

}  // namespace rtdata::config_detail
