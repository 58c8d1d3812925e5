// Finds the types for a search word, from the words in their declarations.
#include <algorithm>
#include <array>

#include "rtdata/detail/config/parameter_info.hpp"

namespace rtdata {
namespace {

bool is_letter(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); }
bool is_small_letter(char c) { return c >= 'a' && c <= 'z'; }
bool is_digit(char c) { return c >= '0' && c <= '9'; }

/// "MPU-6050" is "mpu6050".
std::string plain(std::string_view word) {
  std::string result;
  for (const char c : word) {
    if (c >= 'A' && c <= 'Z') {
      result += static_cast<char>(c | 0x20);
    } else if (is_letter(c) || is_digit(c)) {
      result += c;
    }
  }
  return result;
}

/// The word as written in the text, in singular or plural; empty: not found.
std::string_view written(std::string_view text, const std::string& word) {
  while (!text.empty()) {
    const auto is_of_word = [](char c) { return is_letter(c) || is_digit(c) || c == '-' || c == '_'; };
    const auto first = std::find_if(text.begin(), text.end(), is_of_word);
    const auto last = std::find_if_not(first, text.end(), is_of_word);
    const std::string_view here = text.substr(static_cast<std::size_t>(first - text.begin()),
                                              static_cast<std::size_t>(last - first));
    const std::string found = plain(here);
    if (found == word || found == word + "s") return here;
    text.remove_prefix(static_cast<std::size_t>(last - text.begin()));
  }
  return {};
}

bool has_word(std::string_view text, const std::string& word) { return !written(text, word).empty(); }

/// A short word matches only in capitals: "they can" does not mean a CAN bus.
bool describes(std::string_view text, const std::string& word) {
  const std::string_view here = written(text, word);
  return word.size() > 3 ? !here.empty() : !std::all_of(here.begin(), here.end(), is_small_letter);
}

/// True for names of chips, such as sht31; other words are too common to search in long texts.
bool is_like_a_chip(const std::string& word) {
  return word.size() >= 4 && std::any_of(word.begin(), word.end(), is_digit) &&
         std::any_of(word.begin(), word.end(), is_letter);
}

bool names_what_it_is(const std::string& key) {
  constexpr std::array<std::string_view, 3> keys{"model", "format", "quantity"};
  return std::find(keys.begin(), keys.end(), key) != keys.end();
}

}  // namespace

WordFound find_word(const TypeInfo& type, std::string_view given) {
  const std::string word = plain(given);
  if (word.size() < 3) return {};
  for (const ParameterInfo& parameter : type.parameters) {
    if (!names_what_it_is(parameter.key)) continue;
    for (const std::string& choice : parameter.type.choices)
      if (plain(choice) == word) return {WordIn::choice, parameter.key, choice};
  }
  if (has_word(type.page.aliases, word)) return {WordIn::choice};
  if (describes(type.doc, word)) return {WordIn::description};
  if (!is_like_a_chip(word)) return {};
  bool is_found = has_word(type.page.notes, word);
  for (const ParameterInfo& parameter : type.parameters) is_found = is_found || has_word(parameter.doc, word);
  return {is_found ? WordIn::notes : WordIn::nothing};
}

std::vector<std::size_t> types_for_word(const std::vector<TypeInfo>& types, std::string_view word) {
  std::vector<std::size_t> best;
  WordIn closest = WordIn::nothing;
  for (std::size_t i = 0; i < types.size(); ++i) {
    const WordIn in = find_word(types[i], word).in;
    if (in == WordIn::nothing || in < closest) continue;
    if (in > closest) best.clear();
    closest = in;
    best.push_back(i);
  }
  return best;
}

}  // namespace rtdata
