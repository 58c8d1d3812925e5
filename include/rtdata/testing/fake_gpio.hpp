/// FakeGpio: GPIO chips made of memory, for tests without hardware.
///
///     auto pins = std::make_shared<rtdata::FakeGpio>();
///     pins->add_chip("gpiochip0", 16);
///     rtdata::GpioEdges button(loop, {.line = 3}, [](const rtdata::GpioEdge&) { ... }, pins);
///     pins->drive("gpiochip0", 3, true, time);
///
/// As with the kernel, its descriptor is readable while edges wait. It keeps as many edges as libgpiod 2 or 1, numbered
/// or not.
///
/// Thread: any; a lock protects it.
#pragma once

#include <cstddef>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "rtdata/io/gpio.hpp"

namespace rtdata {

class FakeGpio final : public GpioBackend {
 public:
  enum class Like { libgpiod_2, libgpiod_1 };
  explicit FakeGpio(Like like = Like::libgpiod_2);
  ~FakeGpio() override;

  /// Names the lines `prefix` plus number; without a prefix they have no names.
  void add_chip(const std::string& name, std::size_t lines, const std::string& prefix = {},
                const std::string& label = "fake");
  /// Removes the chip. Users of its lines see the same as with the kernel: a hang-up if `hangs_up`, otherwise nothing.
  void unplug(const std::string& chip, bool hangs_up = false);
  /// Adds a new chip of that name.
  void plug_in(const std::string& chip);
  /// Makes opening fail with this errno; 0: not any more.
  void refuse(const std::string& chip, int error_number);
  /// Another user has the line; empty: nobody.
  void occupy(const std::string& chip, unsigned number, const std::string& consumer);
  /// The level on the wire, at a time of the monotonic clock.
  void drive(const std::string& chip, unsigned number, bool is_high, MonotonicTime time);
  /// The level on the wire, of outputs too.
  bool level(const std::string& chip, unsigned number) const;
  /// True if it is in use.
  bool is_taken(const std::string& chip, unsigned number) const;

  std::size_t kept_edges() const noexcept override { return kept_; }
  bool numbers_edges() const noexcept override { return like_ == Like::libgpiod_2; }
  bool debounces() const noexcept override { return like_ == Like::libgpiod_2; }
  std::vector<GpioChipInfo> chips() override;
  std::unique_ptr<GpioRequest> take_input(const std::string& path, unsigned number, const GpioInput& settings,
                                          bool with_edges, int& error_number) override;
  std::unique_ptr<GpioRequest> take_output(const std::string& path, unsigned number, const GpioOutput& settings,
                                           int& error_number) override;

 private:
  class Request;
  struct Line {
    std::string name;
    std::string consumer;
    bool is_high = false;
    Request* user = nullptr;
  };
  struct Chip {
    std::string name;
    std::string label;
    std::vector<Line> lines;
    int error_number = 0;
    bool is_there = true;
    unsigned generation = 0;  // how often it was plugged in
  };
  Chip& chip(const std::string& name) const;
  std::unique_ptr<GpioRequest> take(const std::string& path, unsigned number, const std::string& consumer,
                                    int& error_number);

  const std::shared_ptr<std::mutex> mutex_ = std::make_shared<std::mutex>();  // shared with those who have lines
  const Like like_;
  const std::size_t kept_;
  std::vector<std::shared_ptr<Chip>> chips_;
};

}  // namespace rtdata
