/// Transaction: one access to a device that may block, done on the device's lane.
///
/// A sensor whose device can block (a kernel ADC file, an I2C bus) consists of a transaction and a decode: `transact`
/// uses the device on the lane's thread and stores bytes or an error in the transaction; `decode`, a pure function on
/// the loop, makes the payload from them. A transaction beyond the lane's limit is given up and replaced by a new one;
/// it must own everything that `transact` uses.
///
/// Opening and closing also run on the lane: a device that takes a second for either does not hold the loop. Starting a
/// sensor waits for the opening only if the loop does not run yet (loop.hpp) or the sensor is `required`, so that a
/// program knows at its start which devices are missing.
///
/// Owner: the sensor and the lane. Thread: `run`, `transact` and `close`: the lane's; the destructor: either; all else
/// the loop's.
#pragma once

#include <atomic>
#include <memory>
#include <optional>
#include <string>

#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace rtdata::detail {

class Transaction : public LaneJob {
 public:
  void run() noexcept final;
  void done(Outcome outcome) final;
  /// When it first ran after its tick, or what `begin_at` says. Valid while it runs and afterwards.
  MonotonicTime began() const noexcept { return began_; }

  /// Accesses the device. On the lane's thread.
  virtual void transact() noexcept = 0;
  /// Releases the device; the data stay for `decode`. On the lane's thread, after `transact`. Not called if the lane
  /// takes no more jobs or has given this one up: then the destructor releases the device.
  virtual void close() noexcept {}
  /// Called on the loop after `transact`: the time until `transact` must run again; the lane is free for others
  /// meanwhile. Empty: the transaction is complete and can be decoded.
  virtual std::optional<Duration> goes_on_after() { return {}; }
  /// Called once, on the loop's thread, when the loop has given it up: it hangs on the lane or will never run.
  virtual void given_up() noexcept {}
  /// Closes it, unless it hangs in `transact`.
  void close_unless_hung() noexcept;

 protected:
  /// The device was asked later, after a wait: its sample has that time, by which it may be late. On the lane's thread.
  void begin_at(MonotonicTime asked) noexcept { began_ = asked; }

 private:
  friend class SensorNode;
  SensorNode* owner_ = nullptr;           // null once the sensor does not want it any more
  std::atomic<bool> is_unwanted_{false};  // tells the lane's thread not to begin it
  std::atomic<bool> is_under_way_{false};
  bool is_resumed_ = false;  // it runs for the second time or later
  MonotonicTime began_{};
  MonotonicTime ended_{};  // when it had run
};

/// A device that is opened, read and closed on a lane. All calls are on the loop.
class LaneDevice {
 public:
  virtual ~LaneDevice() = default;
  /// Makes the transaction that opens the device, before the first read and after each fault. Null: no opening needed.
  virtual std::shared_ptr<Transaction> make_opening() { return nullptr; }
  /// Takes the result of an opening. Errors: the device cannot be opened.
  virtual Result<void> take_opening(Transaction&) { return {}; }
  /// Makes a new transaction, after each opening and after one was given up.
  virtual std::shared_ptr<Transaction> make_transaction() = 0;
  /// Makes the payload of a finished transaction.
  virtual Sampled decode(Transaction& transaction, SamplePort& port) = 0;
  /// The key of the lane; sensors of one physical device have the same key. Called before each opening, or before the
  /// first read if there is no opening; must not block.
  virtual std::string lane_key() const = 0;
  /// The thread of a bus, which sensors of several loops share. Null: the lane has its own.
  virtual std::shared_ptr<LaneThread> lane_thread() const { return nullptr; }
  /// True if reads are short enough to run on the loop; opening and closing still run on the lane.
  virtual bool reads_on_loop() const { return false; }
  /// The time limit of each run of a transaction.
  virtual Duration give_up_after() const { return std::chrono::seconds{1}; }
  /// How long one reading takes; may be called before the device is opened.
  virtual ReadTime read_time() const { return {}; }
  /// Called when the sensor stops: returns how many samples the device has taken since the last one read, if it can no
  /// longer be read. Later losses do not include this time again.
  virtual std::uint64_t stopped(MonotonicTime) { return 0; }
  /// How the device's identity differs from the known one because the user says so. Empty: it does not.
  virtual std::string identity_by_word() const { return {}; }
  /// The error of a transaction that was given up.
  virtual Error given_up_error() const = 0;
};

/// The type of a payload that has a description and no C++ type.
PayloadType described_type(std::shared_ptr<const Description> description);

Node* make_sensor(Loop& loop, SensorConfig config, PayloadType type, std::unique_ptr<LaneDevice> device);
/// The type of a payload that has a description and no C++ type. SetupError (bad-description): it is null.
PayloadType described_type(std::shared_ptr<const Description> description);

}  // namespace rtdata::detail
