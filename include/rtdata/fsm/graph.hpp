/// Graph: the states and transitions of a machine as data: to look for mistakes, and to draw.
///
///     const fsm::Graph graph = machine.graph();
///     for (const fsm::GraphFault& fault : fsm::find_faults(graph)) print(fault.text);
///     print(fsm::mermaid(graph));
///
/// Values; any thread.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "rtdata/data/time.hpp"

namespace rtdata::fsm {

struct Graph {
  static constexpr std::size_t none = static_cast<std::size_t>(-1);
  struct Node {
    std::string name;
    bool is_final = false;  ///< meant to be never left
  };
  struct Edge {
    std::size_t from = 0;  ///< index in `states`
    std::size_t to = 0;
    std::string label = {};         ///< "burnout", "altitude > 5, for 300 ms"
    std::string on = {};            ///< the event that it waits for; empty: any
    bool is_unconditional = false;  ///< taken as soon as it is tried: those behind it that are tried with it never are
    Duration after{0};              ///< the time in the state before which it is not tried
  };
  std::string name;  ///< of the machine
  std::vector<Node> states;
  std::vector<Edge> edges;   ///< of each state in the order in which they are tried
  std::size_t start = none;  ///< index in `states`
};

/// A mistake, and the state or transition it is of.
struct GraphFault {
  enum class Kind {
    no_start,     ///< there is no start state
    unreachable,  ///< no way leads to the state from the start
    dead_end,     ///< nothing leads out of the state, and it is not final
    left_final,   ///< a final state that something leads out of
    duplicate,    ///< two transitions that are the same
    never_taken,  ///< another one is always taken before it
  };
  Kind kind;
  std::size_t state = Graph::none;  ///< index in `states`
  std::size_t edge = Graph::none;   ///< index in `edges`
  std::string text;                 ///< "nothing leads to state `boost`"
};

/// In the order of the states, then of the transitions.
std::vector<GraphFault> find_faults(const Graph& graph);

/// A state diagram as Mermaid reads it (GitHub and GitLab show it in a ```mermaid block).
std::string mermaid(const Graph& graph);
/// As Graphviz reads it: `dot -Tsvg`.
std::string dot(const Graph& graph);

}  // namespace rtdata::fsm
