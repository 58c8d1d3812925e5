/// Transaction: one access to a device that may block, done on the device's lane.
///
/// A sensor whose device can block (a kernel ADC file, an I2C bus) is a transaction and a decode: `transact` touches the
/// device on the lane's thread and leaves bytes or an error in itself; `decode`, a pure function on the loop, makes the
/// payload of them. A transaction that outlives the lane's limit is given up and a fresh one made; it must own all that
/// `transact` touches.
///
/// Owner: the sensor and the lane. Thread: `transact` the lane's, all else the loop's.
#pragma once

#include <atomic>
#include <memory>
#include <string>

#include "rtdata/loop/lane.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace rtdata::detail {

class Transaction : public LaneJob {
 public:
  void run() noexcept final;
  void done(Outcome outcome) final;

  /// The device's turn. On the lane's thread.
  virtual void transact() noexcept = 0;

 private:
  friend class SensorNode;
  SensorNode* owner_ = nullptr;           // null once the sensor does not want it any more
  std::atomic<bool> is_unwanted_{false};  // the same for the lane's thread, when it was not begun yet
  MonotonicTime due_{};
  Duration late_after_{0};  // of the schedule at which it was due
  MonotonicTime began_{};
  LoopCore* loop_ = nullptr;  // on manual loops, whose clock it takes; null otherwise
};

class LaneDevice : public SensorDevice {
 public:
  /// A fresh one: at start, and after one was given up.
  virtual std::shared_ptr<Transaction> make_transaction() = 0;
  /// Makes the payload of a finished transaction.
  virtual Sampled decode(Transaction& transaction, SamplePort& port) = 0;
  /// Sensors of one physical device have one key, and so one lane.
  virtual std::string lane_key() const = 0;
  /// A transaction that takes longer is given up.
  virtual Duration give_up_after() const { return std::chrono::seconds{1}; }
  /// The error of a transaction that was given up.
  virtual Error given_up_error() const = 0;

 private:
  Sampled sample(SamplePort&) final { return Sampled::nothing_new; }
};

}  // namespace rtdata::detail
