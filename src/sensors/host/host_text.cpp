#include "sensors/host/host_text.hpp"

#include <charconv>

#include "sensors/core/sysfs_file.hpp"

namespace rtdata::detail {
namespace {

/// Removes words and lines from the front of a text.
class Words {
 public:
  explicit Words(std::string_view text) : rest_(text) {}

  std::string_view word() noexcept {
    rest_.remove_prefix(std::min(rest_.find_first_not_of(" \t"), rest_.size()));
    const std::string_view word = rest_.substr(0, rest_.find_first_of(" \t\n"));
    rest_.remove_prefix(word.size());
    return word;
  }
  /// The rest of the current line, without its end.
  std::string_view line() noexcept {
    const std::string_view line = rest_.substr(0, rest_.find('\n'));
    rest_.remove_prefix(std::min(line.size() + 1, rest_.size()));
    return line;
  }
  template <class T>
  bool number(T& out) noexcept {
    const std::string_view text = word();
    const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), out);
    return status == std::errc{} && end == text.data() + text.size();
  }
  /// Numbers, all of which must exist.
  template <class... T>
  bool numbers(T&... out) noexcept {
    return (number(out) && ...);
  }
  bool is_at_end() const noexcept { return rest_.empty(); }

 private:
  std::string_view rest_;
};

Error bad(const char* file) {
  return {Errc::bad_data, "cannot read this computer's counters", file, "its text is not as expected",
          "report the version of this kernel to the project"};
}
Error missing(const char* file, std::string_view device) {
  return {Errc::not_found, "cannot read this computer's counters", file,
          "it does not contain \"" + std::string(device) + "\"",
          "check `device`; `rtdata types host` lists the devices"};
}

}  // namespace

Result<CpuTicks> parse_cpu(std::string_view stat, std::string_view device) {
  const std::string_view wanted = device.empty() ? "cpu" : device;
  for (Words words(stat); !words.is_at_end(); words.line()) {
    if (words.word() != wanted || !wanted.starts_with("cpu")) continue;
    CpuTicks ticks{};
    for (std::uint64_t& tick : ticks) {
      if (!words.number(tick)) return bad("/proc/stat");
    }
    return ticks;
  }
  return missing("/proc/stat", wanted);
}

Reading<HostCpu> cpu_shares(const CpuTicks& before, const CpuTicks& now) {
  std::array<double, 8> share{};
  double all = 0;
  for (std::size_t i = 0; i < share.size(); ++i) {
    // The kernel's iowait may go back a little.
    share[i] = now[i] > before[i] ? static_cast<double>(now[i] - before[i]) : 0.0;
    all += share[i];
  }
  if (all == 0) return nothing_new;
  for (double& part : share) part *= 100 / all;
  return HostCpu{
      100 - share[3] - share[4], share[0], share[1], share[2], share[3], share[4], share[5], share[6], share[7]};
}

Result<HostLoad> parse_load(std::string_view loadavg) {
  HostLoad load;
  Words words(loadavg);
  if (!words.numbers(load.minutes_1, load.minutes_5, load.minutes_15)) return bad("/proc/loadavg");
  const std::string_view tasks = words.word();
  const auto slash = tasks.find('/');
  if (slash == std::string_view::npos || !Words(tasks.substr(0, slash)).number(load.running) ||
      !Words(tasks.substr(slash + 1)).number(load.tasks)) {
    return bad("/proc/loadavg");
  }
  return load;
}

Result<HostMemory> parse_memory(std::string_view meminfo) {
  HostMemory memory;
  struct Wanted {
    std::string_view key;
    std::uint64_t* to;
    bool found;
  } wanted[] = {{"MemTotal:", &memory.total, false},         {"MemFree:", &memory.free, false},
                {"MemAvailable:", &memory.available, false}, {"Buffers:", &memory.buffers, false},
                {"Cached:", &memory.cached, false},          {"SwapTotal:", &memory.swap_total, false},
                {"SwapFree:", &memory.swap_free, false}};
  std::size_t found = 0;
  for (Words words(meminfo); !words.is_at_end() && found < std::size(wanted); words.line()) {
    const std::string_view key = words.word();
    for (Wanted& w : wanted) {
      if (w.found || w.key != key) continue;
      if (!words.number(*w.to) || words.word() != "kB") return bad("/proc/meminfo");
      *w.to *= 1024;
      w.found = true;
      ++found;
    }
  }
  if (found != std::size(wanted)) return bad("/proc/meminfo");
  return memory;
}

Result<HostDisk> parse_disk(std::string_view diskstats, std::string_view device) {
  for (Words words(diskstats); !words.is_at_end(); words.line()) {
    words.word();
    words.word();
    if (words.word() != device) continue;
    HostDisk disk;
    std::uint64_t merged = 0, time = 0;
    if (!words.numbers(disk.reads, merged, disk.read_bytes, time, disk.writes, merged, disk.written_bytes, time,
                       disk.in_flight, disk.busy_time)) {
      return bad("/proc/diskstats");
    }
    disk.read_bytes *= 512;
    disk.written_bytes *= 512;
    return disk;
  }
  return missing("/proc/diskstats", device);
}

Result<HostNetwork> parse_network(std::string_view dev, std::string_view device) {
  for (Words lines(dev); !lines.is_at_end();) {
    const std::string_view line = lines.line();
    const auto colon = line.find(':');  // there may be no blank after it
    if (colon == std::string_view::npos || trimmed(line.substr(0, colon)) != device) continue;
    HostNetwork net;
    std::uint64_t other = 0;
    Words words(line.substr(colon + 1));
    if (!words.numbers(net.received_bytes, net.received_packets, net.receive_errors, net.receive_drops, other, other,
                       other, other, net.sent_bytes, net.sent_packets, net.send_errors, net.send_drops)) {
      return bad("/proc/net/dev");
    }
    return net;
  }
  return missing("/proc/net/dev", device);
}

Result<HostScheduler> parse_scheduler(std::string_view stat) {
  HostScheduler scheduler;
  unsigned found = 0;
  bool good = true;
  const auto take = [&](Words& words, auto& to) {
    good = words.number(to) && good;
    ++found;
  };
  for (Words words(stat); !words.is_at_end(); words.line()) {
    const std::string_view key = words.word();
    if (key == "intr") take(words, scheduler.interrupts);
    if (key == "ctxt") take(words, scheduler.context_switches);
    if (key == "processes") take(words, scheduler.forks);
    if (key == "procs_running") take(words, scheduler.running);
    if (key == "procs_blocked") take(words, scheduler.blocked);
    if (key == "softirq") take(words, scheduler.soft_interrupts);
  }
  if (!good || found != 6) return bad("/proc/stat");
  return scheduler;
}

Result<HostProcess> parse_process(std::string_view schedstat) {
  HostProcess process;
  if (!Words(schedstat).numbers(process.run_time, process.wait_time, process.time_slices))
    return bad("/proc/thread-self/schedstat");
  return process;
}

Result<std::int64_t> parse_number(std::string_view text) {
  std::int64_t number = 0;
  const std::string_view word = trimmed(text);
  const auto [end, status] = std::from_chars(word.data(), word.data() + word.size(), number);
  if (status != std::errc{} || end != word.data() + word.size()) {
    return Error{Errc::not_a_number, "cannot read a file of /sys", "", "it does not contain one whole number", ""};
  }
  return number;
}

}  // namespace rtdata::detail
