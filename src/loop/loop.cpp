#include "rtdata/loop/loop.hpp"

#include <sys/prctl.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include <algorithm>
#include <cassert>
#include <cerrno>
#include <exception>
#include <limits>
#include <semaphore>

#include "loop/bridge.hpp"
#include "loop/callback_survey.hpp"
#include "loop/loop_core.hpp"
#include "loop/runtime_core.hpp"
#include "loop/tier_core.hpp"
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

constexpr Duration calm_after = std::chrono::seconds{10};

[[noreturn]] void throw_uv(int status, const char* what) {
  throw SetupError({make_error_code(Errc::io_failed), what, "libuv", uv_strerror(status), ""});
}

void check_uv(int status, const char* what) {
  if (status != 0) throw_uv(status, what);
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
  }
  if (attached_) {
    uv_loop_ = host;
  } else {
    check_uv(uv_loop_init(&own_loop_), "cannot make a loop");
    uv_loop_ = &own_loop_;
  }
  make_side();
  uv_poll_start(&side_->timer, UV_READABLE, [](uv_poll_t* handle, int, int) {
    static_cast<UvSide*>(handle->data)->core->run_due();
  });
  uv_check_start(&side_->check, [](uv_check_t* handle) { static_cast<UvSide*>(handle->data)->core->turn_done(); });
  for (auto* handle : {reinterpret_cast<uv_handle_t*>(&side_->timer), reinterpret_cast<uv_handle_t*>(&side_->check),
                       reinterpret_cast<uv_handle_t*>(&side_->wake_poll)}) {
    uv_unref(handle);
  }
  if (manual_ == nullptr && !runtime.has_injected_clock() && runtime.hub == nullptr) watch_clock();
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
    [[maybe_unused]] const auto got = ::read(core.side_->clock_fd, &expirations, sizeof expirations);  // fails: cancelled
    core.arm_clock();
    core.runtime.look_at_clock();
  });
  uv_unref(reinterpret_cast<uv_handle_t*>(&side_->clock));
}

void LoopCore::arm_clock() noexcept {
  itimerspec never{};
  never.it_value.tv_sec = std::numeric_limits<std::int32_t>::max();
  ::timerfd_settime(side_->clock_fd, TFD_TIMER_ABSTIME | TFD_TIMER_CANCEL_ON_SET, &never, nullptr);
}

void LoopCore::close_nodes() noexcept {
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
  while (!lanes_.empty()) {  // one by one: a job's `done` may ask for lanes
    const auto last = std::move(lanes_.back().second);
    lanes_.pop_back();
  }
  for (const auto& topic : runtime.topics()) topic->abandon();
  runtime.own_loop = nullptr;
  std::vector<Callback<void()>> unrun;
  {
    const std::lock_guard lock(posted_mutex_);
    unrun.swap(posted_);
  }
  unrun.clear();  // outside the lock: captures may post
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

void LoopCore::check_thread(const char* what, std::string_view object) const {
  const std::thread::id running = thread_.load(std::memory_order_relaxed);
  if (running == std::thread::id{} || running == std::this_thread::get_id()) [[likely]] return;
  throw SetupError({Errc::busy, what, std::string(object), "loop " + config.name + ", which it belongs to, runs on another thread",
                    "post a function to that loop that does it there, or make one on the loop of this thread"});
}

void LoopCore::hold() noexcept {
  if (holds_++ == 0) uv_ref(reinterpret_cast<uv_handle_t*>(&side_->wake_poll));
}

void LoopCore::unhold() noexcept {
  if (--holds_ == 0) uv_unref(reinterpret_cast<uv_handle_t*>(&side_->wake_poll));
}

void LoopCore::link(Node& node) noexcept {
  node.next_ = nodes_;
  if (nodes_ != nullptr) nodes_->previous_ = &node;
  nodes_ = &node;
}

void LoopCore::unlink(Node& node) noexcept {
  for (const auto& survey : surveys_) {
    if (survey->next_ == &node) survey->next_ = node.next_;
  }
  {
    const std::lock_guard lock(doing_mutex_);
    if (doing_.load(std::memory_order_relaxed) == &node) doing_.store(nullptr, std::memory_order_relaxed);
  }
  if (node.previous_ != nullptr) node.previous_->next_ = node.next_;
  if (node.next_ != nullptr) node.next_->previous_ = node.previous_;
  if (nodes_ == &node) nodes_ = node.next_;
  node.previous_ = node.next_ = nullptr;
}

// ---- deadlines

void LoopCore::insert(Deadline& deadline) {
  assert_thread();
  if (firing_ && deadline.due <= firing_until_) {  // in the next round, so that one round ends
    deadline.heap_index = Deadline::waiting;
    next_round_.push_back(&deadline);
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

void LoopCore::moved(Deadline& deadline) {
  if (deadline.heap_index == Deadline::waiting || (firing_ && deadline.due <= firing_until_)) {
    remove(deadline);
    insert(deadline);
    return;
  }
  deadlines_.moved(deadline);
  if (!firing_) arm();
}

void LoopCore::arm() {
  const Deadline* top = deadlines_.top();
  if (manual_ != nullptr) return;
  const MonotonicTime due = top == nullptr ? MonotonicTime{} : std::max(top->due - config.spin, MonotonicTime{Duration{1}});
  itimerspec spec{};
  spec.it_value.tv_sec = due.time_since_epoch().count() / 1'000'000'000;
  spec.it_value.tv_nsec = due.time_since_epoch().count() % 1'000'000'000;
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
  for (MonotonicTime current = now(); current < top->due && top->due - current <= config.spin; current = now()) {
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
    if (deadlines_.top() == nullptr || deadlines_.top()->due > until) {
      handled_until_ = std::max(handled_until_, until);
      break;
    }
    firing_until_ = until;
    MonotonicTime begin = until;
    while (Deadline* top = deadlines_.top()) {
      if (top->due > until) break;
      top->fire(begin);
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
  if (delivering_ || ready_first_ == nullptr) return Left::nothing;
  delivering_ = true;
  MonotonicTime current = now();
  const MonotonicTime end = budget == Budget::limited ? current + config.delivery_budget : MonotonicTime::max();
  Left left = Left::nothing;
  for (int round = 0; ready_first_ != nullptr && left == Left::nothing; ++round) {
    left = round < most_rounds ? deliver_round(current, end) : Left::circle;
  }
  delivering_ = false;
  return left;
}

LoopCore::Left LoopCore::deliver_round(MonotonicTime& current, MonotonicTime end) {
  std::size_t unfinished = 0;
  for (TopicCore* topic = ready_first_; topic != nullptr; topic = topic->next_ready) {
    topic->begin_round();
    ++unfinished;
  }
  while (unfinished > 0) {
    TopicCore* topic = ready_first_;
    const bool is_of_round = topic->is_in_round();  // others became ready meanwhile
    if (is_of_round) current = topic->deliver_group(*this, current);
    if (is_of_round && !topic->is_in_round()) --unfinished;
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
    if (end != MonotonicTime::max() && (current >= end || (deadlines_.top() != nullptr && deadlines_.top()->due <= current))) {
      return Left::later;
    }
  }
  return Left::nothing;
}

void LoopCore::deliver_all() { deliver(Budget::none); }

void LoopCore::take_news() {
  if (!side_->wake.take_news()) return;
  run_posted();
  if (!attached_ && is_stopping()) uv_stop(uv_loop_);
}

void LoopCore::turn_done() noexcept {
  take_news();
  turn_is_open_ = false;
  schedule_.begin_waiting();
  start_tiers_in_turn();
  runtime.turn_done();
  if (runtime.has_injected_clock()) runtime.look_at_clock();
  if (ready_first_ != nullptr) {
    deliver(Budget::limited);
    runtime.turn_done();  // what handlers have published
  }
  if (!side_->wake.rest()) {
    start_idle();
  } else if (ready_first_ == nullptr && !turn_is_open_) {
    uv_idle_stop(&side_->idle);
  }
}

// ---- posting and running

void LoopCore::post(Callback<void()> function) {
  {
    const std::lock_guard lock(posted_mutex_);
    posted_.push_back(std::move(function));
  }
  side_->wake.send();
}

bool LoopCore::has_posted() noexcept {
  const std::lock_guard lock(posted_mutex_);
  return !posted_.empty();
}

Wake& LoopCore::wake() noexcept { return side_->wake; }

void LoopCore::call_there(Callback<void()> function) {
  std::binary_semaphore is_done{0};
  std::exception_ptr thrown;
  post([&] {
    try {
      function();
    } catch (...) {
      thrown = std::current_exception();
    }
    is_done.release();
  });
  is_done.acquire();
  if (thrown) std::rethrow_exception(thrown);
}

void LoopCore::remove(Lane& lane) noexcept {
  const auto found = std::find(all_lanes_.begin(), all_lanes_.end(), &lane);
  if (found == all_lanes_.end()) return;
  if (collecting_) {
    *found = nullptr;
  } else {
    all_lanes_.erase(found);
  }
}

void LoopCore::collect_lanes() {
  collecting_ = true;
  for (std::size_t i = 0; i < all_lanes_.size(); ++i) {
    if (all_lanes_[i] != nullptr) all_lanes_[i]->collect();
  }
  collecting_ = false;
  std::erase(all_lanes_, nullptr);
}

void LoopCore::run_posted() {
  collect_lanes();
  runtime.receive();
  {
    const std::lock_guard lock(posted_mutex_);
    running_posted_.swap(posted_);
  }
  for (Callback<void()>& function : running_posted_) {
    CallbackTimes times;
    const MonotonicTime from = now();
    begins(nullptr);
    call_user("posted function", function);
    account(times, from, now(), [] { return std::string("posted function"); });
  }
  running_posted_.clear();
}

void LoopCore::request_stop() noexcept {
  if (attached_) return;
  stop_requested_.store(true, std::memory_order_relaxed);
  side_->wake.send();
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
  if (core.is_running_) {
    throw SetupError({Errc::busy, what, "loop " + core.config.name, "it is running, and this is one of its callbacks",
                      "return from the callback; use stop(), post() or drain() there"});
  }
  core.is_running_ = true;
  core.thread_.store(std::this_thread::get_id(), std::memory_order_relaxed);
}

LoopCore::Running::~Running() {
  core_.is_running_ = false;
  core_.thread_.store(std::thread::id{}, std::memory_order_relaxed);
}

void LoopCore::run() {
  if (attached_) {
    throw SetupError({Errc::bad_argument, "cannot run", "loop " + config.name, "it is attached to the program's own loop",
                      "run that one: uv_run(loop, UV_RUN_DEFAULT)"});
  }
  const Running running(*this, "cannot run");
  start_tiers();
  if (manual_ != nullptr) {
    if (!is_stopping()) settle();
    while (!is_stopping() && holds_ > 0 && deadlines_.top() != nullptr) advance_to(deadlines_.top()->due);
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
    run_due();
    deliver_all();
    return;
  }
  const Running running(*this, "cannot poll");
  if (manual_ != nullptr) {
    settle();
    return;
  }
  run_due();
  run_posted();
  uv_run(uv_loop_, UV_RUN_NOWAIT);
  deliver_all();
}

void LoopCore::advance(Duration duration) {
  if (manual_ == nullptr) {
    throw SetupError({Errc::bad_argument, "cannot advance", "loop " + config.name, "it runs in real time",
                      "make it with rtdata::Loop::Manual{}"});
  }
  const Running running(*this, "cannot advance");
  const MonotonicTime target = later(now(), duration);
  if (!is_stopping()) settle();
  while (!is_stopping() && deadlines_.top() != nullptr && deadlines_.top()->due <= target) advance_to(deadlines_.top()->due);
  if (!is_stopping()) advance_to(target);
  forget_stop();
}

void LoopCore::advance_to(MonotonicTime target) {
  if (target > now()) manual_->pass(target - now());
  settle();
}

void LoopCore::settle() {
  // As in real time: what is due comes before deliveries, also when a handler took so long that something came due.
  Left left = Left::nothing;
  do {
    runtime.look_at_clock();
    run_due();
    run_posted();
    uv_run(uv_loop_, UV_RUN_NOWAIT);
    left = deliver(Budget::limited);
  } while (left == Left::later && !is_stopping());
}

void LoopCore::Flusher::fire(MonotonicTime) {
  core.remove(*this);
  core.runtime.flush_repeats(RuntimeCore::Repeats::old);
}

void LoopCore::flush_repeats_at(MonotonicTime due) {
  if (flusher_.is_listed()) return;
  flusher_.due = due;
  insert(flusher_);
}

Lane& LoopCore::lane(const std::string& key, Duration give_up_after) {
  for (auto& [name, lane] : lanes_) {
    if (name != key) continue;
    lane->allow(give_up_after);
    return *lane;
  }
  lanes_.emplace_back(key, std::make_unique<Lane>(*this, key, give_up_after));
  return *lanes_.back().second;
}

void LoopCore::report_hold(const std::string& name, Duration took) {
  const std::string lasted = "held the loop for " + to_string(took / 1000 * 1000);
  const std::string place = runtime.place_of(name);
  held_last_ = now();
  if (!calm_.is_listed()) {
    runtime.health_changed("loop", config.name, Health::degraded, name + " " + lasted);
    calm_.due = held_last_ + calm_after;
    insert(calm_);
  }
  runtime.report(this, name,
                 {Errc::held_too_long, lasted, (place.empty() ? "" : place + ": ") + "loop " + config.name,
                  "its limit is " + to_string(config.hold_limit),
                  "make it shorter, or do the slow part elsewhere; the ticks it cost are counted as missed"});
}

void LoopCore::Calm::fire(MonotonicTime now) {
  if (const MonotonicTime calm_at = core.held_last_ + calm_after; calm_at > now) {
    due = calm_at;
    core.moved(*this);
    return;
  }
  core.remove(*this);
  core.runtime.health_changed("loop", core.config.name, Health::ok, "");
}

std::vector<CallbackStatus> LoopCore::callbacks() const {
  std::vector<CallbackStatus> all;
  for (const Node* node = nodes_; node != nullptr; node = node->next_) {
    CallbackStatus status;
    if (!node->tell_times(status)) continue;
    status.place = runtime.place_of(status.name);
    all.push_back(std::move(status));
  }
  std::reverse(all.begin(), all.end());
  return all;
}

LoopLoad LoopCore::load() const {
  std::vector<SensorLoad> loads;
  for (const SensorEntry* sensor : runtime.sensors) {
    if (sensor->loop() != this) continue;
    if (auto load = sensor->load()) loads.push_back(std::move(*load));
  }
  return estimate_load(config.name, loads);
}

std::string LoopCore::doing() const {
  const std::lock_guard lock(doing_mutex_);
  const Node* node = doing_.load(std::memory_order_acquire);
  return node != nullptr ? node->callback_name() : std::string();
}

std::shared_ptr<CallbackSurvey> CallbackSurvey::begin(LoopCore& loop) {
  auto survey = std::make_shared<CallbackSurvey>();
  loop.post([&loop, survey] {
    loop.surveys_.push_back(survey);
    survey->next_ = loop.nodes_;
    loop.go_on(survey);
  });
  return survey;
}

void LoopCore::go_on(const std::shared_ptr<CallbackSurvey>& survey) {
  for (std::size_t i = 0; i < CallbackSurvey::most_in_turn && survey->next_ != nullptr; ++i) {
    const Node* node = std::exchange(survey->next_, survey->next_->next_);
    CallbackStatus status;
    if (!node->tell_times(status) || status.times.count == 0) continue;
    status.place = runtime.place_of(status.name);
    survey->callbacks_.push_back(std::move(status));
  }
  if (survey->next_ != nullptr) return post([this, survey] { go_on(survey); });
  std::erase(surveys_, survey);
  std::reverse(survey->callbacks_.begin(), survey->callbacks_.end());
  survey->done_.set();
}

void LoopCore::report_exception(std::string_view name, const char* what) noexcept {
  try {
    runtime.report(this, name, {Errc::handler_threw, "a callback threw", "", what, "it goes on being called"});
  } catch (...) {  // the report itself ran out of memory, or its handler threw: nothing is left to tell it to
  }
}

// ---- Node

Node::Node(LoopCore& loop) : loop_(&loop) {
  if (loop.runs_elsewhere()) {
    throw SetupError({Errc::busy, "cannot make an object", "loop " + loop.config.name, "it runs on a thread of its own",
                      "make it before the tier runs, or with tier.call([](rtdata::Loop& loop) { ... })"});
  }
  loop.link(*this);
}
Node::~Node() {
  if (loop_ != nullptr) loop_->unlink(*this);  // a constructor of a derived class threw
}

void Node::dispose() noexcept {
  LoopCore* const loop = loop_;
  if (loop != nullptr && loop->runs_elsewhere()) {
    loop->call_there([this] { dispose(); });
    return;
  }
  close();
  release();
}

void Node::close() noexcept {
  if (loop_ == nullptr || is_closing_) return;
  is_closing_ = true;  // closing may report, and the handler of the report may close it once more
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
Loop::~Loop() {
  if (own_runtime_ != nullptr) own_runtime_->on_log({});  // as for on_error
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
void Loop::on_error(Callback<void(const ErrorReport&)> handler) { core_->on_error.set(std::move(handler)); }
std::vector<CallbackStatus> Loop::callbacks() const { return core_->callbacks(); }
LoopLoad Loop::load() const { return core_->load(); }
void Loop::script_lane_duration(Duration duration) { core_->lane_duration = duration; }

ManualClock& Loop::manual_clock() {
  if (core_->manual_clock() == nullptr) {
    throw SetupError({Errc::bad_argument, "no manual clock", "loop " + config().name, "it runs in real time",
                      "make it with rtdata::Loop::Manual{}"});
  }
  return *core_->manual_clock();
}

}  // namespace rtdata
