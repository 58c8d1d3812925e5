#include "app/core/terminal_text.hpp"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>

#include "app/core/table.hpp"
#include "data/utf8.hpp"

namespace rtdata::app {
namespace {

/// The indentation of a broken line: under its last column that begins in the first two thirds, otherwise two.
std::size_t indent_of(std::string_view line, std::size_t columns) {
  const std::size_t begin = std::min(line.find_first_not_of(' '), line.size());
  std::size_t indent = begin + 2;
  for (std::size_t at = begin; (at = line.find("  ", at)) != std::string_view::npos;) {
    const std::size_t next = line.find_first_not_of(' ', at);
    if (next == std::string_view::npos) break;
    const std::size_t column = width_of(line.substr(0, next));
    if (column * 3 > columns * 2) break;
    indent = column;
    at = next;
  }
  return std::min(indent, columns / 2 + columns / 6);
}

void wrap_line(std::string& out, std::string_view line, std::size_t columns) {
  if (width_of(line) <= columns || line.find('\x1b') != std::string_view::npos) {
    out += line;
    return;
  }
  const std::size_t indent = indent_of(line, columns);
  std::size_t column = 0;
  bool is_first = true;  // word of its line
  while (!line.empty()) {
    const std::size_t blanks = std::min(line.find_first_not_of(' '), line.size());
    const std::size_t end = std::min(line.find(' ', blanks), line.size());
    const std::string_view word = line.substr(blanks, end - blanks);
    line.remove_prefix(end);
    if (word.empty()) break;
    const std::size_t width = width_of(word);
    if (!is_first && column + blanks + width > columns) {
      out += '\n';
      out.append(indent, ' ');
      column = indent;
    } else {
      out.append(blanks, ' ');
      column += blanks;
    }
    out += word;
    column += width;
    is_first = false;
  }
}

}  // namespace

std::string printable(std::string_view text) {
  std::string safe;
  while (!text.empty()) {
    const std::size_t size = detail::utf8_size(text);
    const auto first = static_cast<unsigned char>(text[0]);
    const bool is_second_set = size == 2 && first == 0xc2 && (text[1] & 0xe0) == 0x80;  // U+0080 to U+009F
    if (size == 0 || first < 0x20 || first == 0x7f || is_second_set) {
      safe += '?';
    } else {
      safe += text.substr(0, size);
    }
    text.remove_prefix(std::max<std::size_t>(size, 1));
  }
  return safe;
}

std::size_t columns_of(int fd) {
  if (::isatty(fd) != 1) return 0;
  winsize size{};
  return ::ioctl(fd, TIOCGWINSZ, &size) == 0 && size.ws_col != 0 ? std::max<std::size_t>(size.ws_col, 20) : 80;
}

std::string wrapped(std::string_view text, std::size_t columns) {
  if (columns == 0) return std::string(text);
  std::string out;
  while (!text.empty()) {
    const std::size_t end = text.find('\n');
    wrap_line(out, text.substr(0, end), columns);
    if (end == std::string_view::npos) break;
    out += '\n';
    text.remove_prefix(end + 1);
  }
  return out;
}

std::string for_terminal(std::string_view text, std::size_t columns) {
  return columns == 0 ? std::string(text) : wrapped(detail::visible(text, true), columns);
}

void print_error(std::ostream& to, const std::string& text, std::string_view id) {
  to << "rtdata: " << detail::with_id(text, id) << std::endl;
}

void print_error(std::ostream& to, const Error& error) { print_error(to, error.text(), error.id()); }

WrappedOutput::WrappedOutput(std::ostream& stream, int fd)
    : stream_(stream), to_(stream.rdbuf()), columns_(columns_of(fd)), flags_(stream.flags()) {
  if (columns_ == 0) return;
  stream.unsetf(std::ios::unitbuf);  // otherwise a line of standard error would be written in pieces
  stream.rdbuf(this);
}

WrappedOutput::~WrappedOutput() {
  if (columns_ == 0) return;
  sync();
  stream_.rdbuf(to_);
  stream_.flags(flags_);
}

int WrappedOutput::overflow(int character) {
  if (character == traits_type::eof()) return traits_type::not_eof(character);
  const char c = traits_type::to_char_type(character);
  return xsputn(&c, 1) == 1 ? character : traits_type::eof();
}

std::streamsize WrappedOutput::xsputn(const char* text, std::streamsize size) {
  line_.append(text, static_cast<std::size_t>(size));
  return write_lines() ? size : 0;
}

int WrappedOutput::sync() {
  const bool is_written = to_->sputn(line_.data(), static_cast<std::streamsize>(line_.size())) ==
                          static_cast<std::streamsize>(line_.size());
  line_.clear();
  return to_->pubsync() == 0 && is_written ? 0 : -1;
}

bool WrappedOutput::write_lines() {
  const std::size_t end = line_.rfind('\n');
  if (end == std::string::npos) return true;
  const std::string text = for_terminal(std::string_view(line_).substr(0, end + 1), columns_);
  line_.erase(0, end + 1);
  return to_->sputn(text.data(), static_cast<std::streamsize>(text.size())) ==
         static_cast<std::streamsize>(text.size());
}

}  // namespace rtdata::app
