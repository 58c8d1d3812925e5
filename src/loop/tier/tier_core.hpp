// What lies behind a Tier: a thread that runs a loop.
#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "loop/core/latch.hpp"
#include "loop/core/virtual_threads.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::detail {

class Bridge;

class TierCore {
 public:
  TierCore(Loop& main, Tier::Config config);
  ~TierCore();
  TierCore(const TierCore&) = delete;
  TierCore& operator=(const TierCore&) = delete;

  void start();
  /// The main loop turns: starts it, unless it runs.
  void start_first() {
    if (!was_started_) start();
  }
  /// Asks the thread to end, and waits for it.
  void stop() noexcept;
  /// The same, but waits no longer than this: false when the callback under way has not returned.
  bool stop_within(Duration at_most) noexcept;
  /// The callback that it is in, for people: "sensor chamber".
  std::string where();
  bool is_running() noexcept;
  /// It runs, and this is its thread.
  bool is_on_its_thread() noexcept { return loop.core().is_bound_to_this_thread(); }
  /// It is stopped where waiting is not possible: on its thread, or in a call of a sink's Writer.
  bool may_only_ask() noexcept;
  /// Ends the program, having said why, when the tier may not be destroyed now.
  void check_may_end() noexcept;
  /// While it runs.
  pthread_t native_thread() noexcept { return thread_.native_handle(); }
  void call(Callback<void()> function);
  /// Drains its loop, on its thread; then `done` is called on the main loop. At once when it does not run; when it is
  /// stopped or destroyed before, in the next turn.
  void drain(Duration deadline, Callback<void()> done);
  /// Unless it runs: ends the drains that it did not come to, here.
  void finish_drains();

  // On the main loop, one after the other
  /// Asks the tier to tell how all its sensors do.
  void ask_account();
  /// Waits for the answer, and takes what the tier has sent up to the instant of that answer. Asks it again when
  /// there was no room for all it had to tell, or when more was taken already.
  void hear_out(Duration at_most);
  /// All that it has sent up to the instant of its answer was taken, and nothing after it.
  bool is_heard_out() noexcept;
  /// Adds what is not known of it, since it does not answer: "tier fast did not come out of sensor a: what its sensors
  /// did after ... is not known". Texts of several are joined.
  void add_unknown(std::string& to);

  /// A drain no longer waits for it: what it did is not known until it has come out after all, or was stopped.
  void give_up();
  bool is_known() const noexcept { return unknown_->text.empty(); }
  /// See `add_unknown`, as of `give_up`.
  const std::string& unknown() const noexcept { return unknown_->text; }

  // On the main loop, what Runtime says of it: while it runs, what it said when it was drained last.
  bool balances() {
    if (!is_running()) return runtime.balances();
    return is_known() && was_balanced_.load(std::memory_order_acquire);
  }
  bool has_loss() { return is_running() ? had_loss_.load(std::memory_order_acquire) : runtime.has_loss(); }

  /// Whether it has answered within the limit; asks again when it has. On the main loop.
  bool look_at_turning(Duration limit);
  /// As of the last look, and it has not answered since.
  bool is_stuck() const noexcept { return is_stuck_ && answered_.load(std::memory_order_acquire) != asked_; }

  const Tier::Config config;
  Loop& main;
  Runtime runtime;
  Loop loop;
  Scheduling scheduling;  ///< what it runs with, once started
  std::vector<std::string> warnings;

 private:
  struct Answer;
  /// Of the main loop, and shared with the tier, which may be late.
  struct Drain {
    Callback<void()> done;  // empty: it is done
    MonotonicTime deadline;
  };
  struct Unknown {
    std::string text;               // empty: all is known
    std::shared_ptr<Drain> latest;  // that it was asked for when it was given up
  };
  void make_bridges();
  Bridge& bridge_to_main() noexcept;
  void go_on(const std::shared_ptr<Drain>& drain);
  /// On its thread; what waits for it goes on on the main loop.
  void send_last_accounts();
  static void end(Drain& drain);
  void run();
  void join() noexcept;
  /// After `stop`; it runs on where it was.
  void start_again() noexcept;
  void set_up_thread();
  void warn(const Error& error);

  // To and from it; those between it and a later tier are the later one's.
  std::vector<std::unique_ptr<Bridge>> bridges_;
  std::thread thread_;
  VirtualThreads::Thread virtual_thread_;  // on a manual loop
  bool was_started_ = false;
  Timer sending_;
  std::vector<std::shared_ptr<Drain>> sending_for_;  // the tier's: drains that wait for the last accounts
  std::vector<std::shared_ptr<Drain>> drains_;       // the main loop's
  const std::shared_ptr<Unknown> unknown_ = std::make_shared<Unknown>();
  std::atomic<bool> quit_{false};
  Latch ended_;                    // its thread is about to end
  std::vector<std::string> told_;  // warnings that the next start does not repeat
  std::atomic<bool> was_balanced_{true};
  std::atomic<bool> had_loss_{false};
  std::uint64_t asked_ = 0;  // questions whether it turns
  std::atomic<std::uint64_t> answered_{0};
  MonotonicTime asked_at_{};
  bool is_stuck_ = false;
  std::shared_ptr<Answer> answer_;  // to `ask_account`; shared with the tier, which may be late
  int latency_fd_ = -1;
};

}  // namespace rtdata::detail
