// The process that has locked a file.
#pragma once

#include <sys/file.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <fstream>
#include <string>

#include "rtdata/data/error.hpp"

namespace rtdata::detail {

/// The process that holds the flock of a file, as /proc/locks (proc_locks(5)) tells: "process 4711"; "another process"
/// when it does not.
inline std::string lock_holder(const struct stat& file) {
  char wanted[64];
  std::snprintf(wanted, sizeof wanted, "%02x:%02x:%llu", major(file.st_dev), minor(file.st_dev),
                static_cast<unsigned long long>(file.st_ino));
  std::ifstream locks("/proc/locks");
  for (std::string number, kind, mode, access, pid, place, rest;
       locks >> number >> kind >> mode >> access >> pid >> place;) {
    std::getline(locks, rest);
    if (kind == "FLOCK" && place == wanted && pid != "0") return "process " + pid;  // 0: of another pid namespace
  }
  return "another process";
}

/// Another process that has locked (flock) this open file; empty: none. Locks nothing.
inline Result<std::string> other_lock_holder(int fd, const std::string& path) {
  struct stat about {};
  if (::fstat(fd, &about) != 0) return system_error(errno, "cannot look at the file", path, "");
  if (::flock(fd, LOCK_SH | LOCK_NB) == 0) {
    ::flock(fd, LOCK_UN);
    return std::string();
  }
  if (errno != EWOULDBLOCK) return system_error(errno, "cannot lock the file", path, "");
  std::string holder = lock_holder(about);
  return holder == "process " + std::to_string(::getpid()) ? std::string() : holder;
}

}  // namespace rtdata::detail
