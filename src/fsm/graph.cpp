#include "rtdata/fsm/machine.hpp"

#include <algorithm>

namespace rtdata::fsm {
namespace {

std::vector<bool> reached_from(const Graph& graph, std::size_t start) {
  std::vector<bool> reached(graph.states.size(), false);
  std::vector<std::size_t> open{start};
  reached[start] = true;
  while (!open.empty()) {
    const std::size_t at = open.back();
    open.pop_back();
    for (const Graph::Edge& edge : graph.edges) {
      if (edge.from != at || reached[edge.to]) continue;
      reached[edge.to] = true;
      open.push_back(edge.to);
    }
  }
  return reached;
}

/// True if `one` is taken whenever `other` could be: both wait for the same event, and `one` has no other condition.
/// `is_first`: it is tried before `other`. Without an event, it is tried as soon as its time has come.
bool hides(const Graph::Edge& one, const Graph::Edge& other, bool is_first) {
  if (one.from != other.from || one.on != other.on || !one.is_unconditional) return false;
  return is_first ? one.after <= other.after : one.on.empty() && one.after < other.after;
}

/// A text in quotes, for both languages.
std::string quoted(const std::string& text, std::string_view quote) {
  std::string result = "\"";
  for (const char c : text) {
    if (c == '"') {
      result += quote;
    } else if (c == '\n') {
      result += ' ';
    } else {
      result += c;
    }
  }
  return result += '"';
}

/// In a Mermaid diagram, a label ends at the end of the line; colon, semicolon and number sign have a special meaning.
std::string mermaid_label(const std::string& text) {
  std::string result;
  for (const char c : text) {
    switch (c) {
      case '\n':
        result += ' ';
        break;
      case ':':
        result += "#58;";
        break;
      case ';':
        result += "#59;";
        break;
      case '#':
        result += "#35;";
        break;
      case '<':
        result += "#60;";
        break;
      case '>':
        result += "#62;";
        break;
      case '"':
        result += "#34;";
        break;
      default:
        result += c;
    }
  }
  return result;
}

std::string of_edge(const Graph& graph, const Graph::Edge& edge) {
  return "from `" + graph.states[edge.from].name + "` to `" + graph.states[edge.to].name + "`";
}

}  // namespace

std::vector<GraphFault> find_faults(const Graph& graph) {
  using Kind = GraphFault::Kind;
  std::vector<GraphFault> faults;
  const bool has_start = graph.start < graph.states.size();
  if (!has_start) faults.push_back({Kind::no_start, Graph::none, Graph::none, "there is no start state"});
  const std::vector<bool> reached = has_start ? reached_from(graph, graph.start)
                                              : std::vector<bool>(graph.states.size(), true);
  for (std::size_t i = 0; i < graph.states.size(); ++i) {
    const Graph::Node& state = graph.states[i];
    const bool is_left = std::any_of(graph.edges.begin(), graph.edges.end(),
                                     [&](const Graph::Edge& edge) { return edge.from == i; });
    if (!reached[i])
      faults.push_back(
          {Kind::unreachable, i, Graph::none, "nothing leads from the start to state `" + state.name + "`"});
    if (!is_left && !state.is_final) {
      faults.push_back({Kind::dead_end, i, Graph::none,
                        "nothing leads out of state `" + state.name + "`; if this is intended, declare it as final"});
    }
    if (is_left && state.is_final)
      faults.push_back(
          {Kind::left_final, i, Graph::none, "state `" + state.name + "` is final, but a transition leads out of it"});
  }
  for (std::size_t i = 0; i < graph.edges.size(); ++i) {
    const Graph::Edge& edge = graph.edges[i];
    for (std::size_t k = 0; k < graph.edges.size(); ++k) {
      const Graph::Edge& other = graph.edges[k];
      if (k < i && other.from == edge.from && other.to == edge.to && other.on == edge.on && other.label == edge.label) {
        faults.push_back({Kind::duplicate, Graph::none, i, "the transition " + of_edge(graph, edge) + " exists twice"});
        break;
      }
      if (k != i && hides(other, edge, k < i)) {
        faults.push_back({Kind::never_taken, Graph::none, i,
                          "the transition " + of_edge(graph, edge) + " is never taken: the one " +
                              of_edge(graph, other) + ", which comes before it, has no condition"});
        break;
      }
    }
  }
  return faults;
}

std::string mermaid(const Graph& graph) {
  // Names may contain characters that identifiers may not, so states are numbered and shown by name.
  std::string text = "stateDiagram-v2\n";
  for (std::size_t i = 0; i < graph.states.size(); ++i)
    text += "  state " + quoted(graph.states[i].name, "#34;") + " as s" + std::to_string(i) + "\n";
  if (graph.start < graph.states.size()) text += "  [*] --> s" + std::to_string(graph.start) + "\n";
  for (const Graph::Edge& edge : graph.edges) {
    text += "  s" + std::to_string(edge.from) + " --> s" + std::to_string(edge.to);
    if (!edge.label.empty()) text += " : " + mermaid_label(edge.label);
    text += '\n';
  }
  for (std::size_t i = 0; i < graph.states.size(); ++i)
    if (graph.states[i].is_final) text += "  s" + std::to_string(i) + " --> [*]\n";
  return text;
}

std::string dot(const Graph& graph) {
  const auto name = [&](std::size_t i) { return quoted(graph.states[i].name, "\\\""); };
  std::string text = "digraph " + quoted(graph.name, "\\\"") + " {\n  node [shape=box, style=rounded];\n";
  for (std::size_t i = 0; i < graph.states.size(); ++i)
    text += "  " + name(i) + (graph.states[i].is_final ? " [peripheries=2]" : "") + ";\n";
  if (graph.start < graph.states.size()) {
    text += "  \"\" [shape=point, label=\"\"];\n  \"\" -> " + name(graph.start) + ";\n";
  }
  for (const Graph::Edge& edge : graph.edges) {
    text += "  " + name(edge.from) + " -> " + name(edge.to);
    if (!edge.label.empty()) text += " [label=" + quoted(edge.label, "\\\"") + "]";
    text += ";\n";
  }
  return text + "}\n";
}

}  // namespace rtdata::fsm
