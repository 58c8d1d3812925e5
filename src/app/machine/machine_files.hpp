// The kernel's files of a machine: this one, or a copy of another's /proc, /sys, /etc and /dev. Private to the program.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::app {

/// All paths are paths on the machine ("/sys/class/hwmon"); a missing or unreadable file gives an empty result.
class MachineFiles {
 public:
  /// `root`: the folder of the copy; empty or "/": this machine.
  explicit MachineFiles(std::string root = {});

  bool is_this_machine() const noexcept { return root_.empty(); }
  /// Where the file is: the path below the root.
  std::string path(const std::string& file) const { return root_ + file; }
  bool exists(const std::string& file) const;
  /// At most 64 KiB, without leading and trailing blanks and line ends.
  std::optional<std::string> text(const std::string& file) const;
  /// Names in a folder, sorted, numbers in them by their value: "i2c-2" before "i2c-10".
  /// `prefix`: those that begin so.
  std::vector<std::string> names(const std::string& folder, std::string_view prefix = {}) const;
  /// The last part of what a link points to: "ttyUSB0" of "../../ttyUSB0"; empty: it is not a link.
  std::string link_name(const std::string& link) const;

 private:
  std::string root_;
};

/// The permission for a device, with advice.
struct Access {
  bool is_granted = true;
  std::string why = {};     ///< "Permission denied"
  std::string advice = {};  ///< names the group that may
};

/// `mode`: R_OK, W_OK. On a copy of another machine, whose users are unknown, it only reports missing files.
Access access_to(const MachineFiles& files, const std::string& file, int mode);

/// The times of synced writes of 4096 bytes to the folder's disk, in ns. Writes for `duration`, at least five times.
Result<std::vector<std::int64_t>> times_of_sync(const std::string& folder, Duration duration);
/// True if the folder is on an SD card or eMMC, by the kernel's name (mmcblk0).
bool is_on_card(const std::string& folder, const std::string& root = "");

// Advice used by both scan and doctor.
inline constexpr const char* load_w1_therm = "sudo modprobe w1_therm; for good: a line `w1_therm` in /etc/modules";
inline constexpr const char* two_at_a_port = "two programs at one port take each other's bytes";

}  // namespace rtdata::app
