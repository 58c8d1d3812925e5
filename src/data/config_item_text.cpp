#include <array>
#include <charconv>
#include <nlohmann/json.hpp>

#include "rtdata/data/config_item.hpp"

namespace rtdata {
namespace {

std::string shortest(double value) {
  std::array<char, 32> buffer{};
  const auto end = std::to_chars(buffer.data(), buffer.data() + buffer.size(), value).ptr;
  std::string text(buffer.data(), end);
  if (text.find_first_of(".e") == std::string::npos) text += ".0";  // stays a number, does not become an integer
  return text;
}

std::string json_string(std::string_view text) {
  return nlohmann::json(text).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

/// At most `limit` characters of a text, cut between characters.
std::string beginning(std::string_view text, std::size_t limit) {
  std::size_t count = 0;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if ((static_cast<unsigned char>(text[i]) & 0xc0) == 0x80) continue;
    if (count++ == limit) return std::string(text.substr(0, i)) + "...";
  }
  return std::string(text);
}

void write(const ConfigItem& item, ConfigItem::Layout layout, std::size_t depth, std::string& out) {
  const bool lines = layout == ConfigItem::Layout::indented;
  const auto new_line = [&](std::size_t level) {
    if (lines) out.append("\n").append(2 * level, ' ');
  };
  switch (item.kind()) {
    case ConfigItem::Kind::null:
      out += "null";
      return;
    case ConfigItem::Kind::boolean:
      out += *item.as_boolean() ? "true" : "false";
      return;
    case ConfigItem::Kind::integer:
    case ConfigItem::Kind::number:
      out += item.number_text();
      return;
    case ConfigItem::Kind::string:
      out += json_string(*item.as_string());
      return;
    case ConfigItem::Kind::array:
    case ConfigItem::Kind::object:
      break;
  }
  const bool array = item.is_array();
  out += array ? '[' : '{';
  bool first = true;
  for (const auto& [key, child] : item.children()) {
    if (!first) out += lines ? "," : ", ";
    first = false;
    new_line(depth + 1);
    if (!array) out += json_string(key) + ": ";
    write(child, layout, depth + 1, out);
  }
  if (!first) new_line(depth);
  out += array ? ']' : '}';
}

}  // namespace

std::string ConfigItem::to_json(Layout layout) const {
  std::string text;
  write(*this, layout, 0, text);
  return text;
}

std::string ConfigItem::number_text() const {
  if (const std::int64_t* integer = as_signed()) return std::to_string(*integer);
  if (const std::uint64_t* integer = as_unsigned()) return std::to_string(*integer);
  if (const Number* number = std::get_if<Number>(&value_))
    return number->literal.empty() ? shortest(number->value) : number->literal;
  return "";
}

const double* ConfigItem::as_number() const noexcept {
  const Number* number = std::get_if<Number>(&value_);
  return number == nullptr ? nullptr : &number->value;
}

std::string ConfigItem::describe() const {
  switch (kind()) {
    case Kind::null:
      return "null";
    case Kind::boolean:
      return *as_boolean() ? "true" : "false";
    case Kind::integer:
    case Kind::number:
      return "the number " + beginning(number_text(), 40);
    case Kind::string:
      return "the string " + json_string(beginning(*as_string(), 40));
    case Kind::array:
      return size() == 0 ? "an empty list" : "a list";
    case Kind::object:
      return size() == 0 ? "an empty object" : "an object";
  }
  return "null";
}

}  // namespace rtdata
