#include <sched.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/utsname.h>
#include <sys/vfs.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <thread>

#include "app/bench/bench_measure.hpp"
#include "app/bench/bench_text.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/machine/doctor.hpp"
#include "loop/support/processors.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

volatile sig_atomic_t interrupted = 0;

// ---- how busy the machine is

/// Processor time in clock ticks, of the whole machine.
struct MachineTime {
  double busy = 0, stolen = 0, all = 0;
};

MachineTime machine_time() {
  std::ifstream file("/proc/stat");
  std::string cpu;
  std::array<double, 8> t{};  // user nice system idle iowait irq softirq steal
  file >> cpu;
  for (double& one : t) file >> one;
  MachineTime time;
  for (const double one : t) time.all += one;
  time.stolen = t[7];
  time.busy = time.all - t[3] - t[4] - t[7];
  return time;
}

double own_seconds() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
         static_cast<double>(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec) / 1e6;
}

Json json_of(Ticks& ticks) {
  std::sort(ticks.lateness.begin(), ticks.lateness.end());
  const auto at = [&](double fraction) {
    if (ticks.lateness.empty()) return Json();
    return Json(ticks.lateness[static_cast<std::size_t>(fraction * static_cast<double>(ticks.lateness.size() - 1))]);
  };
  return {{"ticks", ticks.all()}, {"missed", ticks.missed}, {"p50_ns", at(0.5)},
          {"p99_ns", at(0.99)},   {"p99_9_ns", at(0.999)},  {"max_ns", at(1)}};
}

[[maybe_unused]] bool is_tmpfs(const std::string& path) {
  struct statfs found {};
  return ::statfs(path.c_str(), &found) == 0 && static_cast<unsigned long>(found.f_type) == 0x01021994UL;
}

/// What keeps this machine from doing better, with what to set.
std::vector<std::string> improvements(const std::vector<std::string>& warnings, double others_percent) {
  std::vector<std::string> all = warnings;
  for (const Finding& finding : examine_timing(MachineFiles(), nullptr))
    if (finding.severity != Severity::good) all.push_back(finding.text());
  if (others_percent > 10)
    all.push_back("other programs used the processors meanwhile: measure again when the machine is quiet");
  return all;
}

class Bench {
 public:
  explicit Bench(const BenchOptions& options) : options_(options), talks_(::isatty(STDERR_FILENO) == 1) {}

  Json measure() {
    const MachineTime before = machine_time();
    const double own_before = own_seconds();
    json_["machine"] = Json::object();
    measure_sampling();
    tell("events");
    json_["events"] = {{"rtdata_per_s", measure_topic(share(0.05))}, {"limit_per_s", measure_bare_ring(share(0.05))}};
    json_["storage"] = Json::array();
    measure_disks();
    tell("");
    const MachineTime after = machine_time();
    const double all = std::max(after.all - before.all, 1.0);
    const double own = (own_seconds() - own_before) * static_cast<double>(::sysconf(_SC_CLK_TCK));
    const double others = std::clamp(100 * (after.busy - before.busy - own) / all, 0.0, 100.0);
    utsname system{};
    ::uname(&system);
    json_["machine"] = {{"system", std::string(system.sysname) + " " + system.release + " " + system.machine},
                        {"processors", static_cast<int>(std::thread::hardware_concurrency())},
                        {"load", MachineFiles().text("/proc/loadavg").value_or("").substr(0, 14)},
                        {"others_percent", others},
                        {"stolen_percent", 100 * (after.stolen - before.stolen) / all}};
    json_["verdict"] = bench_verdict(json_);
    json_["improvements"] = improvements(warnings_, others);
    return std::move(json_);
  }

 private:
  Duration share(double part) const {
    return std::max<Duration>(
        Duration{static_cast<Duration::rep>(part * static_cast<double>(options_.duration.count()))},
        std::chrono::milliseconds{50});
  }
  void tell(const std::string& what) const {
    throw_if_interrupted();
    if (talks_) std::cerr << "\r\x1b[K" << (what.empty() ? "" : "measuring: " + what + " ...") << std::flush;
  }

  void measure_sampling() {
    // In turns, so that noise that comes and goes meets both.
    constexpr int turns = 4;
    const Duration slice = share(0.6 / (2 * 2 * turns));
    Scheduling granted;
    Json rates = Json::array();
    for (const auto& [name, period] :
         {std::pair{"1 kHz", Duration{1'000'000}}, std::pair{"10 kHz", Duration{100'000}}}) {
      Ticks ours, bare;
      for (int turn = 0; turn < turns; ++turn) {
        tell(std::string(name) + ", part " + std::to_string(turn + 1) + " of " + std::to_string(turns));
        TierMeasurement on_tier = measure_tier(period, slice, options_.cpu);
        ours.add(on_tier.ticks);
        granted = on_tier.scheduling;
        warnings_ = std::move(on_tier.warnings);
        bare.add(measure_bare_timer(period, slice, granted, options_.cpu));
      }
      rates.push_back(
          {{"name", name}, {"period_ns", period.count()}, {"rtdata", json_of(ours)}, {"limit", json_of(bare)}});
    }
    ::munlockall();  // what follows needs memory
    json_["sampling"] = {{"policy", std::string(name_of(granted.policy))},
                         {"priority", granted.priority},
                         {"as_asked", granted.policy == SchedulingPolicy::fifo},
                         {"cpu", options_.cpu ? Json(*options_.cpu) : Json()},
                         {"rates", std::move(rates)}};
  }

  void measure_disks() {
#ifdef RTDATA_WITH_SQLITE
    std::vector<std::string> folders{std::filesystem::current_path().string()};
    for (const char* folder : {"/dev/shm", "/run", "/tmp"}) {
      if (is_tmpfs(folders.front()) || folders.size() > 1) break;
      if (is_tmpfs(folder) && ::access(folder, W_OK) == 0) folders.push_back(folder);
    }
    for (const std::string& folder : folders) {
      tell("SQLite in " + folder);
      Json one;
      try {
        one = measure_storage(folder, share(0.28 / static_cast<double>(folders.size())));
      } catch (const SetupError& error) {
        one = {{"folder", folder}, {"rtdata", {{"error", error.what()}}}, {"limit", {{"error", "not measured"}}}};
      }
      one["tmpfs"] = is_tmpfs(folder);
      json_["storage"].push_back(std::move(one));
    }
#endif
  }

  const BenchOptions& options_;
  const bool talks_;
  Json json_;
  std::vector<std::string> warnings_;
};

}  // namespace

void catch_interrupts() {
  struct sigaction action {};
  action.sa_handler = [](int) { interrupted = 1; };
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) ::sigaction(signal, &action, nullptr);
}

void throw_if_interrupted() {
  if (interrupted != 0) throw Interrupted{};
}

int bench(const BenchOptions& options) {
  if (options.cpu) {
    const cpu_set_t there = detail::bindable_processors();
    if (*options.cpu < 0 || *options.cpu >= CPU_SETSIZE || !CPU_ISSET(static_cast<std::size_t>(*options.cpu), &there)) {
      std::cerr << "rtdata: --cpu " << *options.cpu << ": this program may use no such processor: there are "
                << detail::list_of(there) << std::endl;
      return exit_other;
    }
  }
  std::ofstream file;
  if (!options.json_file.empty() && options.json_file != "-") {
    file.open(options.json_file);
    if (!file) {
      const Error error = system_error(errno, "cannot write the figures", options.json_file);
      std::cerr << "rtdata: " << error.text() << std::endl;
      return exit_other;
    }
  }
  catch_interrupts();
  try {
    const Json json = Bench(options).measure();
    const std::string text = json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
    if (options.json_file == "-") {
      std::cout << text << std::flush;
    } else {
      std::cout << bench_text(json) << std::flush;
    }
    if (file.is_open() && !(file << text << std::flush)) {
      std::cerr << "rtdata: cannot write all figures: " << options.json_file << std::endl;
      return exit_other;
    }
  } catch (const Interrupted&) {
    std::cerr << "\nrtdata: ended before all was measured" << std::endl;
    return exit_other;
  }
  return exit_good;
}

}  // namespace rtdata::app
