// Lists words in a message.
#pragma once

#include <string>
#include <string_view>

namespace rtdata::detail {

/// "a, b, c", from any container of texts.
template <class Words>
std::string listed(const Words& words, std::string_view between = ", ") {
  std::string text;
  for (const auto& word : words) text.append(text.empty() ? "" : between).append(word);
  return text;
}

/// The same with `text_of` for each item.
template <class Items, class TextOf>
std::string listed_of(const Items& items, const TextOf& text_of) {
  std::string text;
  for (const auto& item : items) text.append(text.empty() ? "" : ", ").append(text_of(item));
  return text;
}

}  // namespace rtdata::detail
