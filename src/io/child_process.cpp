#include "io/child_process.hpp"

#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <list>
#include <mutex>
#include <thread>
#include <utility>

#include "rtdata/detail/io/descriptor.hpp"

namespace rtdata::detail {
namespace {

constexpr int patience = 2000;  // ms
constexpr const char* what = "cannot start the program";

bool open_pipe(Descriptor& read, Descriptor& write) {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) return false;
  read.set(ends[0]);
  write.set(ends[1]);
  return ::fcntl(ends[0], F_SETFL, O_NONBLOCK) == 0;
}

/// Both sides of a raw terminal.
bool open_terminal(Descriptor& master, Descriptor& slave) {
  master.set(::posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC | O_NONBLOCK));
  std::array<char, 128> name{};
  if (master.fd() < 0 || ::grantpt(master.fd()) != 0 || ::unlockpt(master.fd()) != 0 ||
      ::ptsname_r(master.fd(), name.data(), name.size()) != 0)
    return false;
  slave.set(::open(name.data(), O_RDWR | O_NOCTTY | O_CLOEXEC));
  if (slave.fd() < 0) return false;
  struct termios raw {};
  if (::tcgetattr(slave.fd(), &raw) != 0) return false;
  ::cfmakeraw(&raw);
  return ::tcsetattr(slave.fd(), TCSANOW, &raw) == 0;
}

struct Start {
  char* const* arguments;
  int terminal, input, output, errors, failed;
};

/// In the new process, which shares the memory of this one until it runs another program: only system calls.
[[noreturn]] void become(const Start& start) {
  struct sigaction usual {};
  usual.sa_handler = SIG_DFL;
  for (int number = 1; number < NSIG; ++number) ::sigaction(number, &usual, nullptr);
  ::setsid();
  ::ioctl(start.terminal, TIOCSCTTY, 0);
  const sched_param none{};
  ::sched_setscheduler(0, SCHED_OTHER, &none);
  ::setpriority(PRIO_PROCESS, 0, 0);
  cpu_set_t all;
  std::memset(&all, 0xff, sizeof all);
  ::sched_setaffinity(0, sizeof all, &all);
  if (::dup2(start.input, 0) >= 0 && ::dup2(start.output, 1) >= 0 && ::dup2(start.errors, 2) >= 0) {
    ::syscall(SYS_close_range, 3U, ~0U,
              1U << 2);  // closed on exec; with an older kernel by O_CLOEXEC of each descriptor
    sigset_t empty;
    ::sigemptyset(&empty);
    ::sigprocmask(SIG_SETMASK, &empty, nullptr);
    ::execvp(start.arguments[0], start.arguments);
  }
  const int error_number = errno;
  [[maybe_unused]] const ssize_t told = ::write(start.failed, &error_number, sizeof error_number);
  ::_exit(127);
}

/// The pages of a large program are not copied; this thread waits until the new process is another program.
[[gnu::noinline]] pid_t spawn(const Start& start) {
  const pid_t pid = ::vfork();  // a fork with the thread sanitizer: nothing may rely on the shared memory
  if (pid == 0) become(start);
  return pid;
}

/// The errno of the new process, or 0: its side of the pipe is closed when it runs another program. Another child
/// process may also hold that side, so the wait for its end has a limit.
int failure_of_start(int pipe) {
  int error_number = 0;
  const auto has_failed = [&] {
    return ::read(pipe, &error_number, sizeof error_number) == static_cast<ssize_t>(sizeof error_number);
  };
  if (has_failed()) return error_number;
  if (errno != EAGAIN) return 0;
  struct pollfd one {
    pipe, POLLIN, 0
  };
  while (::poll(&one, 1, patience) < 0 && errno == EINTR) {
  }
  return has_failed() ? error_number : 0;
}

/// Blocks. The process is not yet reaped, so that its number is not used again.
void finish(const Child& child) noexcept {
  struct pollfd ended {
    child.ended, POLLIN, 0
  };
  const auto wait = [&] {
    while (::poll(&ended, 1, patience) < 0 && errno == EINTR) {
    }
  };
  wait();
  ::kill(-child.pid, SIGKILL);  // also the processes that it has started
  wait();                       // has no effect if its disk hangs
  ::waitpid(child.pid, nullptr, WNOHANG);
  for (const int fd : {child.output, child.errors, child.terminal, child.ended})
    if (fd >= 0) ::close(fd);
}

/// `si_pid` is 0: it runs.
siginfo_t how_ended(const Child& child) noexcept {
  siginfo_t how{};
  if (::waitid(P_PID, static_cast<id_t>(child.pid), &how, WEXITED | WNOHANG | WNOWAIT) != 0) how.si_pid = 0;
  return how;
}

/// The threads that wait for the end of programs.
class Endings {
 public:
  ~Endings() {
    for (Ending& one : all_) one.thread.join();
  }
  void add(const Child& child) noexcept {
    try {
      const std::lock_guard guard(lock_);
      all_.remove_if([](Ending& one) {
        if (one.is_over) one.thread.join();
        return !one.thread.joinable();
      });
      Ending& one = all_.emplace_back();
      one.thread = std::thread([&one, child] {
        finish(child);
        one.is_over = true;
      });
    } catch (...) {  // no memory, no thread
      finish(child);
    }
  }

 private:
  struct Ending {
    std::thread thread;
    std::atomic<bool> is_over{false};
  };
  std::mutex lock_;
  std::list<Ending> all_;
};

}  // namespace

SettingMistake mistake_in_program(const std::vector<std::string>& run) {
  struct stat found {};
  if (run.empty() || run.front().find('/') == std::string::npos || ::stat(run.front().c_str(), &found) != 0) return {};
  if (S_ISDIR(found.st_mode)) return {"run", run.front() + " is a folder", "name a program"};
  if (::faccessat(AT_FDCWD, run.front().c_str(), X_OK, AT_EACCESS) == 0) return {};
  return {"run", run.front() + " must not be executed", "allow it with `chmod +x`, or name the program that reads it"};
}

Result<Child> start_child(const std::vector<std::string>& run, ChildPrints prints) {
  const bool prints_to_terminal = prints != ChildPrints::to_pipe, is_asked = prints == ChildPrints::answers;
  const auto failure = [&](int error_number) {
    return system_error(error_number, what, run.front(),
                        error_number == ENOENT
                            ? "check the first word of `run`: it must be a program, not a line of shell commands"
                            : "check `run`");
  };
  Descriptor master, slave, read_output, write_output, read_errors, write_errors, read_failed, write_failed;
  const Descriptor input(::open("/dev/null", O_RDONLY | O_CLOEXEC));
  if (input.fd() < 0 || !open_terminal(master, slave) || !open_pipe(read_errors, write_errors) ||
      !open_pipe(read_failed, write_failed))
    return failure(errno);
  if (!prints_to_terminal && !open_pipe(read_output, write_output)) return failure(errno);
  if (prints_to_terminal) {
    read_output.set(::fcntl(master.fd(), F_DUPFD_CLOEXEC, 3));
    if (read_output.fd() < 0) return failure(errno);
  }
  std::vector<char*> arguments;
  for (const std::string& argument : run) arguments.push_back(const_cast<char*>(argument.c_str()));
  arguments.push_back(nullptr);
  const Start start{arguments.data(),
                    slave.fd(),
                    is_asked ? slave.fd() : input.fd(),
                    prints_to_terminal ? slave.fd() : write_output.fd(),
                    is_asked ? STDERR_FILENO : write_errors.fd(),
                    write_failed.fd()};
  sigset_t all, before;
  ::sigfillset(&all);
  ::pthread_sigmask(SIG_SETMASK, &all, &before);  // no handler of this program runs in the new process
  const pid_t pid = spawn(start);
  const int fork_error = errno;
  ::pthread_sigmask(SIG_SETMASK, &before, nullptr);
  if (pid < 0) return failure(fork_error);
  write_failed.set(-1);
  if (const int error_number = failure_of_start(read_failed.fd()); error_number != 0) {
    ::waitpid(pid, nullptr, 0);
    return failure(error_number);
  }
  Child child{pid, static_cast<int>(::syscall(SYS_pidfd_open, pid, 0)), -1, -1, -1};
  if (child.ended < 0) {
    const int no_pidfd = errno;
    ::kill(-pid, SIGKILL);
    ::waitpid(pid, nullptr, 0);
    return failure(no_pidfd);
  }
  child.output = read_output.release();
  if (!is_asked) child.errors = read_errors.release();
  child.terminal = master.release();
  return child;
}

void end_child(const Child& child) noexcept {
  ::kill(-child.pid, SIGTERM);
  static Endings endings;
  endings.add(child);
}

bool has_succeeded(const Child& child) noexcept {
  const siginfo_t how = how_ended(child);
  return how.si_pid != 0 && how.si_code == CLD_EXITED && how.si_status == 0;
}

std::string end_of(const Child& child) {
  const siginfo_t how = how_ended(child);
  if (how.si_pid == 0) return {};
  if (how.si_code == CLD_EXITED) return "it has ended with status " + std::to_string(how.si_status);
  const char* const name = ::sigabbrev_np(how.si_status);
  return "it was ended by " + (name != nullptr ? "SIG" + std::string(name) : "signal " + std::to_string(how.si_status));
}

}  // namespace rtdata::detail
