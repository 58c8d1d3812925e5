// Another plan takes the place of the one that a system was made of. Private to src/config.
#pragma once

#include <exception>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "config/plan/change.hpp"
#include "loop/runtime/configurations.hpp"

namespace rtdata::config_detail {

/// Of making a part, with where its item is.
Error error_at(const PartPlan& plan, Error error);

/// Does what was compared, or undoes what it has done, in steps of which each leaves a system that can run: adds what
/// can be there beside the parts of before; gives back the devices of those that end; in one step closes, makes and
/// changes what replaces something; waits for the devices of what is made; then closes what can wait for it. On the
/// main loop's thread.
class PlanApplication {
 public:
  /// Compares. `next` must outlive it.
  PlanApplication(System& system, const SystemPlan& next, std::set<std::string> given_up);

  const PlanChange& changes() const noexcept { return all_; }
  /// The names of the tiers that have to turn for it.
  std::set<std::string> tiers() const;
  /// Goes on for so long, or with one part; returns whether there is more to do. SetupError: what is refused, and
  /// nothing was changed; what making or changing a part threw, when the parts are those of before again.
  bool step(Duration budget);
  bool is_applied() const noexcept { return is_applied_; }
  /// The next step does nothing until the loops have turned, since a device is slow.
  bool is_waiting() const noexcept { return is_waiting_; }

 private:
  enum class Stage { beginning, adding, releasing, replacing, taking, finishing, undoing, done };

  void refuse() const;
  /// Each tier that the change needs turns.
  void refuse_hanging() const;
  void refuse_held() const;
  /// Which parts are added before, and closed after, the step that replaces.
  void sort_out();
  void begin();
  /// Recordings keep the text of the next plan from here on.
  void take_text();
  void add_one();
  /// Of parts that end, what closing them would wait for.
  void release();
  void replace();
  /// What is made has its devices.
  void take();
  void finish_one();
  void undo_one();

  /// The parts of before that end now: what stores, then the others, of each the last one made first.
  void close();
  /// While there are those before: they say what those that follow take over. A sensor that is stopped stays so.
  void keep_what_is_taken_over();
  /// A part of the next plan that is made stores into this file.
  bool is_made_with(const std::string& path) const;
  /// Of a sink that needs a loop that turns to get rid of what it has queued, or that is not waited for.
  void finish(std::unique_ptr<Parts::Part> part);
  void remove_last_made();
  void make();
  /// By `make` if it is not empty.
  void make_part(const PartPlan& plan, PartPlan::Make make);
  void change_live();
  /// The parts stand in the order of the next plan from here on, before those that are closed later.
  void settle();
  /// Reports for how long a sensor that is made again was none.
  void report_absence(const PartPlan& plan);
  /// Keeps what was thrown, to throw it when all is undone; brings back what was closed.
  void fail(std::exception_ptr why);
  /// Returns what could not be made again, for people.
  std::string bring_back();

  System& system_;
  const SystemPlan& next_;
  const std::set<std::string> given_up_;  // sinks
  ComparedPlans compared_;
  const PlanChange all_;
  Stage stage_ = Stage::beginning;
  bool is_applied_ = false;
  bool may_wait_ = false;  // the loop turns between two steps
  bool is_waiting_ = false;
  bool closes_nothing_ = false;
  std::vector<PlannedChange*> ahead_;                      // what is added before anything is closed
  std::vector<const PartPlan*> later_;                     // what is closed after all is made
  std::size_t place_ = 0;                                  // in the list of this stage
  bool is_new_text_ = false;                               // the text of the next plan is not that of before
  std::unique_ptr<detail::Configurations::State> before_;  // while the text of the next plan is there
  std::map<std::string, MonotonicTime> closed_at_;         // by object
  std::map<std::string, PartPlan::Make> again_;            // those that are made anew, by object
  std::map<std::string, PartPlan::Make> back_;             // those that are closed, should they have to be made again
  std::set<std::string> stopped_;                          // sensors that somebody has stopped, by object
  std::vector<PartPlan> closed_;                           // in the order in which they were made
  std::vector<const Parts::Part*> ending_;                 // recordings that are closed while the loop turns
  std::vector<std::pair<std::string, std::string>> made_;  // kind and name
  std::vector<const PartPlan*> released_;                  // as far as they are not closed
  std::shared_ptr<std::size_t> releasing_;                 // how many of these are not ready; null: none was begun
  struct Taking {
    std::size_t left = 0;  // parts whose devices are being taken
    std::optional<Error> failed = {};
  };
  std::shared_ptr<Taking> taking_ = std::make_shared<Taking>();
  std::size_t made_ahead_ = 0;  // of these, from the first one
  using Live = std::function<void(const PartObject& part)>;
  std::vector<std::pair<Parts::Part*, const Live*>> changed_;  // with what changes it back
  std::exception_ptr failure_;
};

}  // namespace rtdata::config_detail
