// Modbus: TCP (modbus_tcp.hpp) with connections made here within a time limit, and RTU (modbus_rtu.hpp) over a serial
// line or such a connection.
#include "rtdata/io/modbus.hpp"

#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

#include "io/libmodbus.hpp"
#include "io/modbus_rtu.hpp"
#include "io/modbus_tcp.hpp"
#include "io/stream_line.hpp"
#include "io/tty.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/io/serial.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_ask = "cannot read the device";
constexpr unsigned last_unit = 255;

/// Why a bus cannot be made from it.
detail::SettingMistake mistake_in(const ModbusConfig& config) {
  if (config.device.empty() && config.host.empty())
    return {"device", "there is neither a `device` (RTU) nor a `host` (TCP); set one of them"};
  if (!config.device.empty() && !config.host.empty())
    return {"host", "there is a `device` too; a bus is a serial line (RTU) or a server (TCP)"};
  if (config.rtu_over_tcp && config.host.empty())
    return {"rtu_over_tcp", "it works only with `host`; a serial line always uses RTU"};
  if (config.echo && config.device.empty() && !config.rtu_over_tcp)
    return {"echo", "Modbus TCP has no echo: `echo` works only with RTU, on a serial line or with `rtu_over_tcp`"};
  if (!config.host.empty()) {
    const SerialSettings& serial = config.serial;
    for (const auto& [key, is_set] : {std::pair("dtr", serial.dtr.has_value()),
                                      {"rts", serial.rts.has_value()},
                                      {"hangup", serial.hangup},
                                      {"rs485", serial.rs485.has_value()}})
      if (is_set) return {key, "it works only with a serial line (`device`)"};
  }
  if (!config.device.empty() && config.serial.character_size != 8)
    return {"character_size", "Modbus RTU needs 8 bits per character, not " +
                                  std::to_string(config.serial.character_size) + "; Modbus ASCII is not supported"};
  if (config.answer_timeout >= config.timeout)
    return {"answer_timeout", "it is " + to_string(config.answer_timeout) + ", and a reading is given up after " +
                                  to_string(config.timeout) + ": make `timeout` longer"};
  if (config.connect_delay > Duration{0} && config.host.empty()) return {"connect_delay", "it works only with `host`"};
  if (config.connect_delay >= config.timeout - config.answer_timeout)
    return {"connect_delay",
            "with `answer_timeout` it is longer than `timeout`, after which a reading is given up: make "
            "`timeout` longer"};
  return {};
}

constexpr auto take_nothing = [](const std::uint8_t*) {};

}  // namespace

void check_config(const ModbusConfig& config, const ConfigItem& item, Problems& problems) {
  if (!detail::add_not_installed(detail::libmodbus.load(), item, problems)) return;
  check_config(config.serial, item, problems);
  detail::add_mistake(mistake_in(config), item, problems);
}

/// A function code and its data.
class ModbusDevice::Request {
 public:
  Request(std::uint8_t function, std::uint16_t first, std::size_t number) {
    add(function);
    add_word(first);
    add_word(static_cast<std::uint16_t>(number));
    answer_size_ = function <= 2 ? 2 + (number + 7) / 8 : function <= 4 ? 2 + 2 * number : size_;
  }
  void add(std::size_t byte) { bytes_[size_++] = static_cast<std::uint8_t>(byte); }
  void add_word(std::uint16_t word) {
    add(word >> 8);
    add(word & 0xff);
  }
  std::span<const std::uint8_t> bytes() const noexcept { return {bytes_.data(), size_}; }
  std::size_t answer_size() const noexcept { return answer_size_; }
  /// The answer to a read has its length first; the answer to a write repeats it.
  bool is_answered_by(const std::vector<std::uint8_t>& answer) const noexcept {
    if (answer.size() != answer_size_) return false;
    return bytes_[0] <= 4 ? answer[1] == answer_size_ - 2 : std::equal(answer.begin(), answer.end(), bytes_.begin());
  }

 private:
  std::array<std::uint8_t, MODBUS_MAX_PDU_LENGTH> bytes_{};
  std::size_t size_ = 0;
  std::size_t answer_size_ = 0;
};

/// Shared by the bus and its devices, which may hang and outlive it.
struct ModbusDevice::Core {
  /// A connection. Shared with a request that hangs.
  struct Connection {
    Connection(const Connection&) = delete;
    Connection& operator=(const Connection&) = delete;
    explicit Connection(int fd_) : fd(fd_) {}
    ~Connection() { ::close(fd); }
    const int fd;
    detail::ModbusTcp tcp;
    std::atomic<bool> is_in_use{true};  // initially used by the caller that made it
    bool was_asked = false;
    int silences = 0;  // requests without an answer, one after the other
  };
  using Use = std::shared_ptr<Connection>;

  /// `line`: for RTU; null: a TCP connection.
  Core(std::string bus_, ModbusConfig config_, std::shared_ptr<SerialTransport> line)
      : bus(std::move(bus_)), config(std::move(config_)) {
    if (line != nullptr) {
      rtu.emplace(bus, std::move(line), config);
    } else if (config.rtu_over_tcp) {
      auto stream = std::make_shared<detail::StreamLine>(
          detail::StreamLine::Kind{config.host + " port " + std::to_string(config.port),
                                   [of = config]() -> Result<int> {
                                     Result<int> fd = detail::connect_to(of.host, of.port, of.answer_timeout);
                                     if (fd) detail::lane_sleep(of.connect_delay);
                                     return fd;
                                   },
                                   [](int fd) noexcept { ::close(fd); }, detail::StreamLine::Kind::Sort::connection});
      rtu.emplace(bus, stream, config, [stream] { stream->drop(); });
    }
  }

  Result<Use> connect() {
    const Result<int> fd = detail::connect_to(config.host, config.port, config.answer_timeout);
    if (!fd) return fd.error();
    return std::make_shared<Connection>(*fd);
  }

  /// The connection for one request; a new one if there is none, or if a given-up request hangs in the old one.
  Result<Use> acquire() {
    {
      const std::lock_guard lock(mutex);
      if (connection != nullptr && !connection->is_in_use.exchange(true)) return connection;
      connection = nullptr;
    }
    Result<Use> made = connect();
    if (!made) return made;
    const std::lock_guard lock(mutex);
    return connection = *made;
  }
  void release(const Use& use, bool is_of_use) {
    use->is_in_use = false;
    if (is_of_use) return;
    const std::lock_guard lock(mutex);
    if (connection == use) connection = nullptr;
  }

  const std::string bus;
  const ModbusConfig config;
  std::optional<detail::ModbusRtu> rtu;
  std::mutex mutex;  // protects the members below; not held while it connects or asks
  Use connection;
};

Error ModbusDevice::error(Errc code, std::string what, std::string why, std::string advice) const {
  return {code, std::move(what), "bus " + core_->bus + ", unit " + std::to_string(unit_), std::move(why),
          std::move(advice)};
}

Error ModbusDevice::failure(int number) const {
  const auto exception = [&](Errc code, const char* name, const char* advice) {
    return error(code, cannot_ask, "it answers with exception " + std::to_string(number - MODBUS_ENOBASE) + ", " + name,
                 advice);
  };
  switch (number) {
    case EMBXILFUN:
      return exception(
          Errc::bad_argument, "illegal function",
          "change `table`: the manual of the device lists its function codes (holding 3, input 4, coil 1, discrete 2)");
    case EMBXILADD:
      return exception(Errc::bad_argument, "illegal data address",
                       "check `address`: if the manual counts from 1 or from 40001, it is one less than there");
    case EMBXILVAL:
      return exception(
          Errc::bad_argument, "illegal data value",
          "set `gap` to 0, or divide `fields` among sensors: the device may allow fewer registers in one request");
    case EMBXSFAIL:
      return exception(Errc::io_failed, "server device failure",
                       "look at the display or the log of the device: it failed while it prepared the answer");
    case EMBXACK:
      return exception(Errc::busy, "acknowledge", "lower `rate`: the device needs more time");
    case EMBXSBUSY:
      return exception(Errc::busy, "server device busy",
                       "lower `rate`, or find out which other program reads the device");
    case EMBXNACK:
      return exception(Errc::io_failed, "negative acknowledge", "read in its manual what it needs first");
    case EMBXMEMPAR:
      return exception(Errc::io_failed, "memory parity error", "have the device checked: its memory is damaged");
    case EMBXGPATH:
      return exception(Errc::disconnected, "gateway path unavailable",
                       "check `unit` and the settings of the gateway: it has no path to this unit");
    case EMBXGTAR:
      return exception(Errc::timed_out, "gateway target device failed to respond",
                       "check the device behind the gateway");
    case EMBBADCRC:
      return error(Errc::bad_data, cannot_ask, "the checksum of its answer is wrong",
                   "check the wires, their termination, `baud_rate` and `parity`");
    case EMBBADSLAVE:
      return error(
          Errc::bad_data, cannot_ask, "another unit answers",
          "check whether two devices have this address, or whether a device answers later than `answer_timeout`");
    case detail::modbus_echo:
      return error(Errc::bad_data, cannot_ask, "it echoes the request",
                   "switch off the echo of the adapter (many have a jumper for it) or set `echo`, and check its wires");
    case detail::modbus_incomplete:
      return error(Errc::timed_out, cannot_ask,
                   "its answer was not complete within " + to_string(core_->config.answer_timeout),
                   "check the wires and `baud_rate`; make `answer_timeout` longer if the device is slow");
    case EMBBADDATA:
    case EMBUNKEXC:
      return error(Errc::bad_data, cannot_ask, modbus_strerror(number),
                   core_->rtu ? "check the wires, `baud_rate` and `parity`, and which other devices are on the line"
                              : "check whether that server speaks Modbus");
    case ETIMEDOUT:
      return error(Errc::timed_out, cannot_ask, "no answer within " + to_string(core_->config.answer_timeout),
                   core_->rtu ? "check the device, its wires, `unit`, `baud_rate` and `parity`"
                              : "check the device, and `unit`");
    case EIO:
    case ENXIO:
    case ENODEV:
    case ECONNRESET:
    case EPIPE:
    case EBADF:
      return error(Errc::disconnected, core_->rtu ? "lost the serial line" : "lost the connection",
                   core_->rtu ? "the device has disappeared" : "the server has closed it",
                   "it is opened again when it is back");
    default:
      return system_error(number, cannot_ask, "bus " + core_->bus + ", unit " + std::to_string(unit_));
  }
}

/// Over TCP. A server may close an idle connection while a request is on its way; then the request is sent again on a
/// new connection.
template <class Take>
Result<void> ModbusDevice::ask_by_tcp(const Request& request, Take&& take) {
  const MonotonicTime began = detail::lane_now();
  for (;;) {
    Result<Core::Use> use = core_->acquire();
    if (use && (*use)->was_asked && detail::has_ended_modbus((*use)->fd)) {
      core_->release(*use, false);
      use = core_->acquire();
    }
    int number = ECONNREFUSED;
    bool is_new = true;
    if (use) {
      Core::Connection& connection = **use;
      is_new = !std::exchange(connection.was_asked, true);
      if (is_new && core_->config.connect_delay > Duration{0}) wait(core_->config.connect_delay);
      note_request();
      number = connection.tcp.ask(connection.fd, unit_, request.bytes(), core_->config.answer_timeout);
      if (number == 0 && !request.is_answered_by(connection.tcp.answer())) number = EMBBADDATA;
      if (number == 0) take(connection.tcp.answer().data());
      connection.silences = number == ETIMEDOUT ? connection.silences + 1 : 0;
      const bool is_exception = number > MODBUS_ENOBASE && number < EMBBADCRC;
      core_->release(
          *use, number == 0 || is_exception || (number == ETIMEDOUT && connection.silences < detail::most_silences));
    }
    if (!is_new && (number == ECONNRESET || number == EPIPE)) continue;
    count(detail::lane_now() - began, number == 0);
    if (!use) return use.error();
    return number == 0 ? Result<void>() : Result<void>(failure(number));
  }
}

/// `take` gets the answer: the function code and its data.
template <class Take>
Result<void> ModbusDevice::ask(const Request& request, Take&& take) {
  if (is_abandoned()) return error(Errc::closed, cannot_ask, "this reading was given up before");
  if (!core_->rtu) return ask_by_tcp(request, take);
  const MonotonicTime began = detail::lane_now();
  detail::ModbusRtu::Answer answer;
  const Result<int> number = core_->rtu->ask(*this, unit_, request.bytes(), request.answer_size(), answer);
  const bool is_good = number && *number == 0;
  if (is_good) take(answer.bytes.data());
  count(detail::lane_now() - began, is_good);
  count_skipped(answer.skipped);
  if (!number) return number.error();
  return is_good ? Result<void>() : Result<void>(failure(*number));
}

Result<void> ModbusDevice::look_at() {
  if (is_abandoned()) return error(Errc::closed, cannot_ask, "this reading was given up before");
  if (core_->rtu) return core_->rtu->open();
  const Result<Core::Use> use = core_->acquire();
  if (!use) return use.error();
  core_->release(*use, true);
  return {};
}

Result<void> ModbusDevice::read_registers(ModbusTable table, std::uint16_t first, std::span<std::uint16_t> words) {
  const bool is_holding = table == ModbusTable::holding;
  if (words.empty() || words.size() > most_registers || first + words.size() > 65536 ||
      (!is_holding && table != ModbusTable::input))
    return error(Errc::bad_argument, cannot_ask, "these registers cannot be read in one request",
                 "read at most 125 holding or input registers, up to address 65535");
  const auto take = [&](const std::uint8_t* answer) {
    for (std::size_t i = 0; i < words.size(); ++i)
      words[i] = static_cast<std::uint16_t>(answer[2 + 2 * i] << 8 | answer[3 + 2 * i]);
  };
  return ask({is_holding ? std::uint8_t{3} : std::uint8_t{4}, first, words.size()}, take);
}

Result<void> ModbusDevice::read_bits(ModbusTable table, std::uint16_t first, std::span<std::uint8_t> bits) {
  const bool is_coil = table == ModbusTable::coil;
  if (bits.empty() || bits.size() > most_bits || first + bits.size() > 65536 ||
      (!is_coil && table != ModbusTable::discrete))
    return error(Errc::bad_argument, cannot_ask, "these bits cannot be read in one request",
                 "read at most 2000 coils or discrete inputs, up to address 65535");
  const auto take = [&](const std::uint8_t* answer) {
    for (std::size_t i = 0; i < bits.size(); ++i) bits[i] = answer[2 + i / 8] >> (i % 8) & 1;
  };
  return ask({is_coil ? std::uint8_t{1} : std::uint8_t{2}, first, bits.size()}, take);
}

Result<void> ModbusDevice::write_registers(std::uint16_t first, std::span<const std::uint16_t> words) {
  if (words.empty() || words.size() > MODBUS_MAX_WRITE_REGISTERS || first + words.size() > 65536)
    return error(Errc::bad_argument, "cannot write to the device", "these registers cannot be written in one request",
                 "write at most 123 registers, up to address 65535");
  Request request(words.size() == 1 ? 6 : 16, first, words.size() == 1 ? words[0] : words.size());
  if (words.size() > 1) {
    request.add(2 * words.size());
    for (const std::uint16_t word : words) request.add_word(word);
  }
  return ask(request, take_nothing);
}

Result<void> ModbusDevice::write_coil(std::uint16_t address, std::uint8_t bit) {
  return ask({5, address, bit != 0 ? std::size_t{0xff00} : 0}, take_nothing);
}

ModbusBus::ModbusBus(ModbusConfig config)
    : ModbusBus(config.device.empty() ? std::string(config.host) : std::string(config.device), config) {}

ModbusBus::ModbusBus(std::string name, ModbusConfig config) : Bus(name, config.timeout) {
  detail::libmodbus.load().or_throw();
  if (const auto mistake = mistake_in(config))
    throw SetupError({Errc::bad_argument, "cannot use this bus", "bus " + name, mistake.why, ""});
  if (const auto flags = detail::control_flags(config.serial); !flags) throw SetupError(flags.error());
  auto line = config.device.empty() ? nullptr : make_kernel_serial(config.device, config.serial);
  core_ = std::make_shared<ModbusDevice::Core>(std::move(name), std::move(config), std::move(line));
}

ModbusBus::ModbusBus(std::string name, std::shared_ptr<SerialTransport> line, ModbusConfig config)
    : Bus(name, config.timeout) {
  detail::libmodbus.load().or_throw();
  core_ = std::make_shared<ModbusDevice::Core>(std::move(name), std::move(config), std::move(line));
}

ModbusDevice ModbusBus::device(const ModbusDevice::Place& place) const {
  if (place.unit > last_unit)
    throw SetupError({Errc::bad_argument, "cannot use this unit", "bus " + name(),
                      "a unit has a number from 0 to 255, not " + std::to_string(place.unit), ""});
  return {core_, place.unit, counter_of("unit " + std::to_string(place.unit))};
}

}  // namespace rtdata
