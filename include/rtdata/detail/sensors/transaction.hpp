/// Transaction: one access to a device that may block, done on the device's lane.
///
/// A sensor whose device can block (a kernel ADC file, an I2C bus) is a transaction and a decode: `transact` touches
/// the device on the lane's thread and leaves bytes or an error in itself; `decode`, a pure function on the loop, makes
/// the payload of them. A transaction that outlives the lane's limit is given up and a fresh one made; it must own all
/// that `transact` touches.
///
/// Opening is a transaction too, and closing is done on the lane as well: a device that takes a second for either holds
/// no loop. Only while the loop does not run (loop.hpp), or when the sensor is `required`, does starting wait for the
/// opening, so that a program knows at its start which devices are missing.
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
  /// When it was run, for the first time since its tick. To be asked while it runs, or afterwards.
  MonotonicTime began() const noexcept { return began_; }

  /// The device's turn. On the lane's thread.
  virtual void transact() noexcept = 0;
  /// Gives back what it holds of the device; what it has read stays for `decode`. On the lane's thread, after
  /// `transact`. Not called when the lane takes no more, or has given it up: then the destructor does it.
  virtual void close() noexcept {}
  /// Asked on the loop when it has run: how long the device needs before the transaction is run again, the lane being
  /// free for others meanwhile. None: it is done, and can be decoded.
  virtual std::optional<Duration> goes_on_after() { return {}; }
  /// The loop has given it up: it hangs on the lane, or will never run there. Once, on the loop's thread.
  virtual void given_up() noexcept {}
  /// Closes it, unless it hangs in `transact`.
  void close_unless_hung() noexcept;

 private:
  friend class SensorNode;
  SensorNode* owner_ = nullptr;           // null once the sensor does not want it any more
  std::atomic<bool> is_unwanted_{false};  // the same for the lane's thread, when it was not begun yet
  std::atomic<bool> is_under_way_{false};
  bool is_resumed_ = false;  // it goes on
  MonotonicTime began_{};
  MonotonicTime ended_{};  // when it had run
};

/// A device that is opened, read and closed on a lane. All calls are on the loop.
class LaneDevice {
 public:
  virtual ~LaneDevice() = default;
  /// What opens the device, before the first read and after each fault. Null: there is nothing to open.
  virtual std::shared_ptr<Transaction> make_opening() { return nullptr; }
  /// Takes what an opening has found. Errors: the device cannot be opened.
  virtual Result<void> take_opening(Transaction&) { return {}; }
  /// A fresh one: after each opening, and after one was given up.
  virtual std::shared_ptr<Transaction> make_transaction() = 0;
  /// Makes the payload of a finished transaction.
  virtual Sampled decode(Transaction& transaction, SamplePort& port) = 0;
  /// Sensors of one physical device have one key, and so one lane. Asked for before each opening, or before the
  /// first read when there is nothing to open; must not block.
  virtual std::string lane_key() const = 0;
  /// The thread of that lane when it is a bus's, which sensors of several loops may be on. Null: one of its own.
  virtual std::shared_ptr<LaneThread> lane_thread() const { return nullptr; }
  /// Its reads are so short that they are run on the loop, which waits for them; opening and closing is on the lane.
  virtual bool reads_on_loop() const { return false; }
  /// A transaction that takes longer is given up: each time that it is run.
  virtual Duration give_up_after() const { return std::chrono::seconds{1}; }
  /// How long one reading takes; may be called before the device is opened.
  virtual ReadTime read_time() const { return {}; }
  /// The sensor is stopped: how many samples the device took since the last one that was read, if it could not be read
  /// any more. Afterwards no time of before is counted.
  virtual std::uint64_t stopped(MonotonicTime) { return 0; }
  /// The error of a transaction that was given up.
  virtual Error given_up_error() const = 0;
};

/// The type of a payload that has a description and no C++ type.
PayloadType described_type(std::shared_ptr<const Description> description);

Node* make_sensor(Loop& loop, SensorConfig config, PayloadType type, std::unique_ptr<LaneDevice> device);
/// The type of a payload that has a description and no C++ type. SetupError (bad-description): it is null.
PayloadType described_type(std::shared_ptr<const Description> description);

}  // namespace rtdata::detail
