/// System: the sensors and sinks that a configuration file names, made and running on a loop.
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
///     loop.run_for(10s);
///
/// A plan is made without touching a device: it finds every mistake of the whole file, those of single items as well as
/// names used twice, payloads that meet on one topic, and files written twice. It can be checked on another machine
/// than the one that runs it. Relative paths are relative to the working directory.
///
/// Keys of the file: $schema, name, notes, log, loop, tiers, sensors, sinks. Ids of problems, beside those of problem.hpp:
/// bad-name, cannot-record, cannot-resolve, cannot-write, description-differs, duplicate-name, duplicate-path, not-available, unknown-tier; of warnings:
/// late-readings, matches-nothing, no-effect, no-sensors, no-sinks, overloaded-lane, overloaded-loop, plain-secret,
/// unknown-placeholder, unknown-unit, unlikely-unit, unused-tier.
///
/// Owner: the user; plan and registry as values, the registry must outlive a system made with it.
/// Thread: plans any, systems the loop's.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/config/format.hpp"
#include "rtdata/config/parts.hpp"
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

/// See Loop::Config.
struct LoopSettings {
  Duration hold_limit = Loop::Config{}.hold_limit;
  Duration delivery_budget = Loop::Config{}.delivery_budget;
  Duration phase_grid = Loop::Config{}.phase_grid;

  friend constexpr auto parameters(type_tag<LoopSettings>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("hold_limit", &LoopSettings::hold_limit, "a callback that takes longer is reported by its name",
                  range(10us, 1h)),
        parameter("delivery_budget", &LoopSettings::delivery_budget,
                  "time of handlers in a turn before ticks are looked at again", range(10us, 1s)),
        parameter("phase_grid", &LoopSettings::phase_grid,
                  "schedules start on multiples of it, so that they share wake-ups; 0 s: none", range(0s, 1s)));
  }
};

/// See Tier::Config.
struct TierSettings {
  SchedulingPolicy policy = SchedulingPolicy::other;
  int priority = 0;
  std::optional<int> cpu = {};
  std::vector<int> cpus = {};
  bool lock_memory = Tier::Config{}.lock_memory;
  bool keep_cpu_awake = Tier::Config{}.keep_cpu_awake;
  Duration spin{0};
  Duration hold_limit = Loop::Config{}.hold_limit;
  Duration delivery_budget = Loop::Config{}.delivery_budget;
  Duration phase_grid = Loop::Config{}.phase_grid;

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
  Tier::Config tier_config(const std::string& name) const;
};

/// The file's keys that belong to no sensor or sink.
struct SystemSettings {
  std::string schema = {};
  std::string name = {};
  std::string notes = {};
  LogSettings log = {};
  LoopSettings loop = {};
  std::map<std::string, TierSettings> tiers = {};
  std::vector<ConfigItem> sensors = {};
  std::vector<ConfigItem> sinks = {};

  friend constexpr auto parameters(type_tag<SystemSettings>) {
    return parameter_list(
        parameter("$schema", &SystemSettings::schema, "for editors: where the JSON Schema is (rtdata types --schema)",
                  TextIs::recorded),
        parameter("name", &SystemSettings::name, "of the set-up, kept in recordings; default: the file's name",
                  TextIs::recorded),
        parameter("notes", &SystemSettings::notes, "anything worth knowing, kept in recordings", TextIs::recorded),
        parameter("log", &SystemSettings::log, "the log file"),
        parameter("loop", &SystemSettings::loop, "settings of the loop"),
        parameter("tiers", &SystemSettings::tiers,
                  "loops on threads of their own, by name; sensors name theirs as `tier`"),
        parameter("sensors", &SystemSettings::sensors, "what is read; each has a `type`"),
        parameter("sinks", &SystemSettings::sinks, "where it goes; each has a `type`"));
  }
};

/// Everything that a configuration says, checked. Only one without problems can be made into a System.
struct SystemPlan {
  ConfigDocument document;
  SystemSettings settings;
  std::vector<SensorPlan> sensors;
  std::vector<SinkPlan> sinks;
  Problems problems;                 ///< in the order of the file
  Problems warnings;                 ///< the system runs, but perhaps not as it was meant
  std::vector<std::string> secrets;  ///< that were resolved (secret.hpp): to be shown nowhere

  bool good() const noexcept { return problems.empty(); }
  /// Replaces what was resolved in the texts of problems and warnings.
  void hide_secrets();
  /// Every problem with its line of the file, for people.
  std::string report() const;
  /// How long the sensors of each loop may hold it (load.hpp): the main loop, then the tiers; those without sensors are
  /// left out. One that is overloaded, or has an overloaded lane, is among the warnings.
  std::vector<LoopLoad> loads() const;
  /// What the Runtime and the Loop of this system are to be made of.
  Runtime::Config runtime_config() const;
  Loop::Config loop_config() const;
};

/// Checks the whole document. Never throws for what is in it: see `problems`.
SystemPlan plan_system(const Registry& registry, ConfigDocument document);

class System {
 public:
  /// Makes all tiers, then all sinks, on `loop`, then all sensors, which start unless they are configured not to. Throws ConfigError with every
  /// problem of the plan before anything is made; SetupError, with the place in the file, what a sensor or sink threw:
  /// then nothing of the system is left on the loop.
  System(Loop& loop, const Registry& registry, const SystemPlan& plan);
  /// On a loop of the program's own, whose settings stay as they are.
  System(Loop& loop, const Registry& registry, const ConfigDocument& document);
  ~System();
  System(const System&) = delete;
  System& operator=(const System&) = delete;

  /// To start, stop or change while it runs. Valid until it is removed. SetupError (not-found) with the nearest name.
  AnySensor& sensor(std::string_view name);
  Sink& sink(std::string_view name);
  /// In the order they were made.
  std::vector<std::string> sensor_names() const;
  std::vector<std::string> sink_names() const;
  /// SetupError (not-found) with the nearest name.
  Tier& tier(std::string_view name);

  /// Makes one more, from an item as in the lists of the file. Throws ConfigError with every mistake, or SetupError
  /// (busy, description-differs: with the name or topic of another), and leaves the system as it was.
  AnySensor& add_sensor(const ConfigItem& item);
  Sink& add_sink(const ConfigItem& item);
  /// Afterwards not one more event of it appears; a sink stores what is queued first. SetupError (not-found).
  void remove_sensor(std::string_view name);
  void remove_sink(std::string_view name);

 private:
  template <class Base>
  struct Part {
    std::string name;
    Owned<Base> object;
  };
  void make_tiers(const SystemPlan& plan);
  AnySensor& make(const SensorPlan& plan);
  Sink& make(const SinkPlan& plan);

  Loop& loop_;
  const Registry& registry_;
  struct NamedTier {
    std::string name;
    std::unique_ptr<Tier> object;
  };
  std::vector<NamedTier> tiers_;
  std::vector<Part<Sink>> sinks_;
  std::vector<Part<AnySensor>> sensors_;  // gone before the sinks
};

}  // namespace rtdata
