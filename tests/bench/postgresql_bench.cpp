// pg_rows: what a row costs on its way into a PostgreSQL server, in CPU of this process and in time, over COPY alone of
// the same rows, made before.
#include "harness.hpp"

#ifdef RTDATA_BENCH_POSTGRESQL
#include <libpq-fe.h>

#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include "payloads.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/postgresql/sink.hpp"
#include "rtdata/sensors/feed.hpp"
#include "sinks/postgresql_server.hpp"
#endif

namespace bench {

#ifdef RTDATA_BENCH_POSTGRESQL
namespace {

constexpr unsigned batch_rows = 5000;
constexpr unsigned batches = 16;
constexpr unsigned rows = batch_rows * batches;

struct Finish {
  void operator()(PGconn* connection) const noexcept { PQfinish(connection); }
};
using Client = std::unique_ptr<PGconn, Finish>;

double per_row(std::int64_t nanoseconds) { return static_cast<double>(nanoseconds) / rows; }

/// Some batches ahead are queued, so that neither side waits for the ticker, which comes seldom: its turns are not what
/// is measured.
std::vector<double> sink_rows(sinks::PostgresqlServer& server, const std::string& database) {
  server.sql(database, "DROP SCHEMA IF EXISTS sink CASCADE");
  rtdata::Loop loop;
  rtdata::Feed<Eight> feed(loop, {.name = "chamber", .topic = "test/climate"});
  rtdata::PostgresqlSink sink(loop,
                              {.url = server.url(database), .schema = "sink", .sink = {.batch_rows = batch_rows}});
  std::int64_t cpu = 0, wall = 0;
  unsigned published = 0;
  constexpr unsigned ahead = 4;
  // The first batch makes the connection and the tables; those after it are the first to use the queue's memory.
  constexpr unsigned before = 1 + ahead;
  rtdata::Ticker ticker(loop, std::chrono::milliseconds{20}, [&](const rtdata::Tick&) {
    const auto stored = static_cast<unsigned>(sink.counts().stored / batch_rows);
    if ((published > 0 && stored == 0) || published == before + batches) return;
    if (published == before && stored < before) return;
    if (published == before) {
      cpu = process_cpu_ns();
      wall = monotonic_ns();
    }
    const unsigned end = published < before ? before : before + batches;
    while (published < end && published < stored + ahead) {
      for (unsigned i = 0; i < batch_rows; ++i) feed.publish(reading(i));
      if (published++ == 0) break;
    }
    if (published == before + batches) sink.sync([&] { loop.stop(); });
  });
  loop.run();
  return {per_row(process_cpu_ns() - cpu), per_row(monotonic_ns() - wall)};
}

/// The rows as the sink sends them, with the same key and index.
std::vector<double> bare_rows(sinks::PostgresqlServer& server, const std::string& database) {
  server.sql(database,
             "DROP TABLE IF EXISTS bare; CREATE TABLE bare(\"time\" timestamptz NOT NULL, time_ns bigint NOT NULL, run "
             "bigint NOT NULL, origin text NOT NULL, sequence bigint NOT NULL, a float8, b float8, c float8, d float8, "
             "e float8, f float8, g float8, h float8, PRIMARY KEY(run, origin, sequence, \"time\")); CREATE INDEX ON "
             "bare USING brin(\"time\")");
  const Client client(PQconnectdb(server.url(database).c_str()));
  const auto put = [](std::string& out, std::uint64_t value, int bytes) {
    for (int shift = 8 * (bytes - 1); shift >= 0; shift -= 8) out += static_cast<char>(value >> shift & 0xff);
  };
  std::vector<std::string> made;
  std::uint64_t sequence = 0;
  for (unsigned batch = 0; batch < batches; ++batch) {
    std::string& out = made.emplace_back("PGCOPY\n\xff\r\n\0\0\0\0\0\0\0\0\0", 19);
    for (unsigned i = 0; i < batch_rows; ++i) {
      put(out, 13, 2);
      for (const std::uint64_t number : {std::uint64_t{825'681'600'000'000} + ++sequence, sequence, std::uint64_t{1}}) {
        put(out, 8, 4);
        put(out, number, 8);
      }
      put(out, 7, 4);
      out += "chamber";
      put(out, 8, 4);
      put(out, sequence, 8);
      const Eight values = reading(i);
      std::uint64_t bits[8];
      static_assert(sizeof bits == sizeof values);
      std::memcpy(bits, &values, sizeof bits);
      for (const std::uint64_t one : bits) {
        put(out, 8, 4);
        put(out, one, 8);
      }
    }
    put(out, 0xffff, 2);
  }
  const std::int64_t cpu = process_cpu_ns();
  const std::int64_t wall = monotonic_ns();
  for (const std::string& batch : made) {
    PQclear(PQexec(client.get(), "COPY bare FROM STDIN (FORMAT binary)"));
    PQputCopyData(client.get(), batch.data(), static_cast<int>(batch.size()));
    PQputCopyEnd(client.get(), nullptr);
    while (PGresult* result = PQgetResult(client.get())) PQclear(result);
  }
  return {per_row(process_cpu_ns() - cpu), per_row(monotonic_ns() - wall)};
}

}  // namespace

void bench_postgresql(Report& report) {
  if (!report.wants("pg_rows")) return;
  sinks::PostgresqlServer* const server = sinks::PostgresqlServer::shared();
  if (server == nullptr) return report.remark("pg_rows: left out, " + sinks::PostgresqlServer::why_none());
  const std::string database = server->make_database();
  for (const Figure& figure : measure_pairs(
           {{.name = "pg_rows", .unit = "ns/row", .reach = 1.3},
            {.name = "pg_rows_wall", .unit = "ns/row", .reach = 1.3}},
           [&] { return sink_rows(*server, database); }, [&] { return bare_rows(*server, database); }, 7))
    report.add(figure);
}

#else

void bench_postgresql(Report& report) {
  if (report.wants("pg_rows")) report.remark("pg_rows: left out, this was built without libpq");
}

#endif

}  // namespace bench
