// Requests of Modbus RTU and their answers, on a serial line.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "io/asked_line.hpp"
#include "rtdata/io/modbus.hpp"

namespace rtdata::detail {

/// Further codes besides the errnos of libmodbus.
inline constexpr int modbus_echo = -1;        // the request was echoed
inline constexpr int modbus_incomplete = -2;  // a part of the answer came in time

/// The checksum at the end of a frame (CRC-16, 0xA001), its low byte first on the line.
std::uint16_t modbus_checksum(std::span<const std::uint8_t> bytes) noexcept;

/// Shared by the bus and its devices. Thread: as AskedLine.
class ModbusRtu {
 public:
  using Bytes = std::vector<std::uint8_t>;
  ModbusRtu(const std::string& bus, std::shared_ptr<SerialTransport> transport, const ModbusConfig& config);

  /// `request`: the function code and its data; `size`: of a good answer; `answer`: receives the function code and
  /// data. Returns 0 or an errno like libmodbus, also for the device's exceptions. After other results a late answer is
  /// possible. Errors: those of AskedLine; closed (`device` was given up while it waited).
  Result<int> ask(const BusDevice& device, unsigned unit, std::span<const std::uint8_t> request, std::size_t size,
                  Bytes& answer);
  Result<void> open() { return line_.open(); }

 private:
  const Duration silence_;  // between two frames
  const Duration answer_timeout_;
  AskedLine line_;
  std::array<AskedLine::Partner, 248> units_ = {};
};

}  // namespace rtdata::detail
