// Reading back, in CPU time. query_steps: a day at 100 Hz in 1000 steps by Recording::steps, beside one SQL GROUP BY.
// replay_events: events of 1 kHz in virtual time to one handler, beside a loop over the rows.
#include <unistd.h>

#include <filesystem>
#include <stdexcept>
#include <string>

#include "harness.hpp"
#ifdef RTDATA_BENCH_SQLITE
#include <sqlite3.h>

#include "payloads.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/replay.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/feed.hpp"
#endif

namespace bench {

#ifdef RTDATA_BENCH_SQLITE
namespace {

struct Motion {
  double x = 0;
  double y = 0;
  double z = 0;
  RTDATA_FIELDS(Motion, (x, "m/s2"), (y, "m/s2"), (z, "m/s2"))
};

constexpr std::int64_t start_ns = 1'700'000'000'000'000'000;  // where a manual loop's time of day begins
constexpr std::int64_t period_ns = 10'000'000;
constexpr int steps = 1000;

void record(const std::string& path, int rows) {
  using namespace rtdata;
  Loop loop{Loop::Manual{}};
  SqliteSink sink(loop, {.path = path});
  Feed<Motion> feed(loop, {.name = "imu", .topic = "imu"});
  for (int i = 0; i < rows; ++i) {
    feed.publish({.x = i / 7.0, .y = i % 300 / 10.0, .z = 9.81 + i % 11}, Time{Duration{start_ns + i * period_ns}});
    if (i % 1000 == 999) loop.advance(Duration{1000 * period_ns});
  }
  feed.close();
  loop.close();
}

void bench_query_steps(Report& report) {
  constexpr int rows = 8'640'000;
  const std::string path = report.options().memory + "/rtdata_bench_steps." + std::to_string(::getpid()) + ".db";
  record(path, rows);
  const std::int64_t step = rows / steps * period_ns;
  report.add(measure_pair(
      {.name = "query_steps", .unit = "CPU ns/row", .reach = 1.1},
      [&] {
        const std::int64_t begin = process_cpu_ns();
        auto recording = rtdata::Recording::open(path).or_throw();
        auto found = recording.steps({.topic = "imu"}, rtdata::Duration{step}).or_throw();
        double sum = 0;
        while (const rtdata::RecordedRow* row = found.next().or_throw())
          sum += std::get<double>(row->event().value("x.mean").or_throw());
        keep(sum);
        return static_cast<double>(process_cpu_ns() - begin) / rows;
      },
      [&] {
        const std::int64_t begin = process_cpu_ns();
        sqlite3* database = nullptr;
        sqlite3_open_v2(path.c_str(), &database, SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX, nullptr);
        const std::string query = "SELECT time / " + std::to_string(step) +
                                  " AS step, count(*), count(x), min(x), max(x), avg(x), count(y), min(y), max(y), "
                                  "avg(y), count(z), min(z), max(z), avg(z) FROM imu GROUP BY step";
        sqlite3_stmt* statement = nullptr;
        sqlite3_prepare_v2(database, query.c_str(), -1, &statement, nullptr);
        double sum = 0;
        while (sqlite3_step(statement) == SQLITE_ROW) sum += sqlite3_column_double(statement, 5);
        keep(sum);
        sqlite3_finalize(statement);
        sqlite3_close(database);
        return static_cast<double>(process_cpu_ns() - begin) / rows;
      },
      3));
  std::error_code ignored;
  std::filesystem::remove(path, ignored);
}

void bench_replay_events(Report& report) {
  constexpr int rows = 1'000'000;
  const std::string path = report.options().memory + "/rtdata_bench_replay." + std::to_string(::getpid()) + ".db";
  record(path, rows);
  report.add(measure_pair(
      {.name = "replay_events", .unit = "CPU ns/event", .reach = 1.5},
      [&] {
        const std::int64_t begin = process_cpu_ns();
        rtdata::Loop loop{rtdata::Loop::Manual{}};
        double sum = 0;
        int count = 0;
        auto heard = loop.subscribe<Motion>("imu", [&](const rtdata::Event<Motion>& event) {
          sum += event->x;
          ++count;
        });
        rtdata::Replay replay(loop, {.file = path});
        while (!replay.is_done()) loop.advance(std::chrono::hours{1});
        keep(sum);
        if (count != rows) throw std::runtime_error("replay_events: " + std::to_string(count) + " events came");
        return static_cast<double>(process_cpu_ns() - begin) / rows;
      },
      [&] {
        const std::int64_t begin = process_cpu_ns();
        sqlite3* database = nullptr;
        sqlite3_open_v2(path.c_str(), &database, SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX, nullptr);
        sqlite3_stmt* statement = nullptr;
        sqlite3_prepare_v2(database, "SELECT time, origin, sequence, x, y, z FROM imu WHERE run = 1 ORDER BY rowid", -1,
                           &statement, nullptr);
        double sum = 0;
        while (sqlite3_step(statement) == SQLITE_ROW) {
          const Motion motion{sqlite3_column_double(statement, 3), sqlite3_column_double(statement, 4),
                              sqlite3_column_double(statement, 5)};
          keep(motion);
          keep(sqlite3_column_int64(statement, 0));
          keep(sqlite3_column_text(statement, 1));
          keep(sqlite3_column_int64(statement, 2));
          sum += motion.x;
        }
        keep(sum);
        sqlite3_finalize(statement);
        sqlite3_close(database);
        return static_cast<double>(process_cpu_ns() - begin) / rows;
      },
      5));
  std::error_code ignored;
  std::filesystem::remove(path, ignored);
}

}  // namespace

void bench_retrieval(Report& report) {
  if (report.wants("query_steps")) bench_query_steps(report);
  if (report.wants("replay_events")) bench_replay_events(report);
}
#else
void bench_retrieval(Report&) {}
#endif

}  // namespace bench
