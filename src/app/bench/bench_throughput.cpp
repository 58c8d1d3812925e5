#include <stdlib.h>

#include <algorithm>
#include <filesystem>
#include <thread>

#ifdef RTDATA_WITH_SQLITE
#include <sqlite3.h>

#include "rtdata/sinks/sqlite.hpp"
#include "sinks/sqlite/live_file.hpp"
#endif
#include "app/bench/bench_measure.hpp"
#include "rtdata/data/describe.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;
using SteadyClock = std::chrono::steady_clock;

double seconds_of(Duration duration) { return std::chrono::duration<double>(duration).count(); }

struct BenchSample {
  double a = 0, b = 0, c = 0, d = 0;
  RTDATA_FIELDS(BenchSample, (a, "V"), (b, "V"), (c, "V"), (d, "V"))
};

/// Batches of events are handed over while another program may have the processor: that is no fault to tell of.
const Loop::Config unwatched{.hold_limit = std::chrono::hours{1}};

}  // namespace

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
    throw_if_interrupted();
    for (int i = 0; i < 500; ++i) topic.publish({static_cast<double>(i), 1, 2, 3});
    loop.poll();
  }
  const double result = static_cast<double>(seen) / seconds_of(SteadyClock::now() - begin);
  return sum > 0 ? result : 0;
}

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
    throw_if_interrupted();
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

#ifdef RTDATA_WITH_SQLITE
namespace {

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

constexpr std::size_t rows_per_commit = 500;
constexpr const char* database_name = "/rtdata.db";

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
  loop.on_error([](const ErrorReport&) {});  // the sink's health tells it
  SqliteSink sink(loop, {.path = folder + database_name});
  const auto topic = loop.topic<BenchSample>("bench");
  const auto publish = [&](std::size_t rows) {
    for (std::size_t i = 0; i < rows; ++i) topic.publish({static_cast<double>(i), 1, 2, 3});
  };
  const auto is_good = [&] {
    if (failed.empty() && sink.health() != Health::ok) failed = loop.runtime().sinks().front().reason;
    return failed.empty();
  };
  const auto wait_until_at_most = [&](std::uint64_t queued) {
    while (sink.counts().queued > queued && is_good()) {
      throw_if_interrupted();
      loop.run_for(std::chrono::microseconds{100});
    }
  };
  constexpr std::uint64_t waiting = 160 * rows_per_commit;  // 4 MiB: some transactions
  const auto begin = SteadyClock::now();
  while (SteadyClock::now() - begin < duration * 2 / 3 && is_good()) {
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
  while (SteadyClock::now() - begin_single < duration / 3 && is_good()) {
    const auto from = SteadyClock::now();
    publish(rows_per_commit);
    sink.flush();
    wait_until_at_most(0);
    commits.push_back(seconds_of(SteadyClock::now() - from));
  }
  is_good();
  loop.close(std::chrono::seconds{1});
  const std::uint64_t dropped = loop.runtime().sinks().front().counts.all_dropped();
  if (!failed.empty()) return {{"error", failed}, {"dropped", dropped}};
  Json json = stored_json(rows_per_second, commits);
  json["dropped"] = dropped;
  return json;
}

/// Whether this process has a file in the folder open, a removed one too.
bool uses(const std::string& folder) {
  std::error_code ignored;
  for (std::filesystem::directory_iterator entry("/proc/self/fd", ignored), end; !ignored && entry != end;
       entry.increment(ignored)) {
    std::error_code closed;
    if (std::filesystem::read_symlink(entry->path(), closed).string().starts_with(folder + "/")) return true;
  }
  return false;
}

/// A sink that could not store goes on trying when its deadline of closing passes, on a thread that is left behind:
/// until that has ended, too, its files take room and are no other's to remove. Nothing tells when they are closed: it
/// is looked for. False: they are not after a minute.
bool wait_until_closed(const std::string& folder) {
  const auto end = SteadyClock::now() + std::chrono::minutes{1};
  while (uses(folder)) {
    if (SteadyClock::now() >= end) return false;
    throw_if_interrupted();
    std::this_thread::sleep_for(std::chrono::milliseconds{10});
  }
  return true;
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
    throw_if_interrupted();
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
  if (!works) return {{"error", "a statement failed"}};
  return stored_json(rows_per_second, commits);
}

}  // namespace

nlohmann::ordered_json measure_storage(const std::string& parent, Duration duration) {
  const TemporaryFolder folder(parent);
  Json json{{"folder", parent}};
  json["rtdata"] = measure_sink(folder.path(), duration / 2);
  if (!wait_until_closed(std::filesystem::absolute(folder.path()).lexically_normal().string())) {
    json["limit"] = {{"error", "not measured: the recording's files were not let go of within a minute"}};
    return json;
  }
  // What a recording that could not be closed leaves for the next run, of which there will be none.
  sqlite::LiveFile::remove_left(folder.path() + database_name);
  json["limit"] = measure_bare_sqlite(folder.path(), duration / 2);
  return json;
}
#endif

}  // namespace rtdata::app
