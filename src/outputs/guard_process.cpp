// The guard's side: a thread for each output, which waits for orders and for the end of its loop's time.
#include <fcntl.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <list>
#include <memory>
#include <new>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <utility>

#include "data/fnv.hpp"
#include "outputs/guard_link.hpp"
#include "outputs/port.hpp"

namespace rtdata::detail {
namespace {

using SteadyClock = std::chrono::steady_clock;
constexpr Duration retry_period = std::chrono::milliseconds{100};
constexpr Duration check_period = std::chrono::seconds{1};
constexpr const char* name_of_guard = "rtdata-guard";

/// Outputs of this guard that have ended, and whose devices have not taken the safe value.
std::atomic<int> ending{0};

/// The name of a thread with such an output, by which the guard of the program's next run finds it: one with the same
/// settings has the same device. At most 15 bytes.
std::string name_of_ending(std::string_view what) {
  std::uint64_t hash = fnv1a(what);
  std::string name = "end-";
  for (int digit = 0; digit < 11; ++digit, hash /= 36) name += "0123456789abcdefghijklmnopqrstuvwxyz"[hash % 36];
  return name;
}

bool is_named(const std::filesystem::path& task, std::string_view wanted) {
  std::ifstream file(task / "comm");
  std::string name;
  return std::getline(file, name) && name == wanted;
}

/// True if the guard of an ended program still tries to set the output with these settings safe.
bool is_ending_elsewhere(const std::string& what) noexcept try {
  const std::string wanted = name_of_ending(what);
  std::error_code ignored;
  for (const auto& process : std::filesystem::directory_iterator("/proc", ignored)) {
    if (!is_named(process.path(), name_of_guard)) continue;
    for (const auto& task : std::filesystem::directory_iterator(process.path() / "task", ignored))
      if (is_named(task.path(), wanted)) return true;
  }
  return false;
} catch (const std::exception&) {  // no memory: assume none
  return false;
}

/// Converts the error for a device that another guard holds for a moment to a temporary error, like a disconnected
/// device.
Error passing(Error error) noexcept {
  if (error.code != make_error_code(Errc::busy) && error.code != make_error_code(Errc::timed_out)) return error;
  try {
    error.code = make_error_code(Errc::disconnected);
    error.why += "; the guard of its earlier output still tries to set it safe";
    error.advice = "leave that guard alone: it ends after 10 s, and this output is tried again each second";
  } catch (const std::exception&) {  // no memory: the error stays as it is
  }
  return error;
}

/// One output. Thread: its own.
class Keeper {
 public:
  Keeper(int socket, const GuardIntroduction& introduction, std::string what, GuardBeat& beat,
         const OutputGuard::Make& make)
      : socket_(socket),
        name_(introduction.name.data()),
        safe_(introduction.safe),
        what_(std::move(what)),
        beat_(beat),
        held_([this, &make] { return make(what_); }) {}

  /// Runs until the program has ended or requests the device.
  void run() noexcept {
    while (!is_over_) {
      pollfd one{socket_, POLLIN, 0};
      const std::optional<Duration> wait = time_left();
      timespec most{};
      if (wait) {
        const auto left = std::max(*wait, Duration{0}).count();
        most = {static_cast<time_t>(left / 1'000'000'000), static_cast<long>(left % 1'000'000'000)};
      }
      const int ready = ::ppoll(&one, 1, wait ? &most : nullptr, nullptr);
      beat_.seen.store(now(), std::memory_order_release);
      if (is_due() && !(is_retrying_ && ready > 0)) set_safe();
      if (ready > 0) receive();
      if (is_open_ && !is_over_ && now() >= next_check_) check();
    }
    ::close(socket_);
  }

 private:
  bool is_due() const noexcept { return is_watching() && (is_retrying_ || is_over_time()); }
  bool is_over_time() const noexcept { return now() >= beat_.until.load(std::memory_order_acquire); }
  /// True if another value than the safe one is set or may be ordered.
  bool is_watching() const noexcept { return is_open_ && (!is_safe_ || is_armed_); }
  std::optional<Duration> time_left() const noexcept {
    if (!is_open_) return {};
    const Duration until_check{next_check_ - now()};
    if (!is_watching()) return until_check;
    return std::min(until_check,
                    is_retrying_ ? retry_period : Duration{beat_.until.load(std::memory_order_acquire) - now()});
  }
  static std::int64_t now() noexcept { return SteadyClock::now().time_since_epoch().count(); }

  void set_safe() noexcept {
    const bool trips = is_over_time() && !std::exchange(has_tripped_, true);
    is_armed_ = false;
    const Result<void> done = is_safe_ ? Result<void>() : held_.put(safe_);
    is_safe_ = done.has_value();
    is_retrying_ = !is_safe_;
    if (trips) (void)send(GuardAnswer::tripped, done);
  }

  void check() noexcept {
    next_check_ = now() + check_period.count();
    const Result<void> there = held_.check();
    if (there) return;
    is_safe_ = false;
    (void)send(GuardAnswer::vanished, there);
  }

  void receive() noexcept {
    GuardOrder order;
    const ssize_t got = ::recv(socket_, &order, sizeof order, MSG_DONTWAIT);
    if (got < 0 && (errno == EAGAIN || errno == EINTR)) return;
    if (got != sizeof order) return end();
    if (order.kind == GuardOrder::arm || order.kind == GuardOrder::disarm) {
      is_armed_ = order.kind == GuardOrder::arm;
      if (is_armed_) has_tripped_ = false;
      return;
    }
    const std::optional<double> value = order.has_value != 0 ? std::optional(order.value) : std::nullopt;
    if (order.kind == GuardOrder::set && (has_tripped_ || is_retrying_) && value != safe_)
      return answer(Error{Errc::not_permitted, "cannot set the output", "", "its guard has set it safe", "arm it"});
    // Checked first: when the device is opened, it may be free, and the guard that tried may have ended.
    const bool was_ending = !is_open_ && (ending > 0 || is_ending_elsewhere(what_));
    const Result<void> done = order.kind == GuardOrder::finish && !value ? Result<void>() : held_.put(value);
    // After a failed order the device's value is unknown, so the safe value is set when the time is over.
    is_open_ = is_open_ || done.has_value();
    is_safe_ = done.has_value() ? value == safe_ : false;
    is_retrying_ = is_retrying_ && !is_safe_;
    if (order.kind == GuardOrder::finish) return finish(done);
    answer(done || !was_ending ? done : passing(done.error()));
  }
  void finish(const Result<void>& done) noexcept {
    is_over_ = true;
    if (done || !is_open_) {
      held_.give_back();
      answer(done);
      (void)send(GuardAnswer::ended, done ? done : Error{Errc::closed, "", "", done.error().why, ""});
      return;
    }
    announce_ending();  // before the program, which closes the output now, can make it again
    answer(done);
    keep_trying();
  }

  /// The program has ended.
  void end() noexcept {
    is_over_ = true;
    if (!is_open_ || is_safe_) return;
    announce_ending();
    keep_trying();
  }
  void announce_ending() const noexcept {
    ++ending;
    ::prctl(PR_SET_NAME, name_of_ending(what_).c_str());
  }
  void keep_trying() noexcept {
    const auto last = SteadyClock::now() + longest_after_end;
    for (;;) {
      const Result<void> done = held_.put(safe_);
      // Also if another process has the device: the guard of the next run may hold it.
      if (!done && SteadyClock::now() < last) {
        std::this_thread::sleep_for(retry_period);
        continue;
      }
      held_.give_back();
      --ending;
      if (!send(GuardAnswer::ended, done)) report_end(done);
      return;
    }
  }
  /// On standard error, because the program has ended.
  void report_end(const Result<void>& done) const noexcept {
    try {
      const std::string line = std::string(name_of_guard) + ": " + name_ + ": " + text_of_end(done) + "\n";
      (void)!::write(STDERR_FILENO, line.data(), line.size());
    } catch (const std::exception&) {  // no memory
    }
  }

  void answer(const Result<void>& result) const noexcept { (void)send(GuardAnswer::answered, result); }
  /// False: not read. Does not wait if the socket is full because the program does not read; the watchdog handles that.
  bool send(GuardAnswer::Kind kind, const Result<void>& result) const noexcept {
    GuardAnswer answer{.kind = kind};
    if (!result) answer.put(result.error());
    return ::send(socket_, &answer, sizeof answer, MSG_NOSIGNAL | MSG_DONTWAIT) == sizeof answer;
  }

  const int socket_;
  const std::string name_;  // "output pump"
  const double safe_;
  const std::string what_;
  GuardBeat& beat_;
  HeldActuator held_;
  std::int64_t next_check_ = 0;
  bool is_open_ = false;
  bool is_safe_ = true;
  bool is_armed_ = false;     // as far as the guard was told; it is told when the loop turns
  bool has_tripped_ = false;  // and was not armed since
  bool is_retrying_ = false;  // the device did not accept the safe value when the time was over
  bool is_over_ = false;
};

/// The socket of an output; -1: the program has ended.
int receive_introduction(int socket, GuardIntroduction& introduction, std::string& text) {
  text.resize(most_guarded_text);
  iovec parts[2]{{&introduction, sizeof introduction}, {text.data(), text.size()}};
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int))]{};
  msghdr message{};
  message.msg_iov = parts;
  message.msg_iovlen = 2;
  message.msg_control = control;
  message.msg_controllen = sizeof control;
  ssize_t got = 0;
  do {
    got = ::recvmsg(socket, &message, MSG_CMSG_CLOEXEC);
  } while (got < 0 && errno == EINTR);
  const cmsghdr* const head = got > 0 ? CMSG_FIRSTHDR(&message) : nullptr;
  if (got < static_cast<ssize_t>(sizeof introduction) || head == nullptr || introduction.slot >= most_guarded)
    return -1;
  text.resize(static_cast<std::size_t>(got) - sizeof introduction);
  int received = -1;
  std::memcpy(&received, CMSG_DATA(head), sizeof received);
  return received;
}

/// For this thread, not for threads that an Actuator makes. Without permission it runs with normal priority.
void take_priority(int priority) noexcept {
  if (priority <= 0) return;
  const sched_param parameters{.sched_priority = priority};
  (void)::sched_setscheduler(0, SCHED_FIFO | SCHED_RESET_ON_FORK, &parameters);
}

struct KeeperThread {
  std::atomic<bool> is_over{false};
  std::thread thread;
};

void serve(int socket, GuardBeat* beats, const OutputGuard::Make& make) {
  std::list<KeeperThread> threads;
  for (;;) {
    GuardIntroduction introduction;
    std::string text;
    const int output = receive_introduction(socket, introduction, text);
    if (output < 0) break;
    // Each keeps its stack until it is joined.
    threads.remove_if([](KeeperThread& one) {
      if (!one.is_over.load(std::memory_order_acquire)) return false;
      one.thread.join();
      return true;
    });
    bool is_listed = false;
    try {
      KeeperThread& one = threads.emplace_back();
      is_listed = true;
      one.thread = std::thread([=, &make, &one] {
        take_priority(introduction.priority);
        Keeper(output, introduction, text, beats[introduction.slot], make).run();
        one.is_over.store(true, std::memory_order_release);
      });
    } catch (const std::exception&) {
      if (is_listed) threads.pop_back();
      ::close(output);  // its output sees by this that it is not guarded
    }
  }
  for (KeeperThread& one : threads) one.thread.join();
}

void close_others(int kept) noexcept {
  const auto first = static_cast<unsigned>(kept);
  if (kept > 3) (void)::syscall(SYS_close_range, 3U, first - 1, 0U);
  if (::syscall(SYS_close_range, first + 1, ~0U, 0U) == 0) return;
  for (int fd = 3; fd < 1024; ++fd)  // before Linux 5.9
    if (fd != kept) ::close(fd);
}

}  // namespace

void run_guard(int socket, GuardBeat* beats, const OutputGuard::Make& make) noexcept {
  // SIGABRT is what a service manager's watchdog sends to all; abort() in an Actuator ends the guard nevertheless.
  for (const int number : {SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGABRT, SIGALRM, SIGPIPE, SIGUSR1, SIGUSR2, SIGXCPU})
    ::signal(number, SIG_IGN);
  for (const int number : {SIGSEGV, SIGBUS, SIGILL, SIGFPE}) ::signal(number, SIG_DFL);
  std::set_new_handler(nullptr);  // it continues, whatever the program does without memory
  ::setsid();
  ::prctl(PR_SET_NAME, name_of_guard);
  close_others(socket);
  if (const int nothing = ::open("/dev/null", O_RDWR | O_CLOEXEC); nothing >= 0) {
    ::dup2(nothing, STDIN_FILENO);
    ::dup2(nothing, STDOUT_FILENO);
    if (nothing > STDERR_FILENO) ::close(nothing);
  }
  try {
    serve(socket, beats, make);
  } catch (...) {
  }
  ::_exit(0);
}

}  // namespace rtdata::detail
