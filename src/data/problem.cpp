#include "rtdata/data/problem.hpp"

#include <algorithm>
#include <array>
#include <utility>

namespace rtdata {
namespace {

/// Longer words are not typing mistakes of a name; the limit also bounds the work.
constexpr std::size_t longest_word = 64;

std::string folded(std::string_view word) {
  std::string result(word);
  for (char& c : result) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
    if (c == '-') c = '_';
  }
  return result;
}

/// Damerau-Levenshtein: insertions, deletions, replacements and swaps of neighbours, no letter edited twice.
std::size_t distance(std::string_view a, std::string_view b) {
  std::array<std::array<std::size_t, longest_word + 1>, 3> rows{};
  auto* before = &rows[0];
  auto* previous = &rows[1];
  auto* current = &rows[2];
  for (std::size_t j = 0; j <= b.size(); ++j) (*previous)[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    (*current)[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t replaced = (*previous)[j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1);
      (*current)[j] = std::min({(*previous)[j] + 1, (*current)[j - 1] + 1, replaced});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1])
        (*current)[j] = std::min((*current)[j], (*before)[j - 2] + 1);
    }
    std::swap(before, previous);
    std::swap(previous, current);
  }
  return (*previous)[b.size()];
}

std::string first_and_count(const Problems& problems) {
  std::string text = problems[0].message;
  if (problems.size() > 1) text += " (and " + std::to_string(problems.size() - 1) + " more)";
  return text;
}

Error error_of(const Problems& problems) {
  Error error = problems[0].error();
  error.what = first_and_count(problems);
  return error;
}

}  // namespace

std::string ConfigPlace::text() const {
  if (line == 0) return file;
  return file + (file.empty() ? "line " : ":") + std::to_string(line) + ":" + std::to_string(column);
}

std::string Problem::text() const {
  std::string text;
  for (const std::string& part : {place.text(), path, message}) {
    if (part.empty()) continue;
    if (!text.empty()) text += ": ";
    text += part;
  }
  if (!suggestion.empty()) text += " (did you mean \"" + suggestion + "\"?)";
  return text;
}

std::string Problem::text_with_id() const { return detail::with_id(text(), id); }

Error Problem::error() const {
  std::string where = place.text();
  if (!path.empty()) where += (where.empty() ? "" : ": ") + path;
  return {Errc::bad_configuration, message, std::move(where), "",
          suggestion.empty() ? "" : "did you mean \"" + suggestion + "\"?"};
}

void Problems::add(std::string id, ConfigPlace place, std::string path, std::string message, std::string suggestion) {
  Problem& problem = list_.emplace_back();
  problem.id = std::move(id);
  problem.place = std::move(place);
  problem.path = std::move(path);
  problem.message = std::move(message);
  problem.suggestion = std::move(suggestion);
}

void Problems::append(const Problems& others) { list_.insert(list_.end(), others.begin(), others.end()); }

void Problems::sort() {
  std::stable_sort(list_.begin(), list_.end(), [](const Problem& a, const Problem& b) {
    return std::pair(a.place.line, a.place.column) < std::pair(b.place.line, b.place.column);
  });
}

std::string Problems::text() const {
  std::string text;
  for (const Problem& problem : list_) text += problem.text_with_id() + "\n";
  return text;
}

ConfigError::ConfigError(Problems problems) : SetupError(error_of(problems)), problems_(std::move(problems)) {}

std::string nearest_name(std::string_view word, const std::vector<std::string>& candidates) {
  if (word.empty() || word.size() > longest_word) return {};
  const std::string wanted = folded(word);
  std::string best;
  std::string begun;
  std::size_t begun_count = 0;
  std::size_t best_distance = longest_word;
  for (const std::string& candidate : candidates) {
    if (candidate.empty() || candidate.size() > longest_word) continue;
    const std::string name = folded(candidate);
    const std::size_t longer = std::max(name.size(), wanted.size());
    const std::size_t allowed = std::max<std::size_t>(1, longer / 3);
    const std::size_t edits = distance(wanted, name);
    if (edits <= allowed && edits < std::min(name.size(), wanted.size()) && edits < best_distance) {
      best = candidate;
      best_distance = edits;
    }
    if (wanted.size() >= 3 && name.starts_with(wanted)) {
      begun = candidate;
      ++begun_count;
    }
  }
  if (best.empty() && begun_count == 1) return begun;
  return best;
}

}  // namespace rtdata
