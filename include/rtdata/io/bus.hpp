/// Bus: a connection for several devices, with one lane for all of them.
///
/// It belongs to the runtime: sensors of all loops may use it. Every access to a device runs on the one thread of the
/// bus's lane, one job at a time, in the order of submission. A job that hangs is given up after `give_up_after`, and
/// the other jobs continue on a new thread.
///
/// A bus of your own (CAN, an FT232H) derives from it, and its devices from `BusDevice`:
///
///     class Wire;
///     class WireDevice : public rtdata::BusDevice {
///      public:
///       using Bus = Wire;
///       struct Place { unsigned number = 1; parameters(...) };    // where on the bus; beside `bus` in configurations
///       rtdata::Result<double> ask();                                // blocks; on the lane; `count`s itself
///     };
///     class Wire : public rtdata::Bus {
///      public:
///       static constexpr std::string_view type = "wire";             // as in configurations
///       WireDevice device(const WireDevice::Place& place);           // on the lane too
///       static std::string text_of(const WireDevice::Place& place);  // "number 1"; no two sensors have the same,
///                                                                       // unless it is empty
///     };
///
/// A device must not use the Bus object itself, which may be destroyed while a job hangs: keep the connection in an
/// object that both share.
///
/// Owner: the program, or the System; it must outlive the sensors on it. Thread: `device` of a bus: any; devices: that
/// on which they are used, one at a time.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata {

namespace detail {
class LaneThread;
}

/// Statistics of the transfers with the device at one place of a bus.
struct TransferCounts {
  std::uint64_t transfers = 0;  ///< including failed ones, not counting retries
  std::uint64_t failed = 0;     ///< after all retries
  std::uint64_t retried = 0;
  Duration busy{0};  ///< time on the bus
  Duration longest{0};
  std::uint64_t skipped_bytes = 0;  ///< noise and late answers on a serial line, which belong to no answer
};

/// The counts of one place: its devices add to them, `Bus::place_counts` reads them. Any thread; without a lock.
class TransferCounter {
 public:
  void add(Duration took, bool is_good, std::uint64_t retries = 0) noexcept;
  void add_skipped(std::uint64_t bytes) noexcept { skipped_.fetch_add(bytes, std::memory_order_relaxed); }
  TransferCounts counts() const noexcept;

 private:
  std::atomic<std::uint64_t> transfers_{0}, failed_{0}, retried_{0};
  std::atomic<std::int64_t> busy_{0}, longest_{0};  // ns
  std::atomic<std::uint64_t> skipped_{0};
};

/// A place, such as "address 0x76", and its counts.
struct PlaceCounts {
  std::string place;
  TransferCounts counts;
};

class Bus {
 public:
  Bus(const Bus&) = delete;
  Bus& operator=(const Bus&) = delete;
  /// As errors and the lane show it: "i2c1".
  const std::string& name() const noexcept { return name_; }
  /// The limit of each job of a sensor on this bus.
  Duration give_up_after() const noexcept { return give_up_after_; }

  /// Reserves a place on the bus for one sensor; it is released when the last copy of the returned pointer is
  /// destroyed. The empty place can be reserved any number of times. SetupError (busy): the place is taken.
  std::shared_ptr<void> claim(const std::string& place);
  /// The counts of all places that a device was asked for, sorted by place. Any thread.
  std::vector<PlaceCounts> place_counts() const;
  /// The counts of one place; zeros where there was no device. Any thread.
  TransferCounts counts_of(const std::string& place) const;
  const std::shared_ptr<detail::LaneThread>& lane_thread() const noexcept { return lane_thread_; }

 protected:
  Bus(std::string name, Duration give_up_after);
  virtual ~Bus();
  /// The counts of this place, shared by all devices there, which may outlive the bus.
  std::shared_ptr<TransferCounter> counter_of(const std::string& place) const;

 private:
  struct Places;
  std::string name_;
  Duration give_up_after_;
  std::shared_ptr<detail::LaneThread> lane_thread_;
  std::shared_ptr<Places> places_;
};

/// What all devices on buses have.
class BusDevice {
 public:
  /// `counter`: the counts of its place, from `Bus::counter_of`; null: nothing is counted.
  explicit BusDevice(std::shared_ptr<TransferCounter> counter = nullptr) : counter_(std::move(counter)) {}
  /// Called when a job with this device was given up: if that job continues later, it must not use the bus. Any thread.
  void abandon() noexcept { is_abandoned_->store(true, std::memory_order_relaxed); }
  bool is_abandoned() const noexcept { return is_abandoned_->load(std::memory_order_relaxed); }
  /// Blocks for this duration, as chips need after a reset. On a manual loop, virtual time passes.
  void wait(Duration duration) const noexcept;
  /// Called by the device before it sends a request, if its bus may have to wait first, such as for the late answer to
  /// an earlier request: the reading has the time of the first request after `begin_reading`.
  void note_request() noexcept;
  /// Called at the start of each reading, and by a driver that has set up its device during a reading.
  void begin_reading() noexcept { asked_ = {}; }
  /// When the first request of the reading was sent. Empty: not noted, so that the reading began with its job.
  std::optional<MonotonicTime> asked() const noexcept { return asked_; }

 protected:
  /// Counts a finished transfer.
  void count(Duration took, bool is_good, std::uint64_t retries = 0) const noexcept {
    if (counter_ != nullptr) counter_->add(took, is_good, retries);
  }
  void count_skipped(std::uint64_t bytes) const noexcept {
    if (counter_ != nullptr && bytes != 0) counter_->add_skipped(bytes);
  }

 private:
  std::shared_ptr<TransferCounter> counter_;
  std::optional<MonotonicTime> asked_;
  std::shared_ptr<std::atomic<bool>> is_abandoned_ = std::make_shared<std::atomic<bool>>(false);
};

}  // namespace rtdata
