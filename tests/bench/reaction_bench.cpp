// edge_to_output_p50: from a byte in a pipe to the byte that a handler on a tier of its own writes into another, and
// back to who wrote the first, beside a bare epoll loop on a thread that does the same.
#include <sys/epoll.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "harness.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/sensors/feed.hpp"

namespace bench {
namespace {

using namespace std::chrono_literals;

constexpr int edges = 4000;

struct Edge {
  bool level = false;
  RTDATA_FIELDS(Edge, (level))
};

struct Pipes {
  std::array<int, 2> in{}, out{};
  Pipes() {
    if (::pipe(in.data()) != 0 || ::pipe(out.data()) != 0) throw std::runtime_error("no pipe");
  }
  Pipes(const Pipes&) = delete;
  Pipes& operator=(const Pipes&) = delete;
  ~Pipes() {
    for (const int fd : {in[0], in[1], out[0], out[1]}) ::close(fd);
  }
  static void pass(int fd, char byte) {
    if (::write(fd, &byte, 1) != 1) throw std::runtime_error("cannot write");
  }
  static char take(int fd) {
    char byte = 0;
    if (::read(fd, &byte, 1) != 1) throw std::runtime_error("cannot read");
    return byte;
  }
  /// The outside world: the median of the times from an edge to the output, in us.
  double measure() const {
    settle_other_thread();
    std::vector<double> took;
    for (int i = 0; i < edges; ++i) {
      const std::int64_t begin = monotonic_ns();
      pass(in[1], static_cast<char>(i % 2));
      keep(take(out[0]));
      took.push_back(static_cast<double>(monotonic_ns() - begin) / 1000);
      const std::int64_t next = monotonic_ns() + 20'000;  // so that the loop waits when the next one comes
      while (monotonic_ns() < next) {
      }
    }
    return percentile(took, 0.5);
  }
};

double ours() {
  const Pipes pipes;
  rtdata::Loop loop;
  rtdata::Tier tier(loop, {.name = "fast"});
  rtdata::Feed<Edge> feed(tier.loop(), {.name = "edge"});
  const rtdata::FdWatch watch(tier.loop(), pipes.in[0], rtdata::FdWatch::readable,
                              [&](const rtdata::FdEvent&) { feed.publish({Pipes::take(pipes.in[0]) != 0}); });
  const auto seen = tier.loop().subscribe<Edge>(
      "edge", [&](const rtdata::Event<Edge>& event) { Pipes::pass(pipes.out[1], event->level ? 1 : 0); });
  double result = 0;
  std::thread world([&] {
    result = pipes.measure();
    loop.stop();
  });
  loop.run();
  world.join();
  return result;
}

double bare() {
  const Pipes pipes;
  std::atomic<bool> is_over{false};
  std::thread loop([&] {
    const int epoll = ::epoll_create1(EPOLL_CLOEXEC);
    epoll_event wanted{};
    wanted.events = EPOLLIN;
    ::epoll_ctl(epoll, EPOLL_CTL_ADD, pipes.in[0], &wanted);
    while (!is_over) {
      epoll_event ready{};
      if (::epoll_wait(epoll, &ready, 1, 100) == 1) Pipes::pass(pipes.out[1], Pipes::take(pipes.in[0]));
    }
    ::close(epoll);
  });
  double result = 0;
  std::thread world([&] { result = pipes.measure(); });
  world.join();
  is_over = true;
  loop.join();
  return result;
}

}  // namespace

void bench_reactions(Report& report) {
  if (!report.wants("edge_to_output_p50")) return;
  settle_thread();
  report.add(measure_pair({.name = "edge_to_output_p50", .unit = "us", .reach = 1.15}, ours, bare, 9));
}

}  // namespace bench
