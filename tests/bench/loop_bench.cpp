// tick_*, react_p50, edge_p50, sensors_10k, close_10k, sensor_memory: what the loop keeps of the kernel's timing, and
// what a sensor costs.
#include <fcntl.h>
#include <malloc.h>
#include <sys/epoll.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cmath>
#include <deque>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "bare.hpp"
#include "harness.hpp"
#include "payloads.hpp"
#include "rtdata/io/gpio.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace bench {
namespace {

// ---- ticks

constexpr int lateness_ticks = 1000;

std::vector<double> percentiles(std::vector<double> lateness) {
  return {percentile(lateness, 0.5) / 1e3, percentile(lateness, 0.99) / 1e3};
}

std::vector<double> ticker_lateness() {
  rtdata::Loop loop;
  std::vector<double> lateness;
  lateness.reserve(lateness_ticks);
  rtdata::Ticker ticker(loop, rtdata::Duration{millisecond}, [&](const rtdata::Tick& tick) {
    lateness.push_back(static_cast<double>(monotonic_ns() - tick.due.time_since_epoch().count()));
    if (lateness.size() == lateness_ticks) loop.stop();
  });
  loop.run();
  return percentiles(std::move(lateness));
}

std::vector<double> bare_lateness() {
  const BareTimer timer;
  std::vector<double> lateness;
  lateness.reserve(lateness_ticks);
  std::int64_t due = on_grid(monotonic_ns());
  timer.arm(due);
  while (lateness.size() < lateness_ticks) {
    timer.wait();
    const std::int64_t now = monotonic_ns();
    due += (now - due) / millisecond * millisecond;  // as a Ticker does, the latest tick that has come due is taken
    lateness.push_back(static_cast<double>(now - due));
    due += millisecond;
    timer.arm(due);
  }
  return percentiles(std::move(lateness));
}

void bench_lateness(Report& report) {
  if (!report.wants("tick_lateness_p50") && !report.wants("tick_lateness_p99")) return;
  const auto figures = measure_pairs({{.name = "tick_lateness_p50", .unit = "us", .reach = 1.1},
                                      {.name = "tick_lateness_p99", .unit = "us", .reach = 1.25}},
                                     ticker_lateness, bare_lateness, 9);
  for (const Figure& figure : figures) {
    if (report.wants(figure.name)) report.add(figure);
  }
}

/// CLOCK_BOOTTIME: goes at the rate of CLOCK_MONOTONIC, and nothing in the library looks at it.
std::int64_t boot_time_ns() {
  timespec time{};
  ::clock_gettime(CLOCK_BOOTTIME, &time);
  return std::int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
}

void bench_drift(Report& report) {
  if (!report.wants("tick_drift")) return;
  constexpr std::uint64_t ticks = 20'000;
  constexpr std::int64_t period = 500'000;
  rtdata::Loop loop;
  std::int64_t first_due = 0;
  std::int64_t first_seen = 0;
  std::int64_t last_due = 0;
  std::int64_t last_seen = 0;
  std::uint64_t told_missed = 0;
  rtdata::Ticker ticker(loop, rtdata::Duration{period}, [&](const rtdata::Tick& tick) {
    const std::int64_t seen = boot_time_ns();
    last_due = tick.due.time_since_epoch().count();
    last_seen = seen - (monotonic_ns() - last_due);  // the due time on the independent clock
    told_missed += tick.missed;
    if (first_due == 0) {
      first_due = last_due;
      first_seen = last_seen;
    }
    if (tick.index + 1 >= ticks) loop.stop();
  });
  loop.run();
  const std::uint64_t counted = ticker.fired() + ticker.missed() - 1;  // periods from the first tick to the last
  const auto elapsed = static_cast<std::uint64_t>(std::llround(static_cast<double>(last_seen - first_seen) / period));
  const std::int64_t drift = last_due - (first_due + static_cast<std::int64_t>(counted) * period);
  const bool is_right = counted == elapsed && told_missed == ticker.missed();
  Figure figure{.name = "tick_drift", .unit = "ns", .reach = 1};
  figure.value = static_cast<double>(drift);
  figure.ratio = drift == 0 && is_right ? 1 : 1 + std::abs(static_cast<double>(drift)) + (is_right ? 0 : 1);
  figure.note = std::to_string(counted + 1) + " ticks, " + std::to_string(ticker.missed()) + " of them missed, " +
                (is_right ? "as the independent clock counts"
                          : "the independent clock counts " + std::to_string(elapsed + 1));
  report.add(figure);
}

// ---- reaction

constexpr int messages = 800;

/// The outside world: writes the time into a pipe, every 0.3 ms or so.
class Outside {
 public:
  Outside() {
    if (::pipe2(ends_.data(), O_NONBLOCK) != 0) std::abort();
    writer_ = std::thread([this] {
      settle_other_thread();
      for (int i = 0; i < messages; ++i) {
        const timespec pause{0, 250'000 + 1000 * (i * 37 % 100)};
        ::nanosleep(&pause, nullptr);
        const std::int64_t now = monotonic_ns();
        if (::write(ends_[1], &now, sizeof now) != sizeof now) std::abort();
      }
    });
  }
  Outside(const Outside&) = delete;
  Outside& operator=(const Outside&) = delete;
  ~Outside() {
    writer_.join();
    ::close(ends_[0]);
    ::close(ends_[1]);
  }
  int fd() const { return ends_[0]; }
  /// Reads what has been written; `now` is when it was noticed.
  void take(std::int64_t now, std::vector<double>& reactions) const {
    std::int64_t written = 0;
    while (::read(ends_[0], &written, sizeof written) == sizeof written)
      reactions.push_back(static_cast<double>(now - written) / 1e3);
  }

 private:
  std::array<int, 2> ends_{};
  std::thread writer_;
};

double watch_reaction() {
  std::vector<double> reactions;
  reactions.reserve(messages);
  rtdata::Loop loop;
  const Outside outside;
  rtdata::FdWatch watch(loop, outside.fd(), rtdata::FdWatch::readable, [&](const rtdata::FdEvent&) {
    outside.take(monotonic_ns(), reactions);
    if (reactions.size() == messages) loop.stop();
  });
  loop.run();
  watch.close();
  return percentile(reactions, 0.5);
}

double epoll_reaction() {
  std::vector<double> reactions;
  reactions.reserve(messages);
  const Outside outside;
  const int epoll = ::epoll_create1(0);
  epoll_event event{};
  event.events = EPOLLIN;
  ::epoll_ctl(epoll, EPOLL_CTL_ADD, outside.fd(), &event);
  while (reactions.size() < messages) {
    if (::epoll_wait(epoll, &event, 1, -1) == 1) outside.take(monotonic_ns(), reactions);
  }
  ::close(epoll);
  return percentile(reactions, 0.5);
}

// ---- edges of a GPIO line: as many as wait are read at once, as from the kernel, and each is handed to a handler

constexpr std::size_t most_edges = 64;

/// A line whose edges are what is written into the pipe.
class PipeLine final : public rtdata::GpioRequest {
 public:
  explicit PipeLine(int fd) : fd_(fd) {}
  int value() noexcept override { return 1; }
  int set(bool) noexcept override { return EPERM; }
  int descriptor() const noexcept override { return fd_; }
  int read(std::span<rtdata::GpioRawEdge> edges) noexcept override {
    std::array<std::int64_t, most_edges> written;
    const ssize_t got = ::read(fd_, written.data(), sizeof written[0] * std::min(written.size(), edges.size()));
    if (got <= 0) return errno == EAGAIN ? 0 : -errno;
    const std::size_t count = static_cast<std::size_t>(got) / sizeof written[0];
    for (std::size_t i = 0; i < count; ++i) edges[i] = {true, written[i], ++number_};
    return static_cast<int>(count);
  }
  bool is_there() noexcept override { return true; }

 private:
  const int fd_;
  std::uint32_t number_ = 0;
};

class PipeChip final : public rtdata::GpioBackend {
 public:
  explicit PipeChip(int fd) : fd_(fd) {}
  std::size_t kept_edges() const noexcept override { return 0; }
  bool numbers_edges() const noexcept override { return true; }
  bool debounces() const noexcept override { return true; }
  std::vector<rtdata::GpioChipInfo> chips() override { return {{.path = "/dev/gpiochip0", .lines = {{}}}}; }
  std::unique_ptr<rtdata::GpioRequest> take_input(const std::string&, unsigned, const rtdata::GpioInput&, bool,
                                                  int&) override {
    return std::make_unique<PipeLine>(fd_);
  }
  std::unique_ptr<rtdata::GpioRequest> take_output(const std::string&, unsigned, const rtdata::GpioOutput&,
                                                   int& error_number) override {
    error_number = EPERM;
    return nullptr;
  }

 private:
  const int fd_;
};

double edge_reaction() {
  std::vector<double> reactions;
  reactions.reserve(messages);
  rtdata::Loop loop;
  std::optional<rtdata::GpioEdges> edges;
  std::optional<Outside> outside(std::in_place);
  edges.emplace(
      loop, rtdata::GpioInput{.line = 0},
      [&](const rtdata::GpioEdge& edge) {
        reactions.push_back(static_cast<double>(monotonic_ns() - edge.time.time_since_epoch().count()) / 1e3);
        if (reactions.size() == messages) loop.stop();
      },
      std::make_shared<PipeChip>(outside->fd()));
  loop.run();
  edges.reset();
  return percentile(reactions, 0.5);
}

double epoll_edge_reaction() {
  std::vector<double> reactions;
  reactions.reserve(messages);
  const Outside outside;
  const int epoll = ::epoll_create1(0);
  epoll_event event{};
  event.events = EPOLLIN;
  ::epoll_ctl(epoll, EPOLL_CTL_ADD, outside.fd(), &event);
  while (reactions.size() < messages) {
    if (::epoll_wait(epoll, &event, 1, -1) != 1) continue;
    std::array<std::int64_t, most_edges> written;
    const ssize_t got = ::read(outside.fd(), written.data(), sizeof written);
    for (std::size_t i = 0; i < static_cast<std::size_t>(std::max<ssize_t>(got, 0)) / sizeof written[0]; ++i)
      reactions.push_back(static_cast<double>(monotonic_ns() - written[i]) / 1e3);
  }
  ::close(epoll);
  return percentile(reactions, 0.5);
}

// ---- many sensors

constexpr std::size_t sensor_count = 10'000;
constexpr std::size_t phases = 10;
constexpr std::int64_t sensor_period = 10 * millisecond;
constexpr std::int64_t sensors_time = 400 * millisecond;

class ManySensors {
 public:
  ManySensors() {
    for (std::size_t i = 0; i < sensor_count; ++i) {
      sensors_.emplace_back(
          loop_,
          rtdata::SensorConfig{.name = "s" + std::to_string(i),
                               .topic = "many",
                               .rate = rtdata::Rate::from_period(rtdata::Duration{sensor_period}),
                               .phase = rtdata::Duration{static_cast<std::int64_t>(i % phases) * millisecond}},
          [this] { return Single{++value_}; });
    }
  }
  double measure() {
    const std::uint64_t before = published();
    const std::int64_t begin = thread_cpu_ns();
    loop_.run_for(rtdata::Duration{sensors_time});
    const std::int64_t end = thread_cpu_ns();
    return static_cast<double>(end - begin) / static_cast<double>(published() - before);
  }

 private:
  std::uint64_t published() const {
    std::uint64_t sum = 0;
    for (const auto& sensor : sensors_) sum += sensor.counts().published;
    return sum;
  }
  rtdata::Loop loop_;
  std::vector<rtdata::Sensor<Single>> sensors_;
  double value_ = 0;
};

/// The same rate groups: each sample is a call through a function pointer, which counts and numbers it.
class ManyCalls {
 public:
  ManyCalls() {
    for (std::size_t i = 0; i < sensor_count; ++i) {
      auto& state = states_.emplace_back(std::make_unique<State>());
      groups_[i % phases].push_back({[](State& s, std::int64_t time) {
                                       s.time = time;
                                       ++s.sequence;
                                       s.value += 1;
                                     },
                                     state.get()});
    }
  }
  double measure() {
    std::uint64_t samples = 0;
    const BareTimer timer;
    const std::int64_t begin = thread_cpu_ns();
    std::int64_t due = on_grid(monotonic_ns());
    const std::int64_t end = due + sensors_time;
    timer.arm(due);
    for (std::size_t phase = 0; due < end; phase = (phase + 1) % phases) {
      timer.wait();
      while (due <= monotonic_ns()) {  // none is left out, late or not
        for (const Call& call : groups_[phase]) call.function(*call.state, due);
        samples += groups_[phase].size();
        due += millisecond;
        if (due > monotonic_ns()) break;
        phase = (phase + 1) % phases;
      }
      timer.arm(due);
    }
    return static_cast<double>(thread_cpu_ns() - begin) / static_cast<double>(samples);
  }

 private:
  struct State {
    std::int64_t time = 0;
    std::uint64_t sequence = 0;
    double value = 0;
    std::array<std::byte, 40> rest{};
  };
  struct Call {
    void (*function)(State&, std::int64_t);
    State* state;
  };
  std::vector<std::unique_ptr<State>> states_;
  std::array<std::vector<Call>, phases> groups_;
};

// ---- closing many sensors

/// Loops, each with as many sensors in one rate group, which have begun. Returns the ns that one sensor takes to be
/// closed and destroyed, in the order in which they were made.
double closing(std::size_t loops, std::size_t sensors_each) {
  struct One {
    rtdata::Loop loop;
    std::vector<rtdata::Sensor<Single>> sensors;
  };
  std::deque<One> all;
  for (std::size_t i = 0; i < loops; ++i) {
    One& one = all.emplace_back();
    for (std::size_t n = 0; n < sensors_each; ++n) {
      one.sensors.emplace_back(
          one.loop,
          rtdata::SensorConfig{.name = "s" + std::to_string(n), .topic = "many", .rate = rtdata::Rate::hertz(1)},
          [] { return Single{}; });
    }
    one.loop.poll();
  }
  const std::int64_t begin = thread_cpu_ns();
  for (One& one : all) {
    for (auto& sensor : one.sensors) sensor.close();
  }
  return static_cast<double>(thread_cpu_ns() - begin) / static_cast<double>(loops * sensors_each);
}

void bench_closing(Report& report) {
  if (!report.wants("close_10k")) return;
  // Ten times as many objects either way, so that the caches hold as little of them.
  report.add(measure_pair(
      {.name = "close_10k", .unit = "ns/sensor", .reach = 1.2}, [] { return closing(1, sensor_count); },
      [] { return closing(10, sensor_count / 10); }, 9));
}

void bench_sensor_memory(Report& report) {
  if (!report.wants("sensor_memory")) return;
  const auto used = [] {
    const auto info = ::mallinfo2();
    return info.uordblks + info.hblkhd;
  };
  rtdata::Loop loop;
  const auto topic = loop.topic<Single>("many");
  keep(topic);
  const std::size_t before = used();
  std::deque<rtdata::Sensor<Single>> sensors;
  for (std::size_t i = 0; i < sensor_count; ++i) {
    sensors.emplace_back(
        loop,
        rtdata::SensorConfig{.name = "sensor" + std::to_string(i), .topic = "many", .rate = rtdata::Rate::hertz(1)},
        [] { return Single{}; });
  }
  Figure figure{.name = "sensor_memory", .unit = "bytes", .reach = 1};
  figure.value = static_cast<double>(used() - before) / sensor_count;
  figure.limit = 512;
  figure.ratio = figure.value / figure.limit;
  report.add(figure);
}

}  // namespace

void bench_loop(Report& report) {
  bench_sensor_memory(report);
  if (report.wants("sensors_10k")) {
    ManySensors sensors;
    ManyCalls calls;
    report.add(measure_pair(
        {.name = "sensors_10k", .unit = "ns/sample", .reach = 2}, [&] { return sensors.measure(); },
        [&] { return calls.measure(); }, 9));
  }
  if (report.wants("react_p50"))
    report.add(measure_pair({.name = "react_p50", .unit = "us", .reach = 1.1}, watch_reaction, epoll_reaction, 9));
  if (report.wants("edge_p50"))
    report.add(measure_pair({.name = "edge_p50", .unit = "us", .reach = 1.15}, edge_reaction, epoll_edge_reaction, 9));
  bench_closing(report);
  bench_lateness(report);
  bench_drift(report);
}

}  // namespace bench
