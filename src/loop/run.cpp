// Running a loop: in real time, in steps, in virtual time; and what other threads ask of it.
#include <sys/prctl.h>

#include <algorithm>
#include <exception>
#include <utility>

#include "loop/latch.hpp"
#include "loop/loop_core.hpp"
#include "loop/runtime_core.hpp"
#include "loop/tier_core.hpp"
#include "loop/virtual_threads.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::detail {

void LoopCore::post(Callback<void()> function) {
  if (!function) refuse_empty("cannot post", "loop " + config.name);
  {
    const std::lock_guard lock(posted_mutex_);
    if (!takes_posts_) return;  // the function goes when the lock is free again
    posted_.push_back(std::move(function));
  }
  wake().send();
  if (threads_ != nullptr) preempt();
}

void LoopCore::drop_posted() noexcept {
  std::vector<Callback<void()>> unrun;
  {
    const std::lock_guard lock(posted_mutex_);
    takes_posts_ = false;
    unrun.swap(posted_);
  }
  unrun.clear();  // outside the lock: captures may post
}

bool LoopCore::has_posted() noexcept {
  const std::lock_guard lock(posted_mutex_);
  return !posted_.empty();
}

void LoopCore::call_there(Callback<void()> function) {
  Latch is_done;
  std::exception_ptr thrown;
  post([&] {
    try {
      function();
    } catch (...) {
      thrown = std::current_exception();
    }
    runtime.send_now();
    is_done.set();
  });
  if (!wait_for(is_done, std::chrono::seconds{1})) {
    const std::string at = doing();
    if (runtime.hub != nullptr)
      runtime.hub->log(LogLevel::warning, "loop " + config.name,
                       "is waited for: it has not come out of " + (at.empty() ? "a callback" : at) + " for 1 s");
    while (!wait_for(is_done, std::chrono::milliseconds{100})) {
      if (!runs_elsewhere()) run_posted();  // a tier that was given up has ended meanwhile
    }
  }
  if (thrown) std::rethrow_exception(thrown);
}

void LoopCore::run_posted() {
  call_own("loop", [&] {
    collect_lanes();
    runtime.receive();
  });
  {
    const std::lock_guard lock(posted_mutex_);
    running_posted_.swap(posted_);
  }
  for (Callback<void()>& function : running_posted_) {
    CallbackTimes times;
    const MonotonicTime from = now();
    begins(nullptr);
    call_user("posted function", function);
    if (held_last_ < from)  // nothing that it called was blamed
      time_callback(times, from, now(), [] { return std::string("posted function"); });
  }
  running_posted_.clear();
}

void LoopCore::request_stop() noexcept {
  if (attached_) return;
  stop_requested_.store(true, std::memory_order_relaxed);
  wake().send();
}

void LoopCore::start_tiers() {
  for (TierCore* tier : runtime.tiers) tier->start_first();
}

void LoopCore::start_tiers_in_turn() noexcept {
  try {
    start_tiers();
  } catch (const SetupError& e) {  // not tried again in each turn
    runtime.report(this, "loop " + config.name, e.error());
  }
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
  if (attached_) {
    throw SetupError({Errc::bad_argument, "cannot run", "loop " + config.name,
                      "it is attached to the program's own loop", "run that one: uv_run(loop, UV_RUN_DEFAULT)"});
  }
  const Running running(*this, "cannot run");
  start_tiers();
  if (manual_ != nullptr) {
    begin_advancing();
    if (!is_stopping()) settle();
    while (!is_stopping() && refs_ > 0 && (next_due() || has_running_tiers())) {
      if (!advance_to(next_due().value_or(MonotonicTime::max()))) break;
    }
  } else {
    const int slack = config.timer_slack.count() > 0 ? ::prctl(PR_GET_TIMERSLACK) : -1;
    if (slack >= 0) ::prctl(PR_SET_TIMERSLACK, static_cast<unsigned long>(config.timer_slack.count()));
    if (!is_stopping()) run_due();
    while (!is_stopping()) {
      run_posted();  // libuv does not look at them when nothing else keeps the loop alive
      if (!is_stopping()) uv_run(uv_loop_, UV_RUN_DEFAULT);
      if (!has_posted()) break;
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
  if (attached_) {
    check_thread("cannot poll", "");
    check_not_ending("cannot poll");
    if (is_in_user_code()) {
      throw SetupError({Errc::busy, "cannot poll", "loop " + config.name, "this is one of its callbacks",
                        "return from the callback; what is due follows by itself"});
    }
    run_due();
    deliver_all();
    return;
  }
  const Running running(*this, "cannot poll");
  if (manual_ != nullptr) {
    begin_advancing();
    settle();
    return;
  }
  run_due();
  run_posted();
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
  begin_advancing();
  if (!is_stopping()) settle();
  for (bool is_there = false; !is_there && !is_stopping();) {
    const MonotonicTime next = std::min(next_due().value_or(MonotonicTime::max()), target);
    const bool is_last = !next_due() || *next_due() > target;
    if (!advance_to(next)) break;
    is_there = is_last && now() >= target;
  }
  // What tiers do at the very end, and what comes of it here; not for ever, when each time something does.
  constexpr int most_rounds = 100;
  for (int round = 0; round < most_rounds && has_running_tiers() && !is_stopping(); ++round) {
    threads_->wait_for_others();
    if (!wake().is_sent()) break;
    settle();
  }
  forget_stop();
}

void LoopCore::begin_advancing() noexcept { rounds_ = turns_ = 0; }

std::optional<MonotonicTime> LoopCore::next_due() const noexcept {
  if (deadlines_.top() == nullptr || deadlines_.top()->due == MonotonicTime::max()) return std::nullopt;
  return deadlines_.top()->due;
}

bool LoopCore::has_running_tiers() const noexcept { return threads_ != nullptr && threads_->has_others(); }

void LoopCore::preempt() noexcept { threads_->preempt(); }

bool LoopCore::wait_for(const Latch& latch, Duration at_most) noexcept {
  if (threads_ == nullptr) return latch.wait(at_most);
  threads_->wait(later(now(), at_most), [&] { return latch.is_set(); });
  return latch.is_set();
}

bool LoopCore::advance_to(MonotonicTime target) {
  // What brings itself on again at one instant (a timer of zero that starts itself) would keep time from going on.
  constexpr int most_turns = 1000;
  constexpr Duration turn = std::chrono::microseconds{1};
  const MonotonicTime from = now();
  if (target > from && has_running_tiers()) {
    if (!threads_->wait_for_news(target, [this] { return wake().is_sent() || is_stopping(); })) return false;
  } else if (target > from) {
    manual_->pass(target - from);
  } else if (++turns_ > most_turns) {
    manual_->pass(turn);
  }
  if (now() > from) begin_advancing();
  settle();
  return true;
}

void LoopCore::look_at_io() {
  ref();  // libuv looks at nothing when nothing keeps the loop alive, as a watch of a signal does not
  uv_run(uv_loop_, UV_RUN_NOWAIT);
  unref();
}

void LoopCore::settle() {
  // As in real time: what is due comes before deliveries, also when a handler took so long that something came due.
  Left left = Left::nothing;
  do {
    call_own("clock", [&] { runtime.look_at_clock(); });
    run_due();
    run_posted();
    look_at_io();
    left = deliver(Budget::limited);
  } while (left == Left::later && !is_stopping());
}

}  // namespace rtdata::detail
