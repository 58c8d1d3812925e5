/// OutputGuard: a separate process that holds the devices of outputs, so that they get their safe values even if this
/// program hangs, is stopped or is killed.
///
///     int main() {
///       rtdata::OutputGuard guard([](const std::string& what) -> std::unique_ptr<rtdata::Actuator> {
///         if (what == "pump") return std::make_unique<rtdata::GpioActuator>(rtdata::GpioActuatorConfig{.line = 5});
///         throw std::runtime_error("there is no " + what);
///       });
///       rtdata::Runtime runtime({.guard = &guard});
///       rtdata::Loop loop(runtime, {});
///       rtdata::Output pump(loop, {.name = "pump"}, {}, "pump");
///       loop.run();
///     }
///
/// The constructor forks: everything that `make` needs must exist by then. Construct it before the program has threads
/// and before it opens files that the guard must not share: the guard closes all descriptors except standard error.
///
/// The guard makes, sets and destroys each output's Actuator on a thread of its own. It sets the safe value
///   - when the loop has not turned for the output's `watchdog`; it then takes no other value until the output is
///     armed;
///   - at once when the program has ended, for any reason; then it releases the device and ends.
/// If a device does not take its safe value, the guard tries again; after the end of the program or of the output, for
/// 10 s. The result is in the log, or on standard error if the program has ended.
///
/// It ignores SIGINT, SIGTERM, SIGHUP, SIGQUIT and SIGABRT, which terminals and service managers also send to it. If it
/// ends anyway (SIGKILL, an Actuator that crashes), the program notices: its outputs open their devices themselves, set
/// them safe, and keep them safe.
///
/// docs/outputs.md lists its limits.
///
/// It holds at most 1024 outputs, each with a `guarded` text of at most 64 KiB; others are refused (does-not-fit).
///
/// Owner: the user; it must outlive the runtime. Thread: that of the constructor; outputs use it on their loops.
/// Errors: SetupError (io-failed): the system has no process or memory for it.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "rtdata/outputs/output.hpp"

namespace rtdata {

class OutputGuard {
 public:
  static constexpr std::size_t most_outputs = 1024;
  static constexpr std::size_t most_bytes = 65536;  ///< of an output's `guarded` text
  /// Makes the device of an output, in the guard. The argument is the output's `guarded` text. May throw.
  using Make = std::function<std::unique_ptr<Actuator>(const std::string& what)>;
  explicit OutputGuard(const Make& make);
  /// Waits for the guard's end, at most 2 s.
  ~OutputGuard();
  OutputGuard(const OutputGuard&) = delete;
  OutputGuard& operator=(const OutputGuard&) = delete;

  /// Call this when the program is about to end. Each output sets its safe value as soon as its loop turns, within a
  /// quarter of its `watchdog`, and takes no other value afterwards; if its loop does not turn, the guard does it after
  /// the watchdog time. An output with `keep` keeps its value. Any thread; does not allocate or wait.
  void make_all_safe() noexcept;
  /// Its process id.
  int process() const noexcept;
  /// The sorted names of outputs that ended while their device had not taken the safe value, and did not take it later,
  /// and that were not made again and set safe. Any thread.
  std::vector<std::string> ended_unsafe() const;

  struct Link;
  const std::shared_ptr<Link>& link() const noexcept { return link_; }  ///< for outputs

 private:
  std::shared_ptr<Link> link_;
};

}  // namespace rtdata
