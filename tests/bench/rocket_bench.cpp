// rocket_replay: the whole example of the rocket (examples/rocket) on half an hour on the pad and in the air, as
// `rtdata replay --speed max` does it in a process of its own: reading, derived topics, machine, and the recording of
// all of it; beside it a bare select of the rows. As a remark, the seconds of flight a second.
#ifdef RTDATA_BENCH_SQLITE
#include <fcntl.h>
#include <spawn.h>
#include <sqlite3.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "harness.hpp"

extern char** environ;

namespace bench {
namespace {

constexpr int rows = 100'000;
constexpr double rate = 50;  // Hz

/// Its CPU time in ns; negative: it failed.
double run(std::vector<std::string> command, const std::string& folder) {
  std::vector<char*> arguments;
  for (std::string& word : command) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addchdir_np(&actions, folder.c_str());
  for (const int fd : {1, 2}) posix_spawn_file_actions_addopen(&actions, fd, "/dev/null", O_WRONLY, 0);
  pid_t child = -1;
  if (::posix_spawn(&child, arguments[0], &actions, nullptr, arguments.data(), environ) != 0) child = -1;
  posix_spawn_file_actions_destroy(&actions);
  int status = -1;
  rusage usage{};
  if (child < 0 || ::wait4(child, &status, 0, &usage) != child || status != 0) return -1;
  const auto ns = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) * 1e9 + static_cast<double>(time.tv_usec) * 1e3;
  };
  return ns(usage.ru_utime) + ns(usage.ru_stime);
}

/// Most of it on the pad, then to 3 km and down.
void write_flight(const std::string& path) {
  std::ofstream file(path);
  file.precision(9);
  file << "t,altitude [m],acceleration\n";
  double height = 0;
  double speed = 0;
  std::uint32_t noise = 1;
  for (int i = 0; i < rows; ++i) {
    noise = noise * 1664525u + 1013904223u;
    const double since = (i - rows * 0.8) / rate;
    double felt = 1;
    if (since > 0) {
      felt = since < 3 ? 9 : speed > 0 || height <= 0 ? -1e-5 * speed * speed : 1;
      if (since > 3 && height <= 0) felt = 1, speed = 0;
      if (since > 3 && speed < -6) speed = -6, felt = 1;
      speed += (felt - 1) * 9.81 / rate;
      height = std::max(0.0, height + speed / rate);
    }
    file << i / rate << ',' << height + static_cast<double>(noise >> 8) / (1 << 24) << ',' << felt << '\n';
  }
}

double select_rows(const std::string& path) {
  const std::int64_t begin = process_cpu_ns();
  sqlite3* database = nullptr;
  sqlite3_open_v2(path.c_str(), &database, SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX, nullptr);
  sqlite3_stmt* statement = nullptr;
  sqlite3_prepare_v2(database, "SELECT time, altitude, acceleration FROM rocket WHERE run = 1 ORDER BY rowid", -1,
                     &statement, nullptr);
  double sum = 0;
  int count = 0;
  for (; sqlite3_step(statement) == SQLITE_ROW; ++count)
    sum += sqlite3_column_double(statement, 1) + sqlite3_column_double(statement, 2) +
           static_cast<double>(sqlite3_column_int64(statement, 0));
  keep(sum);
  sqlite3_finalize(statement);
  sqlite3_close(database);
  return count == rows ? static_cast<double>(process_cpu_ns() - begin) / rows : 0;
}

}  // namespace

void bench_rocket(Report& report) {
  if (!report.wants("rocket_replay")) return;
  const std::string folder = std::filesystem::absolute(report.options().memory).string() + "/rtdata_bench_rocket." +
                             std::to_string(::getpid());
  std::filesystem::create_directory(folder);
  std::filesystem::copy_file(RTDATA_BENCH_ROCKET, folder + "/rocket.json");
  write_flight(folder + "/flight.csv");
  const std::string program = std::filesystem::absolute(report.options().program).string();
  std::error_code ignored;
  if (run({program, "import", "flight.csv", "--time", "t", "--topic", "rocket", "--origin", "rocket", "--into",
           "flight.db"},
          folder) < 0) {
    report.remark("rocket_replay: the flight cannot be imported: is " + program + " the program?");
    std::filesystem::remove_all(folder, ignored);
    return;
  }
  bool has_failed = false;
  const Figure figure = measure_pair(
      {.name = "rocket_replay", .unit = "CPU ns/row", .reach = 0},
      [&] {
        std::filesystem::remove(folder + "/rocket.db", ignored);
        const double ns = run({program, "replay", "flight.db", "rocket.json", "--speed", "max"}, folder);
        has_failed = has_failed || ns < 0;
        return ns / rows;
      },
      [&] { return select_rows(folder + "/flight.db"); }, 3);
  std::filesystem::remove_all(folder, ignored);
  if (has_failed) return report.remark("rocket_replay: the replay failed");
  report.add(figure);
  std::array<char, 120> text{};
  std::snprintf(text.data(), text.size(), "rocket_replay: %.0f s of flight a second at %.0f rows/s; select alone %.0f",
                1e9 / (figure.value * rate), rate, 1e9 / (figure.limit * rate));
  report.remark(text.data());
}

}  // namespace bench
#else
#include "harness.hpp"
namespace bench {
void bench_rocket(Report&) {}
}  // namespace bench
#endif
