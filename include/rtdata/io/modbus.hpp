/// ModbusBus, ModbusDevice: devices that speak Modbus, RTU over a serial line (RS-485) or over TCP, or Modbus TCP.
///
///     rtdata::ModbusBus bus({.device = "/dev/ttyUSB0", .serial = {.baud_rate = 19200,
///                                                                    .parity = rtdata::Parity::even}});
///     rtdata::ModbusDevice meter = bus.device({.unit = 3});
///     std::array<std::uint16_t, 2> words{};
///     meter.read_registers(rtdata::ModbusTable::input, 0, words).or_throw();
///
/// All calls block the thread that makes them, for at most `answer_timeout` each; over RTU, after a missing or invalid
/// answer, the next call to the unit waits as `SerialDevice::transact` does (serial.hpp). A program that has a loop
/// gives the bus to sensors (ModbusSensor, sensors/modbus.hpp), which use it on its lane. Units on one line share it:
/// one request at a time, with the silence between two requests that RTU needs.
///
/// Addresses are those of the protocol and start at 0: register 40001 in a manual is holding register 0, 30001 is input
/// register 0.
///
/// The line or connection is opened by the first call, and again after it was lost. A serial line is this program's
/// alone, as of SerialPort (serial.hpp).
///
/// RTU over TCP (`rtu_over_tcp`) is for serial servers that pass bytes on without conversion: the frames and rules are
/// those of RTU. There, bytes of noise before an answer are skipped and counted (TransferCounts::skipped_bytes).
///
/// Units are 0 to 255. Over RTU, 0 means all devices, and none answers it; 248 to 255 are reserved.
///
/// Errors: timed-out (no answer, an incomplete one, or an earlier answer may still come), bad-data (a wrong checksum,
/// an answer to another request, an echo of the request, or with `echo` one that differs), bad-argument (the device's
/// exceptions 1 to 3: it has no such function, address or number), busy, io-failed (its other exceptions), disconnected
/// (the line was unplugged, the server refuses or has closed), closed (of a job that was given up); and those of
/// opening a serial line.
///
/// In the library rtdata::modbus, which needs libmodbus. Thread: ModbusBus: any. The devices of one bus: one at a time.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/data/problem.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/io/bus.hpp"
#include "rtdata/io/serial.hpp"

namespace rtdata {

/// What a device has: registers of 16 bits, and single bits.
enum class ModbusTable { holding, input, coil, discrete };
constexpr auto describe(type_tag<ModbusTable>) {
  return enumeration("table", value("holding", ModbusTable::holding), value("input", ModbusTable::input),
                     value("coil", ModbusTable::coil), value("discrete", ModbusTable::discrete));
}

struct ModbusConfig {
  std::string device = {};  ///< RTU: "/dev/serial/by-id/...", "/dev/ttyUSB0"; empty: TCP
  SerialSettings serial = {};
  std::string host = {};      ///< TCP: host name or IP address; empty: RTU
  std::uint16_t port = 502;   ///< TCP
  bool rtu_over_tcp = false;  ///< TCP: the frames are those of RTU
  bool echo = false;          ///< RTU: the adapter returns what is sent: it is discarded; an error if it differs
  Duration connect_delay{0};  ///< TCP: wait before the first request; some servers ignore an early one
  Duration answer_timeout = std::chrono::milliseconds{500};  ///< longest wait for an answer
  Duration timeout = std::chrono::seconds{5};                ///< limit of each job of a sensor on the bus

  friend constexpr auto parameters(type_tag<ModbusConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("device", &ModbusConfig::device, "RTU: the serial device", TextIs::device),
        include_member(&ModbusConfig::serial),
        parameter("host", &ModbusConfig::host, "TCP: host name or IP address of the server"),
        parameter("port", &ModbusConfig::port, "TCP: port of the server", range(1, 65535)),
        parameter("rtu_over_tcp", &ModbusConfig::rtu_over_tcp, "TCP: the server passes RTU frames to a serial line"),
        parameter("echo", &ModbusConfig::echo,
                  "RTU: the adapter returns all bytes that are sent to it; they are discarded"),
        parameter("connect_delay", &ModbusConfig::connect_delay,
                  "TCP: how long to wait after connecting before the first request",
                  range(Duration{0}, Duration{1min})),
        parameter("answer_timeout", &ModbusConfig::answer_timeout, "time limit for a complete answer",
                  range(Duration{1ms}, Duration{10min})),
        parameter("timeout", &ModbusConfig::timeout, "a reading that takes the bus for longer than this is given up",
                  range(Duration{2ms}, Duration{1h})));
  }
  friend Duration give_up_after(const ModbusConfig& config) { return config.timeout; }
  /// Checks that there is a device or a host, that the settings fit it, and that `timeout` is longer than
  /// `answer_timeout`.
  friend void check_config(const ModbusConfig& config, const ConfigItem& item, Problems& problems);
};

class ModbusBus;
class SerialTransport;

class ModbusDevice : public BusDevice {
 public:
  using Bus = ModbusBus;
  struct Place {
    unsigned unit = 1;  ///< address of the device, 0 to 255
    friend constexpr auto parameters(type_tag<Place>) {
      return parameter_list(parameter("unit", &Place::unit, "address of the device (\"slave\")", range(0, 255)));
    }
  };
  static constexpr std::size_t most_registers = 125;  ///< of one request
  static constexpr std::size_t most_bits = 2000;

  /// Functions 3 (holding) and 4 (input): up to `most_registers`.
  Result<void> read_registers(ModbusTable table, std::uint16_t first, std::span<std::uint16_t> words);
  /// Functions 1 (coil) and 2 (discrete): up to `most_bits`, each 0 or 1.
  Result<void> read_bits(ModbusTable table, std::uint16_t first, std::span<std::uint8_t> bits);
  /// Function 6 for one register, 16 for several (at most 123).
  Result<void> write_registers(std::uint16_t first, std::span<const std::uint16_t> words);
  /// Function 5.
  Result<void> write_coil(std::uint16_t address, std::uint8_t bit);
  /// Checks that the line or the server is available.
  Result<void> look_at();

  /// An error of this device, for drivers: "cannot read the meter: bus rs485, unit 3: ...".
  Error error(Errc code, std::string what, std::string why, std::string advice = {}) const;

 private:
  friend class ModbusBus;
  struct Core;
  class Request;
  ModbusDevice(std::shared_ptr<Core> core, unsigned unit, std::shared_ptr<TransferCounter> counter)
      : BusDevice(std::move(counter)), core_(std::move(core)), unit_(unit) {}
  template <class Take>
  Result<void> ask(const Request& request, Take&& take);
  template <class Take>
  Result<void> ask_by_tcp(const Request& request, Take&& take);
  Error failure(int number) const;
  std::shared_ptr<Core> core_;
  unsigned unit_;
};

class ModbusBus : public Bus {
 public:
  static constexpr std::string_view type = "modbus";
  /// Its name is its device or host. SetupError (bad-argument): invalid settings, or not exactly one of device and
  /// host.
  explicit ModbusBus(ModbusConfig config);
  ModbusBus(std::string name, ModbusConfig config);
  /// RTU over another transport, such as a FakeSerial; `device`, `serial` and `host` are not used.
  ModbusBus(std::string name, std::shared_ptr<SerialTransport> line, ModbusConfig config);

  /// SetupError (bad-argument): the unit is not 0 to 255.
  ModbusDevice device(const ModbusDevice::Place& place) const;
  /// Always empty: several sensors may read one device.
  static std::string text_of(const ModbusDevice::Place&) { return {}; }
  /// The transfer counts of the unit. Any thread.
  TransferCounts counts(unsigned unit) const { return counts_of("unit " + std::to_string(unit)); }

 private:
  std::shared_ptr<ModbusDevice::Core> core_;
};

}  // namespace rtdata
