/// A file descriptor that is closed with its owner. Move-only.
#pragma once

#include <utility>

namespace rtdata::detail {

class Descriptor {
 public:
  Descriptor() = default;
  explicit Descriptor(int fd) noexcept : fd_(fd) {}
  Descriptor(Descriptor&& other) noexcept : fd_(other.release()) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    set(other.release());
    return *this;
  }
  ~Descriptor() { set(-1); }
  /// Closes the previous descriptor.
  void set(int fd) noexcept;
  int fd() const noexcept { return fd_; }
  /// The caller closes it.
  int release() noexcept { return std::exchange(fd_, -1); }

 private:
  int fd_ = -1;
};

}  // namespace rtdata::detail
