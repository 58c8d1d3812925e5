// The common part of reading and listing parameters by their tables. Private to the library.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/config/read.hpp"

namespace rtdata::config_detail {

struct KnownKey {
  std::string_view key;
  std::string_view doc;
  bool required;
};
/// Reports unknown and missing keys.
bool check_keys(const ConfigItem& item, const std::vector<KnownKey>& known, UnknownKeys unknown, Problems& problems);

inline std::vector<std::string> names_among(std::span<const Word> choices) {
  std::vector<std::string> names;
  for (const Word& choice : choices) names.emplace_back(choice.text);
  return names;
}

}  // namespace rtdata::config_detail
