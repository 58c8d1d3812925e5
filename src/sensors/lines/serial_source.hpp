// An open serial line that the sensors of one loop share.
#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "loop/core/loop_core.hpp"
#include "rtdata/io/serial.hpp"
#include "rtdata/loop/watch.hpp"

namespace rtdata::detail {

/// Owner: its users, the last of which closes the line. Thread: the loop's.
class SerialSource : public std::enable_shared_from_this<SerialSource> {
 public:
  class User {
   public:
    /// Bytes that were read; empty: the line has ended, with the error of `read` or 0.
    virtual void take_bytes(std::string_view bytes, int error_number) = 0;

   protected:
    ~User() = default;
  };

  /// The open line of this device, or a new one. Errors: as `open_tty`; busy (it is open with other settings).
  static Result<std::shared_ptr<SerialSource>> open(LoopCore& loop, const std::string& device,
                                                    const SerialSettings& settings);
  ~SerialSource();
  SerialSource(const SerialSource&) = delete;
  SerialSource& operator=(const SerialSource&) = delete;

  int fd() const noexcept { return fd_; }
  bool has_users() const noexcept;
  /// From now on this user receives the bytes that are read.
  void add(User& user);
  void remove(User& user) noexcept;

 private:
  SerialSource(LoopCore& loop, std::string device, SerialSettings settings, int fd);
  void on_ready(const FdEvent& event);
  void give(std::string_view bytes, int error_number);

  LoopCore& loop_;
  const std::string device_;  // without symbolic links
  const SerialSettings settings_;
  const int fd_;
  FdWatch watch_;
  std::vector<User*> users_;  // null: removed while bytes are given
  bool is_giving_ = false;
};

}  // namespace rtdata::detail
