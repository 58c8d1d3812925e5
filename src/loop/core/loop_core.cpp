// The core of a loop: its parts, the steps of a turn, its thread, its end.
#include "loop/core/loop_core.hpp"

#include <cassert>
#include <utility>

#include "loop/core/fatal.hpp"
#include "loop/core/virtual_threads.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {

namespace {

RuntimeCore& free_runtime(RuntimeCore& runtime, const Loop::Config& config) {
  if (runtime.own_loop == nullptr) return runtime;
  throw SetupError({Errc::busy, "cannot make a loop", config.name,
                    "its runtime has loop " + runtime.own_loop->config.name + " already",
                    "give each loop a runtime of its own; for a loop on another thread make a Tier"});
}

}  // namespace

LoopCore::LoopCore(Loop& face_, RuntimeCore& runtime_, Loop::Config config_, uv_loop_t* host, Time time)
    : face(face_),
      runtime(free_runtime(runtime_, config_)),
      config(std::move(config_)),
      manual_(time == Time::manual ? dynamic_cast<ManualClock*>(&runtime.clock()) : nullptr),
      own_threads_(manual_ != nullptr && runtime.hub == nullptr ? std::make_unique<VirtualThreads>(*manual_) : nullptr),
      threads_(manual_ != nullptr && runtime.hub != nullptr ? runtime.hub->own_loop->threads_ : own_threads_.get()),
      reads_kernel_clock_(manual_ == nullptr && !runtime.has_injected_clock()),
      uv(*this, host) {
  if (reads_kernel_clock_ && runtime.hub == nullptr) uv.watch_clock();
  deadlines.begin(now());
  runtime.attach(*this);
}

LoopCore::~LoopCore() {
  close_nodes();
  posts.drop();
  lanes.close();
  runtime.forget(*this);
}

void LoopCore::close_nodes() noexcept {
  is_ending_ = true;
  on_error.reset();  // it may refer to destroyed objects that were made after the loop
  nodes.close_all();
}

MonotonicTime LoopCore::now() noexcept {
  if (reads_kernel_clock_) [[likely]]
    return CycleClock::kernel_time();
  return manual_ != nullptr ? manual_->monotonic() : runtime.clock().monotonic();
}

// ---- the steps of a turn

void LoopCore::run_due() {
  if (deadlines.is_firing()) return;  // called from a callback of a deadline
  schedule_.begin_waiting();
  if (config.spin.count() > 0) deadlines.spin();
  deadlines.fire_due();
  runtime.send_now();  // before the system call: other loops wait for it
  deadlines.arm();
}

bool LoopCore::take_sent(MonotonicTime end) {
  call_own("loop", [&] {
    lanes.collect();
    runtime.receive();
  });
  return posts.run(end);
}

void LoopCore::take_news() {
  if (is_manual() && !uv.wake().is_sent()) return;  // a manual loop does not sleep, so checking is enough
  if (!uv.wake().take_news()) return;
  take_sent(end_of_budget());
  if (!is_attached() && is_stopping()) uv_stop(uv.loop());
}

void LoopCore::woken() {
  const Calling calling(runtime);
  take_news();
}

void LoopCore::turn_ended() noexcept {
  host_has_run_ = is_attached();
  const Calling calling(runtime);
  take_news();
  turn_is_open_ = false;
  schedule_.begin_waiting();
  runtime.start_tiers_in_turn();
  call_own("loop", [&] {
    runtime.turn_done();
    if (runtime.has_injected_clock()) runtime.clock_log.look();
  });
  if (!deliveries.is_empty()) {
    deliveries.deliver(Deliveries::Budget::limited);
    call_own("loop", [&] { runtime.turn_done(); });  // sends what handlers have published
  }
  if (is_manual()) return;  // a manual loop does not sleep: it checks for sent data at every instant
  if (!uv.wake().rest()) {
    uv.forbid_sleep();
  } else if (deliveries.is_empty() && !turn_is_open_) {
    uv.allow_sleep();
  }
}

void LoopCore::clock_was_set() {
  const Calling calling(runtime);
  call_own("clock", [&] { runtime.clock_log.look(); });
}

MonotonicTime LoopCore::turn_start() noexcept {
  const MonotonicTime current = now();
  // Before the loop runs, a turn may be long; objects made much later start later.
  if (!turn_is_open_ || current - turn_start_ > config.hold_limit) {
    turn_start_ = current;
    turn_is_open_ = true;
    uv.forbid_sleep();  // so that the turn ends
  }
  return turn_start_;
}

void LoopCore::ref() noexcept {
  if (refs_++ == 0) uv.ref();
}

void LoopCore::unref() noexcept {
  if (--refs_ == 0) uv.unref();
}

// ---- its thread, and user code on it

LoopCore::Calling::Calling(RuntimeCore& of) noexcept : runtime_(of) { ++runtime_.calling; }
LoopCore::Calling::~Calling() { --runtime_.calling; }

bool LoopCore::is_in_user_code() const noexcept {
  return is_running_ || is_in_callback() || runtime.calling > 0 || is_run_by_another_thread();
}

void LoopCore::report_exception(std::string_view name, std::string_view what) noexcept {
  try {
    runtime.report(this, name,
                   {Errc::handler_threw, "a callback threw", "", std::string(what), "the callback is still called"});
  } catch (...) {  // the report failed: out of memory, or its handler threw; there is no other way to report
  }
}

void LoopCore::assert_thread() const noexcept {
#ifndef NDEBUG
  assert(!is_run_by_another_thread());
#endif
}

void LoopCore::refuse_thread(const char* what, std::string_view object) const {
  throw SetupError(
      {Errc::busy, what, std::string(object),
       "loop " + config.name + ", which it belongs to, runs on another thread, or this is a call on a lane",
       "post a function to that loop that does it there, or make one on the loop of this thread"});
}

// ---- its end

void LoopCore::check_may_end() const noexcept {
  const bool is_called_by_it = is_in_user_code();
  const std::string user = is_called_by_it ? "" : runtime.user_of_loop();
  if (!is_called_by_it && user.empty()) return;
  std::string why = "this happens in one of its callbacks, in one of a sink on it, or on another thread than its own";
  if (!is_called_by_it) why = user + " still uses it";
  end_program({Errc::busy, "a loop is destroyed too early", "loop " + config.name, std::move(why),
               "use stop(), and destroy it where run() has returned, after its tiers"});
}

void LoopCore::check_not_ending(const char* what) const {
  if (!is_ending_) return;
  throw SetupError(
      {Errc::busy, what, "loop " + config.name, "it is being destroyed",
       "do not make or run anything in code that runs while a loop ends: destructors of captures, `close` of devices"});
}

void LoopCore::dispose_later(Node& node) noexcept {
  post_disposal(node, {Errc::busy, "was closed where it may not be", "loop " + config.name,
                       "another thread closed it, or a call of a sink's writer; its loop closes it now",
                       "post a function to the loop that closes it there"});
}

void LoopCore::dispose_when_it_turns(Node& node) noexcept {
  post_disposal(node, {Errc::not_turning, "was closed late", "loop " + config.name,
                       "its loop did not turn when it was to be closed, and closes it now",
                       "find what blocked in its sensors and handlers"});
}

void LoopCore::post_disposal(Node& node, Error why) noexcept {
  struct Owned {
    explicit Owned(Node& node) noexcept : node_(&node) {}
    Owned(Owned&& other) noexcept : node_(std::exchange(other.node_, nullptr)) {}
    ~Owned() {
      if (node_ == nullptr) return;
      node_->close();
      node_->release();
    }
    Node* node_;
  };
  post([this, owned = Owned(node), why = std::move(why)] {
    const std::string name = owned.node_->callback_name();
    owned.node_->close();
    runtime.report(this, name.empty() ? "loop " + config.name : name, why);
  });
}

}  // namespace rtdata::detail
