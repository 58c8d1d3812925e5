#include "app/run/stop_signals.hpp"

#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <system_error>
#include <thread>
#include <utility>

#include "loop/core/no_thread.hpp"

namespace rtdata::app {

namespace {

/// False if the process has no terminal, or it has hung up.
bool has_terminal() noexcept {
  const int fd = ::open("/dev/tty", O_RDONLY | O_CLOEXEC | O_NOCTTY | O_NONBLOCK);
  if (fd >= 0) ::close(fd);
  return fd >= 0 || (errno != ENXIO && errno != EIO && errno != ENOENT);
}

}  // namespace

struct StopSignals::State {
  sigset_t taken{};
  sigset_t mask_before{};
  int any_taken = 0;  // one of the handled signals; 0: all are ignored
  struct sigaction pipe_before {};
  const bool had_terminal = has_terminal();
  std::atomic<bool> is_over{false};
  std::thread thread;

  std::mutex mutex;
  Loop* loop = nullptr;
  Actions actions;
  const char* pending = nullptr;  // received before there was a loop
  int count = 0;
  const char* waits = nullptr;  // the first one, until the loop has processed it
  MonotonicTime posted{};
  bool is_reload_pending = false;
  std::optional<MonotonicTime> starts;  // start time, until the loop turns or the delay is reported

  struct Answer {
    std::mutex mutex;
    std::condition_variable is_there;
    std::optional<std::uint64_t> queued;
  };

  void run() {
    for (;;) {
      const int signal = next();
      if (is_over.load()) return;
      if (signal < 0) continue;
      if (signal == SIGHUP && (!had_terminal || has_terminal())) {
        reload();
        continue;
      }
      came(signal == SIGINT ? "SIGINT" : signal == SIGTERM ? "SIGTERM" : "SIGHUP");
    }
  }

  /// The next signal; -1: none. Also checks the loop.
  int next() {
    const auto left = time_left();
    if (!left) {
      int signal = 0;
      return ::sigwait(&taken, &signal) == 0 ? signal : -1;
    }
    const timespec most{static_cast<time_t>(left->count() / 1'000'000'000),
                        static_cast<long>(left->count() % 1'000'000'000)};
    if (const int signal = ::sigtimedwait(&taken, nullptr, &most); signal > 0) return signal;
    const std::lock_guard lock(mutex);
    if (loop == nullptr) return -1;
    if (waits != nullptr && actions.hangs && now() - posted >= hang_limit) actions.hangs(waits);
    if (starts && now() - *starts >= slow_limit) {
      starts.reset();
      actions.slow();
    }
    return -1;
  }
  /// Time until the loop counts as hung or slow; empty: no limit.
  std::optional<Duration> time_left() {
    const std::lock_guard lock(mutex);
    if (loop == nullptr) return std::chrono::seconds{1};  // one may come
    std::optional<MonotonicTime> until;
    if (starts) until = *starts + slow_limit;
    if (waits != nullptr && actions.hangs) until = std::min(posted + hang_limit, until.value_or(MonotonicTime::max()));
    if (!until) return {};
    return std::max(*until - now(), Duration{0});
  }
  static MonotonicTime now() noexcept { return MonotonicTime{std::chrono::steady_clock::now().time_since_epoch()}; }

  /// The first signal, for the loop.
  void post_first(const char* name) {
    waits = name;
    posted = now();
    if (actions.at_once) actions.at_once();
    loop->post([this, name] {
      {
        const std::lock_guard lock(mutex);
        waits = nullptr;
      }
      actions.first(name);
    });
  }

  void reload() {
    const std::lock_guard lock(mutex);
    is_reload_pending = loop == nullptr || !actions.reload;
    if (!is_reload_pending && count == 0) actions.reload();
  }

  void came(const char* name) {
    const std::lock_guard lock(mutex);
    ++count;
    if (loop == nullptr) {
      if (count > 1) ::_exit(1);
      pending = name;
    } else if (count == 1) {
      post_first(name);
    } else {
      actions.second(name, ask());
    }
  }

  std::optional<std::uint64_t> ask() {
    auto answer = std::make_shared<Answer>();
    loop->post([this, answer] {
      const std::lock_guard lock(answer->mutex);
      answer->queued = actions.queued();
      answer->is_there.notify_one();
    });
    std::unique_lock lock(answer->mutex);
    answer->is_there.wait_for(lock, std::chrono::milliseconds{500}, [&] { return answer->queued.has_value(); });
    return answer->queued;
  }
};

StopSignals::StopSignals() : state_(std::make_unique<State>()) {
  struct sigaction ignore {};
  ignore.sa_handler = SIG_IGN;
  ::sigaction(SIGPIPE, &ignore, &state_->pipe_before);
  ::sigemptyset(&state_->taken);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    struct sigaction now {};
    ::sigaction(signal, nullptr, &now);
    if (now.sa_handler == SIG_IGN) continue;
    ::sigaddset(&state_->taken, signal);
    state_->any_taken = signal;
  }
  if (state_->any_taken == 0) return;
  ::pthread_sigmask(SIG_BLOCK, &state_->taken, &state_->mask_before);
  try {
    state_->thread = std::thread([state = state_.get()] { state->run(); });
  } catch (const std::system_error&) {
    ::pthread_sigmask(SIG_SETMASK, &state_->mask_before, nullptr);
    throw SetupError(detail::no_thread("cannot start", "the thread that waits for signals"));
  }
}

StopSignals::~StopSignals() {
  ::sigaction(SIGPIPE, &state_->pipe_before, nullptr);
  if (state_->any_taken == 0) return;
  // The thread waits without a descriptor, which the system may refuse, so a signal wakes it.
  state_->is_over = true;
  ::pthread_kill(state_->thread.native_handle(), state_->any_taken);
  state_->thread.join();
  // A late SIGHUP must not end the process now that everything is closed.
  if (::sigismember(&state_->taken, SIGHUP) == 1) ::signal(SIGHUP, SIG_IGN);
  ::pthread_sigmask(SIG_SETMASK, &state_->mask_before, nullptr);
}

void StopSignals::attach(Loop& loop, Actions actions) {
  const std::lock_guard lock(state_->mutex);
  if (state_->loop == nullptr && actions.slow) {
    state_->starts = State::now();
    loop.post([state = state_.get()] {
      const std::lock_guard turning(state->mutex);
      state->starts.reset();
    });
  }
  state_->loop = &loop;
  state_->actions = std::move(actions);
  if (state_->pending != nullptr)
    state_->post_first(std::exchange(state_->pending, nullptr));
  else if (state_->is_reload_pending && state_->actions.reload && state_->count == 0)
    state_->actions.reload();
  state_->is_reload_pending &= !state_->actions.reload;
}

void StopSignals::detach() noexcept {
  const std::lock_guard lock(state_->mutex);
  state_->loop = nullptr;
}

}  // namespace rtdata::app
