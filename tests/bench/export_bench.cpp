// export_csv: `rtdata export` beside `sqlite3 -csv`, both of one recording, in CPU time of the process.
#include <fcntl.h>
#include <spawn.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <string>
#include <vector>

#include "harness.hpp"
#ifdef RTDATA_BENCH_SQLITE
#include "payloads.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/feed.hpp"
#endif

extern char** environ;

namespace bench {

#ifdef RTDATA_BENCH_SQLITE
namespace {

constexpr int rows = 300'000;
constexpr const char* shell = "/usr/bin/sqlite3";

struct Reading {
  double temperature = 0;
  double humidity = 0;
  double pressure = 0;
  std::int32_t state = 0;
  RTDATA_FIELDS(Reading, (temperature, "Cel"), (humidity, "%RH"), (pressure, "hPa"), (state))
};

/// Two decimals as sensors have them, and all that a double has.
void record(const std::string& path) {
  using namespace rtdata;
  Loop loop{Loop::Manual{}};
  SqliteSink sink(loop, {.path = path});
  Feed<Reading> feed(loop, {.name = "room", .topic = "room/climate"});
  for (int i = 0; i < rows; ++i) {
    feed.publish({.temperature = 20 + (i % 1000) / 100.0,
                  .humidity = 40 + (i % 300) / 10.0,
                  .pressure = 1013.25 + i / 7.0,
                  .state = i % 5});
    if (i % 1000 == 0) loop.advance(std::chrono::milliseconds{10});
  }
  feed.close();
  loop.close();
}

/// CPU ns of a child for each row; 0 when it fails.
double cpu_per_row(const std::vector<std::string>& command) {
  std::vector<char*> arguments;
  for (const std::string& word : command) arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, 1, "/dev/null", O_WRONLY, 0);
  pid_t child = -1;
  const int failed = ::posix_spawn(&child, arguments[0], &actions, nullptr, arguments.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  int status = 0;
  rusage use{};
  if (failed != 0 || ::wait4(child, &status, 0, &use) != child || status != 0) return 0;
  const auto ns = [](const timeval& time) {
    return 1e9 * static_cast<double>(time.tv_sec) + 1e3 * static_cast<double>(time.tv_usec);
  };
  return (ns(use.ru_utime) + ns(use.ru_stime)) / rows;
}

}  // namespace

void bench_export(Report& report) {
  if (!report.wants("export_csv")) return;
  const std::string program = report.options().program;
  if (::access(program.c_str(), X_OK) != 0 || ::access(shell, X_OK) != 0) {
    report.remark("export_csv: left out, there is no program rtdata given (--program FILE), or no " +
                  std::string(shell));
    return;
  }
  const std::string path = report.options().memory + "/rtdata_bench_export." + std::to_string(::getpid()) + ".db";
  record(path);
  const std::string
      query = "SELECT time, origin, sequence, temperature, humidity, pressure, state FROM \"room/climate\"";
  report.add(measure_pair(
      {.name = "export_csv", .unit = "CPU ns/row", .reach = 1.0},
      [&] {
        return cpu_per_row({program, "export", path});
      },
      [&] {
        return cpu_per_row({shell, "-csv", path, query});
      }));
  std::error_code ignored;
  std::filesystem::remove(path, ignored);
}
#else
void bench_export(Report&) {}
#endif

}  // namespace bench
