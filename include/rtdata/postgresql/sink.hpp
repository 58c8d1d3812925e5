/// PostgresqlSink: events into tables of a PostgreSQL server, each exactly once.
///
///     rtdata::PostgresqlSink server(loop, {.url = "postgresql://rt@db.example/plant?sslmode=verify-full",
///                                          .sink = {.through = "run.db"}});
///
/// One table per topic, named as the topic, made by the sink: `time` (UTC), `time_ns` (exact, as recorded), `run`,
/// `origin`, `sequence`, then one column per field, with units as comments. COPY inserts the rows, in one transaction
/// with the position of each origin on the server (rtdata_position). After any failure on either side, the sink reads
/// the position again and does not send rows that the server already has. docs/postgresql.md has the layout.
///
/// While the server is away events wait: in the sink's queue, or, with `through`, in the recording of that name. With
/// `through` it also sends the account of the recording, so that `rtdata verify postgresql://...` can check the
/// server's rows against it.
///
/// The sink opens its connection with its first batch and again after every failure. If the server cannot store now (it
/// is away, full or read-only, or a table is locked or belongs to someone else), the sink reports it and tries again. A
/// row that is refused by a constraint, trigger or computed column of the table is dropped as refused; the others are
/// stored. Reports never contain passwords.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's; libpq is called on the sink's lane, and
/// never waits longer than `timeout`. Errors of the constructor (SetupError): bad-argument (an invalid URL, or a
/// password in it), those of `Sink`.
#pragma once

#include <string>

#include "rtdata/data/parameter.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata {

class ConfigItem;
class Problems;

struct PostgresqlConfig {
  static constexpr bool is_sender = true;  ///< its peer is across a network
  std::string url = {};                    ///< postgresql://user@host:port/database?sslmode=...; the others add to it
  std::string host = {};      ///< a name, an address, or the folder of a Unix socket; libpq's default when empty
  int port = 0;               ///< 0: libpq's default, 5432
  std::string database = {};  ///< empty: libpq's default, the user's name
  std::string user = {};
  std::string password = {};  ///< empty: ~/.pgpass, PGPASSFILE or none
  std::string schema = {};    ///< schema of the tables, made if missing; empty: the first of search_path
  std::string machine = {};   ///< name of this machine on the server; empty: its host name
  Duration timeout = std::chrono::seconds{30};  ///< for connecting, for each answer and for each statement
  /// Larger batches than in other sinks: each is a transaction, which the server syncs to its disk.
  SinkConfig sink = {.batch_rows = 5000};

  friend constexpr auto parameters(type_tag<PostgresqlConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("url", &PostgresqlConfig::url,
                  "postgresql://user@host/database?sslmode=verify-full, without a password"),
        parameter("host", &PostgresqlConfig::host, "name, address, or the folder of a Unix socket"),
        parameter("port", &PostgresqlConfig::port, "0: 5432, or what PGPORT says", range(0, 65535)),
        parameter("database", &PostgresqlConfig::database, "name of the database"),
        parameter("user", &PostgresqlConfig::user, "the user's name on the server"),
        parameter("password", &PostgresqlConfig::password,
                  "as {\"env\": ...} or {\"file\": ...}; default: from ~/.pgpass"),
        parameter("schema", &PostgresqlConfig::schema, "schema of the tables; made if it does not exist"),
        parameter("machine", &PostgresqlConfig::machine, "this machine's name on the server; its host name by default",
                  TextIs::name),
        parameter("timeout", &PostgresqlConfig::timeout, "time limit of each answer of the server", range(100ms, 1h)),
        include_member(&PostgresqlConfig::sink));
  }
  friend void check_config(const PostgresqlConfig& config, const ConfigItem& item, Problems& problems);
};

/// Returns an error for each topic for which the server cannot have a table; `where` is the topic.
std::vector<Error> refused_topics(const PostgresqlConfig& config, std::span<const TopicToRecord> topics);

class PostgresqlSink : public Sink {
 public:
  PostgresqlSink() noexcept = default;
  PostgresqlSink(Loop& loop, PostgresqlConfig config);
};

}  // namespace rtdata
