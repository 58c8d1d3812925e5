#include <fcntl.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/sysmacros.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <map>
#include <sstream>

#include "app/machine/doctor.hpp"

namespace rtdata::app {
namespace {

struct Mount {
  std::string folder, type, device, options;
};

/// Of the folder: the mount of the longest path that it lies below. Later mounts cover earlier ones.
Mount mount_of(const MachineFiles& files, const std::string& folder) {
  std::istringstream lines(files.text("/proc/mounts").value_or(""));
  Mount best;
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    Mount mount;
    if (!(words >> mount.device >> mount.folder >> mount.type >> mount.options)) continue;
    const std::string prefix = mount.folder == "/" ? "/" : mount.folder + "/";
    if ((folder + "/").starts_with(prefix) && mount.folder.size() >= best.folder.size()) best = mount;
  }
  return best;
}

std::string megabytes(std::uint64_t bytes) { return std::to_string(bytes / 1'000'000) + " MB"; }

void examine_disk(const MachineFiles& files, const std::string& folder, Severity worst, std::vector<Finding>& found) {
  const std::string subject = "disk of " + folder;
  const Mount mount = mount_of(files, folder);
  const auto add = [&](Severity severity, std::string what, std::string cost, std::string advice) {
    found.push_back({severity, subject, std::move(what), std::move(cost), std::move(advice)});
  };
  const std::size_t before = found.size();
  if (("," + mount.options + ",").find(",ro,") != std::string::npos) {
    add(worst, "it is mounted read-only", "nothing can be recorded",
        "after an error the kernel does this: see dmesg, then check the file system");
    return;
  }
  if (mount.type == "tmpfs" || mount.type == "ramfs")
    add(Severity::warning, "it is memory (" + mount.type + ")", "what is recorded is gone when the power is",
        "record into a folder of a disk");
  if (mount.type.starts_with("nfs") || mount.type == "cifs" || mount.type == "smb3" || mount.type.starts_with("fuse."))
    add(Severity::warning, "it is a network's or a program's (" + mount.type + ")",
        "writes wait for it, and locks of SQLite may not hold", "record onto a local disk, and copy afterwards");
  if (mount.type == "vfat" || mount.type == "exfat" || mount.type == "msdos")
    add(Severity::warning, "its file system has no journal (" + mount.type + ")", "a power cut can damage all of it",
        "ext4 for what is recorded onto");
  if (mount.device.starts_with("/dev/mmcblk") || (files.is_this_machine() && is_on_card(folder)))
    add(Severity::note, "it is an SD card or eMMC", "writes wear it out",
        "`\"profile\": \"card\"` of a recording writes less often");
  if (files.is_this_machine()) {
    struct statvfs space {};
    if (::statvfs(folder.c_str(), &space) == 0) {
      const std::uint64_t free = std::uint64_t{space.f_bavail} * space.f_frsize;
      if (free < 10'000'000) {
        add(worst, megabytes(free) + " are free", "recording stops within minutes", "make room");
      } else if (free < 1'000'000'000) {
        add(Severity::warning, megabytes(free) + " are free", "it is full soon",
            "make room, or limit recordings by `max_bytes`");
      }
    }
    auto times = times_of_sync(folder, Duration{});
    if (!times) {
      add(worst, "nothing can be written: " + times.error().why, "nothing can be recorded",
          "`ls -ld` shows who may write there");
    } else if (std::nth_element(times->begin(), times->begin() + 2, times->end()); (*times)[2] > 200'000'000) {
      add(Severity::warning,
          "a small write takes " + std::to_string((*times)[2] / 1'000'000) + " ms until it is on the disk",
          "commits queue up behind each other", "a larger `latency` of the recording, or another disk");
    }
  }
  if (found.size() == before)
    add(Severity::good, mount.type.empty() ? "it can be written" : mount.type + ", which can be written", "", "");
}

}  // namespace

Result<std::vector<std::int64_t>> times_of_sync(const std::string& folder, Duration duration) {
  std::string path = folder + "/rtdata-write-XXXXXX";
  const int fd = ::mkostemp(path.data(), O_CLOEXEC);
  if (fd < 0) return system_error(errno, "nothing can be written", folder);
  ::unlink(path.c_str());
  std::vector<std::int64_t> times;
  const std::string block(4096, 'x');
  constexpr int blocks = 256;  // of the file, each written again and again
  const auto end = std::chrono::steady_clock::now() + duration;
  for (auto began = end - duration; times.size() < 5 || began < end; began = std::chrono::steady_clock::now()) {
    const auto at = static_cast<off_t>(times.size() % blocks * block.size());
    errno = ENOSPC;  // of a write that is too short
    if (::pwrite(fd, block.data(), block.size(), at) != static_cast<ssize_t>(block.size()) || ::fdatasync(fd) != 0) {
      const Error error = system_error(errno, "nothing can be written", folder);
      ::close(fd);
      return error;
    }
    times.push_back((std::chrono::steady_clock::now() - began).count());
  }
  ::close(fd);
  return times;
}

std::vector<Finding> examine_disks(const MachineFiles& files, const SystemPlan* plan) {
  std::vector<Finding> found;
  std::vector<std::string> folders;
  if (plan != nullptr) {
    for (const PartPlan& part : plan->parts) {
      if (!part.stores || part.stores->path.empty() || part.stores->path == "-") continue;
      folders.push_back(std::filesystem::absolute(part.stores->path).lexically_normal().parent_path().string());
    }
  }
  const Severity worst = folders.empty() ? Severity::warning : Severity::fault;
  if (folders.empty()) folders.push_back(files.is_this_machine() ? std::filesystem::current_path().string() : "/");
  std::sort(folders.begin(), folders.end());
  folders.erase(std::unique(folders.begin(), folders.end()), folders.end());
  for (const std::string& folder : folders) examine_disk(files, folder, worst, found);
  return found;
}

}  // namespace rtdata::app
