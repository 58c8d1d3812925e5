#include "loop/core/uv_handles.hpp"

#include <sys/eventfd.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include <algorithm>
#include <cassert>
#include <cerrno>
#include <cstdint>
#include <limits>
#include <memory>

#include "data/no_memory.hpp"
#include "loop/core/loop_core.hpp"

namespace rtdata::detail {

// libuv uses it until the close callbacks have run; for a host's uv_loop_t this is after the loop's end.
struct UvHandles::Memory {
  LoopCore* core = nullptr;
  int timer_fd = -1;
  uv_poll_t timer{};
  uv_check_t check{};
  uv_idle_t idle{};
  Wake wake;
  uv_poll_t wake_poll{};
  int clock_fd = -1;
  uv_poll_t clock{};
  int open_handles = 0;
  bool* closed = nullptr;  // set when the last handle is closed

  template <class UvHandle>
  void close(UvHandle& handle) {
    handle.data = this;
    ++open_handles;
    uv_close(reinterpret_cast<uv_handle_t*>(&handle), [](uv_handle_t* ended) {
      auto* memory = static_cast<Memory*>(ended->data);
      if (--memory->open_handles > 0) return;
      ::close(memory->timer_fd);
      if (memory->clock_fd >= 0) ::close(memory->clock_fd);
      if (memory->closed != nullptr) *memory->closed = true;
      delete memory;
    });
  }
};

namespace {

template <class UvHandle>
uv_handle_t* base(UvHandle& handle) noexcept {
  return reinterpret_cast<uv_handle_t*>(&handle);
}

[[noreturn]] void throw_uv(int status, const char* what) {
  if (status == UV_ENOMEM) no_memory();
  throw SetupError({make_error_code(Errc::io_failed), what, "libuv", uv_strerror(status), ""});
}

/// libuv aborts the process if uv_loop_init gets an epoll descriptor but no pipe for signals. So this first checks that
/// enough descriptors are free: libuv 1.44 uses 4, later versions also io_uring rings.
void require_descriptors() {
  int taken[8];
  int count = 0, failure = 0;
  for (int& one : taken) {
    one = ::eventfd(0, EFD_CLOEXEC);
    if (one < 0) {
      failure = errno;
      break;
    }
    ++count;
  }
  for (int i = 0; i < count; ++i) ::close(taken[i]);
  if (failure != 0) throw SetupError(system_error(failure, "cannot make a loop", "", "raise the limit: `ulimit -n`"));
}

/// When the time of day is set, the kernel cancels this timer, which makes the descriptor readable.
void arm_clock(int fd) noexcept {
  itimerspec never{};
  constexpr std::int64_t year_2200 = 7'258'118'400;
  using Seconds = decltype(never.it_value.tv_sec);
  never.it_value.tv_sec = static_cast<Seconds>(std::min<std::int64_t>(year_2200, std::numeric_limits<Seconds>::max()));
  ::timerfd_settime(fd, TFD_TIMER_ABSTIME | TFD_TIMER_CANCEL_ON_SET, &never, nullptr);
}

}  // namespace

UvHandles::UvHandles(LoopCore& core, uv_loop_t* host) : loop_(host != nullptr ? host : &own_loop_) {
  if (!is_attached()) {
    require_descriptors();
    if (const int status = uv_loop_init(&own_loop_); status != 0) throw_uv(status, "cannot make a loop");
  }
  make_memory(core);
  uv_poll_start(&memory_->timer, UV_READABLE, [](uv_poll_t* handle, int, int) {
    auto* memory = static_cast<Memory*>(handle->data);
    // From here on the loop turns and checks for sent data itself, so senders need not write to the descriptor.
    Wake& wake = memory->wake;
    if (!wake.is_sent() && wake.take_news()) wake.send();  // sent between the two
    memory->core->run_due();
  });
  uv_check_start(&memory_->check, [](uv_check_t* handle) { static_cast<Memory*>(handle->data)->core->turn_ended(); });
  uv_poll_start(&memory_->wake_poll, UV_READABLE, [](uv_poll_t* handle, int, int) {
    auto* memory = static_cast<Memory*>(handle->data);
    memory->wake.answer();
    memory->core->woken();
  });
  for (auto* handle : {base(memory_->timer), base(memory_->check), base(memory_->wake_poll)}) uv_unref(handle);
}

void UvHandles::make_memory(LoopCore& core) {
  auto memory = std::make_unique<Memory>();
  memory->core = &core;
  memory->timer_fd = ::timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
  const int failure = errno;
  const auto give_up = [&] {
    if (memory->timer_fd >= 0) ::close(memory->timer_fd);
    if (!is_attached()) uv_loop_close(&own_loop_);
  };
  if (memory->timer_fd < 0) {
    give_up();
    throw SetupError(system_error(failure, "cannot make a loop", "timerfd_create"));
  }
  if (!memory->wake.open()) {
    const int number = errno;
    give_up();
    throw SetupError(system_error(number, "cannot make a loop", "eventfd"));
  }
  int status = uv_poll_init(loop_, &memory->wake_poll, memory->wake.fd());
  if (status != 0) {
    give_up();
    throw_uv(status, "cannot watch for wake-ups");
  }
  status = uv_poll_init(loop_, &memory->timer, memory->timer_fd);
  if (status != 0) {
    Memory* abandoned = memory.release();
    abandoned->close(abandoned->wake_poll);
    if (!is_attached()) {
      uv_run(&own_loop_, UV_RUN_NOWAIT);
      uv_loop_close(&own_loop_);
    }
    throw_uv(status, "cannot watch the timer");
  }
  memory_ = memory.release();
  uv_check_init(loop_, &memory_->check);
  uv_idle_init(loop_, &memory_->idle);
  memory_->timer.data = memory_->check.data = memory_->idle.data = memory_->wake_poll.data = memory_;
}

UvHandles::~UvHandles() {
  memory_->core = nullptr;
  uv_poll_stop(&memory_->timer);
  memory_->close(memory_->timer);
  memory_->close(memory_->check);
  memory_->close(memory_->idle);
  memory_->close(memory_->wake_poll);
  if (memory_->clock_fd >= 0) memory_->close(memory_->clock);
  if (is_attached()) return;
  bool is_closed = false;
  memory_->closed = &is_closed;
  while (!is_closed) uv_run(&own_loop_, UV_RUN_NOWAIT);
  [[maybe_unused]] const int status = uv_loop_close(&own_loop_);
  assert(status == 0);
}

Wake& UvHandles::wake() noexcept { return memory_->wake; }

void UvHandles::arm(MonotonicTime due) noexcept {
  itimerspec spec{};
  spec.it_value.tv_sec = due.time_since_epoch().count() / 1'000'000'000;
  spec.it_value.tv_nsec = static_cast<decltype(spec.it_value.tv_nsec)>(due.time_since_epoch().count() % 1'000'000'000);
  ::timerfd_settime(memory_->timer_fd, TFD_TIMER_ABSTIME, &spec, nullptr);
}

void UvHandles::watch_clock() {
  const int fd = ::timerfd_create(CLOCK_REALTIME, TFD_NONBLOCK | TFD_CLOEXEC);
  if (fd < 0) return;
  if (uv_poll_init(loop_, &memory_->clock, fd) != 0) {
    ::close(fd);
    return;
  }
  memory_->clock_fd = fd;
  memory_->clock.data = memory_;
  arm_clock(fd);
  uv_poll_start(&memory_->clock, UV_READABLE, [](uv_poll_t* handle, int, int) {
    auto* memory = static_cast<Memory*>(handle->data);
    std::uint64_t expirations = 0;
    [[maybe_unused]] const auto got = ::read(memory->clock_fd, &expirations, sizeof expirations);  // fails: cancelled
    arm_clock(memory->clock_fd);
    memory->core->clock_was_set();
  });
  uv_unref(base(memory_->clock));
}

void UvHandles::forbid_sleep() noexcept {
  if (memory_->core->is_manual()) return;  // libuv is never told to wait
  uv_idle_start(&memory_->idle, [](uv_idle_t*) {});
}

void UvHandles::allow_sleep() noexcept { uv_idle_stop(&memory_->idle); }

void UvHandles::ref() noexcept { uv_ref(base(memory_->wake_poll)); }
void UvHandles::unref() noexcept { uv_unref(base(memory_->wake_poll)); }

}  // namespace rtdata::detail
