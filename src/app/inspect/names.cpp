#include "app/inspect/names.hpp"

#include <cstddef>

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

std::string nearest_or_all(const std::string& name, const std::vector<std::string>& known) {
  for (std::string part = name;; part.resize(part.rfind('.'))) {
    if (const std::string nearest = nearest_name(part, known); !nearest.empty()) return "did you mean " + nearest + "?";
    if (part.find('.') == std::string::npos) return "there is " + list_of({known.begin(), known.end()});
  }
}

}  // namespace rtdata::app
