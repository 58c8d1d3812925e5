// A file descriptor that is closed with its owner.
#pragma once

#include <unistd.h>

#include <utility>

namespace rtdata::detail {

class Descriptor {
 public:
  Descriptor() = default;
  explicit Descriptor(int fd) noexcept : fd_(fd) {}
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  ~Descriptor() { set(-1); }
  /// Closes the previous descriptor.
  void set(int fd) noexcept {
    if (const int before = std::exchange(fd_, fd); before >= 0) ::close(before);
  }
  int fd() const noexcept { return fd_; }
  /// The caller closes it.
  int release() noexcept { return std::exchange(fd_, -1); }

 private:
  int fd_ = -1;
};

}  // namespace rtdata::detail
