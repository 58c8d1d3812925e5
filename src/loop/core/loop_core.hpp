// The core of a Loop: runs its members turn by turn, and knows its thread.
#pragma once

#include <atomic>
#include <exception>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <type_traits>
#include <utility>

#include "loop/core/blame.hpp"
#include "loop/core/cycle_clock.hpp"
#include "loop/core/deadlines.hpp"
#include "loop/core/deliveries.hpp"
#include "loop/core/handler.hpp"
#include "loop/core/lanes.hpp"
#include "loop/core/nodes.hpp"
#include "loop/core/posts.hpp"
#include "loop/core/schedule.hpp"
#include "loop/core/uv_handles.hpp"
#include "rtdata/loop/handle.hpp"
#include "rtdata/loop/loop.hpp"

namespace rtdata::detail {

class Latch;
class RuntimeCore;
class VirtualThreads;

class LoopCore {
 public:
  enum class Time { real, manual };
  LoopCore(Loop& face, RuntimeCore& runtime, Loop::Config config, uv_loop_t* host, Time time);
  LoopCore(const LoopCore&) = delete;
  LoopCore& operator=(const LoopCore&) = delete;
  ~LoopCore();

  Loop& face;
  RuntimeCore& runtime;
  const Loop::Config config;

 private:
  ManualClock* const manual_;
  const std::unique_ptr<VirtualThreads> own_threads_;  // of a main loop in virtual time
  VirtualThreads* const threads_;
  const bool reads_kernel_clock_;  // neither a manual clock nor an injected one
  CycleClock cycle_clock_;

 public:
  UvHandles uv;
  Deadlines deadlines{*this};
  Deliveries deliveries{*this};
  Posts posts{*this};
  Lanes lanes{*this};
  Nodes nodes{*this, threads_};
  Blame blame{*this, config.hold_limit};
  Handler<ErrorReport> on_error;

  MonotonicTime now() noexcept;
  /// The same within about 100 ns, for thousands of sensors in a row (cycle_clock.hpp).
  MonotonicTime quick_now() noexcept { return reads_kernel_clock_ ? cycle_clock_.now() : now(); }
  bool is_manual() const noexcept { return manual_ != nullptr; }
  ManualClock* manual_clock() noexcept { return manual_; }
  /// The threads of a manual loop and its tiers; null in real time.
  VirtualThreads* virtual_threads() const noexcept { return threads_; }
  /// Waits until the latch is set, at most `at_most` of the loop's time. Returns true if it is set.
  bool wait_for(const Latch& latch, Duration at_most) noexcept;
  bool is_attached() const noexcept { return uv.is_attached(); }
  Schedule& schedule() noexcept { return schedule_; }

  // Running
  void run();
  void run_for(Duration duration);
  void poll();
  void advance(Duration duration);
  /// Any thread.
  void request_stop() noexcept;
  void forget_stop() noexcept { stop_requested_.store(false, std::memory_order_relaxed); }
  /// True while the loop runs. False for an attached loop, which never runs itself.
  bool is_running() const noexcept { return is_running_; }
  /// True during set-up, when a sensor or sink may wait for its opening: the loop does not run, and the host of an
  /// attached loop has not run a turn.
  bool is_being_set_up() const noexcept { return !is_running_ && !host_has_run_; }
  /// `run` does not return while there is a reference, like uv_ref.
  void ref() noexcept;
  void unref() noexcept;

  // The steps of a turn, which the handles of libuv call, too
  /// Fires all deadlines that are due now. Within a callback of a deadline: nothing.
  void run_due();
  void turn_ended() noexcept;
  /// Called when other threads have sent data.
  void woken();
  void clock_was_set();
  void deliver_all() { deliveries.deliver(Deliveries::Budget::none); }
  /// The start time of schedules that are started in this turn.
  MonotonicTime turn_start() noexcept;
  /// Makes sure that there is a turn for waiting schedules to begin; an attached loop does not know when it will run.
  void wake_for_waiting() noexcept {
    if (is_attached()) uv.forbid_sleep();
  }

  /// Any thread.
  void post(Callback<void()> function) { posts.add(std::move(function)); }
  enum class Begun { is_awaited, is_given_up };
  enum class Called { done, not_begun, not_ended };
  /// Runs the function on the loop's bound thread and waits for it; throws its exception. If the loop does not turn
  /// within 1 s: SetupError (not-turning), and the function is never called. Once the function has begun, waits without
  /// limit. Thread: that of the main loop.
  void call_there(Callback<void()> function) { call_there(std::move(function), Begun::is_awaited); }
  /// The same, and returns its result. The function must own everything it uses, because the wait also ends after 1 s
  /// if it has begun: SetupError (not-turning), and the result is unknown.
  template <class Function>
  auto ask_there(Function function) {
    auto answer = std::make_shared<std::optional<std::invoke_result_t<Function&>>>();
    call_there([answer, function = std::move(function)]() mutable { answer->emplace(function()); }, Begun::is_given_up);
    return std::move(**answer);
  }
  /// `not_begun`: it has not turned for `at_most`, and the function is never called.
  Called call_there_within(Duration at_most, Callback<void()> function, Begun begun);
  /// Any thread: notes that the loop turns.
  void note_turning() noexcept { stands_since_.store(never, std::memory_order_release); }
  /// True if the loop is known not to turn.
  bool is_standing() const noexcept { return stands_since_.load(std::memory_order_acquire) != never; }
  /// Notes that the loop does not turn. Thread: that of the main loop.
  void note_standing(MonotonicTime since) noexcept {
    stands_since_.store(since.time_since_epoch().count(), std::memory_order_release);
  }

  // Threads
  /// A tier's loop belongs to its thread, also between two runs.
  void bind_to_this_thread() noexcept { bound_to_.store(std::this_thread::get_id(), std::memory_order_relaxed); }
  /// With release order: a thread that sees the loop unbound sees all writes of the tier's thread.
  void unbind() noexcept { bound_to_.store(std::thread::id{}, std::memory_order_release); }
  bool is_bound_to_this_thread() const noexcept {
    return bound_to_.load(std::memory_order_acquire) == std::this_thread::get_id();
  }
  bool runs_elsewhere() const noexcept {
    const std::thread::id thread = bound_to_.load(std::memory_order_acquire);
    return thread != std::thread::id{} && thread != std::this_thread::get_id();
  }
  void assert_thread() const noexcept;
  /// SetupError (busy) on any other thread than the loop's. An attached loop does not know its thread.
  void check_thread(const char* what, std::string_view object) const {
    if (is_run_by_another_thread()) [[unlikely]]
      refuse_thread(what, object);
  }
  /// Also true on a thread of the runtime's lanes, which continue while the loop does not run.
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
  /// Brackets lane code that runs on the loop's thread: meanwhile the loop refuses every function that only its own
  /// thread may use.
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

  // Calls of code that may throw
  /// Calls user code: an exception is reported under the name and not passed on.
  template <class Function>
  void call_user(std::string_view name, Function&& function) noexcept {
    const Calling calling(runtime);
    try {
      function();
    } catch (const std::exception& e) {
      report_exception(name, reason_of(e));
    } catch (...) {
      report_exception(name, "an exception that is not a std::exception");
    }
  }
  /// Calls code of this library, which throws without memory. False: it threw, which is reported in the same way.
  template <class Function>
  bool call_own(std::string_view name, Function&& function) noexcept {
    bool has_ended = false;
    call_user(name, [&] {
      function();
      has_ended = true;
    });
    return has_ended;
  }
  void report_exception(std::string_view name, std::string_view what) noexcept;
  /// Brackets user code that is called outside deadlines and deliveries: meanwhile the loop must not be run or
  /// destroyed.
  class Calling {
   public:
    explicit Calling(RuntimeCore& of) noexcept;
    Calling(const Calling&) = delete;
    Calling& operator=(const Calling&) = delete;
    ~Calling();

   private:
    RuntimeCore& runtime_;
  };
  /// A callback of a deadline or a delivery is on the stack.
  bool is_in_callback() const noexcept { return deadlines.is_firing() || deliveries.is_delivering(); }
  /// True if user code called by this loop or one of its objects is on the stack.
  bool is_in_user_code() const noexcept;

  // The end
  /// Ends the program with a message if the loop must not be destroyed now.
  void check_may_end() const noexcept;
  bool is_ending() const noexcept { return is_ending_; }
  void begin_ending() noexcept { is_ending_ = true; }
  /// SetupError (busy) while it is being destroyed.
  void check_not_ending(const char* what) const;
  /// Closes all objects on it. From here on errors do not reach the user's handler.
  void close_nodes() noexcept;
  /// Closes, in the next turn, a handle that was closed on a wrong thread, and reports it.
  void dispose_later(Node& node) noexcept;
  /// The same for a handle whose loop does not turn.
  void dispose_when_it_turns(Node& node) noexcept;

 private:
  /// Brackets running the loop on this thread. SetupError if it runs already.
  class Running {
   public:
    Running(LoopCore& core, const char* what);
    Running(const Running&) = delete;
    Running& operator=(const Running&) = delete;
    ~Running();

   private:
    LoopCore& core_;
  };
  struct CallThere;
  void call_there(Callback<void()> function, Begun begun);
  /// Waits until the call is done, or gives it up after `at_most`.
  Called wait_for(CallThere& call, Duration at_most, Begun begun);
  /// The running callback, as text for messages.
  std::string where() const;
  void post_disposal(Node& node, Error why) noexcept;
  [[noreturn, gnu::cold]] void refuse_thread(const char* what, std::string_view object) const;
  bool is_stopping() const noexcept { return stop_requested_.load(std::memory_order_relaxed); }
  /// Processes data from other threads and runs posted functions until `end`. True: some are left.
  bool take_sent(MonotonicTime end);
  void take_news();
  MonotonicTime end_of_budget() noexcept { return later(now(), config.delivery_budget); }
  /// One turn of libuv, without waiting.
  void look_at_io();
  // In virtual time
  void begin_instant() noexcept;
  /// Advances virtual time; the maximum means until another loop sends something. False: nothing will ever happen.
  bool advance_to(MonotonicTime target);
  bool has_running_tiers() const noexcept;
  void settle();

  Schedule schedule_{*this};
  bool is_running_ = false;
  bool host_has_run_ = false;  // of an attached loop
  bool is_ending_ = false;
  MonotonicTime turn_start_{};
  bool turn_is_open_ = false;
  std::size_t refs_ = 0;
  int turns_ = 0;  // of a manual loop at this instant
  std::atomic<bool> stop_requested_{false};
  /// A different value on each thread; unlike std::this_thread::get_id without a function call.
  static const void* this_thread() noexcept {
#ifdef __GLIBC__  // other systems may refuse to load a library with it after the start
    [[gnu::tls_model("initial-exec")]]
#endif
    static thread_local char own;
    return &own;
  }
  std::atomic<const void*> thread_{nullptr};  // the thread that runs the loop
  std::atomic<std::thread::id> bound_to_{};
  static constexpr Duration::rep never = -1;
  std::atomic<Duration::rep> stands_since_{never};  // by the main loop's clock
};

}  // namespace rtdata::detail
