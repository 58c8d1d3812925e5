/// Turns the error at which the JSON library stopped into a message for users. Private to src/config.
#pragma once

#include <string>
#include <string_view>

#include "config/read/text_scanner.hpp"

namespace rtdata {

/// The state when the library refuses a text.
struct JsonMistake {
  std::size_t bytes_read = 0;     ///< by the library
  std::string_view library_text;  ///< its own words
  bool number_too_large = false;
  bool in_object = false;          ///< what is being read lies in an object
  bool in_array = false;           ///< ... in an array
  bool after_key = false;          ///< the last thing accepted was a key
  bool after_value = false;        ///< ... was a whole value
  TextScanner::Token previous;     ///< the last thing accepted
  ConfigBuilder::Position opened;  ///< where the innermost object or array begins
};

/// `scanner` is after the last accepted token. The file and path of the result are empty.
Problem explain(const JsonMistake& mistake, TextScanner& scanner);

}  // namespace rtdata
