#include "rtdata/loop/loop.hpp"

#include <sys/eventfd.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include <algorithm>
#include <cassert>
#include <cerrno>
#include <limits>

#include "loop/bridge.hpp"
#include "loop/fatal.hpp"
#include "loop/loop_core.hpp"
#include "loop/runtime_core.hpp"
#include "loop/tier_core.hpp"
#include "loop/virtual_threads.hpp"
#include "rtdata/loop/lane.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata {
namespace detail {

// Heap memory that libuv uses until the close callbacks have run; `core` is null from the destructor on.
struct LoopCore::UvSide {
  LoopCore* core = nullptr;
  int timer_fd = -1;
  uv_poll_t timer{};
  uv_check_t check{};
  uv_idle_t idle{};
  Wake wake;
  uv_poll_t wake_poll{};
  int clock_fd = -1;
  uv_poll_t clock{};
  int open_handles = 0;
  bool* closed = nullptr;  // told when the last handle is closed

  template <class UvHandle>
  void close(UvHandle& handle) {
    handle.data = this;
    ++open_handles;
    uv_close(reinterpret_cast<uv_handle_t*>(&handle), [](uv_handle_t* ended) {
      auto* side = static_cast<UvSide*>(ended->data);
      if (--side->open_handles > 0) return;
      ::close(side->timer_fd);
      if (side->clock_fd >= 0) ::close(side->clock_fd);
      if (side->closed != nullptr) *side->closed = true;
      delete side;
    });
  }
};

namespace {

[[noreturn]] void throw_uv(int status, const char* what) {
  throw SetupError({make_error_code(Errc::io_failed), what, "libuv", uv_strerror(status), ""});
}

void check_uv(int status, const char* what) {
  if (status != 0) throw_uv(status, what);
}

/// Where uv_loop_init gets an epoll, but no pipe for signals, libuv aborts the process: seen to here. libuv 1.44 takes 4,
/// later versions also rings of io_uring.
void require_descriptors() {
  int taken[8];
  int count = 0, failure = 0;
  for (int& one : taken) {
    one = ::eventfd(0, EFD_CLOEXEC);
    if (one < 0) {
      failure = errno;
      break;
    }
    ++count;
  }
  for (int i = 0; i < count; ++i) ::close(taken[i]);
  if (failure != 0) throw SetupError(system_error(failure, "cannot make a loop", "", "raise the limit: `ulimit -n`"));
}

}  // namespace

LoopCore::LoopCore(Loop& face_, RuntimeCore& runtime_, Loop::Config config_, uv_loop_t* host, Time time)
    : face(face_), runtime(runtime_), config(std::move(config_)), attached_(host != nullptr) {
  if (runtime.own_loop != nullptr) {
    throw SetupError({Errc::busy, "cannot make a loop", config.name,
                      "its runtime has loop " + runtime.own_loop->config.name + " already",
                      "give each loop a runtime of its own; for a loop on another thread make a Tier"});
  }
  if (time == Time::manual) {
    manual_ = dynamic_cast<ManualClock*>(&runtime.clock());
    if (runtime.hub == nullptr) own_threads_ = std::make_unique<VirtualThreads>(*manual_);
    threads_ = own_threads_ != nullptr ? own_threads_.get() : runtime.hub->own_loop->threads_;
  }
  reads_kernel_clock_ = manual_ == nullptr && !runtime.has_injected_clock();
  for (int i = 0; i < 2; ++i) add_deadline();  // the flusher, and the end of a hold
  if (attached_) {
    uv_loop_ = host;
  } else {
    require_descriptors();
    check_uv(uv_loop_init(&own_loop_), "cannot make a loop");
    uv_loop_ = &own_loop_;
  }
  make_side();
  uv_poll_start(&side_->timer, UV_READABLE,
                [](uv_poll_t* handle, int, int) { static_cast<UvSide*>(handle->data)->core->run_due(); });
  uv_check_start(&side_->check, [](uv_check_t* handle) { static_cast<UvSide*>(handle->data)->core->turn_done(); });
  for (auto* handle : {reinterpret_cast<uv_handle_t*>(&side_->timer), reinterpret_cast<uv_handle_t*>(&side_->check),
                       reinterpret_cast<uv_handle_t*>(&side_->wake_poll)}) {
    uv_unref(handle);
  }
  if (reads_kernel_clock_ && runtime.hub == nullptr) watch_clock();
  handled_until_ = now();
  runtime.own_loop = this;
}

void LoopCore::make_side() {
  auto side = std::make_unique<UvSide>();
  side->core = this;
  side->timer_fd = ::timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
  const int failure = errno;
  const auto give_up = [&] {
    if (side->timer_fd >= 0) ::close(side->timer_fd);
    if (!attached_) uv_loop_close(&own_loop_);
  };
  if (side->timer_fd < 0) {
    give_up();
    throw SetupError(system_error(failure, "cannot make a loop", "timerfd_create"));
  }
  if (!side->wake.open()) {
    const int number = errno;
    give_up();
    throw SetupError(system_error(number, "cannot make a loop", "eventfd"));
  }
  int status = uv_poll_init(uv_loop_, &side->wake_poll, side->wake.fd());
  if (status != 0) {
    give_up();
    throw_uv(status, "cannot watch for wake-ups");
  }
  status = uv_poll_init(uv_loop_, &side->timer, side->timer_fd);
  if (status != 0) {
    UvSide* abandoned = side.release();
    abandoned->close(abandoned->wake_poll);
    if (!attached_) {
      uv_run(&own_loop_, UV_RUN_NOWAIT);
      uv_loop_close(&own_loop_);
    }
    throw_uv(status, "cannot watch the timer");
  }
  side_ = side.release();
  uv_check_init(uv_loop_, &side_->check);
  uv_idle_init(uv_loop_, &side_->idle);
  side_->timer.data = side_->check.data = side_->idle.data = side_->wake_poll.data = side_;
  uv_poll_start(&side_->wake_poll, UV_READABLE, [](uv_poll_t* handle, int, int) {
    LoopCore& core = *static_cast<UvSide*>(handle->data)->core;
    const Calling calling(core.runtime);
    core.side_->wake.answer();
    core.take_news();
  });
}

void LoopCore::watch_clock() {
  // The kernel tells of a clock that is set by cancelling timers on it. Where it cannot, steps go unnoticed until the end.
  const int fd = ::timerfd_create(CLOCK_REALTIME, TFD_NONBLOCK | TFD_CLOEXEC);
  if (fd < 0) return;
  if (uv_poll_init(uv_loop_, &side_->clock, fd) != 0) {
    ::close(fd);
    return;
  }
  side_->clock_fd = fd;
  side_->clock.data = side_;
  arm_clock();
  uv_poll_start(&side_->clock, UV_READABLE, [](uv_poll_t* handle, int, int) {
    LoopCore& core = *static_cast<UvSide*>(handle->data)->core;
    std::uint64_t expirations = 0;
    [[maybe_unused]] const auto got = ::read(core.side_->clock_fd, &expirations,
                                             sizeof expirations);  // fails: cancelled
    core.arm_clock();
    const Calling calling(core.runtime);
    core.call_own("clock", [&] { core.runtime.look_at_clock(); });
  });
  uv_unref(reinterpret_cast<uv_handle_t*>(&side_->clock));
}

void LoopCore::arm_clock() noexcept {
  itimerspec never{};
  constexpr std::int64_t year_2200 = 7'258'118'400;
  using Seconds = decltype(never.it_value.tv_sec);
  never.it_value.tv_sec = static_cast<Seconds>(std::min<std::int64_t>(year_2200, std::numeric_limits<Seconds>::max()));
  ::timerfd_settime(side_->clock_fd, TFD_TIMER_ABSTIME | TFD_TIMER_CANCEL_ON_SET, &never, nullptr);
}

void LoopCore::close_nodes() noexcept {
  is_ending_ = true;
  on_error.reset();  // what it refers to may be gone already, as objects made after the loop are
  while (nodes_ != nullptr) {
    nodes_->retain();
    Node* node = nodes_;
    node->close();
    node->release();
  }
}

LoopCore::~LoopCore() {
  close_nodes();
  drop_posted();
  while (!lanes_.empty()) {  // one by one: a job's `done` may ask for lanes
    const auto last = std::move(lanes_.back().second);
    lanes_.pop_back();
  }
  for (const auto& topic : runtime.topics()) topic->abandon();
  runtime.forget(*this);
  remove(flusher_);
  remove(calm_);
  side_->core = nullptr;
  uv_poll_stop(&side_->timer);
  side_->close(side_->timer);
  side_->close(side_->check);
  side_->close(side_->idle);
  side_->close(side_->wake_poll);
  if (side_->clock_fd >= 0) side_->close(side_->clock);
  if (!attached_) {
    bool is_closed = false;
    side_->closed = &is_closed;
    while (!is_closed) uv_run(&own_loop_, UV_RUN_NOWAIT);
    [[maybe_unused]] const int status = uv_loop_close(&own_loop_);
    assert(status == 0);
  }
}

LoopCore::Calling::Calling(RuntimeCore& of) noexcept : runtime_(of) { ++runtime_.calling; }
LoopCore::Calling::~Calling() { --runtime_.calling; }

bool LoopCore::is_in_user_code() const noexcept {
  return is_running_ || is_in_callback() || runtime.calling > 0 || is_run_by_another_thread();
}

void LoopCore::check_may_end() const noexcept {
  if (!is_in_user_code() && runtime.tiers.empty()) return;
  std::string why = "this is one of its callbacks, or of a sink on it, or another thread than that which runs it";
  if (!is_in_user_code()) why = "tier " + runtime.tiers.front()->config.name + " still uses it";
  end_program({Errc::busy, "a loop is destroyed too early", "loop " + config.name, std::move(why),
               "use stop(), and destroy it where run() has returned, after its tiers"});
}

MonotonicTime LoopCore::now() noexcept {
  if (reads_kernel_clock_) [[likely]]
    return CycleClock::kernel_time();
  return manual_ != nullptr ? manual_->monotonic() : runtime.clock().monotonic();
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

void LoopCore::ref() noexcept {
  if (refs_++ == 0) uv_ref(reinterpret_cast<uv_handle_t*>(&side_->wake_poll));
}

void LoopCore::unref() noexcept {
  if (--refs_ == 0) uv_unref(reinterpret_cast<uv_handle_t*>(&side_->wake_poll));
}

Wake& LoopCore::wake() noexcept { return side_->wake; }

// ---- deadlines

void LoopCore::add_deadline() {
  deadlines_.make_room(deadline_count_ + 1);
  if (deadline_count_ + 1 > next_round_.capacity()) next_round_.reserve(2 * (deadline_count_ + 1));
  ++deadline_count_;
}

void LoopCore::insert(Deadline& deadline) noexcept {
  assert_thread();
  if (firing_ && deadline.due <= firing_until_) {  // in the next round, so that one round ends
    next_round_.push_back(&deadline);
    deadline.heap_index = Deadline::waiting;
    return;
  }
  deadlines_.insert(deadline);
  if (!firing_ && deadlines_.top() == &deadline) arm();
}

void LoopCore::remove(Deadline& deadline) noexcept {
  if (deadline.heap_index == Deadline::waiting) {
    std::erase(next_round_, &deadline);
    deadline.heap_index = Deadline::npos;
    return;
  }
  deadlines_.remove(deadline);
}

void LoopCore::moved(Deadline& deadline) noexcept {
  if (deadline.heap_index == Deadline::waiting || (firing_ && deadline.due <= firing_until_)) {
    remove(deadline);
    insert(deadline);
    return;
  }
  deadlines_.moved(deadline);
  if (!firing_) arm();
}

void LoopCore::arm() noexcept {
  const Deadline* top = deadlines_.top();
  if (manual_ != nullptr) return;
  const Duration spin = std::max(config.spin, Duration{0});
  const MonotonicTime due = top == nullptr ? MonotonicTime{}
                                           : std::max(later(top->due, -spin), MonotonicTime{Duration{1}});
  itimerspec spec{};
  spec.it_value.tv_sec = due.time_since_epoch().count() / 1'000'000'000;
  spec.it_value.tv_nsec = static_cast<decltype(spec.it_value.tv_nsec)>(due.time_since_epoch().count() % 1'000'000'000);
  ::timerfd_settime(side_->timer_fd, TFD_TIMER_ABSTIME, &spec, nullptr);
}

MonotonicTime LoopCore::turn_start() noexcept {
  const MonotonicTime current = now();
  // Before the loop runs, a turn may be long: what is made much later starts later.
  if (!turn_is_open_ || current - turn_start_ > config.hold_limit) {
    turn_start_ = current;
    turn_is_open_ = true;
    start_idle();  // so that the turn ends
  }
  return turn_start_;
}

void LoopCore::spin_until_due() noexcept {
  const Deadline* top = deadlines_.top();
  if (top == nullptr || manual_ != nullptr) return;
  for (MonotonicTime current = now(); current < top->due && span_between(current, top->due) <= config.spin;
       current = now()) {
  }
}

void LoopCore::run_due() {
  constexpr int rounds = 4;  // what comes due meanwhile is done at once rather than armed for, but I/O gets its turn
  if (firing_) return;       // asked for by a callback of a deadline
  schedule_.begin_waiting();
  if (config.spin.count() > 0) spin_until_due();
  firing_ = true;
  for (int round = 0; round < rounds; ++round) {
    const MonotonicTime until = now();
    if (!is_something_due(until)) {
      handled_until_ = std::max(handled_until_, until);
      break;
    }
    firing_until_ = until;
    MonotonicTime begin = until;
    while (is_something_due(until)) {
      Deadline& due = *deadlines_.top();
      const MonotonicTime due_at = due.due;
      // What cannot do what it is to do for want of memory has moved itself first, or is taken out.
      if (!call_own("loop", [&] { due.fire(begin); }) && deadlines_.top() == &due && due.due == due_at) remove(due);
      begin = now();
    }
    for (Deadline* deadline : next_round_) deadlines_.insert(*deadline);
    next_round_.clear();
    handled_until_ = std::max(handled_until_, until);
  }
  firing_ = false;
  for (Bridge* bridge : runtime.outbound) bridge->wake();  // before the system call: others wait for it
  arm();
}

// ---- deliveries

void LoopCore::add_ready(TopicCore& topic) {
  assert_thread();
  topic.is_ready = true;
  topic.next_ready = nullptr;
  if (ready_last_ == nullptr) {
    ready_first_ = &topic;
    start_idle();
  } else {
    ready_last_->next_ready = &topic;
  }
  ready_last_ = &topic;
}

void LoopCore::start_idle() noexcept {
  // An active idle handle makes the next poll return at once.
  uv_idle_start(&side_->idle, [](uv_idle_t*) {});
}

LoopCore::Left LoopCore::deliver(Budget budget) {
  constexpr int most_rounds = 100;  // each brings what the handlers of the one before have published
  if (delivering_ || is_ending_) return Left::nothing;
  delivering_ = true;
  MonotonicTime current = now();
  const MonotonicTime end = budget == Budget::limited ? later(current, config.delivery_budget) : MonotonicTime::max();
  Left left = Left::nothing;
  if (budget == Budget::none || manual_ == nullptr) rounds_ = 0;
  while (ready_first_ != nullptr && left == Left::nothing)
    left = rounds_ < most_rounds ? deliver_round(current, end) : Left::circle;
  delivering_ = false;
  runtime.send_now();
  return left;
}

LoopCore::Left LoopCore::deliver_round(MonotonicTime& current, MonotonicTime end) {
  // One that was broken off goes on, so that the rounds of handlers in a circle are counted whatever comes due between.
  std::size_t unfinished = 0;
  for (TopicCore* topic = ready_first_; topic != nullptr; topic = topic->next_ready) {
    if (!round_is_open_) topic->begin_round();
    if (topic->is_in_round()) ++unfinished;
  }
  round_is_open_ = true;
  while (unfinished > 0) {
    TopicCore* topic = ready_first_;
    const bool is_of_round = topic->is_in_round();  // others became ready meanwhile
    if (is_of_round) current = topic->deliver_group(*this, current);
    if (is_of_round && !topic->is_in_round()) --unfinished;
    if (!topic->has_pending()) {
      ready_first_ = topic->next_ready;
      if (ready_first_ == nullptr) ready_last_ = nullptr;
      topic->is_ready = false;
    } else if (topic->next_ready !=
               nullptr) {  // to the back of the row, so that one busy topic does not hold the others
      ready_first_ = topic->next_ready;
      ready_last_->next_ready = topic;
      ready_last_ = topic;
      topic->next_ready = nullptr;
    }
    if (end != MonotonicTime::max() && (current >= end || is_something_due(current))) return Left::later;
  }
  round_is_open_ = false;
  ++rounds_;
  return Left::nothing;
}

void LoopCore::deliver_all() { deliver(Budget::none); }

void LoopCore::take_news() {
  if (!side_->wake.take_news()) return;
  run_posted();
  if (!attached_ && is_stopping()) uv_stop(uv_loop_);
}

void LoopCore::turn_done() noexcept {
  const Calling calling(runtime);
  take_news();
  turn_is_open_ = false;
  schedule_.begin_waiting();
  start_tiers_in_turn();
  call_own("loop", [&] {
    runtime.turn_done();
    if (runtime.has_injected_clock()) runtime.look_at_clock();
  });
  if (ready_first_ != nullptr) {
    deliver(Budget::limited);
    call_own("loop", [&] { runtime.turn_done(); });  // what handlers have published
  }
  if (!side_->wake.rest()) {
    start_idle();
  } else if (ready_first_ == nullptr && !turn_is_open_) {
    uv_idle_stop(&side_->idle);
  }
}

}  // namespace detail

// ---- Loop

Loop::Loop() : Loop(Config{}) {}
Loop::Loop(Config config)
    : own_runtime_(std::make_unique<Runtime>()),
      core_(std::make_unique<detail::LoopCore>(*this, own_runtime_->core(), std::move(config), nullptr,
                                               detail::LoopCore::Time::real)) {}
Loop::Loop(uv_loop_t* host) : Loop(host, Config{}) {}
Loop::Loop(uv_loop_t* host, Config config) : own_runtime_(std::make_unique<Runtime>()) {
  if (host == nullptr)
    throw SetupError({Errc::bad_argument, "cannot attach", "loop", "the uv_loop_t is null", "pass the loop"});
  core_ = std::make_unique<detail::LoopCore>(*this, own_runtime_->core(), std::move(config), host,
                                             detail::LoopCore::Time::real);
}
Loop::Loop(Manual manual) : Loop(manual, Config{}) {}
Loop::Loop(Manual manual, Config config) : own_runtime_(std::make_unique<Runtime>()) {
  own_runtime_->core().use_manual_clock();
  core_ = std::make_unique<detail::LoopCore>(*this, own_runtime_->core(), std::move(config), nullptr,
                                             detail::LoopCore::Time::manual);
  core_->virtual_threads()->choose_by(manual);
}
Loop::Loop(Runtime& runtime, Config config)
    : core_(std::make_unique<detail::LoopCore>(*this, runtime.core(), std::move(config), nullptr,
                                               dynamic_cast<ManualClock*>(&runtime.core().clock()) != nullptr
                                                   ? detail::LoopCore::Time::manual
                                                   : detail::LoopCore::Time::real)) {}
Loop::~Loop() {
  core_->check_may_end();
  core_->begin_ending();
  if (own_runtime_ != nullptr) own_runtime_->core().on_log.reset();  // as for on_error
}

void Loop::run() { core_->run(); }
void Loop::run_for(Duration duration) { core_->run_for(duration); }
void Loop::poll() { core_->poll(); }
void Loop::stop() noexcept { core_->request_stop(); }
void Loop::advance(Duration duration) { core_->advance(duration); }
void Loop::post(Callback<void()> function) { core_->post(std::move(function)); }
MonotonicTime Loop::now() noexcept { return core_->now(); }
Time Loop::time() noexcept { return core_->runtime.event_time(core_->now()); }
Runtime& Loop::runtime() noexcept { return core_->runtime.face; }
const Loop::Config& Loop::config() const noexcept { return core_->config; }
uv_loop_t* Loop::uv() noexcept { return core_->uv(); }
void Loop::on_error(Callback<void(const ErrorReport&)> handler) {
  core_->check_thread("cannot set on_error", "loop " + config().name);
  core_->check_not_ending("cannot set on_error");
  core_->on_error.set(std::move(handler));
}
std::vector<CallbackStatus> Loop::callbacks() const { return core_->callbacks(); }
LoopLoad Loop::load() const { return core_->load(); }
void Loop::script_lane_duration(Duration duration) {
  core_->check_thread("cannot script lanes", "loop " + config().name);
  core_->lane_duration = duration;
}

ManualClock& Loop::manual_clock() {
  if (core_->manual_clock() == nullptr) {
    throw SetupError({Errc::bad_argument, "no manual clock", "loop " + config().name, "it runs in real time",
                      "make it with rtdata::Loop::Manual{}"});
  }
  return *core_->manual_clock();
}

}  // namespace rtdata
