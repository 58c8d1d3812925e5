#include "rtdata/detail/io/descriptor.hpp"

#include <unistd.h>

namespace rtdata::detail {

void Descriptor::set(int fd) noexcept {
  if (const int before = std::exchange(fd_, fd); before >= 0) ::close(before);
}

}  // namespace rtdata::detail
