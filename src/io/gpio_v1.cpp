// The kernel's GPIO chips by libgpiod 1.
#include <fcntl.h>
#include <gpiod.h>
#include <linux/gpio.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>

#include "io/gpio_files.hpp"
#include "rtdata/io/gpio.hpp"

namespace rtdata {
namespace {

constexpr unsigned kept = 16;  // in the kernel, of each line; a new one is dropped when it is full

struct ChipCloser {
  void operator()(gpiod_chip* chip) const noexcept { gpiod_chip_close(chip); }
};
using Chip = std::unique_ptr<gpiod_chip, ChipCloser>;

class Request final : public GpioRequest {
 public:
  Request(Chip chip, gpiod_line* line, int fd, std::string path)
      : chip_(std::move(chip)), line_(line), fd_(fd), file_(std::move(path)) {}
  ~Request() override { gpiod_line_release(line_); }

  int value() noexcept override {
    const int value = gpiod_line_get_value(line_);
    return value < 0 ? -errno : value;
  }
  int set(bool value) noexcept override { return gpiod_line_set_value(line_, value ? 1 : 0) < 0 ? errno : 0; }
  int descriptor() const noexcept override { return fd_; }
  int read(std::span<GpioRawEdge> edges) noexcept override {
    // As the kernel gives them: on 32-bit systems, libgpiod's timespec differs from ours.
    std::array<gpioevent_data, kept> events;
    const ssize_t got = ::read(fd_, events.data(), sizeof events[0] * std::min(events.size(), edges.size()));
    if (got < 0) return errno == EAGAIN || errno == EINTR ? 0 : -errno;
    const std::size_t count = static_cast<std::size_t>(got) / sizeof events[0];
    for (std::size_t i = 0; i < count; ++i) {
      edges[i].is_rising = events[i].id == GPIOEVENT_EVENT_RISING_EDGE;
      edges[i].time = static_cast<std::int64_t>(events[i].timestamp);
    }
    return static_cast<int>(count);
  }
  bool is_there() noexcept override { return file_.is_the_same(); }
  /// 0 or an errno.
  int make_output(int flags, int value) noexcept {
    return gpiod_line_set_config(line_, GPIOD_LINE_REQUEST_DIRECTION_OUTPUT, flags, value) < 0 ? errno : 0;
  }

 private:
  const Chip chip_;  // must outlive its lines
  gpiod_line* const line_;
  const int fd_;
  const detail::GpioChipFile file_;
};

class KernelGpio final : public GpioBackend {
 public:
  std::size_t kept_edges() const noexcept override { return kept; }
  bool numbers_edges() const noexcept override { return false; }
  bool debounces() const noexcept override { return false; }

  std::vector<GpioChipInfo> chips() override {
    std::vector<GpioChipInfo> all;
    for (std::string& path : detail::gpio_chip_files()) {
      GpioChipInfo& info = all.emplace_back();
      info.path = std::move(path);
      const Chip chip(gpiod_chip_open(info.path.c_str()));
      if (chip == nullptr) {
        info.error_number = errno;
        continue;
      }
      info.label = gpiod_chip_label(chip.get());
      const unsigned count = gpiod_chip_num_lines(chip.get());
      for (unsigned i = 0; i < count; ++i) {
        GpioLineInfo& one = info.lines.emplace_back();
        gpiod_line* const line = gpiod_chip_get_line(chip.get(), i);
        if (line == nullptr) continue;
        if (const char* name = gpiod_line_name(line)) one.name = name;
        if (const char* consumer = gpiod_line_consumer(line)) one.consumer = consumer;
        one.is_used = gpiod_line_is_used(line);
      }
    }
    return all;
  }

  std::unique_ptr<GpioRequest> take_input(const std::string& path, unsigned number, const GpioInput& settings,
                                          bool with_edges, int& error_number) override {
    int type = GPIOD_LINE_REQUEST_DIRECTION_INPUT;
    if (with_edges) {
      type = settings.edges == GpioEdgeKind::rising    ? GPIOD_LINE_REQUEST_EVENT_RISING_EDGE
             : settings.edges == GpioEdgeKind::falling ? GPIOD_LINE_REQUEST_EVENT_FALLING_EDGE
                                                       : GPIOD_LINE_REQUEST_EVENT_BOTH_EDGES;
    }
    int flags = settings.active_low ? GPIOD_LINE_REQUEST_FLAG_ACTIVE_LOW : 0;
    if (settings.bias == GpioBias::none) flags |= GPIOD_LINE_REQUEST_FLAG_BIAS_DISABLE;
    if (settings.bias == GpioBias::pull_up) flags |= GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_UP;
    if (settings.bias == GpioBias::pull_down) flags |= GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_DOWN;
    return take(path, number, {settings.consumer.c_str(), type, flags}, 0, error_number);
  }

  std::unique_ptr<GpioRequest> take_output(const std::string& path, unsigned number, const GpioOutput& settings,
                                           int& error_number) override {
    int flags = settings.active_low ? GPIOD_LINE_REQUEST_FLAG_ACTIVE_LOW : 0;
    if (settings.drive == GpioDrive::open_drain) flags |= GPIOD_LINE_REQUEST_FLAG_OPEN_DRAIN;
    if (settings.drive == GpioDrive::open_source) flags |= GPIOD_LINE_REQUEST_FLAG_OPEN_SOURCE;
    if (settings.keep) {
      const int active_low = flags & GPIOD_LINE_REQUEST_FLAG_ACTIVE_LOW;
      auto taken = take(path, number, {settings.consumer.c_str(), GPIOD_LINE_REQUEST_DIRECTION_AS_IS, active_low}, 0,
                        error_number);
      if (taken == nullptr) return nullptr;
      const int level = taken->value();
      error_number = level < 0 ? -level : taken->make_output(flags, level);
      if (error_number != 0) return nullptr;
      return taken;
    }
    return take(path, number, {settings.consumer.c_str(), GPIOD_LINE_REQUEST_DIRECTION_OUTPUT, flags},
                settings.initial ? 1 : 0, error_number);
  }

 private:
  static std::unique_ptr<Request> take(const std::string& path, unsigned number,
                                       const gpiod_line_request_config& config, int initial, int& error_number) {
    Chip chip(gpiod_chip_open(path.c_str()));
    gpiod_line* const line = chip != nullptr ? gpiod_chip_get_line(chip.get(), number) : nullptr;
    if (line == nullptr || gpiod_line_request(line, &config, initial) != 0) {
      error_number = errno;
      return nullptr;
    }
    const bool has_edges = config.request_type != GPIOD_LINE_REQUEST_DIRECTION_AS_IS &&
                           config.request_type != GPIOD_LINE_REQUEST_DIRECTION_INPUT &&
                           config.request_type != GPIOD_LINE_REQUEST_DIRECTION_OUTPUT;
    const int fd = has_edges ? gpiod_line_event_get_fd(line) : -1;
    if (fd >= 0) ::fcntl(fd, F_SETFL, ::fcntl(fd, F_GETFL) | O_NONBLOCK);
    return std::make_unique<Request>(std::move(chip), line, fd, path);
  }
};

}  // namespace

std::shared_ptr<GpioBackend> make_kernel_gpio() { return std::make_shared<KernelGpio>(); }

}  // namespace rtdata
