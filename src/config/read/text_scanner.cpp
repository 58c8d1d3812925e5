#include "config/read/text_scanner.hpp"

#include <algorithm>

namespace rtdata {
namespace {

constexpr std::string_view blanks = " \t\r\n";
constexpr std::string_view ends_of_words = " \t\r\n,:[]{}\"/";

ConfigBuilder::Position advanced(ConfigBuilder::Position position, std::string_view over) {
  for (const char c : over) {
    if (c == '\n')
      position = {position.line + 1, 1};
    else if ((static_cast<unsigned char>(c) & 0xc0) != 0x80)
      ++position.column;
  }
  return position;
}

}  // namespace

void TextScanner::go_to(std::size_t byte) {
  byte = std::min(byte, text_.size());
  position_ = advanced(position_, text_.substr(offset_, byte - offset_));
  offset_ = byte;
}

ConfigBuilder::Position TextScanner::position_of(std::size_t byte) const {
  if (byte <= offset_) return position_;
  return advanced(position_, text_.substr(offset_, byte - offset_));
}

void TextScanner::skip_blank() {
  for (;;) {
    go_to(text_.find_first_not_of(blanks, offset_));
    const std::string_view rest = text_.substr(offset_);
    if (rest.starts_with("//")) {
      go_to(text_.find_first_of("\r\n", offset_));
    } else if (rest.starts_with("/*")) {
      const std::size_t close = text_.find("*/", offset_ + 2);
      if (close == std::string_view::npos) return;  // the comment is the token that is wrong
      go_to(close + 2);
    } else {
      return;
    }
  }
}

std::size_t TextScanner::end_of_token() const {
  if (offset_ == text_.size()) return offset_;
  if (text_[offset_] == '"') {
    for (std::size_t i = offset_ + 1; i < text_.size(); ++i) {
      if (text_[i] == '\\')
        ++i;
      else if (text_[i] == '"')
        return i + 1;
      else if (text_[i] == '\n')
        return i;
    }
    return text_.size();
  }
  const std::size_t end = text_.find_first_of(ends_of_words, offset_);
  return end == std::string_view::npos ? text_.size() : std::max(end, offset_ + 1);
}

TextScanner::Token TextScanner::next() {
  skip_blank();
  const Token token{text_.substr(offset_, end_of_token() - offset_), position_};
  go_to(offset_ + token.text.size());
  return token;
}

TextScanner::Token TextScanner::next_value() {
  Token token = next();
  while (token.text == "," || token.text == ":") token = next();
  return token;
}

}  // namespace rtdata
