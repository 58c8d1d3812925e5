#include "app/inspect/names.hpp"

#include <cstddef>

#include "app/core/terminal_text.hpp"
#include "rtdata/data/problem.hpp"

namespace rtdata::app {

std::string list_of(const std::set<std::string>& names) {
  constexpr std::size_t most = 10;
  std::string text;
  std::size_t count = 0;
  for (const std::string& name : names) {
    if (count++ == most) return text + ", ...";
    text += (text.empty() ? "" : ", ") + name;
  }
  return text.empty() ? "nothing" : text;
}

std::string list_of_fields(const std::map<std::string, std::vector<std::string>>& by_topic,
                           const std::string& command) {
  std::string text, example;
  for (const auto& [topic, paths] : by_topic) {
    std::string line = topic + ":";
    for (const std::string& path : paths) line += (line.back() == ':' ? " " : ", ") + path;
    if (paths.empty()) line += " no numbers so far";
    if (!paths.empty() && example.empty()) example = topic + "." + paths.front();
    text += wrapped(line, 80) + "\n";
  }
  return example.empty() ? text + "there is no number to plot\n" : text + "such as: " + command + " " + example + "\n";
}

std::string nearest_or_all(const std::string& name, const std::vector<std::string>& known) {
  for (std::string part = name;; part.resize(part.rfind('.'))) {
    if (const std::string nearest = nearest_name(part, known); !nearest.empty()) return "did you mean " + nearest + "?";
    if (part.find('.') == std::string::npos) return "available: " + list_of({known.begin(), known.end()});
  }
}

}  // namespace rtdata::app
