/// System: the parts that a configuration file names (tiers, buses, sinks, sensors), made and running on a loop.
///
///     Registry registry = ...;                                // which types there are
///     SystemPlan plan = plan_system(registry, load_config("bench.json"));
///     if (!plan.good()) { std::cerr << plan.report(); return 2; }
///     Runtime runtime(plan.runtime_config());
///     Loop loop(runtime, plan.loop_config());
///     System system(loop, registry, plan);
///     system.sensor("chamber").set_rate(50_Hz);
///     system.add_sensor(item);
///     system.remove_sensor("chamber");
///     system.apply(plan_system(registry, load_config("bench.json")));   // what has changed in the file
///     loop.run_for(10s);
///
/// A plan is made without touching a device: it finds every mistake of the whole file, those of single items as well as
/// names used twice or not there, payloads that meet on one topic, and files written twice. It can be checked on
/// another machine than the one that runs it. Relative paths are relative to the working directory.
///
/// Keys of the file: $schema, name, notes, log, control, loop, tiers, and those of the registry's kinds of parts:
/// buses, sinks, sensors. Ids of problems, beside those of problem.hpp: bad-name, cannot-record, cannot-resolve,
/// cannot-write, description-differs, duplicate-name, duplicate-path, not-recorded, unknown-bus, unknown-sensor,
/// unknown-sink, unknown-tier, unknown-topic, uses-itself, wrong-part; of warnings: in-memory, late-readings,
/// loses-data, matches-nothing, no-effect, no-sensors, no-sinks, overloaded-lane, overloaded-loop, plain-secret,
/// sent-twice, unknown-placeholder, unknown-unit, unlikely-unit, unused-tier.
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
#include "rtdata/config/registry.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/tier.hpp"

namespace rtdata {

/// Where log lines go.
struct LogSettings {
  std::string file = {};            ///< empty: the program's default
  LogLevel level = LogLevel::info;  ///< lesser ones are left out
  /// Before it becomes larger it is renamed to FILE.1, what was that to FILE.2, and so on; 0: never.
  std::uint64_t max_bytes = std::uint64_t{10} << 20;
  unsigned keep = 5;                 ///< how many of those before are kept
  std::string permissions = "0640";  ///< of a file that is made, less the umask; one that is there keeps its own

  friend constexpr auto parameters(type_tag<LogSettings>) {
    return parameter_list(
        parameter("file", &LogSettings::file,
                  "the log file; default: the configuration file's name with .log, in the working directory",
                  TextIs::device),
        parameter("level", &LogSettings::level, "the least important lines that are written",
                  choices(value("debug", LogLevel::debug), value("info", LogLevel::info),
                          value("warning", LogLevel::warning), value("error", LogLevel::error))),
        parameter("max_bytes", &LogSettings::max_bytes,
                  "a new file before this one becomes larger, which is renamed to FILE.1; 0: never, else 4096 at least",
                  unit("By")),
        parameter("keep", &LogSettings::keep, "how many of the files before are kept", range(1, 1000)),
        parameter("permissions", &LogSettings::permissions,
                  "who may read and write a file that is made, in octal digits, less the umask", TextIs::permissions));
  }
  friend void check_config(const LogSettings& settings, const ConfigItem& item, Problems& problems);
};

/// What others may ask of a running program (`rtdata top`, `rtdata ctl`, `rtdata tail`).
struct ControlSettings {
  unsigned readers = 32;  ///< of events, at a time; 0: nobody reads them

  friend constexpr auto parameters(type_tag<ControlSettings>) {
    return parameter_list(parameter("readers", &ControlSettings::readers,
                                    "how many may read events at a time, such as `rtdata tail`; 0: none",
                                    range(0, 1000)));
  }
};

/// What a file says of the main loop, in `loop`.
constexpr auto parameters(type_tag<Loop::Config>) {
  using namespace std::chrono_literals;
  return parameter_list(
      parameter("hold_limit", &Loop::Config::hold_limit, "a callback that takes longer is reported by its name",
                range(10us, 1h)),
      parameter("delivery_budget", &Loop::Config::delivery_budget,
                "time of handlers in a turn before ticks are looked at again", range(10us, 1s)),
      parameter("phase_grid", &Loop::Config::phase_grid,
                "schedules start on multiples of it, so that they share wake-ups; 0 s: none", range(0s, 1s)));
}

/// What a file says of a tier, in `tiers`.
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
                  "no deep idle of any processor while it runs: less lateness, more power"),
        parameter("spin", &TierSettings::spin,
                  "wait the last stretch before a deadline spinning: exact, and costs that share of a processor",
                  range(0s, 10ms)),
        parameter("hold_limit", &TierSettings::hold_limit, "a callback that takes longer is reported by its name",
                  range(10us, 1h)),
        parameter("delivery_budget", &TierSettings::delivery_budget,
                  "time of handlers in a turn before ticks are looked at again", range(10us, 1s)),
        parameter("phase_grid", &TierSettings::phase_grid,
                  "schedules start on multiples of it, so that they share wake-ups; 0 s: none", range(0s, 1s)));
  }
  friend void check_config(const TierSettings& settings, const ConfigItem& item, Problems& problems);
  Tier::Config tier_config(const std::string& tier_name) const;
};

/// The file's keys that list no parts with types.
struct SystemSettings {
  std::string schema = {};
  std::string name = {};
  std::string notes = {};
  LogSettings log = {};
  ControlSettings control = {};
  Loop::Config loop = {};
  std::map<std::string, TierSettings> tiers = {};

  friend constexpr auto parameters(type_tag<SystemSettings>) {
    return parameter_list(
        parameter("$schema", &SystemSettings::schema, "for editors: where the JSON Schema is (rtdata types --schema)",
                  TextIs::recorded),
        parameter("name", &SystemSettings::name, "of the set-up, kept in recordings; default: the file's name",
                  TextIs::name),
        parameter("notes", &SystemSettings::notes, "anything worth knowing, kept in recordings", TextIs::recorded),
        parameter("log", &SystemSettings::log, "the log file"),
        parameter("control", &SystemSettings::control, "what others may ask of the running program"),
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

/// Everything that a configuration says, checked. Only one without problems can be made into a System.
struct SystemPlan {
  ConfigDocument document;
  SystemSettings settings;
  std::vector<PartPlan> parts;       ///< without mistakes of their own; each after those that it uses
  Problems problems;                 ///< in the order of the file
  Problems warnings;                 ///< the system runs, but perhaps not as it was meant
  std::vector<std::string> secrets;  ///< that were resolved (read.hpp): to be shown nowhere

  bool good() const noexcept { return problems.empty(); }
  /// "sensor", "sink", "bus" or "tier", in the order in which they are made. Valid as long as `parts` is not changed.
  std::vector<const PartPlan*> of_kind(std::string_view kind) const;
  /// Replaces what was resolved in the texts of problems and warnings.
  void hide_secrets();
  /// Every problem with its line of the file, for people.
  std::string report() const;
  /// How long the sensors of each loop may hold it (LoopLoad): the main loop, then the tiers; those without sensors are
  /// left out. One that is overloaded, or has an overloaded lane, is among the warnings.
  std::vector<LoopLoad> loads() const;
  /// What the Runtime and the Loop of this system are to be made of.
  Runtime::Config runtime_config() const;
  Loop::Config loop_config() const { return settings.loop; }
};

/// Checks the whole document. Never throws for what is in it: see `problems`.
SystemPlan plan_system(const Registry& registry, ConfigDocument document);

class System {
 public:
  /// Makes all parts in the order of the plan: tiers, buses, sinks on `loop`, then sensors, which start unless they are
  /// configured not to; a part that another uses before that one. Throws ConfigError with every problem of the plan
  /// before anything is made; SetupError, with the place in the file, what a part threw: then nothing of the system is
  /// left on the loop.
  System(Loop& loop, const Registry& registry, const SystemPlan& plan);
  /// On a loop of the program's own, whose settings stay as they are.
  System(Loop& loop, const Registry& registry, const ConfigDocument& document);
  /// Closes all parts, the last one made first.
  ~System();
  System(const System&) = delete;
  System& operator=(const System&) = delete;

  /// To start, stop or change while it runs. Valid until it is removed. SetupError (not-found) with the nearest name.
  AnySensor& sensor(std::string_view name) { return parts_.get<AnySensor>("sensor", name); }
  Sink& sink(std::string_view name) { return parts_.get<Sink>("sink", name); }
  Tier& tier(std::string_view name) { return parts_.get<Tier>("tier", name); }
  const Parts& parts() const noexcept { return parts_; }
  /// In the order they were made.
  std::vector<std::string> sensor_names() const { return parts_.names("sensor"); }
  std::vector<std::string> sink_names() const { return parts_.names("sink"); }

  /// Makes one more part of any kind, from an item as in the file (`parse_config(text).or_throw()`), and returns its
  /// name. `name`: of a kind that is written by name, such as a bus. It is checked as if it stood in the file: throws
  /// ConfigError with every mistake of it and with the parts that are there (names, payloads of topics, files), or
  /// SetupError, what making it threw; then the system is as it was. Recordings keep the item and the time.
  std::string add(std::string_view kind, const ConfigItem& item, const std::string& name = {});
  AnySensor& add_sensor(const ConfigItem& item) { return sensor(add("sensor", item)); }
  Sink& add_sink(const ConfigItem& item) { return sink(add("sink", item)); }
  void add_bus(const std::string& name, const ConfigItem& item) { add("bus", item, name); }
  /// Afterwards not one more event of it appears; a sink stores what is queued first. SetupError (not-found); (busy):
  /// another part uses it. Recordings keep the time.
  void remove(std::string_view kind, std::string_view name);
  void remove_sensor(std::string_view name) { remove("sensor", name); }
  void remove_sink(std::string_view name) { remove("sink", name); }
  void remove_bus(std::string_view name) { remove("bus", name); }

  /// What `apply` would do to each part. Those that were added are parts of this system as all others.
  PlanChange change_to(const SystemPlan& next) const;
  /// Makes the system what the plan says, in this turn of the loop: closes, makes and changes live what can be so, in
  /// the order of StepwiseChange (config/change.hpp), which lets the loop turn. What is unchanged goes on; handles of
  /// parts that were closed are not valid any more. A sink that is closed stores what it has queued afterwards, while
  /// the loop turns, for its `close_deadline`; one that is made on its file waits for that. Recordings keep the text
  /// and the time.
  ///
  /// Throws before anything is changed: ConfigError, the plan has mistakes; SetupError (busy), something is refused.
  /// SetupError, what making a part threw: then the plan of before is applied again; an output of it whose device
  /// cannot be opened begins as failed, and what cannot be made is gone: the error names both. SetupError
  /// (not-turning): the plan is applied, but for what a tier has not made within 1 s, which it closes when it turns
  /// again.
  PlanChange apply(const SystemPlan& next);
  /// Sets all outputs safe, and gives their devices back, while the loops turn; calls `done` in a later turn of this
  /// loop, when each has done so or has failed to. Then they are to be closed, which waits for nothing more.
  void finish_outputs(Callback<void()> done);
  /// Events that sinks had queued which `apply` closed, and could not send in their time.
  std::uint64_t lost_in_changes() const noexcept { return finishing_->lost; }
  /// Parts that `apply` or a StepwiseChange has not made, or not made again: "sink far". What they had to do meanwhile
  /// is counted nowhere, so that they stay among these though another change makes them.
  const std::set<std::string>& not_made() const noexcept { return not_made_; }

 private:
  friend class config_detail::PlanApplication;
  void make(std::unique_ptr<Parts::Part> part);
  PartObject make_on_tier(Loop& loop, const PartPlan& plan);
  /// What a tier still makes, though it was given up, may use it: then it is closed after that.
  void close(std::unique_ptr<Parts::Part> part);
  config_detail::Neighbours& neighbours();
  config_detail::ComparedPlans compared_to(const SystemPlan& next) const;

  Loop& loop_;
  const Registry& registry_;
  std::string configuration_;  // the file; empty: none
  ConfigItem root_;
  LogSettings log_;
  std::unique_ptr<config_detail::Neighbours> neighbours_;  // what the parts have taken; null: to be made anew
  Parts parts_;
  struct GivenUp {
    std::weak_ptr<int> making;  // expired: it has ended
    std::vector<PartUse> uses;
    std::vector<std::unique_ptr<Parts::Part>> used;  // to be closed then
  };
  std::vector<GivenUp> given_up_;
  struct Finishing {
    std::vector<std::unique_ptr<Parts::Part>> sinks;  // that send what they have queued
    std::uint64_t lost = 0;
  };
  std::shared_ptr<Finishing> finishing_ = std::make_shared<Finishing>();
  std::set<std::string> not_made_;
};

}  // namespace rtdata
