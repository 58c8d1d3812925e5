/// TextScanner: reads JSON text in parallel with the JSON library, which reports values but not their places.
///
/// The library has already accepted the tokens, so the scanner only needs to find their ends. It counts lines and
/// characters once. Private to src/config.
#pragma once

#include <cstddef>
#include <string_view>

#include "rtdata/config/format.hpp"

namespace rtdata {

class TextScanner {
 public:
  explicit TextScanner(std::string_view text) : text_(text) {}

  /// A piece of the text and where it begins.
  struct Token {
    std::string_view text;
    ConfigBuilder::Position position;
  };

  /// Skips white space and comments, then takes one token: a string with its quotes, a word or number, or one
  /// character. Its text is empty at the end of the text. A string that does not end is taken to the end of its line.
  Token next();
  /// The same, after the commas and colons between two values.
  Token next_value();
  /// The line and column of a byte not yet passed.
  ConfigBuilder::Position position_of(std::size_t byte) const;
  /// Where the next token would be looked for.
  std::size_t offset() const noexcept { return offset_; }

 private:
  void skip_blank();
  void go_to(std::size_t byte);
  std::size_t end_of_token() const;

  std::string_view text_;
  std::size_t offset_ = 0;
  ConfigBuilder::Position position_{1, 1};
};

}  // namespace rtdata
