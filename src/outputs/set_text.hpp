// Values as texts, for devices that are set by a text.
#pragma once

#include <array>
#include <charconv>
#include <map>
#include <string>
#include <string_view>

#include "data/setting_mistake.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/data/problem.hpp"

namespace rtdata::detail {

/// The shortest exact text: 1, 0.5.
inline std::string number_text(double value) {
  std::array<char, 32> text;
  return {text.data(), std::to_chars(text.data(), text.data() + text.size(), value).ptr};
}

/// The pattern with the value, or its word, for `{value}`.
inline std::string set_text(std::string pattern, double value, const std::map<std::string, std::string>& words) {
  std::string number = number_text(value);
  if (const auto word = words.find(number); word != words.end()) number = word->second;
  constexpr std::string_view mark = "{value}";
  for (std::size_t at = pattern.find(mark); at != std::string::npos; at = pattern.find(mark, at + number.size()))
    pattern.replace(at, mark.size(), number);
  return pattern;
}

inline bool has_value_mark(std::string_view pattern) { return pattern.find("{value}") != pattern.npos; }

/// Reports keys that no value matches, and a word used for two values.
inline void check_words(const std::map<std::string, std::string>& words, const ConfigItem& item, Problems& problems,
                        const char* name = "words") {
  std::map<std::string, std::string> values;  // by word
  for (const auto& [key, word] : words) {
    if (const auto [other, is_new] = values.try_emplace(word, key); !is_new)
      add_mistake({name, other->second + " and " + key + " are both written \"" + word +
                             "\": the device could not distinguish them"},
                  item, problems);
    double value = 0;
    const auto [end, failed] = std::from_chars(key.data(), key.data() + key.size(), value);
    const bool is_number = failed == std::errc{} && end == key.data() + key.size();
    if (is_number && number_text(value) == key) continue;
    add_mistake({name, "\"" + key + "\" is not a value" + (is_number ? ": it is written " + number_text(value) : "")},
                item, problems);
  }
}

}  // namespace rtdata::detail
