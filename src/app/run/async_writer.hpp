// Writes text to a file descriptor on its own thread: the caller never waits for a terminal, a pipe or a disk.
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
  std::atomic<int> last_errno{0};  ///< of the last failed write; its text is lost
  std::atomic<int> fd{-1};
  bool is_idle() const noexcept { return written.load() >= taken.load(); }
};

/// One thread, started at the first `open`. If more than `queue` texts wait, the oldest is dropped. Thread: `write`
/// any, all other functions one.
class AsyncWriter {
 public:
  explicit AsyncWriter(std::size_t queue) : queue_(queue) {}
  AsyncWriter(const AsyncWriter&) = delete;
  AsyncWriter& operator=(const AsyncWriter&) = delete;
  /// Waits for the queue, at most 2 s; abandons a thread that is stuck in a write.
  ~AsyncWriter();

  /// The caller owns `fd`, which must outlive this object. `before`: called on the thread with the size of the next
  /// write; it may put another file behind `fd`.
  void open(int fd, std::function<void(std::size_t)> before = {});
  bool is_open() const noexcept { return logger_ != nullptr; }
  void write(std::string_view text) noexcept;
  /// True if everything queued so far was written or dropped.
  bool wait_until_written(Duration limit) noexcept;
  const WriterCounts& counts() const noexcept { return *counts_; }

 private:
  std::size_t queue_;
  std::shared_ptr<WriterCounts> counts_ = std::make_shared<WriterCounts>();
  std::shared_ptr<spdlog::details::thread_pool> pool_;
  std::shared_ptr<spdlog::logger> logger_;
};

/// Writes the whole text with write(2); returns 0 or the errno. Async-signal-safe.
int write_fully(int fd, const char* text, std::size_t size) noexcept;

}  // namespace rtdata::app
