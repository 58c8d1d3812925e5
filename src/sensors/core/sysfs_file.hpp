// A small text file of the kernel, read whole, on a lane.
#pragma once

#include <sys/types.h>

#include <array>
#include <cstddef>
#include <functional>
#include <string>
#include <string_view>
#include <utility>

#include "io/kernel_file.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/detail/sensors/transaction.hpp"

namespace rtdata::detail {

/// Owns the descriptor. Below /sys it stays open between reads, because sysfs gives a new value for each read at 0. A
/// regular file on local disks or in memory also stays open while the path names it, which each read checks. Anything
/// else is opened for each read.
class SysfsFile {
 public:
  static constexpr std::size_t most = 128;
  explicit SysfsFile(std::string path) : path_(std::move(path)) {}
  SysfsFile(const SysfsFile&) = delete;
  SysfsFile& operator=(const SysfsFile&) = delete;
  ~SysfsFile() { close(); }

  /// Blocks as long as the kernel does. Afterwards `error_number` is 0 and `text` has at most `most` bytes of the
  /// content; or `error_number` is the errno.
  void read() noexcept;
  int error_number() const noexcept { return error_number_; }
  std::string_view text() const noexcept { return {buffer_.data(), size_}; }
  const std::string& path() const noexcept { return path_; }
  /// The content stays. The next read opens the file again.
  void close() noexcept;

 private:
  enum class Keeps { never, while_it_is_there, always };
  void open() noexcept;
  bool is_replaced() const noexcept;

  std::string path_;
  int fd_ = -1;
  Keeps keeps_ = Keeps::never;
  dev_t device_ = 0;
  ino_t inode_ = 0;
  int error_number_ = 0;
  std::size_t size_ = 0;
  std::array<char, most> buffer_;
};

/// The cost of a read on a lane for the loop (submitting and decoding): about ten times the measured value
/// (docs/tiers.md).
inline constexpr Duration lane_read_on_loop = std::chrono::microseconds{50};

/// Reads it once.
class ReadFile final : public Transaction {
 public:
  explicit ReadFile(const std::string& path) : file(path) {}
  void transact() noexcept override { file.read(); }
  void close() noexcept override { file.close(); }
  SysfsFile file;
};

/// Finds the file, possibly by reading others, and checks that it may be read, without opening it.
class FindFile final : public Transaction {
 public:
  using Find = std::function<Result<std::string>()>;
  /// `what`, `advice`: of the error.
  FindFile(Find find, const char* what, const char* advice) : find_(std::move(find)), what_(what), advice_(advice) {}
  void transact() noexcept override;
  const Result<std::string>& path() const noexcept { return path_; }

 private:
  Find find_;
  const char* what_;
  const char* advice_;
  Result<std::string> path_ = std::string();
};

/// Checks that the file exists and may be read. `what`, `advice`: of the error.
Result<void> check_readable(const std::string& path, const char* what, const std::string& advice);
/// One lane per physical device: its directory for a file below /sys, else the file itself.
std::string physical_device_of(const std::string& path);

}  // namespace rtdata::detail
