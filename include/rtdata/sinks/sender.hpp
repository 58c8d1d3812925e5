/// Sender: a writer whose peer is across a network.
///
/// A sink with a Sender encodes its events on its lane and transfers them on the loop, without blocking either: the
/// events of a batch become parcels, up to `window` of them are under way at a time, and each is answered once, in any
/// order. A sender of your own says how an event becomes bytes and how a parcel is sent:
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
/// What is not acknowledged is sent again, with the delay that the peer asks for or one that doubles; meanwhile events
/// wait: in the queue, or, with `through`, in the recording, which keeps them over a kill and a reboot. So an event may
/// arrive twice; its key (run, origin, sequence) tells.
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

/// How much is under way. Each sender has its own defaults.
struct SendingConfig {
  std::size_t window = 8;                           ///< parcels under way at a time
  std::size_t parcel_rows = 100;                    ///< events of a parcel, at most
  std::size_t parcel_bytes = std::size_t{1} << 20;  ///< a parcel has no more events once it has so many bytes
  Duration timeout = std::chrono::seconds{30};      ///< a parcel without an answer is given up and sent again
  std::uint64_t bytes_per_second = 0;               ///< sent, on average; 0: no limit

  friend constexpr auto parameters(type_tag<SendingConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("window", &SendingConfig::window, "parcels that are under way at a time", range(1, 1000)),
        parameter("parcel_rows", &SendingConfig::parcel_rows, "events of a parcel, at most", range(1, 100'000)),
        parameter("parcel_bytes", &SendingConfig::parcel_bytes, "a parcel has no more events once it is so long",
                  unit("By"), range(1.0, 268435456.0)),
        parameter("timeout", &SendingConfig::timeout, "without an answer for so long a parcel is sent again",
                  range(10ms, 1h)),
        parameter("bytes_per_second", &SendingConfig::bytes_per_second, "sent, on average; 0: no limit", unit("By/s")));
  }
};

/// Events that are sent together: their bytes, one after the other, and their keys.
class Parcel {
 public:
  struct Row {
    const SlotInfo* info = nullptr;  ///< topic, origin, run and description
    std::uint32_t slot = 0;
    std::size_t in_batch = 0;  ///< its place among the events of the batch
    std::uint64_t sequence = 0;
    Time time{};
    std::size_t end = 0;  ///< where its bytes end
  };
  /// In order; at least one.
  const std::vector<Row>& rows() const noexcept { return rows_; }
  /// Of all rows, without anything between them.
  std::span<const std::byte> bytes() const noexcept { return bytes_; }
  std::span<const std::byte> bytes(std::size_t row) const noexcept {
    const std::size_t begin = row == 0 ? 0 : rows_[row - 1].end;
    return std::span(bytes_).subspan(begin, rows_[row].end - begin);
  }
  /// Of the rows from `first` up to and without `last`.
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

/// What became of a parcel. To be given once: an Answer that is destroyed before counts as `again`. After `cancel`, and
/// after the end of the sink, what it says is ignored.
class Answer {
 public:
  Answer() noexcept = default;
  Answer(Answer&& other) noexcept;
  Answer& operator=(Answer&& other) noexcept;
  ~Answer();

  /// Not given yet, and still awaited.
  explicit operator bool() const noexcept;
  /// The peer has the parcel, but for the rows that it refused.
  void acknowledge();
  /// The peer has so many of the rows, from the first one on, but for those that it refused. They count as delivered
  /// now, whatever becomes of the others, and are not to be sent again.
  void confirm(std::size_t rows);
  /// Rows that were confirmed, also when the parcel was sent before: it is to be sent from there on.
  std::size_t confirmed() const noexcept;
  /// Before `acknowledge`, or its `confirm`: the peer will never take this row. It is dropped, counted and reported.
  void refuse(std::size_t row, Error why);
  /// The peer does not have it: it is sent again, after the time that the peer asked for, else after one that doubles
  /// from `retry_first` to `retry_longest`. Until then nothing is sent, and the sink is faulted with this reason.
  void again(Error why, std::optional<Duration> after = {});

 private:
  friend class detail::Transfer;
  Answer(std::weak_ptr<detail::Transfer> transfer, std::size_t parcel, std::uint64_t transmission) noexcept
      : transfer_(std::move(transfer)), parcel_(parcel), transmission_(transmission) {}
  /// It is not given any more.
  void forget() noexcept;
  std::weak_ptr<detail::Transfer> transfer_;
  std::size_t parcel_ = 0;
  std::uint64_t transmission_ = 0;
};

class Sender : public Writer {
 public:
  Sender* as_sender() noexcept final { return this; }

  // ---- on the loop's thread. What these throw is an error of the sink's; where a parcel was not answered yet, nothing
  // waits for its time-out: everything under way is given up (`cancel`) and sent again later.
  /// Once, before all other calls.
  virtual SendingConfig sending() const { return {}; }
  /// Once, before the first parcel. Handles of this loop may be made; nothing that can block.
  virtual void begin(Loop& loop) = 0;
  /// Sends it, without blocking. The parcel lives until its answer is given, or `cancel` has returned. The answer may
  /// be given at once.
  virtual void send(const Parcel& parcel, Answer answer) = 0;
  /// Gives up everything that is under way: a parcel was not answered for `timeout`, or the sink ends. Parcels may be
  /// sent again afterwards.
  virtual void cancel() = 0;
  /// Everything is acknowledged, or the deadline of closing is over: says goodbye to the peer, without blocking, and
  /// closes its handles. Nothing is sent afterwards. `cancel` was called before when something was under way.
  virtual void end() {}

  // ---- on the lane
  /// Appends the bytes of one event. An error refuses it (it does not fit the format).
  virtual Result<void> encode(const Record& record, std::vector<std::byte>& out) = 0;
  Result<void> open() override { return {}; }

 private:
  Result<void> write(Batch&) final { return {}; }  // batches are encoded by the sink
};

}  // namespace rtdata
