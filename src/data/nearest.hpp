/// Finds the known word nearest to an unknown one, for advice in errors.
#pragma once

#include <algorithm>
#include <string>
#include <string_view>
#include <vector>

namespace rtdata::detail {

/// The number of letters to insert, remove or replace to change one word into the other.
inline std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t replaced = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, replaced});
    }
  }
  return row[b.size()];
}

/// "did you mean NAME?", or "known are A, B, C" when none is near.
inline std::string suggestion(std::string_view word, const std::vector<std::string_view>& known) {
  if (known.empty()) return {};
  if (word.size() <= 64) {
    std::string_view best;
    std::size_t least = std::max<std::size_t>(2, word.size() / 3) + 1;
    for (const auto candidate : known) {
      if (candidate.size() > 64) continue;
      if (const auto distance = edit_distance(word, candidate); distance < least) {
        least = distance;
        best = candidate;
      }
    }
    if (!best.empty()) return "did you mean " + std::string(best) + "?";
  }
  std::string text = "known are";
  for (std::size_t i = 0; i < known.size() && i < 12; ++i) text.append(i == 0 ? " " : ", ").append(known[i]);
  if (known.size() > 12) text += ", ...";
  return text;
}

}  // namespace rtdata::detail
