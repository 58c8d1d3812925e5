#include <sched.h>
#include <sys/epoll.h>
#include <sys/prctl.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include <thread>

#include "app/bench/bench_measure.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::app {
namespace {

std::size_t room_for(Duration period, Duration duration) { return static_cast<std::size_t>(duration / period) + 1000; }

}  // namespace

TierMeasurement measure_tier(Duration period, Duration duration, std::optional<int> cpu) {
  Loop loop;
  loop.runtime().on_log([](const LogRecord&) {});  // the warnings are printed at the end
  Tier::Config config{.name = "bench", .policy = SchedulingPolicy::fifo, .priority = 80};
  if (cpu) config.cpus = {*cpu};
  Tier tier(loop, config);
  TierMeasurement result;
  Ticks& ticks = result.ticks;
  ticks.lateness.resize(room_for(period, duration));  // touched
  std::size_t count = 0;
  Ticker ticker(tier.loop(), period, [&](const Tick& tick) {
    if (count < ticks.lateness.size()) ticks.lateness[count++] = tick.lateness().count();
    ticks.missed += tick.missed;
  });
  loop.run_for(duration);
  result.scheduling = tier.scheduling();
  result.warnings = tier.warnings();
  tier.stop();
  ticks.lateness.resize(count);
  return result;
}

Ticks measure_bare_timer(Duration period, Duration duration, Scheduling scheduling, std::optional<int> cpu) {
  Ticks ticks;
  ticks.lateness.resize(room_for(period, duration));
  std::size_t count = 0;
  std::thread thread([&] {
    if (cpu) {
      cpu_set_t set;
      CPU_ZERO(&set);
      CPU_SET(static_cast<std::size_t>(*cpu), &set);
      ::sched_setaffinity(0, sizeof set, &set);
    }
    ::prctl(PR_SET_TIMERSLACK, 1UL);
    static_cast<void>(set_scheduling(scheduling));
    const int timer = ::timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
    const int poller = ::epoll_create1(EPOLL_CLOEXEC);
    epoll_event event{};
    event.events = EPOLLIN;
    ::epoll_ctl(poller, EPOLL_CTL_ADD, timer, &event);
    SystemClock clock;
    MonotonicTime due = clock.monotonic() + period;
    const MonotonicTime end = due + duration;
    while (due < end && count < ticks.lateness.size()) {
      const std::int64_t at = due.time_since_epoch().count();
      itimerspec spec{};
      spec.it_value = {at / 1'000'000'000, static_cast<long>(at % 1'000'000'000)};
      ::timerfd_settime(timer, TFD_TIMER_ABSTIME, &spec, nullptr);
      if (::epoll_wait(poller, &event, 1, 1000) != 1) continue;
      std::uint64_t expired = 0;
      [[maybe_unused]] const ssize_t size = ::read(timer, &expired, sizeof expired);
      const MonotonicTime now = clock.monotonic();
      const auto behind = (now - due) / period;  // counted as the tiers count it
      ticks.missed += static_cast<std::uint64_t>(behind);
      due += behind * period;
      ticks.lateness[count++] = (now - due).count();
      due += period;
    }
    ::close(poller);
    ::close(timer);
  });
  thread.join();
  ticks.lateness.resize(count);
  return ticks;
}

}  // namespace rtdata::app
