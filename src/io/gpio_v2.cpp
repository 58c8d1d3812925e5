// The kernel's GPIO chips by libgpiod 2.
#include <fcntl.h>
#include <gpiod.h>

#include <algorithm>
#include <cerrno>

#include "io/gpio_files.hpp"
#include "rtdata/io/gpio.hpp"

namespace rtdata {
namespace {

constexpr std::size_t kept = 1024;     // in the kernel, of each line; it drops the oldest when it is full
constexpr std::size_t most_read = 64;  // at once

template <class T, void (*Free)(T*)>
struct Freer {
  void operator()(T* object) const noexcept { Free(object); }
};
using Chip = std::unique_ptr<gpiod_chip, Freer<gpiod_chip, gpiod_chip_close>>;
using ChipInfo = std::unique_ptr<gpiod_chip_info, Freer<gpiod_chip_info, gpiod_chip_info_free>>;
using LineInfo = std::unique_ptr<gpiod_line_info, Freer<gpiod_line_info, gpiod_line_info_free>>;
using Settings = std::unique_ptr<gpiod_line_settings, Freer<gpiod_line_settings, gpiod_line_settings_free>>;
using LineConfig = std::unique_ptr<gpiod_line_config, Freer<gpiod_line_config, gpiod_line_config_free>>;
using RequestConfig = std::unique_ptr<gpiod_request_config, Freer<gpiod_request_config, gpiod_request_config_free>>;
using Lines = std::unique_ptr<gpiod_line_request, Freer<gpiod_line_request, gpiod_line_request_release>>;
using Buffer = std::unique_ptr<gpiod_edge_event_buffer, Freer<gpiod_edge_event_buffer, gpiod_edge_event_buffer_free>>;

class Request final : public GpioRequest {
 public:
  Request(Lines lines, unsigned number, Buffer buffer, std::string path)
      : lines_(std::move(lines)), number_(number), buffer_(std::move(buffer)), file_(std::move(path)) {}

  int value() noexcept override {
    const gpiod_line_value value = gpiod_line_request_get_value(lines_.get(), number_);
    return value == GPIOD_LINE_VALUE_ERROR ? -errno : value == GPIOD_LINE_VALUE_ACTIVE ? 1 : 0;
  }
  int set(bool value) noexcept override {
    const gpiod_line_value wanted = value ? GPIOD_LINE_VALUE_ACTIVE : GPIOD_LINE_VALUE_INACTIVE;
    return gpiod_line_request_set_value(lines_.get(), number_, wanted) < 0 ? errno : 0;
  }
  int descriptor() const noexcept override { return gpiod_line_request_get_fd(lines_.get()); }
  int read(std::span<GpioRawEdge> edges) noexcept override {
    const std::size_t room = std::min(most_read, edges.size());
    const int got = gpiod_line_request_read_edge_events(lines_.get(), buffer_.get(), room);
    if (got < 0) return errno == EAGAIN || errno == EINTR ? 0 : -errno;
    for (std::size_t i = 0; i < static_cast<std::size_t>(got); ++i) {
      gpiod_edge_event* const event = gpiod_edge_event_buffer_get_event(buffer_.get(), static_cast<unsigned long>(i));
      edges[i].is_rising = gpiod_edge_event_get_event_type(event) == GPIOD_EDGE_EVENT_RISING_EDGE;
      edges[i].time = static_cast<std::int64_t>(gpiod_edge_event_get_timestamp_ns(event));
      edges[i].number = static_cast<std::uint32_t>(gpiod_edge_event_get_line_seqno(event));
    }
    return got;
  }
  bool is_there() noexcept override { return file_.is_the_same(); }
  /// 0 or an errno.
  int configure(gpiod_line_settings* settings) noexcept {
    const LineConfig config(gpiod_line_config_new());
    if (config == nullptr) return ENOMEM;
    if (gpiod_line_config_add_line_settings(config.get(), &number_, 1, settings) != 0) return errno;
    return gpiod_line_request_reconfigure_lines(lines_.get(), config.get()) == 0 ? 0 : errno;
  }

 private:
  const Lines lines_;
  const unsigned number_;
  const Buffer buffer_;  // null: no edges
  const detail::GpioChipFile file_;
};

class KernelGpio final : public GpioBackend {
 public:
  std::size_t kept_edges() const noexcept override { return kept; }
  bool numbers_edges() const noexcept override { return true; }
  bool debounces() const noexcept override { return true; }

  std::vector<GpioChipInfo> chips() override {
    std::vector<GpioChipInfo> all;
    for (std::string& path : detail::gpio_chip_files()) {
      GpioChipInfo& info = all.emplace_back();
      info.path = std::move(path);
      const Chip chip(gpiod_chip_open(info.path.c_str()));
      const ChipInfo about(chip != nullptr ? gpiod_chip_get_info(chip.get()) : nullptr);
      if (about == nullptr) {
        info.error_number = errno;
        continue;
      }
      info.label = gpiod_chip_info_get_label(about.get());
      const std::size_t count = gpiod_chip_info_get_num_lines(about.get());
      for (std::size_t i = 0; i < count; ++i) {
        GpioLineInfo& one = info.lines.emplace_back();
        const LineInfo line(gpiod_chip_get_line_info(chip.get(), static_cast<unsigned>(i)));
        if (line == nullptr) continue;
        if (const char* name = gpiod_line_info_get_name(line.get())) one.name = name;
        if (const char* consumer = gpiod_line_info_get_consumer(line.get())) one.consumer = consumer;
        one.is_used = gpiod_line_info_is_used(line.get());
      }
    }
    return all;
  }

  std::unique_ptr<GpioRequest> take_input(const std::string& path, unsigned number, const GpioInput& wanted,
                                          bool with_edges, int& error_number) override {
    const Settings settings(gpiod_line_settings_new());
    if (settings == nullptr) return refuse(error_number);
    gpiod_line_settings_set_direction(settings.get(), GPIOD_LINE_DIRECTION_INPUT);
    gpiod_line_settings_set_active_low(settings.get(), wanted.active_low);
    gpiod_line_settings_set_bias(settings.get(), bias_of(wanted.bias));
    if (with_edges) {
      gpiod_line_settings_set_edge_detection(settings.get(),
                                             wanted.edges == GpioEdgeKind::rising    ? GPIOD_LINE_EDGE_RISING
                                             : wanted.edges == GpioEdgeKind::falling ? GPIOD_LINE_EDGE_FALLING
                                                                                     : GPIOD_LINE_EDGE_BOTH);
      gpiod_line_settings_set_event_clock(settings.get(), GPIOD_LINE_CLOCK_MONOTONIC);
      const auto micros = std::chrono::duration_cast<std::chrono::microseconds>(wanted.debounce).count();
      gpiod_line_settings_set_debounce_period_us(settings.get(), static_cast<unsigned long>(micros));
    }
    return take(path, number, wanted.consumer, settings.get(), with_edges, error_number);
  }

  std::unique_ptr<GpioRequest> take_output(const std::string& path, unsigned number, const GpioOutput& wanted,
                                           int& error_number) override {
    const Settings settings(gpiod_line_settings_new());
    if (settings == nullptr) return refuse(error_number);
    gpiod_line_settings_set_active_low(settings.get(), wanted.active_low);
    if (wanted.keep) {
      auto taken = take(path, number, wanted.consumer, settings.get(), false, error_number);
      if (taken == nullptr) return nullptr;
      const int level = taken->value();
      set_up(settings.get(), wanted, level > 0);
      error_number = level < 0 ? -level : taken->configure(settings.get());
      if (error_number != 0) return nullptr;
      return taken;
    }
    set_up(settings.get(), wanted, wanted.initial);
    return take(path, number, wanted.consumer, settings.get(), false, error_number);
  }

 private:
  static void set_up(gpiod_line_settings* settings, const GpioOutput& wanted, bool value) noexcept {
    gpiod_line_settings_set_direction(settings, GPIOD_LINE_DIRECTION_OUTPUT);
    gpiod_line_settings_set_drive(settings, wanted.drive == GpioDrive::open_drain    ? GPIOD_LINE_DRIVE_OPEN_DRAIN
                                            : wanted.drive == GpioDrive::open_source ? GPIOD_LINE_DRIVE_OPEN_SOURCE
                                                                                     : GPIOD_LINE_DRIVE_PUSH_PULL);
    gpiod_line_settings_set_output_value(settings, value ? GPIOD_LINE_VALUE_ACTIVE : GPIOD_LINE_VALUE_INACTIVE);
  }
  static gpiod_line_bias bias_of(GpioBias bias) noexcept {
    switch (bias) {
      case GpioBias::none:
        return GPIOD_LINE_BIAS_DISABLED;
      case GpioBias::pull_up:
        return GPIOD_LINE_BIAS_PULL_UP;
      case GpioBias::pull_down:
        return GPIOD_LINE_BIAS_PULL_DOWN;
      default:
        return GPIOD_LINE_BIAS_AS_IS;
    }
  }
  static std::nullptr_t refuse(int& error_number) noexcept {
    error_number = errno;
    return nullptr;
  }
  static std::unique_ptr<Request> take(const std::string& path, unsigned number, const std::string& consumer,
                                       gpiod_line_settings* settings, bool with_edges, int& error_number) {
    const Chip chip(gpiod_chip_open(path.c_str()));  // the request does not need it
    if (chip == nullptr) return refuse(error_number);
    const LineConfig config(gpiod_line_config_new());
    const RequestConfig request(gpiod_request_config_new());
    if (config == nullptr || request == nullptr) return refuse(error_number);
    gpiod_request_config_set_consumer(request.get(), consumer.c_str());
    if (with_edges) gpiod_request_config_set_event_buffer_size(request.get(), kept);
    if (gpiod_line_config_add_line_settings(config.get(), &number, 1, settings) != 0) return refuse(error_number);
    Lines lines(gpiod_chip_request_lines(chip.get(), request.get(), config.get()));
    if (lines == nullptr) return refuse(error_number);
    Buffer buffer(with_edges ? gpiod_edge_event_buffer_new(most_read) : nullptr);
    if (with_edges && buffer == nullptr) return refuse(error_number);
    const int fd = gpiod_line_request_get_fd(lines.get());
    ::fcntl(fd, F_SETFL, ::fcntl(fd, F_GETFL) | O_NONBLOCK);
    return std::make_unique<Request>(std::move(lines), number, std::move(buffer), path);
  }
};

}  // namespace

std::shared_ptr<GpioBackend> make_kernel_gpio() { return std::make_shared<KernelGpio>(); }

}  // namespace rtdata
