// A PostgreSQL server behind a line that spoils what it says, tables that are divided by time, and the order in which
// several tables arrive.
#include <doctest/doctest.h>
#include <poll.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <thread>
#include <utility>

#include "rtdata/loop/ledger.hpp"
#include "rtdata/postgresql/recording.hpp"
#include "rtdata/postgresql/sink.hpp"
#include "rtdata/sensors/feed.hpp"
#include "sensors/fake_gpsd.hpp"
#include "sinks/certificates.hpp"
#include "sinks/postgresql_server.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace std::chrono_literals;
using sinks::PostgresqlServer;

namespace {

struct Number {
  std::int64_t count = 0;
  friend constexpr auto describe(type_tag<Number>) { return record("number", field("count", &Number::count, "1")); }
};

/// A program that records, and whose sink goes through the recording to a server; in virtual time.
struct Node {
  Node(const std::string& path, PostgresqlConfig config, std::vector<std::string> topics = {"#"}) {
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    loop.runtime().on_log([](const LogRecord&) {});
    recording = SqliteSink(loop, {.path = path, .sink = {.name = "recording", .topics = topics}});
    config.sink.through = "recording";
    config.sink.topics = topics;
    config.sink.from = From::beginning;
    config.sink.retry_longest = 1s;
    sink = PostgresqlSink(loop, std::move(config));
  }
  void publish(int number, const std::string& topic = "plant/number") {
    for (int i = 0; i < number; ++i) loop.topic<Number>(topic).publish({++count});
  }
  std::string last_error() const { return errors.empty() ? "" : errors.back(); }
  std::vector<std::string> errors;
  std::int64_t count = 0;
  Loop loop{Loop::Manual{}};
  SqliteSink recording;
  PostgresqlSink sink;
};

/// A line to the server, by TCP: a thread carries the bytes, and spoils those of the server as it is told to.
class Line {
 public:
  enum class Mode { carries, garbage, drips, breaks };
  explicit Line(const PostgresqlServer& server) : path_(server.folder() + "/.s.PGSQL.5432") {
    thread_ = std::thread([this] { work(); });
  }
  Line(const Line&) = delete;
  Line& operator=(const Line&) = delete;
  ~Line() {
    is_over_ = true;
    thread_.join();
  }
  void become(Mode mode) { mode_ = mode; }
  std::string url(const std::string& database) const {
    return "postgresql://rt@127.0.0.1:" + std::to_string(listener_.port()) + "/" + database +
           "?sslmode=disable&gssencmode=disable";
  }

 private:
  struct Pair {
    int client, server;
    std::string for_client = {};
    std::size_t carried = 0;
  };
  void work() {
    std::vector<Pair> pairs;
    for (; !is_over_; std::this_thread::sleep_for(1ms)) {
      if (const int client = listener_.take(); client >= 0) pairs.push_back({client, connected()});
      for (Pair& pair : pairs) {
        if (!carry(pair)) {
          ::close(pair.client);
          ::close(pair.server);
          pair.client = -1;
        }
      }
      std::erase_if(pairs, [](const Pair& pair) { return pair.client < 0; });
    }
    for (const Pair& pair : pairs) {
      ::close(pair.client);
      ::close(pair.server);
    }
  }
  bool carry(Pair& pair) const {
    char bytes[65536];
    for (ssize_t got; (got = ::recv(pair.client, bytes, sizeof bytes, MSG_DONTWAIT)) >= 0;)
      if (got == 0 || ::send(pair.server, bytes, static_cast<std::size_t>(got), MSG_NOSIGNAL) != got) return false;
    for (ssize_t got; (got = ::recv(pair.server, bytes, sizeof bytes, MSG_DONTWAIT)) >= 0;) {
      if (got == 0) return false;
      pair.for_client.append(bytes, static_cast<std::size_t>(got));
    }
    if (mode_ == Mode::garbage && !pair.for_client.empty())
      std::fill(pair.for_client.begin(), pair.for_client.end(), '\x7e');
    const std::size_t most = mode_ == Mode::drips ? 1 : pair.for_client.size();
    if (most > 0 && !pair.for_client.empty()) {
      const ssize_t sent = ::send(pair.client, pair.for_client.data(), most, MSG_NOSIGNAL);
      if (sent < 0) return false;
      pair.for_client.erase(0, static_cast<std::size_t>(sent));
      pair.carried += static_cast<std::size_t>(sent);
    }
    if (mode_ == Mode::drips) std::this_thread::sleep_for(20ms);
    return mode_ != Mode::breaks || pair.carried < 700;  // behind what is said at the beginning
  }
  int connected() const {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    path_.copy(address.sun_path, sizeof address.sun_path - 1);
    const int fd = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    (void)::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address);
    return fd;
  }

  const std::string path_;
  FakeGpsd listener_;
  std::atomic<Mode> mode_{Mode::carries};
  std::atomic<bool> is_over_{false};
  std::thread thread_;
};

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("NFR-1 a server that says garbage, a byte at a time, or breaks off: each event is there once, later") {
    SERVER_OR_SKIP(server);
    using Mode = Line::Mode;
    for (const auto& one :
         {std::pair{Mode::garbage, true}, std::pair{Mode::garbage, false}, std::pair{Mode::drips, true},
          std::pair{Mode::drips, false}, std::pair{Mode::breaks, true}, std::pair{Mode::breaks, false}}) {
      const Mode mode = one.first;
      const bool closes = one.second;
      INFO("mode " << static_cast<int>(mode) << (closes ? ", closed meanwhile" : ""));
      const std::string database = server.make_database();
      const recordings::Folder folder;
      Line line(server);
      Node node(folder / "run.db", {.url = line.url(database), .timeout = 300ms});
      node.publish(50);
      node.loop.advance(3s);
      REQUIRE(node.sink.counts().stored == 50);
      line.become(mode);
      for (int round = 0; round < 3; ++round) {
        node.publish(50);
        node.loop.advance(1500ms);
      }
      CHECK(node.sink.health() == Health::faulted);
      CHECK_FALSE(node.errors.empty());
      CHECK(node.sink.counts().balances());
      if (closes) {
        const auto begin = std::chrono::steady_clock::now();
        CHECK(node.loop.close(2s) == 0);
        CHECK(std::chrono::steady_clock::now() - begin < 30s);  // each call has its time
        line.become(Mode::carries);
        Node next(folder / "run.db", {.url = line.url(database), .timeout = 5s});
        next.loop.advance(10s);
        CHECK(next.loop.close(5s) == 0);
      } else {
        line.become(Mode::carries);
        node.loop.advance(10s);
        CHECK(node.sink.health() == Health::ok);
        CHECK(node.loop.close(5s) == 0);
      }
      CHECK(server.number(database, "SELECT count(*) FROM \"plant/number\"") == 200);
      CHECK(server.number(database, "SELECT count(DISTINCT (run, origin, sequence)) FROM \"plant/number\"") == 200);
      CHECK(verify_server({.url = server.url(database)}).or_throw().exit_code() == 0);
    }
  }

  TEST_CASE("FW-4 a server without TLS where the configuration asks for it is a mistake that is told at once") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    const recordings::Folder folder;
    Line line(server);  // a server behind a socket of the file system has no TLS
    std::string url = line.url(database);
    url.replace(url.find("sslmode=disable"), 15, "sslmode=require");
    {
      Node node(folder / "run.db", {.url = url, .timeout = 5s});
      node.publish(20);
      node.loop.advance(3s);
      CHECK(node.sink.health() == Health::faulted);
      REQUIRE_FALSE(node.errors.empty());
      CHECK_MESSAGE(node.errors.front().find("server does not support SSL") != std::string::npos, node.errors.front());
      CHECK_MESSAGE(node.last_error().find("`ssl = on`") != std::string::npos, node.last_error());
      CHECK_MESSAGE(node.last_error().find("`sslmode` in `url`") != std::string::npos, node.last_error());
      CHECK(node.last_error().find("until the server is there") == std::string::npos);
      CHECK(node.sink.counts().queued == 20);
      node.loop.close(2s);
    }
    Node right(folder / "run.db", {.url = line.url(database), .timeout = 5s});
    right.loop.advance(5s);
    CHECK(right.loop.close(5s) == 0);
    CHECK(server.number(database, "SELECT count(*) FROM \"plant/number\"") == 20);
  }

  TEST_CASE("FW-4 TLS of a server: a certificate that is over, of itself, for another name: each says what to change") {
    SERVER_OR_SKIP(server);
    NEEDS_PROGRAM(sinks::openssl);
    const std::string database = server.make_database();
    const sinks::Certificates& certificates = sinks::Certificates::all();
    const std::string ca = certificates / "ca.pem";
    const struct {
      const char *certificate, *mode;
      std::string authority;
      const char *why, *advice;
    } cases[] = {{"right", "verify-full", ca, "", ""},
                 {"right", "verify-full", certificates / "none.pem", "does not exist", "`sslrootcert`"},
                 {"expired", "verify-ca", ca, "certificate verify failed", "`date`"},
                 {"self", "verify-ca", ca, "certificate verify failed", "`sslrootcert`"},
                 {"other", "verify-full", ca, "does not match host name", "use the name"},
                 {"other", "verify-ca", ca, "", ""}};
    std::int64_t stored = 0;
    for (const auto& one : cases) {
      CAPTURE(one.certificate);
      CAPTURE(one.mode);
      const std::string port = std::to_string(FakeGpsd().port());  // free again
      server.start_with_tls(port, certificates / (std::string(one.certificate) + ".pem"),
                            certificates / (std::string(one.certificate) + ".key"));
      const recordings::Folder folder;
      Node node(folder / "run.db", {.url = "postgresql://rt@127.0.0.1:" + port + "/" + database +
                                           "?sslmode=" + one.mode + "&sslrootcert=" + one.authority,
                                    .timeout = 10s});
      node.publish(10);
      node.loop.advance(3s);
      if (std::string(one.why).empty()) {
        CHECK_MESSAGE(node.sink.health() == Health::ok, node.last_error());
        CHECK(node.sink.counts().stored == 10);
        stored += 10;
      } else {
        CHECK(node.sink.health() == Health::faulted);
        CHECK_MESSAGE(node.last_error().find(one.why) != std::string::npos, node.last_error());
        CHECK_MESSAGE(node.last_error().find(one.advice) != std::string::npos, node.last_error());
        CHECK(node.sink.counts().queued == 10);
      }
      node.loop.close(2s);
    }
    server.stop(SIGINT);
    server.start();
    CHECK(server.number(database, "SELECT count(*) FROM \"plant/number\"") == stored);
  }

  TEST_CASE("FW-4 a table that is divided by time, as TimescaleDB does it, takes the rows and proves to be whole") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    const recordings::Folder folder;
    Node node(folder / "run.db", {.url = server.url(database)});
    node.publish(100);
    node.loop.advance(3s);
    REQUIRE(node.sink.counts().stored == 100);
    // What create_hypertable(..., migrate_data => true) comes to: the same table, with a part for each stretch of time.
    server.sql(database,
               "BEGIN; ALTER TABLE \"plant/number\" RENAME TO whole;"
               "CREATE TABLE \"plant/number\" (LIKE whole INCLUDING DEFAULTS INCLUDING COMMENTS INCLUDING INDEXES) "
               "PARTITION BY RANGE (\"time\");"
               "CREATE TABLE part_1 PARTITION OF \"plant/number\" FOR VALUES FROM (MINVALUE) TO ("
               "'" +
                   server.sql(database, "SELECT max(\"time\") + interval '2 seconds' FROM \"plant/number\"") +
                   "');"
                   "CREATE TABLE part_2 PARTITION OF \"plant/number\" DEFAULT;"
                   "INSERT INTO \"plant/number\" SELECT * FROM whole; DROP TABLE whole; COMMIT");
    for (int second = 0; second < 10; ++second) {
      node.publish(20);
      node.loop.advance(1s);
    }
    CHECK(node.loop.close(5s) == 0);
    {
      Node next(folder / "run.db", {.url = server.url(database)});  // which finds the divided table
      next.publish(30);
      next.loop.advance(3s);
      CHECK(next.loop.close(5s) == 0);
      CHECK(next.errors.empty());
    }
    CHECK(server.number(database, "SELECT count(*) FROM \"plant/number\"") == 330);
    CHECK(server.number(database, "SELECT count(*) FROM part_1") > 100);
    CHECK(server.number(database, "SELECT count(*) FROM part_2") > 100);
    const VerifyReport report = verify_server({.url = server.url(database)}).or_throw();
    CHECK_MESSAGE(report.exit_code() == 0, report.text());
  }

  TEST_CASE("US-32 FW-4 the final account is the last row that a server gets, when several tables have waited") {
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    const recordings::Folder folder;
    const std::vector<std::string> topics{"#", account_topic};
    {
      Node away(folder / "run.db", {.url = "postgresql://rt@/none?host=" + folder / "nobody", .timeout = 200ms},
                topics);
      Feed<Number> feed(away.loop, {.name = "chamber", .topic = "room"});
      for (std::int64_t i = 1; i <= 700; ++i) feed.publish({i});
      away.publish(9000);
      away.publish(40, "plant/slow");
      away.loop.advance(3s);
      CHECK(away.loop.close(3s) == 0);
    }
    Node node(folder / "run.db", {.url = server.url(database)}, topics);
    node.loop.advance(10s);
    CHECK(node.sink.counts().stored == 9741);
    CHECK(server.number(database, "SELECT count(*) FROM \"$rtdata/account\"") == 1);
    CHECK(server.number(database, "SELECT published FROM \"$rtdata/account\"") == 700);
    CHECK(server.number(database, "SELECT count(*) FROM room") == 700);
    // In a transaction of its own, after all others.
    for (const char* table : {"plant/number", "plant/slow", "room"}) {
      CAPTURE(table);
      CHECK(server.number(database, std::string("SELECT (SELECT min(xmin::text::bigint) FROM \"$rtdata/account\") - "
                                                "max(xmin::text::bigint) FROM \"") +
                                        table + "\"") > 0);
    }
    CHECK(node.loop.close(5s) == 0);
    CHECK(verify_server({.url = server.url(database)}).or_throw().exit_code() == 0);
  }
}
