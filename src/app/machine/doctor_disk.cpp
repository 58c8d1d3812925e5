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

/// How long a small write takes until it is on the disk; none: nothing can be written.
struct Synced {
  int error = 0;
  std::chrono::milliseconds median{0};
};

Synced time_of_sync(const std::string& folder) {
  std::string path = folder + "/rtdata-doctor-XXXXXX";
  const int fd = ::mkostemp(path.data(), O_CLOEXEC);
  if (fd < 0) return {errno, {}};
  ::unlink(path.c_str());
  Synced synced;
  std::vector<std::chrono::steady_clock::duration> times;
  const std::string block(4096, 'x');
  for (int i = 0; i < 5 && synced.error == 0; ++i) {
    const auto began = std::chrono::steady_clock::now();
    if (::write(fd, block.data(), block.size()) != static_cast<ssize_t>(block.size()) || ::fdatasync(fd) != 0)
      synced.error = errno != 0 ? errno : ENOSPC;
    times.push_back(std::chrono::steady_clock::now() - began);
  }
  ::close(fd);
  std::sort(times.begin(), times.end());
  synced.median = std::chrono::duration_cast<std::chrono::milliseconds>(times[times.size() / 2]);
  return synced;
}

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
    const Synced synced = time_of_sync(folder);
    if (synced.error != 0) {
      add(worst, std::string("nothing can be written: ") + std::strerror(synced.error), "nothing can be recorded",
          "`ls -ld` shows who may write there");
    } else if (synced.median.count() > 200) {
      add(Severity::warning,
          "a small write takes " + std::to_string(synced.median.count()) + " ms until it is on the disk",
          "commits queue up behind each other", "a larger `latency` of the recording, or another disk");
    }
  }
  if (found.size() == before)
    add(Severity::good, mount.type.empty() ? "it can be written" : mount.type + ", which can be written", "", "");
}

}  // namespace

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
