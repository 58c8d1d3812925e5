#include "app/stop_signals.hpp"

#include <poll.h>
#include <signal.h>
#include <sys/eventfd.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include <condition_variable>
#include <mutex>
#include <system_error>
#include <thread>

#include "loop/no_thread.hpp"

namespace rtdata::app {

struct StopSignals::State {
  sigset_t taken{};
  sigset_t mask_before{};
  int signals = -1;
  int quit = -1;
  std::thread thread;

  std::mutex mutex;
  Loop* loop = nullptr;
  Actions actions;
  const char* pending = nullptr;  // came before there was a loop
  int count = 0;

  struct Answer {
    std::mutex mutex;
    std::condition_variable is_there;
    std::optional<std::uint64_t> queued;
  };

  void run() {
    pollfd fds[2] = {{signals, POLLIN, 0}, {quit, POLLIN, 0}};
    for (;;) {
      if (::poll(fds, 2, -1) < 0) continue;
      if (fds[1].revents != 0) return;
      signalfd_siginfo info{};
      if (::read(signals, &info, sizeof info) != sizeof info) continue;
      const char* name = info.ssi_signo == SIGINT ? "SIGINT" : info.ssi_signo == SIGTERM ? "SIGTERM" : "SIGHUP";
      came(name);
    }
  }

  void came(const char* name) {
    const std::lock_guard lock(mutex);
    ++count;
    if (loop == nullptr) {
      if (count > 1) ::_exit(1);
      pending = name;
    } else if (count == 1) {
      loop->post([this, name] { actions.first(name); });
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
  ::sigemptyset(&state_->taken);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    struct sigaction now {};
    ::sigaction(signal, nullptr, &now);
    if (now.sa_handler != SIG_IGN) ::sigaddset(&state_->taken, signal);
  }
  ::pthread_sigmask(SIG_BLOCK, &state_->taken, &state_->mask_before);
  state_->signals = ::signalfd(-1, &state_->taken, SFD_CLOEXEC | SFD_NONBLOCK);
  state_->quit = ::eventfd(0, EFD_CLOEXEC);
  try {
    state_->thread = std::thread([state = state_.get()] { state->run(); });
  } catch (const std::system_error&) {
    ::close(state_->signals);
    ::close(state_->quit);
    ::pthread_sigmask(SIG_SETMASK, &state_->mask_before, nullptr);
    throw SetupError(detail::no_thread("cannot start", "the thread that waits for signals"));
  }
}

StopSignals::~StopSignals() {
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t written = ::write(state_->quit, &one, sizeof one);
  state_->thread.join();
  ::close(state_->signals);
  ::close(state_->quit);
  ::pthread_sigmask(SIG_SETMASK, &state_->mask_before, nullptr);
}

void StopSignals::attach(Loop& loop, Actions actions) {
  const std::lock_guard lock(state_->mutex);
  state_->loop = &loop;
  state_->actions = std::move(actions);
  if (state_->pending != nullptr)
    loop.post([state = state_.get(), name = state_->pending] { state->actions.first(name); });
}

void StopSignals::detach() noexcept {
  const std::lock_guard lock(state_->mutex);
  state_->loop = nullptr;
}

}  // namespace rtdata::app
