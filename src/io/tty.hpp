// Opening and closing a serial line of the kernel.
#pragma once

#include <string>

#include "rtdata/data/error.hpp"
#include "rtdata/io/serial.hpp"

namespace rtdata::detail {

/// The c_cflag of these settings, speed left out. Errors: bad-argument.
Result<unsigned> control_flags(const SerialSettings& settings);

/// Opens it raw, non-blocking and locked for this program. Returns the descriptor; close it with `close_tty`. Errors:
/// not-found, not-permitted, busy, bad-argument (not a tty, invalid settings), out-of-range (the device does not
/// support them).
Result<int> open_tty(const std::string& path, const SerialSettings& settings);
void close_tty(int fd) noexcept;

}  // namespace rtdata::detail
