// A serial line with a device at its other end, which is the test.
#pragma once

#include <doctest/doctest.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <string>
#include <thread>

namespace outputs_test {

/// A line that stays when the program has gone.
struct Terminal {
  Terminal() {
    std::array<char, 128> path{};
    termios raw{};
    ::cfmakeraw(&raw);
    raw.c_cflag |= CREAD | CLOCAL | CS8;
    REQUIRE(::openpty(&master, &slave, path.data(), &raw, nullptr) == 0);
    name = path.data();
    for (const int fd : {master, slave}) ::fcntl(fd, F_SETFD, FD_CLOEXEC);
    ::fcntl(master, F_SETFL, O_NONBLOCK);
  }
  Terminal(const Terminal&) = delete;
  Terminal& operator=(const Terminal&) = delete;
  ~Terminal() {
    ::close(master);
    ::close(slave);
  }

  void write(const std::string& text) const { (void)!::write(master, text.data(), text.size()); }
  /// What came while nobody read is lost, as on a real line.
  void flush() const { ::tcflush(slave, TCIFLUSH); }
  /// Waits until something is there, and returns it.
  std::string read() const {
    pollfd ready{master, POLLIN, 0};
    if (::poll(&ready, 1, 30'000) <= 0) return {};
    std::array<char, 256> buffer{};
    const ssize_t size = ::read(master, buffer.data(), buffer.size());
    return {buffer.data(), static_cast<std::size_t>(size > 0 ? size : 0)};
  }
  /// All that has come until now.
  const std::string& collect() {
    std::array<char, 256> buffer{};
    for (ssize_t size; (size = ::read(master, buffer.data(), buffer.size())) > 0;)
      got.append(buffer.data(), static_cast<std::size_t>(size));
    return got;
  }
  /// Whether what has come ends with this, or does later.
  bool reads(const std::string& end) { return reads_within(end, std::chrono::seconds{30}); }
  bool reads_within(const std::string& end, std::chrono::nanoseconds patience) {
    const auto limit = std::chrono::steady_clock::now() + patience;
    while (!collect().ends_with(end) && std::chrono::steady_clock::now() < limit)
      std::this_thread::sleep_for(std::chrono::milliseconds{1});
    return got.ends_with(end);
  }

  int master = -1, slave = -1;
  std::string name;
  std::string got;
};

}  // namespace outputs_test
