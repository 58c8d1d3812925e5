// Orderly shutdown: stops the schedules, lets running reads finish, delivers, then closes the sinks.
#include <algorithm>
#include <memory>
#include <utility>
#include <vector>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/final_account.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/tier_core.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata {
namespace {

constexpr Duration try_again_after = std::chrono::milliseconds{2};

class Drain : public std::enable_shared_from_this<Drain> {
 public:
  Drain(Loop& loop, Duration deadline, Callback<void(std::uint64_t)> done)
      : loop_(loop),
        runtime_(loop.core().runtime),
        deadline_(detail::later(loop.now(), deadline)),
        done_(std::move(done)) {}

  /// Not within a callback of a deadline or a delivery, whose tick is not fully counted.
  void begin() {
    if (loop_.core().is_in_callback()) {
      loop_.post([self = shared_from_this()] { self->begin(); });
      return;
    }
    runtime_.unknown_end.clear();
    // Leaves time for storing, whatever hangs.
    reads_end_ = detail::later(loop_.now(), std::max(detail::span_between(loop_.now(), deadline_), Duration{0}) / 2);
    run_posted();
    loop_.core().run_due();
    for_each_sensor([&](detail::SensorEntry& sensor) { sensor.stop_schedule(loop_.core().deadlines.handled_until()); });
    drain_tiers();
  }

 private:
  /// Functions posted before the end belong to the run, even after `stop`. Leaves time for storing.
  void run_posted() {
    const Duration left = std::max(detail::span_between(loop_.now(), deadline_), Duration{0});
    const std::uint64_t count = loop_.core().posts.run_all(detail::later(loop_.now(), left / 2));
    if (count == 0) return;
    runtime_.report(&loop_.core(), "loop " + loop_.core().config.name,
                    {Errc::timed_out, std::to_string(count) + " posted functions did not run before the end", "",
                     "they took too long, or there were too many", "post less, or close with a later deadline"});
  }
  /// For the present sensors. Closing a device may close or destroy any of them.
  template <class Function>
  void for_each_sensor(const Function& function) {
    const auto sensors = runtime_.sensors.all();
    for (detail::SensorEntry* sensor : sensors) sensor->retain();
    for (detail::SensorEntry* sensor : sensors) {
      if (sensor->is_open()) function(*sensor);
      sensor->release();
    }
  }

  template <class T>
  static std::vector<T> copy(const std::vector<T>& list) {
    return list;
  }

  /// Tiers first, because this loop's sinks record what they still send.
  void drain_tiers() {
    if (runtime_.tiers.empty()) return wait_for_reads();
    // Leaves time for the sinks, and for a tier to report a read that it gives up.
    const Duration share = std::max(detail::span_between(loop_.now(), deadline_), Duration{0}) / 2;
    timer_ = Timer(loop_, share, [self = shared_from_this()] { self->give_up_tiers(); });
    draining_ = runtime_.tiers;
    for (detail::TierCore* tier : copy(runtime_.tiers)) {
      if (!is_there(tier)) {  // draining a stopped tier runs handlers here, which may destroy another tier
        std::erase(draining_, tier);
        continue;
      }
      tier->drain(share / 4 * 3, [self = shared_from_this(), tier] {
        std::erase(self->draining_, tier);
        if (self->draining_.empty()) self->tiers_done();
      });
    }
    if (draining_.empty()) tiers_done();
  }

  bool is_there(const detail::TierCore* tier) const {
    return std::find(runtime_.tiers.begin(), runtime_.tiers.end(), tier) != runtime_.tiers.end();
  }

  void tiers_done() {
    if (!are_tiers_waited_for_) return;
    are_tiers_waited_for_ = false;
    runtime_.receive();
    timer_ = Timer();
    wait_for_reads();
  }

  void give_up_tiers() {
    const auto self = shared_from_this();
    runtime_.receive();
    std::vector<std::pair<std::string, Error>> errors;  // reported at the end, because a report may run user code
    for (detail::TierCore* tier : copy(draining_)) {
      if (!is_there(tier)) continue;
      if (!tier->is_running()) {  // the tier was stopped meanwhile, and is drained here
        tier->finish_drains();
        continue;
      }
      tier->give_up();
      runtime_.unknown_end += (runtime_.unknown_end.empty() ? "" : "; ") + tier->unknown();
      errors.push_back({"tier " + tier->config.name,
                        {Errc::timed_out, "did not stop in time", "", "it has not returned from " + tier->where(),
                         "check what blocks there"}});
    }
    for (const auto& [name, error] : errors) runtime_.report(&loop_.core(), name, error);
    tiers_done();
  }

  /// Called by a timer; without memory it tries again.
  void go_on_waiting() {
    try {
      wait_for_reads();
    } catch (...) {
      timer_.start(try_again_after);
      throw;  // the timer's call reports it
    }
  }

  /// Throws with nothing begun.
  void wait_for_reads() {
    bool reading = false;
    for (const detail::SensorEntry* sensor : runtime_.sensors.all()) reading = reading || sensor->is_reading();
    if (reading && loop_.now() < reads_end_) {
      if (!timer_) timer_ = Timer(loop_, [self = shared_from_this()] { self->go_on_waiting(); });
      timer_.start(try_again_after);
      return;
    }
    loop_.core().deliver_all();  // what stopping would cancel
    for_each_sensor([](detail::SensorEntry& sensor) { sensor.stop(); });
    const auto recorders = copy(runtime_.recorders);
    std::vector<Callback<void(std::uint64_t)>> done;
    for (std::size_t i = 0; i < recorders.size(); ++i)
      done.emplace_back([self = shared_from_this()](std::uint64_t lost) { self->one_done(lost); });
    runtime_.reports.flush(detail::Reports::Repeated::all);
    detail::publish_final_account(loop_.core());
    loop_.core().call_own("clock", [&] { runtime_.clock_log.look("end"); });
    pending_ = recorders.size() + 1;
    for (detail::Recorder* recorder : recorders) {
      const auto& left = runtime_.recorders;  // a report of one may have closed another
      if (std::find(left.begin(), left.end(), recorder) == left.end()) {
        one_done(0);
        continue;
      }
      recorder->drain(deadline_, std::move(done.back()));
      done.pop_back();
    }
    one_done(0);
  }

  void one_done(std::uint64_t lost) {
    lost_ += lost;
    if (--pending_ != 0) return;
    timer_.close();  // its callback holds this object
    loop_.core().call_user("handler of drain", [&] { done_(lost_); });
  }

  Loop& loop_;
  detail::RuntimeCore& runtime_;
  MonotonicTime deadline_;
  MonotonicTime reads_end_{};
  Callback<void(std::uint64_t)> done_;
  Timer timer_;
  std::vector<detail::TierCore*> draining_;
  bool are_tiers_waited_for_ = true;
  std::size_t pending_ = 0;
  std::uint64_t lost_ = 0;
};

}  // namespace

void Loop::drain(Duration deadline, Callback<void(std::uint64_t)> done) {
  core_->check_thread("cannot drain", "loop " + config().name);
  core_->check_not_ending("cannot drain");
  if (!done) detail::refuse_empty("cannot drain", "loop " + config().name);
  std::make_shared<Drain>(*this, deadline, std::move(done))->begin();
}

std::uint64_t Loop::close(Duration deadline) {
  if (core_->is_attached()) {
    throw SetupError({Errc::bad_argument, "cannot close", "loop " + config().name,
                      "it is attached: only the program can run it", "use drain(deadline, done)"});
  }
  core_->check_thread("cannot close", "loop " + config().name);
  if (core_->is_in_user_code()) {
    throw SetupError({Errc::busy, "cannot close", "loop " + config().name, "this is one of its callbacks",
                      "use drain(deadline, done), or close it after run() has returned"});
  }
  // Shared, because the drain continues if stop() ends the wait.
  struct State {
    bool is_done = false;
    bool is_running = false;
    std::uint64_t lost = 0;
  };
  const auto state = std::make_shared<State>();
  core_->forget_stop();
  struct Reference {
    explicit Reference(detail::LoopCore& of) : core(of) { core.ref(); }
    ~Reference() { core.unref(); }
    detail::LoopCore& core;
  };
  const Reference until_it_is_over(*core_);
  drain(deadline, [this, state](std::uint64_t count) {
    state->lost = count;
    state->is_done = true;
    if (state->is_running) stop();
  });
  if (!state->is_done) {
    state->is_running = true;
    run();
    state->is_running = false;
  }
  if (state->is_done) return state->lost;
  std::uint64_t queued = 0;
  for (const detail::Recorder* recorder : core_->runtime.recorders) {
    const SinkStatus status = recorder->status();
    if (!status.backlog) queued += status.counts.queued;  // otherwise its events are safe in the recording
  }
  return queued;
}

}  // namespace rtdata
