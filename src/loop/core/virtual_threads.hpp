// The threads of a main loop and its tiers in virtual time: one of them runs at a time, in an order that a seed
// chooses.
//
// Each tier keeps a thread of its own, so that it can wait in the middle of a callback; but only the thread that has
// the turn runs, until it waits. A loop that begins to wait chooses the next one to run. Virtual time passes only when
// all wait: to the earliest instant that one of them waits for.
//
// The same seed makes the same choices, since there is nothing else that they depend on. A thread must not wait in any
// other way for what another one is to do: it would wait for ever, with the turn.
#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <optional>
#include <random>
#include <thread>
#include <vector>

#include "rtdata/loop/clock.hpp"
#include "rtdata/loop/loop.hpp"

namespace rtdata::detail {

/// Owner: the main loop's core. Thread: see each function; the one that has the turn.
class VirtualThreads {
 public:
  /// One of them. Owned by the tier; it must outlive the thread.
  class Thread {
   private:
    friend class VirtualThreads;
    std::thread::id id;
    MonotonicTime until{};                            // it waits no longer
    const std::function<bool()>* is_ready = nullptr;  // or until this is true
    std::optional<MonotonicTime> ready_at;            // from when on it acts upon that
    bool sees_at_once = true;
    bool is_last = false;  // only when no other one can run at this instant
    bool nothing_comes = false;
    std::condition_variable turn;
  };

  /// The caller's thread is the main loop's, and has the turn.
  explicit VirtualThreads(ManualClock& clock);
  ~VirtualThreads();
  VirtualThreads(const VirtualThreads&) = delete;
  VirtualThreads& operator=(const VirtualThreads&) = delete;

  /// Before anything is chosen.
  void choose_by(const Loop::Manual& config);
  bool has_others() const noexcept { return threads_.size() > 1; }

  // ---- a thread that begins and ends
  /// Before it is started: from here on it gets turns.
  void add(Thread& thread);
  /// It could not be started after all.
  void remove(Thread& thread) noexcept;
  /// The first that it calls: waits for its first turn.
  void begin(Thread& thread) noexcept;
  /// The last that it calls: gives its turn away for good.
  void end(Thread& thread) noexcept;

  // ---- on the thread that has the turn
  /// Waits until this instant, or until `is_ready`. False: neither ever comes, since all others wait for ever as well;
  /// on the main loop's thread alone.
  bool wait(MonotonicTime until, const std::function<bool()>& is_ready) noexcept;
  /// The same for a loop with nothing to do: the seed chooses how much later it sees what others have sent.
  bool wait_for_news(MonotonicTime until, const std::function<bool()>& has_news) noexcept;
  /// Lets the others do all that they can do at this instant.
  void wait_for_others() noexcept;
  /// This thread takes `duration` of virtual time, in which the others run.
  void sleep(Duration duration) noexcept;
  /// A point at which the processor may be taken away: with a seed another thread may run first.
  void preempt() noexcept;
  /// How much longer something takes than it has to; without a seed nothing.
  Duration choose_delay() noexcept;
  /// Without a seed: false.
  bool choose() noexcept { return seed_ != 0 && random_() % 2 == 0; }

 private:
  Thread& self() noexcept;
  /// Lets time pass until one can run. Null: none ever can.
  Thread* choose_next() noexcept;
  void hand_over(Thread& from) noexcept;
  void pass_turn_on(Thread* to) noexcept;

  ManualClock& clock_;
  std::uint64_t seed_ = 0;
  Duration jitter_{0};
  std::mt19937_64 random_;
  Thread main_;
  std::vector<Thread*> threads_;   // the main loop's first, then in the order in which they were started
  std::vector<Thread*> runnable_;  // at the instant that is looked at
  std::size_t last_ = 0;           // index of the thread that was chosen last at this instant
  unsigned choices_ = 0;           // at this instant
  std::mutex mutex_;
  Thread* has_turn_ = &main_;               // guarded by the mutex
  std::atomic<std::thread::id> running_{};  // the thread that has the turn, as far as it has waited yet
};

}  // namespace rtdata::detail
