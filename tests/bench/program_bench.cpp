// start, rss: the program rtdata on its starter file, beside a bare program with the same libraries (bare_program.cpp).
// report: `rtdata report` of a day at 100 Hz and 20 fields, beside `rtdata verify` of it.
// run_wakeups: how often the program is woken up for each tick of its only sensor.
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <charconv>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <string>
#include <utility>
#include <vector>

#include "child.hpp"
#include "harness.hpp"
#ifdef RTDATA_BENCH_SQLITE
#include <array>

#include "rtdata/loop/loop.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/feed.hpp"
#endif

namespace bench {
namespace {

std::int64_t realtime_ns() {
  timespec time{};
  ::clock_gettime(CLOCK_REALTIME, &time);
  return std::int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
}

int wait_for(pid_t child) {
  int status = -1;
  if (child > 0) ::waitpid(child, &status, 0);
  return status;
}

double resident_kib(pid_t child) {
  std::ifstream status("/proc/" + std::to_string(child) + "/status");
  for (std::string line; std::getline(status, line);) {
    if (line.starts_with("VmRSS:")) return std::stod(line.substr(6));
  }
  return 0;
}

/// The first number after `key` in the first line of a file; 0 when there is none.
std::int64_t first_number(const std::string& path, const std::string& key) {
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  const auto at = line.find(key);
  std::int64_t number = 0;
  if (at != std::string::npos) std::from_chars(line.data() + at + key.size(), line.data() + line.size(), number);
  return number;
}

/// From the start of the process to the time in its first line of `file`, in ms; and its memory after a second, in MiB.
std::vector<double> first_event(const std::vector<std::string>& command, const std::string& file,
                                const std::string& key, const char* output) {
  ::unlink(file.c_str());
  const std::int64_t begin = realtime_ns();
  const pid_t child = start(command, output);
  const timespec second{1, 0};
  ::nanosleep(&second, nullptr);
  const double resident = resident_kib(child) / 1024;
  wait_for(child);
  const std::int64_t first = first_number(file, key);
  return {static_cast<double>(first - begin) / 1e6, resident};
}

/// Of all its threads, so far.
double wakeups(pid_t child) {
  double sum = 0;
  std::error_code gone;
  for (const auto& task : std::filesystem::directory_iterator("/proc/" + std::to_string(child) + "/task", gone)) {
    std::ifstream status(task.path() / "status");
    for (std::string line; std::getline(status, line);) {
      if (line.starts_with("voluntary_ctxt_switches:")) sum += std::stod(line.substr(24));
    }
  }
  return sum;
}

void bench_wakeups(Report& report, const std::string& program) {
  if (!report.wants("run_wakeups")) return;
  constexpr int ticks = 8;
  std::ofstream("one.json") << R"({"sensors": [{"type": "host", "name": "load", "quantity": "load", "rate": "1 Hz"}]})"
                            << "\n";
  const pid_t child = start({program, "run", "one.json"});
  const timespec begin{1, 500'000'000};  // between two ticks, when it has started
  ::nanosleep(&begin, nullptr);
  const double before = wakeups(child);
  const timespec span{ticks, 0};
  ::nanosleep(&span, nullptr);
  const double after = wakeups(child);
  ::kill(child, SIGTERM);
  if (wait_for(child) != 0) return report.remark("run_wakeups: left out, `rtdata run` fails here");
  Figure figure{.name = "run_wakeups", .unit = "wake-ups/tick", .reach = 2};
  figure.value = (after - before) / ticks;
  figure.limit = 1;
  figure.ratio = figure.value;
  report.add(figure);
}

#ifdef RTDATA_BENCH_SQLITE
struct Twenty {
  std::array<double, 20> values{};
  RTDATA_FIELDS(Twenty, (values))
};

void record_day(const std::string& path) {
  using namespace rtdata;
  constexpr std::int64_t start_ns = 1'700'000'000'000'000'000;  // where a manual loop's time of day begins
  constexpr std::int64_t period_ns = 10'000'000;
  constexpr int rows = 8'640'000;
  Loop loop{Loop::Manual{}};
  const SqliteSink sink(loop, {.path = path});
  Feed<Twenty> feed(loop, {.name = "board"});
  for (int i = 0; i < rows; ++i) {
    Twenty sample;
    for (int j = 0; j < 20; ++j)
      sample.values[static_cast<std::size_t>(j)] = j % 2 == 0 ? i / (7.0 + j) : i % (300 + j) * 1.0;
    feed.publish(sample, Time{Duration{start_ns + i * period_ns}});
    if (i % 1000 == 999) loop.advance(Duration{1000 * period_ns});
  }
  feed.close();
  loop.close();
}

void bench_report(Report& report, const std::string& program) {
  if (!report.wants("report")) return;
  record_day("day.db");
  report.add(measure_pair(
      {.name = "report", .unit = "CPU s", .reach = 1.2},
      [&] {
        return cpu_seconds(start({program, "report", "day.db", "-o", "day.html", "--overwrite"}));
      },
      [&] {
        return cpu_seconds(start({program, "verify", "day.db"}));
      },
      3));
  report.remark("report: the page has " + std::to_string(std::filesystem::file_size("day.html")) +
                " bytes, of a recording of " + std::to_string(std::filesystem::file_size("day.db")));
}
#else
void bench_report(Report&, const std::string&) {}
#endif

}  // namespace

void bench_program(Report& report) {
  if (!report.wants("start") && !report.wants("rss") && !report.wants("run_wakeups") && !report.wants("report")) return;
  const std::string& name = report.options().program;
  if (name.empty() || ::access(name.c_str(), X_OK) != 0) {
    report.remark("start, rss, run_wakeups, report: left out, there is no program " +
                  (name.empty() ? "given (--program FILE)" : name));
    return;
  }
  const std::string program = std::filesystem::absolute(name).string();
  const std::string bare = beside("rtdata_bench_bare");
  const Folder folder(report.options().memory);
  bench_wakeups(report, program);
  bench_report(report, program);
  if (!report.wants("start") && !report.wants("rss")) return;
  if (wait_for(start({program, "init", "demo.json"})) != 0 ||
      wait_for(start({program, "run", "demo.json", "--for", "100ms"})) != 0) {
    report.remark("start, rss: left out, `rtdata init` or `rtdata run` fails here");
    return;
  }
  const auto figures = measure_pairs(
      {{.name = "start", .unit = "ms", .reach = 2}, {.name = "rss", .unit = "MiB", .reach = 2}},
      [&] {
        return first_event({program, "run", "demo.json", "--for", "1200ms"}, "demo.jsonl", "\"time\":", "/dev/null");
      },
      [&] {
        return first_event({bare, "demo.db"}, "bare.txt", "first ", "bare.txt");
      },
      7);
  for (const Figure& figure : figures) {
    if (report.wants(figure.name)) report.add(figure);
  }
}

}  // namespace bench
