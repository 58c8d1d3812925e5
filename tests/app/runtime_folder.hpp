// A folder for the control sockets of the programs that a test starts, so that it sees no others.
#pragma once

#include <stdlib.h>

#include "app/process.hpp"

namespace rtdata::test {

class RuntimeFolder {
 public:
  RuntimeFolder() { ::setenv("RTDATA_RUNTIME_DIR", path().c_str(), 1); }
  RuntimeFolder(const RuntimeFolder&) = delete;
  RuntimeFolder& operator=(const RuntimeFolder&) = delete;
  ~RuntimeFolder() { ::unsetenv("RTDATA_RUNTIME_DIR"); }
  std::string path() const { return folder_.path() + "/run"; }
  std::size_t sockets() const {
    std::size_t count = 0;
    std::error_code none;
    for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(path(), none)) ++count;
    return count;
  }

 private:
  Folder folder_;
};

}  // namespace rtdata::test
