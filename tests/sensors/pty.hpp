// A pseudo terminal behind a path that stays the same: what a test plugs in and out.
#pragma once

#include <fcntl.h>
#include <pty.h>
#include <unistd.h>

#include <string>
#include <string_view>

class Pty {
 public:
  explicit Pty(std::string path) : path_(std::move(path)) {}
  Pty(const Pty&) = delete;
  Pty& operator=(const Pty&) = delete;
  ~Pty() { unplug(); }

  void plug_in() {
    int device = -1;
    char name[128];
    if (::openpty(&master_, &device, name, nullptr, nullptr) != 0) return;
    ::fcntl(master_, F_SETFL, O_NONBLOCK);
    ::fcntl(master_, F_SETFD, FD_CLOEXEC);
    struct termios raw {};
    ::tcgetattr(device, &raw);
    ::cfmakeraw(&raw);
    ::tcsetattr(device, TCSANOW, &raw);
    device_ = device;  // kept open: a terminal that nobody has open hangs up
    ::unlink(path_.c_str());
    if (::symlink(name, path_.c_str()) != 0) unplug();
  }
  void unplug() {
    if (master_ >= 0) ::close(master_);
    if (device_ >= 0) ::close(device_);
    master_ = device_ = -1;
    ::unlink(path_.c_str());
  }
  /// As much as the kernel takes now.
  std::size_t send(std::string_view text) {
    const ssize_t sent = ::write(master_, text.data(), text.size());
    return sent > 0 ? static_cast<std::size_t>(sent) : 0;
  }
  int master() const { return master_; }
  int device() const { return device_; }
  const std::string& path() const { return path_; }

 private:
  std::string path_;
  int master_ = -1;
  int device_ = -1;
};
