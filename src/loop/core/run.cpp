// Running a loop: in real time, in steps, in virtual time; and calls that other threads wait for.
#include <sys/prctl.h>

#include <algorithm>
#include <atomic>
#include <exception>
#include <memory>
#include <optional>
#include <utility>

#include "loop/core/latch.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/core/virtual_threads.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::detail {

/// Shared with the loop, which may reach or run the call after the caller has stopped waiting.
struct LoopCore::CallThere {
  enum class State { waits, runs, done, given_up };
  std::atomic<State> state{State::waits};
  Latch is_done;
  Callback<void()> function;
  std::exception_ptr thrown;

  bool become(State next, State before) noexcept { return state.compare_exchange_strong(before, next); }
};

LoopCore::Called LoopCore::wait_for(CallThere& call, Duration at_most, Begun begun) {
  using State = CallThere::State;
  // The waiting loop does not hang, so its outputs keep their values meanwhile, for a limited time.
  constexpr Duration between_beats = std::chrono::milliseconds{10};
  constexpr Duration longest_held = std::chrono::seconds{5};
  constexpr Duration report_after = std::chrono::seconds{1};
  LoopCore* const waiting = runtime.main().own_loop;
  const bool holds = waiting != nullptr && !waiting->is_run_by_another_thread();
  const MonotonicTime began = now();
  bool is_reported = false;
  while (!wait_for(call.is_done, between_beats)) {
    const Duration waited = now() - began;
    if (holds && waited < longest_held) waiting->lanes.beat();
    if (!runs_elsewhere()) take_sent(MonotonicTime::max());  // an abandoned tier has ended meanwhile
    if (waited >= report_after && !std::exchange(is_reported, true))
      runtime.main().log(LogLevel::warning, "loop " + config.name, "is waited for: " + where() + " for 1 s");
    if (waited < at_most) continue;
    if (begun == Begun::is_awaited && call.state.load() != State::waits) continue;
    note_standing(began);
    if (call.become(State::given_up, State::waits)) {
      call.function = {};
      return Called::not_begun;
    }
    if (begun == Begun::is_given_up && call.become(State::given_up, State::runs)) return Called::not_ended;
    note_turning();
  }
  return Called::done;
}

LoopCore::Called LoopCore::call_there_within(Duration at_most, Callback<void()> function, Begun begun) {
  using State = CallThere::State;
  if (const Duration::rep since = stands_since_.load(std::memory_order_acquire); since != never)
    at_most -= now() - MonotonicTime{Duration{since}};
  if (at_most <= Duration{0}) return Called::not_begun;
  const auto call = std::make_shared<CallThere>();
  call->function = std::move(function);
  post([this, call] {
    if (!call->become(State::runs, State::waits)) return note_turning();
    try {
      call->function();
    } catch (...) {
      call->thrown = std::current_exception();
    }
    runtime.send_now();
    if (!call->become(State::done, State::runs)) return note_turning();
    call->is_done.set();
  });
  const Called called = wait_for(*call, at_most, begun);
  if (called == Called::done && call->thrown) std::rethrow_exception(std::exchange(call->thrown, nullptr));
  return called;
}

void LoopCore::call_there(Callback<void()> function, Begun begun) {
  constexpr Duration patience = std::chrono::seconds{1};
  const Called called = call_there_within(patience, std::move(function), begun);
  if (called == Called::done) return;
  throw SetupError({Errc::not_turning, "cannot be reached", "loop " + config.name,
                    where() + " for " + to_string(patience),
                    called == Called::not_begun
                        ? "nothing was done; find what blocks in its sensors and handlers"
                        : "the loop has begun to do what was asked, and may still finish; find what blocks there"});
}

std::string LoopCore::where() const {
  const std::string at = nodes.doing();
  return "it has not returned from " + (at.empty() ? "a callback" : at);
}

void LoopCore::request_stop() noexcept {
  if (is_attached()) return;
  stop_requested_.store(true, std::memory_order_relaxed);
  uv.wake().send();
}

LoopCore::Running::Running(LoopCore& core, const char* what) : core_(core) {
  core.check_thread(what, "");
  core.check_not_ending(what);
  if (core.is_in_user_code()) {
    throw SetupError({Errc::busy, what, "loop " + core.config.name, "this is one of its callbacks",
                      "return from the callback; use stop(), post() or drain() there"});
  }
  core.is_running_ = true;
  core.thread_.store(this_thread(), std::memory_order_relaxed);
}

LoopCore::Running::~Running() {
  core_.is_running_ = false;
  core_.thread_.store(nullptr, std::memory_order_relaxed);
}

void LoopCore::run() {
  if (is_attached()) {
    throw SetupError({Errc::bad_argument, "cannot run", "loop " + config.name,
                      "it is attached to the program's own loop", "run that one: uv_run(loop, UV_RUN_DEFAULT)"});
  }
  const Running running(*this, "cannot run");
  runtime.start_tiers();
  if (manual_ != nullptr) {
    begin_instant();
    if (!is_stopping()) settle();
    while (!is_stopping() && refs_ > 0 && (deadlines.next_due() || has_running_tiers())) {
      if (!has_running_tiers()) deadlines.leave_out_idle(MonotonicTime::max());
      if (!advance_to(deadlines.next_due().value_or(MonotonicTime::max()))) break;
    }
  } else {
    const int slack = config.timer_slack.count() > 0 ? ::prctl(PR_GET_TIMERSLACK) : -1;
    if (slack >= 0) ::prctl(PR_SET_TIMERSLACK, static_cast<unsigned long>(config.timer_slack.count()));
    if (!is_stopping()) run_due();
    while (!is_stopping()) {
      take_sent(end_of_budget());  // libuv ignores them if nothing else keeps the loop alive
      if (!is_stopping()) uv_run(uv.loop(), UV_RUN_DEFAULT);
      if (!posts.has_some()) break;
    }
    if (slack >= 0) ::prctl(PR_SET_TIMERSLACK, static_cast<unsigned long>(slack));
  }
  forget_stop();
}

void LoopCore::run_for(Duration duration) {
  if (manual_ != nullptr) {
    advance(duration);
    return;
  }
  const MonotonicTime end = later(now(), duration);
  bool is_over = false;
  Timer timer(face, [this, &is_over] {
    is_over = true;
    request_stop();
  });
  timer.start_at(end);
  run();
  if (!is_over) return;  // stopped before
  const Running running(*this, "cannot run");
  run_due();
  deliver_all();
}

void LoopCore::poll() {
  if (is_attached()) {
    check_thread("cannot poll", "");
    check_not_ending("cannot poll");
    if (is_in_user_code()) {
      throw SetupError({Errc::busy, "cannot poll", "loop " + config.name, "this is one of its callbacks",
                        "return from the callback; due work follows by itself"});
    }
    run_due();
    deliver_all();
    return;
  }
  const Running running(*this, "cannot poll");
  if (manual_ != nullptr) {
    begin_instant();
    settle();
    return;
  }
  run_due();
  take_sent(MonotonicTime::max());
  look_at_io();
  deliver_all();
}

void LoopCore::advance(Duration duration) {
  if (manual_ == nullptr) {
    throw SetupError({Errc::bad_argument, "cannot advance", "loop " + config.name, "it runs in real time",
                      "make it with rtdata::Loop::Manual{}"});
  }
  const Running running(*this, "cannot advance");
  const MonotonicTime target = later(now(), duration);
  begin_instant();
  if (!is_stopping()) settle();
  for (bool is_there = false; !is_there && !is_stopping();) {
    if (!has_running_tiers()) deadlines.leave_out_idle(target);  // events from tiers may come before any deadline
    const std::optional<MonotonicTime> next = deadlines.next_due();
    const bool is_last = !next || *next > target;
    if (!advance_to(is_last ? target : *next)) break;
    is_there = is_last && now() >= target;
  }
  // Processes the tiers' work at the very end and its results here, for a limited number of rounds.
  constexpr int most_rounds = 100;
  for (int round = 0; round < most_rounds && has_running_tiers() && !is_stopping(); ++round) {
    threads_->wait_for_others();
    if (!uv.wake().is_sent()) break;
    settle();
  }
  forget_stop();
}

void LoopCore::begin_instant() noexcept {
  deliveries.begin_instant();
  turns_ = 0;
}

bool LoopCore::has_running_tiers() const noexcept { return threads_ != nullptr && threads_->has_others(); }

bool LoopCore::wait_for(const Latch& latch, Duration at_most) noexcept {
  if (threads_ == nullptr) return latch.wait(at_most);
  threads_->wait(later(now(), at_most), [&] { return latch.is_set(); });
  return latch.is_set();
}

bool LoopCore::advance_to(MonotonicTime target) {
  // A chain at one instant (a zero timer that restarts itself) would stop time for ever.
  constexpr int most_turns = 1000;
  constexpr Duration turn = std::chrono::microseconds{1};
  const MonotonicTime from = now();
  if (target > from && has_running_tiers()) {
    if (!threads_->wait_for_news(target, [this] { return uv.wake().is_sent() || is_stopping(); })) return false;
  } else if (target > from) {
    manual_->pass(target - from);
  } else if (++turns_ > most_turns) {
    manual_->pass(turn);
  }
  if (now() > from) begin_instant();
  settle();
  return true;
}

void LoopCore::look_at_io() {
  // In virtual time there is no kernel timer, and sent data is found without the descriptor, so the expensive system
  // call is skipped.
  if (manual_ != nullptr && !uv.is_lent()) return turn_ended();
  ref();  // libuv processes nothing if nothing keeps the loop alive, and a signal watch does not
  uv_run(uv.loop(), UV_RUN_NOWAIT);
  unref();
}

void LoopCore::settle() {
  // As in real time, deadlines come before deliveries, also when one came due while a handler ran.
  bool is_some_left = false;
  do {
    call_own("clock", [&] { runtime.clock_log.look(); });
    run_due();
    is_some_left = take_sent(end_of_budget());
    look_at_io();  // delivers at the end of the turn
    if (deliveries.is_interrupted()) is_some_left = true;
  } while (is_some_left && !is_stopping());
}

}  // namespace rtdata::detail
