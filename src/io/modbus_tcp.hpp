// Modbus TCP requests and numbered answers; late answers, or answers to other requests, are skipped.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "rtdata/data/time.hpp"

namespace rtdata::detail {

/// A connection, of one thread at a time.
class ModbusTcp {
 public:
  using Bytes = std::vector<std::uint8_t>;
  /// `request`: the function code and its data. Returns 0 or an errno like libmodbus, also for the device's exceptions.
  int ask(int connection, unsigned unit, std::span<const std::uint8_t> request, Duration timeout);
  /// The answer to the last request: the function code and its data.
  const Bytes& answer() const noexcept { return answer_; }

 private:
  enum class Taken { answer, nothing, broken };
  Taken take(std::uint8_t function);
  int receive(int connection);

  std::uint16_t number_ = 0;  // number of the last request
  Bytes out_, in_, answer_;   // `in_` was received, but not taken yet
};

/// True if the peer has closed or reset the connection and nothing is left to read.
bool has_ended_modbus(int connection) noexcept;

}  // namespace rtdata::detail
