// Reads the configuration of a run again and applies it while the run continues.
#pragma once

#include <cstdint>
#include <functional>
#include <future>
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

/// Why outputs cannot be added to a system that was started without outputs.
inline constexpr std::string_view
    no_guard = "the guard of outputs starts only with the program: start the program again";

/// Thread: the loop's, unless stated otherwise. Destroy it before the system.
class Reload {
 public:
  struct Run {
    std::function<bool()> is_ending;
    std::function<void(const SystemPlan& next)> applied;
    const Tares& tares;      ///< tares for the configuration that is read
    bool has_guard = false;  ///< the process that sets outputs safe was started with the program
  };
  struct NextPlan {
    SystemPlan plan;
    std::string failed = {};  ///< empty: there is a plan, perhaps with mistakes
  };
  using Told = std::function<void(const CommandOutcome&)>;

  Reload(Loop& loop, System& system, const Registry& registry, const RunOptions& options, RunConsole& console, Run run)
      : loop_(loop),
        system_(system),
        registry_(registry),
        options_(options),
        console_(console),
        run_(std::move(run)),
        reading_lane_(loop.core(), "configuration", reading_limit),
        lane_(loop.core(), "reload", std::chrono::seconds{1}) {}

  static constexpr Duration reading_limit = std::chrono::seconds{30};
  static constexpr Duration opening_patience = std::chrono::milliseconds{500};  // the client waits for it, too
  /// Reads and checks the file again on a lane, since its disk may hang, and applies it. `why`: the cause, for
  /// messages. A recording that the change closes first stores its queue, while the loop turns;
  /// if it cannot, for example on a full disk, nothing is changed, because the queue would be lost. If its disk does
  /// not answer, and nothing writes its file afterwards, it is left instead. A reload that comes while another is
  /// applied waits for it; of several waiting ones, the last is applied.
  void read_and_apply(const std::string& why, Told told);
  /// Events that closed sinks could not store.
  std::uint64_t not_stored() const noexcept { return system_.lost_in_changes(); }
  /// The run ends: a running change stops as it is. Returns the parts that changes could not make.
  const std::set<std::string>& end();
  /// The run is ending: answers those that wait for a reading.
  void give_up_reading();
  /// At the end: "reading rig.json" if a thread that was given up still reads, which uses this object; or empty.
  std::string hanging() const;

 private:
  struct RemovedSender {
    std::string name;
    std::string through;  ///< the recording that keeps what it has not sent
  };
  /// A reload in progress.
  struct Change {
    std::shared_ptr<const NextPlan> read;
    std::string why;
    Told told;
    std::unique_ptr<StepwiseChange> steps = {};
    bool is_waiting = false;
    bool is_looking = false;                  // the check of new files is running
    std::vector<std::string> obstacles = {};  // reasons against new files, a line each
    // Sinks that still store their queue, and "tier fast" until it turns; then sinks that open their files.
    std::set<std::string> waits_for = {};
    Timer patience = {};
    std::vector<std::string> left = {};  // events that wait in recordings and will not be sent, one line each
    std::vector<RemovedSender> removed_senders = {};
    std::size_t reported_parts = 0;  // number of changed parts already logged
    std::string details = {};        // its messages, a line each
    std::string missing = {};        // parts that could not be made, although it is applied
  };
  using Weak = std::weak_ptr<Change>;
  /// Any thread.
  void read(NextPlan& next) const;
  void apply(std::shared_ptr<const NextPlan> read, const std::string& why, Told told);
  void conclude(Change& change, LogLevel level, const std::string& text, std::string_view id = {});
  void refuse(Change& change, const std::string& text);
  void add(Change& change, LogLevel level, const std::string& text, std::string_view id = {});
  /// False: it is refused and finished.
  bool may_be_applied(Change& change);
  /// The sinks that the change closes.
  std::vector<const PartPlan*> closing_sinks(const Change& change) const;
  std::vector<RemovedSender> removed_senders(const Change& change) const;
  /// Reports events that wait in recordings for removed senders, as counted when these were closed: their files are not
  /// read, because a disk may hang.
  void report_removed_senders(Change& change);
  /// True if a sink that cannot store its queue may be left: nobody can repair its disk, and no other sink gets its
  /// file.
  bool may_be_left(const Change& change, const PartPlan& sink) const;
  void begin(const std::shared_ptr<Change>& change);
  /// Checks on the lane that new files can be written, while closing sinks store their queue.
  void look_at_new_files(const std::shared_ptr<Change>& change);
  /// Checks that the needed tiers turn.
  void ask_tiers(const std::shared_ptr<Change>& change);
  /// Begins the waiting reload, in a separate turn.
  void begin_next();
  /// Runs the next step in a separate turn, unless this change is finished.
  void then(const Weak& change, void (Reload::*step)(const std::shared_ptr<Change>&));
  void stop_waiting(const std::shared_ptr<Change>& change);
  void go_on(const std::shared_ptr<Change>& change);
  void finish_change(const std::shared_ptr<Change>& change);
  /// Reports new sinks that could not open their files.
  void report_unopened(const std::shared_ptr<Change>& change);
  void report_parts(const std::shared_ptr<Change>& change);

  struct NewFilesLook;
  struct Reading;

  Loop& loop_;
  System& system_;
  const Registry& registry_;
  const RunOptions& options_;
  RunConsole& console_;
  const Run run_;
  std::shared_ptr<Change> under_way_;     // null: no reload in progress
  std::shared_ptr<Change> next_;          // the waiting one
  int readings_ = 0;                      // in progress
  std::vector<std::future<void>> reads_;  // of threads that may use this object
  detail::Lane reading_lane_;
  detail::Lane lane_;  // checks files on all disks
};

}  // namespace rtdata::app
