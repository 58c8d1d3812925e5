// Mistakes in a machine's table, and its drawings.
#include "rtdata/fsm/machine.hpp"

#include <doctest/doctest.h>

#include <string>
#include <vector>

using namespace rtdata;
using fsm::Graph;
using FaultKind = fsm::GraphFault::Kind;

namespace {

std::vector<FaultKind> kinds(const Graph& graph) {
  std::vector<FaultKind> found;
  for (const fsm::GraphFault& fault : fsm::find_faults(graph)) found.push_back(fault.kind);
  return found;
}
Graph flight() {
  return {"flight",
          {{"pad"}, {"boost"}, {"landed", true}},
          {{0, 1, "altitude > 20", "", false}, {1, 2, "touchdown", "touchdown", false}},
          0};
}

}  // namespace

TEST_SUITE("fsm") {
  TEST_CASE("US-39 a table without mistakes has none") { CHECK(kinds(flight()).empty()); }

  TEST_CASE("US-41 each kind of mistake in a table is found") {
    Graph graph = flight();
    graph.start = Graph::none;
    CHECK(kinds(graph) == std::vector{FaultKind::no_start});

    graph = flight();
    graph.states.push_back({"abort", true});
    CHECK(kinds(graph) == std::vector{FaultKind::unreachable});

    graph = flight();
    graph.states[2].is_final = false;
    CHECK(kinds(graph) == std::vector{FaultKind::dead_end});

    graph = flight();
    graph.states[1].is_final = true;
    CHECK(kinds(graph) == std::vector{FaultKind::left_final});

    graph = flight();
    graph.edges.push_back(graph.edges[0]);
    CHECK(kinds(graph) == std::vector{FaultKind::duplicate});

    graph = flight();
    graph.edges.insert(graph.edges.begin(), {0, 2, "", "", true});
    CHECK(kinds(graph) == std::vector{FaultKind::never_taken});
    graph.edges[0].on = "abort";  // another event
    CHECK(kinds(graph).empty());
    graph.edges[0].on = "";
    graph.edges[0].after = std::chrono::seconds{1};  // until then the other may be taken
    CHECK(kinds(graph).empty());
  }

  TEST_CASE("a graph is drawn, whatever its names hold") {
    Graph graph = flight();
    graph.states[0].name = "on the \"pad\"";
    graph.edges[0].label = "a > 5; b: c#";
    CHECK(fsm::mermaid(graph) ==
          "stateDiagram-v2\n"
          "  state \"on the #34;pad#34;\" as s0\n"
          "  state \"boost\" as s1\n"
          "  state \"landed\" as s2\n"
          "  [*] --> s0\n"
          "  s0 --> s1 : a #62; 5#59; b#58; c#35;\n"
          "  s1 --> s2 : touchdown\n"
          "  s2 --> [*]\n");
    CHECK(fsm::dot(graph) ==
          "digraph \"flight\" {\n"
          "  node [shape=box, style=rounded];\n"
          "  \"on the \\\"pad\\\"\";\n"
          "  \"boost\";\n"
          "  \"landed\" [peripheries=2];\n"
          "  \"\" [shape=point, label=\"\"];\n"
          "  \"\" -> \"on the \\\"pad\\\"\";\n"
          "  \"on the \\\"pad\\\"\" -> \"boost\" [label=\"a > 5; b: c#\"];\n"
          "  \"boost\" -> \"landed\" [label=\"touchdown\"];\n"
          "}\n");
  }
}
