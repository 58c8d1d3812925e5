#include "data/json_tree.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "data/utf8.hpp"

namespace rtdata::detail {
namespace {

/// Builds nodes from nlohmann's events.
class Builder {
 public:
  explicit Builder(JsonNode& root) : root_(root) {}
  std::string error;

  bool null() { return add({}) != nullptr; }
  bool boolean(bool flag) {
    JsonNode* node = add(JsonNode::Type::boolean);
    node->flag = flag;
    return true;
  }
  bool number_integer(std::int64_t number) {
    add(JsonNode::Type::integer)->integer = number;
    return true;
  }
  bool number_unsigned(std::uint64_t number) {
    add(JsonNode::Type::natural)->natural = number;
    return true;
  }
  bool number_float(double number, const std::string& digits) {
    JsonNode* node = add(JsonNode::Type::fraction);
    node->fraction = number;
    node->text = digits;
    return true;
  }
  bool string(std::string& text) {
    add(JsonNode::Type::string)->text = std::move(text);
    return true;
  }
  bool binary(nlohmann::json::binary_t& bytes) {  // JSON has none
    add(JsonNode::Type::string)->text.assign(bytes.begin(), bytes.end());
    return true;
  }
  bool start_object(std::size_t) { return open(JsonNode::Type::object); }
  bool start_array(std::size_t) { return open(JsonNode::Type::array); }
  bool key(std::string& key) {
    open_.back()->keys.push_back(std::move(key));
    return true;
  }
  bool end_object() { return close(); }
  bool end_array() { return close(); }
  bool parse_error(std::size_t position, const std::string&, const nlohmann::json::exception& exception) {
    error = "at byte " + std::to_string(position) + ", ";
    // "[json.exception.parse_error.101] parse error at line 1, column 2: syntax error ..."
    const std::string_view what = exception.what();
    const auto colon = what.find(": ");
    error += what.substr(colon == std::string_view::npos ? 0 : colon + 2);
    return false;
  }

 private:
  static constexpr std::size_t deepest = 48;
  JsonNode* add(JsonNode::Type type) {
    if (open_.empty()) {
      root_.type = type;
      return &root_;
    }
    // Only the innermost open node grows, so the pointers to the others stay valid.
    JsonNode& made = open_.back()->children.emplace_back();
    made.type = type;
    return &made;
  }
  bool open(JsonNode::Type type) {
    if (open_.size() >= deepest) {
      error = "it is nested more than " + std::to_string(deepest) + " deep";
      return false;
    }
    open_.push_back(add(type));
    return true;
  }
  bool close() {
    open_.pop_back();
    return true;
  }

  JsonNode& root_;
  std::vector<JsonNode*> open_;
};

}  // namespace

const JsonNode* JsonNode::find(std::string_view key) const noexcept {
  const auto found = std::find(keys.begin(), keys.end(), key);
  return found == keys.end() ? nullptr : &children[static_cast<std::size_t>(found - keys.begin())];
}

std::string parse_json(std::string_view text, JsonNode& root) {
  Builder builder(root);
  if (nlohmann::json::sax_parse(text.begin(), text.end(), &builder)) return {};
  return builder.error.empty() ? "it is not JSON" : builder.error;
}

std::string parse_cbor(std::span<const std::byte> bytes, JsonNode& root) {
  Builder builder(root);
  const auto* begin = reinterpret_cast<const char*>(bytes.data());
  if (nlohmann::json::sax_parse(begin, begin + bytes.size(), &builder, nlohmann::json::input_format_t::cbor)) return {};
  return builder.error.empty() ? "it is not CBOR" : builder.error;
}

void append_json(std::string& out, std::string_view text) {
  constexpr std::string_view plain_escapes = "\"\"\\\\\bb\ff\nn\rr\tt";  // pairs of escape letter and character
  constexpr char digits[] = "0123456789abcdef";
  out += '"';
  while (!text.empty()) {
    const std::size_t size = text.front() == '\0' ? 1 : utf8_size(text);
    const char c = text.front();
    std::size_t known = 0;
    while (known < plain_escapes.size() && plain_escapes[known] != c) known += 2;
    if (size == 0) {
      out += "\xef\xbf\xbd";
    } else if (known < plain_escapes.size()) {
      out += '\\';
      out += plain_escapes[known + 1];
    } else if (static_cast<unsigned char>(c) < 0x20) {
      out += "\\u00";
      out += digits[static_cast<unsigned char>(c) >> 4];
      out += digits[c & 0xf];
    } else {
      out += text.substr(0, size);
    }
    text.remove_prefix(std::max<std::size_t>(size, 1));
  }
  out += '"';
}

}  // namespace rtdata::detail
