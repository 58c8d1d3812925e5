#include "data/utf8.hpp"

#include <algorithm>
#include <cstdint>
#include <cstring>

namespace rtdata::detail {
namespace {

constexpr char digits[] = "0123456789abcdef";

int value_of(char digit) noexcept {
  if (digit >= '0' && digit <= '9') return digit - '0';
  if (digit >= 'a' && digit <= 'f') return digit - 'a' + 10;
  return -1;
}

/// The start of `text` that is ASCII without zero bytes and backslashes.
std::size_t plain_size(std::string_view text) noexcept {
  std::size_t i = 0;
  for (; i + 8 <= text.size(); i += 8) {
    constexpr std::uint64_t ones = 0x0101010101010101, tops = 0x8080808080808080;
    std::uint64_t word;
    std::memcpy(&word, text.data() + i, sizeof word);
    const std::uint64_t backslash = word ^ (ones * '\\');
    // A zero byte borrows from its top bit.
    if ((((word - ones) & ~word) | word | ((backslash - ones) & ~backslash)) & tops) break;
  }
  while (i < text.size() && text[i] != '\0' && text[i] != '\\' && static_cast<unsigned char>(text[i]) < 0x80) ++i;
  return i;
}

/// The size of the next piece without escapes; 0: the first byte must be escaped.
std::size_t piece(std::string_view text, bool keeps_backslash) noexcept {
  if (text.front() == '\\') return keeps_backslash || escaped_byte(text) < 0 ? 1 : 0;
  return text.front() == '\0' ? 0 : utf8_size(text);
}

void append_byte(std::string& out, char c) {
  const auto byte = static_cast<unsigned char>(c);
  const char written[] = {'\\', 'x', digits[byte >> 4], digits[byte & 0xf]};
  out.append(written, sizeof written);
}

void append(std::string& out, std::string_view text, bool keeps_backslash) {
  while (!text.empty()) {
    std::size_t size = plain_size(text);
    if (size == 0) size = piece(text, keeps_backslash);
    if (size == 0) {
      append_byte(out, text.front());
      size = 1;
    } else {
      out.append(text.substr(0, size));
    }
    text.remove_prefix(size);
  }
}

bool is_same(std::string_view text, bool keeps_backslash) noexcept {
  while (!text.empty()) {
    std::size_t size = plain_size(text);
    if (size == 0) size = piece(text, keeps_backslash);
    if (size == 0) return false;
    text.remove_prefix(size);
  }
  return true;
}

}  // namespace

std::size_t utf8_size(std::string_view text) noexcept {
  const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(text[i]); };
  const auto follows = [&](std::size_t count) {
    if (text.size() <= count) return false;
    for (std::size_t i = 1; i <= count; ++i) {
      if ((byte(i) & 0xc0) != 0x80) return false;
    }
    return true;
  };
  const unsigned char first = byte(0);
  if (first < 0x80) return 1;
  if (first >= 0xc2 && first <= 0xdf) return follows(1) ? 2 : 0;
  if (first >= 0xe0 && first <= 0xef) {  // no longer than needed, no surrogates
    return follows(2) && !(first == 0xe0 && byte(1) < 0xa0) && !(first == 0xed && byte(1) > 0x9f) ? 3 : 0;
  }
  if (first >= 0xf0 && first <= 0xf4) {  // up to U+10FFFF
    return follows(3) && !(first == 0xf0 && byte(1) < 0x90) && !(first == 0xf4 && byte(1) > 0x8f) ? 4 : 0;
  }
  return 0;
}

bool is_utf8(std::string_view text) noexcept {
  while (!text.empty()) {
    std::size_t size = plain_size(text);
    if (size == 0) size = utf8_size(text);
    if (size == 0) return false;
    text.remove_prefix(size);
  }
  return true;
}

std::size_t control_size(std::string_view text) noexcept {
  const auto first = static_cast<unsigned char>(text.front());
  if (first < 0x20 || first == 0x7f) return 1;
  return first == 0xc2 && text.size() > 1 && (text[1] & 0xe0) == 0x80 ? 2 : 0;
}

std::string visible(std::string_view text, bool keeps_lines) {
  std::string out;
  while (!text.empty()) {
    const bool is_kept = keeps_lines && (text.front() == '\n' || text.front() == '\t');
    const std::size_t character = utf8_size(text);
    const std::size_t control = is_kept ? 0 : control_size(text);
    const std::size_t size = std::max<std::size_t>(character, 1);
    if (character == 0 || control > 0) {
      for (const char c : text.substr(0, size)) append_byte(out, c);
    } else {
      out.append(text.substr(0, size));
    }
    text.remove_prefix(size);
  }
  return out;
}

std::string readable(std::string_view text) {
  std::string out;
  out.reserve(text.size());
  append(out, text, true);
  return out;
}

bool is_readable(std::string_view text) noexcept { return is_same(text, true); }

void append_escaped(std::string& out, std::string_view text) { append(out, text, false); }

bool needs_escape(std::string_view text) noexcept { return !is_same(text, false); }

int escaped_byte(std::string_view text) noexcept {
  if (text.size() < 4 || text[0] != '\\' || text[1] != 'x') return -1;
  const int high = value_of(text[2]), low = value_of(text[3]);
  if (high < 0 || low < 0) return -1;
  const int byte = high * 16 + low;
  return byte == 0 || byte == '\\' || byte >= 0x80 ? byte : -1;
}

std::string unescaped(std::string_view text) {
  std::string out;
  out.reserve(text.size());
  while (!text.empty()) {
    const int byte = escaped_byte(text);
    out += byte < 0 ? text.front() : static_cast<char>(static_cast<unsigned char>(byte));
    text.remove_prefix(byte < 0 ? 1 : 4);
  }
  return out;
}

bool has_escape(std::string_view text) noexcept {
  for (std::size_t at = text.find('\\'); at != std::string_view::npos; at = text.find('\\', at + 1)) {
    if (escaped_byte(text.substr(at)) >= 0) return true;
  }
  return false;
}

}  // namespace rtdata::detail
