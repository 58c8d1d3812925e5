// checksum: what the checksum of a row costs of all that storing it does. steps_stored: what a row costs with the steps
// beside it, over one without. verify_rows: what verifying a row costs.
#include <array>
#include <chrono>
#include <string>
#include <vector>

#include "harness.hpp"

#ifdef RTDATA_BENCH_SQLITE
#include <sqlite3.h>

#include "bare.hpp"
#include "payloads.hpp"
#include "recording/checksum.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/recording/verify.hpp"
#include "rtdata/sensors/feed.hpp"
#endif

namespace bench {

#ifdef RTDATA_BENCH_SQLITE

namespace {

using namespace std::chrono_literals;

constexpr unsigned rows = 100'000;
constexpr unsigned rows_at_once = 500;

/// CPU time a row, stored in virtual time, so that nothing sleeps.
double stored_row(const std::string& path) {
  rtdata::Loop loop{rtdata::Loop::Manual{}};
  rtdata::SqliteSink sink(loop, {.path = path});
  rtdata::Feed<Eight> feed(loop, {.name = "chamber", .topic = "test/climate"});
  unsigned i = 0;
  rtdata::Ticker ticker(loop, 10ms, [&](const rtdata::Tick&) {
    for (unsigned left = i < rows ? rows_at_once : 0; left > 0; --left) feed.publish(reading(i++));
  });
  const std::int64_t begin = process_cpu_ns();
  loop.advance(10ms * (rows / rows_at_once));
  const std::int64_t end = process_cpu_ns();
  ticker.close();
  loop.close();
  return static_cast<double>(end - begin) / rows;
}

/// CPU time a row of eight sensors at `rate`, in virtual time, with all that a second's transaction writes beside them.
double sensors_row(const std::string& path, rtdata::Rate rate, bool has_steps) {
  rtdata::Loop loop{rtdata::Loop::Manual{}};
  rtdata::SqliteSink sink(loop, {.path = path, .steps = has_steps});
  std::vector<rtdata::Feed<Eight>> feeds;
  for (const char* name : {"a", "b", "c", "d", "e", "f", "g", "h"})
    feeds.emplace_back(loop, rtdata::FeedConfig{.name = name});
  unsigned i = 0;
  rtdata::Ticker ticker(loop, rate.period(), [&](const rtdata::Tick&) {
    for (rtdata::Feed<Eight>& feed : feeds) feed.publish(reading(i++));
  });
  const std::int64_t begin = process_cpu_ns();
  loop.advance(rate.period() * (rows / feeds.size()));
  const std::int64_t end = process_cpu_ns();
  ticker.close();
  loop.close();
  return static_cast<double>(end - begin) / rows;
}

/// What the sink does more for the checksum of such a row. In the sink, SQLite works between the values of a row: none
/// waits for the one before to be written. So here many rows are gathered before the first is hashed.
double hashed_row() {
  const std::string origin = "chamber";
  constexpr unsigned at_once = 50;
  std::array<rtdata::sqlite::RowHash, at_once> hashes;
  std::uint64_t sum = 0;
  const std::int64_t begin = process_cpu_ns();
  for (unsigned first = 0; first < rows; first += at_once) {
    for (unsigned i = first; i < first + at_once; ++i) {
      rtdata::sqlite::RowHash& hash = hashes[i - first];
      const Eight row = reading(i);
      hash.begin();
      hash.integer(1);
      hash.integer(1'772'366'400'000'000'000 + i);
      hash.text(origin);
      hash.integer(i);
      for (const double value : {row.a, row.b, row.c, row.d, row.e, row.f, row.g, row.h}) hash.real(value);
    }
    for (const rtdata::sqlite::RowHash& hash : hashes) sum += hash.hash_of_values();
  }
  keep(sum);
  return static_cast<double>(process_cpu_ns() - begin) / rows;
}

double verified_row(const std::string& path) {
  const std::int64_t begin = process_cpu_ns();
  const auto recording = rtdata::Recording::open(path).or_throw();
  const auto report = rtdata::verify(recording).or_throw();
  const std::int64_t end = process_cpu_ns();
  if (report.verdict() != rtdata::Verdict::balanced || report.runs.at(0).values_checked != rows) return 0;
  return static_cast<double>(end - begin) / rows;
}

/// SQLite's own check, and every value read once.
double scanned_row(const std::string& path) {
  sqlite3* database = nullptr;
  if (sqlite3_open_v2(path.c_str(), &database, SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX, nullptr) != SQLITE_OK)
    return 0;
  const std::int64_t begin = process_cpu_ns();
  double sum = 0;
  for (const char* sql : {"PRAGMA quick_check(1)", "SELECT * FROM \"test/climate\""}) {
    sqlite3_stmt* statement = nullptr;
    sqlite3_prepare_v2(database, sql, -1, &statement, nullptr);
    const int columns = sqlite3_column_count(statement);
    while (sqlite3_step(statement) == SQLITE_ROW) {
      for (int i = 0; i < columns; ++i) sum += sqlite3_column_double(statement, i);
    }
    sqlite3_finalize(statement);
  }
  keep(sum);
  const std::int64_t end = process_cpu_ns();
  sqlite3_close(database);
  return static_cast<double>(end - begin) / rows;
}

}  // namespace

void bench_verify(Report& report) {
  const std::string& folder = report.options().memory;
  if (report.wants("checksum")) {
    // The limit is what the row costs without: hashing is taken from it, measured by itself beside each row.
    double with = 0, hashing = 0;
    const auto measure = [&] {
      const Scratch file(folder, "checksum.db");
      hashing = hashed_row();
      with = stored_row(file.path());
    };
    std::vector<Figure> figures = measure_rounds(
        {{.name = "checksum", .unit = "ns/row", .reach = 1.03}},
        [&](int) {
          measure();
          Round round{.value = {with}, .limit = {with - hashing}, .again = {}};
          round.again = round.limit;
          return round;
        },
        9);
    for (Figure& figure : figures) report.add(figure);
  }
  if (report.wants("steps_stored")) {
    using namespace rtdata::literals;
    const auto pairs = [&](rtdata::Rate rate) {
      const auto row = [&](bool has_steps) {
        const Scratch file(folder, "steps.db");
        return sensors_row(file.path(), rate, has_steps);
      };
      return measure_pair(
          {.name = "steps_stored", .unit = "ns/row", .reach = 1.1}, [&] { return row(true); },
          [&] { return row(false); }, 9);
    };
    report.add(pairs(1_kHz));
    for (const rtdata::Rate rate : {100_Hz, 10_Hz}) {
      const Figure slow = pairs(rate);
      report.remark("at " + std::to_string(rate.hertz()) + " Hz: " + std::to_string(slow.value) + " against " +
                    std::to_string(slow.limit) + " ns/row");
    }
  }
  if (report.wants("verify_rows")) {
    const Scratch file(folder, "verify.db");
    stored_row(file.path());
    report.add(measure_pair(
        {.name = "verify_rows", .unit = "ns/row", .reach = 1.5}, [&] { return verified_row(file.path()); },
        [&] { return scanned_row(file.path()); }));
  }
}

#else

void bench_verify(Report&) {}

#endif

}  // namespace bench
