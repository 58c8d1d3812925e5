// What a device on a serial line gets.
#pragma once

#include <doctest/doctest.h>
#include <fcntl.h>
#include <pty.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <string>
#include <thread>

namespace outputs_test {

/// A serial line that stays when the program has gone.
struct Terminal {
  int master = -1, slave = -1;
  std::string name;
  Terminal() {
    std::array<char, 128> path{};
    REQUIRE(::openpty(&master, &slave, path.data(), nullptr, nullptr) == 0);
    name = path.data();
    ::close(slave);
    slave = ::open(name.c_str(), O_RDWR | O_NOCTTY | O_CLOEXEC);  // so that it stays when the program has gone
    ::fcntl(master, F_SETFL, O_NONBLOCK);
  }
  ~Terminal() {
    ::close(master);
    ::close(slave);
  }
  /// What has come, until it ends with this.
  bool reads(const std::string& end) { return reads_within(end, std::chrono::seconds{30}); }
  bool reads_within(const std::string& end, std::chrono::nanoseconds patience) {
    const auto limit = std::chrono::steady_clock::now() + patience;
    while (!got.ends_with(end) && std::chrono::steady_clock::now() < limit) {
      std::array<char, 256> buffer{};
      const ssize_t size = ::read(master, buffer.data(), buffer.size());
      if (size > 0)
        got.append(buffer.data(), static_cast<std::size_t>(size));
      else
        std::this_thread::sleep_for(std::chrono::milliseconds{1});
    }
    return got.ends_with(end);
  }
  std::string got;
};

}  // namespace outputs_test
