// Facts of this machine that cost timing or data, and tables of rules for them.
#include <grp.h>
#include <sys/resource.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <ctime>
#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <sstream>
#include <string_view>

#include "app/machine/doctor.hpp"
#include "data/listed.hpp"
#include "loop/tier/processors.hpp"
#include "rtdata/loop/clock.hpp"

namespace rtdata::app {
namespace {

using Facts = std::map<std::string, std::string, std::less<>>;

struct Rule {
  const char* subject;
  const char* fact;   ///< or a file, whose text is the fact; a missing file gives no finding
  const char* value;  ///< pattern: one of a|b; a* is a prefix. The first matching rule of a fact applies
  Severity severity;
  const char *what, *cost = "", *advice = "";  ///< {} is replaced by the fact, {/proc/version} by the file's text
  const char* needed = "";                     ///< if this fact exists, the finding is one level worse
};

using enum Severity;
constexpr const char* limits_advice =
    "in /etc/security/limits.d/99-rtdata.conf: `@realtime - rtprio 99` and `@realtime - memlock unlimited`, join the "
    "group, log in again; in a systemd unit: LimitRTPRIO=99, LimitMEMLOCK=infinity";
constexpr const char* lock_advice = "set `lock_memory` of a tier: it locks all memory of the program";
constexpr const char* waking = "waking up takes 10 to 300 us";
constexpr const char* supply_cost = "the board is slowed down, and may lose data or its SD card";
constexpr const char* supply_advice = "use a 5.1 V, 3 A supply (Raspberry Pi 5: 5 A) and a short cable";
constexpr const char* see_supply = "check the supply and the temperature";
constexpr const char* are_slow = "the processors are slow";
constexpr const char* good_state = "run `vcgencmd get_throttled`: 0x0 is good";

constexpr Rule timing_rules[] = {
    {"kernel", "kernel", "PREEMPT_RT", good, "{}"},
    {"kernel", "kernel", "*", note, "it is not PREEMPT_RT", "the largest lateness has no bound",
     "on Debian: sudo apt install linux-image-rt-$(dpkg --print-architecture)"},
    {"real-time priorities", "priority", "enough", good, "this user may use real-time priorities"},
    {"real-time priorities", "priority", "*", note, "this user may {}",
     "tiers with a real-time policy run without it, and other programs delay them", limits_advice, "needs priority"},
    {"real-time priorities", "priority in files", "", note, "no limits file gives real-time priorities to a user",
     "tiers with a real-time policy run without it unless they are root's or a service's", limits_advice,
     "needs priority"},
    {"real-time priorities", "priority in files", "*", good, "{}"},
    {"memory lock", "memory lock", "all", good, "this user may lock all memory"},
    {"memory lock", "memory lock", "*", note, "this user may lock {} KiB",
     "a page that was swapped out costs milliseconds at its next use", limits_advice, "needs lock"},
    {"swap", "swap", "/dev/zram*", note, "there is swap space: {}",
     "memory that is not locked may be compressed meanwhile", lock_advice},
    {"swap", "swap", "*", note, "there is swap space: {}",
     "memory that is not locked may be on the disk when it is needed", lock_advice},
};

constexpr Rule processor_rules[] = {
    {"frequency", "governor", "", good,
     "the processors do not change their frequency by load, as far as the kernel knows"},
    {"frequency", "governor", "*", note, "the governor is \"{}\"", "the first work after an idle time is done slowly",
     "sudo cpupower frequency-set -g performance"},
    {"idle states", "idle", "|none", good, "the kernel knows of no deep idle states"},
    {"idle states", "idle", "*", note, "processors sleep when idle ({})", waking,
     "set `keep_cpu_awake` of a tier: processors then stay awake while it runs, and use more power"},
    {"idle states", "idle for all", "*", note, "processors sleep when idle ({})", waking,
     "/dev/cpu_dma_latency cannot be written by this user: allow it by a udev rule, then set `keep_cpu_awake` of a "
     "tier",
     "needs awake"},
    {"real-time share", "real-time share", "*", note, "real-time threads get {} if others want the rest",
     "tiers with `spin` are interrupted", "sudo sysctl kernel.sched_rt_runtime_us=-1"},
    {"timer slack", "timer slack", "*", note, "{} ns",
     "the parent process allows its timers to be this late; loops and tiers set their own",
     "set `timer_slack` of a tier"},
    {"power", "unreadable state", "*", warning, "the firmware's state cannot be read: \"{}\"",
     "it is not known whether the supply is too weak", good_state},
    // The bits of vcgencmd get_throttled.
    {"power", "throttled 0", "*", warning, "the supply's voltage was too low {}", supply_cost, supply_advice},
    {"power", "throttled 1", "*", warning, "the frequency was limited {}", are_slow, see_supply},
    {"power", "throttled 2", "*", warning, "the processors were throttled {}", are_slow, see_supply},
    {"power", "throttled 3", "*", warning, "the temperature limit was reached {}", are_slow,
     "add a heat sink or a fan"},
    {"power", "never throttled", "*", good, "no low voltage and no throttling since the start"},
    {"power", "voltage alarm", "0", good, "the supply's voltage is not too low"},
    {"power", "voltage alarm", "1", warning, "the supply's voltage is or was too low", supply_cost, supply_advice},
    {"power", "voltage alarm", "*", warning, "the supply's state cannot be read: \"{}\"",
     "it is not known whether the supply is too weak", good_state},
};

constexpr const char* clock_source = "/sys/devices/system/clocksource/clocksource0/current_clocksource";

constexpr Rule clock_rules[] = {
    {"clock source", clock_source, "hpet|acpi_pm|jiffies|refined-jiffies|pit", warning, "{}",
     "reading the time takes a microsecond and more",
     "available: {/sys/devices/system/clocksource/clocksource0/available_clocksource}; the boot option clocksource= "
     "chooses"},
    {"clock source", clock_source, "*", good, "{}"},
    {"clock", "clock", "", warning, "nothing synchronises the clock, as far as the kernel knows",
     "UTC of a recording is as wrong as the clock; times between events are right nevertheless",
     "sudo apt install chrony; without a network, a GPS receiver gives the time (docs/gps.md)"},
    {"clock", "clock", "*", good, "synchronised{}"},
    {"time", "bits", "32*", warning, "this program counts seconds in 32 bits",
     "times of files and logs go wrong in January 2038; those of recordings do not",
     "compile it with -D_TIME_BITS=64, or use a system of 64 bits"},
    {"time", "bits", "64 of 32", note, "this system has 32 bits, this program counts seconds in 64",
     "other programs may go wrong in January 2038", "use a system of 64 bits"},
    {"time", "bits", "*", good, "seconds are counted in 64 bits"},
    {"hardware clock", "no hardware clock", "*", note, "there is none",
     "the machine starts with a time in the past until something synchronises it",
     "add a clock chip with a battery (DS3231), or use a network or GPS at the start"},
};

constexpr Rule disk_rules[] = {
    {"disk", "read-only", "*", warning, "it is mounted read-only", "nothing can be recorded",
     "after an error the kernel does this: see dmesg, then check the file system", "needs disk"},
    {"disk", "type", "tmpfs|ramfs", warning, "it is in memory ({})", "recordings are lost when the power fails",
     "record into a folder of a disk"},
    {"disk", "type", "nfs*|cifs|smb3|fuse.*", warning, "it is on a network, or served by a program ({})",
     "writes wait for it, and locks of SQLite may not hold", "record onto a local disk, and copy afterwards"},
    {"disk", "type", "vfat|exfat|msdos", warning, "its file system has no journal ({})",
     "a power failure can damage all of it", "use a disk with ext4 for recordings"},
    {"disk", "card", "*", note, "it is an SD card or eMMC", "writes wear it out",
     "set `\"profile\": \"card\"` of a recording: it writes less often"},
    {"disk", "full", "*", warning, "{} MB are free", "recording stops within minutes", "make room", "needs disk"},
    {"disk", "nearly full", "*", warning, "{} MB are free", "the disk is full soon",
     "make room, or limit recordings by `max_bytes`"},
    {"disk", "unwritable", "*", warning, "nothing can be written: {}", "nothing can be recorded",
     "`ls -ld` shows who may write there", "needs disk"},
    {"disk", "slow", "*", warning, "a small write takes {} ms until it is on the disk",
     "commits queue up behind each other", "set a longer `batch_time` of the recording, or use another disk"},
};

bool fits(std::string_view values, std::string_view fact) {
  for (;; values.remove_prefix(values.find('|') + 1)) {
    const std::string_view one = values.substr(0, values.find('|'));
    if (one.ends_with('*') ? fact.starts_with(one.substr(0, one.size() - 1)) : fact == one) return true;
    if (one.size() == values.size()) return false;
  }
}

std::string filled(std::string text, const std::string& fact, const MachineFiles& files) {
  for (std::size_t at = text.find('{'); at != std::string::npos; at = text.find('{', at)) {
    const std::string file = text.substr(at + 1, text.find('}', at) - at - 1);
    const std::string with = file.empty() ? fact : files.text(file).value_or("unknown");
    text.replace(at, file.size() + 2, with);
    at += with.size();
  }
  return text;
}

/// `of`: the owner of the subjects.
std::vector<Finding> judged(std::span<const Rule> rules, const MachineFiles& files, const Facts& facts,
                            const std::string& of = {}) {
  std::vector<Finding> found;
  std::set<std::string_view> judged;
  for (const Rule& rule : rules) {
    const auto known = facts.find(rule.fact);
    const auto fact = known != facts.end() ? std::optional(known->second)
                      : *rule.fact == '/'  ? files.text(rule.fact)
                                           : std::nullopt;
    if (!fact || !fits(rule.value, *fact) || !judged.insert(rule.fact).second) continue;
    const std::string what = filled(rule.what, *fact, files);
    if (what.empty()) continue;
    const int worse = facts.contains(rule.needed) ? 1 : 0;
    found.push_back({static_cast<Severity>(static_cast<int>(rule.severity) + worse), rule.subject + of, what, rule.cost,
                     filled(rule.advice, *fact, files)});
  }
  return found;
}

template <auto which>
rlim_t limit_of_user() {
  rlimit limit{};
  ::getrlimit(which, &limit);
  return ::geteuid() == 0 ? RLIM_INFINITY : limit.rlim_cur;
}

std::optional<long> number_in(std::string_view text, int base = 10) {
  if (text.starts_with("0x")) text.remove_prefix(2);
  long number = 0;
  const auto [end, failed] = std::from_chars(text.data(), text.data() + text.size(), number, base);
  return failed == std::errc{} && end != text.data() ? std::optional(number) : std::nullopt;
}

/// "@realtime may use those up to 95"; empty: none.
std::string priority_in_files(const MachineFiles& files) {
  std::string rules = files.text("/etc/security/limits.conf").value_or("");
  for (const std::string& name : files.names("/etc/security/limits.d"))
    if (name.ends_with(".conf")) rules += "\n" + files.text("/etc/security/limits.d/" + name).value_or("");
  std::istringstream lines(rules);
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line.substr(0, line.find('#')));
    std::string domain, type, item, value;
    if (words >> domain >> type >> item >> value && item == "rtprio" && number_in(value).value_or(0) > 0)
      return domain + " may use those up to " + value;
  }
  return "";
}

void add_processors(const MachineFiles& files, Facts& facts) {
  const std::string cpus = "/sys/devices/system/cpu/";
  facts["governor"] = "";
  for (const std::string& cpu : files.names(cpus, "cpu")) {
    const std::string one = files.text(cpus + cpu + "/cpufreq/scaling_governor").value_or("");
    if (!one.empty() && one != "performance") facts["governor"] = one;
  }
  const std::string idle = files.text(cpus + "cpuidle/current_driver").value_or("");
  const bool may = access_to(files, "/dev/cpu_dma_latency", W_OK).is_granted;
  facts[may || idle.empty() || idle == "none" ? "idle" : "idle for all"] = idle;
  const std::string share = files.text("/proc/sys/kernel/sched_rt_runtime_us").value_or("");
  const std::string period = files.text("/proc/sys/kernel/sched_rt_period_us").value_or("1000000");
  if (!share.empty() && share != "-1" && share != period)
    facts["real-time share"] = share + " us of each " + period + " us";
  const long slack = number_in(files.text("/proc/self/timerslack_ns").value_or("")).value_or(0);
  if (slack > 50'000) facts["timer slack"] = std::to_string(slack);
}

/// Adds the facts of a Raspberry Pi.
void add_power(const MachineFiles& files, Facts& facts) {
  if (const auto state = files.text("/sys/devices/platform/soc/soc:firmware/get_throttled")) {
    const std::optional<long> bits = number_in(*state, 16);
    if (!bits) facts["unreadable state"] = *state;
    if (bits && (*bits & 0xf000f) == 0) facts["never throttled"] = "";
    for (int bit = 0; bits && bit < 4; ++bit)
      if (const long is_so = *bits >> bit; (is_so & 0x10001) != 0)
        facts["throttled " + std::to_string(bit)] = (is_so & 1) != 0 ? "now" : "since the start";
    return;
  }
  // If the kernel does not show the firmware's state: the alarm of the driver rpi_volt.
  for (const std::string& chip : files.names("/sys/class/hwmon", "hwmon"))
    if (files.text("/sys/class/hwmon/" + chip + "/name") == "rpi_volt")
      facts.emplace("voltage alarm", files.text("/sys/class/hwmon/" + chip + "/in0_lcrit_alarm").value_or(""));
}

Facts timing_facts(const MachineFiles& files, const SystemPlan* plan) {
  Facts facts;
  rlim_t priority = 1;
  for (const auto& [name, tier] : plan != nullptr ? plan->settings.tiers : decltype(plan->settings.tiers)()) {
    if (tier.keep_cpu_awake) facts["needs awake"];
    if (tier.policy == SchedulingPolicy::other) continue;
    if (tier.priority > 0) facts["needs priority"];
    priority = std::max(priority, static_cast<rlim_t>(tier.priority));
    if (tier.lock_memory) facts["needs lock"];
  }
  const bool is_rt = files.text("/sys/kernel/realtime") == "1" ||
                     files.text("/proc/version").value_or("").find("PREEMPT_RT") != std::string::npos;
  facts["kernel"] = is_rt ? "PREEMPT_RT" : "";
  if (files.is_this_machine()) {
    const rlim_t most = limit_of_user<RLIMIT_RTPRIO>(), memory = limit_of_user<RLIMIT_MEMLOCK>();
    facts["priority"] = most >= priority ? "enough"
                        : most == 0      ? "not use them"
                                         : "use those up to " + std::to_string(most);
    facts["memory lock"] = memory == RLIM_INFINITY ? "all" : std::to_string(memory / 1024);
  } else {
    facts["priority in files"] = priority_in_files(files);
  }
  std::istringstream swaps(files.text("/proc/swaps").value_or(""));
  if (std::string heading, first; std::getline(swaps, heading) && swaps >> first) facts["swap"] = first;
  add_processors(files, facts);
  add_power(files, facts);
  return facts;
}

/// Checks tiers that are bound to processors.
void examine_tiers(const MachineFiles& files, const SystemPlan& plan, std::vector<Finding>& found) {
  const std::string cpus = "/sys/devices/system/cpu/cpu";
  if (!files.exists(cpus + "0")) return;
  const cpu_set_t bindable = detail::bindable_processors();
  for (const auto& [name, tier] : plan.settings.tiers) {
    std::vector<std::string> missing;
    for (const int cpu : tier.tier_config(name).cpus)
      if (files.is_this_machine() ? CPU_ISSET(static_cast<std::size_t>(cpu), &bindable) == 0
                                  : !files.exists(cpus + std::to_string(cpu)))
        missing.push_back(std::to_string(cpu));
    if (!missing.empty())
      found.push_back(
          {warning, "tier " + name,
           "this machine does not have the processors " + detail::listed(missing) + ", or the program may not use them",
           "the tier runs on other processors, beside all other programs",
           "set `cpu` or `cpus` to processors that this machine has"});
  }
}

/// The facts of the mount with the longest path above the folder. Later mounts cover earlier ones.
Facts disk_facts(const MachineFiles& files, const std::string& folder) {
  std::istringstream lines(files.text("/proc/mounts").value_or(""));
  std::string best_at, best_device, best_options;
  Facts facts;
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::string device, at, type, options;
    if (!(words >> device >> at >> type >> options) || at.size() < best_at.size() ||
        !(folder + "/").starts_with(at == "/" ? at : at + "/"))
      continue;
    best_at = at, best_device = device, best_options = "," + options + ",", facts["type"] = type;
  }
  if (best_options.find(",ro,") != std::string::npos) return {{"read-only", ""}};
  if (best_device.starts_with("/dev/mmcblk") || (files.is_this_machine() && is_on_card(folder))) facts["card"];
  if (!files.is_this_machine()) return facts;
  struct statvfs space {};
  const bool is_known = ::statvfs(folder.c_str(), &space) == 0;
  if (const std::uint64_t mb = std::uint64_t{space.f_bavail} * space.f_frsize / 1'000'000; is_known && mb < 1000)
    facts[mb < 10 ? "full" : "nearly full"] = std::to_string(mb);
  auto times = times_of_sync(folder, Duration{});
  if (!times) {
    facts["unwritable"] = times.error().why;
  } else if (std::nth_element(times->begin(), times->begin() + 2, times->end()); (*times)[2] > 200'000'000) {
    facts["slow"] = std::to_string((*times)[2] / 1'000'000);
  }
  return facts;
}

}  // namespace

std::vector<Finding> examine_timing(const MachineFiles& files, const SystemPlan* plan) {
  const Facts facts = timing_facts(files, plan);
  std::vector<Finding> found = judged(timing_rules, files, facts);
  if (plan != nullptr) examine_tiers(files, *plan, found);
  for (Finding& one : judged(processor_rules, files, facts)) found.push_back(std::move(one));
  return found;
}

std::vector<Finding> examine_clock(const MachineFiles& files) {
  Facts facts;
  if (files.is_this_machine()) {
    const auto accuracy = SystemClock().accuracy();
    facts["clock"] = accuracy ? ", within " + to_string(*accuracy) : "";
    facts["bits"] = std::to_string(8 * sizeof(std::time_t)) + " of " + std::to_string(8 * sizeof(long));
  } else if (files.exists("/run/systemd/timesync/synchronized")) {
    facts["clock"] = " by systemd-timesyncd";
  }
  if (files.names("/sys/class/rtc").empty()) facts["no hardware clock"];
  return judged(clock_rules, files, facts);
}

std::vector<Finding> examine_disks(const MachineFiles& files, const SystemPlan* plan) {
  std::set<std::string> folders;
  for (const PartPlan* sink : plan != nullptr ? plan->of_kind("sink") : std::vector<const PartPlan*>())
    if (sink->stores && !sink->stores->path.empty() && sink->stores->path != "-")
      folders.insert(std::filesystem::absolute(sink->stores->path).lexically_normal().parent_path().string());
  const bool is_needed = !folders.empty();
  if (!is_needed) folders.insert(files.is_this_machine() ? std::filesystem::current_path().string() : "/");
  std::vector<Finding> found;
  for (const std::string& folder : folders) {
    Facts facts = disk_facts(files, folder);
    if (is_needed) facts["needs disk"];
    std::vector<Finding> of_disk = judged(disk_rules, files, facts, " of " + folder);
    const std::string type = facts["type"];
    if (of_disk.empty())
      of_disk.push_back(
          {good, "disk of " + folder, type.empty() ? "it can be written" : type + ", which can be written"});
    found.insert(found.end(), of_disk.begin(), of_disk.end());
  }
  return found;
}

std::vector<Finding> examine_groups(const MachineFiles& files) {
  // Distributions give ports and buses to these groups.
  constexpr std::string_view wanted[] = {"dialout", "i2c", "spi", "gpio", "iio"};
  std::vector<gid_t> mine;
  if (files.is_this_machine()) {
    if (::geteuid() == 0) return {{good, "groups", "root may open all devices"}};
    mine.resize(static_cast<std::size_t>(std::max(0, ::getgroups(0, nullptr))));
    if (::getgroups(static_cast<int>(mine.size()), mine.data()) < 0) mine.clear();
    mine.push_back(::getegid());
  }
  std::vector<std::string> missing;
  std::istringstream lines(files.text("/etc/group").value_or(""));
  for (std::string line; std::getline(lines, line);) {
    std::istringstream fields(line);  // dialout:x:20:pi
    std::string name, password, number, members;
    std::getline(std::getline(std::getline(std::getline(fields, name, ':'), password, ':'), number, ':'), members);
    const bool is_mine = std::any_of(mine.begin(), mine.end(),
                                     [&](gid_t one) { return std::to_string(one) == number; });
    // On a copy the users are unknown: any member counts.
    const bool has_member = files.is_this_machine() ? is_mine : !line.ends_with(':');
    if (std::find(std::begin(wanted), std::end(wanted), name) != std::end(wanted) && !has_member)
      missing.push_back(name);
  }
  if (missing.empty()) return {{good, "groups", "this user is in all groups that devices belong to"}};
  const std::string all = detail::listed(missing, ",");
  return {{note, "groups", (files.is_this_machine() ? "this user is not in: " : "no user is in: ") + all,
           "devices of these groups cannot be opened", "sudo usermod -aG " + all + " $USER, then log in again"}};
}

}  // namespace rtdata::app
