#include <sched.h>
#include <sys/mman.h>
#include <sys/utsname.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <thread>

#include "app/core/configuration_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "app/machine/machine_files.hpp"
#include "data/rounded_time.hpp"
#include "loop/tier/processors.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

/// The JSON of lateness or write times, in ns.
Json json_of(std::vector<std::int64_t> times) {
  std::sort(times.begin(), times.end());
  const auto at = [&](double fraction) {
    return times[static_cast<std::size_t>(fraction * static_cast<double>(times.size() - 1))];
  };
  if (times.empty()) return Json::object();
  return {{"p50_ns", at(0.5)}, {"p99_ns", at(0.99)}, {"p99_9_ns", at(0.999)}, {"max_ns", times.back()}};
}

struct Ticks {
  std::vector<std::int64_t> lateness;
  std::uint64_t missed = 0;
  Scheduling scheduling;
  std::vector<std::string> warnings;
};

/// Adds the ticks of a ticker on a tier with a real-time policy, if permitted.
void add_ticks(Ticks& ticks, Duration period, Duration duration, std::optional<int> cpu) {
  Loop loop;
  loop.runtime().on_log([](const LogRecord&) {});  // the warnings are printed at the end
  Tier::Config config{.name = "bench", .policy = SchedulingPolicy::fifo, .priority = 80};
  if (cpu) config.cpus = {*cpu};
  Tier tier(loop, config);
  std::size_t count = ticks.lateness.size();
  ticks.lateness.resize(count + static_cast<std::size_t>(duration / period) + 1000);  // loads the pages
  Ticker ticker(tier.loop(), period, [&](const Tick& tick) {
    if (count < ticks.lateness.size()) ticks.lateness[count++] = tick.lateness().count();
    ticks.missed += tick.missed;
  });
  loop.run_for(duration);
  ticks.scheduling = tier.scheduling();
  ticks.warnings = tier.warnings();
  tier.stop();
  ticks.lateness.resize(count);
}

/// Adds the results of cyclictest (rt-tests) with the same priority, if it can run.
void add_cyclictest(std::vector<std::int64_t>& lateness, Duration period, Duration duration, const Scheduling& like,
                    std::optional<int> cpu) {
  constexpr std::int64_t most = 100'000;  // us
  const std::int64_t loops = duration / period;
  std::string command = "cyclictest -q --laptop -i" + std::to_string(period / std::chrono::microseconds{1}) + " -l" +
                        std::to_string(loops) + " -h" + std::to_string(most);
  if (like.policy == SchedulingPolicy::fifo) command += " -m -p" + std::to_string(like.priority);
  if (cpu) command += " -a" + std::to_string(*cpu);
  std::FILE* const output = ::popen((command + " 2>/dev/null").c_str(), "r");
  if (output == nullptr) return;
  const std::size_t wanted = lateness.size() + static_cast<std::size_t>(loops);
  std::array<char, 200> line{};
  while (std::fgets(line.data(), static_cast<int>(line.size()), output) != nullptr) {
    unsigned long microseconds = 0, count = 0;
    if (std::sscanf(line.data(), "%lu %lu", &microseconds, &count) == 2)
      lateness.insert(lateness.end(), count, static_cast<std::int64_t>(microseconds) * 1000);
  }
  if (::pclose(output) == 0 && !lateness.empty()) lateness.resize(wanted, most * 1000);  // beyond its table
}

Json measure_rate(Duration period, Duration duration, std::optional<int> cpu, Ticks& ticks) {
  std::vector<std::int64_t> cyclictest;
  constexpr int turns = 4;  // so that temporary noise affects both
  for (int turn = 0; turn < turns; ++turn) {
    add_ticks(ticks, period, duration / (2 * turns), cpu);
    add_cyclictest(cyclictest, period, duration / (2 * turns), ticks.scheduling, cpu);
  }
  Json ours = json_of(ticks.lateness);
  ours["ticks"] = ticks.lateness.size() + ticks.missed;
  ours["missed"] = ticks.missed;
  return {{"period_ns", period.count()}, {"rtdata", std::move(ours)}, {"cyclictest", json_of(std::move(cyclictest))}};
}

Json measure(const BenchOptions& options) {
  const bool talks = ::isatty(STDERR_FILENO) == 1;
  const auto tell = [&](const char* what) {
    if (talks) std::cerr << "\r\x1b[K" << what << std::flush;
  };
  const Duration part = std::max<Duration>(options.duration * 2 / 5, std::chrono::milliseconds{50});
  Json json, rates = Json::array(), warnings = Json::array();
  Scheduling granted;
  for (const std::int64_t hertz : {1000, 10'000}) {
    tell(hertz == 1000 ? "measuring: 1 kHz ..." : "measuring: 10 kHz ...");
    Ticks ticks;
    rates.push_back(measure_rate(Duration{1'000'000'000 / hertz}, part, options.cpu, ticks));
    granted = ticks.scheduling;
    warnings = ticks.warnings;
  }
  ::munlockall();  // the next parts need memory
  utsname system{};
  ::uname(&system);
  json["machine"] = {{"system", std::string(system.sysname) + " " + system.release + " " + system.machine},
                     {"processors", static_cast<int>(std::thread::hardware_concurrency())},
                     {"load", MachineFiles().text("/proc/loadavg").value_or("").substr(0, 14)}};
  json["sampling"] = {{"policy", std::string(name_of(granted.policy))},
                      {"priority", granted.priority},
                      {"cpu", options.cpu ? Json(*options.cpu) : Json()},
                      {"warnings", std::move(warnings)},
                      {"rates", std::move(rates)}};
  tell("measuring: the disk ...");
  const std::string folder = std::filesystem::current_path().string();
  auto times = times_of_sync(folder, part / 2);
  json["disk"] = times ? json_of(*std::move(times)) : Json{{"error", times.error().text()}};
  json["disk"]["folder"] = folder;
  tell("");
  return json;
}

std::string text_of(const Json& json) {
  std::string out;
  const auto line = [&](const char* format, const auto&... values) {
    std::array<char, 600> text{};
    std::snprintf(text.data(), text.size(), format, values...);
    out += std::string(text.data()) + "\n";
  };
  const auto time = [](const Json& of, const char* key) { return detail::rounded_time(of.at(key).get<double>()); };
  const Json &machine = json.at("machine"), &sampling = json.at("sampling"), &disk = json.at("disk");
  line("machine   %s, %d processors; load %s\n", machine.at("system").get_ref<const std::string&>().c_str(),
       machine.at("processors").get<int>(), machine.at("load").get_ref<const std::string&>().c_str());
  out += "sampling on a tier, " + sampling.at("policy").get<std::string>() +
         (sampling.at("priority") > 0 ? " " + sampling.at("priority").dump() : "") + ", " +
         (sampling.at("cpu").is_number() ? "processor " + sampling.at("cpu").dump() : "any processor") + "\n";
  for (const Json& warning : sampling.at("warnings")) out += "  " + warning.get<std::string>() + "\n";
  out += "lateness                 p50       p99     p99.9       max    missed        of\n";
  for (const Json& rate : sampling.at("rates")) {
    const char* name = rate.at("period_ns") == 1'000'000 ? "1 kHz" : "10 kHz";
    for (const char* who : {"rtdata", "cyclictest"}) {
      const Json& of = rate.at(who);
      if (of.empty()) {
        line("%-7s %s: cannot be run here: apt install rt-tests", name, who);
      } else {
        line("%-7s %-10s%10s%10s%10s%10s", name, who, time(of, "p50_ns").c_str(), time(of, "p99_ns").c_str(),
             time(of, "p99_9_ns").c_str(), time(of, "max_ns").c_str());
        if (!of.contains("missed")) continue;
        out.pop_back();
        line("%10s%10s", of["missed"].dump().c_str(), of["ticks"].dump().c_str());
      }
    }
  }
  out += "\ndisk of " + disk.at("folder").get<std::string>() + "\n";
  if (disk.contains("error")) return out + "  " + disk["error"].get<std::string>() + "\n";
  line("  a small write is on the disk after p50 %s, p99 %s, at worst %s", time(disk, "p50_ns").c_str(),
       time(disk, "p99_ns").c_str(), time(disk, "max_ns").c_str());
  return out;
}

}  // namespace

int bench(const BenchOptions& options) {
  if (options.cpu) {
    const cpu_set_t there = detail::bindable_processors();
    if (*options.cpu < 0 || *options.cpu >= CPU_SETSIZE || !CPU_ISSET(static_cast<std::size_t>(*options.cpu), &there)) {
      print_error(std::cerr,
                  "--cpu " + std::to_string(*options.cpu) +
                      ": this program may not use this processor; available: " + detail::list_of(there),
                  "bad-argument");
      return exit_other;
    }
  }
  std::ofstream file;
  if (!options.json_file.empty() && options.json_file != "-") {
    file.open(options.json_file);
    if (!file) {
      const Error error = system_error(errno, "cannot write the figures", options.json_file);
      print_error(std::cerr, error);
      return exit_other;
    }
  }
  const Json json = measure(options);
  const std::string text = json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
  std::cout << (options.json_file == "-" ? text : text_of(json)) << std::flush;
  if (file.is_open() && !(file << text << std::flush)) {
    print_error(std::cerr, "cannot write all figures: " + options.json_file, "io-failed");
    return exit_other;
  }
  return exit_good;
}

}  // namespace rtdata::app
