// The simulated GPIO chip of the kernel bench.
#pragma once

#include <doctest/doctest.h>
#include <fcntl.h>
#include <unistd.h>

#include <chrono>
#include <fstream>
#include <string>
#include <string_view>

#include "rtdata/io/gpio.hpp"
#include "rtdata/loop/loop.hpp"
#include "sensors/fixture.hpp"

namespace gpio_bench {

using namespace rtdata;
using namespace rtdata::literals;

inline MonotonicTime now() { return std::chrono::steady_clock::now(); }

/// gpio-sim's chip of 16 lines, sim0 to sim15.
class Chip {
 public:
  Chip() {
    for (int& fd : pulls_) fd = -1;
    find();
  }
  Chip(const Chip&) = delete;
  Chip& operator=(const Chip&) = delete;
  ~Chip() { close_files(); }
  const std::string& name() const { return name_; }
  std::string path() const { return "/dev/" + name_; }
  /// What is on the wire of an input.
  void pull(unsigned line, bool is_high) const {
    int& fd = pulls_[line];
    if (fd < 0) fd = ::open((folder(line) + "/pull").c_str(), O_WRONLY | O_CLOEXEC);
    const std::string_view text = is_high ? "pull-up" : "pull-down";
    CHECK_MESSAGE(::pwrite(fd, text.data(), text.size(), 0) == static_cast<ssize_t>(text.size()), folder(line));
  }
  /// Of an output.
  bool value(unsigned line) const {
    int number = -1;
    std::ifstream(folder(line) + "/value") >> number;
    CHECK(number >= 0);
    return number == 1;
  }
  bool is_taken(unsigned line) const {
    for (const GpioChipInfo& info : make_kernel_gpio()->chips())
      if (info.path == path()) return info.lines.at(line).is_used;
    return false;
  }
  void unplug() {
    close_files();
    std::ofstream(configuration_ + "/live") << 0;
    CHECK(::access(path().c_str(), F_OK) != 0);
  }
  void plug_in() {
    std::ofstream(configuration_ + "/live") << 1;
    find();
  }

 private:
  static std::string text_of(const std::string& file) {
    std::string text;
    std::getline(std::ifstream(file), text);
    return text;
  }
  /// It may be another one each time.
  void find() {
    name_ = text_of(configuration_ + "/bank0/chip_name");
    folder_ = "/sys/devices/platform/" + text_of(configuration_ + "/dev_name") + "/" + name_;
    REQUIRE(::access(path().c_str(), F_OK) == 0);
  }
  std::string folder(unsigned line) const { return folder_ + "/sim_gpio" + std::to_string(line); }
  void close_files() {
    for (int& fd : pulls_) {
      if (fd >= 0) ::close(fd);
      fd = -1;
    }
  }
  const std::string configuration_ = "/sys/kernel/config/gpio-sim/bench";
  std::string name_;
  std::string folder_;
  mutable int pulls_[16];
};

}  // namespace gpio_bench
