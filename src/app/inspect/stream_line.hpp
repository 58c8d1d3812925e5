// Values in the lines of JSON that docs/subscribe.md describes.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

namespace rtdata::app {

/// Empty: there is no text of this key.
inline std::string text_in(const nlohmann::ordered_json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_string() ? found->get<std::string>() : std::string();
}

/// 0: there is no number of this key.
inline std::int64_t whole_in(const nlohmann::ordered_json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_number() ? found->get<std::int64_t>() : 0;
}

}  // namespace rtdata::app
