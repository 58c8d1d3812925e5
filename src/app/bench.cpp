#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/timerfd.h>
#include <sys/utsname.h>
#include <sys/vfs.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <thread>

#ifdef RTDATA_WITH_SQLITE
#include <sqlite3.h>

#include "rtdata/sinks/sqlite.hpp"
#endif
#include "app/bench_text.hpp"
#include "app/subcommands.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/scheduling.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;
using SteadyClock = std::chrono::steady_clock;

struct BenchSample {
  double a = 0, b = 0, c = 0, d = 0;
  RTDATA_FIELDS(BenchSample, (a, "V"), (b, "V"), (c, "V"), (d, "V"))
};

volatile sig_atomic_t interrupted = 0;
struct Interrupted {};

void stop_if_interrupted() {
  if (interrupted != 0) throw Interrupted{};
}

std::string file_text(const std::string& path) {
  std::ifstream file(path);
  std::string text;
  std::getline(file, text);
  return text;
}

double seconds_of(Duration duration) { return std::chrono::duration<double>(duration).count(); }

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

// ---- lateness

struct Ticks {
  std::vector<std::int64_t> lateness;  // ns; room for all is made before
  std::uint64_t missed = 0;
  void add(const Ticks& other) {
    lateness.insert(lateness.end(), other.lateness.begin(), other.lateness.end());
    missed += other.missed;
  }
  std::uint64_t all() const { return lateness.size() + missed; }
};

std::size_t room_for(Duration period, Duration duration) { return static_cast<std::size_t>(duration / period) + 1000; }

struct OnTier {
  Ticks ticks;
  Scheduling scheduling;
  std::vector<std::string> warnings;
};

OnTier measure_tier(Duration period, Duration duration, std::optional<int> cpu) {
  Loop loop;
  loop.runtime().on_log([](const LogRecord&) {});  // the warnings are printed at the end
  Tier::Config config{.name = "bench", .policy = SchedulingPolicy::fifo, .priority = 80};
  if (cpu) config.cpus = {*cpu};
  Tier tier(loop, config);
  OnTier result;
  Ticks& ticks = result.ticks;
  ticks.lateness.resize(room_for(period, duration));  // touched
  std::size_t count = 0;
  Ticker ticker(tier.loop(), period, [&](const Tick& tick) {
    if (count < ticks.lateness.size()) ticks.lateness[count++] = tick.lateness().count();
    ticks.missed += tick.missed;
  });
  loop.run_for(duration);
  result.scheduling = tier.scheduling();
  result.warnings = tier.warnings();
  tier.stop();
  ticks.lateness.resize(count);
  return result;
}

/// What the kernel gives: an absolute timerfd and epoll, on a thread with the same priority.
Ticks measure_bare(Duration period, Duration duration, Scheduling scheduling, std::optional<int> cpu) {
  Ticks ticks;
  ticks.lateness.resize(room_for(period, duration));
  std::size_t count = 0;
  std::thread thread([&] {
    if (cpu) {
      cpu_set_t set;
      CPU_ZERO(&set);
      CPU_SET(static_cast<std::size_t>(*cpu), &set);
      ::sched_setaffinity(0, sizeof set, &set);
    }
    ::prctl(PR_SET_TIMERSLACK, 1UL);
    static_cast<void>(set_scheduling(scheduling));
    const int timer = ::timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
    const int poller = ::epoll_create1(EPOLL_CLOEXEC);
    epoll_event event{};
    event.events = EPOLLIN;
    ::epoll_ctl(poller, EPOLL_CTL_ADD, timer, &event);
    SystemClock clock;
    MonotonicTime due = clock.monotonic() + period;
    const MonotonicTime end = due + duration;
    while (due < end && count < ticks.lateness.size()) {
      const std::int64_t at = due.time_since_epoch().count();
      itimerspec spec{};
      spec.it_value = {at / 1'000'000'000, at % 1'000'000'000};
      ::timerfd_settime(timer, TFD_TIMER_ABSTIME, &spec, nullptr);
      if (::epoll_wait(poller, &event, 1, 1000) != 1) continue;
      std::uint64_t expired = 0;
      [[maybe_unused]] const ssize_t size = ::read(timer, &expired, sizeof expired);
      const MonotonicTime now = clock.monotonic();
      const auto behind = (now - due) / period;  // counted as the tiers count it
      ticks.missed += static_cast<std::uint64_t>(behind);
      due += behind * period;
      ticks.lateness[count++] = (now - due).count();
      due += period;
    }
    ::close(poller);
    ::close(timer);
  });
  thread.join();
  ticks.lateness.resize(count);
  return ticks;
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

// ---- throughput

/// Batches of events are handed over while another program may have the processor: that is no fault to tell of.
const Loop::Config unwatched{.hold_limit = std::chrono::hours{1}};

/// Events a second through a topic to a handler; each has its time and its copy.
double measure_topic(Duration duration) {
  Loop loop(unwatched);
  const auto topic = loop.topic<BenchSample>("bench");
  double sum = 0;
  std::uint64_t seen = 0;
  const auto subscription = topic.subscribe(loop, [&](const Event<BenchSample>& event) {
    sum += event->a;
    ++seen;
  });
  const auto begin = SteadyClock::now();
  const auto end = begin + duration;
  while (SteadyClock::now() < end) {
    stop_if_interrupted();
    for (int i = 0; i < 500; ++i) topic.publish({static_cast<double>(i), 1, 2, 3});
    loop.poll();
  }
  const double result = static_cast<double>(seen) / seconds_of(SteadyClock::now() - begin);
  return sum > 0 ? result : 0;
}

/// The same by hand: a clock, a copy into a ring, a call for each.
double measure_bare_ring(Duration duration) {
  std::vector<Event<BenchSample>> ring(1024);
  double sum = 0;
  std::uint64_t seen = 0;
  Callback<void(const Event<BenchSample>&)> handler = [&](const Event<BenchSample>& event) {
    sum += event->a;
    ++seen;
  };
  SystemClock clock;
  const auto begin = SteadyClock::now();
  const auto end = begin + duration;
  while (SteadyClock::now() < end) {
    stop_if_interrupted();
    for (std::size_t i = 0; i < 500; ++i) {
      Event<BenchSample>& event = ring[i];
      event.time = Time{clock.monotonic().time_since_epoch()};
      event.sequence = seen + i;
      event.data = {static_cast<double>(i), 1, 2, 3};
    }
    for (std::size_t i = 0; i < 500; ++i) handler(ring[i]);
  }
  const double result = static_cast<double>(seen) / seconds_of(SteadyClock::now() - begin);
  return sum > 0 ? result : 0;
}

/// A folder of its own, removed at the end.
class TemporaryFolder {
 public:
  explicit TemporaryFolder(const std::string& parent) : path_(parent + "/rtdata-bench-XXXXXX") {
    if (::mkdtemp(path_.data()) == nullptr) {
      throw SetupError(system_error(errno, "cannot make a folder for the recording", parent));
    }
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  ~TemporaryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

bool is_tmpfs(const std::string& path) {
  struct statfs found {};
  return ::statfs(path.c_str(), &found) == 0 && static_cast<unsigned long>(found.f_type) == 0x01021994UL;
}

#ifdef RTDATA_WITH_SQLITE
constexpr std::size_t rows_per_commit = 500;

Json stored_json(double rows_per_second, std::vector<double>& commits) {
  std::sort(commits.begin(), commits.end());
  const auto at = [&](double fraction) {
    if (commits.empty()) return Json();
    return Json(commits[static_cast<std::size_t>(fraction * static_cast<double>(commits.size() - 1))] * 1e9);
  };
  return {{"rows_per_s", rows_per_second},
          {"commits", commits.size()},
          {"commit_p50_ns", at(0.5)},
          {"commit_p99_ns", at(0.99)},
          {"commit_max_ns", at(1)}};
}

/// Rows as fast as the sink takes them; then single batches, from handing over to the news that they are stored.
Json measure_sink(const std::string& folder, Duration duration) {
  Loop loop(unwatched);
  std::string failed;
  loop.on_error([&](const ErrorReport& report) { failed = report.error.text(); });
  SqliteConfig config{.path = folder + "/rtdata.db"};
  config.sink.batch_rows = rows_per_commit;
  SqliteSink sink(loop, config);
  const auto topic = loop.topic<BenchSample>("bench");
  const auto publish = [&](std::size_t rows) {
    for (std::size_t i = 0; i < rows; ++i) topic.publish({static_cast<double>(i), 1, 2, 3});
  };
  const auto wait_until_at_most = [&](std::uint64_t queued) {
    while (sink.counts().queued > queued && failed.empty()) {
      stop_if_interrupted();
      loop.run_for(std::chrono::microseconds{100});
    }
  };
  constexpr std::uint64_t waiting = 20 * rows_per_commit;
  const auto begin = SteadyClock::now();
  while (SteadyClock::now() - begin < duration * 2 / 3 && failed.empty()) {
    publish(rows_per_commit);
    loop.poll();
    wait_until_at_most(waiting);
  }
  sink.flush();
  wait_until_at_most(0);
  const auto counts = sink.counts();
  const double rows_per_second = static_cast<double>(counts.stored) / seconds_of(SteadyClock::now() - begin);
  std::vector<double> commits;
  const auto begin_single = SteadyClock::now();
  while (SteadyClock::now() - begin_single < duration / 3 && failed.empty()) {
    const auto from = SteadyClock::now();
    publish(rows_per_commit);
    sink.flush();
    wait_until_at_most(0);
    commits.push_back(seconds_of(SteadyClock::now() - from));
  }
  const std::uint64_t lost = loop.close();
  Json json = stored_json(rows_per_second, commits);
  json["dropped"] = counts.all_dropped() + lost;
  if (!failed.empty()) json["error"] = failed;
  return json;
}

/// The same columns by SQLite alone, on this thread: prepared, WAL, synchronous=NORMAL, as many rows a transaction.
Json measure_bare_sqlite(const std::string& folder, Duration duration) {
  sqlite3* database = nullptr;
  if (::sqlite3_open((folder + "/bare.db").c_str(), &database) != SQLITE_OK) {
    ::sqlite3_close(database);
    return {{"error", "cannot open the database"}};
  }
  const auto execute = [&](const char* sql) {
    return ::sqlite3_exec(database, sql, nullptr, nullptr, nullptr) == SQLITE_OK;
  };
  bool works = execute("PRAGMA journal_mode=WAL") && execute("PRAGMA synchronous=NORMAL") &&
               execute(
                   "CREATE TABLE bench(run INTEGER, time INTEGER, origin INTEGER, sequence INTEGER, a REAL, b REAL, c "
                   "REAL, d REAL)");
  sqlite3_stmt* insert = nullptr;
  works = works && ::sqlite3_prepare_v2(database, "INSERT INTO bench VALUES(?,?,?,?,?,?,?,?)", -1, &insert, nullptr) ==
                       SQLITE_OK;
  std::vector<double> commits;
  std::int64_t rows = 0;
  const auto begin = SteadyClock::now();
  while (works && SteadyClock::now() - begin < duration) {
    stop_if_interrupted();
    const auto from = SteadyClock::now();
    works = execute("BEGIN");
    for (std::size_t i = 0; works && i < rows_per_commit; ++i) {
      ::sqlite3_bind_int64(insert, 1, 1);
      ::sqlite3_bind_int64(insert, 2, from.time_since_epoch().count());
      ::sqlite3_bind_int64(insert, 3, 1);
      ::sqlite3_bind_int64(insert, 4, ++rows);
      for (int column = 5; column <= 8; ++column) ::sqlite3_bind_double(insert, column, static_cast<double>(i));
      works = ::sqlite3_step(insert) == SQLITE_DONE;
      ::sqlite3_reset(insert);
    }
    works = works && execute("COMMIT");
    commits.push_back(seconds_of(SteadyClock::now() - from));
  }
  const double rows_per_second = static_cast<double>(rows) / seconds_of(SteadyClock::now() - begin);
  ::sqlite3_finalize(insert);
  ::sqlite3_close(database);
  Json json = stored_json(rows_per_second, commits);
  if (!works) json["error"] = "a statement failed";
  return json;
}

Json measure_storage(const std::string& parent, Duration duration) {
  const TemporaryFolder folder(parent);
  Json json{{"folder", parent}};
  json["rtdata"] = measure_sink(folder.path(), duration / 2);
  json["limit"] = measure_bare_sqlite(folder.path(), duration / 2);
  return json;
}
#endif

/// What keeps this machine from doing better, with what to set.
std::vector<std::string> improvements(const std::vector<std::string>& warnings, double others_percent) {
  std::vector<std::string> all = warnings;
  const auto cpuidle = file_text("/sys/devices/system/cpu/cpuidle/current_driver");
  if (!cpuidle.empty() && cpuidle != "none") {
    all.push_back(
        ::access("/dev/cpu_dma_latency", W_OK) == 0
            ? "processors go to sleep when idle: set `keep_cpu_awake` of the tier for less lateness and more power"
            : "processors go to sleep when idle, and /dev/cpu_dma_latency cannot be written by this user: allow it by "
              "a udev rule, then set `keep_cpu_awake` of the tier");
  }
  const std::string governor = file_text("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor");
  if (!governor.empty() && governor != "performance") {
    all.push_back("the frequency governor is \"" + governor +
                  "\": `cpupower frequency-set -g performance` keeps the processors fast");
  }
  if (file_text("/sys/kernel/realtime") != "1") {
    all.push_back("the kernel is not PREEMPT_RT: with one that is, the largest lateness is bounded");
  }
  const std::string budget = file_text("/proc/sys/kernel/sched_rt_runtime_us");
  if (!budget.empty() && budget != "-1" && budget != "1000000") {
    all.push_back("real-time threads may use " + budget +
                  " us of each second's 1000000 only if others want the rest "
                  "(kernel.sched_rt_runtime_us): matters to those that spin");
  }
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
                        {"load", file_text("/proc/loadavg").substr(0, 14)},
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
    stop_if_interrupted();
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
        OnTier on_tier = measure_tier(period, slice, options_.cpu);
        ours.add(on_tier.ticks);
        granted = on_tier.scheduling;
        warnings_ = std::move(on_tier.warnings);
        bare.add(measure_bare(period, slice, granted, options_.cpu));
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

int bench(const BenchOptions& options) {
  if (options.cpu && (*options.cpu < 0 || *options.cpu >= CPU_SETSIZE)) {
    std::cerr << "rtdata: --cpu " << *options.cpu << ": there is no such processor" << std::endl;
    return exit_other;
  }
  std::ofstream file;
  if (!options.json_file.empty() && options.json_file != "-") {
    file.open(options.json_file);
    if (!file) {
      std::cerr << "rtdata: " << system_error(errno, "cannot write the figures", options.json_file).text() << std::endl;
      return exit_other;
    }
  }
  struct sigaction action {};
  action.sa_handler = [](int) { interrupted = 1; };
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) ::sigaction(signal, &action, nullptr);
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
