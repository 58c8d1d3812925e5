// Reads small files of the kernel with a single value.
#pragma once

#include <fcntl.h>
#include <unistd.h>

#include <string>

namespace rtdata::detail {

/// The first line of a file, at most 255 bytes; empty when it cannot be read.
inline std::string first_line(const char* path) {
  const int fd = ::open(path, O_RDONLY | O_CLOEXEC | O_NOCTTY | O_NONBLOCK);
  if (fd < 0) return {};
  char text[255];
  const ssize_t size = ::read(fd, text, sizeof text);
  ::close(fd);
  const std::string all(text, size > 0 ? static_cast<std::size_t>(size) : 0);
  return all.substr(0, all.find('\n'));
}

}  // namespace rtdata::detail
