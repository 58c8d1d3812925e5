// Requests of Modbus TCP and their answers, which have numbers: what is late, or of another request, is passed over.
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
  /// `request` is its function and what belongs to that. 0, or an errno as libmodbus gives them, of the device's
  /// exceptions too.
  int ask(int connection, unsigned unit, std::span<const std::uint8_t> request, Duration timeout);
  /// To the last request: its function and what belongs to that.
  const Bytes& answer() const noexcept { return answer_; }

 private:
  enum class Taken { answer, nothing, broken };
  Taken take(std::uint8_t function);
  int receive(int connection);

  std::uint16_t number_ = 0;  // of the last request
  Bytes out_, in_, answer_;   // `in_` has come, and is not taken
};

/// The peer has closed it, or reset it, and nothing is left to be read.
bool has_ended_modbus(int connection) noexcept;

}  // namespace rtdata::detail
