// A tree for JSON and the similar part of CBOR. Its destructor does not allocate; nlohmann's does, which would end the
// program without memory. For use while a program records.
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

/// Parses the text into `root`; returns the error, or an empty text. At most 48 levels of nesting.
std::string parse_json(std::string_view text, JsonNode& root);
/// The same for CBOR; byte strings become texts, tags are errors.
std::string parse_cbor(std::span<const std::byte> bytes, JsonNode& root);

/// Appends `text` as a JSON string with quotes; a byte that is not UTF-8 becomes U+FFFD.
void append_json(std::string& out, std::string_view text);

}  // namespace rtdata::detail
