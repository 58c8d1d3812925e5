/// Recordings for the tests: made by a real sink on a manual loop, then changed by SQL.
#pragma once

#include <doctest/doctest.h>
#include <sqlite3.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <map>
#include <string>

#include "data/payloads.hpp"
#include "recording/account_sums.hpp"
#include "recording/database.hpp"
#include "recording/schema.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/recording/verify.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace recordings {

using namespace rtdata;
using namespace rtdata::literals;
using payloads::Climate;
using payloads::Everything;

/// A folder that is gone with the object.
class Folder {
 public:
  Folder() {
    std::string name = std::filesystem::temp_directory_path() / "rtdata-XXXXXX";
    REQUIRE(::mkdtemp(name.data()) != nullptr);
    path_ = name;
  }
  Folder(const Folder&) = delete;
  ~Folder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  std::string operator/(const std::string& name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

inline void sql(const std::string& path, const std::string& statements) {
  auto database = sqlite::Database::open(path, sqlite::Database::Mode::write);
  database.execute(statements);
}

inline std::int64_t number(const std::string& path, const std::string& query) {
  return sqlite::Database::open(path, sqlite::Database::Mode::read).integer(query);
}

inline VerifyReport verified(const std::string& path) { return verify(Recording::open(path).or_throw()).or_throw(); }

/// Makes all checksums those of what is there: as if it had been written so, by a recorder that made a mistake.
inline void write_checksums(const std::string& path) {
  auto database = sqlite::Database::open(path, sqlite::Database::Mode::write);
  database.execute("BEGIN; UPDATE rtdata_checksum SET sum = 0; UPDATE rtdata_run SET \"checksum~\" = 0");
  const auto all_of = [&](const std::string& query) {
    std::vector<std::string> found;
    auto statement = database.prepare(query);
    while (statement.step()) found.emplace_back(statement.text(0));
    return found;
  };
  sqlite::AccountSums sums;
  for (const std::string& run : all_of("SELECT run FROM rtdata_run")) sums.add_run(database, std::stoll(run));
  for (const std::string& table : all_of("SELECT table_name FROM rtdata_topic")) {
    sums.add_topic(database, table);
    const auto columns = sqlite::columns_of(database, table);
    if (std::find(columns.begin(), columns.end(), sqlite::checksum_column) == columns.end()) continue;
    sqlite::RowHash hash;
    std::map<std::int64_t, std::uint64_t> ends;  // by row number
    std::uint64_t sum = 0;
    std::int64_t last = 0;
    auto row = database.prepare("SELECT rowid, * FROM " + sqlite::quoted(table) + " ORDER BY rowid");
    while (row.step()) {
      hash.begin();
      for (std::size_t i = 0; i < columns.size(); ++i) {
        if (columns[i] != sqlite::checksum_column) hash.column(row.raw(), static_cast<int>(i) + 1);
      }
      sum += hash.hash_of_values();
      last = row.integer(0);
      if (!row.is_null(sqlite::columns_before_fields)) ends[last] = std::exchange(sum, 0);
    }
    if (sum != 0) ends[last] = sum;
    auto update = database.prepare("UPDATE " + sqlite::quoted(table) + " SET " +
                                   sqlite::quoted(sqlite::checksum_column) + " = ? WHERE rowid = ?");
    for (const auto& [number, of] : ends) update.bind(1, static_cast<std::int64_t>(of)).bind(2, number).run();
  }
  sums.write(database);
  database.execute("COMMIT");
}

/// Of the topic that make() records.
inline const std::string drop_steps =
    "DROP TABLE \"room/climate~1s\"; DROP TABLE \"room/climate~1min\";"
    "UPDATE rtdata_ledger SET seconds_from = 0, minutes_from = 0;";

/// Changes a recording, and makes its checksums fit.
inline void written_as(const std::string& path, const std::string& statements) {
  sql(path, statements);
  write_checksums(path);
}

/// All problems, a line each.
inline std::string problems_of(const VerifyReport& report) {
  std::string all;
  for (const std::string& problem : report.problems) all += problem + "\n";
  for (const RunReport& run : report.runs) {
    for (const std::string& problem : run.problems) all += problem + "\n";
  }
  return all;
}

inline VerifyReport check_balanced(const std::string& path) {
  VerifyReport report = verified(path);
  INFO(problems_of(report));
  CHECK(report.verdict() == Verdict::balanced);
  return report;
}

/// The next start, which seals what is there.
inline void start_again(const std::string& path) {
  Loop loop{Loop::Manual{}};
  loop.runtime().on_log([](const LogRecord&) {});
  SqliteSink sink(loop, {.path = path});
  CHECK(loop.close() == 0);
}

inline Everything full() {
  Everything e = payloads::full();
  e.numbers[1] = std::numeric_limits<float>::infinity();
  e.maybes[0] = std::nullopt;
  return e;
}

/// 10 s of room/climate at 100 Hz (2 failed from tick 100 on, 4 missed after tick 500): 999 rows and a few events of a
/// feed.
inline std::string make(const Folder& folder, const std::function<void(Feed<Everything>&)>& feed_events = {},
                        const std::string& name = "run.db") {
  const std::string path = folder / name;
  Loop loop{Loop::Manual{}};
  loop.on_error([](const ErrorReport&) {});
  SqliteSink sink(loop, {.path = path});
  std::int64_t tick = 0;
  Sensor<Climate> room(loop, {.name = "room", .topic = "room/climate", .rate = 100_Hz}, [&]() -> Result<Climate> {
    ++tick;
    if (tick > 100 && tick <= 102) return Error{Errc::io_failed, "no answer", "", "", ""};
    if (tick == 500) loop.manual_clock().pass(55ms);
    return Climate{static_cast<double>(tick), 40};
  });
  Feed<Everything> feed(loop, {.name = "program feed", .topic = "every/thing"});
  loop.advance(5s);
  if (feed_events) {
    feed_events(feed);
  } else {
    feed.publish(full());
    feed.publish(Everything{});
  }
  loop.advance(5s);
  room.close();
  feed.close();
  loop.close();
  return path;
}

}  // namespace recordings
