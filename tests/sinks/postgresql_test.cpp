// Events into a real PostgreSQL server, and what becomes of them when it fails.
#include <doctest/doctest.h>
#include <libpq-fe.h>
#include <poll.h>
#include <sys/mount.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "has.hpp"
#include "postgresql/connection.hpp"
#include "rtdata/postgresql/recording.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/limit.hpp"
#include "sinks/killed.hpp"
#include "sinks/postgresql_server.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;
using sinks::fork_without_threads;
using sinks::PostgresqlServer;

namespace {

struct Number {
  std::int64_t count = 0;
  friend constexpr auto describe(type_tag<Number>) { return record("number", field("count", &Number::count, "1")); }
};
struct Wider {
  std::int64_t count = 0;
  double more = 0;
  friend constexpr auto describe(type_tag<Wider>) {
    return record("number", field("count", &Wider::count, "1"), field("more", &Wider::more, "V"));
  }
};
struct Other {
  double count = 0;
  friend constexpr auto describe(type_tag<Other>) { return record("number", field("count", &Other::count, "1")); }
};

/// A program whose events go to a server, in virtual time: the lane's jobs are done inline.
struct Program {
  explicit Program(PostgresqlConfig config, std::string origin = "pulse") {
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    loop.runtime().on_log([](const LogRecord&) {});
    sink = PostgresqlSink(loop, std::move(config));
    pulse = Sensor<Number>(loop, {.name = std::move(origin), .topic = "plant/number", .rate = 100_Hz},
                           [this] { return Number{++count}; });
  }
  bool told(std::string_view text) const {
    for (const std::string& error : errors) {
      if (error.find(text) != std::string::npos) return true;
    }
    return false;
  }
  std::string all_errors() const {
    std::string text;
    for (const std::string& error : errors) text += error + "\n";
    return text;
  }

  std::vector<std::string> errors;
  std::int64_t count = 0;
  Loop loop{Loop::Manual{}};
  PostgresqlSink sink;
  Sensor<Number> pulse;
};

/// Of the contract that all kinds of sinks keep (sink_contract_test.cpp). A schema each: databases take long to make.
class PostgresqlStore final : public sinks::Store {
 public:
  Sink make(Loop& loop, SinkConfig config) override {
    return PostgresqlSink(loop, {.url = server_.url("postgres"), .schema = schema_, .sink = std::move(config)});
  }
  std::vector<sinks::Row> rows() override {
    std::vector<sinks::Row> all;
    const std::string in = "SET search_path = " + schema_ + ";";
    if (server_.sql("postgres", in + "SELECT coalesce(to_regclass('rtdata_topic')::text, '')").empty()) return all;
    std::istringstream topics(server_.sql("postgres", in + "SELECT topic FROM rtdata_topic ORDER BY topic"));
    for (std::string topic; std::getline(topics, topic);) {
      std::istringstream rows(
          server_.sql("postgres", in + "SELECT sequence || ' ' || value FROM \"" + topic + "\" ORDER BY sequence"));
      sinks::Row row{topic};
      while (rows >> row.sequence >> row.value) all.push_back(row);
    }
    return all;
  }

 private:
  static inline int number_ = 0;
  PostgresqlServer& server_ = *PostgresqlServer::shared();
  std::string schema_ = "store" + std::to_string(++number_);
};
const bool is_added = PostgresqlServer::is_there() &&
                      sinks::add_sink_kind({"PostgreSQL", [] { return std::make_unique<PostgresqlStore>(); }});

using rtdata::test::has;

/// A network between a sink and the server, of Unix sockets. It goes dark for a connection at the first COPY: nothing
/// comes through any more, and neither side hears that it is over.
class DarkNetwork {
 public:
  explicit DarkNetwork(const std::string& server) : server_(server + "/.s.PGSQL.5432") {
    const std::string path = (folder_ / ".s.PGSQL.5432");
    listener_ = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    const sockaddr_un at = address(path);
    REQUIRE(::bind(listener_, reinterpret_cast<const sockaddr*>(&at), sizeof at) == 0);
    REQUIRE(::listen(listener_, 8) == 0);
    thread_ = std::thread([this] { run(); });
  }
  ~DarkNetwork() {
    is_over_ = true;
    thread_.join();
    ::close(listener_);
  }
  DarkNetwork(const DarkNetwork&) = delete;
  DarkNetwork& operator=(const DarkNetwork&) = delete;
  std::string url(const std::string& database) const {
    return "postgresql://rt@/" + database + "?host=" + (folder_ / "");
  }
  void go_dark_at_copy() { goes_dark_ = true; }
  int dark() const { return dark_; }

 private:
  struct Pair {
    int client, server;
    bool is_dark;
  };
  static sockaddr_un address(const std::string& path) {
    sockaddr_un at{};
    at.sun_family = AF_UNIX;
    path.copy(at.sun_path, sizeof at.sun_path - 1);
    return at;
  }
  /// False: it has ended.
  bool pass(Pair& pair, int from, int to) {
    char buffer[1 << 16];
    const ssize_t size = ::recv(from, buffer, sizeof buffer, MSG_DONTWAIT);
    if (size < 0) return errno == EAGAIN;
    if (size == 0) return false;
    const std::string_view text(buffer, static_cast<std::size_t>(size));
    if (::send(to, text.data(), text.size(), MSG_NOSIGNAL) != size) return false;
    if (goes_dark_ && from == pair.client && text.find("COPY ") != text.npos) {
      goes_dark_ = false;
      pair.is_dark = true;
      ++dark_;
    }
    return true;
  }
  void run() {
    std::vector<Pair> pairs;
    while (!is_over_) {
      std::vector<pollfd> ready{{listener_, POLLIN, 0}};
      for (const Pair& pair : pairs) {
        ready.push_back({pair.is_dark ? -1 : pair.client, POLLIN, 0});
        ready.push_back({pair.is_dark ? -1 : pair.server, POLLIN, 0});
      }
      ::poll(ready.data(), ready.size(), 20);
      for (std::size_t i = 0; i < pairs.size(); ++i) {
        Pair& pair = pairs[i];
        bool goes_on = true;
        if (ready[1 + 2 * i].revents != 0 && !pair.is_dark) goes_on = pass(pair, pair.client, pair.server);
        if (goes_on && ready[2 + 2 * i].revents != 0 && !pair.is_dark) goes_on = pass(pair, pair.server, pair.client);
        if (goes_on) continue;
        ::close(std::exchange(pair.client, -1));
        ::close(std::exchange(pair.server, -1));
      }
      std::erase_if(pairs, [](const Pair& pair) { return pair.client < 0; });
      if (ready[0].revents == 0) continue;
      const int client = ::accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
      const int server = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
      const sockaddr_un at = address(server_);
      ::connect(server, reinterpret_cast<const sockaddr*>(&at), sizeof at);
      pairs.push_back({client, server, false});
    }
    for (const Pair& pair : pairs) {
      ::close(pair.client);
      ::close(pair.server);
    }
  }

  recordings::Folder folder_;
  std::string server_;
  int listener_ = -1;
  std::atomic<bool> is_over_ = false, goes_dark_ = false;
  std::atomic<int> dark_ = 0;
  std::thread thread_;
};

/// One that records, and whose sink goes through the recording.
struct Node {
  Node(const std::string& path, PostgresqlConfig config) {
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    loop.runtime().on_log([](const LogRecord&) {});
    recording = SqliteSink(loop, {.path = path, .sink = {.name = "recording"}});
    sink = PostgresqlSink(loop, std::move(config));
    pulse = Sensor<Number>(loop, {.name = "pulse", .topic = "plant/number", .rate = 100_Hz},
                           [this] { return Number{++count}; });
    // One whose reads fail now and then, so that there are gaps.
    shaky = Sensor<Number>(loop, {.name = "shaky", .topic = "plant/shaky", .rate = 10_Hz}, [this]() -> Result<Number> {
      if (++tries % 50 > 2) return Number{tries};
      return Error{Errc::io_failed, "cannot read", "shaky", "it shakes", ""};
    });
  }
  std::string all_errors() const {
    std::string text;
    for (const std::string& error : errors) {
      if (error.find("it shakes") == std::string::npos) text += error + "\n";
    }
    return text;
  }
  std::vector<std::string> errors;
  std::int64_t count = 0, tries = 0;
  Loop loop{Loop::Manual{}};
  SqliteSink recording;
  PostgresqlSink sink;
  Sensor<Number> pulse, shaky;
};

/// No event is missing or there twice, and rtdata_position says the same as the rows. Returns how many there are.
std::int64_t check_once(PostgresqlServer& server, const std::string& database) {
  const std::int64_t rows = server.number(database, "SELECT count(*) FROM \"plant/number\"");
  CHECK(server.number(database, "SELECT count(DISTINCT (run, origin, sequence)) FROM \"plant/number\"") == rows);
  const char* const of_topic = " FROM rtdata_position WHERE topic = 'plant/number'";
  CHECK(server.number(database, std::string("SELECT coalesce(sum(rows), 0)") + of_topic) == rows);
  CHECK(server.number(database,
                      std::string("SELECT coalesce(sum(last_sequence - first_sequence + 1), 0)") + of_topic) == rows);
  CHECK(server.number(database, "SELECT count(*) FROM \"plant/number\" WHERE sequence <> count") == 0);
  return rows;
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("FW-4 every event is in the server's table, once, with its time, run, origin and units") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    Program program({.url = server.url(database), .machine = "node1"});
    program.loop.advance(10s);
    program.loop.close();
    CHECK(program.all_errors() == "");
    CHECK(check_once(server, database) == program.count);
    CHECK(program.sink.counts().stored == static_cast<std::uint64_t>(program.count));
    CHECK(server.sql(database, "SELECT DISTINCT machine FROM rtdata_run") == "node1");
    CHECK(server.sql(database, "SELECT DISTINCT origin FROM \"plant/number\"") == "pulse");
    CHECK(server.number(database,
                        "SELECT count(*) FROM \"plant/number\" WHERE extract(epoch FROM \"time\") * 1000000 "
                        "<> time_ns / 1000") == 0);
    CHECK(server.number(database,
                        "SELECT min(time_ns - before) FROM (SELECT time_ns, lag(time_ns) OVER (ORDER BY "
                        "sequence) AS before FROM \"plant/number\") t") == 10'000'000);
    const std::string comment = server.sql(
        database,
        "SELECT col_description('\"plant/number\"'::regclass, attnum) FROM pg_attribute WHERE attrelid = "
        "'\"plant/number\"'::regclass AND attname = 'count'");
    CHECK(comment == "count: int64, unit 1");
    // What TimescaleDB asks of a table that it is to divide by time.
    CHECK(server.number(database,
                        "SELECT count(*) FROM pg_index WHERE indrelid = '\"plant/number\"'::regclass AND indisunique "
                        "AND NOT (SELECT attnum FROM pg_attribute WHERE attrelid = indrelid AND attname = 'time') = "
                        "ANY(indkey)") == 0);
    CHECK(server.sql(database,
                     "SELECT attnotnull FROM pg_attribute WHERE attrelid = '\"plant/number\"'::regclass AND "
                     "attname = 'time'") == "t");
    CHECK(server.number(database, "SELECT count(*) FROM pg_constraint WHERE contype = 'f'") == 0);
  }

  TEST_CASE("FW-4 every kind of value arrives as itself") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    Loop loop{Loop::Manual{}};
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    PostgresqlSink sink(loop, {.url = server.url(database)});
    Feed<payloads::Everything> feed(loop, {.name = "feed", .topic = "all"});
    feed.publish(payloads::full());
    feed.publish(payloads::Everything{});
    payloads::Everything bad;
    bad.name = text<7>("\xff\\xff");
    bad.u64 = 100'000'000;
    bad.f64 = std::numeric_limits<double>::quiet_NaN();
    feed.publish(bad);
    loop.close();
    CHECK(errors.empty());
    const auto at = [&](const char* field, int row) {
      return server.sql(database,
                        std::string("SELECT ") + field + "::text FROM \"all\" WHERE sequence = " + std::to_string(row));
    };
    CHECK(at("flag", 1) == "true");
    CHECK(at("letter", 1) == "\\xe4");
    CHECK(at("letter", 2) == "a");
    CHECK(at("i8", 1) == "-128");
    CHECK(at("i64", 1) == "-9223372036854775808");
    CHECK(at("u8", 1) == "255");
    CHECK(at("u32", 1) == "4294967295");
    CHECK(at("u64", 1) == "18446744073709551615");
    CHECK(at("u64", 2) == "0");
    CHECK(at("u64", 3) == "100000000");
    CHECK(at("f32", 1) == "0.1");
    CHECK(at("f64", 1) == "-0");
    CHECK(at("f64", 3) == "NaN");
    CHECK(at("name", 1) == "a\"\n\xc3\xa4\\");
    CHECK(at("name", 3) == "\\xff\\x5cxff");
    CHECK(at("state", 1) == "broken");
    CHECK(at("maybe", 1) == "5e-324");
    CHECK(at("maybe IS NULL", 2) == "true");
    CHECK(at("maybe_name", 1) == "");
    CHECK(at("maybe_name IS NULL", 2) == "true");
    CHECK(at("\"states[1]\"", 1) == "-9");
    CHECK(at("(\"points[1].x\" = 9007199254740992)", 1) == "true");
    CHECK(at("\"maybes[0]\"", 1) == "7");
  }

  TEST_CASE("FW-4 names longer than the server's are shortened, each to another") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    Loop loop{Loop::Manual{}};
    PostgresqlSink sink(loop, {.url = server.url(database)});
    const std::string name(70, 'n');
    auto description = DescriptionBuilder("long").field(name + "1", Kind::f64).field(name + "2", Kind::f64).build();
    AnyFeed feed(loop, {.name = "feed", .topic = name + "/1"}, *description);
    AnyFeed other(loop, {.name = "other", .topic = name + "/2"}, *description);
    const double values[] = {1, 2};
    feed.publish_bytes(std::as_bytes(std::span(values)));
    other.publish_bytes(std::as_bytes(std::span(values)));
    loop.close();
    CHECK(sink.health() == Health::ok);
    CHECK(server.number(database, "SELECT count(*) FROM rtdata_topic WHERE length(table_name) = 63") == 2);
    CHECK(server.number(database, "SELECT sum(rows) FROM rtdata_position") == 2);
  }

  TEST_CASE("FW-4 a later run with more fields adds columns, one with fewer uses them, another kind gets a new table") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    const auto run = [&](auto payload) {
      Loop loop{Loop::Manual{}};
      PostgresqlSink sink(loop, {.url = server.url(database)});
      Feed<decltype(payload)> feed(loop, {.name = "feed", .topic = "a"});
      feed.publish(payload);
      loop.close();
      CHECK(sink.health() == Health::ok);
    };
    run(Number{1});
    run(Wider{2, 2.5});
    run(Number{3});
    run(Other{4.5});
    run(Wider{5, 5.5});
    CHECK(server.sql(database, "SELECT count || ' ' || coalesce(more::text, 'none') FROM a ORDER BY run") ==
          "1 none\n2 2.5\n3 none\n5 5.5");
    CHECK(server.sql(database, "SELECT count FROM \"a~2\"") == "4.5");
    CHECK(server.number(database, "SELECT count(*) FROM rtdata_topic") == 2);
  }

  TEST_CASE("FW-4 three machines into one server at once: each event once, told apart by machine and run") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    std::vector<std::unique_ptr<Program>> programs;
    for (const char* machine : {"north", "east", "south"})
      programs.push_back(
          std::make_unique<Program>(PostgresqlConfig{.url = server.url(database), .machine = machine}, "pulse"));
    for (int i = 0; i < 10; ++i) {
      for (auto& program : programs) program->loop.advance(700ms);
    }
    for (auto& program : programs) {
      program->loop.close();
      CHECK(program->all_errors() == "");
    }
    check_once(server, database);
    for (std::size_t i = 0; i < programs.size(); ++i) {
      const char* machines[] = {"north", "east", "south"};
      CHECK(server.number(database, std::string("SELECT count(*) FROM \"plant/number\" JOIN rtdata_run USING (run) "
                                                "WHERE machine = '") +
                                        machines[i] + "'") == programs[i]->count);
    }
  }

  TEST_CASE("NFR-1 a server that is absent at the start gets everything later, and no sensor is delayed") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    server.stop(SIGINT);
    Program program({.url = server.url(database)});
    program.loop.advance(20s);
    CHECK(program.sink.health() == Health::faulted);
    CHECK(program.told("cannot connect"));
    server.start();
    program.loop.advance(20s);
    CHECK(program.sink.health() == Health::ok);
    program.loop.close();
    const SensorCounts counts = program.pulse.counts();
    CHECK(counts.missed == 0);
    CHECK(counts.late == 0);
    CHECK(program.count == 4001);
    CHECK(check_once(server, database) == program.count);
  }

  TEST_CASE("NFR-1 a server that crashes and comes back, again and again: each event once") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    Program program({.url = server.url(database)});
    for (int i = 0; i < 3; ++i) {
      program.loop.advance(2500ms);
      server.stop(SIGQUIT);
      program.loop.advance(2500ms);
      CHECK(program.sink.health() == Health::faulted);
      server.start();
    }
    program.loop.advance(20s);
    program.loop.close();
    CHECK(program.told("cannot connect"));
    CHECK(check_once(server, database) == program.count);
  }

  TEST_CASE("NFR-1 a server that closes connections in the middle of transactions: each event once") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    Program program({.url = server.url(database)});
    program.loop.advance(2s);
    // At each row that is the hundredth of its run, once: in the middle of COPY, and at the commit.
    server.sql(database,
               "CREATE TABLE told(sequence bigint);"
               "CREATE FUNCTION end_it() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN "
               "IF nextval('turn') % 3 = 1 THEN PERFORM pg_terminate_backend(pg_backend_pid()); END IF; RETURN NULL; "
               "END $$;"
               "CREATE SEQUENCE turn;"
               "CREATE TRIGGER in_copy AFTER INSERT ON \"plant/number\" FOR EACH STATEMENT EXECUTE FUNCTION end_it();"
               "CREATE CONSTRAINT TRIGGER at_commit AFTER UPDATE ON rtdata_position DEFERRABLE INITIALLY DEFERRED FOR "
               "EACH ROW EXECUTE FUNCTION end_it()");
    program.loop.advance(20s);
    server.sql(database, "DROP TRIGGER in_copy ON \"plant/number\"; DROP TRIGGER at_commit ON rtdata_position");
    program.loop.advance(20s);
    program.loop.close();
    CHECK(program.told("terminating connection"));
    CHECK(check_once(server, database) == program.count);
  }

  TEST_CASE("NFR-1 a table with other columns is told, and nothing is lost") {
    SERVER_OR_SKIP(server);
    SUBCASE("of somebody else") {
      const std::string database = server.make_database();
      server.sql(database, "CREATE TABLE \"plant/number\"(id int, name text)");
      Program program({.url = server.url(database)});
      program.loop.advance(3s);
      CHECK(program.told("a table of this name is there, and rt-data has not made it"));
      CHECK(server.number(database,
                          "SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() AND "
                          "state LIKE 'idle in transaction%'") == 0);  // nor are its locks held
      server.sql(database, "ALTER TABLE \"plant/number\" RENAME TO theirs");
      program.loop.advance(20s);
      program.loop.close();
      CHECK(check_once(server, database) == program.count);
    }
    SUBCASE("of which one was changed") {
      const std::string database = server.make_database();
      Program program({.url = server.url(database)});
      program.loop.advance(3s);
      server.sql(database, "ALTER TABLE \"plant/number\" ALTER COLUMN count TYPE text");
      program.loop.advance(3s);
      CHECK(program.told("its column count is of type text, not bigint"));
      server.sql(database, "ALTER TABLE \"plant/number\" ALTER COLUMN count TYPE bigint USING count::bigint");
      program.loop.advance(20s);
      program.loop.close();
      CHECK(check_once(server, database) == program.count);
    }
    SUBCASE("with one that the user has added") {
      const std::string database = server.make_database();
      Program program({.url = server.url(database)});
      program.loop.advance(3s);
      server.sql(database, "ALTER TABLE \"plant/number\" ADD COLUMN arrived timestamptz DEFAULT now()");
      program.loop.advance(3s);
      program.loop.close();
      CHECK(program.all_errors() == "");
      CHECK(check_once(server, database) == program.count);
    }
  }

  TEST_CASE("NFR-1 rows that a table's constraints refuse are left out one by one, told and counted; all others come") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    Program program({.url = server.url(database)});
    program.loop.advance(3s);
    const std::int64_t before = server.number(database, "SELECT max(count) FROM \"plant/number\"");
    std::string refuse, accept;
    SUBCASE("a CHECK") {
      refuse = "ALTER TABLE \"plant/number\" ADD CONSTRAINT seven CHECK (count % 7 <> 0) NOT VALID";
      accept = "ALTER TABLE \"plant/number\" DROP CONSTRAINT seven";
    }
    SUBCASE("a trigger") {
      refuse =
          "CREATE FUNCTION seven() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN IF NEW.count % 7 = 0 THEN RAISE "
          "EXCEPTION 'no sevens'; END IF; RETURN NEW; END $$;"
          "CREATE TRIGGER seven BEFORE INSERT ON \"plant/number\" FOR EACH ROW EXECUTE FUNCTION seven()";
      accept = "DROP TRIGGER seven ON \"plant/number\"";
    }
    SUBCASE("a computed column that cannot be computed") {
      refuse = "ALTER TABLE \"plant/number\" ADD COLUMN inverse bigint GENERATED ALWAYS AS (CASE WHEN sequence <= " +
               std::to_string(before) + " THEN 0 ELSE 1 / (count % 7) END) STORED";
      accept = "ALTER TABLE \"plant/number\" DROP COLUMN inverse";
    }
    if (refuse.empty()) return;
    server.sql(database, refuse);
    program.loop.advance(5s);
    const std::int64_t until = server.number(database, "SELECT max(count) FROM \"plant/number\"");
    const auto refused = static_cast<std::uint64_t>(until / 7 - before / 7);
    REQUIRE(refused > 10);
    CHECK(program.told("see the table's constraints"));
    CHECK(program.sink.health() == Health::ok);
    CHECK(program.sink.counts().all_dropped() == refused);
    server.sql(database, accept);
    program.loop.advance(2s);
    program.loop.close();
    CHECK(program.sink.counts().stored == static_cast<std::uint64_t>(program.count) - refused);
    const std::int64_t rows = server.number(database, "SELECT count(*) FROM \"plant/number\"");
    CHECK(rows == program.count - static_cast<std::int64_t>(refused));
    CHECK(server.number(database, "SELECT sum(rows) FROM rtdata_position") == rows);
    CHECK(server.number(database, "SELECT count(*) FROM \"plant/number\" WHERE count % 7 = 0 AND count > " +
                                      std::to_string(before) + " AND count <= " + std::to_string(until)) == 0);
  }

  TEST_CASE("NFR-1 rows that the server refuses stay refused when its connection breaks before the others are there") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    DarkNetwork network(server.folder());
    Program program({.url = network.url(database), .timeout = 300ms});
    program.loop.advance(1s);
    server.sql(database, "ALTER TABLE \"plant/number\" ADD CONSTRAINT seven CHECK (count % 7 <> 0) NOT VALID");
    const std::int64_t before = server.number(database, "SELECT max(count) FROM \"plant/number\"");
    for (int i = 0; i < 4; ++i) {
      network.go_dark_at_copy();
      program.loop.advance(5s);
    }
    program.loop.close();
    CHECK(network.dark() == 4);
    const std::int64_t refused = program.count / 7 - before / 7;
    CHECK(program.sink.counts().all_dropped() == static_cast<std::uint64_t>(refused));
    CHECK(server.number(database, "SELECT count(*) FROM \"plant/number\"") == program.count - refused);
  }

  TEST_CASE("NFR-1 a server that is read only, a lock, a full disk: told with what to do, and everything comes later") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    Program program({.url = server.url(database), .timeout = 400ms});
    program.loop.advance(3s);
    SUBCASE("read only") {
      server.sql("postgres", "ALTER DATABASE " + database + " SET default_transaction_read_only = on");
      server.sql("postgres",
                 "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = '" + database + "'");
      program.loop.advance(5s);
      CHECK(program.told("name one that can be written to"));
      server.sql("postgres", "ALTER DATABASE " + database + " SET default_transaction_read_only = off");
      server.sql("postgres",
                 "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = '" + database + "'");
    }
    SUBCASE("a lock held on the table") {
      PGconn* const other = ::PQconnectdb(server.url(database).c_str());
      ::PQclear(PQexec(other, "BEGIN; LOCK TABLE \"plant/number\" IN EXCLUSIVE MODE"));
      program.loop.advance(2s);
      CHECK(program.told("holds a lock on the table"));
      CHECK(program.sink.health() == Health::faulted);
      ::PQfinish(other);
    }
    SUBCASE("the code of a full disk") {
      server.sql(database,
                 "CREATE FUNCTION full_disk() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN RAISE EXCEPTION 'could not "
                 "extend file' USING ERRCODE = '53100'; END $$;"
                 "CREATE TRIGGER no_room BEFORE INSERT ON \"plant/number\" FOR EACH ROW EXECUTE FUNCTION full_disk()");
      program.loop.advance(3s);
      CHECK(program.told("make room on the server"));
      server.sql(database, "DROP TRIGGER no_room ON \"plant/number\"");
    }
    program.loop.advance(20s);
    program.loop.close();
    CHECK(program.sink.health() == Health::ok);
    CHECK(program.pulse.counts().missed == 0);
    CHECK(check_once(server, database) == program.count);
  }

  TEST_CASE("NFR-1 a real full disk: a tablespace in a small tmpfs") {
    SERVER_OR_SKIP(server);
    recordings::Folder folder;
    const std::string disk = server.folder() + "/disk";
    std::filesystem::create_directory(disk);
    if (::mount("none", disk.c_str(), "tmpfs", 0, "size=1m,mode=0777") != 0) {
      MESSAGE("skipped: only root may mount a tmpfs");
      return;
    }
    std::filesystem::create_directory(disk + "/space");
    REQUIRE(::chown((disk + "/space").c_str(), server.user(), static_cast<gid_t>(-1)) == 0);
    server.sql("postgres", "CREATE TABLESPACE small LOCATION '" + disk + "/space'");
    const std::string database = server.make_database();
    server.sql(database, "ALTER DATABASE " + database + " SET default_tablespace = small");
    Program program({.url = server.url(database)});
    program.loop.advance(300s);
    CHECK(program.told("make room on the server"));
    CHECK(program.told("53100"));
    REQUIRE(::mount("none", disk.c_str(), "tmpfs", MS_REMOUNT, "size=64m") == 0);
    program.loop.advance(20s);
    program.loop.close();
    CHECK(check_once(server, database) == program.count);
    server.sql("postgres", "DROP DATABASE " + database + " WITH (FORCE)");
    server.sql("postgres", "DROP TABLESPACE small");
    ::umount(disk.c_str());
  }

  TEST_CASE("NFR-1 a wrong password, a database that is not there, an encoding: told, without the password") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    SUBCASE("wrong password") {
      server.sql(database, "CREATE ROLE guarded LOGIN PASSWORD 'right one'");
      const std::string hba = server.sql(database, "SHOW hba_file");
      const std::string before = sinks::content(hba);
      std::ofstream(hba) << "local all guarded scram-sha-256\n" << before;
      server.sql(database, "SELECT pg_reload_conf(); GRANT ALL ON SCHEMA public TO guarded");
      const std::string url = "postgresql://guarded@/" + database + "?host=" + server.folder();
      {
        Program program({.url = url, .password = "wrong secret"});
        program.loop.advance(3s);
        CHECK(program.told("password authentication failed"));
        CHECK(program.told("check `user` and `password`"));
        CHECK_FALSE(program.told("wrong secret"));
        program.loop.close(0s);
      }
      {
        Program program({.url = url, .password = "right one"});
        program.loop.advance(3s);
        program.loop.close();
        CHECK(program.all_errors() == "");
      }
      std::ofstream(hba) << before;
      server.sql(database, "SELECT pg_reload_conf()");
    }
    SUBCASE("no database") {
      Program program({.url = server.url("no_such")});
      program.loop.advance(3s);
      CHECK(program.told("make it: createdb"));
      server.sql("postgres", "CREATE DATABASE no_such");
      program.loop.advance(20s);
      program.loop.close();
      CHECK(check_once(server, "no_such") == program.count);
      server.sql("postgres", "DROP DATABASE no_such");
    }
    SUBCASE("another encoding") {
      const std::string latin = server.make_database(
          "ENCODING 'LATIN1' LC_COLLATE 'C' LC_CTYPE 'C' TEMPLATE template0");
      Program program({.url = server.url(latin)});
      program.loop.advance(3s);
      CHECK(program.told("its encoding is LATIN1"));
      program.loop.close(0s);
    }
    SUBCASE("a password in the URL, and one that is none") {
      Loop loop{Loop::Manual{}};
      CHECK_THROWS_WITH_AS(PostgresqlSink(loop, {.url = "postgresql://a:secret@localhost/b"}),
                           doctest::Contains("it has a password in it"), SetupError);
      CHECK_THROWS_WITH_AS(PostgresqlSink(loop, {.url = "postgresql://localhost/b%zz"}),
                           doctest::Contains("libpq does not understand it"), SetupError);
    }
    SUBCASE("a mode and ports that there are not") {
      Loop loop{Loop::Manual{}};
      const auto refused = [&](const std::string& url) {
        CAPTURE(url);
        CHECK_THROWS_AS(PostgresqlSink(loop, {.url = "postgresql://" + url}), SetupError);
      };
      refused("localhost/b?sslmode=requir");
      for (const char* port : {"99999", "0", "1,70000"}) refused("localhost/b?port=" + std::string(port));
      const PostgresqlSink good(loop, {.url = "postgresql://localhost,::1/b?port=1,65535&sslmode=require"});
    }
    SUBCASE("options that libpq refuses") {
      Loop loop{Loop::Manual{}};
      const auto refused = [&](const std::string& options, const char* why) {
        CAPTURE(options);
        CHECK_THROWS_WITH_AS(PostgresqlSink(loop, {.url = "postgresql://127.0.0.1/b?" + options}),
                             doctest::Contains(why), SetupError);
      };
      refused("target_session_attrs=zz", "target_session_attrs");
      refused("gssencmode=zz", "gssencmode");
      refused("channel_binding=zz", "channel_binding");
      refused("ssl_min_protocol_version=zz", "ssl_min_protocol_version");
      refused("ssl_min_protocol_version=TLSv1.3&ssl_max_protocol_version=TLSv1.2",
              "invalid SSL protocol version range");
      for (const char* keyword :
           {"keepalives", "keepalives_idle", "keepalives_interval", "keepalives_count", "tcp_user_timeout"})
        refused(std::string(keyword) + "=1x", "is a whole number, not \"1x\"");
      const PostgresqlSink good(
          loop, {.url = "postgresql://a@db.example:5433,/tmp/b?target_session_attrs=read-write&keepalives_idle=5&"
                        "gssencmode=disable&channel_binding=prefer&ssl_min_protocol_version=TLSv1.2&sslmode=require"});
    }
  }

  TEST_CASE("NFR-1 a server that stands still: each call ends in time, closing too, and everything comes later") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    Program program({.url = server.url(database), .timeout = 300ms});
    program.loop.advance(3s);
    server.freeze();
    program.loop.advance(2s);
    CHECK(program.told("does not answer"));
    server.thaw();
    program.loop.advance(20s);
    program.loop.close();
    CHECK(check_once(server, database) == program.count);
  }

  TEST_CASE("NFR-1 a network that goes dark in a COPY: the server's session is ended by the next, and only that") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    DarkNetwork network(server.folder());
    Program program({.url = network.url(database), .timeout = 1s, .sink = {.name = "north"}});
    Program other({.url = server.url(database), .timeout = 1s, .sink = {.name = "north"}});  // on another machine
    program.loop.advance(3s);
    other.loop.advance(3s);
    const char* const sessions = "SELECT count(*) FROM pg_stat_activity WHERE application_name LIKE 'rtdata north %'";
    CHECK(server.number(database, sessions) == 2);
    network.go_dark_at_copy();
    program.loop.advance(2s);
    REQUIRE(network.dark() == 1);
    CHECK(program.told("does not answer"));
    program.loop.advance(20s);
    CHECK(server.number(database, sessions) == 2);
    CHECK(server.number(database,
                        "SELECT count(*) FROM pg_stat_activity WHERE state = 'active' AND query LIKE "
                        "'%COPY%' AND application_name LIKE 'rtdata north %'") == 0);
    other.loop.advance(20s);
    program.loop.close();
    other.loop.close();
    CHECK(other.all_errors().empty());
    CHECK(check_once(server, database) == program.count + other.count);
  }

  TEST_CASE("NFR-1 what the server does when the network goes dark is asked for, where nobody has chosen it") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    const auto connected = [&](const std::string& more) {
      postgresql::Connection made({.url = server.url(database) + more, .timeout = 7s});
      const auto reply = made.run(
          "SELECT source || ' ' || coalesce(reset_val, '') FROM pg_settings WHERE name LIKE 'tcp_%' ORDER BY name");
      std::string all;
      for (int row = 0; row < reply.rows(); ++row) all += std::string(reply.text(row, 0)) + "\n";
      return all;
    };
    CHECK(connected("") == "session 0\nsession 0\nsession 0\nsession 0\n");
    CHECK(connected("&options=-c%20tcp_keepalives_idle%3D77") == "session 0\nclient 77\nsession 0\nsession 0\n");
  }

  TEST_CASE("NFR-1 an older connection that was thought to be dead stores late: nothing is there twice") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    Program program({.url = server.url(database), .timeout = 5s});
    program.loop.advance(3s);
    // Somebody moves the position on, as that connection would have.
    server.sql(database, "UPDATE rtdata_position SET last_sequence = last_sequence + 1");
    program.loop.advance(1s);
    CHECK(program.told("another program has also sent events of this run"));
    server.sql(database, "UPDATE rtdata_position SET last_sequence = last_sequence - 1");
    program.loop.advance(20s);
    program.loop.close();
    CHECK(server.number(database, "SELECT count(DISTINCT (run, origin, sequence)) - count(*) FROM \"plant/number\"") ==
          0);
  }

  TEST_CASE("FW-4 verify says of the server what it says of the recording that a sink goes through") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    recordings::Folder folder;
    const std::string path = folder / "run.db";
    const PostgresqlConfig config{.url = server.url(database), .machine = "node", .sink = {.through = "recording"}};
    {
      Node node(path, config);
      node.loop.advance(70s);
      const VerifyReport meanwhile = verify_server(config).or_throw();
      CHECK(has(meanwhile.text(), "recording"));
      CHECK(meanwhile.exit_code() == 0);
      node.loop.close();
      CHECK(node.all_errors() == "");
    }
    const VerifyReport recorded = recordings::verified(path);
    VerifyReport served = verify_server(config).or_throw();
    INFO(served.text());
    REQUIRE(served.runs.size() == 1);
    CHECK(served.verdict() == Verdict::balanced);
    served.path = recorded.path;
    CHECK(served.text() == recorded.text());

    const auto problem_after = [&](const std::string& change, const std::string& undo) {
      server.sql(database, change);
      const VerifyReport changed = verify_server(config).or_throw();
      CHECK(changed.exit_code() == 1);
      server.sql(database, undo);
      std::string text;
      for (const std::string& problem : changed.problems) text += problem + "\n";
      for (const RunReport& run : changed.runs) {
        for (const std::string& problem : run.problems) text += problem + "\n";
      }
      return text;
    };
    CHECK(has(problem_after("CREATE TABLE kept AS SELECT * FROM \"plant/number\" WHERE sequence = 17; DELETE FROM "
                            "\"plant/number\" WHERE sequence = 17",
                            "INSERT INTO \"plant/number\" SELECT * FROM kept"),
              "17"));
    CHECK(has(problem_after("UPDATE \"plant/number\" SET count = 4 WHERE sequence = 5",
                            "UPDATE \"plant/number\" SET count = 5 WHERE sequence = 5"),
              "a value was changed"));
    CHECK(has(
        problem_after("UPDATE rtdata_ledger SET missed = missed + 1", "UPDATE rtdata_ledger SET missed = missed - 1"),
        "rtdata_ledger"));
    CHECK(has(problem_after("CREATE TABLE gaps AS TABLE rtdata_gap; DELETE FROM rtdata_gap",
                            "INSERT INTO rtdata_gap TABLE gaps"),
              "rtdata_gap"));
    CHECK(has(problem_after("UPDATE rtdata_position SET rows = rows - 1", "UPDATE rtdata_position SET rows = rows + 1"),
              "rtdata_position"));
    CHECK(has(problem_after("CREATE TABLE runs AS TABLE rtdata_run; DELETE FROM rtdata_run",
                            "INSERT INTO rtdata_run OVERRIDING SYSTEM VALUE TABLE runs"),
              "plant/number: rows of run 1 ("));
    CHECK(has(problem_after("UPDATE rtdata_position SET topic = 'plant/other' WHERE topic = 'plant/number'",
                            "UPDATE rtdata_position SET topic = 'plant/number' WHERE topic = 'plant/other'"),
              "but that table belongs to plant/number"));
    CHECK(has(problem_after("UPDATE rtdata_topic SET version = 2 WHERE topic = 'plant/number'",
                            "UPDATE rtdata_topic SET version = 1 WHERE topic = 'plant/number'"),
              "has version 2 where 1 follows"));
    CHECK(has(problem_after("DELETE FROM rtdata_layout", "INSERT INTO rtdata_layout VALUES(1)"), "rtdata_layout"));
    CHECK(has(problem_after("UPDATE rtdata_layout SET version = -1", "UPDATE rtdata_layout SET version = 1"),
              "rtdata_layout"));
    CHECK(has(problem_after("INSERT INTO rtdata_layout VALUES(1)",
                            "DELETE FROM rtdata_layout; INSERT INTO rtdata_layout VALUES(1)"),
              "rtdata_layout"));
    for (const auto& [change, undo] :
         {std::pair{"rtdata_run SET machine = machine || 'x'", "rtdata_run SET machine = rtrim(machine, 'x')"},
          {"rtdata_topic SET first_run = first_run + 1", "rtdata_topic SET first_run = first_run - 1"},
          {"rtdata_position SET stored_at = stored_at + '1 us'::interval",
           "rtdata_position SET stored_at = stored_at - '1 us'::interval"}}) {
      CHECK(has(problem_after(std::string("UPDATE ") + change, std::string("UPDATE ") + undo),
                "rtdata_position: the checksum of its "));
    }
    for (const char* other : {"account_at + 1", "NULL"}) {
      CHECK(has(problem_after(std::string("UPDATE rtdata_run SET account_at = ") + other,
                              "UPDATE rtdata_run SET account_at = ended"),
                "rtdata_run: account_at is not the end"));
    }
    const auto error_after = [&](const std::string& change, const std::string& undo) {
      server.sql(database, change);
      const auto found = verify_server(config);
      server.sql(database, undo);
      return found ? "none" : std::string(found.error().id()) + ": " + found.error().text();
    };
    CHECK(has(error_after("UPDATE rtdata_layout SET version = 2", "UPDATE rtdata_layout SET version = 1"),
              "newer-version"));
    CHECK(has(error_after("ALTER TABLE \"plant/number\" ALTER COLUMN count TYPE text",
                          "ALTER TABLE \"plant/number\" ALTER COLUMN count TYPE bigint USING count::bigint"),
              "sequence 1: field count holds a value that is not a valid int64"));
    CHECK(has(error_after("ALTER TABLE \"plant/number\" RENAME COLUMN count TO counted",
                          "ALTER TABLE \"plant/number\" RENAME COLUMN counted TO count"),
              "it lacks columns of its description"));
    CHECK(has(error_after("ALTER TABLE rtdata_topic RENAME TO other", "ALTER TABLE other RENAME TO rtdata_topic"),
              "it has no table rtdata_topic"));
    CHECK(verify_server(config).or_throw().exit_code() == 0);
  }

  TEST_CASE("FW-4 a server that takes what is made of a topic has the account of that topic, and none of its rows") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    recordings::Folder folder;
    const std::string path = folder / "run.db";
    const PostgresqlConfig config{
        .url = server.url(database), .machine = "node", .sink = {.topics = {"plant/alarm"}, .through = "recording"}};
    {
      Node node(path, config);
      const LimitSensor alarm(node.loop, {.name = "alarm", .topic = "plant/alarm"},
                              {.on = "plant/shaky", .field = "count", .high = 100});
      node.loop.advance(20s);
      node.loop.close();
      CHECK(node.all_errors() == "");
    }
    const VerifyReport recorded = recordings::verified(path), served = verify_server(config).or_throw();
    INFO(served.text());
    REQUIRE(served.runs.size() == 1);
    CHECK(served.verdict() == Verdict::balanced);
    REQUIRE(served.runs[0].losses.size() == 1);
    REQUIRE(recorded.runs[0].losses.size() == 1);
    CHECK(served.runs[0].losses[0].topic == "plant/shaky");
    CHECK(served.runs[0].losses[0].failed == recorded.runs[0].losses[0].failed);
    CHECK(served.runs[0].losses[0].made_of_it == std::vector<std::string>{"plant/alarm"});
    CHECK(server.sql(database, "SELECT string_agg(topic, ' ' ORDER BY topic) FROM rtdata_ledger") ==
          "plant/alarm plant/shaky");
    CHECK(server.number(database, "SELECT offered + published FROM rtdata_ledger WHERE topic = 'plant/shaky'") == 0);
  }

  TEST_CASE("FW-4 verify counts rows that the server has refused as refused there, and all is balanced") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    recordings::Folder folder;
    const PostgresqlConfig config{.url = server.url(database), .machine = "node", .sink = {.through = "recording"}};
    std::int64_t before = 0, count = 0;
    {
      Node node(folder / "run.db", config);
      node.loop.advance(1s);
      before = server.number(database, "SELECT max(count) FROM \"plant/number\"");
      server.sql(database, "ALTER TABLE \"plant/number\" ADD CONSTRAINT seven CHECK (count % 7 <> 0) NOT VALID");
      node.loop.advance(70s);
      const VerifyReport meanwhile = verify_server(config).or_throw();
      INFO(meanwhile.text());
      CHECK(meanwhile.problems.empty());
      CHECK(server.number(database, "SELECT count(*) FROM rtdata_run WHERE account_at IS NOT NULL") == 1);
      node.loop.close();
      count = node.count;
    }
    const VerifyReport served = verify_server(config).or_throw();
    INFO(served.text());
    REQUIRE(served.runs.size() == 1);
    CHECK(served.runs[0].problems.empty());
    CHECK(served.verdict() == Verdict::balanced);
    const std::string refused = std::to_string(count / 7 - before / 7);
    CHECK(server.sql(database, "SELECT dropped_refused FROM rtdata_ledger WHERE origin = 'pulse'") == refused);
    CHECK(has(served.text(), "refused on storing " + refused));
  }

  TEST_CASE("FW-4 of events from memory verify says that no account came along") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    const PostgresqlConfig config{.url = server.url(database)};
    {
      Program program(config);
      program.loop.advance(3s);
      program.loop.close();
    }
    const VerifyReport report = verify_server(config).or_throw();
    CHECK(has(report.text(), "The account was not sent"));
    CHECK(report.verdict() == Verdict::unsealed);
    CHECK(report.runs.at(0).rows == 301);
    CHECK(has(report.text(), "2023-11-14T22:13:20Z to 2023-11-14T22:13:23Z"));  // of its rows
  }

  TEST_CASE("FW-4 every kind of value comes back from the server equal") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    const PostgresqlConfig config{.url = server.url(database)};
    payloads::Everything bad;
    bad.name = text<7>("\xff\\xff");
    bad.u64 = 1'000'000'000'000;
    bad.states = {static_cast<payloads::State>(5), payloads::State::idle};
    bad.letter = '\\';
    const payloads::Everything sent[] = {payloads::full(), {}, bad};
    {
      Loop loop{Loop::Manual{}};
      PostgresqlSink sink(loop, config);
      Feed<payloads::Everything> feed(loop, {.name = "feed", .topic = "all"});
      for (const auto& one : sent) feed.publish(one);
      loop.close();
    }
    const ServerRecording server_side = download(config).or_throw();
    CHECK(server_side.problems.empty());
    auto rows = server_side.recording.rows({}).or_throw();
    for (const auto& one : sent) {
      const RecordedRow* row = rows.next().or_throw();
      REQUIRE(row != nullptr);
      payloads::Everything back;
      const Description& description = *description_of<payloads::Everything>();
      for (std::size_t i = 0; i < description.leaves().size(); ++i) {
        const Leaf& leaf = description.leaves()[i];
        write(leaf, reinterpret_cast<std::byte*>(&back), row->event().value(row->topic().description->leaves()[i]))
            .or_throw();
      }
      CHECK((back == one));
    }
    CHECK(rows.next().or_throw() == nullptr);
  }

  TEST_CASE("NFR-1 a program that is killed goes on where the server is, through its recording; its seal goes along") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    recordings::Folder folder;
    const std::string path = folder / "run.db";
    const PostgresqlConfig config{.url = server.url(database), .sink = {.through = "recording"}};
    SUBCASE("with the server there") {}
    SUBCASE("with the server away until after the start") { server.stop(SIGINT); }
    sinks::killed_in([&] {
      Node node(path, config);
      node.loop.advance(20s);
      ::raise(SIGKILL);
    });
    {
      Node node(path, config);
      node.loop.advance(5s);
      server.start();
      node.loop.advance(40s);
      node.loop.close();
    }
    check_once(server, database);
    CHECK(server.number(database, "SELECT count(*) FROM \"plant/number\"") ==
          recordings::number(path, "SELECT count(*) FROM \"plant/number\""));
    const VerifyReport served = verify_server(config).or_throw();
    INFO(served.text());
    REQUIRE(served.runs.size() == 2);
    CHECK(served.runs[0].verdict == Verdict::sealed);
    CHECK(served.runs[1].verdict == Verdict::balanced);
  }

  TEST_CASE("NFR-1 killed at random moments while it sends: each event once on the server") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    recordings::Folder folder;
    const std::string path = folder / "run.db";
    const PostgresqlConfig config{.url = server.url(database), .sink = {.batch_time = 5ms, .through = "recording"}};
    const char* const wanted = std::getenv("RTDATA_TEST_SEEDS");  // "FIRST COUNT", to look for more
    char* rest = nullptr;
    const unsigned long first = wanted != nullptr ? std::strtoul(wanted, &rest, 10) : 1;
    const unsigned long count = wanted != nullptr ? std::strtoul(rest, nullptr, 10) : 6;
    for (unsigned long seed = first; seed < first + count; ++seed) {
      CAPTURE(seed);
      const pid_t child = fork_without_threads();
      if (child == 0) {
        Loop loop;
        loop.on_error([](const ErrorReport&) {});
        loop.runtime().on_log([](const LogRecord&) {});
        SqliteSink recording(loop, {.path = path, .sink = {.name = "recording", .batch_time = 5ms}});
        PostgresqlSink sink(loop, config);
        std::int64_t published = 0;
        Sensor<Number> sensor(loop, {.name = "pulse", .topic = "plant/number", .rate = 2_kHz},
                              [&] { return Number{++published}; });
        loop.run();
        ::_exit(0);
      }
      std::mt19937 random(static_cast<unsigned>(seed));
      ::usleep(static_cast<useconds_t>(20000 + random() % 300000));  // the moment is what is tried
      ::kill(child, SIGKILL);
      REQUIRE(::waitpid(child, nullptr, 0) == child);
    }
    {
      Node node(path, config);
      node.loop.advance(3s);
      node.loop.close();
      CHECK(node.all_errors() == "");
    }
    check_once(server, database);
    const std::int64_t recorded = recordings::number(path, "SELECT count(*) FROM \"plant/number\"");
    CHECK(server.number(database, "SELECT count(*) FROM \"plant/number\"") == recorded);
    CHECK(verify_server(config).or_throw().exit_code() == 0);
  }
}
