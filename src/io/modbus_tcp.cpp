#include "io/modbus_tcp.hpp"

#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <chrono>

#include "io/libmodbus.hpp"

namespace rtdata::detail {
namespace {

// MODBUS Messaging on TCP/IP Implementation Guide V1.0b, section 3.1.3.
constexpr std::size_t modbus_prefix = 7;  // number, protocol, length, unit
constexpr std::size_t most_modbus_pdu = 253;
constexpr std::uint8_t exception_bit = 0x80;

std::size_t modbus_word(const ModbusTcp::Bytes& bytes, std::size_t at) noexcept {
  return static_cast<std::size_t>(bytes[at] << 8 | bytes[at + 1]);
}

}  // namespace

bool has_ended_modbus(int connection) noexcept {
  char byte = 0;
  const ssize_t got = ::recv(connection, &byte, 1, MSG_PEEK | MSG_DONTWAIT);
  return got == 0 || (got < 0 && errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR);
}

int ModbusTcp::ask(int connection, unsigned unit, std::span<const std::uint8_t> request, Duration timeout) {
  using Clock = std::chrono::steady_clock;
  const auto until = Clock::now() + timeout;
  ++number_;
  const std::size_t length = request.size() + 1;
  out_.clear();
  for (const std::size_t word : {std::size_t{number_}, std::size_t{0}, length}) {
    out_.push_back(static_cast<std::uint8_t>(word >> 8));
    out_.push_back(static_cast<std::uint8_t>(word));
  }
  out_.push_back(static_cast<std::uint8_t>(unit));
  out_.insert(out_.end(), request.begin(), request.end());
  // The request fits into the kernel's buffer, unless there were no answers for long.
  const ssize_t sent = ::send(connection, out_.data(), out_.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
  if (sent < 0) return errno == EAGAIN || errno == EWOULDBLOCK ? ECONNRESET : errno;
  if (static_cast<std::size_t>(sent) != out_.size()) return ECONNRESET;
  for (;;) {
    switch (take(request[0])) {
      case Taken::answer:
        if (answer_[0] == request[0]) return 0;
        return answer_[1] >= 1 && answer_[1] <= 11 ? MODBUS_ENOBASE + answer_[1] : EMBUNKEXC;
      case Taken::broken:
        return EMBBADDATA;
      case Taken::nothing:
        break;
    }
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(until - Clock::now()).count();
    pollfd ready{connection, POLLIN, 0};
    const int count = left > 0 ? ::poll(&ready, 1, static_cast<int>(std::min<std::int64_t>(left, 1'000'000))) : 0;
    if (count == 0) return ETIMEDOUT;
    if (const int number = count < 0 ? errno : receive(connection); number != 0 && number != EINTR) return number;
  }
}

int ModbusTcp::receive(int connection) {
  std::uint8_t bytes[1024];
  const ssize_t got = ::recv(connection, bytes, sizeof bytes, MSG_DONTWAIT);
  if (got < 0) return errno == EAGAIN || errno == EWOULDBLOCK ? 0 : errno;
  if (got == 0) return ECONNRESET;
  in_.insert(in_.end(), bytes, bytes + got);
  return 0;
}

/// Skips complete answers to earlier requests.
ModbusTcp::Taken ModbusTcp::take(std::uint8_t function) {
  while (in_.size() >= modbus_prefix) {
    const std::size_t length = modbus_word(in_, 4);  // bytes of unit, function and data
    if (modbus_word(in_, 2) != 0 || length < 3 || length > most_modbus_pdu + 1) return Taken::broken;
    const std::size_t size = modbus_prefix - 1 + length;
    if (in_.size() < size) return Taken::nothing;
    const bool is_it = modbus_word(in_, 0) == number_;
    if (is_it) answer_.assign(in_.begin() + modbus_prefix, in_.begin() + static_cast<std::ptrdiff_t>(size));
    in_.erase(in_.begin(), in_.begin() + static_cast<std::ptrdiff_t>(size));
    if (!is_it) continue;
    return (answer_[0] & ~exception_bit) == function ? Taken::answer : Taken::broken;
  }
  return Taken::nothing;
}

}  // namespace rtdata::detail
