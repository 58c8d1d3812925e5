// examples/fleet: nodes, a broker, a dashboard, a collector and a server as they stand there, with the real programs.
#if defined(RTDATA_WITH_MQTT) && defined(RTDATA_WITH_HTTP)
#include <doctest/doctest.h>
#include <signal.h>

#include <cstdlib>
#include <fstream>
#include <map>
#include <memory>
#include <set>
#include <sstream>
#include <thread>

#include "app/process.hpp"
#include "paths.hpp"
#include "rtdata/recording/recording.hpp"
#include "sinks/broker.hpp"
#include "sinks/http_bench.hpp"
#include "sinks/postgresql_server.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;
using test::Folder;
using test::Process;

namespace {

using rtdata::test::program;

std::string replaced(std::string text, const std::string& mark, const std::string& by) {
  REQUIRE(text.find(mark) != std::string::npos);
  for (std::size_t at = text.find(mark); at != std::string::npos; at = text.find(mark, at + by.size()))
    text.replace(at, mark.size(), by);
  return text;
}

/// A file of the example. The broker of a test has a port of its own.
std::string example(const std::string& name, const Broker& broker) {
  std::ifstream file(test::in_source("examples/fleet/" + name));
  std::ostringstream text;
  text << file.rdbuf();
  return replaced(text.str(), R"({"env": "BROKER"})", R"({"env": "BROKER"}, "port": )" + std::to_string(broker.port()));
}

/// Run, topic, origin and sequence of each event of a recording.
std::set<std::string> keys_of(const std::string& path, const std::string& topic = "#") {
  std::set<std::string> all;
  const Recording recording = Recording::open(path).or_throw();
  std::map<std::int64_t, std::string> uuids;
  for (const RunInfo& run : recording.runs().or_throw()) uuids[run.run] = run.uuid;
  RowFilter filter;
  filter.topic = topic;
  auto rows = recording.rows(filter).or_throw();
  while (const RecordedRow* row = rows.next().or_throw()) {
    const EventView event = row->event();
    all.insert(uuids[row->run()] + " " + std::string(event.topic()) + " " + std::string(event.origin()) + " " +
               std::to_string(event.sequence()));
  }
  return all;
}

template <class Done>
bool wait_until(Done&& done) {
  for (int i = 0; i < 1500 && !done(); ++i) std::this_thread::sleep_for(20ms);  // other programs
  return done();
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE(
      "US-30 US-32 FW-4 FW-5 FW-1 the example's fleet: nodes send by MQTT and HTTP, a collector stores, all agree") {
    NEEDS_BROKER();
    SERVER_OR_SKIP(server);
    if (!is_program(python)) {
      MESSAGE("skipped: there is no " << python << ", which serves");
      return;
    }
    const std::string database = server.make_database();
    const Folder folder;
    Broker broker("allow_anonymous true\nmax_queued_messages 0\nlog_type all\n");
    HttpServer dashboard;
    dashboard.kill();
    ::setenv("BROKER", "127.0.0.1", 1);
    ::setenv("DASHBOARD", dashboard.url().c_str(), 1);
    ::setenv("SERVER", server.url(database).c_str(), 1);

    folder.write("collector.json", example("collector.json", broker));
    Process collector(folder, program, {"run", "collector.json", "--quiet"});
    REQUIRE(wait_until([&] { return broker.log().find("Sending SUBACK to collector-1") != std::string::npos; }));

    const std::set<std::string> names{"north", "east"};
    for (const std::string& name : names)
      folder.write(name + ".json", replaced(example("node.json", broker), "north", name));
    const auto run_nodes = [&] {
      std::vector<std::unique_ptr<Process>> nodes;
      for (const std::string& name : names) {
        nodes.push_back(std::make_unique<Process>(
            folder, program, std::vector<std::string>{"run", name + ".json", "--for", "2s", "--quiet"}));
      }
      for (const auto& node : nodes) CHECK_MESSAGE(node->end() == 0, node->err);
    };
    run_nodes();  // the dashboard is away: what is for it waits in the recordings
    dashboard.start();
    run_nodes();

    std::set<std::string> all, loads;
    for (const std::string& name : names) {
      all.merge(keys_of(folder.path() + "/" + name + ".db"));
      loads.merge(keys_of(folder.path() + "/" + name + ".db", "host/load"));
    }
    CHECK(loads.size() >= 100);  // of two machines, twice 2 s at 20 Hz each
    CHECK(all.size() > loads.size());

    // The dashboard has both topics, of both runs of each node, once each.
    std::multiset<std::string> shown;
    for (const HttpServer::Json& event : dashboard.events()) {
      shown.insert(event["run"].get<std::string>() + " " + event["topic"].get<std::string>() + " " +
                   event["origin"].get<std::string>() + " " + event["sequence"].dump());
    }
    CHECK(std::set<std::string>(shown.begin(), shown.end()) == all);
    CHECK(shown.size() == all.size());

    // The server has the loads, which came by the broker and the collector's recording.
    const auto stored = [&] {
      std::set<std::string> keys;
      if (server.number(database, "SELECT count(*) FROM pg_class WHERE relname = 'plant/load'") == 0) return keys;
      std::istringstream lines(server.sql(
          database,
          "SELECT DISTINCT node_run || ' host/load ' || node_origin || ' ' || node_sequence FROM \"plant/load\""));
      for (std::string line; std::getline(lines, line);) keys.insert(line);
      return keys;
    };
    CHECK(wait_until([&] { return stored().size() == loads.size(); }));
    collector.signal(SIGTERM);
    CHECK_MESSAGE(collector.end() == 0, collector.err);
    CHECK(stored() == loads);

    // All of it proves to be whole, on each machine and on the server.
    for (const std::string& file :
         {std::string("north.db"), std::string("east.db"), std::string("collector-1.db"), server.url(database)}) {
      Process verify(folder, program, {"verify", file});
      CHECK_MESSAGE(verify.end() == 0, verify.out);
    }

    // The analysis replays the collector's recording: four runs of nodes, nothing missing.
    Process analysis(folder, test::built("examples/example_analysis"), {"collector-1.db"});
    CHECK_MESSAGE(analysis.end() == 0, (analysis.out + analysis.err));
    std::istringstream lines(analysis.out);
    std::size_t count = 0, events = 0;
    for (std::string line; std::getline(lines, line); ++count) {
      CHECK_MESSAGE(line.find(" 0 missing") != std::string::npos, line);
      events += std::stoul(line.substr(line.find(": ") + 2));
    }
    CHECK(count == 4);
    CHECK(events == loads.size());
  }
}
#endif
