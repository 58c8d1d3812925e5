#include "rtdata/loop/loop.hpp"

#include <sys/prctl.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include <algorithm>
#include <cassert>
#include <cerrno>

#include "loop/loop_core.hpp"
#include "loop/runtime_core.hpp"
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
  uv_async_t wake{};
  int open_handles = 4;

  template <class UvHandle>
  void close(UvHandle& handle) {
    handle.data = this;
    uv_close(reinterpret_cast<uv_handle_t*>(&handle), [](uv_handle_t* closed) {
      auto* side = static_cast<UvSide*>(closed->data);
      if (--side->open_handles > 0) return;
      ::close(side->timer_fd);
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

}  // namespace

LoopCore::LoopCore(Loop& face_, RuntimeCore& runtime_, Loop::Config config_, uv_loop_t* host, Time time)
    : face(face_), runtime(runtime_), config(std::move(config_)), attached_(host != nullptr) {
  if (time == Time::manual) {
    manual_ = dynamic_cast<ManualClock*>(&runtime.clock());
  }
  if (attached_) {
    uv_loop_ = host;
  } else {
    check_uv(uv_loop_init(&own_loop_), "cannot make a loop");
    uv_loop_ = &own_loop_;
  }
  auto side = std::make_unique<UvSide>();
  side->core = this;
  side->timer_fd = ::timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
  if (side->timer_fd < 0) throw SetupError(system_error(errno, "cannot make a loop", "timerfd_create"));
  check_uv(uv_poll_init(uv_loop_, &side->timer, side->timer_fd), "cannot watch the timer");
  side_ = side.release();
  uv_check_init(uv_loop_, &side_->check);
  uv_idle_init(uv_loop_, &side_->idle);
  check_uv(uv_async_init(uv_loop_, &side_->wake, [](uv_async_t* handle) { static_cast<UvSide*>(handle->data)->core->run_posted(); }),
           "cannot make a wake-up");
  side_->timer.data = side_->check.data = side_->idle.data = side_->wake.data = side_;
  uv_poll_start(&side_->timer, UV_READABLE, [](uv_poll_t* handle, int, int) {
    static_cast<UvSide*>(handle->data)->core->run_due();
  });
  uv_check_start(&side_->check, [](uv_check_t* handle) { static_cast<UvSide*>(handle->data)->core->turn_done(); });
  for (auto* handle : {reinterpret_cast<uv_handle_t*>(&side_->timer), reinterpret_cast<uv_handle_t*>(&side_->check),
                       reinterpret_cast<uv_handle_t*>(&side_->wake)}) {
    uv_unref(handle);
  }
  handled_until_ = now();
  runtime.loops.push_back(this);
}

LoopCore::~LoopCore() {
  while (nodes_ != nullptr) {
    nodes_->retain();
    Node* node = nodes_;
    node->close();
    node->release();
  }
  lanes_.clear();
  for (TopicCore* topic = ready_first_; topic != nullptr;) {
    TopicCore* next = topic->next_ready;
    topic->abandon();
    topic = next;
  }
  for (const auto& topic : runtime.topics()) topic->abandon();
  std::erase(runtime.loops, this);
  {
    const std::lock_guard lock(posted_mutex_);
    posted_.clear();
  }
  side_->core = nullptr;
  uv_poll_stop(&side_->timer);
  side_->close(side_->timer);
  side_->close(side_->check);
  side_->close(side_->idle);
  side_->close(side_->wake);
  if (!attached_) {
    while (uv_run(&own_loop_, UV_RUN_NOWAIT) != 0) {
    }
    [[maybe_unused]] const int status = uv_loop_close(&own_loop_);
    assert(status == 0);
  }
}

MonotonicTime LoopCore::now() noexcept {
  if (!runtime.has_injected_clock()) [[likely]] {
    if (manual_ != nullptr) return manual_->monotonic();
    timespec spec;
    ::clock_gettime(CLOCK_MONOTONIC, &spec);
    return MonotonicTime{std::chrono::seconds{spec.tv_sec} + Duration{spec.tv_nsec}};
  }
  return runtime.clock().monotonic();
}

void LoopCore::assert_thread() const noexcept {
#ifndef NDEBUG
  const std::thread::id running = thread_.load(std::memory_order_relaxed);
  assert(running == std::thread::id{} || running == std::this_thread::get_id());
#endif
}

void LoopCore::hold() noexcept {
  if (holds_++ == 0) uv_ref(reinterpret_cast<uv_handle_t*>(&side_->wake));
}

void LoopCore::unhold() noexcept {
  if (--holds_ == 0) uv_unref(reinterpret_cast<uv_handle_t*>(&side_->wake));
}

void LoopCore::link(Node& node) noexcept {
  node.next_ = nodes_;
  if (nodes_ != nullptr) nodes_->previous_ = &node;
  nodes_ = &node;
}

void LoopCore::unlink(Node& node) noexcept {
  if (node.previous_ != nullptr) node.previous_->next_ = node.next_;
  if (node.next_ != nullptr) node.next_->previous_ = node.previous_;
  if (nodes_ == &node) nodes_ = node.next_;
  node.previous_ = node.next_ = nullptr;
}

// ---- deadlines

void LoopCore::insert(Deadline& deadline) {
  deadlines_.insert(deadline);
  if (!firing_ && deadlines_.top() == &deadline) arm();
}

void LoopCore::remove(Deadline& deadline) noexcept { deadlines_.remove(deadline); }

void LoopCore::moved(Deadline& deadline) noexcept {
  deadlines_.moved(deadline);
  if (!firing_) arm();
}

void LoopCore::arm() {
  const Deadline* top = deadlines_.top();
  if (manual_ != nullptr) return;
  const MonotonicTime due = top == nullptr ? MonotonicTime{} : std::max(top->due, MonotonicTime{Duration{1}});
  itimerspec spec{};
  spec.it_value.tv_sec = due.time_since_epoch().count() / 1'000'000'000;
  spec.it_value.tv_nsec = due.time_since_epoch().count() % 1'000'000'000;
  ::timerfd_settime(side_->timer_fd, TFD_TIMER_ABSTIME, &spec, nullptr);
}

MonotonicTime LoopCore::turn_start() noexcept {
  if (!turn_is_open_) {
    turn_start_ = now();
    turn_is_open_ = true;
    start_idle();  // so that the turn ends
  }
  return turn_start_;
}

void LoopCore::run_due() {
  constexpr int rounds = 4;  // what comes due meanwhile is done at once rather than armed for, but I/O gets its turn
  firing_ = true;
  for (int round = 0; round < rounds; ++round) {
    const MonotonicTime until = now();
    if (deadlines_.top() == nullptr || deadlines_.top()->due > until) {
      handled_until_ = std::max(handled_until_, until);
      break;
    }
    while (Deadline* top = deadlines_.top()) {
      if (top->due > until) break;
      top->fire(until);
    }
    handled_until_ = std::max(handled_until_, until);
  }
  firing_ = false;
  arm();
}

// ---- deliveries

void LoopCore::add_ready(TopicCore& topic) {
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

void LoopCore::deliver(Budget budget) {
  if (delivering_ || ready_first_ == nullptr) return;
  delivering_ = true;
  const MonotonicTime end = now() + config.delivery_budget;
  while (ready_first_ != nullptr) {
    TopicCore* topic = ready_first_;
    topic->deliver_group(*this);
    if (!topic->has_pending()) {
      ready_first_ = topic->next_ready;
      if (ready_first_ == nullptr) ready_last_ = nullptr;
      topic->is_ready = false;
    } else if (topic->next_ready != nullptr) {  // to the back of the row, so that one busy topic does not hold the others
      ready_first_ = topic->next_ready;
      ready_last_->next_ready = topic;
      ready_last_ = topic;
      topic->next_ready = nullptr;
    }
    if (budget == Budget::none) continue;
    const MonotonicTime current = now();
    if (current >= end || (deadlines_.top() != nullptr && deadlines_.top()->due <= current)) break;
  }
  delivering_ = false;
}

void LoopCore::deliver_all() { deliver(Budget::none); }

void LoopCore::turn_done() noexcept {
  turn_is_open_ = false;
  deliver(Budget::limited);
  if (ready_first_ == nullptr && !turn_is_open_) uv_idle_stop(&side_->idle);
}

// ---- posting and running

void LoopCore::post(Callback<void()> function) {
  {
    const std::lock_guard lock(posted_mutex_);
    posted_.push_back(std::move(function));
  }
  uv_async_send(&side_->wake);
}

bool LoopCore::has_posted() noexcept {
  const std::lock_guard lock(posted_mutex_);
  return !posted_.empty();
}

uv_async_t* LoopCore::wake_handle() noexcept { return &side_->wake; }

void LoopCore::run_posted() {
  for (std::size_t i = 0; i < lanes_.size(); ++i) lanes_[i].second->collect();
  {
    const std::lock_guard lock(posted_mutex_);
    running_posted_.swap(posted_);
  }
  for (Callback<void()>& function : running_posted_) {
    CallbackTimes times;
    const MonotonicTime from = now();
    call_user("posted function", function);
    account(times, from, now(), [] { return std::string("posted function"); });
  }
  running_posted_.clear();
  if (stop_requested_.load(std::memory_order_relaxed) && !attached_) uv_stop(uv_loop_);
}

void LoopCore::request_stop() noexcept {
  stop_requested_.store(true, std::memory_order_relaxed);
  uv_async_send(&side_->wake);
}

void LoopCore::run() {
  if (attached_) {
    throw SetupError({Errc::bad_argument, "cannot run", "loop " + config.name, "it is attached to the program's own loop",
                      "run that one: uv_run(loop, UV_RUN_DEFAULT)"});
  }
  thread_.store(std::this_thread::get_id(), std::memory_order_relaxed);
  if (manual_ != nullptr) {
    poll();
    while (!stop_requested_.load(std::memory_order_relaxed) && holds_ > 0 && deadlines_.top() != nullptr) {
      advance_to(deadlines_.top()->due);
    }
  } else {
    const int slack = config.timer_slack.count() > 0 ? ::prctl(PR_GET_TIMERSLACK) : -1;
    if (slack >= 0) ::prctl(PR_SET_TIMERSLACK, static_cast<unsigned long>(config.timer_slack.count()));
    run_due();
    do {
      run_posted();  // libuv does not look at them when nothing else keeps the loop alive
      if (!stop_requested_.load(std::memory_order_relaxed)) uv_run(uv_loop_, UV_RUN_DEFAULT);
    } while (!stop_requested_.load(std::memory_order_relaxed) && has_posted());
    if (slack >= 0) ::prctl(PR_SET_TIMERSLACK, static_cast<unsigned long>(slack));
  }
  stop_requested_.store(false, std::memory_order_relaxed);
  thread_.store(std::thread::id{}, std::memory_order_relaxed);
}

void LoopCore::run_for(Duration duration) {
  if (manual_ != nullptr) {
    advance(duration);
    return;
  }
  const MonotonicTime end = now() + duration;
  Timer timer(face, [this] { request_stop(); });
  timer.start_at(end);
  run();
  if (now() >= end) run_due();
  deliver_all();
}

void LoopCore::poll() {
  if (attached_) {
    run_due();
    deliver_all();
    return;
  }
  if (manual_ == nullptr) run_due();
  uv_run(uv_loop_, UV_RUN_NOWAIT);
  if (manual_ != nullptr && deadlines_.top() != nullptr && deadlines_.top()->due <= now()) run_due();
  deliver_all();
}

void LoopCore::advance(Duration duration) {
  if (manual_ == nullptr) {
    throw SetupError({Errc::bad_argument, "cannot advance", "loop " + config.name, "it runs in real time",
                      "make it with rtdata::Loop::Manual{}"});
  }
  const MonotonicTime target = now() + duration;
  poll();
  while (!stop_requested_.load(std::memory_order_relaxed) && deadlines_.top() != nullptr && deadlines_.top()->due <= target) {
    advance_to(deadlines_.top()->due);
  }
  if (!stop_requested_.exchange(false, std::memory_order_relaxed)) advance_to(target);
}

void LoopCore::advance_to(MonotonicTime target) {
  if (target > now()) manual_->pass(target - now());
  run_due();
  deliver_all();
  uv_run(uv_loop_, UV_RUN_NOWAIT);
  deliver_all();
}

Lane& LoopCore::lane(const std::string& key, Duration give_up_after) {
  for (auto& [name, lane] : lanes_) {
    if (name == key) return *lane;
  }
  lanes_.emplace_back(key, std::make_unique<Lane>(*this, key, give_up_after));
  return *lanes_.back().second;
}

void LoopCore::report_hold(const std::string& name, Duration took) {
  runtime.report(this, name, {Errc::held_too_long, "held the loop for " + to_string(took / 1000 * 1000), "loop " + config.name,
                              "its limit is " + to_string(config.hold_limit),
                              "make it shorter, or do the slow part elsewhere; the ticks it cost are counted as missed"});
}

void LoopCore::report_exception(std::string_view name, const char* what) noexcept {
  try {
    runtime.report(this, name, {Errc::handler_threw, "a callback threw", "", what, "it goes on being called"});
  } catch (...) {  // the report itself ran out of memory, or its handler threw: nothing is left to tell it to
  }
}

// ---- Node

Node::Node(LoopCore& loop) : loop_(&loop) { loop.link(*this); }
Node::~Node() {
  if (loop_ != nullptr) loop_->unlink(*this);  // a constructor of the derived class threw: it was never open
}

void Node::close() noexcept {
  if (loop_ == nullptr) return;
  on_close();
  loop_->unlink(*this);
  loop_ = nullptr;
  if (running_ == 0) drop_callbacks();
}

}  // namespace detail

// ---- Loop

Loop::Loop() : Loop(Config{}) {}
Loop::Loop(Config config)
    : own_runtime_(std::make_unique<Runtime>()),
      core_(std::make_unique<detail::LoopCore>(*this, own_runtime_->core(), std::move(config), nullptr, detail::LoopCore::Time::real)) {}
Loop::Loop(uv_loop_t* host) : Loop(host, Config{}) {}
Loop::Loop(uv_loop_t* host, Config config) : own_runtime_(std::make_unique<Runtime>()) {
  if (host == nullptr) throw SetupError({Errc::bad_argument, "cannot attach", "loop", "the uv_loop_t is null", "pass the loop"});
  core_ = std::make_unique<detail::LoopCore>(*this, own_runtime_->core(), std::move(config), host, detail::LoopCore::Time::real);
}
Loop::Loop(Manual manual) : Loop(manual, Config{}) {}
Loop::Loop(Manual, Config config) : own_runtime_(std::make_unique<Runtime>()) {
  own_runtime_->core().use_manual_clock();
  core_ = std::make_unique<detail::LoopCore>(*this, own_runtime_->core(), std::move(config), nullptr, detail::LoopCore::Time::manual);
}
Loop::Loop(Runtime& runtime, Config config)
    : core_(std::make_unique<detail::LoopCore>(*this, runtime.core(), std::move(config), nullptr,
                                               dynamic_cast<ManualClock*>(&runtime.core().clock()) != nullptr
                                                   ? detail::LoopCore::Time::manual
                                                   : detail::LoopCore::Time::real)) {}
Loop::~Loop() = default;

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
void Loop::on_error(Callback<void(const ErrorReport&)> handler) { core_->on_error = std::move(handler); }
void Loop::script_lane_duration(Duration duration) { core_->lane_duration = duration; }

ManualClock& Loop::manual_clock() {
  if (core_->manual_clock() == nullptr) {
    throw SetupError({Errc::bad_argument, "no manual clock", "loop " + config().name, "it runs in real time",
                      "make it with rtdata::Loop::Manual{}"});
  }
  return *core_->manual_clock();
}

}  // namespace rtdata
