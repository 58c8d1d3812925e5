// Removes secrets from a text.
#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace rtdata::detail {

/// The text with each secret replaced. A secret shorter than 4 bytes is not replaced, because it would match
/// everywhere.
inline std::string hidden(std::string text, const std::vector<std::string>& secrets) {
  constexpr std::size_t least = 4;
  constexpr std::string_view shown = "(secret)";
  for (const std::string& secret : secrets) {
    if (secret.size() < least) continue;
    for (auto at = text.find(secret); at != std::string::npos; at = text.find(secret, at + shown.size()))
      text.replace(at, secret.size(), shown);
  }
  return text;
}

}  // namespace rtdata::detail
