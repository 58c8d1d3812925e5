// docs/many_machines.md: nodes, a broker, collectors and a server, all of them the real programs.
#ifdef RTDATA_WITH_MQTT
#include <doctest/doctest.h>
#include <signal.h>

#include <chrono>
#include <cstring>
#include <map>
#include <memory>
#include <set>
#include <sstream>
#include <thread>

#include "app/process.hpp"
#include "paths.hpp"
#include "rtdata/recording/recording.hpp"
#include "sinks/broker.hpp"
#include "sinks/postgresql_server.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;
using test::Folder;
using test::Process;

namespace {

using rtdata::test::program;

std::string node_file(const std::string& name, std::uint16_t port) {
  return R"({
  "name": ")" +
         name + R"(",
  "sensors": [{"name": "load", "type": "host", "quantity": "load", "rate": "100 Hz", "topic": "host/load"}],
  "sinks": [
    {"name": "recording", "type": "sqlite", "path": ")" +
         name + R"(.db", "batch_time": "100 ms"},
    {"type": "mqtt", "host": "127.0.0.1", "port": )" +
         std::to_string(port) + R"(, "topic": "plant/)" + name + R"(/{topic}",
     "through": "recording", "from": "beginning", "retry_first": "50 ms", "retry_longest": "200 ms"}
  ]
})";
}

std::string collector_file(const std::string& name, std::uint16_t port, const std::string& url) {
  return R"({
  "name": ")" +
         name + R"(",
  "sensors": [
    {"name": "nodes", "type": "mqtt", "host": "127.0.0.1", "port": )" +
         std::to_string(port) + R"(, "client_id": ")" + name + R"(",
     "topics": ["$share/collectors/plant/+/host/load"], "topic": "plant/load", "session": "1 d", "stored_by": "server",
     "retry_first": "20 ms", "retry_longest": "100 ms",
     "fields": [
       {"name": "node_run", "key": "run", "type": "text", "length": 36},
       {"name": "node_origin", "key": "origin", "type": "text", "length": 60},
       {"name": "node_sequence", "key": "sequence", "type": "uint64"},
       {"name": "node_time", "key": "time", "type": "int64", "unit": "ns"},
       {"name": "load1", "key": "data.minutes_1"}
     ]}
  ],
  "sinks": [{"name": "server", "type": "postgresql", "url": ")" +
         url + R"(", "batch_time": "50 ms"}]
})";
}

struct Key {
  std::string run, origin;
  std::uint64_t sequence = 0;
  auto operator<=>(const Key&) const = default;
};

std::map<Key, double> recorded(const std::string& path) {
  std::map<Key, double> all;
  const Recording recording = Recording::open(path).or_throw();
  std::map<std::int64_t, std::string> uuids;
  for (const RunInfo& run : recording.runs().or_throw()) uuids[run.run] = run.uuid;
  auto rows = recording.rows({}).or_throw();
  while (const RecordedRow* row = rows.next().or_throw()) {
    const EventView event = row->event();
    const Leaf* leaf = event.description().find("minutes_1");
    REQUIRE(leaf != nullptr);
    double load = 0;
    std::memcpy(&load, event.payload().data() + leaf->offset, sizeof load);
    all[{uuids[row->run()], std::string(event.origin()), event.sequence()}] = load;
  }
  return all;
}

template <class Done>
bool wait_for(Done&& done) {
  for (int i = 0; i < 1500 && !done(); ++i) std::this_thread::sleep_for(20ms);  // other programs
  return done();
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE(
      "US-32 FW-4 three nodes, one broker, two collectors of which one is killed, one server: all of them agree") {
    NEEDS_BROKER();
    SERVER_OR_SKIP(server);
    const std::string database = server.make_database();
    const Folder folder;
    Broker broker("allow_anonymous true\nmax_queued_messages 0\nlog_type all\n");
    const auto collect = [&](const std::string& name) {
      folder.write(name + ".json", collector_file(name, broker.port(), server.url(database)));
      return std::make_unique<Process>(folder, program, std::vector<std::string>{"run", name + ".json", "--quiet"});
    };
    auto first = collect("collector-1"), second = collect("collector-2");
    REQUIRE(wait_for([&] {
      return broker.log().find("Sending SUBACK to collector-1") != std::string::npos &&
             broker.log().find("Sending SUBACK to collector-2") != std::string::npos;
    }));

    const std::vector<std::string> names{"north", "east", "south"};
    std::vector<std::unique_ptr<Process>> nodes;
    for (const std::string& name : names) {
      folder.write(name + ".json", node_file(name, broker.port()));
      nodes.push_back(std::make_unique<Process>(
          folder, program, std::vector<std::string>{"run", name + ".json", "--for", "3s", "--quiet"}));
    }
    const auto count = [&](const char* what) {
      const bool is_there = server.number(database, "SELECT count(*) FROM pg_class WHERE relname = 'plant/load'") != 0;
      return is_there ? server.number(database, std::string("SELECT count(") + what + ") FROM \"plant/load\"") : 0;
    };
    // In the middle, killed with what it has read and not stored; the other goes on, and it comes back.
    REQUIRE(wait_for([&] { return count("*") > 100; }));
    first->signal(SIGKILL);
    first->end();
    std::this_thread::sleep_for(300ms);
    first = collect("collector-1");

    std::map<Key, double> sent;
    for (std::size_t i = 0; i < names.size(); ++i) {
      CHECK_MESSAGE(nodes[i]->end() == 0, nodes[i]->err);
      CHECK_MESSAGE(nodes[i]->out.find("wait in a recording") == std::string::npos, nodes[i]->out);
      const auto rows = recorded(folder.path() + "/" + names[i] + ".db");
      CHECK(rows.size() > 200);
      sent.insert(rows.begin(), rows.end());
    }
    constexpr const char* distinct = "DISTINCT (node_run, node_origin, node_sequence)";
    CHECK(wait_for([&] { return count(distinct) == static_cast<std::int64_t>(sent.size()); }));
    for (auto* collector : {first.get(), second.get()}) {
      collector->signal(SIGTERM);
      CHECK_MESSAGE(collector->end() == 0, collector->err);
    }

    // Event for event; what came twice is the same twice.
    std::istringstream text(server.sql(
        database, "SELECT node_run || ' ' || node_origin || ' ' || node_sequence || ' ' || load1 FROM \"plant/load\""));
    std::map<Key, double> stored;
    std::size_t rows = 0;
    for (std::string line; std::getline(text, line);) {
      std::istringstream words(line);
      Key key;
      double load = 0;
      words >> key.run >> key.origin >> key.sequence >> load;
      REQUIRE_FALSE(words.fail());
      ++rows;
      const auto [at, is_new] = stored.emplace(key, load);
      CHECK(at->second == load);
    }
    const bool is_equal = stored == sent;
    CHECK(is_equal);
    MESSAGE(sent.size() << " events of three nodes, " << rows - stored.size() << " came twice");
    std::set<std::string> runs;
    for (const auto& [key, load] : stored) runs.insert(key.run);
    CHECK(runs.size() == 3);
    CHECK(server.number(database, "SELECT count(*) FROM rtdata_run") == 3);  // of the collectors, one twice
  }
}
#endif
