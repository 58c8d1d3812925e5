#include <signal.h>
#include <time.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cstring>

#include "app/core/configuration_commands.hpp"
#include "app/core/no_memory.hpp"
#include "app/run/log.hpp"

namespace rtdata::app {
namespace {

constexpr std::array fatal{SIGSEGV, SIGBUS, SIGILL, SIGFPE, SIGABRT, SIGSYS, SIGXCPU, SIGXFSZ};
// A signal handler can only use globals.
std::atomic<const WriterCounts*> counts_of_log{nullptr};
std::array<struct sigaction, fatal.size()> before;
alignas(16) std::array<char, 64 * 1024> handler_stack;

/// A line without heap memory: text that does not fit is cut.
struct Line {
  std::array<char, 160> text{};
  std::size_t size = 0;
  void add(const char* more) noexcept {
    while (*more != '\0' && size < text.size()) text[size++] = *more++;
  }
  void add(std::int64_t number, int digits) noexcept {
    std::array<char, 24> reversed{};
    int count = 0;
    for (; number > 0 || count < digits; number /= 10)
      reversed[static_cast<std::size_t>(count++)] = static_cast<char>('0' + number % 10);
    while (count > 0 && size < text.size()) text[size++] = reversed[static_cast<std::size_t>(--count)];
  }
};

void add_time(Line& line) noexcept {
  timespec now{};
  ::clock_gettime(CLOCK_REALTIME, &now);
  const std::int64_t second = now.tv_sec % 86400;
  const std::chrono::year_month_day day{std::chrono::sys_days{std::chrono::days{now.tv_sec / 86400}}};
  line.add(static_cast<int>(day.year()), 4);
  line.add("-");
  line.add(static_cast<unsigned>(day.month()), 2);
  line.add("-");
  line.add(static_cast<unsigned>(day.day()), 2);
  line.add("T");
  line.add(second / 3600, 2);
  line.add(":");
  line.add(second / 60 % 60, 2);
  line.add(":");
  line.add(second % 60, 2);
  line.add(".");
  line.add(now.tv_nsec / 1000, 6);
  line.add("Z");
}

/// Adds a line once, after the lines already written.
template <class AddText>
void write_last_line(const AddText& add_text) noexcept {
  const WriterCounts* const counts = counts_of_log.exchange(nullptr);
  if (counts == nullptr) return;
  for (int i = 0; i < 500 && !counts->is_idle(); ++i) {
    const timespec pause{0, 1'000'000};
    ::nanosleep(&pause, nullptr);
  }
  Line line;
  add_time(line);
  line.add(" error program: ");
  add_text(line);
  line.add("\n");
  write_fully(counts->fd.load(), line.text.data(), line.size);
}

extern "C" void on_fatal_signal(int signal) {
  const int saved_errno = errno;
  write_last_line([signal](Line& line) {
    line.add("fatal signal ");
    line.add(signal, 1);
    line.add(" (SIG");
    line.add(::sigabbrev_np(signal));
    line.add(")");
  });
  for (std::size_t i = 0; i < fatal.size(); ++i) {
    if (fatal[i] == signal) ::sigaction(signal, &before[i], nullptr);
  }
  errno = saved_errno;
  ::raise(signal);  // is delivered when this handler has returned
}

}  // namespace

void end_without_memory() noexcept {
  static std::atomic_flag is_ending = ATOMIC_FLAG_INIT;
  while (is_ending.test_and_set()) ::pause();  // another thread is ending the program already
  constexpr const char* what = "there is no memory: the program ends; free some, or raise its limit";
  Line line;
  line.add("rtdata: fatal: ");
  line.add(what);
  line.add("\n");
  write_fully(STDERR_FILENO, line.text.data(), line.size);
  write_last_line([](Line& last) { last.add(what); });
  ::_exit(exit_other);
}

FatalSignals::FatalSignals(const Log& log) {
  counts_of_log.store(&log.counts());
  stack_t stack{};
  stack.ss_sp = handler_stack.data();
  stack.ss_size = handler_stack.size();
  ::sigaltstack(&stack, nullptr);
  struct sigaction action {};
  action.sa_handler = on_fatal_signal;
  action.sa_flags = SA_ONSTACK;
  ::sigfillset(&action.sa_mask);
  for (std::size_t i = 0; i < fatal.size(); ++i) ::sigaction(fatal[i], &action, &before[i]);
}

FatalSignals::~FatalSignals() {
  for (std::size_t i = 0; i < fatal.size(); ++i) ::sigaction(fatal[i], &before[i], nullptr);
  stack_t none{};
  none.ss_flags = SS_DISABLE;
  ::sigaltstack(&none, nullptr);
  counts_of_log.store(nullptr);
}

}  // namespace rtdata::app
