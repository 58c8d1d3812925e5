// The threads of a main loop and its tiers in virtual time: one of them runs at a time, in an order that a seed
// chooses.
//
// Each tier has its own thread, so that it can wait in the middle of a callback, but only the thread with the turn
// runs, until it waits. A loop that begins to wait chooses the next one. Virtual time passes only when all wait: to the
// earliest time that one of them waits for.
//
// The choices depend only on the seed. A thread must not wait for another in any other way: it would keep the turn and
// wait for ever.
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

/// Owner: the main loop's core. Called by the thread that may run now, unless a function says otherwise.
class VirtualThreads {
 public:
  /// One virtual thread. Owned by the tier; it must outlive the thread.
  class Thread {
   private:
    friend class VirtualThreads;
    std::thread::id id;
    MonotonicTime until{};                            // the thread waits no longer than this
    const std::function<bool()>* is_ready = nullptr;  // or until this is true
    std::optional<MonotonicTime> ready_at;            // from when it may run
    bool sees_at_once = true;
    bool is_last = false;  // runs only if no other can run at this instant
    bool nothing_comes = false;
    std::condition_variable turn;
  };

  /// The caller must be the main loop's thread; it gets the turn.
  explicit VirtualThreads(ManualClock& clock);
  ~VirtualThreads();
  VirtualThreads(const VirtualThreads&) = delete;
  VirtualThreads& operator=(const VirtualThreads&) = delete;

  /// Call it before the first choice.
  void choose_by(const Loop::Manual& config);
  bool has_others() const noexcept { return threads_.size() > 1; }

  // ---- a thread that begins and ends
  /// Call it before the thread is started: it then gets turns.
  void add(Thread& thread);
  /// Call it if the thread could not be started.
  void remove(Thread& thread) noexcept;
  /// The first call of a thread: waits for its first turn.
  void begin(Thread& thread) noexcept;
  /// The last call of a thread: gives its turn away permanently.
  void end(Thread& thread) noexcept;

  // ---- on the thread that has the turn
  /// Waits until this time, or until `is_ready`. False (only on the main loop's thread): neither will ever happen,
  /// because all others wait for ever too.
  bool wait(MonotonicTime until, const std::function<bool()>& is_ready) noexcept;
  /// The same for an idle loop: the seed chooses the delay after which it sees data from others.
  bool wait_for_news(MonotonicTime until, const std::function<bool()>& has_news) noexcept;
  /// Lets the others do all their work at this instant.
  void wait_for_others() noexcept;
  /// Takes `duration` of virtual time; the others run meanwhile.
  void sleep(Duration duration) noexcept;
  /// A preemption point: with a seed another thread may run first.
  void preempt() noexcept;
  /// A random additional delay; 0 without a seed.
  Duration choose_delay() noexcept;
  /// False without a seed.
  bool choose() noexcept { return seed_ != 0 && random_() % 2 == 0; }

 private:
  Thread& self() noexcept;
  /// Lets time pass until a thread can run; null: none ever can.
  Thread* choose_next() noexcept;
  void hand_over(Thread& from) noexcept;
  void pass_turn_on(Thread* to) noexcept;

  ManualClock& clock_;
  std::uint64_t seed_ = 0;
  Duration jitter_{0};
  std::mt19937_64 random_;
  Thread main_;
  std::vector<Thread*> threads_;   // the main loop's first, then in order of start
  std::vector<Thread*> runnable_;  // at the instant that is looked at
  std::size_t last_ = 0;           // index of the thread that was chosen last at this instant
  unsigned choices_ = 0;           // at this instant
  std::mutex mutex_;
  Thread* has_turn_ = &main_;               // guarded by the mutex
  std::atomic<std::thread::id> running_{};  // the thread that has the turn
};

}  // namespace rtdata::detail
