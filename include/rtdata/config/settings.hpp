/// Settings: the keys of a configuration file that are no parts, and the settings of tiers.
///
/// Values; any thread.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>

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
        parameter("loop", &SystemSettings::loop, "settings of the loop"),
        parameter("tiers", &SystemSettings::tiers,
                  "loops on threads of their own, by name; sensors name theirs as `tier`"));
  }
};

}  // namespace rtdata
