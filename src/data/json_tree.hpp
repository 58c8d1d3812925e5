// JSON, and what is alike in CBOR, as a tree. Unlike nlohmann's it is destroyed without asking for memory: where there
// is none, its destructor would end the program. For what is read or written while a program records.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace rtdata::detail {

/// Numbers are as exact as they were written.
struct JsonNode {
  enum class Type { null, boolean, integer, natural, fraction, string, object, array };
  Type type = Type::null;
  bool flag = false;
  std::int64_t integer = 0;
  std::uint64_t natural = 0;
  double fraction = 0;
  std::string text;               ///< of a string, or the digits of a fraction
  std::vector<std::string> keys;  ///< of an object's children
  std::vector<JsonNode> children;

  /// The first of this key; null: there is none.
  const JsonNode* find(std::string_view key) const noexcept;
};

/// What is wrong with it; empty: nothing, and `root` is what it says. Nested 48 deep at most.
std::string parse_json(std::string_view text, JsonNode& root);
/// The same of CBOR; strings of bytes are texts, tags are mistakes.
std::string parse_cbor(std::span<const std::byte> bytes, JsonNode& root);

/// Appends `text` as JSON writes it, with its quotes; a byte that is no UTF-8 as U+FFFD.
void append_json(std::string& out, std::string_view text);

}  // namespace rtdata::detail
