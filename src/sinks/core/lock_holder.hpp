// The process that has locked a file.
#pragma once

#include <sys/stat.h>
#include <sys/sysmacros.h>

#include <cstdio>
#include <fstream>
#include <string>

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

}  // namespace rtdata::detail
