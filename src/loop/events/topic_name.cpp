// Names of topics, and the patterns that they match.
#include <algorithm>
#include <cctype>
#include <string>

#include "rtdata/loop/topic.hpp"

namespace rtdata {

bool is_topic_name(std::string_view name) noexcept {
  if (name.empty() || name.size() > 200) return false;
  if (name.front() == '$') name.remove_prefix(1);
  bool segment_is_empty = true;
  for (const char c : name) {
    if (c == '/') {
      if (segment_is_empty) return false;
      segment_is_empty = true;
    } else if (std::isalnum(static_cast<unsigned char>(c)) || c == '_' || c == '.' || c == '-') {
      segment_is_empty = false;
    } else {
      return false;
    }
  }
  return !segment_is_empty;
}

bool is_topic_pattern(std::string_view pattern) noexcept {
  std::string name(pattern);
  if (name == "#") return true;
  if (name.ends_with("/#")) name.resize(name.size() - 2);
  for (std::size_t begin = 0; begin <= name.size();) {
    const std::size_t end = std::min(name.find('/', begin), name.size());
    if (end - begin == 1 && name[begin] == '+') name[begin] = 'x';
    begin = end + 1;
  }
  return is_topic_name(name);
}

bool topic_matches(std::string_view pattern, std::string_view name) noexcept {
  if (!name.empty() && name.front() == '$' && (pattern.empty() || pattern.front() != '$')) return false;
  for (;;) {
    if (pattern == "#") return true;
    const std::size_t pattern_end = std::min(pattern.find('/'), pattern.size());
    const std::size_t name_end = std::min(name.find('/'), name.size());
    const std::string_view level = pattern.substr(0, pattern_end);
    if (level != "+" && level != name.substr(0, name_end)) return false;
    const bool pattern_done = pattern_end == pattern.size();
    const bool name_done = name_end == name.size();
    if (name_done && !pattern_done) return pattern.substr(pattern_end) == "/#";  // "a/#" matches "a" too
    if (pattern_done || name_done) return pattern_done && name_done;
    pattern.remove_prefix(pattern_end + 1);
    name.remove_prefix(name_end + 1);
  }
}

}  // namespace rtdata
