// The implementation of a Tier: a thread that runs a loop.
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
  /// Starts it when the main loop turns, unless it runs.
  void start_first() {
    if (!was_started_) start();
  }
  /// Asks the thread to end, and waits for it.
  void stop() noexcept;
  /// The same, but waits at most this long; false: the running callback has not returned.
  bool stop_within(Duration at_most) noexcept;
  /// The callback that it is in, as text for messages: "sensor chamber".
  std::string where();
  bool is_running() noexcept;
  /// It runs, and this is its thread.
  bool is_on_its_thread() noexcept { return loop.core().is_bound_to_this_thread(); }
  /// True where waiting is not possible: on its thread, or in a call of a sink's Writer.
  bool may_only_ask() noexcept;
  /// Ends the program with a message if the tier must not be destroyed now.
  void check_may_end() noexcept;
  /// While it runs.
  pthread_t native_thread() noexcept { return thread_.native_handle(); }
  void call(Callback<void()> function);
  /// Drains its loop on its thread, then calls `done` on the main loop: at once if it does not run; in the next turn if
  /// it is stopped or destroyed meanwhile.
  void drain(Duration deadline, Callback<void()> done);
  /// If it does not run: ends its pending drains here.
  void finish_drains();

  // On the main loop, one after the other
  /// Asks the tier for the accounts of all its sensors.
  void ask_account();
  /// Waits for the answer, and takes all data of the tier up to the instant of the answer. Asks again if the ring had
  /// no space for everything, or if later data was taken already.
  void wait_for_account(Duration at_most);
  /// True if exactly the data up to the instant of its answer was taken.
  bool has_whole_account() noexcept;
  /// Adds a text about missing data if it does not answer: "tier fast did not come out of sensor a: what its sensors
  /// did after ... is not known". Joins the texts of several tiers.
  void add_unknown(std::string& to);

  /// A drain no longer waits for it: its data is missing until its callback returns or it is stopped.
  void give_up();
  bool is_known() const noexcept { return unknown_->text.empty(); }
  /// The text of `add_unknown` at `give_up`.
  const std::string& unknown() const noexcept { return unknown_->text; }

  // For Runtime, on the main loop; while it runs, the state of its last drain.
  bool balances() {
    if (!is_running()) return runtime.balances();
    return is_known() && was_balanced_.load(std::memory_order_acquire);
  }
  bool has_loss() { return is_running() ? had_loss_.load(std::memory_order_acquire) : runtime.has_loss(); }

  /// True if it has answered within the limit; then asks again. On the main loop.
  bool look_at_turning(Duration limit);
  /// True if it was stuck at the last check and has not answered since.
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
  /// Called on its thread; notifies the waiting main loop.
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
