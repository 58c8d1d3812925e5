#include "config/read/json_mistake.hpp"

#include <algorithm>

namespace rtdata {
namespace {

using Token = TextScanner::Token;

Problem problem(ConfigBuilder::Position position, std::string message, std::string suggestion = {}) {
  return {"syntax", {"", position.line, position.column}, "", std::move(message), std::move(suggestion)};
}

std::string shown(const Token& token) {
  if (token.text.empty()) return "the end of the file";
  std::size_t length = std::min<std::size_t>(token.text.size(), 30);
  while (length < token.text.size() && (static_cast<unsigned char>(token.text[length]) & 0xc0) == 0x80) ++length;
  std::string text(token.text.substr(0, length));
  if (length < token.text.size()) text += "...";
  if (token.text.front() == '"') return "the string " + text;
  return "'" + text + "'";
}

bool is_closing(const Token& token) { return token.text == "]" || token.text == "}"; }

/// Skips digits from `i` and says whether there were any.
bool digits(std::string_view word, std::size_t& i) {
  const std::size_t start = i;
  while (i < word.size() && word[i] >= '0' && word[i] <= '9') ++i;
  return i > start;
}

bool is_json_number(std::string_view word) {
  std::size_t i = word.starts_with('-') ? 1 : 0;
  if (i + 1 < word.size() && word[i] == '0' && word[i + 1] >= '0' && word[i + 1] <= '9') return false;
  if (!digits(word, i)) return false;
  if (i < word.size() && word[i] == '.' && !digits(word, ++i)) return false;
  if (i < word.size() && (word[i] == 'e' || word[i] == 'E')) {
    ++i;
    if (i < word.size() && (word[i] == '+' || word[i] == '-')) ++i;
    if (!digits(word, i)) return false;
  }
  return i == word.size();
}

/// True if only the beginning of a token was taken as a value: 01, 5V, truely.
bool is_half_a_word(const Token& token) {
  if (token.text.empty() || std::string_view("\"[]{}").find(token.text.front()) != std::string_view::npos) return false;
  return token.text != "true" && token.text != "false" && token.text != "null" && !is_json_number(token.text);
}

std::string opening(const JsonMistake& mistake) {
  return std::string(mistake.in_object ? "the object" : "the list") + " that begins at line " +
         std::to_string(mistake.opened.line) + ", column " + std::to_string(mistake.opened.column);
}

Problem never_closed(const JsonMistake& mistake, const Token& token) {
  return problem(token.position, "the file ends here, but " + opening(mistake) + " is not closed");
}

Problem in_a_string(const JsonMistake& mistake, const TextScanner& before, const Token& token) {
  // The library's words: "... - invalid string: REASON; last read: '...'".
  std::string_view reason = mistake.library_text;
  constexpr std::string_view start = "invalid string: ";
  if (const std::size_t at = reason.find(start); at != std::string_view::npos) reason.remove_prefix(at + start.size());
  reason = reason.substr(0, reason.find("; last read"));
  if (reason.find("(LF)") != std::string_view::npos || reason.find("(CR)") != std::string_view::npos ||
      reason.starts_with("missing closing"))
    return problem(token.position, "this string is not closed: its second '\"' is missing on this line");
  return problem(before.position_of(mistake.bytes_read == 0 ? 0 : mistake.bytes_read - 1),
                 "this character cannot be in a string: " + std::string(reason));
}

Problem bad_word(const Token& token) {
  const char first = token.text.front();
  if ((first >= '0' && first <= '9') || first == '-' || first == '+' || first == '.')
    return problem(token.position,
                   shown(token) + " is not a number as JSON writes it; text, and values with a unit, need \"quotes\"");
  return problem(token.position, "expected a value, found " + shown(token) + "; text needs \"quotes\"",
                 nearest_name(token.text, {"true", "false", "null"}));
}

/// Quotes as written by word processors and web pages.
bool has_typographic_quote(std::string_view text) {
  for (const std::string_view quote : {"\u201c", "\u201d", "\u201e", "\u2018", "\u2019", "\u00ab", "\u00bb"})
    if (text.starts_with(quote)) return true;
  return false;
}

/// Explains a token that is wrong in any context; false if it is not.
bool broken_token(const JsonMistake& mistake, const TextScanner& before, const Token& token, Problem& out) {
  if (token.text.empty()) return false;
  if (token.text.front() == '"' && mistake.library_text.find("invalid string") != std::string_view::npos)
    out = in_a_string(mistake, before, token);
  else if (token.text.front() == '/')
    out = problem(token.position, mistake.library_text.find("missing closing") != std::string_view::npos
                                      ? "this comment is not closed: there is no '*/'"
                                      : "a '/' alone is not a comment: write // or /* */");
  else if (token.text.front() == '\'')
    out = problem(token.position, "text needs double quotes (\"), not single ones");
  else if (token.text.front() == '#')
    out = problem(token.position, "a comment begins with //, not with '#'");
  else if (has_typographic_quote(token.text))
    out = problem(token.position, "text needs plain double quotes (\"), not typographic ones: " + shown(token));
  else
    return false;
  return true;
}

Problem bad_value(const JsonMistake& mistake, const Token& token) {
  if (token.text.empty() && (mistake.in_object || mistake.in_array)) return never_closed(mistake, token);
  if (mistake.number_too_large) {
    Problem result = problem(token.position, "the number " + std::string(token.text.substr(0, 40)) + " is too large");
    result.id = "out-of-range";
    return result;
  }
  if (is_half_a_word(token) && token.text != "," && token.text != ":") return bad_word(token);
  return problem(token.position, "expected a value, found " + shown(token));
}

Problem bad_key(const JsonMistake& mistake, const Token& token) {
  if (token.text.empty()) return never_closed(mistake, token);
  return problem(token.position, "expected a key in \"quotes\", found " + shown(token));
}

}  // namespace

Problem explain(const JsonMistake& mistake, TextScanner& scanner) {
  if (is_half_a_word(mistake.previous)) return bad_word(mistake.previous);
  TextScanner before = scanner;
  Token token = scanner.next();
  Token comma;
  if (mistake.after_key) {
    if (token.text == ":") {
      before = scanner;
      token = scanner.next();
    } else if (!token.text.empty()) {
      return problem(token.position, "expected ':' after the key, found " + shown(token));
    }
  } else if (mistake.after_value && token.text == "," && (mistake.in_object || mistake.in_array)) {
    comma = token;
    before = scanner;
    token = scanner.next();
  }

  Problem broken;
  if (broken_token(mistake, before, token, broken)) return broken;
  if (mistake.after_key) return bad_value(mistake, token);
  if (!comma.text.empty()) {
    if (is_closing(token)) return problem(comma.position, "there is an extra comma before " + shown(token));
    if (token.text == ",") return problem(token.position, "there is an extra comma");
    return mistake.in_object ? bad_key(mistake, token) : bad_value(mistake, token);
  }
  if (!mistake.after_value) return mistake.in_object ? bad_key(mistake, token) : bad_value(mistake, token);
  if (!mistake.in_object && !mistake.in_array)
    return problem(token.position, "the configuration has ended, but here is " + shown(token));
  if (token.text.empty()) return never_closed(mistake, token);
  const std::string closing = mistake.in_object ? "'}'" : "']'";
  if (is_closing(token))
    return problem(token.position, "expected " + closing + " to close " + opening(mistake) + ", found " + shown(token));
  return problem(token.position,
                 "expected ',' or " + closing + ", found " + shown(token) + "; is a comma missing before it?");
}

}  // namespace rtdata
