#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <cstdint>
#include <optional>
#include <sstream>
#include <string_view>

#include "app/machine/doctor.hpp"
#include "loop/support/processors.hpp"

namespace rtdata::app {
namespace {

/// What the configuration asks of the kernel.
struct Needs {
  int priority = 0;  ///< the highest; 0: no real-time policy
  bool locked_memory = false;
  bool awake_processors = false;
};

Needs needs_of(const SystemPlan* plan) {
  Needs needs;
  if (plan == nullptr) return needs;
  for (const auto& [name, tier] : plan->settings.tiers) {
    if (tier.policy != SchedulingPolicy::other) {
      needs.priority = std::max(needs.priority, tier.priority);
      needs.locked_memory = needs.locked_memory || tier.lock_memory;
    }
    needs.awake_processors = needs.awake_processors || tier.keep_cpu_awake;
  }
  return needs;
}

constexpr const char* limits_advice =
    "in /etc/security/limits.d/99-rtdata.conf: `@realtime - rtprio 99` and `@realtime - memlock unlimited`, join the "
    "group, log in again; in a systemd unit: LimitRTPRIO=99, LimitMEMLOCK=infinity";

std::optional<long> number_in(std::string_view text, int base = 10) {
  if (text.starts_with("0x")) text.remove_prefix(2);
  long number = 0;
  const auto [end, failed] = std::from_chars(text.data(), text.data() + text.size(), number, base);
  if (failed != std::errc{} || end == text.data()) return std::nullopt;
  return number;
}

Finding kernel(const MachineFiles& files) {
  const std::string version = files.text("/proc/version").value_or("");
  const bool is_rt = files.text("/sys/kernel/realtime") == "1" || version.find("PREEMPT_RT") != std::string::npos;
  if (is_rt) return {Severity::good, "kernel", "PREEMPT_RT"};
  return {Severity::note, "kernel", "it is not PREEMPT_RT", "the largest lateness has no bound",
          "on Debian: sudo apt install linux-image-rt-$(dpkg --print-architecture)"};
}

Finding priorities(const MachineFiles& files, const Needs& needs) {
  const Severity severity = needs.priority > 0 ? Severity::warning : Severity::note;
  if (files.is_this_machine()) {
    rlimit limit{};
    ::getrlimit(RLIMIT_RTPRIO, &limit);
    const bool may = ::geteuid() == 0 || limit.rlim_cur >= static_cast<rlim_t>(std::max(needs.priority, 1));
    if (may) return {Severity::good, "real-time priorities", "this user may use them"};
    return {severity, "real-time priorities",
            limit.rlim_cur == 0 ? "this user may not use them"
                                : "this user may use those up to " + std::to_string(limit.rlim_cur),
            "tiers with a real-time policy run without it, behind whatever else runs", limits_advice};
  }
  std::string rules = files.text("/etc/security/limits.conf").value_or("");
  for (const std::string& name : files.names("/etc/security/limits.d"))
    if (name.ends_with(".conf")) rules += "\n" + files.text("/etc/security/limits.d/" + name).value_or("");
  std::istringstream lines(rules);
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line.substr(0, line.find('#')));
    std::string domain, type, item, value;
    if (words >> domain >> type >> item >> value && item == "rtprio" && number_in(value).value_or(0) > 0)
      return {Severity::good, "real-time priorities", domain + " may use those up to " + value};
  }
  return {severity, "real-time priorities", "no limits file gives them to a user",
          "tiers with a real-time policy run without it unless they are root's or a service's", limits_advice};
}

std::vector<Finding> memory(const MachineFiles& files, const Needs& needs) {
  std::vector<Finding> found;
  if (files.is_this_machine()) {
    rlimit limit{};
    ::getrlimit(RLIMIT_MEMLOCK, &limit);
    if (::geteuid() == 0 || limit.rlim_cur == RLIM_INFINITY) {
      found.push_back({Severity::good, "memory lock", "this user may lock all memory"});
    } else {
      found.push_back({needs.locked_memory ? Severity::warning : Severity::note, "memory lock",
                       "this user may lock " + std::to_string(limit.rlim_cur / 1024) + " KiB",
                       "a page that was swapped out costs milliseconds when it is used again", limits_advice});
    }
  }
  const std::string swaps = files.text("/proc/swaps").value_or("");
  const std::size_t end = swaps.find('\n');
  if (end != std::string::npos) {
    const std::string first = swaps.substr(end + 1);
    const bool is_memory = first.starts_with("/dev/zram");
    found.push_back({Severity::note, "swap", "there is swap space: " + first.substr(0, first.find_first_of(" \t")),
                     is_memory ? "memory that is not locked may be compressed meanwhile"
                               : "memory that is not locked may be on the disk when it is needed",
                     "`lock_memory` of a tier locks all of the program's"});
  }
  return found;
}

/// Of tiers that are bound to some.
std::vector<Finding> tiers(const MachineFiles& files, const SystemPlan* plan) {
  std::vector<Finding> found;
  const std::string cpus = "/sys/devices/system/cpu/cpu";
  if (plan == nullptr || !files.exists(cpus + "0")) return found;
  const cpu_set_t bindable = detail::bindable_processors();
  for (const auto& [name, tier] : plan->settings.tiers) {
    std::string missing;
    for (const int cpu : tier.tier_config(name).cpus) {
      const bool is_there = files.is_this_machine() ? CPU_ISSET(static_cast<std::size_t>(cpu), &bindable) != 0
                                                    : files.exists(cpus + std::to_string(cpu));
      if (!is_there) missing += (missing.empty() ? "" : ", ") + std::to_string(cpu);
    }
    if (missing.empty()) continue;
    found.push_back({Severity::warning, "tier " + name,
                     "this machine does not have the processors " + missing + ", or the program may not use them",
                     "it runs on others, beside all else", "set `cpu` or `cpus` to processors that there are"});
  }
  return found;
}

std::vector<Finding> processors(const MachineFiles& files, const Needs& needs) {
  std::vector<Finding> found;
  const std::string cpus = "/sys/devices/system/cpu/";
  std::string governor;
  for (const std::string& cpu : files.names(cpus, "cpu")) {
    const std::string one = files.text(cpus + cpu + "/cpufreq/scaling_governor").value_or("");
    if (!one.empty() && one != "performance") governor = one;
  }
  if (governor.empty()) {
    found.push_back(
        {Severity::good, "frequency", "the processors do not change it by load, as far as the kernel knows"});
  } else {
    found.push_back({Severity::note, "frequency", "the governor is \"" + governor + "\"",
                     "the first work after an idle time is done slowly", "sudo cpupower frequency-set -g performance"});
  }
  const std::string idle = files.text(cpus + "cpuidle/current_driver").value_or("");
  if (idle.empty() || idle == "none") {
    found.push_back({Severity::good, "idle states", "the kernel knows of none that are deep"});
  } else {
    const bool may = access_to(files, "/dev/cpu_dma_latency", W_OK).is_granted;
    found.push_back({needs.awake_processors && !may ? Severity::warning : Severity::note, "idle states",
                     "processors sleep when idle (" + idle + ")", "waking up takes 10 to 300 us",
                     may ? "`keep_cpu_awake` of a tier keeps them from it while it runs, for more power"
                         : "/dev/cpu_dma_latency cannot be written by this user: allow it by a udev rule, then set "
                           "`keep_cpu_awake` of a tier"});
  }
  const std::string budget = files.text("/proc/sys/kernel/sched_rt_runtime_us").value_or("");
  const std::string period = files.text("/proc/sys/kernel/sched_rt_period_us").value_or("1000000");
  if (!budget.empty() && budget != "-1" && budget != period) {
    found.push_back({Severity::note, "real-time share",
                     "real-time threads get " + budget + " us of each " + period + " us if others want the rest",
                     "matters to those that spin", "sudo sysctl kernel.sched_rt_runtime_us=-1"});
  }
  if (const std::optional<long> slack = number_in(files.text("/proc/self/timerslack_ns").value_or(""));
      slack && *slack > 50'000)
    found.push_back({Severity::note, "timer slack", std::to_string(*slack) + " ns",
                     "what the program is started from lets its timers be that late; loops and tiers set their own",
                     "`timer_slack` of a tier"});
  return found;
}

constexpr const char* supply_cost = "the board is slowed down, and may lose data or its SD card";
constexpr const char* supply_advice = "a supply for 5.1 V and 3 A (Raspberry Pi 5: 5 A), and a short cable";

/// Of a Raspberry Pi whose kernel does not show the firmware's state: the alarm of its driver rpi_volt.
std::vector<Finding> voltage_alarm(const MachineFiles& files) {
  for (const std::string& chip : files.names("/sys/class/hwmon", "hwmon")) {
    const std::string folder = "/sys/class/hwmon/" + chip;
    if (files.text(folder + "/name") != "rpi_volt") continue;
    const std::string alarm = files.text(folder + "/in0_lcrit_alarm").value_or("");
    if (alarm == "0") return {{Severity::good, "power", "the supply's voltage is not too low"}};
    if (alarm == "1")
      return {{Severity::warning, "power", "the supply's voltage is or was too low", supply_cost, supply_advice}};
    return {{Severity::warning, "power", "the supply's state cannot be read: \"" + alarm + "\"",
             "nobody knows whether it is too weak", "vcgencmd get_throttled: 0x0 is good"}};
  }
  return {};
}

/// Of a Raspberry Pi: bits of vcgencmd get_throttled, see its documentation.
std::vector<Finding> power(const MachineFiles& files) {
  const std::optional<std::string> text = files.text("/sys/devices/platform/soc/soc:firmware/get_throttled");
  if (!text) return voltage_alarm(files);
  const std::optional<long> bits = number_in(*text, 16);
  if (!bits)
    return {{Severity::warning, "power", "the firmware's state cannot be read: \"" + *text + "\"",
             "nobody knows whether the supply is too weak", "vcgencmd get_throttled: 0x0 is good"}};
  std::vector<Finding> found;
  const auto state = [&](int bit, const char* what, const char* means, const char* advice) {
    const bool is_now = (*bits >> bit & 1) != 0, was = (*bits >> (bit + 16) & 1) != 0;
    if (is_now || was)
      found.push_back(
          {Severity::warning, "power", std::string(what) + (is_now ? " now" : " since the start"), means, advice});
  };
  state(0, "the supply's voltage was too low", supply_cost, supply_advice);
  state(1, "the frequency was limited", "the processors are slow", "see the supply and the temperature");
  state(2, "the processors were throttled", "the processors are slow", "see the supply and the temperature");
  state(3, "the limit of the temperature was reached", "the processors are slow", "a heat sink or a fan");
  if (found.empty()) found.push_back({Severity::good, "power", "no low voltage and no throttling since the start"});
  return found;
}

}  // namespace

std::vector<Finding> examine_timing(const MachineFiles& files, const SystemPlan* plan) {
  const Needs needs = needs_of(plan);
  std::vector<Finding> found{kernel(files), priorities(files, needs)};
  const auto append = [&](std::vector<Finding> more) {
    for (Finding& one : more) found.push_back(std::move(one));
  };
  append(memory(files, needs));
  append(tiers(files, plan));
  append(processors(files, needs));
  append(power(files));
  return found;
}

std::string Finding::text() const {
  std::string text = what;
  if (!cost.empty()) text += ": " + cost;
  if (!advice.empty()) text += "; " + advice;
  return text;
}

}  // namespace rtdata::app
