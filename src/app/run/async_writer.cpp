#include "app/run/async_writer.hpp"

#include <poll.h>
#include <spdlog/async_logger.h>
#include <spdlog/details/null_mutex.h>
#include <spdlog/details/thread_pool.h>
#include <spdlog/pattern_formatter.h>
#include <spdlog/sinks/base_sink.h>
#include <time.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>

#include "loop/core/no_thread.hpp"
#include "loop/core/signals_blocked.hpp"

namespace rtdata::app {
namespace {

class FdSink final : public spdlog::sinks::base_sink<spdlog::details::null_mutex> {
 public:
  FdSink(std::shared_ptr<WriterCounts> counts, std::function<void(std::size_t)> before)
      : counts_(std::move(counts)), before_(std::move(before)) {}

 private:
  void sink_it_(const spdlog::details::log_msg& message) override {
    if (before_) before_(message.payload.size());
    const int failed = write_fully(counts_->fd.load(), message.payload.data(), message.payload.size());
    if (failed != 0) counts_->last_errno.store(failed);
    counts_->written.fetch_add(1);
  }
  void flush_() override {}

  std::shared_ptr<WriterCounts> counts_;
  std::function<void(std::size_t)> before_;
};

}  // namespace

int write_fully(int fd, const char* text, std::size_t size) noexcept {
  while (size > 0) {
    const ssize_t written = ::write(fd, text, size);
    if (written > 0) {
      text += written;
      size -= static_cast<std::size_t>(written);
    } else if (written < 0 && errno == EAGAIN) {
      pollfd ready{fd, POLLOUT, 0};
      ::poll(&ready, 1, 100);
    } else if (written < 0 && errno != EINTR) {
      return errno;
    }
  }
  return 0;
}

AsyncWriter::~AsyncWriter() {
  if (pool_ == nullptr) return;
  const bool is_written = wait_until_written(std::chrono::seconds{2});
  logger_ = nullptr;
  if (!is_written) new std::shared_ptr(pool_);  // joining its thread might never return; the process ends soon
}

void AsyncWriter::open(int fd, std::function<void(std::size_t)> before) {
  counts_->fd.store(fd);
  if (pool_ != nullptr) return;
  // Blocks fatal signals in its thread: the signal handler waits for this thread to write.
  const detail::SignalsBlocked for_the_writer;
  try {
    pool_ = std::make_shared<spdlog::details::thread_pool>(queue_, 1);
  } catch (const std::system_error&) {
    throw SetupError(detail::no_thread("cannot start", "the thread that writes to the terminal or the log"));
  }
  logger_ = std::make_shared<spdlog::async_logger>("rtdata", std::make_shared<FdSink>(counts_, std::move(before)),
                                                   pool_, spdlog::async_overflow_policy::overrun_oldest);
  logger_->set_level(spdlog::level::trace);
}

void AsyncWriter::write(std::string_view text) noexcept {
  if (logger_ == nullptr) return;
  counts_->taken.fetch_add(1);
  logger_->log(spdlog::level::info, spdlog::string_view_t(text.data(), text.size()));
}

bool AsyncWriter::wait_until_written(Duration limit) noexcept {
  if (logger_ == nullptr) return true;
  const auto end = std::chrono::steady_clock::now() + limit;
  const std::uint64_t taken = counts_->taken.load();
  while (counts_->written.load() + pool_->overrun_counter() < taken) {
    if (std::chrono::steady_clock::now() >= end) return false;
    const timespec pause{0, 1'000'000};
    ::nanosleep(&pause, nullptr);
  }
  return true;
}

}  // namespace rtdata::app
