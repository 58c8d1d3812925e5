#include "rtdata/io/serial.hpp"

#include <algorithm>
#include <array>

#include "io/asked_line.hpp"
#include "io/child_process.hpp"
#include "io/stream_line.hpp"
#include "io/tty.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/detail/loop/lane.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_read = "no answer";

std::string what_to_check(const SerialPortConfig& config) {
  if (!config.run.empty()) return "check the program, and its messages on standard error";
  return config.host.empty() ? "check the device, its wires, and `baud_rate`" : "check the device and the network";
}

constexpr const char* keys_of_a_port = "`device`, `host` and `run`";

std::shared_ptr<SerialTransport> transport_of(const SerialPortConfig& config) {
  if (const auto mistake = detail::mistake_in_place(config, keys_of_a_port))
    throw mistake.error("cannot use this serial line");
  if (!config.run.empty()) return detail::make_program_line(config.run);
  if (config.host.empty()) return make_kernel_serial(config.device, config.serial);
  return make_tcp_line(config.host, config.port, config.answer_timeout);
}

std::string place_of_port(const SerialPortConfig& config) {
  if (!config.run.empty()) return config.run.front();
  return config.host.empty() ? config.device : config.host + " port " + std::to_string(config.port);
}

std::span<const std::uint8_t> bytes_of(std::string_view text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

}  // namespace

detail::SettingMistake detail::mistake_in_place(const SerialPortConfig& config, const char* keys) {
  const int places = !config.device.empty() + !config.host.empty() + !config.run.empty();
  const char* const other = config.host.empty() ? "run" : "host";
  if (places == 0) return {"device", "one of " + std::string(keys) + " is needed", "set one of them"};
  if (places > 1) return {other, "only one of " + std::string(keys) + " is possible", "keep one of them"};
  if (!config.host.empty() && config.port == 0) return {"port", "there is no `port`", "set it, such as 5025 for SCPI"};
  if (config.host.empty() && config.port != 0) return {"port", "it works only with `host`", "remove it"};
  if (!config.run.empty() && config.run.front().empty())
    return {"run", "there is no program", "name it as the first word"};
  const SerialSettings& serial = config.serial;
  if (config.device.empty() && (serial.dtr || serial.rts || serial.hangup || serial.rs485))
    return {other, "`dtr`, `rts`, `hangup` and `rs485` work only with a serial `device`", "remove them"};
  return {};
}

void detail::check_place(const SerialPortConfig& config, const char* keys, const ConfigItem& item, Problems& problems) {
  const SettingMistake mistake = mistake_in_place(config, keys);
  if (!mistake && config.device.empty())
    for (const char* const key : {"baud_rate", "character_size", "parity", "stop_bits"})
      if (const ConfigItem* const at = item.find(key))
        problems.add(at->problem("bad-value", "it works only with a serial `device`: remove it"));
  add_mistake(mistake, item, problems, "missing-key");
  if (!mistake) add_mistake(mistake_in_program(config.run), item, problems);
}

void check_config(const SerialSettings& settings, const ConfigItem& item, Problems& problems) {
  const Result<unsigned> flags = detail::control_flags(settings);
  const ConfigItem* const at = item.find("rts");
  if (!flags && at != nullptr) problems.add(at->problem("bad-value", flags.error().why + "; " + flags.error().advice));
}

void check_config(const SerialPortConfig& config, const ConfigItem& item, Problems& problems) {
  check_config(config.serial, item, problems);
  detail::check_place(config, keys_of_a_port, item, problems);
  if (config.answer_timeout < config.timeout) return;
  const ConfigItem* at = item.find("answer_timeout");
  if (at == nullptr) at = item.find("timeout");
  problems.add((at != nullptr ? *at : item)
                   .problem("out-of-range", "answer_timeout is " + to_string(config.answer_timeout) +
                                                ", and a reading is given up after " + to_string(config.timeout) +
                                                ": make `timeout` longer"));
}

/// Shared by the port and its devices, which may hang and outlive it.
struct SerialDevice::Core {
  Core(std::string bus_, std::shared_ptr<SerialTransport> transport, SerialPortConfig config_)
      : bus(std::move(bus_)),
        config(std::move(config_)),
        line(bus, std::move(transport), config.answer_timeout, config.timeout, config.echo) {}
  const std::string bus;
  const SerialPortConfig config;
  detail::AskedLine line;
  detail::AskedLine::Partner all;  // answers do not identify their device
};

Error SerialDevice::error(Errc code, std::string what, std::string why, std::string advice) const {
  return {code, std::move(what), "bus " + core_->bus, std::move(why), std::move(advice)};
}

Duration SerialDevice::answer_timeout() const noexcept { return core_->config.answer_timeout; }

Result<void> SerialDevice::check_wanted() const {
  if (is_abandoned()) return error(Errc::closed, "cannot talk to the device", "this reading was given up before");
  return {};
}

Result<void> SerialDevice::look_at() {
  if (auto wanted = check_wanted(); !wanted) return wanted;
  return core_->line.open();
}

Result<void> SerialDevice::drop_input() {
  pending_.clear();
  if (auto wanted = check_wanted(); !wanted) return wanted;
  const Result<std::size_t> dropped = core_->line.settle(core_->all);
  if (!dropped) return dropped.error();
  count_skipped(*dropped);
  return {};
}

std::uint64_t SerialDevice::losses() const { return core_->line.losses(); }

void SerialDevice::distrust() {
  if (!is_abandoned()) core_->line.distrust(core_->all);
}

Result<void> SerialDevice::write(std::span<const std::uint8_t> bytes) {
  if (auto wanted = check_wanted(); !wanted) return wanted;
  note_request();
  const MonotonicTime began = detail::lane_now();
  Result<void> done = core_->line.write(core_->all, bytes);
  count(detail::lane_now() - began, static_cast<bool>(done));
  return done;
}

Result<void> SerialDevice::write(std::string_view text) { return write(bytes_of(text)); }

Result<bool> SerialDevice::receive(MonotonicTime until) {
  if (auto wanted = check_wanted(); !wanted) return std::move(wanted).error();
  std::array<std::uint8_t, 512> bytes{};
  const MonotonicTime began = detail::lane_now();
  const Result<std::size_t> got = core_->line.read(core_->all, bytes, until);
  count(detail::lane_now() - began, got && *got > 0);
  if (!got) return got.error();
  pending_.append(reinterpret_cast<const char*>(bytes.data()), *got);
  return *got > 0;
}

Result<void> SerialDevice::read(std::span<std::uint8_t> bytes, std::optional<Duration> timeout) {
  const Duration patience = timeout.value_or(core_->config.answer_timeout);
  const MonotonicTime until = detail::lane_now() + patience;
  while (pending_.size() < bytes.size()) {
    const Result<bool> came = receive(until);
    if (!came) return came.error();
    if (*came) continue;
    distrust();
    return error(Errc::timed_out, cannot_read,
                 std::to_string(pending_.size()) + " of " + std::to_string(bytes.size()) + " bytes came within " +
                     to_string(patience),
                 what_to_check(core_->config));
  }
  std::copy_n(pending_.begin(), bytes.size(), bytes.begin());
  pending_.erase(0, bytes.size());
  core_->line.answered(core_->all, !pending_.empty());
  return {};
}

Result<std::uint8_t> SerialDevice::read_byte(std::optional<Duration> timeout) {
  std::uint8_t byte = 0;
  if (auto done = read({&byte, 1}, timeout); !done) return std::move(done).error();
  return byte;
}

Result<std::size_t> SerialDevice::read_some(std::span<std::uint8_t> bytes, std::optional<Duration> timeout) {
  const Duration patience = timeout.value_or(core_->config.answer_timeout);
  if (pending_.empty()) {
    const Result<bool> came = receive(detail::lane_now() + patience);
    if (!came) return came.error();
    if (!*came) {
      distrust();
      return error(Errc::timed_out, cannot_read, "nothing came within " + to_string(patience));
    }
  }
  const std::size_t count = std::min(pending_.size(), bytes.size());
  std::copy_n(pending_.begin(), count, bytes.begin());
  pending_.erase(0, count);
  return count;
}

Result<std::string> SerialDevice::read_until(char delimiter, std::optional<Duration> timeout, std::size_t most) {
  const Duration patience = timeout.value_or(core_->config.answer_timeout);
  const MonotonicTime until = detail::lane_now() + patience;
  for (std::size_t looked_at = 0;;) {
    const std::size_t end = pending_.find(delimiter, looked_at);
    if (end != std::string::npos && end <= most) {
      std::string text = pending_.substr(0, end);
      pending_.erase(0, end + 1);
      core_->line.answered(core_->all, !pending_.empty());
      return text;
    }
    if (pending_.size() > most) {
      pending_.clear();
      distrust();
      return error(Errc::does_not_fit, "cannot use an answer",
                   "more than " + std::to_string(most) + " bytes came without an end",
                   what_to_check(core_->config) + "; and how answers end");
    }
    looked_at = pending_.size();
    const Result<bool> came = receive(until);
    if (!came) return came.error();
    if (*came) continue;
    distrust();
    return error(Errc::timed_out, cannot_read,
                 pending_.empty() ? "nothing came within " + to_string(patience)
                                  : std::to_string(pending_.size()) + " bytes came within " + to_string(patience) +
                                        ", without an end",
                 what_to_check(core_->config) + "; and how answers end");
  }
}

Result<void> SerialDevice::transact(std::span<const std::uint8_t> request, std::span<std::uint8_t> answer,
                                    std::optional<Duration> timeout) {
  if (auto dropped = drop_input(); !dropped) return dropped;
  if (auto written = write(request); !written) return written;
  return read(answer, timeout);
}

Result<std::string> SerialDevice::transact(std::string_view request, char delimiter, std::optional<Duration> timeout,
                                           std::size_t most) {
  if (auto dropped = drop_input(); !dropped) return std::move(dropped).error();
  if (auto written = write(request); !written) return std::move(written).error();
  return read_until(delimiter, timeout, most);
}

SerialPort::SerialPort(SerialPortConfig config) : SerialPort(place_of_port(config), config) {}

// Not moved, because the order of argument evaluation is unspecified.
SerialPort::SerialPort(std::string name, SerialPortConfig config)
    : SerialPort(std::move(name), transport_of(config), config) {}

SerialPort::SerialPort(std::string name, std::shared_ptr<SerialTransport> transport, SerialPortConfig config)
    : Bus(name, config.timeout),
      core_(std::make_shared<SerialDevice::Core>(std::move(name), std::move(transport), std::move(config))) {
  if (const auto flags = detail::control_flags(core_->config.serial); !flags) throw SetupError(flags.error());
}

SerialDevice SerialPort::device(const SerialDevice::Place&) const { return {core_, counter_of(all)}; }

}  // namespace rtdata
