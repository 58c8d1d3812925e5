// What the kernel bench gives to a test: devices, and the simulated chips behind them.
#pragma once

#include <doctest/doctest.h>
#include <fcntl.h>
#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <string>
#include <string_view>

#include "paths.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/verify.hpp"
#include "sensors/fixture.hpp"
#include "sinks/recordings.hpp"

namespace bench {

using namespace rtdata;
using namespace rtdata::literals;

/// What $RTDATA_BENCH_`name` says.
inline std::string device(const char* name) {
  const char* value = std::getenv((std::string("RTDATA_BENCH_") + name).c_str());
  return value == nullptr ? "" : value;
}

/// Waiting takes no time here, and neither does computing: what happens is the same in every run.
inline bool is_time_simulated() { return device("APPEND").find("time-travel=inf-cpu") != std::string::npos; }

/// A file of the kernel: written at `offset`, in one piece. Throws nothing, for use in callbacks.
inline void put(const std::string& path, std::string_view bytes, off_t offset = 0) {
  const int fd = ::open(path.c_str(), O_WRONLY | O_CLOEXEC);
  const bool found = fd >= 0 && (offset == 0 || ::lseek(fd, offset, SEEK_SET) == offset);
  const bool written = found && ::write(fd, bytes.data(), bytes.size()) == static_cast<ssize_t>(bytes.size());
  if (fd >= 0) ::close(fd);
  CAPTURE(path);
  CHECK(written);
}

inline std::uint64_t number_in(const std::string& path) {
  std::uint64_t number = ~std::uint64_t{0};
  std::ifstream(path) >> number;
  return number;
}

/// A simulated chip that has registers, as its folder in debugfs shows it.
class Chip {
 public:
  /// "spi", "i2c-48"
  explicit Chip(const char* name) : folder_(device("SIM") + "/" + name) {}
  /// A word of a chip that sends the high byte first.
  void set_word(unsigned index, int value) const {
    const char bytes[] = {static_cast<char>(value >> 8), static_cast<char>(value)};
    put(folder_ + "/regs", {bytes, 2}, 2 * index);
  }
  void set_input(unsigned channel, std::uint16_t code) const {
    put(folder_ + "/adc", {reinterpret_cast<const char*>(&code), 2}, 2 * channel);
  }
  /// The next `count` transfers fail with this errno.
  void fail(std::uint32_t count, int number) const {
    put(folder_ + "/fail_errno", std::to_string(number));
    put(folder_ + "/fail_count", std::to_string(count));
  }
  bool still_fails() const { return number_in(folder_ + "/fail_count") != 0; }

 private:
  std::string folder_;
};

/// Ends the loop when a test does not get where it is going.
inline Timer limit(Loop& loop, Duration duration = std::chrono::seconds{20}) {
  return Timer(loop, duration, [&loop] { loop.stop(); });
}

/// Closes the loop, which has lost nothing and balances.
inline void close_balanced(Loop& loop) {
  CHECK(loop.close() == 0);
  CHECK(loop.runtime().balances());
}

/// The library and the program find the recording balanced.
inline void check_verifies(const std::string& path) {
  const auto report = verify(Recording::open(path).or_throw()).or_throw();
  INFO(report.text());
  CHECK(report.verdict() == Verdict::balanced);
  CHECK(std::system((rtdata::test::built("rtdata") + " verify '" + path + "' >/dev/null").c_str()) == 0);
}

}  // namespace bench
