// What lies behind a Loop.
#pragma once

#include <uv.h>

#include <sched.h>

#include <atomic>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "loop/cycle_clock.hpp"
#include "loop/deadline.hpp"
#include "loop/handler.hpp"
#include "loop/priority_mutex.hpp"
#include "loop/schedule.hpp"
#include "loop/wake.hpp"
#include "rtdata/loop/handle.hpp"
#include "rtdata/loop/loop.hpp"

namespace rtdata::detail {

class RuntimeCore;
class CallbackSurvey;
class TopicCore;
class Lane;
class Latch;
class VirtualThreads;

class LoopCore {
 public:
  enum class Time { real, manual };
  LoopCore(Loop& face, RuntimeCore& runtime, Loop::Config config, uv_loop_t* host, Time time);
  ~LoopCore();

  Loop& face;
  RuntimeCore& runtime;
  const Loop::Config config;

  MonotonicTime now() noexcept;
  /// The same to some 100 ns, for one after the other of thousands (cycle_clock.hpp).
  MonotonicTime quick_now() noexcept { return reads_kernel_clock_ ? cycle_clock_.now() : now(); }
  bool is_manual() const noexcept { return manual_ != nullptr; }
  bool is_attached() const noexcept { return attached_; }
  /// Between the begin and the end of running. An attached loop cannot know: it never runs.
  bool is_running() const noexcept { return is_running_; }
  /// A callback of a deadline or a delivery is on the stack.
  bool is_in_callback() const noexcept { return firing_ || delivering_; }
  /// Code of the user's is on the stack that this loop, or an object on it, has called and goes on after.
  bool is_in_user_code() const noexcept;
  /// Brackets such code, where it is neither a deadline's nor a delivery's: the loop is not run in it, nor destroyed.
  class Calling {
   public:
    explicit Calling(RuntimeCore& of) noexcept;
    Calling(const Calling&) = delete;
    Calling& operator=(const Calling&) = delete;
    ~Calling();

   private:
    RuntimeCore& runtime_;
  };
  /// Ends the program, having said why, when the loop may not be destroyed now.
  void check_may_end() const noexcept;
  ManualClock* manual_clock() noexcept { return manual_; }
  /// Those of a manual loop and its tiers; null in real time.
  VirtualThreads* virtual_threads() const noexcept { return threads_; }
  /// Whether it is set, waited for at most so long; in the loop's time.
  bool wait_for(const Latch& latch, Duration at_most) noexcept;
  uv_loop_t* uv() noexcept { return uv_loop_; }

  // Running
  void run();
  void run_for(Duration duration);
  void poll();
  void request_stop() noexcept;
  void advance(Duration duration);
  void post(Callback<void()> function);
  void forget_stop() noexcept { stop_requested_.store(false, std::memory_order_relaxed); }

  // Deadlines
  /// For each deadline that there is on this loop, so that none asks for memory when it is inserted. Throws, with nothing
  /// changed.
  void add_deadline();
  void drop_deadline() noexcept { --deadline_count_; }
  void insert(Deadline& deadline) noexcept;
  void remove(Deadline& deadline) noexcept;
  void moved(Deadline& deadline) noexcept;
  Schedule& schedule() noexcept { return schedule_; }
  /// Schedules wait: on an attached loop, makes sure that a turn comes.
  void wake_for_waiting() noexcept {
    if (attached_) start_idle();
  }
  /// The instant at which what is started in this turn begins.
  MonotonicTime turn_start() noexcept;
  /// Up to here every due tick has been fired or counted.
  MonotonicTime handled_until() const noexcept { return handled_until_; }
  /// Fires all that is due now. Within a callback of a deadline: nothing.
  void run_due();

  // Deliveries
  void add_ready(TopicCore& topic);
  void deliver_all();

  // A tier's loop belongs to its thread, also between two runs.
  void bind_to_this_thread() noexcept { bound_to_.store(std::this_thread::get_id(), std::memory_order_relaxed); }
  /// What the thread did is seen by who sees that it has gone.
  void unbind() noexcept { bound_to_.store(std::thread::id{}, std::memory_order_release); }
  bool is_bound_to_this_thread() const noexcept {
    return bound_to_.load(std::memory_order_acquire) == std::this_thread::get_id();
  }
  bool runs_elsewhere() const noexcept {
    const std::thread::id thread = bound_to_.load(std::memory_order_acquire);
    return thread != std::thread::id{} && thread != std::this_thread::get_id();
  }
  /// Runs the function on the thread that the loop is bound to, and waits for it; what it throws is thrown here.
  void call_there(Callback<void()> function);

  /// `run` does not return while there is a reference, as with uv_ref.
  void ref() noexcept;
  void unref() noexcept;

  /// Adds what a callback took and reports one that held the loop too long: then returns true.
  template <class Named>
  bool time_callback(CallbackTimes& times, MonotonicTime from, MonotonicTime to, const Named& name) {
    const Duration took = to - from;
    times.add(took);
    if (took <= config.hold_limit) [[likely]]
      return false;
    ++times.held;
    call_own("loop", [&] { report_hold(name(), took); });
    return true;
  }
  std::vector<CallbackStatus> callbacks() const;
  LoopLoad load() const;
  /// Reports that were held back are written at `due`.
  void flush_repeats_at(MonotonicTime due) noexcept;
  void report_hold(const std::string& name, Duration took) noexcept;
  void report_exception(std::string_view name, const char* what) noexcept;
  /// Calls user code: an exception is reported under the name and goes no further.
  template <class Function>
  void call_user(std::string_view name, Function&& function) noexcept {
    const Calling calling(runtime);
    try {
      function();
    } catch (const std::exception& e) {
      report_exception(name, e.what());
    } catch (...) {
      report_exception(name, "an exception that is no std::exception");
    }
  }
  /// The same, of what is ours: it throws when there is no memory. False: it did.
  template <class Function>
  bool call_own(std::string_view name, Function&& function) noexcept {
    bool has_ended = false;
    call_user(name, [&] {
      function();
      has_ended = true;
    });
    return has_ended;
  }
  void assert_thread() const noexcept;
  /// SetupError (busy) on another thread than that which runs the loop. Nobody knows who runs an attached one.
  void check_thread(const char* what, std::string_view object) const {
    if (is_run_by_another_thread()) [[unlikely]]
      refuse_thread(what, object);
  }
  /// Or this thread is one of the runtime's lanes: these go on while the loop does not run.
  bool is_run_by_another_thread() const noexcept {
    const void* running = thread_.load(std::memory_order_relaxed);
    return running != nullptr ? running != this_thread() : lane_of() == &runtime;
  }
  /// The runtime whose lane this thread is; null on all others.
  static const void*& lane_of() noexcept {
#ifdef __GLIBC__
    [[gnu::tls_model("initial-exec")]]
#endif
    static thread_local const void* own = nullptr;
    return own;
  }
  /// Brackets user code that belongs on a lane and runs on this thread: meanwhile nothing of the loop may be used but what
  /// any thread may use.
  class OffLimits {
   public:
    explicit OffLimits(LoopCore& core) noexcept : core_(core), before_(core.thread_.exchange(this)) {}
    OffLimits(const OffLimits&) = delete;
    OffLimits& operator=(const OffLimits&) = delete;
    ~OffLimits() { core_.thread_.store(before_, std::memory_order_relaxed); }

   private:
    LoopCore& core_;
    const void* const before_;
  };
  /// For a handle that is let go of where it may not be.
  void dispose_later(Node& node) noexcept;
  /// It is being destroyed.
  bool is_ending() const noexcept { return is_ending_; }
  void begin_ending() noexcept { is_ending_ = true; }
  /// SetupError (busy) while it is being destroyed.
  void check_not_ending(const char* what) const;

  /// Lanes by key: one per physical device; made when first asked for.
  Lane& lane(const std::string& key, Duration give_up_after);
  Wake& wake() noexcept;
  // Lanes list themselves, to be told of finished jobs.
  void add(Lane& lane) { all_lanes_.push_back(&lane); }
  void remove(Lane& lane) noexcept;
  Duration lane_duration{0};
  /// Where threads of lanes may run, when the loop's own thread is bound to less.
  std::optional<cpu_set_t> worker_cpus;
  Handler<ErrorReport> on_error;

  /// A callback of the node begins; null: one that has no name.
  void begins(const Node* node) noexcept {
    doing_.store(node, std::memory_order_release);
    if (threads_ != nullptr) [[unlikely]]
      preempt();
  }
  /// The name of the callback that began last; empty when that is not known. Any thread.
  std::string doing() const;
  /// Goes on with a survey, on the loop's thread.
  void go_on(const std::shared_ptr<CallbackSurvey>& survey);
  /// Changes a name that `doing` may be reading.
  void rename(std::string& name, std::string to) noexcept {
    const std::lock_guard lock(doing_mutex_);
    name.swap(to);
  }

  /// Closes all that is on it. Errors in it no longer reach the user's handler.
  void close_nodes() noexcept;

  // Nodes list themselves.
  void link(Node& node) noexcept;
  void unlink(Node& node) noexcept;

 private:
  friend class CallbackSurvey;
  struct UvSide;  // what libuv keeps until its close callbacks have run
  enum class Budget { limited, none };
  /// Brackets the time in which this thread runs the loop. SetupError when it runs already.
  class Running {
   public:
    Running(LoopCore& core, const char* what);
    Running(const Running&) = delete;
    Running& operator=(const Running&) = delete;
    ~Running();

   private:
    LoopCore& core_;
  };
  struct Flusher final : Deadline {
    explicit Flusher(LoopCore& core_) : core(core_) {}
    void fire(MonotonicTime now) override;
    LoopCore& core;
  };
  /// The loop is ok again some time after it was held last.
  struct Calm final : Deadline {
    explicit Calm(LoopCore& core_) : core(core_) {}
    void fire(MonotonicTime now) override;
    LoopCore& core;
  };
  [[noreturn, gnu::cold]] void refuse_thread(const char* what, std::string_view object) const;
  void make_side();
  void watch_clock();
  void arm_clock() noexcept;
  void settle();
  /// One turn of libuv's, without waiting.
  void look_at_io();
  bool is_stopping() const noexcept { return stop_requested_.load(std::memory_order_relaxed); }
  /// What a delivery has left in the queues.
  enum class Left {
    nothing,
    later,   // its time was up
    circle,  // handlers went on publishing for each other
  };
  Left deliver(Budget budget);
  /// Delivers what was queued when the round began.
  Left deliver_round(MonotonicTime& current, MonotonicTime end);
  bool is_something_due(MonotonicTime now) const noexcept {
    return deadlines_.top() != nullptr && has_come(deadlines_.top()->due, now);
  }
  void arm() noexcept;
  void spin_until_due() noexcept;
  void run_posted();
  /// Takes no more, and destroys what was not run.
  void drop_posted() noexcept;
  /// What other threads have sent.
  void take_news();
  /// The main loop's.
  void start_tiers();
  void start_tiers_in_turn() noexcept;
  void collect_lanes();
  bool has_posted() noexcept;
  void start_idle() noexcept;
  void turn_done() noexcept;
  /// The end of time: until another loop sends something. False: nothing ever happens.
  bool advance_to(MonotonicTime target);
  bool has_running_tiers() const noexcept;
  void preempt() noexcept;
  void begin_advancing() noexcept;
  /// The first deadline, if it ever comes.
  std::optional<MonotonicTime> next_due() const noexcept;

  uv_loop_t* uv_loop_ = nullptr;
  uv_loop_t own_loop_{};
  bool attached_ = false;
  ManualClock* manual_ = nullptr;
  std::unique_ptr<VirtualThreads> own_threads_;  // the main loop's
  VirtualThreads* threads_ = nullptr;
  bool reads_kernel_clock_;  // neither a manual clock nor an injected one
  CycleClock cycle_clock_;
  UvSide* side_ = nullptr;
  DeadlineHeap deadlines_;
  std::size_t deadline_count_ = 0;  // that there are, in the heap or not
  Schedule schedule_{*this};
  MonotonicTime armed_for_{};
  MonotonicTime turn_start_{};
  MonotonicTime handled_until_{};
  bool turn_is_open_ = false;
  bool firing_ = false;
  MonotonicTime firing_until_{};
  std::vector<Deadline*> next_round_;  // inserted while firing and due already
  Flusher flusher_{*this};
  Calm calm_{*this};
  MonotonicTime held_last_{};
  bool is_running_ = false;
  std::size_t refs_ = 0;

  // topics with pending deliveries, first to last
  TopicCore* ready_first_ = nullptr;
  TopicCore* ready_last_ = nullptr;
  bool delivering_ = false;
  bool round_is_open_ = false;  // a delivery has ended within it
  int rounds_ = 0;              // of deliveries in this turn; on a manual loop, at this instant
  int turns_ = 0;               // of a manual loop at this instant

  Node* nodes_ = nullptr;
  std::vector<std::shared_ptr<CallbackSurvey>> surveys_;  // under way
  std::atomic<const Node*> doing_{nullptr};
  mutable PriorityMutex doing_mutex_;  // a node that is read by `doing` is not taken away
  std::vector<std::pair<std::string, std::unique_ptr<Lane>>> lanes_;
  std::vector<Lane*> all_lanes_;  // null: removed while they are told
  bool collecting_ = false;

  PriorityMutex posted_mutex_;
  std::vector<Callback<void()>> posted_;
  std::vector<Callback<void()>> running_posted_;
  bool takes_posts_ = true;  // guarded by the mutex
  bool is_ending_ = false;
  std::atomic<bool> stop_requested_{false};
  /// Another value on each thread; unlike std::this_thread::get_id without a call.
  static const void* this_thread() noexcept {
#ifdef __GLIBC__  // others may refuse to load a library with it later than at the start
    [[gnu::tls_model("initial-exec")]]
#endif
    static thread_local char own;
    return &own;
  }
  std::atomic<const void*> thread_{nullptr};
  std::atomic<std::thread::id> bound_to_{};
};

}  // namespace rtdata::detail
