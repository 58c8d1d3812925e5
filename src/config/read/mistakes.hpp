// Common functions for the places and texts of mistakes. Private to src/config.
#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rtdata/config/read.hpp"
#include "rtdata/data/config_item.hpp"

namespace rtdata::config_detail {

/// Null when there is none.
inline const ConfigItem* child_of(const ConfigItem& item, std::string_view key) {
  if (!item.is_object()) return nullptr;
  for (const ConfigChild& child : item.children())
    if (child.key == key) return &child.item;
  return nullptr;
}

/// The child of an item that a problem is best shown at: that of the key, or the item itself.
inline const ConfigItem& child_or_self(const ConfigItem& item, std::string_view key) {
  const ConfigItem* child = child_of(item, key);
  return child != nullptr ? *child : item;
}

inline std::string text_or_empty(const ConfigItem& item, std::string_view key) {
  const ConfigItem* child = child_of(item, key);
  const std::string* text = child != nullptr ? child->as_string() : nullptr;
  return text != nullptr ? *text : "";
}

/// A problem at the key of the item.
inline Problem problem_at_key(const ConfigItem& item, std::string id, std::string message,
                              std::string suggestion = {}) {
  Problem problem = item.problem(std::move(id), std::move(message), std::move(suggestion));
  problem.place = item.key_place();
  return problem;
}

/// "bench.json:3:5", or the path of an item that a program made.
inline std::string place_of(const ConfigItem& item) {
  const std::string place = item.place().text();
  return place.empty() ? item.path() : place;
}

inline std::string topic_advice(std::string_view topic) {
  return "\"" + std::string(topic) +
         "\" is not a topic name: letters, digits, _ . - in levels joined by /, such as \"room/climate\"";
}

/// Replaces the secrets in the texts of the problems.
inline void hide_secrets_in(Problems& problems, const std::vector<std::string>& secrets) {
  Problems shown;
  for (Problem problem : problems) {
    problem.message = hide_secrets(std::move(problem.message), secrets);
    shown.add(std::move(problem));
  }
  problems = std::move(shown);
}

}  // namespace rtdata::config_detail
