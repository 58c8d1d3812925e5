// The interface of the program and its guard: a table of times in shared memory, a socket to introduce outputs, and a
// socket for each output.
#pragma once

#include <sys/types.h>

#include <array>
#include <atomic>
#include <cstdint>
#include <cstring>
#include <list>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "data/fitting.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/outputs/guard.hpp"

namespace rtdata {
namespace detail {

inline constexpr std::size_t most_guarded = OutputGuard::most_outputs;
/// More than `check` counts: includes settings that are not in the file.
inline constexpr std::size_t most_guarded_text = OutputGuard::most_bytes + 8192;

/// In ns of CLOCK_MONOTONIC. A line of cache each.
struct alignas(64) GuardBeat {
  std::atomic<std::int64_t> until{0};  // until when the guard waits for the output's loop
  std::atomic<std::int64_t> seen{0};   // when the guard last checked that, which it does while the output is not safe
};
static_assert(std::atomic<std::int64_t>::is_always_lock_free, "two processes share it");

/// How long the guard waits for an output's loop that does not turn; in this process only.
struct GuardPatience {
  std::atomic<const Loop*> loop{nullptr};
  std::atomic<std::int64_t> time{0};  // ns
};

/// Introduces an output; its socket is passed along, and the `guarded` text follows.
struct GuardIntroduction {
  std::uint32_t slot = 0;
  double safe = 0;
  std::array<char, 64> name{};  // "output pump", for messages
  std::int32_t priority = 0;    // SCHED_FIFO priority, above all tiers; 0: no tier has one
};

/// How long the guard tries to set an ended output safe.
inline constexpr Duration longest_after_end = std::chrono::seconds{10};

struct GuardOrder {
  enum Kind : std::uint32_t { open, set, arm, disarm, finish };
  Kind kind = open;
  std::uint32_t has_value = 0;
  double value = 0;
};

struct GuardAnswer {
  enum Kind : std::uint32_t { answered, tripped, vanished, ended };
  Kind kind = answered;   // answer to an order, or a message of the guard itself: no turn, no device, result of its end
  std::int32_t code = 0;  // an Errc; 0: the device has the value
  std::array<char, 96> what{};
  std::array<char, 160> where{}, why{}, advice{};

  void put(const Error& error) noexcept {
    code = error.code.category() == error_category() ? error.code.value() : static_cast<int>(Errc::io_failed);
    put_text(what, error.what);
    put_text(where, error.where);
    put_text(why, error.why);
    put_text(advice, error.advice);
  }
  Result<void> result() const {
    if (code == 0) return {};
    return Error{static_cast<Errc>(code), text_of(what), text_of(where), text_of(why), text_of(advice)};
  }

 private:
  template <std::size_t N>
  static void put_text(std::array<char, N>& to, std::string_view text) noexcept {
    to[put_fitting(to.data(), N - 1, text)] = 0;
  }
  template <std::size_t N>
  static std::string text_of(const std::array<char, N>& from) {
    return {from.data(), ::strnlen(from.data(), N)};
  }
};

/// The result of an output that ended without its safe value, as a text. Errors: closed (the guard never had its
/// device), busy (another guard has it), the device's error.
inline std::string text_of_end(const Result<void>& done) {
  if (done) return "it has its safe value now";
  if (done.error().code == make_error_code(Errc::closed))
    return "its device could not be opened and keeps its value: " + done.error().why;
  if (done.error().code == make_error_code(Errc::busy))
    return "another output has its device now, and the guard no longer tries to set it safe";
  return "its device has not accepted the safe value for " + to_string(longest_after_end) +
         ", and the guard no longer tries: " + done.error().why;
}

/// The guard's whole life, in its process.
[[noreturn]] void run_guard(int socket, GuardBeat* beats, const OutputGuard::Make& make) noexcept;

}  // namespace detail

struct OutputGuard::Link {
  ~Link();
  /// Introduces an output to the guard and returns its socket. Errors: disconnected, and no descriptors. `priority`: of
  /// the guard's thread, see GuardIntroduction.
  Result<int> introduce(const std::string& name, double safe, const std::string& what, int priority,
                        std::uint32_t& slot);
  void release(std::uint32_t slot) noexcept;
  /// Waits on the loop for the guard's message about an output that ended without its safe value, and logs it. Takes
  /// the socket.
  void await_end(Loop& loop, const std::string& output, int its_socket);
  /// Extends the beats of all outputs of a loop while the loop waits for an output's device.
  void beat_for(const Loop& loop) noexcept;
  /// How an output ended, or that it was made again.
  void note(const std::string& output, bool is_safe);

  std::atomic<bool> is_ending{false};  // the program ends: outputs must be safe
  int socket = -1;
  pid_t process = -1;
  detail::GuardBeat* beats = nullptr;
  std::mutex mutex;  // protects the members below: outputs are made on the threads of all loops
  struct Ending {
    ~Ending();
    std::string output;
    int socket = -1;
    FdWatch watch;
  };
  std::list<Ending> endings;
  std::set<std::string> unsafe;
  std::vector<bool> is_taken = std::vector<bool>(detail::most_guarded);
  std::vector<detail::GuardPatience> patience = std::vector<detail::GuardPatience>(detail::most_guarded);
};

}  // namespace rtdata
