// Requests of Modbus RTU and their answers, on a serial line.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "io/asked_line.hpp"
#include "rtdata/io/modbus.hpp"

namespace rtdata::detail {

/// Further codes besides the errnos of libmodbus.
inline constexpr int modbus_echo = -1;        // the request was echoed
inline constexpr int modbus_incomplete = -2;  // a part of the answer came in time

inline constexpr int most_silences = 3;  // consecutive missing answers before a new connection is made

/// The checksum at the end of a frame (CRC-16, 0xA001), its low byte first on the line.
std::uint16_t modbus_checksum(std::span<const std::uint8_t> bytes) noexcept;

/// Shared by the bus and its devices. Thread: as AskedLine.
class ModbusRtu {
 public:
  using Bytes = std::vector<std::uint8_t>;
  /// `reconnect`: of a connection, called after three requests in a row without a byte of an answer.
  ModbusRtu(const std::string& bus, std::shared_ptr<SerialTransport> transport, const ModbusConfig& config,
            std::function<void()> reconnect = nullptr);

  struct Answer {
    Bytes bytes = {};         // the function code and its data
    std::size_t skipped = 0;  // bytes on the line that were not part of it
  };
  /// `request`: the function code and its data; `size`: of a good answer. Returns 0 or an errno like libmodbus, also
  /// for the device's exceptions. After other results a late answer is possible. Errors: those of AskedLine; closed
  /// (`device` was given up while it waited).
  Result<int> ask(BusDevice& device, unsigned unit, std::span<const std::uint8_t> request, std::size_t size,
                  Answer& answer);
  Result<void> open() { return line_.open(); }

 private:
  const Duration silence_;  // between two frames
  const Duration answer_timeout_;
  const std::function<void()> reconnect_;
  std::atomic<int> silences_{0};  // in a row
  AskedLine line_;
  std::array<AskedLine::Partner, 256> units_ = {};
};

}  // namespace rtdata::detail
