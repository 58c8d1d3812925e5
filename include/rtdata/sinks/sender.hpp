/// Sender: a writer whose peer is across a network.
///
/// A sink with a Sender encodes its events on its lane and transfers them on the loop, without blocking the loop. The
/// events of a batch become parcels; up to `window` parcels are in flight at a time, and each gets one answer, in any
/// order. Your own sender defines how an event becomes bytes and how a parcel is sent:
///
///     class Lines final : public rtdata::Sender {
///       rtdata::SendingConfig sending() const override { return {.window = 1}; }
///       rtdata::Result<void> encode(const rtdata::Record& record, std::vector<std::byte>& out) override {
///         return codec_->encode(record.keyed_view(), out);
///       }
///       void begin(rtdata::Loop& loop) override { ... }                                       // open nothing yet
///       void send(const rtdata::Parcel& parcel, rtdata::Answer answer) override { ... }       // connect when needed
///       void cancel() override { ... }
///     };
///     rtdata::Sink sink(loop, {.name = "lines", .through = "recording"}, std::make_unique<Lines>());
///
/// Parcels without an acknowledgement are sent again, after the delay that the peer asks for or one that doubles.
/// Meanwhile events wait in the queue or, with `through`, in the recording, which survives a kill and a reboot. So an
/// event may arrive twice; the receiver can recognise it by its key (run, origin, sequence).
///
/// Owner: its sink. Thread: said at each call.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "rtdata/sinks/sink.hpp"

namespace rtdata {

/// Limits of parcels in flight. Each sender has its own defaults.
struct SendingConfig {
  std::size_t window = 8;                           ///< parcels in flight at a time
  std::size_t parcel_rows = 100;                    ///< events of a parcel, at most
  std::size_t parcel_bytes = std::size_t{1} << 20;  ///< a parcel is complete at this size
  Duration timeout = std::chrono::seconds{30};      ///< after this time without an answer, a parcel is sent again
  std::uint64_t bytes_per_second = 0;               ///< most to send, on average; 0: no limit

  friend constexpr auto parameters(type_tag<SendingConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("window", &SendingConfig::window, "how many parcels may be under way at a time", range(1, 1000)),
        parameter("parcel_rows", &SendingConfig::parcel_rows, "most events in a parcel", range(1, 100'000)),
        parameter("parcel_bytes", &SendingConfig::parcel_bytes, "a parcel takes no more events once it has this size",
                  unit("By"), range(1.0, 268435456.0)),
        parameter("timeout", &SendingConfig::timeout, "a parcel without an answer for this long is sent again",
                  range(10ms, 1h)),
        parameter("bytes_per_second", &SendingConfig::bytes_per_second,
                  "most bytes to send per second, on average; 0: no limit", unit("By/s")));
  }
};

/// Events that are sent together: their bytes in sequence, and their keys.
class Parcel {
 public:
  struct Row {
    const SlotInfo* info = nullptr;  ///< topic, origin, run and description
    std::uint32_t slot = 0;
    std::size_t in_batch = 0;  ///< its index in the batch
    std::uint64_t sequence = 0;
    Time time{};
    std::size_t end = 0;  ///< where its bytes end
  };
  /// In order; at least one.
  const std::vector<Row>& rows() const noexcept { return rows_; }
  /// The bytes of all rows, without separators.
  std::span<const std::byte> bytes() const noexcept { return bytes_; }
  std::span<const std::byte> bytes(std::size_t row) const noexcept {
    const std::size_t begin = row == 0 ? 0 : rows_[row - 1].end;
    return std::span(bytes_).subspan(begin, rows_[row].end - begin);
  }
  /// The bytes of the rows from `first` up to, but not including, `last`.
  std::span<const std::byte> bytes(std::size_t first, std::size_t last) const noexcept {
    const std::size_t begin = first == 0 ? 0 : rows_[first - 1].end;
    return std::span(bytes_).subspan(begin, (last == 0 ? 0 : rows_[last - 1].end) - begin);
  }

 private:
  friend class detail::SinkQueue;
  std::vector<Row> rows_;
  std::vector<std::byte> bytes_;
};

namespace detail {
class Transfer;
}

/// The result of a parcel. Give it once: an Answer destroyed without a result counts as `again`. After `cancel`, and
/// after the end of the sink, the result is ignored.
class Answer {
 public:
  Answer() noexcept = default;
  Answer(Answer&& other) noexcept;
  Answer& operator=(Answer&& other) noexcept;
  ~Answer();

  /// True if there is no result yet and the sink still waits for it.
  explicit operator bool() const noexcept;
  /// The peer has the parcel, except the refused rows.
  void acknowledge();
  /// The peer has this many rows, from the first one on, except the refused ones. They count as delivered now, whatever
  /// happens to the others, and must not be sent again.
  void confirm(std::size_t rows);
  /// The number of rows confirmed so far, also by earlier attempts: send the parcel from there on.
  std::size_t confirmed() const noexcept;
  /// The peer will never take this row: it is dropped, counted and reported. Call it before `acknowledge` or the
  /// `confirm` of the row.
  void refuse(std::size_t row, Error why);
  /// The peer does not have the parcel: it is sent again, after the time that the peer asked for, or after one that
  /// doubles from `retry_first` to `retry_longest`. Until then nothing is sent, and the sink is faulted with this
  /// reason.
  void again(Error why, std::optional<Duration> after = {});

 private:
  friend class detail::Transfer;
  Answer(std::weak_ptr<detail::Transfer> transfer, std::size_t parcel, std::uint64_t transmission) noexcept
      : transfer_(std::move(transfer)), parcel_(parcel), transmission_(transmission) {}
  /// Drops the Answer without a result.
  void forget() noexcept;
  std::weak_ptr<detail::Transfer> transfer_;
  std::size_t parcel_ = 0;
  std::uint64_t transmission_ = 0;
};

class Sender : public Writer {
 public:
  Sender* as_sender() noexcept final { return this; }

  // ---- on the loop's thread. An exception from these is an error of the sink. If a parcel has no answer then,
  // everything in flight is given up at once (`cancel`) and sent again later.
  /// Once, before all other calls.
  virtual SendingConfig sending() const { return {}; }
  /// Called once, before the first parcel. May make handles on this loop; must not block.
  virtual void begin(Loop& loop) = 0;
  /// Sends it, without blocking. The parcel lives until its answer is given, or `cancel` has returned. The answer may
  /// be given at once.
  virtual void send(const Parcel& parcel, Answer answer) = 0;
  /// Gives up everything in flight: a parcel had no answer for `timeout`, or the sink ends. Parcels may be sent again
  /// afterwards.
  virtual void cancel() = 0;
  /// Called when everything is acknowledged, or the deadline of closing is over: disconnects from the peer without
  /// blocking and closes its handles. Nothing is sent afterwards. If anything was in flight, `cancel` was called
  /// before.
  virtual void end() {}

  // ---- on the lane
  /// Appends the bytes of one event. An error refuses it (it does not fit the format).
  virtual Result<void> encode(const Record& record, std::vector<std::byte>& out) = 0;
  Result<void> open() override { return {}; }

 private:
  Result<void> write(Batch&) final { return {}; }  // batches are encoded by the sink
};

}  // namespace rtdata
