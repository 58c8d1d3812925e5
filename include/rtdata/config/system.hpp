/// System: the parts that a configuration file names (tiers, buses, sinks, sensors), made and running on a loop.
///
///     rtdata::Registry registry = rtdata::standard_registry();   // which types there are
///     rtdata::SystemPlan plan = rtdata::plan_system(registry, rtdata::load_config("bench.json"));
///     if (!plan.good()) { std::cerr << plan.report(); return 2; }
///     rtdata::Runtime runtime(plan.runtime_config());
///     rtdata::Loop loop(runtime, plan.loop_config());
///     rtdata::System system(loop, registry, plan);
///     system.sensor("chamber").set_rate(50_Hz);
///     system.add_sensor(item);
///     system.remove_sensor("chamber");
///     system.apply(rtdata::plan_system(registry, rtdata::load_config("bench.json")));  // what has changed in the file
///     loop.run_for(10s);
///
/// Making a plan touches no device. It finds every mistake of the whole file: mistakes in single items, names that are
/// used twice or missing, different payloads on one topic, and files written twice. The check also works on another
/// machine than the one that runs the system. Relative paths are relative to the working directory.
///
/// Keys of the file: $schema, name, notes, log, control, page, loop, tiers, and those of the registry's kinds of parts:
/// buses, sinks, sensors. docs/errors.md explains the ids of problems and warnings.
///
/// Owner: the user; plan and registry as values, the registry must outlive a system made with it.
/// Thread: plans any, systems the loop's.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/config/format.hpp"
#include "rtdata/config/page.hpp"
#include "rtdata/config/registry.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/tier.hpp"

namespace rtdata {

/// Where log lines go.
struct LogSettings {
  std::string file = {};            ///< empty: the program's default
  LogLevel level = LogLevel::info;  ///< less important lines are omitted
  /// At this size the file is renamed to FILE.1, the old FILE.1 to FILE.2, and so on; 0: never.
  std::uint64_t max_bytes = std::uint64_t{10} << 20;
  unsigned keep = 5;                 ///< how many old files are kept
  std::string permissions = "0640";  ///< of a new file, minus the umask; an existing file keeps its own

  friend constexpr auto parameters(type_tag<LogSettings>) {
    return parameter_list(
        parameter("file", &LogSettings::file,
                  "the log file; default: the configuration file's name with .log, in the working directory",
                  TextIs::device),
        parameter("level", &LogSettings::level, "the least important lines that are written",
                  choices(value("debug", LogLevel::debug), value("info", LogLevel::info),
                          value("warning", LogLevel::warning), value("error", LogLevel::error))),
        parameter("max_bytes", &LogSettings::max_bytes,
                  "largest size: then it is renamed to FILE.1, and a new file begins; 0: no limit, else at least 4096",
                  unit("By")),
        parameter("keep", &LogSettings::keep, "how many earlier files are kept", range(1, 1000)),
        parameter("permissions", &LogSettings::permissions,
                  "permissions of a new file, in octal digits, minus the umask", TextIs::permissions));
  }
  friend void check_config(const LogSettings& settings, const ConfigItem& item, Problems& problems);
};

/// The settings of the control socket, key `control` (`rtdata top`, `rtdata ctl`, `rtdata tail`).
struct ControlSettings {
  unsigned readers = 32;  ///< most readers of events at a time; 0: none

  friend constexpr auto parameters(type_tag<ControlSettings>) {
    return parameter_list(parameter("readers", &ControlSettings::readers,
                                    "how many programs may read events at a time, such as `rtdata tail`; 0: none",
                                    range(0, 1000)));
  }
};

/// The settings of the main loop, key `loop`.
constexpr auto parameters(type_tag<Loop::Config>) {
  using namespace std::chrono_literals;
  return parameter_list(
      parameter("hold_limit", &Loop::Config::hold_limit, "a callback that takes longer is reported by its name",
                range(10us, 1h)),
      parameter("delivery_budget", &Loop::Config::delivery_budget,
                "how long handlers run in a turn before due ticks are checked again", range(10us, 1s)),
      parameter("phase_grid", &Loop::Config::phase_grid,
                "schedules start on multiples of it, so that they share wake-ups; 0 s: none", range(0s, 1s)));
}

/// The settings of a tier, key `tiers`.
struct TierSettings : Tier::Config {
  std::optional<int> cpu = {};  ///< for `cpus`, when it is one

  friend constexpr auto parameters(type_tag<TierSettings>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("policy", &TierSettings::policy, "how the kernel schedules its thread",
                  choices(value("other", SchedulingPolicy::other), value("fifo", SchedulingPolicy::fifo),
                          value("rr", SchedulingPolicy::round_robin))),
        parameter("priority", &TierSettings::priority, "1 to 99 for the policies fifo and rr, else 0", range(0, 99)),
        parameter("cpu", &TierSettings::cpu, "the processor that it runs on; default: any", range(0, 1023)),
        parameter("cpus", &TierSettings::cpus, "the processors that it may run on, if more than one", range(0, 1023)),
        parameter("lock_memory", &TierSettings::lock_memory,
                  "with a real-time policy: keep all memory of the program resident",
                  only_with("policy", "fifo", "rr")),
        parameter("keep_cpu_awake", &TierSettings::keep_cpu_awake,
                  "keep all processors out of deep idle states while it runs: less lateness, more power"),
        parameter("spin", &TierSettings::spin,
                  "busy-wait this long before each deadline: exact, but uses a processor meanwhile", range(0s, 10ms)),
        parameter("hold_limit", &TierSettings::hold_limit, "a callback that takes longer is reported by its name",
                  range(10us, 1h)),
        parameter("delivery_budget", &TierSettings::delivery_budget,
                  "how long handlers run in a turn before due ticks are checked again", range(10us, 1s)),
        parameter("phase_grid", &TierSettings::phase_grid,
                  "schedules start on multiples of it, so that they share wake-ups; 0 s: none", range(0s, 1s)));
  }
  friend void check_config(const TierSettings& settings, const ConfigItem& item, Problems& problems);
  Tier::Config tier_config(const std::string& tier_name) const;
};

/// The top-level keys that are not lists of parts.
struct SystemSettings {
  std::string schema = {};
  std::string name = {};
  std::string notes = {};
  LogSettings log = {};
  ControlSettings control = {};
  std::optional<PageSettings> page = {};
  Loop::Config loop = {};
  std::map<std::string, TierSettings> tiers = {};

  friend constexpr auto parameters(type_tag<SystemSettings>) {
    return parameter_list(
        parameter("$schema", &SystemSettings::schema, "for editors: where the JSON Schema is (rtdata types --schema)",
                  TextIs::recorded),
        parameter("name", &SystemSettings::name, "name of the set-up, kept in recordings; default: the file's name",
                  TextIs::name),
        parameter("notes", &SystemSettings::notes, "anything worth knowing, kept in recordings", TextIs::recorded),
        parameter("log", &SystemSettings::log, "the log file"),
        parameter("control", &SystemSettings::control, "what other programs may ask the running program"),
        parameter("page", &SystemSettings::page, "the live page, for browsers"),
        parameter("loop", &SystemSettings::loop, "settings of the loop"),
        parameter("tiers", &SystemSettings::tiers,
                  "loops on threads of their own, by name; sensors name theirs as `tier`"));
  }
};

struct PlanChange;  // config/change.hpp

namespace config_detail {
class Neighbours;
class PlanApplication;
struct ComparedPlans;
}  // namespace config_detail

/// The checked content of a configuration. A System needs a plan without problems.
struct SystemPlan {
  ConfigDocument document;
  SystemSettings settings;
  std::vector<PartPlan> parts;       ///< those without mistakes of their own; each after the parts that it uses
  Problems problems;                 ///< in the order of the file
  Problems warnings;                 ///< the system runs, but perhaps not as intended
  std::vector<std::string> secrets;  ///< resolved secrets (read.hpp); never shown

  bool good() const noexcept { return problems.empty(); }
  /// "sensor", "sink", "bus" or "tier", in the order in which they are made. Valid as long as `parts` is not changed.
  std::vector<const PartPlan*> of_kind(std::string_view kind) const;
  /// Replaces resolved secrets in the texts of problems and warnings.
  void hide_secrets();
  /// Every problem with its line of the file, as text for users.
  std::string report() const;
  /// How long the sensors of each loop may hold it (LoopLoad): the main loop, then the tiers; loops without sensors are
  /// left out. `warnings` names each overloaded loop or lane.
  std::vector<LoopLoad> loads() const;
  /// The settings for the Runtime and the Loop of this system.
  Runtime::Config runtime_config() const;
  Loop::Config loop_config() const { return settings.loop; }
};

/// Checks the whole document. Never throws for what is in it: see `problems`.
SystemPlan plan_system(const Registry& registry, ConfigDocument document);

class System {
 public:
  /// Makes all parts in the order of the plan: tiers, buses, sinks on `loop`, then sensors, which start unless
  /// configured not to. A part is made after the parts that it uses. Throws ConfigError with every problem of the plan,
  /// before anything is made. If a part throws, throws SetupError with the place in the file, and nothing of the system
  /// is left on the loop.
  System(Loop& loop, const Registry& registry, const SystemPlan& plan);
  /// Uses the program's own loop; its settings do not change.
  System(Loop& loop, const Registry& registry, const ConfigDocument& document);
  /// Closes all parts, the last one made first.
  ~System();
  System(const System&) = delete;
  System& operator=(const System&) = delete;

  /// A sensor, to start, stop or change. Valid until it is removed. SetupError (not-found), with the nearest name.
  AnySensor& sensor(std::string_view name) { return parts_.get<AnySensor>("sensor", name); }
  Sink& sink(std::string_view name) { return parts_.get<Sink>("sink", name); }
  Tier& tier(std::string_view name) { return parts_.get<Tier>("tier", name); }
  const Parts& parts() const noexcept { return parts_; }
  /// In the order they were made.
  std::vector<std::string> sensor_names() const { return parts_.names("sensor"); }
  std::vector<std::string> sink_names() const { return parts_.names("sink"); }

  /// Makes one more part of any kind, from an item as in the file (`parse_config(text).or_throw()`), and returns its
  /// name. `name`: of a kind that is written by name, such as a bus. It is checked as if it were in the file, also
  /// against the existing parts (names, payloads of topics, files): throws ConfigError with every mistake, or the
  /// SetupError of its factory; then the system is unchanged. Recordings store the item and the time.
  std::string add(std::string_view kind, const ConfigItem& item, const std::string& name = {});
  AnySensor& add_sensor(const ConfigItem& item) { return sensor(add("sensor", item)); }
  Sink& add_sink(const ConfigItem& item) { return sink(add("sink", item)); }
  void add_bus(const std::string& name, const ConfigItem& item) { add("bus", item, name); }
  /// Removes a part. Afterwards it publishes no more events; a sink first stores its queue. SetupError: not-found; busy
  /// (another part uses it). Recordings store the time.
  void remove(std::string_view kind, std::string_view name);
  void remove_sensor(std::string_view name) { remove("sensor", name); }
  void remove_sink(std::string_view name) { remove("sink", name); }
  void remove_bus(std::string_view name) { remove("bus", name); }

  /// What `apply` would do to each part, including parts added with `add`.
  PlanChange change_to(const SystemPlan& next) const;
  /// Applies the plan in this turn of the loop: closes, makes and changes parts, in the order of StepwiseChange
  /// (config/change.hpp), which lets the loop turn in between. Unchanged parts continue; handles of closed parts are
  /// invalid. A closed sink stores its queue afterwards, while the loop turns, within its `close_deadline`; a new sink
  /// on the same file waits for that. Recordings store the text and the time.
  ///
  /// Throws before any change: ConfigError (the plan has mistakes), SetupError (busy: something is refused). If a part
  /// cannot be made, the old plan is applied again and the SetupError of the part is thrown; it also names outputs
  /// whose device cannot be opened (they begin as failed) and old parts that could not be made again (they are gone).
  /// SetupError (not-turning): the plan is applied, except the parts that a tier has not made within 1 s; the tier
  /// closes these when it turns again.
  PlanChange apply(const SystemPlan& next);
  /// Sets all outputs safe and releases their devices while the loops turn. Calls `done` in a later turn of this loop,
  /// when each output has finished or failed. Closing them then does not wait.
  void finish_outputs(Callback<void()> done);
  /// Queued events that sinks closed by `apply` could not send within their deadline.
  std::uint64_t lost_in_changes() const noexcept { return finishing_->lost; }
  /// Parts that `apply` or a StepwiseChange could not make: "sink far". Their lost work is counted nowhere, so they
  /// stay in this list even if a later change makes them.
  const std::set<std::string>& not_made() const noexcept { return not_made_; }

 private:
  friend class config_detail::PlanApplication;
  void make(std::unique_ptr<Parts::Part> part);
  PartObject make_on_tier(Loop& loop, const PartPlan& plan);
  /// Closes a part, but after any part that a tier still makes although it was given up, because that may use it.
  void close(std::unique_ptr<Parts::Part> part);
  config_detail::Neighbours& neighbours();
  config_detail::ComparedPlans compared_to(const SystemPlan& next) const;

  Loop& loop_;
  const Registry& registry_;
  std::string configuration_;  // the file; empty: none
  ConfigItem root_;
  LogSettings log_;
  std::unique_ptr<config_detail::Neighbours> neighbours_;  // places and names in use; null: rebuild
  Parts parts_;
  struct GivenUp {
    std::weak_ptr<int> making;  // expired: it has ended
    std::vector<PartUse> uses;
    std::vector<std::unique_ptr<Parts::Part>> used;  // to close afterwards
  };
  std::vector<GivenUp> given_up_;
  struct Finishing {
    std::vector<std::unique_ptr<Parts::Part>> sinks;  // sinks that still store their queue
    std::uint64_t lost = 0;
  };
  std::shared_ptr<Finishing> finishing_ = std::make_shared<Finishing>();
  std::set<std::string> not_made_;
};

}  // namespace rtdata
