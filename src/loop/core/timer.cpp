#include "rtdata/loop/timer.hpp"

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata {
namespace detail {
class TimerNode final : public Node, public Deadline {
 public:
  TimerNode(LoopCore& loop, Timer::Config config, Callback<void()> callback)
      : Node(loop), config_(std::move(config)), callback_(std::move(callback)) {
    if (!callback_) refuse_empty("cannot make timer", config_.name);
    loop.deadlines.reserve_one();
  }

  void start_at(MonotonicTime at) {
    if (!is_open()) return;
    loop()->check_thread("cannot start timer", config_.name);
    due = at;
    if (is_listed()) {
      loop()->deadlines.moved(*this);
    } else {
      loop()->deadlines.insert(*this);
      loop()->ref();
    }
  }
  bool report_times(CallbackStatus& status) const override {
    status.name = config_.name;
    status.times = times_;
    return true;
  }
  std::string callback_name() const override { return config_.name; }
  void stop() {
    if (!is_open() || !is_listed()) return;
    loop()->check_thread("cannot stop timer", config_.name);
    loop()->deadlines.remove(*this);
    loop()->unref();
  }
  void fire(MonotonicTime now) override {
    stop();
    LoopCore& on = *loop();
    Call call(*this);
    on.nodes.begins(this);
    on.call_user(config_.name, [&] { callback_(); });
    on.blame.time_callback(times_, now, on.now(), [&] { return config_.name; });
  }

 private:
  void on_close() noexcept override {
    stop();
    loop()->deadlines.release_one();
  }
  void drop_callbacks() noexcept override { callback_.reset(); }
  Timer::Config config_;
  Callback<void()> callback_;
  CallbackTimes times_;
};

class TickerNode final : public Node, public RateMember {
 public:
  TickerNode(LoopCore& loop, Ticker::Config config, Callback<void(const Tick&)> callback)
      : Node(loop), RateMember(config.period), config_(std::move(config)), callback_(std::move(callback)) {
    if (config_.period < std::chrono::microseconds{1}) {
      throw SetupError({Errc::bad_argument, "cannot make ticker", config_.name,
                        "its period is " + to_string(config_.period), "use at least 1 us"});
    }
    if (!callback_) refuse_empty("cannot make ticker", config_.name);
  }

  void start() {
    if (!is_open() || is_scheduled()) return;
    loop()->check_thread("cannot start ticker", config_.name);
    index_ = 0;
    loop()->schedule().add(*this);
    loop()->ref();
  }
  void stop() {
    if (!is_open() || !is_scheduled()) return;
    loop()->check_thread("cannot stop ticker", config_.name);
    loop()->schedule().remove(*this);
    loop()->unref();
  }
  void change_period(Duration period) {
    if (period < std::chrono::microseconds{1}) {
      throw SetupError({Errc::bad_argument, "cannot change ticker", config_.name, "the period is " + to_string(period),
                        "use at least 1 us"});
    }
    loop()->check_thread("cannot change ticker", config_.name);
    if (period == this->period()) return;
    const bool was_running = is_scheduled();
    stop();
    set_period(period);
    if (was_running) start();
  }
  void tick(const Tick& tick) override {
    Tick told = tick;
    index_ += tick.missed;
    told.index = index_++;
    ++fired;
    missed += tick.missed;
    LoopCore& on = *loop();
    Call call(*this);
    on.nodes.begins(this);
    on.call_user(config_.name, [&] { callback_(told); });
  }
  Duration wanted_phase() const noexcept override { return config_.phase; }
  std::string blame_name() const override { return config_.name; }
  std::string callback_name() const override { return config_.name; }
  bool report_times(CallbackStatus& status) const override {
    status.name = config_.name;
    status.times = times;
    return true;
  }

  std::uint64_t fired = 0;
  std::uint64_t missed = 0;

 private:
  void on_close() noexcept override { stop(); }
  void drop_callbacks() noexcept override { callback_.reset(); }
  Ticker::Config config_;
  Callback<void(const Tick&)> callback_;
  std::uint64_t index_ = 0;
};

}  // namespace detail

using detail::TickerNode;
using detail::TimerNode;

Timer::Timer(Loop& loop, Callback<void()> callback) : Timer(loop, Config{}, std::move(callback)) {}
Timer::Timer(Loop& loop, Config config, Callback<void()> callback)
    : Handle(new TimerNode(loop.core(), std::move(config), std::move(callback))) {}
Timer::Timer(Loop& loop, Duration delay, Callback<void()> callback) : Timer(loop, std::move(callback)) { start(delay); }
void Timer::start(Duration delay) {
  if (is_open()) start_at(detail::later(node()->loop()->now(), std::max(delay, Duration{0})));
}
void Timer::start_at(MonotonicTime due) {
  if (is_open()) static_cast<TimerNode*>(node())->start_at(due);
}
void Timer::stop() {
  if (is_open()) static_cast<TimerNode*>(node())->stop();
}
bool Timer::is_running() const noexcept { return is_open() && static_cast<TimerNode*>(node())->is_listed(); }

Ticker::Ticker(Loop& loop, Duration period, Callback<void(const Tick&)> callback)
    : Ticker(loop, Config{.period = period}, std::move(callback)) {}
Ticker::Ticker(Loop& loop, Config config, Callback<void(const Tick&)> callback)
    : Handle(new TickerNode(loop.core(), std::move(config), std::move(callback))) {
  start();
}
void Ticker::start() {
  if (is_open()) static_cast<TickerNode*>(node())->start();
}
void Ticker::stop() {
  if (is_open()) static_cast<TickerNode*>(node())->stop();
}
void Ticker::set_period(Duration period) {
  if (is_open()) static_cast<TickerNode*>(node())->change_period(period);
}
bool Ticker::is_running() const noexcept { return is_open() && static_cast<TickerNode*>(node())->is_scheduled(); }
std::uint64_t Ticker::fired() const noexcept { return is_open() ? static_cast<TickerNode*>(node())->fired : 0; }
std::uint64_t Ticker::missed() const noexcept { return is_open() ? static_cast<TickerNode*>(node())->missed : 0; }
CallbackTimes Ticker::times() const noexcept {
  return is_open() ? static_cast<TickerNode*>(node())->times : CallbackTimes{};
}

}  // namespace rtdata
