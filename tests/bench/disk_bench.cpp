// disk_1hz, disk_10_topics, disk_10khz, disk_card: bytes written (wchar of this process) in virtual time. limit_held:
// how large a recording with a limit becomes, in real time.
#include <sys/stat.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#ifdef RTDATA_BENCH_SQLITE
#include <sqlite3.h>

#include "rtdata/recording/sqlite.hpp"
#endif

#include "bare.hpp"
#include "harness.hpp"
#include "payloads.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace bench {

#ifdef RTDATA_BENCH_SQLITE

namespace {

using namespace std::chrono_literals;

/// Bytes that this process has passed to write and its kin.
std::uint64_t bytes_written() {
  std::FILE* file = std::fopen("/proc/self/io", "r");
  if (file == nullptr) return 0;
  unsigned long long bytes = 0;
  char line[128];
  while (std::fgets(line, sizeof line, file) != nullptr) {
    if (std::sscanf(line, "wchar: %llu", &bytes) == 1) break;
  }
  std::fclose(file);
  return bytes;
}

struct Load {
  unsigned topics;
  unsigned rate;     // of each, in Hz
  unsigned seconds;  // virtual
  double rows() const { return static_cast<double>(topics) * rate * seconds; }
};

std::string topic_name(unsigned number) { return "bench/topic" + std::to_string(number); }

/// All that a run writes, from its start to its end.
std::uint64_t ours(const std::string& folder, const Load& load, rtdata::SqliteProfile profile) {
  const Scratch file(folder, "disk.db");
  const std::uint64_t before = bytes_written();
  {
    rtdata::Loop loop{rtdata::Loop::Manual{}};
    rtdata::SqliteSink sink(loop, {.path = file.path(), .profile = profile});
    std::vector<rtdata::Sensor<Single>> sensors;
    for (unsigned i = 0; i < load.topics; ++i) {
      sensors.emplace_back(
          loop,
          rtdata::SensorConfig{
              .name = "sensor" + std::to_string(i), .topic = topic_name(i), .rate = rtdata::Rate::hertz(load.rate)},
          [value = 0.0]() mutable { return Single{value += 0.1}; });
    }
    loop.advance(std::chrono::seconds{load.seconds});
    loop.close();
  }
  return bytes_written() - before;
}

/// The same tables and rows, a commit each second, everything as SQLite's authors set it, but for the log.
std::uint64_t bare(const std::string& folder, const Load& load) {
  const Scratch file(folder, "bare.db");
  const std::uint64_t before = bytes_written();
  sqlite3* database = nullptr;
  if (sqlite3_open(file.path().c_str(), &database) != SQLITE_OK) return 0;
  const auto execute = [&](const std::string& sql) {
    return sqlite3_exec(database, sql.c_str(), nullptr, nullptr, nullptr) == SQLITE_OK;
  };
  bool good = execute("PRAGMA journal_mode=WAL; PRAGMA synchronous=NORMAL");
  std::vector<sqlite3_stmt*> inserts(load.topics);
  std::vector<std::string> origins;
  for (unsigned i = 0; i < load.topics; ++i) {
    const std::string table = "\"" + topic_name(i) + "\"";
    good = good && execute("CREATE TABLE " + table +
                           "(run INTEGER NOT NULL, time INTEGER NOT NULL, origin TEXT NOT NULL,"
                           " sequence INTEGER NOT NULL, value REAL)");
    good = good && sqlite3_prepare_v2(database, ("INSERT INTO " + table + " VALUES(1,?,?,?,?)").c_str(), -1,
                                      &inserts[i], nullptr) == SQLITE_OK;
    origins.push_back("sensor" + std::to_string(i));
  }
  std::int64_t sequence = 0;
  for (unsigned second = 0; second < load.seconds && good; ++second) {
    good = execute("BEGIN");
    for (unsigned row = 0; row < load.rate; ++row) {
      ++sequence;
      for (unsigned i = 0; i < load.topics && good; ++i) {
        sqlite3_bind_int64(inserts[i], 1, 1'772'366'400'000'000'000 + sequence * (1'000'000'000 / load.rate));
        sqlite3_bind_text(inserts[i], 2, origins[i].c_str(), -1, SQLITE_STATIC);
        sqlite3_bind_int64(inserts[i], 3, sequence);
        sqlite3_bind_double(inserts[i], 4, 0.1 * static_cast<double>(sequence));
        good = sqlite3_step(inserts[i]) == SQLITE_DONE;
        sqlite3_reset(inserts[i]);
      }
    }
    good = good && execute("COMMIT");
  }
  for (sqlite3_stmt* insert : inserts) sqlite3_finalize(insert);
  sqlite3_close(database);
  return good ? bytes_written() - before : 0;
}

constexpr Load one_hz{1, 1, 4 * 3600};
constexpr Load ten_topics{10, 1, 2 * 3600};
constexpr Load ten_khz{1, 10'000, 60};

void add_bytes(Report& report, Figure figure, std::uint64_t value, std::uint64_t limit, double per) {
  figure.value = static_cast<double>(value) / per;
  figure.limit = static_cast<double>(limit) / per;
  figure.ratio = limit == 0 ? 0 : figure.value / figure.limit;
  report.add(figure);
}

void bench_bytes(Report& report) {
  const std::string& folder = report.options().memory;
  constexpr auto normal = rtdata::SqliteProfile::normal;
  constexpr auto card = rtdata::SqliteProfile::card;
  if (report.wants("disk_1hz")) {
    add_bytes(report, {.name = "disk_1hz", .unit = "B/s", .reach = 1.25}, ours(folder, one_hz, normal),
              bare(folder, one_hz), one_hz.seconds);
  }
  if (report.wants("disk_10_topics")) {
    add_bytes(report, {.name = "disk_10_topics", .unit = "B/s", .reach = 1.15}, ours(folder, ten_topics, normal),
              bare(folder, ten_topics), ten_topics.seconds);
  }
  if (report.wants("disk_10khz")) {
    add_bytes(report, {.name = "disk_10khz", .unit = "B/row", .reach = 1.4}, ours(folder, ten_khz, normal),
              bare(folder, ten_khz), ten_khz.rows());
  }
  if (report.wants("disk_card")) {
    add_bytes(report, {.name = "disk_card", .unit = "B/s", .reach = 0.2, .note = "one topic at 1 Hz"},
              ours(folder, one_hz, card), ours(folder, one_hz, normal), one_hz.seconds);
    add_bytes(report, {.name = "disk_card", .unit = "B/s", .reach = 0.2, .note = "ten topics at 1 Hz"},
              ours(folder, ten_topics, card), ours(folder, ten_topics, normal), ten_topics.seconds);
  }
}

std::uint64_t size_of(const std::string& path) {
  struct stat status {};
  return ::stat(path.c_str(), &status) == 0 ? static_cast<std::uint64_t>(status.st_size) : 0;
}

/// Queries each second, as a dashboard does: all rows that there are, and the account.
class Reader {
 public:
  explicit Reader(const std::string& path) : thread_([this, path] { run(path); }) {}
  Reader(const Reader&) = delete;
  ~Reader() {
    is_ended_ = true;
    thread_.join();
  }
  unsigned queries() const { return queries_; }

 private:
  void run(const std::string& path) {
    settle_other_thread();
    sqlite3* database = nullptr;
    if (sqlite3_open_v2(path.c_str(), &database, SQLITE_OPEN_READONLY, nullptr) == SQLITE_OK) {
      sqlite3_busy_timeout(database, 1000);
      for (int tick = 0; !is_ended_; ++tick) {
        std::this_thread::sleep_for(100ms);
        if (tick % 10 != 9) continue;
        if (sqlite3_exec(
                database,
                ("SELECT count(*), avg(value), max(time) FROM \"" + topic_name(0) + "\"; SELECT * FROM rtdata_ledger")
                    .c_str(),
                [](void*, int, char**, char**) { return 0; }, nullptr, nullptr) == SQLITE_OK) {
          ++queries_;
        }
      }
    }
    sqlite3_close(database);
  }
  std::atomic<bool> is_ended_{false};
  std::atomic<unsigned> queries_{0};
  std::thread thread_;
};

void bench_limit(Report& report) {
  constexpr std::uint64_t max_bytes = rtdata::SqliteConfig::least_max_bytes;
  constexpr unsigned rows_a_tick = 20;
  constexpr unsigned ticks = 30'000;  // 30 s at 20 000 rows/s
  const Scratch file(report.options().memory, "limit.db");
  std::uint64_t largest = 0;
  std::uint64_t published = 0;
  unsigned queries = 0;
  rtdata::SinkCounts counts;
  {
    rtdata::Loop loop;
    rtdata::SqliteSink sink(loop, {.path = file.path(), .max_bytes = max_bytes});
    rtdata::Feed<Single> feed(loop, {.name = "feed", .topic = topic_name(0)});
    const auto look = [&] {
      largest = std::max(largest, size_of(file.path()) + size_of(file.path() + "-wal") + size_of(file.path() + "-shm"));
    };
    std::unique_ptr<Reader> reader;
    rtdata::Ticker ticker(loop, 1ms, [&](const rtdata::Tick& tick) {
      if (tick.index >= ticks) return loop.stop();
      for (std::uint64_t i = 0; i < rows_a_tick * (1 + tick.missed); ++i, ++published)
        feed.publish({static_cast<double>(published) * 0.1});
      if (reader == nullptr && tick.index > 2000) reader = std::make_unique<Reader>(file.path());
      look();
    });
    loop.run();
    ticker.close();
    queries = reader != nullptr ? reader->queries() : 0;
    reader.reset();
    feed.close();
    counts = sink.counts();
    loop.close();
    look();
  }
  Figure figure{.name = "limit_held", .unit = "B", .reach = 1, .note = {}};
  figure.value = static_cast<double>(largest);
  figure.limit = 1.1 * static_cast<double>(max_bytes);
  figure.ratio = figure.value / figure.limit;
  figure.note = std::to_string(published) + " rows published, " + std::to_string(counts.all_dropped()) + " dropped, " +
                std::to_string(queries) + " queries";
  report.add(figure);
}

}  // namespace

void bench_disk(Report& report) {
  bench_bytes(report);
  if (report.wants("limit_held")) bench_limit(report);
}

#else

void bench_disk(Report& report) {
  for (const char* name : {"disk_1hz", "disk_10_topics", "disk_10khz", "disk_card", "limit_held"}) {
    if (report.wants(name)) report.remark(std::string(name) + ": left out, this was built without SQLite");
  }
}

#endif

}  // namespace bench
