/// SerialPort, SerialDevice: bytes over a serial line of the kernel (/dev/serial/by-id/..., /dev/ttyS0), or over
/// whatever stands in for one: devices that answer requests.
///
///     rtdata::SerialPort port({.device = "/dev/ttyUSB0", .serial = {.baud_rate = 115200}});
///     rtdata::SerialDevice meter = port.device();
///     meter.write("*IDN?\n").or_throw();
///     const std::string name = meter.read_until('\n').or_throw();
///
/// All calls block the thread that makes them, for at most their timeout: a program that has a loop gives the port to
/// sensors (DriverSensor, driver.hpp), which use it on its lane. Lines of devices that send by themselves are for
/// SerialLineSensor (serial_line.hpp).
///
/// - 9600 8N1 unless `serial` says otherwise. No flow control.
/// - The port is opened by the first call, for this program alone, and again after it was gone, by its path:
///   /dev/serial/by-id/... finds an adapter wherever it is plugged in.
/// - Several devices on one line (RS-485) share the port and its lane: one request at a time.
///
/// Errors: timed-out (no answer, or not all of it; an earlier one may still come for longer than a reading may take),
/// disconnected (the adapter was unplugged), does-not-fit (no delimiter within the most bytes), closed (of a job that
/// was given up), and of opening: not-found, not-permitted, busy (who has it is named), bad-argument (no serial line),
/// out-of-range (it cannot do these settings).
///
/// Thread: SerialPort: any. SerialDevice: one at a time.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/data/problem.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/io/bus.hpp"

namespace rtdata {

enum class Parity { none, even, odd, mark, space };
constexpr auto describe(type_tag<Parity>) {
  return enumeration("parity", value("none", Parity::none), value("even", Parity::even), value("odd", Parity::odd),
                     value("mark", Parity::mark), value("space", Parity::space));
}

/// How the bits go over a serial line. Default: 9600 8N1.
///
///     rtdata::SerialSettings settings{.baud_rate = 115200, .parity = rtdata::Parity::even};
struct SerialSettings {
  std::uint32_t baud_rate = 9600;  ///< bits a second; any that the device can do, not only the usual ones
  unsigned character_size = 8;     ///< bits of a character, 5 to 8
  Parity parity = Parity::none;
  unsigned stop_bits = 1;  ///< 1 or 2

  friend constexpr auto parameters(type_tag<SerialSettings>) {
    return parameter_list(parameter("baud_rate", &SerialSettings::baud_rate, "speed, any that the device can do",
                                    rtdata::unit("Bd"), range(1, 20000000)),
                          parameter("character_size", &SerialSettings::character_size, "bits of a character",
                                    rtdata::unit("bit"), range(5, 8)),
                          parameter("parity", &SerialSettings::parity, "parity bit"),
                          parameter("stop_bits", &SerialSettings::stop_bits, "stop bits", range(1, 2)));
  }
};

/// What carries the bytes: the kernel's serial line, the fake of tests (fake_serial.hpp), or one of your own.
/// Thread: that of the bus's lane; after a job was given up, another one while the first still hangs in a call.
class SerialTransport {
 public:
  virtual ~SerialTransport() = default;
  /// Opens it, when it is not open.
  virtual Result<void> open() = 0;
  /// All of them; opens it when it is not open.
  virtual Result<void> write(std::span<const std::uint8_t> bytes, Duration timeout) = 0;
  /// As soon as there are some; 0: none came in time.
  virtual Result<std::size_t> read(std::span<std::uint8_t> bytes, Duration timeout) = 0;
};

struct SerialPortConfig {
  std::string device = {};  ///< "/dev/serial/by-id/...", "/dev/ttyUSB0"
  SerialSettings serial = {};
  Duration answer_timeout = std::chrono::milliseconds{500};  ///< a device that has not answered by then is silent
  Duration timeout = std::chrono::seconds{5};  ///< what a sensor does on the port at a time; longer, it is given up

  friend constexpr auto parameters(type_tag<SerialPortConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("device", &SerialPortConfig::device, "the serial device", required, TextIs::device),
        include_member(&SerialPortConfig::serial),
        parameter("answer_timeout", &SerialPortConfig::answer_timeout,
                  "an answer that is not complete by then is missed", range(Duration{1ms}, Duration{10min})),
        parameter("timeout", &SerialPortConfig::timeout, "a reading that takes the port for longer is given up",
                  range(Duration{2ms}, Duration{1h})));
  }
  friend Duration give_up_after(const SerialPortConfig& config) { return config.timeout; }
  /// Checks that `timeout` is longer than `answer_timeout`.
  friend void check_config(const SerialPortConfig& config, const ConfigItem& item, Problems& problems);
};

class SerialPort;

class SerialDevice : public BusDevice {
 public:
  using Bus = SerialPort;
  /// Nothing tells devices apart but what is said to them: any number of sensors may be on a port.
  struct Place {
    friend constexpr auto parameters(type_tag<Place>) { return parameter_list(); }
  };

  Result<void> write(std::span<const std::uint8_t> bytes);
  Result<void> write(std::string_view text);
  Result<void> write(std::uint8_t byte) { return write(std::span<const std::uint8_t>(&byte, 1)); }
  /// All of them; `timeout` counts from the call. Unset: the port's `answer_timeout`.
  Result<void> read(std::span<std::uint8_t> bytes, std::optional<Duration> timeout = {});
  Result<std::uint8_t> read_byte(std::optional<Duration> timeout = {});
  /// What comes before `delimiter`, which is taken too. What comes after it is kept for the next read.
  Result<std::string> read_until(char delimiter, std::optional<Duration> timeout = {}, std::size_t most = 4096);
  /// Reads what has come, or waits for what comes first: at least one byte, as many as fit.
  Result<std::size_t> read_some(std::span<std::uint8_t> bytes, std::optional<Duration> timeout = {});
  /// Drops what came unasked or too late, sends the request, and reads all of the answer. After an answer that did not
  /// come, or that was distrusted, it first waits until that can no longer come: for as long again as `answer_timeout`,
  /// at least a second, or as late as answers have come; and after any, until the line has been still for 20 ms.
  Result<void> transact(std::span<const std::uint8_t> request, std::span<std::uint8_t> answer,
                        std::optional<Duration> timeout = {});
  /// The same with an answer that ends with a delimiter.
  Result<std::string> transact(std::string_view request, char delimiter, std::optional<Duration> timeout = {},
                               std::size_t most = 4096);
  /// Drops what has come and was not read, and waits as `transact` does: for a request that is written by hand.
  Result<void> drop_input();
  /// What came last makes no sense: the right answer may still come, and is not to be taken for the next one's. Done
  /// for a driver whose reading is unreadable (driver.hpp).
  void distrust();
  /// Whether the port can be opened.
  Result<void> look_at();

  Duration answer_timeout() const noexcept;
  /// An error of the device, for drivers: "cannot read the MH-Z19: bus co2: ...".
  Error error(Errc code, std::string what, std::string why, std::string advice = {}) const;

 private:
  friend class SerialPort;
  struct Core;
  SerialDevice(std::shared_ptr<Core> core, std::shared_ptr<TransferCounter> counter)
      : BusDevice(std::move(counter)), core_(std::move(core)) {}
  Result<void> check_wanted() const;
  /// Adds what has come to `pending_`; false: nothing came by then.
  Result<bool> receive(MonotonicTime until);
  std::shared_ptr<Core> core_;
  std::string pending_;  // came with what was read, and is not asked for yet
};

class SerialPort : public Bus {
 public:
  static constexpr std::string_view type = "serial";
  /// Named as its device. SetupError (bad-argument): settings that there are not.
  explicit SerialPort(SerialPortConfig config);
  SerialPort(std::string name, SerialPortConfig config);
  /// With another transport; `device` and `serial` are not used.
  SerialPort(std::string name, std::shared_ptr<SerialTransport> transport, SerialPortConfig config = {});

  SerialDevice device(const SerialDevice::Place& place = {}) const;
  static std::string text_of(const SerialDevice::Place&) { return {}; }
  /// The counts of writes and reads. Any thread.
  TransferCounts counts() const { return counts_of(all); }

 private:
  static constexpr const char* all = "all devices";
  std::shared_ptr<SerialDevice::Core> core_;
};

/// The kernel's serial line.
std::shared_ptr<SerialTransport> make_kernel_serial(std::string device, SerialSettings settings);

}  // namespace rtdata
