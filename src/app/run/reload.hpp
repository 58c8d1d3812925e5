// The configuration of a run is read again, and applied while the run goes on.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/control/commands.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/run/console.hpp"
#include "rtdata/config/change.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::app {

/// Why a system that was started without outputs gets none.
inline constexpr std::string_view no_guard = "the guard of outputs is started with the program: start it again";

/// Thread: the loop's, unless said otherwise. Gone before the system.
class Reload {
 public:
  struct Run {
    std::function<bool()> is_ending;
    std::function<void(const SystemPlan& next)> applied;
    bool has_guard = false;  ///< the process that sets outputs safe, which is started with the program
  };
  struct NextPlan {
    SystemPlan plan;
    std::string failed = {};   ///< empty: there is a plan, perhaps with mistakes
    std::uint64_t number = 0;  ///< later readings have larger ones
  };
  using Told = std::function<void(const CommandOutcome&)>;

  Reload(Loop& loop, System& system, const Registry& registry, const RunOptions& options, RunConsole& console, Run run)
      : loop_(loop),
        system_(system),
        registry_(registry),
        options_(options),
        console_(console),
        run_(std::move(run)),
        lane_(loop.core(), "reload", std::chrono::seconds{1}) {}

  static constexpr Duration opening_patience = std::chrono::milliseconds{500};  // who asked waits for it, too
  /// Reads and checks the file again. Any thread but the loop's: so nothing waits for it.
  std::shared_ptr<const NextPlan> read_again() const;
  /// `why`: what asked for it, for messages. A recording that the change closes stores first what it has, while the
  /// loop turns; one that cannot, as on a full disk, would lose it: then nothing is changed.
  /// One whose disk does not answer is left instead, if nothing writes its file afterwards.
  /// One that comes while another is applied waits for it; of several that wait, the last one is applied.
  void apply(std::shared_ptr<const NextPlan> read, const std::string& why, Told told);
  /// Events of sinks that were closed before they could store them.
  std::uint64_t not_stored() const noexcept { return system_.lost_in_changes(); }
  /// The run is over: what is under way stays as it is. Returns the parts that a change has not made, or not again.
  const std::set<std::string>& end();

 private:
  /// One that is under way.
  struct Change {
    std::shared_ptr<const NextPlan> read;
    std::string why;
    Told told;
    std::unique_ptr<StepwiseChange> steps = {};
    bool is_waiting = false;
    bool is_looking = false;                  // whether files that it begins can be written
    std::vector<std::string> obstacles = {};  // to that, a line each
    // Sinks that store what they have, and "tier fast" until that turns; then sinks that open their files.
    std::set<std::string> waits_for = {};
    Timer patience = {};
    std::vector<std::string> left = {};  // recordings that it closes for good, a line each
    std::size_t told_parts = 0;          // of those that are changed, for the log
    std::string details = {};            // what is said of it, a line each
    std::string missing = {};            // what could not be made, though it is applied
  };
  using Weak = std::weak_ptr<Change>;
  void conclude(Change& change, LogLevel level, const std::string& text, std::string_view id = {});
  void refuse(Change& change, const std::string& text);
  void add(Change& change, LogLevel level, const std::string& text, std::string_view id = {});
  /// False: it is refused, and concluded.
  bool may_be_applied(Change& change);
  /// That it closes.
  std::vector<const PartPlan*> closing_sinks(const Change& change) const;
  /// Of a sink that does not store what it has: nobody can mend that, such as a full disk, and none gets its file.
  bool may_be_left(const Change& change, const PartPlan& sink) const;
  void begin(const std::shared_ptr<Change>& change);
  /// Whether the files that it begins can be written: asked on the lane, while closing sinks store what they have.
  void look_at_new_files(const std::shared_ptr<Change>& change);
  /// Whether the tiers turn that it needs.
  void ask_tiers(const std::shared_ptr<Change>& change);
  /// What waits, in a turn of its own.
  void begin_next();
  /// What comes next, in a turn of its own. Not when this change is concluded.
  void then(const Weak& change, void (Reload::*step)(const std::shared_ptr<Change>&));
  void stop_waiting(const std::shared_ptr<Change>& change);
  void go_on(const std::shared_ptr<Change>& change);
  void be_applied(const std::shared_ptr<Change>& change);
  /// Tells which sinks that it has made could not open their files.
  void tell_unopened(const std::shared_ptr<Change>& change);
  void tell_parts(const std::shared_ptr<Change>& change);

  struct NewFilesLook;

  Loop& loop_;
  System& system_;
  const Registry& registry_;
  const RunOptions& options_;
  RunConsole& console_;
  const Run run_;
  std::shared_ptr<Change> under_way_;                // null: none
  std::shared_ptr<Change> next_;                     // that waits for it
  mutable std::atomic<std::uint64_t> readings_ = 0;  // begun
  std::uint64_t newest_ = 0;                         // that was to be applied
  detail::Lane lane_;                                // that looks at files, on whatever disks they are
};

}  // namespace rtdata::app
