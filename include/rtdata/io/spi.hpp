/// SpiBus, SpiDevice: chips on an SPI controller of the kernel (/dev/spidev0.0, /dev/spidev0.1) or on another
/// transport.
///
///     rtdata::SpiBus bus({.device = "/dev/spidev0"});  // the controller; a chip is one of its chip selects
///     rtdata::SpiDevice chip = bus.device({.chip_select = 1, .mode = 0, .clock = 1'000'000});
///     const std::array<std::uint8_t, 3> ask{0x06, 0x40, 0x00};
///     std::array<std::uint8_t, 3> answer{};
///     chip.transfer(ask, answer).or_throw();
///
/// SPI has no acknowledgement: without a chip all bits read as ones or zeros, which the driver must detect.
///
/// All transfers block the thread that calls them: a program that has a loop gives the bus to sensors (DriverSensor,
/// driver.hpp), which use it on its lane.
///
/// Errors: not-found, not-permitted (of the controller), bad-argument (a mode, clock or length that the controller
/// refuses), disconnected (it was unplugged), closed (of a job that was given up), io-failed.
///
/// Owner: the program, or the System; the SpiBus must outlive the sensors on it. Thread: SpiBus: any.
/// SpiDevice: one at a time.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "rtdata/data/parameter.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/io/bus.hpp"
#include "rtdata/io/registers.hpp"

namespace rtdata {

/// Where a chip is, and how it is accessed.
struct SpiPlace {
  unsigned chip_select = 0;
  unsigned mode = 0;           ///< 0 to 3: clock polarity times 2, plus phase
  unsigned clock = 1'000'000;  ///< Hz; controllers take the next lower one that they have
  unsigned bits_per_word = 8;  ///< words of more than 8 bits are in memory in the processor's byte order
  friend constexpr auto parameters(type_tag<SpiPlace>) {
    return parameter_list(
        parameter("chip_select", &SpiPlace::chip_select, "chip select of the chip, the 1 of /dev/spidev0.1",
                  range(0, 255)),
        parameter("mode", &SpiPlace::mode, "SPI mode: clock polarity times 2, plus phase", range(0, 3)),
        parameter("clock", &SpiPlace::clock, "highest clock frequency; long wires need a lower one", unit("Hz"),
                  range(1'000, 100'000'000)),
        parameter("bits_per_word", &SpiPlace::bits_per_word, "bits of a word in transfers", unit("bit"), range(4, 32)));
  }
};

/// A segment of a transfer during which the chip stays selected.
struct SpiSegment {
  std::span<const std::uint8_t> write = {};  ///< empty: zeros are sent
  std::span<std::uint8_t> read = {};         ///< empty: received bytes are dropped; otherwise as long as `write`
  Duration delay_after{0};                   ///< pause before the next segment; to 65 ms
  bool release_after = false;                ///< the chip select goes up before the next segment
};

/// The transport: the kernel's controller, the fake for tests (fake_spi.hpp), or your own. Thread: the bus's lane;
/// after a job was given up, a second thread may call it while the first still hangs in a call; with `reads_on_loop`,
/// the loops of all its sensors at once.
class SpiTransport {
 public:
  virtual ~SpiTransport() = default;
  /// 0, or the errno of what went wrong.
  virtual int transfer(const SpiPlace& place, std::span<const SpiSegment> segments) noexcept = 0;
};

struct SpiConfig {
  std::string device = {};                     ///< of the controller, without the chip select: "/dev/spidev0"
  Duration timeout = std::chrono::seconds{1};  ///< limit of each job of a sensor on the bus
  /// Sensors read on their own loop, which waits for the transfer. For short transfers this is faster than a job on the
  /// lane. A controller that hangs then holds the loop, without regard to `timeout`.
  bool reads_on_loop = false;

  friend constexpr auto parameters(type_tag<SpiConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("device", &SpiConfig::device, "the controller without a chip select, such as /dev/spidev0", required,
                  TextIs::device),
        parameter("timeout", &SpiConfig::timeout, "a reading that takes the bus for longer than this is given up",
                  range(Duration{1ms}, Duration{1h})),
        parameter("inline", &SpiConfig::reads_on_loop,
                  "true: the sensors' own loops read, and wait for each transfer; only for short transfers"));
  }
  friend Duration give_up_after(const SpiConfig& config) { return config.timeout; }
  friend void check_config(const SpiConfig& config, const ConfigItem& item, Problems& problems);
};

class SpiBus;

class SpiDevice : public BusDevice {
 public:
  using Bus = SpiBus;
  using Place = SpiPlace;
  /// Longest transfer of the kernel's spidev, unless its `bufsiz` was set.
  static constexpr std::size_t longest = 4096;
  static constexpr std::size_t most_segments = 64;

  const SpiPlace& place() const noexcept { return place_; }
  /// Sends and receives at the same time. Both spans have the same size, or one is empty.
  Result<void> transfer(std::span<const std::uint8_t> write, std::span<std::uint8_t> read);
  Result<void> write(std::span<const std::uint8_t> bytes) { return transfer(bytes, {}); }
  Result<void> read(std::span<std::uint8_t> bytes) { return transfer({}, bytes); }
  /// Sends, then receives, with the chip selected all the time.
  Result<void> write_read(std::span<const std::uint8_t> write, std::span<std::uint8_t> read);
  /// Transfers the segments one after the other, as one message.
  Result<void> transfer(std::span<const SpiSegment> segments);

  /// An error of this chip, for drivers: "cannot read the MCP3208: bus spi0, chip select 1: ...".
  Error error(Errc code, std::string what, std::string why, std::string advice = {}) const;

 private:
  friend class SpiBus;
  struct Core;
  SpiDevice(std::shared_ptr<Core> core, SpiPlace place, std::shared_ptr<TransferCounter> counter)
      : BusDevice(std::move(counter)), core_(std::move(core)), place_(place) {}
  std::shared_ptr<Core> core_;
  SpiPlace place_;
};

class SpiBus : public RegisterBus {
 public:
  static constexpr std::string_view type = "spi";
  /// Its name is its device. The first transfer opens a chip select; after the controller was gone, the next one opens
  /// it again.
  explicit SpiBus(SpiConfig config);
  SpiBus(std::string name, SpiConfig config);
  /// With another transport; `device` is not used.
  SpiBus(std::string name, std::shared_ptr<SpiTransport> transport, SpiConfig config = {});

  /// SetupError (bad-argument): an invalid mode or number of bits.
  SpiDevice device(const SpiPlace& place) const;
  static std::string text_of(const SpiPlace& place) { return "chip select " + std::to_string(place.chip_select); }
  /// The transfer counts of the chip. Any thread.
  TransferCounts counts(unsigned chip_select) const { return counts_of(text_of({.chip_select = chip_select})); }
  /// Sensors read on their loop, not on the bus's lane.
  bool reads_on_loop() const noexcept override;

 private:
  RegisterDevice register_device(const RegisterPlace& place) const override;
  std::shared_ptr<SpiDevice::Core> core_;
};

/// The kernel's controller.
std::shared_ptr<SpiTransport> make_kernel_spi(std::string device);

}  // namespace rtdata
