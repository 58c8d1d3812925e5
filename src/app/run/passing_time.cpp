#include "app/run/passing_time.hpp"

#include <poll.h>

#include <algorithm>
#include <chrono>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "sinks/core/sink_node.hpp"

namespace rtdata::app {
namespace {

constexpr Duration long_step = std::chrono::hours{24 * 365};
constexpr Duration least_step = std::chrono::microseconds{1};
constexpr Duration real_step = std::chrono::milliseconds{2};  // longest delay for data from a peer

bool needs_real_time(Loop& loop) {
  const auto& recorders = loop.runtime().core().recorders;
  return std::any_of(recorders.begin(), recorders.end(), [](detail::Recorder* recorder) {
    const detail::SinkNode* sink = recorder->as_sink();
    return sink != nullptr && sink->needs_real_time();
  });
}

/// The time to the next deadline.
Duration one_step(Loop& loop) {
  detail::Deadlines& deadlines = loop.core().deadlines;
  deadlines.leave_out_idle(detail::later(loop.now(), long_step));
  const auto next = deadlines.next_due();
  if (!next) return long_step;
  const Duration until = detail::span_between(loop.now(), *next);
  return until <= Duration{0} ? least_step : std::min(until, long_step);
}

void pass_real_time(Loop& loop, Duration at_most) {
  using std::chrono::steady_clock;
  const auto before = steady_clock::now();
  const Duration wait = std::min(at_most, real_step);
  pollfd ready{uv_backend_fd(loop.core().uv.loop()), POLLIN, 0};
  const timespec limit{0, static_cast<decltype(timespec::tv_nsec)>(wait.count())};
  ::ppoll(&ready, 1, &limit, nullptr);
  loop.advance(std::min<Duration>(steady_clock::now() - before, at_most));
}

}  // namespace

void pass_time(Loop& loop, const std::function<bool()>& is_over) {
  while (!is_over()) {
    if (needs_real_time(loop)) {
      pass_real_time(loop, one_step(loop));
    } else {
      loop.advance(one_step(loop));  // a sink may begin to send at the next instant
    }
  }
}

}  // namespace rtdata::app
