#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <utility>

#include "config/json_reader.hpp"
#include "rtdata/config/format.hpp"

namespace rtdata {
namespace {

constexpr std::size_t largest_file = std::size_t{64} << 20;
constexpr std::string_view byte_order_mark = "\xef\xbb\xbf";

struct Descriptor {
  int fd = -1;
  ~Descriptor() {
    if (fd >= 0) ::close(fd);
  }
};

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
  const Descriptor descriptor{::open(file.c_str(), O_RDONLY | O_CLOEXEC)};
  if (descriptor.fd < 0) return fail(errno);
  struct stat status {};
  if (::fstat(descriptor.fd, &status) == 0 && S_ISDIR(status.st_mode)) return fail(EISDIR);
  std::array<char, 65536> buffer{};
  for (;;) {
    const ssize_t count = ::read(descriptor.fd, buffer.data(), buffer.size());
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

/// Bytes of the character that begins here, 0 when it is not valid UTF-8.
std::size_t character_size(std::string_view text) {
  const auto byte = [&](std::size_t i) { return i < text.size() ? static_cast<unsigned char>(text[i]) : 0u; };
  const auto follows = [&](std::size_t i) { return (byte(i) & 0xc0) == 0x80; };
  const unsigned first = byte(0);
  if (first < 0x80) return 1;
  if (first >= 0xc2 && first <= 0xdf) return follows(1) ? 2 : 0;
  if (first >= 0xe0 && first <= 0xef) {
    const bool overlong = first == 0xe0 && byte(1) < 0xa0;
    const bool surrogate = first == 0xed && byte(1) >= 0xa0;
    return follows(1) && follows(2) && !overlong && !surrogate ? 3 : 0;
  }
  if (first >= 0xf0 && first <= 0xf4) {
    const bool overlong = first == 0xf0 && byte(1) < 0x90;
    const bool beyond = first == 0xf4 && byte(1) >= 0x90;
    return follows(1) && follows(2) && follows(3) && !overlong && !beyond ? 4 : 0;
  }
  return 0;
}

bool check_encoding(std::string_view text, const std::string& file, Problems& problems) {
  ConfigPlace place{file, 1, 1};
  for (std::size_t i = 0; i < text.size();) {
    const std::size_t size = character_size(text.substr(i));
    if (size == 0 || text[i] == '\0') {
      problems.add("bad-encoding", place, "",
                   size == 0 ? "this byte is not UTF-8: save the file as UTF-8" : "a NUL byte: the file is no text");
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
  std::string extension(name.substr(dot));
  for (char& c : extension)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  return extension;
}

void parse(ConfigDocument& document, const ConfigFormats& formats) {
  const ConfigFormat* format = formats.find(document.file);
  if (format == nullptr) {
    std::string known;
    for (const std::string& extension : formats.extensions())
      if (!extension.empty()) known += (known.empty() ? "" : ", ") + extension;
    document.problems.add(
        "unknown-format", whole(document.file), "",
        "no configuration format has the extension \"" + extension_of(document.file) + "\"; there are " + known);
    return;
  }
  std::string_view text = document.text;
  if (text.starts_with(byte_order_mark)) text.remove_prefix(byte_order_mark.size());
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
  constexpr std::size_t widest = 72;  // with "..." on both sides and the margin, 80 columns
  constexpr std::size_t ahead = 40;   // characters shown before the column when the line is cut
  std::string_view rest = text;
  if (rest.starts_with(byte_order_mark)) rest.remove_prefix(byte_order_mark.size());
  for (std::size_t line = 1; line < problem.place.line; ++line) {
    const std::size_t end = rest.find('\n');
    if (end == std::string_view::npos) return "";
    rest.remove_prefix(end + 1);
  }
  rest = rest.substr(0, rest.find('\n'));
  if (rest.ends_with('\r')) rest.remove_suffix(1);

  const std::size_t column = problem.place.column;
  const std::size_t first = column > ahead + widest / 4 ? column - ahead : 1;
  std::string line = first > 1 ? "..." : "";
  std::string caret = first > 1 ? "   " : "";
  std::size_t at = 1;
  for (std::size_t i = 0; i < rest.size(); ++at) {
    const std::size_t size = std::max<std::size_t>(1, character_size(rest.substr(i)));
    if (at >= first + widest) {
      line += "...";
      break;
    }
    if (at >= first) {
      const char c = rest[i];
      const bool shows = static_cast<unsigned char>(c) >= 0x20 && c != 0x7f && (size > 1 || (c & 0x80) == 0);
      if (shows)
        line += rest.substr(i, size);
      else
        line += c == '\t' ? ' ' : '?';
      if (at < column) caret += ' ';
    }
    i += size;
  }
  return "  " + line + "\n  " + caret + "^\n";
}

std::string ConfigDocument::report() const {
  Problems sorted = problems;
  sorted.sort();
  std::string report;
  for (const Problem& problem : sorted) report += problem.text() + "\n" + excerpt(problem);
  return report;
}

}  // namespace rtdata
