// The way from an output to its device: a lane of this program, or the guard.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "rtdata/data/time.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/outputs/output.hpp"

namespace rtdata {
class OutputGuard;
}

namespace rtdata::detail {

/// An Actuator that is made again after a failure, but not after it has refused a value. Exceptions become errors.
/// Thread: one at a time.
class HeldActuator {
 public:
  explicit HeldActuator(MakeActuator make) : make_(std::move(make)) {}
  /// Opens the device with the value if it is not open; otherwise sets the value. Without a value it only opens.
  Result<void> put(std::optional<double> value) noexcept;
  /// Checks the open device; after an error the device is given up.
  Result<void> check() noexcept;
  void give_back() noexcept { actuator_.reset(); }

 private:
  MakeActuator make_;
  std::unique_ptr<Actuator> actuator_;
};

/// Owner: the output; thread: its loop's.
class OutputPort {
 public:
  static constexpr Duration longest_wait = std::chrono::seconds{5};  // for opening or releasing a device
  class Listener {
   public:
    /// The result of the last `set`, `begin_open` or `begin_finish`. May destroy the port.
    virtual void answered(Result<void> result) = 0;
    /// The guard has set the safe value, or tries until the device accepts it. It accepts no other value until `arm`.
    virtual void tripped(const Result<void>& done) = 0;
    /// The device with a value has disappeared. The next `set` opens it again.
    virtual void vanished(const Error& error) = 0;
    /// The device can no longer be reached. May destroy the port.
    virtual void lost(const Error& error) = 0;

   protected:
    ~Listener() = default;
  };
  virtual ~OutputPort() = default;
  /// Waits.
  virtual Result<void> open(std::optional<double> value) = 0;
  /// The same without waiting; calls `answered` within `longest_wait`. An error: it has already failed.
  virtual Result<void> begin_open(std::optional<double> value) = 0;
  /// Sets a value; call it only after the last one was answered. `answered` follows unless this returns an error.
  virtual Result<void> set(double value) = 0;
  /// Waits, also for a value that is being set, which is then not answered; then releases the device.
  virtual Result<void> finish(std::optional<double> value) = 0;
  /// The same without waiting, also if a value is being set: the result is `answered`, within `longest_wait` after that
  /// value is set. An error: it has already ended.
  virtual Result<void> begin_finish(std::optional<double> value) = 0;
  /// Waits for the end of `begin_finish`, which is then not `answered`.
  virtual Result<void> wait_for_end() = 0;
  /// The result for `tripped` that was not delivered before the end. Empty: the guard has not tripped since.
  virtual std::optional<Result<void>> late_trip() const { return {}; }
  /// The loop turns: the guard waits until this time.
  virtual void beat(MonotonicTime) noexcept {}
  /// When the guard has last shown that it runs, for an output that is not safe. Empty: there is no guard.
  virtual std::optional<MonotonicTime> guard_seen() const noexcept { return {}; }
  /// From now on the output is disarmed if its loop does not turn, even at its safe value.
  virtual void arm() noexcept {}
  virtual void disarm() noexcept {}
  /// True if the program ends and the output must be safe (OutputGuard::make_all_safe).
  virtual bool is_to_end() const noexcept { return false; }
  virtual bool is_guarded() const noexcept { return false; }
};

/// `name`: of the output, in reports.
std::unique_ptr<OutputPort> make_lane_port(Loop& loop, const std::string& name, MakeActuator make,
                                           OutputPort::Listener& listener);
std::unique_ptr<OutputPort> make_guard_port(Loop& loop, const std::string& name, OutputGuard& guard,
                                            const std::string& guarded, double safe, OutputPort::Listener& listener);

}  // namespace rtdata::detail
