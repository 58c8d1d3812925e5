// An analysis of what a collector has (collector.json): its recording is replayed, as fast as it goes, to a handler
// that sorts the events by node and looks for those that are missing and those that came twice.
//   analysis collector-1.db      Without an argument it makes a recording of its own first.
#include <cstdint>
#include <cstdio>
#include <map>
#include <set>
#include <string>
#include <utility>

#include "rtdata/loop/loop.hpp"
#include "rtdata/recording/replay.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/feed.hpp"

using namespace std::chrono_literals;

// The fields of the collector's sensor. Run, origin and sequence are an event's key on its node.
struct NodeLoad {
  rtdata::text<36> node_run;
  rtdata::text<60> node_origin;
  std::uint64_t node_sequence = 0;
  std::int64_t node_time = 0;
  double load = 0;
  RTDATA_FIELDS(NodeLoad, (node_run), (node_origin), (node_sequence), (node_time, "ns"), (load))
};

// Two nodes, of which one loses two events and sends one twice.
void record(const std::string& path) {
  std::remove(path.c_str());
  rtdata::Loop loop{rtdata::Loop::Manual{}};
  rtdata::SqliteSink sink(loop, {.path = path});
  rtdata::Feed<NodeLoad> nodes(loop, {.name = "nodes", .topic = "plant/load"});
  for (std::uint64_t number = 1; number <= 100; ++number) {
    loop.advance(50ms);
    nodes.publish({"run of north", "load", number, 0, 0.5});
    if (number != 40 && number != 41) nodes.publish({"run of east", "load", number, 0, 1.5});
    if (number == 70) nodes.publish({"run of east", "load", number, 0, 1.5});
  }
  loop.close();
}

int main(int argc, char** argv) {
  const std::string path = argc > 1 ? argv[1] : "collector-1.db";
  if (argc < 2) record(path);

  struct Node {
    std::set<std::uint64_t> numbers;
    std::uint64_t doubles = 0;
  };
  std::map<std::pair<std::string, std::string>, Node> nodes;
  rtdata::Loop loop{rtdata::Loop::Manual{}};  // virtual time
  auto watch = loop.subscribe<NodeLoad>("plant/load", [&](const rtdata::Event<NodeLoad>& event) {
    Node& node = nodes[{std::string(event->node_run), std::string(event->node_origin)}];
    if (!node.numbers.insert(event->node_sequence).second) ++node.doubles;
  });
  rtdata::Replay replay(loop, {.file = path, .topics = {"plant/load"}});
  while (!replay.is_done()) loop.advance(1min);

  std::uint64_t events = 0, missing = 0;
  for (const auto& [key, node] : nodes) {
    const std::uint64_t lost = *node.numbers.rbegin() - node.numbers.size();
    std::printf("%s %s: %zu events, %llu missing, %llu twice\n", key.first.c_str(), key.second.c_str(),
                node.numbers.size(), static_cast<unsigned long long>(lost),
                static_cast<unsigned long long>(node.doubles));
    events += node.numbers.size();
    missing += lost;
  }
  return argc > 1 ? (missing == 0 ? 0 : 1) : (events == 198 && missing == 2 ? 0 : 1);
}
