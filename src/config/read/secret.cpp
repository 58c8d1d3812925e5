#include "rtdata/config/read.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdlib>
#include <system_error>
#include <utility>

#include "data/hidden.hpp"

namespace rtdata {
namespace {

constexpr std::size_t largest = std::size_t{64} << 10;

/// Why it cannot be read; empty: it was.
std::string read_file(const std::string& path, std::string& out) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOCTTY | O_NONBLOCK);
  if (fd < 0) return std::generic_category().message(errno);
  struct stat about {};
  std::string why;
  if (::fstat(fd, &about) != 0 || !S_ISREG(about.st_mode)) why = "it is not a regular file";
  std::array<char, 4096> buffer{};
  while (why.empty()) {
    const ssize_t got = ::read(fd, buffer.data(), buffer.size());
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) why = std::generic_category().message(errno);
    if (got <= 0) break;
    out.append(buffer.data(), static_cast<std::size_t>(got));
    if (out.size() > largest) why = "it is larger than 64 KiB";
  }
  ::close(fd);
  return why;
}

}  // namespace

bool is_secret_reference(const ConfigItem& item) noexcept {
  if (!item.is_object() || item.size() != 1) return false;
  const std::string& key = item.children().front().key;
  return key == "env" || key == "file";
}

bool resolve_secret(const ConfigItem& reference, std::string& out, Problems& problems) {
  const ConfigChild& child = reference.children().front();
  const auto fail = [&](const std::string& message) {
    problems.add(child.item.problem("cannot-resolve", message));
    return false;
  };
  const std::string* name = child.item.as_string();
  if (name == nullptr || name->empty() || name->find('\0') != std::string::npos)
    return fail("expected the name of a " + std::string(child.key == "env" ? "variable" : "file") + ", got " +
                child.item.describe());
  out.clear();
  if (child.key == "env") {
    const char* value = std::getenv(name->c_str());
    if (value == nullptr) return fail("there is no variable " + *name + " in the environment");
    out = value;
    if (out.empty()) return fail("the variable " + *name + " is empty");
    return true;
  }
  if (const std::string why = read_file(*name, out); !why.empty())
    return fail("cannot read the secret from " + *name + ": " + why);
  if (out.ends_with('\n')) out.pop_back();
  if (out.ends_with('\r')) out.pop_back();
  if (out.empty()) return fail("the file " + *name + " is empty");
  if (out.find('\0') != std::string::npos) return fail("the file " + *name + " is not text: it has a NUL byte");
  return true;
}

std::string hide_secrets(std::string text, const std::vector<std::string>& secrets) {
  return detail::hidden(std::move(text), secrets);
}

}  // namespace rtdata
