#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <utility>

#include "config/read/json_reader.hpp"
#include "data/listed.hpp"
#include "data/lower_case.hpp"
#include "data/utf8.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/detail/io/descriptor.hpp"

namespace rtdata {
namespace {

constexpr std::size_t largest_file = std::size_t{64} << 20;

ConfigPlace whole(const std::string& file) {
  ConfigPlace place;
  place.file = file;
  return place;
}

/// Reads the whole file, or adds a problem.
bool read_file(const std::string& file, std::string& text, Problems& problems) {
  const auto fail = [&](int error) {
    problems.add("cannot-read", whole(file), "",
                 "cannot read the configuration: " + std::generic_category().message(error));
    return false;
  };
  const detail::Descriptor descriptor(::open(file.c_str(), O_RDONLY | O_CLOEXEC));
  if (descriptor.fd() < 0) return fail(errno);
  struct stat status {};
  if (::fstat(descriptor.fd(), &status) == 0 && S_ISDIR(status.st_mode)) return fail(EISDIR);
  std::array<char, 65536> buffer{};
  for (;;) {
    const ssize_t count = ::read(descriptor.fd(), buffer.data(), buffer.size());
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return fail(errno);
    if (count == 0) return true;
    if (text.size() + static_cast<std::size_t>(count) > largest_file) {
      problems.add("too-large", whole(file), "", "the file is larger than 64 MiB");
      return false;
    }
    text.append(buffer.data(), static_cast<std::size_t>(count));
  }
}

bool check_encoding(std::string_view text, const std::string& file, Problems& problems) {
  ConfigPlace place{file, 1, 1};
  for (std::size_t i = 0; i < text.size();) {
    const std::size_t size = detail::utf8_size(text.substr(i));
    if (size == 0 || text[i] == '\0') {
      problems.add("bad-encoding", place, "",
                   size == 0 ? "this byte is not UTF-8: save the file as UTF-8" : "a NUL byte: the file is not text");
      return false;
    }
    ++place.column;
    if (text[i] == '\n') {
      ++place.line;
      place.column = 1;
    }
    i += size;
  }
  return true;
}

std::string extension_of(std::string_view file) {
  const std::size_t slash = file.rfind('/');
  const std::string_view name = slash == std::string_view::npos ? file : file.substr(slash + 1);
  const std::size_t dot = name.rfind('.');
  if (dot == std::string_view::npos || dot == 0) return "";
  return detail::lower_case(name.substr(dot));
}

/// Shows places of a text with their lines, in order of the text.
class Excerpts {
 public:
  explicit Excerpts(std::string_view text) : text_(text) {
    if (text_.starts_with(detail::byte_order_mark)) text_.remove_prefix(detail::byte_order_mark.size());
  }

  /// The line, cut when it is long, and below it a '^' under the column. Empty when the text has no such line.
  std::string at(const ConfigPlace& place) {
    constexpr std::size_t widest = 72;  // with "..." on both sides and the margin, 80 columns
    constexpr std::size_t ahead = 40;   // characters shown before the column when the line is cut
    const std::size_t first = place.column > ahead + widest / 4 ? place.column - ahead : 1;
    if (!go_to(place.line, first)) return "";
    std::string line = first > 1 ? "..." : "";
    std::string caret = first > 1 ? "   " : "";
    std::size_t column = column_;
    for (std::size_t i = offset_; !is_end_of_line(i); ++column) {
      if (column >= first + widest) {
        line += "...";
        break;
      }
      const std::size_t size = size_at(i);
      const char c = text_[i];
      const bool shows = static_cast<unsigned char>(c) >= 0x20 && c != 0x7f && (size > 1 || (c & 0x80) == 0);
      if (shows)
        line += text_.substr(i, size);
      else
        line += c == '\t' ? ' ' : '?';
      if (column < place.column) caret += ' ';
      i += size;
    }
    return "  " + line + "\n  " + caret + "^\n";
  }

 private:
  std::size_t size_at(std::size_t offset) const {
    return std::max<std::size_t>(1, detail::utf8_size(text_.substr(offset, 4)));
  }
  bool is_end_of_line(std::size_t offset) const {
    if (offset < text_.size() && text_[offset] == '\r') ++offset;
    return offset >= text_.size() || text_[offset] == '\n';
  }
  /// To this column, or to the end of the line before it. False when there is no such line.
  bool go_to(std::size_t line, std::size_t column) {
    if (line < line_ || (line == line_ && column < column_)) offset_ = 0, line_ = column_ = 1;
    for (; line_ < line; ++line_, column_ = 1) {
      const std::size_t end = text_.find('\n', offset_);
      if (end == std::string_view::npos) return false;
      offset_ = end + 1;
    }
    for (; column_ < column && !is_end_of_line(offset_); ++column_) offset_ += size_at(offset_);
    return true;
  }

  std::string_view text_;
  std::size_t offset_ = 0;  // of the character at line_ and column_
  std::size_t line_ = 1;
  std::size_t column_ = 1;
};

void parse(ConfigDocument& document, const ConfigFormats& formats) {
  const ConfigFormat* format = formats.find(document.file);
  if (format == nullptr) {
    std::vector<std::string> known = formats.extensions();
    std::erase(known, "");
    document.problems.add("unknown-format", whole(document.file), "",
                          "no configuration format has the extension \"" + extension_of(document.file) +
                              "\"; available: " + detail::listed(known));
    return;
  }
  std::string_view text = document.text;
  if (text.starts_with(detail::byte_order_mark)) text.remove_prefix(detail::byte_order_mark.size());
  if (text.find_first_not_of(" \t\r\n") == std::string_view::npos) {
    document.problems.add("empty", whole(document.file), "", "the configuration is empty");
    return;
  }
  if (check_encoding(text, document.file, document.problems))
    document.root = format->read(text, document.file, document.problems);
}

}  // namespace

ConfigFormats::ConfigFormats() { add(make_json_format()); }

void ConfigFormats::add(std::unique_ptr<ConfigFormat> format) { formats_.push_back(std::move(format)); }

const ConfigFormat* ConfigFormats::find(std::string_view file) const {
  const std::string extension = extension_of(file);
  for (auto format = formats_.rbegin(); format != formats_.rend(); ++format) {
    const auto known = (*format)->extensions();
    if (std::find(known.begin(), known.end(), extension) != known.end()) return format->get();
  }
  return nullptr;
}

std::vector<std::string> ConfigFormats::extensions() const {
  std::vector<std::string> all;
  for (const auto& format : formats_)
    for (const std::string& extension : format->extensions())
      if (std::find(all.begin(), all.end(), extension) == all.end()) all.push_back(extension);
  return all;
}

ConfigDocument load_config(const std::string& file, const ConfigFormats& formats) {
  ConfigDocument document;
  document.file = file;
  if (read_file(file, document.text, document.problems)) parse(document, formats);
  return document;
}

ConfigDocument load_config(const std::string& file) { return load_config(file, ConfigFormats()); }

ConfigDocument parse_config(std::string_view text, const std::string& name, const ConfigFormats& formats) {
  ConfigDocument document;
  document.file = name;
  document.text = text;
  parse(document, formats);
  return document;
}

ConfigDocument parse_config(std::string_view text, const std::string& name) {
  return parse_config(text, name, ConfigFormats());
}

ConfigItem ConfigDocument::or_throw() const {
  if (!problems.empty()) throw ConfigError(problems);
  return root;
}

std::string ConfigDocument::excerpt(const Problem& problem) const {
  if (problem.place.file != file || problem.place.line == 0) return "";
  return Excerpts(text).at(problem.place);
}

std::string ConfigDocument::report(const Problems& others, std::string_view prefix) const {
  Problems sorted = others;
  sorted.sort();
  Excerpts excerpts(text);
  std::string report;
  for (const Problem& problem : sorted) {
    report.append(prefix).append(problem.text_with_id()).append("\n");
    if (problem.place.file == file && problem.place.line != 0) report += excerpts.at(problem.place);
  }
  return report;
}

}  // namespace rtdata
