// The log file of a run: one line for every error, written at once, whatever happens to the program.
//
//     2026-03-01T12:00:00.123456Z error sensor chamber: cannot read the ADC file: ... [not-found]
#pragma once

#include <string>

#include "app/run/async_writer.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::app {

/// Appends to the file, which rotates by size (LogSettings). Thread: `write` any, all other functions the main one.
class Log {
 public:
  Log() : writer_(128) {}  // queued lines; each takes 0.4 KiB, allocated at the start
  Log(const Log&) = delete;
  Log& operator=(const Log&) = delete;
  ~Log();

  /// Errors: the operating system's; then `write` does nothing.
  Result<void> open(const std::string& file, const LogSettings& settings);
  const std::string& file() const noexcept { return file_; }
  void write(LogLevel level, std::string_view object, std::string_view text, std::string_view error_id = {}) noexcept;
  bool wait_until_written(Duration limit) noexcept { return writer_.wait_until_written(limit); }
  const WriterCounts& counts() const noexcept { return writer_.counts(); }

 private:
  std::string file_;
  LogLevel least_ = LogLevel::info;
  int fd_ = -1;
  AsyncWriter writer_;
};

std::string_view name_of(LogLevel level) noexcept;

/// While it lives, a fatal signal (SIGSEGV, SIGBUS, SIGILL, SIGFPE, SIGABRT, SIGSYS, SIGXCPU, SIGXFSZ) waits up to half
/// a second for the log to be written, adds its own line, and then has its previous effect. One at a time in a process.
class FatalSignals {
 public:
  explicit FatalSignals(const Log& log);
  FatalSignals(const FatalSignals&) = delete;
  FatalSignals& operator=(const FatalSignals&) = delete;
  ~FatalSignals();
};

}  // namespace rtdata::app
