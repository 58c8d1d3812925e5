#include "rtdata/io/spi.hpp"

#include <array>
#include <cerrno>

#include "data/setting_mistake.hpp"
#include "io/enabling.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/detail/loop/lane.hpp"

namespace rtdata {

void check_config(const SpiConfig& config, const ConfigItem& item, Problems& problems) {
  const std::size_t dot = config.device.rfind('.');
  if (!config.device.starts_with("/dev/spidev") || dot == std::string::npos) return;
  problems.add(detail::item_of(item, "device")
                   .problem("bad-value",
                            "this is a chip select, not a controller: write \"" + config.device.substr(0, dot) +
                                "\" here, and \"chip_select\": " + config.device.substr(dot + 1) + " to the sensor"));
}

/// Shared by the bus and its devices, which may hang and outlive it.
struct SpiDevice::Core {
  Core(std::string bus_, std::shared_ptr<SpiTransport> transport_, SpiConfig config_)
      : bus(std::move(bus_)), transport(std::move(transport_)), config(std::move(config_)) {}
  const std::string bus;
  const std::shared_ptr<SpiTransport> transport;
  const SpiConfig config;
};

Error SpiDevice::error(Errc code, std::string what, std::string why, std::string advice) const {
  return {code, std::move(what), "bus " + core_->bus + ", " + SpiBus::text_of(place_), std::move(why),
          std::move(advice)};
}

Result<void> SpiDevice::transfer(std::span<const SpiSegment> segments) {
  constexpr const char* what = "cannot talk to the chip";
  if (is_abandoned()) return error(Errc::closed, what, "this reading was given up before");
  std::size_t bytes = 0;
  for (const SpiSegment& segment : segments) {
    if (!segment.write.empty() && !segment.read.empty() && segment.write.size() != segment.read.size())
      return error(Errc::bad_argument, what,
                   "a segment sends " + std::to_string(segment.write.size()) + " bytes and receives " +
                       std::to_string(segment.read.size()),
                   "use the same number of bytes for both, or leave one empty");
    bytes += std::max(segment.write.size(), segment.read.size());
  }
  if (segments.size() > most_segments || bytes > longest)
    return error(Errc::bad_argument, what,
                 std::to_string(bytes) + " bytes in " + std::to_string(segments.size()) +
                     " segments are more than one transfer can have",
                 "use at most 4096 bytes and 64 segments");
  const MonotonicTime began = detail::lane_now();
  const int status = core_->transport->transfer(place_, segments);
  count(detail::lane_now() - began, status == 0);
  if (status == 0) return {};
  if (status == EINVAL || status == EMSGSIZE)
    return error(Errc::bad_argument, what,
                 "the controller refuses mode " + std::to_string(place_.mode) + " at " + std::to_string(place_.clock) +
                     " Hz with " + std::to_string(place_.bits_per_word) + " bits, or " + std::to_string(bytes) +
                     " bytes at a time",
                 "try mode 0, 8 bits and a lower clock");
  if (status == ENODEV || status == ESHUTDOWN)
    return error(Errc::disconnected, what, "the controller is gone", "check whether it was unplugged");
  const std::string device = core_->config.device.empty()
                                 ? "bus " + core_->bus + ", " + SpiBus::text_of(place_)
                                 : core_->config.device + "." + std::to_string(place_.chip_select);
  const std::string enabling = status == ENOENT ? detail::how_to_enable(core_->config.device) : "";
  return system_error(status, what, device,
                      enabling.empty() ? "`ls -l /dev/spidev*` lists the chip selects and who may use them" : enabling);
}

Result<void> SpiDevice::transfer(std::span<const std::uint8_t> write, std::span<std::uint8_t> read) {
  const std::array<SpiSegment, 1> one{{{.write = write, .read = read}}};
  return transfer(one);
}

Result<void> SpiDevice::write_read(std::span<const std::uint8_t> write, std::span<std::uint8_t> read) {
  const std::array<SpiSegment, 2> both{{{.write = write}, {.read = read}}};
  return transfer(both);
}

SpiBus::SpiBus(SpiConfig config) : SpiBus(std::string(config.device), config) {}

SpiBus::SpiBus(std::string name, SpiConfig config) : SpiBus(std::move(name), make_kernel_spi(config.device), config) {}

SpiBus::SpiBus(std::string name, std::shared_ptr<SpiTransport> transport, SpiConfig config)
    : RegisterBus(name, config.timeout),
      core_(std::make_shared<SpiDevice::Core>(std::move(name), std::move(transport), std::move(config))) {}

SpiDevice SpiBus::device(const SpiPlace& place) const {
  const bool is_good = place.mode <= 3 && place.bits_per_word >= 4 && place.bits_per_word <= 32 && place.clock > 0;
  if (!is_good)
    throw SetupError({Errc::bad_argument, "cannot use this chip", "bus " + name() + ", " + text_of(place),
                      "use a mode from 0 to 3, words of 4 to 32 bits, and a clock above 0", ""});
  return {core_, place, counter_of(text_of(place))};
}

namespace {

class SpiRegisters final : public detail::RegisterWires {
 public:
  explicit SpiRegisters(SpiDevice device) : device_(std::move(device)) {}
  Result<void> write_read(std::span<const std::uint8_t> write, std::span<std::uint8_t> read) override {
    return read.empty() ? device_.write(write) : device_.write_read(write, read);
  }
  Result<void> look_at() override { return {}; }
  Error error(Errc code, std::string what, std::string why, std::string advice) const override {
    return device_.error(code, std::move(what), std::move(why), std::move(advice));
  }

 private:
  SpiDevice device_;
};

}  // namespace

RegisterDevice SpiBus::register_device(const RegisterPlace& place) const {
  expect(place, type);
  const SpiDevice chip = device({.chip_select = *place.chip_select, .mode = place.mode, .clock = place.clock});
  return {chip, std::make_shared<SpiRegisters>(chip), true};
}

bool SpiBus::reads_on_loop() const noexcept { return core_->config.reads_on_loop; }

}  // namespace rtdata
