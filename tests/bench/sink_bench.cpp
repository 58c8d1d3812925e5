// sqlite_rows, sqlite_loop, file_jsonl: what a row costs, in all and on the sampling loop.
#include <fcntl.h>
#include <unistd.h>

#include <cstdio>
#include <cstring>
#include <ctime>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#ifdef RTDATA_BENCH_SQLITE
#include <sqlite3.h>

#include "rtdata/recording/sqlite.hpp"
#endif

#include "bare.hpp"
#include "by_hand.hpp"
#include "harness.hpp"
#include "payloads.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sinks/file.hpp"

namespace bench {
namespace {

constexpr unsigned batch_rows = 500;
constexpr unsigned batches = 80;
constexpr unsigned rows = batch_rows * batches;
constexpr rtdata::Duration batch_period = std::chrono::milliseconds{1};

/// Publishes a batch every millisecond: about as fast as one is stored, so that neither side sleeps for long.
class Producer {
 public:
  Producer() : feed_(loop_, {.name = "chamber", .topic = "test/climate"}) {}
  rtdata::Loop& loop() { return loop_; }

  /// All rows, until `stored` says that they are there. Returns the CPU time that publishing took on this thread.
  template <class Stored>
  std::int64_t run(Stored stored) {
    std::int64_t publishing = 0;
    unsigned left = batches;
    rtdata::Ticker ticker(loop_, batch_period, [&](const rtdata::Tick&) {
      if (left == 0) {
        if (stored()) loop_.stop();
        return;
      }
      --left;
      const std::int64_t begin = thread_cpu_ns();
      for (unsigned i = 0; i < batch_rows; ++i) feed_.publish(reading(i));
      publishing += thread_cpu_ns() - begin;
    });
    loop_.run();
    return publishing;
  }

 private:
  rtdata::Loop loop_;
  rtdata::Feed<Eight> feed_;
};

/// Whether all rows are there. The last of them do not wait for their time.
class WhenStored {
 public:
  explicit WhenStored(rtdata::Sink& sink) : sink_(sink) {}
  bool operator()() {
    if (!std::exchange(is_flushed_, true)) sink_.flush();
    return sink_.counts().stored == rows;
  }

 private:
  rtdata::Sink& sink_;
  bool is_flushed_ = false;
};

/// Process CPU time a row, from the first publish until the last is stored.
double stored_cpu(Producer& producer, rtdata::Sink& sink) {
  const std::int64_t begin = process_cpu_ns();
  producer.run(WhenStored(sink));
  return static_cast<double>(process_cpu_ns() - begin) / rows;
}

double file_sink_row(const std::string& folder) {
  const Scratch file(folder, "sink.jsonl");
  Producer producer;
  rtdata::FileSink sink(producer.loop(), {.path = file.path()});
  return stored_cpu(producer, sink);
}

/// The rhythm in which the producer publishes batches: both sides find their caches as cold as pauses leave them.
class Rhythm {
 public:
  void wait() {
    due_ += std::chrono::nanoseconds{batch_period}.count();
    const timespec until{due_ / 1'000'000'000, static_cast<long>(due_ % 1'000'000'000)};
    ::clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr);
  }

 private:
  std::int64_t due_ = monotonic_ns();
};

double file_by_hand_row(const std::string& folder) {
  const Scratch file(folder, "hand.jsonl");
  const int fd = ::open(file.path().c_str(), O_WRONLY | O_CREAT | O_APPEND, 0600);
  std::vector<char> buffer(batch_rows * 1024);
  const std::int64_t begin = process_cpu_ns();
  std::int64_t time = 1'772'366'400'000'000'000;
  std::uint64_t sequence = 0;
  Rhythm rhythm;
  for (unsigned batch = 0; batch < batches; ++batch) {
    rhythm.wait();
    char* to = buffer.data();
    for (unsigned i = 0; i < batch_rows; ++i) to = json_by_hand(to, time += 8000, ++sequence, reading(i));
    for (const char* from = buffer.data(); from < to;) {
      const auto written = ::write(fd, from, static_cast<std::size_t>(to - from));
      if (written <= 0) return 0;
      from += written;
    }
  }
  const std::int64_t end = process_cpu_ns();
  ::close(fd);
  return static_cast<double>(end - begin) / rows;
}

#ifdef RTDATA_BENCH_SQLITE

double sqlite_sink_row(const std::string& folder) {
  const Scratch file(folder, "sink.db");
  Producer producer;
  rtdata::SqliteSink sink(producer.loop(), {.path = file.path()});
  return stored_cpu(producer, sink);
}

/// The same table, settings, batches and rhythm, sixteen rows a statement, the log's checkpoints outside of the
/// commits.
double bare_sqlite_row(const std::string& folder) {
  const Scratch file(folder, "bare.db");
  sqlite3* database = nullptr;
  if (sqlite3_open_v2(file.path().c_str(), &database, SQLITE_OPEN_NOMUTEX | SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE,
                      nullptr) != SQLITE_OK) {
    return 0;
  }
  const auto execute = [&](const char* sql) {
    return sqlite3_exec(database, sql, nullptr, nullptr, nullptr) == SQLITE_OK;
  };
  execute(
      "PRAGMA auto_vacuum=INCREMENTAL; PRAGMA journal_mode=WAL; PRAGMA synchronous=NORMAL; PRAGMA wal_autocheckpoint=0;"
      "PRAGMA journal_size_limit=67108864; PRAGMA temp_store=MEMORY;"
      "CREATE TABLE \"test/climate\"(run INTEGER NOT NULL, time INTEGER NOT NULL, origin TEXT NOT NULL,"
      " sequence INTEGER NOT NULL, a REAL, b REAL, c REAL, d REAL, e REAL, f REAL, g REAL, h REAL)");
  constexpr unsigned most = 16;
  const auto prepare = [&](unsigned count) {
    std::string
        sql = "INSERT OR ROLLBACK INTO \"test/climate\"(run, time, origin, sequence, a, b, c, d, e, f, g, h) VALUES ";
    for (unsigned i = 0; i < count; ++i) sql += i == 0 ? "(?,?,?,?,?,?,?,?,?,?,?,?)" : ",(?,?,?,?,?,?,?,?,?,?,?,?)";
    sqlite3_stmt* statement = nullptr;
    sqlite3_prepare_v3(database, sql.c_str(), -1, SQLITE_PREPARE_PERSISTENT, &statement, nullptr);
    return statement;
  };
  sqlite3_stmt* const many = prepare(most);
  sqlite3_stmt* const one = prepare(1);
  const std::int64_t start = process_cpu_ns();
  std::int64_t time = 1'772'366'400'000'000'000;
  std::int64_t sequence = 0;
  Rhythm rhythm;
  for (unsigned batch = 0; batch < batches; ++batch) {
    rhythm.wait();
    execute("BEGIN");
    for (unsigned i = 0; i < batch_rows;) {
      const unsigned count = batch_rows - i >= most ? most : 1;
      sqlite3_stmt* const statement = count == most ? many : one;
      int at = 0;
      for (unsigned row = 0; row < count; ++row, ++i) {
        const Eight data = reading(i);
        sqlite3_bind_int64(statement, ++at, 1);
        sqlite3_bind_int64(statement, ++at, time += 8000);
        sqlite3_bind_text64(statement, ++at, "chamber", 7, SQLITE_STATIC, SQLITE_UTF8);
        sqlite3_bind_int64(statement, ++at, ++sequence);
        for (const double value : {data.a, data.b, data.c, data.d, data.e, data.f, data.g, data.h})
          sqlite3_bind_double(statement, ++at, value);
      }
      if (sqlite3_step(statement) != SQLITE_DONE) return 0;
      sqlite3_reset(statement);
    }
    execute("COMMIT");
    if (batch % 20 == 19) sqlite3_wal_checkpoint_v2(database, nullptr, SQLITE_CHECKPOINT_PASSIVE, nullptr, nullptr);
  }
  const std::int64_t end = process_cpu_ns();
  sqlite3_finalize(many);
  sqlite3_finalize(one);
  sqlite3_close(database);
  return static_cast<double>(end - start) / rows;
}

/// What a recording adds to publishing: a run with it less a run without.
double sqlite_loop_row(const std::string& folder) {
  std::int64_t without = 0;
  {
    Producer producer;
    without = producer.run([] { return true; });
  }
  const Scratch file(folder, "loop.db");
  Producer producer;
  rtdata::SqliteSink sink(producer.loop(), {.path = file.path()});
  const std::int64_t with = producer.run(WhenStored(sink));
  return static_cast<double>(with - without) / rows;
}

/// The payload into a slot of a ring that is as long as a batch.
double ring_copy() {
  struct Slot {
    std::uint32_t number, bytes;
    std::int64_t time;
    std::uint64_t sequence;
    Eight payload;
  };
  static std::vector<Slot> ring(batch_rows);
  constexpr unsigned rounds = 10;
  std::int64_t time = 0;
  const std::int64_t begin = thread_cpu_ns();
  for (unsigned i = 0; i < rounds * batches; ++i) {
    for (unsigned n = 0; n < batch_rows; ++n) {
      Eight payload = reading(n);
      keep(payload);
      const Slot slot{0, sizeof slot, ++time, n, {}};
      std::memcpy(static_cast<void*>(&ring[n]), &slot, offsetof(Slot, payload));
      std::memcpy(static_cast<void*>(&ring[n].payload), &payload, sizeof payload);
      keep(ring[n]);
    }
  }
  const std::int64_t with = thread_cpu_ns() - begin;
  const std::int64_t again = thread_cpu_ns();
  for (unsigned i = 0; i < rounds * batches; ++i) {
    for (unsigned n = 0; n < batch_rows; ++n) {
      Eight payload = reading(n);
      keep(payload);
    }
  }
  const std::int64_t without = thread_cpu_ns() - again;
  return static_cast<double>(with - without) / (rounds * rows);
}

void bench_sqlite(Report& report) {
  const std::string& folder = report.options().memory;
  if (report.wants("sqlite_rows")) {
    const auto pairs = [](const std::string& where) {
      return measure_pair(
          {.name = "sqlite_rows", .unit = "ns/row", .reach = 1.1}, [&] { return sqlite_sink_row(where); },
          [&] { return bare_sqlite_row(where); }, 9);
    };
    report.add(pairs(folder));
    const Figure disk = pairs(report.options().disk);
    report.remark("on the disk: " + std::to_string(disk.value) + " against " + std::to_string(disk.limit) + " ns/row");
  }
  if (report.wants("sqlite_loop")) {
    report.add(measure_pair(
        {.name = "sqlite_loop", .unit = "ns/row", .reach = 3}, [&] { return sqlite_loop_row(folder); }, ring_copy, 15));
  }
}

#else

void bench_sqlite(Report& report) {
  if (report.wants("sqlite_rows") || report.wants("sqlite_loop"))
    report.remark("sqlite_rows, sqlite_loop: left out, this was built without SQLite");
}

#endif

}  // namespace

void bench_sinks(Report& report) {
  bench_sqlite(report);
  if (!report.wants("file_jsonl")) return;
  const auto pairs = [](const std::string& where) {
    return measure_pair(
        {.name = "file_jsonl", .unit = "ns/row", .reach = 1.2}, [&] { return file_sink_row(where); },
        [&] { return file_by_hand_row(where); }, 9);
  };
  report.add(pairs(report.options().memory));
  const Figure disk = pairs(report.options().disk);
  report.remark("on the disk: " + std::to_string(disk.value) + " against " + std::to_string(disk.limit) + " ns/row");
}

}  // namespace bench
