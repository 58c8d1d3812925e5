// Text to a file descriptor, from a thread of its own: the caller never waits for a terminal, a pipe or a disk.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string_view>

#include "rtdata/data/time.hpp"

namespace spdlog {
class logger;
namespace details {
class thread_pool;
}
}  // namespace spdlog

namespace rtdata::app {

/// Counts for code that must not lock: a signal handler.
struct WriterCounts {
  std::atomic<std::uint64_t> taken{0};
  std::atomic<std::uint64_t> written{0};
  std::atomic<int> last_errno{0};  ///< of a write that failed; its text is lost
  std::atomic<int> fd{-1};
  bool is_idle() const noexcept { return written.load() >= taken.load(); }
};

/// One thread, started at the first `open`. When more than `queue` texts wait, the oldest is thrown away.
/// Thread: `write` any, all else one.
class AsyncWriter {
 public:
  explicit AsyncWriter(std::size_t queue) : queue_(queue) {}
  AsyncWriter(const AsyncWriter&) = delete;
  AsyncWriter& operator=(const AsyncWriter&) = delete;
  /// Waits for what is queued, at most 2 s: a thread that is stuck in a write is left behind.
  ~AsyncWriter();

  /// `fd` stays the caller's and must live as long as this. `before`: called on the thread with the size of what is
  /// written next; it may put another file behind `fd`.
  void open(int fd, std::function<void(std::size_t)> before = {});
  bool is_open() const noexcept { return logger_ != nullptr; }
  void write(std::string_view text) noexcept;
  /// True when everything taken so far has been written, or thrown away.
  bool wait_until_written(Duration limit) noexcept;
  const WriterCounts& counts() const noexcept { return *counts_; }

 private:
  std::size_t queue_;
  std::shared_ptr<WriterCounts> counts_ = std::make_shared<WriterCounts>();
  std::shared_ptr<spdlog::details::thread_pool> pool_;
  std::shared_ptr<spdlog::logger> logger_;
};

/// All of the text, by write(2); errno of what failed, or 0. Async-signal-safe.
int write_fully(int fd, const char* text, std::size_t size) noexcept;

}  // namespace rtdata::app
