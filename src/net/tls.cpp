#include "net/tls_mistakes.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <string>
#include <system_error>
#include <utility>

namespace rtdata::detail {
namespace {

constexpr off_t most_looked_at = off_t{1}
                                 << 20;  // the file with all authorities of a system has comments before the first

/// Why the file cannot be used; empty: it can.
std::string obstacle(const std::string& path) {
  if (path.find('\0') != std::string::npos) return "it is not a file name: it contains a NUL byte";
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOCTTY | O_NONBLOCK);
  if (fd < 0) return std::generic_category().message(errno);
  struct stat about {};
  const bool is_file = ::fstat(fd, &about) == 0 && S_ISREG(about.st_mode);
  std::string text(is_file ? static_cast<std::size_t>(std::min<off_t>(about.st_size, most_looked_at)) : 0, '\0');
  const ssize_t got = ::read(fd, text.data(), text.size());
  ::close(fd);
  if (!is_file) return "it is not a regular file";
  text.resize(got > 0 ? static_cast<std::size_t>(got) : 0);
  return text.find("-----BEGIN ") != std::string::npos ? ""
                                                       : "it is not PEM: it has no line that begins with -----BEGIN";
}

}  // namespace

std::vector<SettingMistake> mistakes_of(const TlsConfig& config) {
  std::vector<SettingMistake> mistakes;
  const auto add = [&](const std::string& key, std::string why) { mistakes.push_back({"tls." + key, std::move(why)}); };
  const auto look_at = [&](const char* key, const std::string& path) {
    if (path.empty()) return;
    if (const std::string why = obstacle(path); !why.empty()) add(key, "cannot read the file " + path + ": " + why);
  };
  look_at("ca_file", config.ca_file);
  look_at("certificate", config.certificate);
  look_at("key", config.key);
  if (!config.certificate.empty() && config.key.empty())
    add("certificate", "a certificate needs its private key: set `key` to its file");
  if (config.certificate.empty() && !config.key.empty())
    add("key", "a key needs its certificate: set `certificate` to its file");
  if (!config.key_password.empty() && config.key.empty()) add("key_password", "`key_password` needs a `key`");
  if (!config.verify && !config.ca_file.empty())
    add("ca_file", "it is not used with `verify` false: remove one of the two");
  return mistakes;
}

}  // namespace rtdata::detail
