/// OutputGuard: a process of its own that holds the devices of outputs, so that they get their safe values also when
/// this program hangs, is stopped or is killed.
///
///     int main() {
///       rtdata::OutputGuard guard([](const std::string& what) -> std::unique_ptr<rtdata::Actuator> {
///         if (what == "pump") return std::make_unique<rtdata::GpioActuator>(rtdata::GpioActuatorConfig{.line = 5});
///         throw std::runtime_error("there is no " + what);
///       });
///       rtdata::Runtime runtime({.guard = &guard});
///       rtdata::Loop loop(runtime, {});
///       rtdata::Output pump(loop, {.name = "pump"}, {}, "pump");
///
/// The constructor forks: what `make` needs must be there by then. Make it before the program has threads, and before
/// it opens what the guard is not to share: the guard closes all descriptors but the standard ones, of which it keeps
/// standard error.
///
/// The guard makes, sets and destroys each output's Actuator on a thread of its own. It sets the safe value
///   - when the loop has not turned for the output's `watchdog`: then it takes no other value until the output is
///     armed;
///   - when the program has ended, in whatever way: at once; then it gives the device back and ends.
/// A device that does not take its safe value is tried again, after the end of the program or of the output for 10 s.
/// What came of that is told in the log, and on standard error when the program has gone.
///
/// It ignores SIGINT, SIGTERM, SIGHUP, SIGQUIT and SIGABRT, which terminals and service managers send to it too. What
/// ends it all the same (SIGKILL, an Actuator that crashes) is seen by the program: its outputs take their devices
/// themselves, set them safe, and stay so.
///
/// What it cannot do is in docs/outputs.md.
///
/// It has 1024 outputs at most, each of a text of 64 KiB at most: others are refused (does-not-fit).
///
/// Owner: the user; it must outlive the runtime. Thread: that of the constructor; outputs use it on their loops.
/// Errors: SetupError (io-failed): there is no process or memory for it.
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
  static constexpr std::size_t most_bytes = 65536;  ///< of what an output is given as `guarded`
  /// Called in the guard, with what an output was given as `guarded`. May throw.
  using Make = std::function<std::unique_ptr<Actuator>(const std::string& what)>;
  explicit OutputGuard(const Make& make);
  /// Waits for the guard's end, at most 2 s.
  ~OutputGuard();
  OutputGuard(const OutputGuard&) = delete;
  OutputGuard& operator=(const OutputGuard&) = delete;

  /// The program is about to end: each output sets its safe value as soon as its loop turns, within a quarter of its
  /// `watchdog`, and takes no other from then on; where its loop does not turn, the guard does so when the watchdog is
  /// over. One that is kept keeps what it has. Any thread; no allocation, nothing is waited for.
  void make_all_safe() noexcept;
  /// Its process id.
  int process() const noexcept;
  /// The names of outputs, sorted, that ended without that their device took the safe value, then or while the guard
  /// tried again and the loop turned, and of which none was made again that is safe. Thread: any.
  std::vector<std::string> ended_unsafe() const;

  struct Link;
  const std::shared_ptr<Link>& link() const noexcept { return link_; }  ///< for outputs

 private:
  std::shared_ptr<Link> link_;
};

}  // namespace rtdata
