#include "rtdata/config/format.hpp"

#include <algorithm>
#include <cstddef>

#include "config/read/text_scanner.hpp"
#include "data/utf8.hpp"

namespace rtdata {
namespace {

/// The byte at a place; the end of the text if there is no such place.
std::size_t byte_at(std::string_view text, const ConfigPlace& place) {
  std::size_t at = text.starts_with(detail::byte_order_mark) ? detail::byte_order_mark.size() : 0;
  for (std::size_t line = 1; line < place.line && at < text.size(); ++line)
    at = std::min(text.find('\n', at), text.size() - 1) + 1;
  for (std::size_t column = 1; column < place.column && at < text.size(); ++column) {
    ++at;
    while (at < text.size() && (static_cast<unsigned char>(text[at]) & 0xc0) == 0x80) ++at;
  }
  return at;
}

/// Behind the value that begins there.
std::size_t end_of_value(std::string_view text, std::size_t begin) {
  TextScanner scanner(text.substr(std::min(begin, text.size())));
  std::size_t depth = 0;
  while (true) {
    const std::string_view token = scanner.next().text;
    if (token == "{" || token == "[") ++depth;
    if ((token == "}" || token == "]") && depth > 0) --depth;
    if (depth == 0 || token.empty()) return begin + scanner.offset();
  }
}

/// The next token from there on, without comments.
std::size_t next_token(std::string_view text, std::size_t from) {
  TextScanner scanner(text.substr(from));
  const std::size_t size = scanner.next().text.size();
  return from + scanner.offset() - size;
}

/// The end of the line, if only blanks and a comment follow from `end` on; otherwise `end`.
std::size_t end_of_line_with_comment(std::string_view text, std::size_t end) {
  const std::size_t line_end = text.find('\n', end);
  const std::string_view rest = text.substr(end, line_end == std::string_view::npos ? line_end : line_end - end);
  if (line_end == std::string_view::npos || !TextScanner(rest).next().text.empty()) return end;
  return line_end;
}

const ConfigChild* child_of(const ConfigItem& object, std::string_view key) {
  for (const ConfigChild& child : object.children())
    if (child.key == key) return &child;
  return nullptr;
}

std::string one_line(const ConfigItem& item) { return item.to_json(ConfigItem::Layout::one_line); }

}  // namespace

std::string with_member(const ConfigDocument& document, const ConfigItem& object, std::string_view key,
                        const ConfigItem& value) {
  std::string text = document.text;
  if (const ConfigChild* const known = child_of(object, key)) {
    const std::size_t begin = byte_at(text, known->item.place());
    return text.replace(begin, end_of_value(text, begin) - begin, one_line(value));
  }
  const std::string member = one_line(ConfigItem::of(key)) + ": " + one_line(value);
  if (object.size() == 0) {
    const std::size_t brace = byte_at(text, object.place());
    return text.insert(std::min(brace + 1, text.size()), member);
  }
  const ConfigItem& last = object.children().back().item;
  const std::size_t key_begin = byte_at(text, last.key_place());
  const std::size_t end = end_of_value(text, byte_at(text, last.place()));
  // On a line of its own if the last member begins one.
  const std::size_t line = text.rfind('\n', key_begin) + 1;  // 0: there is none
  if (line == 0 || text.find_first_not_of(" \t\r\n", line) != key_begin) return text.insert(end, ", " + member);
  std::size_t at = end_of_line_with_comment(text, end);
  std::string ending = "\n";
  if (at > end && at < text.size() && text[at - 1] == '\r') {
    --at;
    ending = "\r\n";
  }
  text.insert(at, ending + text.substr(line, key_begin - line) + member);
  return text.insert(end, ",");
}

std::string without_member(const ConfigDocument& document, const ConfigItem& object, std::string_view key) {
  std::string text = document.text;
  const ConfigChild* const child = child_of(object, key);
  if (child == nullptr) return text;
  std::size_t begin = byte_at(text, child->item.key_place());
  std::size_t end = end_of_value(text, byte_at(text, child->item.place()));
  if (const std::size_t comma = next_token(text, end); comma < text.size() && text[comma] == ',') {
    text.erase(comma, 1);  // a comment before it stays
    end = std::min(text.find_first_not_of(" \t", end), text.size());
  } else if (&object.children().front() != child) {  // the last one: the comma before it goes
    const ConfigItem& before = (child - 1)->item;
    const std::size_t before_end = end_of_value(text, byte_at(text, before.place()));
    text.erase(next_token(text, before_end), 1);
    --begin;
    --end;
    while (begin > before_end && (text[begin - 1] == ' ' || text[begin - 1] == '\t')) --begin;
  }
  // Its line goes, too, if nothing else is there.
  const std::size_t line = text.rfind('\n', begin == 0 ? 0 : begin - 1) + 1;
  const std::size_t line_end = text.find('\n', end);
  const bool is_alone = text.find_first_not_of(" \t", line) >= begin && line_end != std::string::npos &&
                        text.find_first_not_of(" \t\r", end) == line_end && line > 0;
  if (is_alone) return text.erase(line, line_end + 1 - line);
  return text.erase(begin, end - begin);
}

}  // namespace rtdata
