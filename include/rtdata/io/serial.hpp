/// SerialPort, SerialDevice: devices that answer requests on a serial line of the kernel (/dev/serial/by-id/...,
/// /dev/ttyS0) or on another transport.
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
/// - With `host` and `port` instead of `device` it is a TCP connection to a serial server or an instrument.
/// - With `run` instead it is a program of the user's own, which reads requests from its standard input and prints
///   answers. It is started by the first call, and again when it has ended; what it writes to its standard error goes
///   to that of this program. Its terminal is raw, so that it holds nothing back.
/// - 9600 8N1 by default. No flow control.
/// - The port is opened by the first call, for this program alone, and again after it was gone, by its path:
///   /dev/serial/by-id/... finds an adapter wherever it is plugged in.
/// - Several devices on one line (RS-485) share the port and its lane: one request at a time.
///
/// Errors: timed-out (no answer, or an incomplete one; an earlier answer may still come for longer than a reading may
/// take), bad-data (with `echo`: the returned bytes differ from the sent ones), disconnected (the adapter was
/// unplugged), does-not-fit (no delimiter within the most bytes), closed (of a job that was given up), and of opening:
/// not-found, not-permitted, busy (the error names the other program), bad-argument (not a serial line), out-of-range
/// (the line does not support these settings).
///
/// Owner: the program, or the System; the SerialPort must outlive the sensors on it. Thread: SerialPort: any.
/// SerialDevice: one at a time.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

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

/// The level of RTS while the kernel sends on an RS-485 line.
enum class Rs485 { rts_high, rts_low };
constexpr auto describe(type_tag<Rs485>) {
  return enumeration("rs485", value("rts_high", Rs485::rts_high), value("rts_low", Rs485::rts_low));
}

/// How the bits go over a serial line. Default: 9600 8N1.
///
///     rtdata::SerialSettings settings{.baud_rate = 115200, .parity = rtdata::Parity::even};
struct SerialSettings {
  std::uint32_t baud_rate = 9600;  ///< bits a second; any that the device supports, not only the usual ones
  unsigned character_size = 8;     ///< bits of a character, 5 to 8
  Parity parity = Parity::none;
  unsigned stop_bits = 1;  ///< 1 or 2
  /// The lines after opening. The kernel sets both for a moment when it opens a line that was closed; unset: they stay.
  std::optional<bool> dtr = {}, rts = {};
  bool hangup = false;              ///< closing clears both; else they stay as they are
  std::optional<Rs485> rs485 = {};  ///< the kernel switches the driver of an RS-485 line by RTS

  friend constexpr auto parameters(type_tag<SerialSettings>) {
    return parameter_list(
        parameter("baud_rate", &SerialSettings::baud_rate, "speed; any that the device supports", rtdata::unit("Bd"),
                  range(1, 20000000)),
        parameter("character_size", &SerialSettings::character_size, "bits of a character", rtdata::unit("bit"),
                  range(5, 8)),
        parameter("parity", &SerialSettings::parity, "parity bit"),
        parameter("stop_bits", &SerialSettings::stop_bits, "stop bits", range(1, 2)),
        parameter("dtr", &SerialSettings::dtr, "state of the line DTR after opening; default: set"),
        parameter("rts", &SerialSettings::rts, "state of the line RTS after opening; default: set"),
        parameter("hangup", &SerialSettings::hangup, "true: closing the device clears DTR and RTS"),
        parameter("rs485", &SerialSettings::rs485,
                  "the kernel switches an RS-485 driver with RTS; this is the level of RTS while sending"));
  }
  /// Checks that `rts` and `rs485` are not both set. Called by the checks of the types that include these settings.
  friend void check_config(const SerialSettings& settings, const ConfigItem& item, Problems& problems);
};

/// The transport: the kernel's serial line, the fake for tests (fake_serial.hpp), or your own. The bus's lane calls it;
/// after a job was given up, a new thread may call it while the old one still hangs in a call.
class SerialTransport {
 public:
  virtual ~SerialTransport() = default;
  /// Opens it, when it is not open.
  virtual Result<void> open() = 0;
  /// Writes all bytes; opens the line if it is not open.
  virtual Result<void> write(std::span<const std::uint8_t> bytes, Duration timeout) = 0;
  /// Returns as soon as there are some bytes; 0: none came in time.
  virtual Result<std::size_t> read(std::span<std::uint8_t> bytes, Duration timeout) = 0;
};

struct SerialPortConfig {
  std::string device = {};  ///< "/dev/serial/by-id/...", "/dev/ttyUSB0"
  std::string host = {};    ///< instead of `device`: host name or IP address; the device answers on its TCP `port`
  std::uint16_t port = 0;
  std::vector<std::string> run = {};  ///< instead of `device`: a program and its arguments
  SerialSettings serial = {};
  Duration answer_timeout = std::chrono::milliseconds{500};  ///< longest wait for an answer
  Duration timeout = std::chrono::seconds{5};                ///< limit of each job of a sensor on the port
  bool echo = false;  ///< the adapter returns what is sent: it is discarded; an error if it differs

  friend constexpr auto parameters(type_tag<SerialPortConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("device", &SerialPortConfig::device, "the serial device", TextIs::device),
        parameter("host", &SerialPortConfig::host,
                  "instead of `device`: host name or IP address of an instrument or a serial server"),
        parameter("port", &SerialPortConfig::port, "TCP port of `host`, such as 5025 for SCPI; 0: none",
                  range(0, 65535)),
        parameter("run", &SerialPortConfig::run,
                  "instead of `device`: a program of your own that answers each line on its standard input"),
        include_member(&SerialPortConfig::serial),
        parameter("answer_timeout", &SerialPortConfig::answer_timeout, "time limit for a complete answer",
                  range(Duration{1ms}, Duration{10min})),
        parameter("timeout", &SerialPortConfig::timeout,
                  "a reading that takes the port for longer than this is given up", range(Duration{2ms}, Duration{1h})),
        parameter("echo", &SerialPortConfig::echo,
                  "the adapter returns all bytes that are sent to it; they are discarded"));
  }
  friend Duration give_up_after(const SerialPortConfig& config) { return config.timeout; }
  /// Checks that there is one of `device`, `host` and `run`, and that `timeout` is longer than `answer_timeout`.
  friend void check_config(const SerialPortConfig& config, const ConfigItem& item, Problems& problems);
};

class SerialPort;

class SerialDevice : public BusDevice {
 public:
  using Bus = SerialPort;
  /// Always empty: any number of sensors may use a port; only their requests distinguish the devices.
  struct Place {
    friend constexpr auto parameters(type_tag<Place>) { return parameter_list(); }
  };

  Result<void> write(std::span<const std::uint8_t> bytes);
  Result<void> write(std::string_view text);
  Result<void> write(std::uint8_t byte) { return write(std::span<const std::uint8_t>(&byte, 1)); }
  /// How often the port was lost so far. After a loss, send the set-up of the device again, after `drop_input`.
  std::uint64_t losses() const;
  /// Reads all bytes; `timeout` counts from the call. Unset: the port's `answer_timeout`.
  Result<void> read(std::span<std::uint8_t> bytes, std::optional<Duration> timeout = {});
  Result<std::uint8_t> read_byte(std::optional<Duration> timeout = {});
  /// Reads up to `delimiter` and removes it. Later bytes are kept for the next read.
  Result<std::string> read_until(char delimiter, std::optional<Duration> timeout = {}, std::size_t most = 4096);
  /// Reads the bytes received so far, or waits for the first: at least one byte, as many as fit.
  Result<std::size_t> read_some(std::span<std::uint8_t> bytes, std::optional<Duration> timeout = {});
  /// Drops bytes that came without a request or too late, sends the request, and reads the whole answer. After a
  /// missing or distrusted answer it first waits until a late answer can no longer come: another `answer_timeout`, at
  /// least a second, or the longest delay seen so far; and then until the line has been silent for 20 ms.
  Result<void> transact(std::span<const std::uint8_t> request, std::span<std::uint8_t> answer,
                        std::optional<Duration> timeout = {});
  /// The same for an answer that ends with a delimiter.
  Result<std::string> transact(std::string_view request, char delimiter, std::optional<Duration> timeout = {},
                               std::size_t most = 4096);
  /// Drops unread bytes and waits as `transact` does, before a request sent with `write`.
  Result<void> drop_input();
  /// Marks the last answer as wrong: the right answer may still come and must not be taken as the answer to the next
  /// request. Called for a driver after an unreadable reading (driver.hpp).
  void distrust();
  /// Checks that the port can be opened.
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
  /// Adds received bytes to `pending_`; false: none came in time.
  Result<bool> receive(MonotonicTime until);
  std::shared_ptr<Core> core_;
  std::string pending_;  // received, but not read yet
};

class SerialPort : public Bus {
 public:
  static constexpr std::string_view type = "serial";
  /// Its name is its device. SetupError (bad-argument): invalid settings.
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

/// A device that answers on a TCP port: a serial server (ser2net), an instrument. Connecting takes at most `limit`.
std::shared_ptr<SerialTransport> make_tcp_line(std::string host, std::uint16_t port, Duration limit);
/// The kernel's serial line.
std::shared_ptr<SerialTransport> make_kernel_serial(std::string device, SerialSettings settings);

}  // namespace rtdata
