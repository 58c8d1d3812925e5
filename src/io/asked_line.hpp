// A serial line on which requests are answered, and on which no answer is taken for that to another request.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <string>

#include "rtdata/io/serial.hpp"

namespace rtdata::detail {

/// An answer that did not come, or that made no sense, leaves a doubt: the right one may still come. A request which
/// that could be taken for waits until it no longer can be: for `answer_timeout` and then as long again, at least a
/// second, or as late as answers have come. What comes meanwhile is dropped.
///
/// Shared by a bus and its devices. Thread: that of the bus's lane, and those of jobs that were given up.
class AskedLine {
 public:
  static constexpr Duration least_patience = std::chrono::seconds{1};
  /// What follows an answer at once (a copy, a prompt, the rest of a packet of USB) has come by then.
  static constexpr Duration stillness = std::chrono::milliseconds{20};

  AskedLine(std::string bus, std::shared_ptr<SerialTransport> transport, Duration answer_timeout, Duration timeout);

  /// Whose answers are taken for one another's: all of a line, or those of one unit of it. The line's lock guards it.
  struct Partner {
    MonotonicTime asked{};          // last
    MonotonicTime heard{};          // last
    MonotonicTime in_doubt_from{};  // the first request whose answer may still come; epoch: there is none
    MonotonicTime answers_until{};
  };

  /// Before a request: waits until no answer to an earlier one can come, nor a copy of the last. `silence`: what the
  /// line needs between two frames. Errors: timed-out (it would have to be left still for longer than a reading may
  /// take), and those of the transport.
  Result<void> settle(Partner& partner, Duration silence = Duration{0});
  Result<void> write(Partner& partner, std::span<const std::uint8_t> bytes);
  /// 0: nothing came by then.
  Result<std::size_t> read(Partner& partner, std::span<std::uint8_t> bytes, MonotonicTime until);
  /// The answer has come, all of it. `has_more`: and something behind it.
  void answered(Partner& partner, bool has_more);
  /// The answer to the last request did not come, or what came is perhaps not it.
  void distrust(Partner& partner);

  Result<void> open() { return transport_->open(); }

 private:
  Duration patience() const noexcept;

  const std::string bus_;
  const std::shared_ptr<SerialTransport> transport_;
  const Duration answer_timeout_;
  const Duration spare_;      // of a reading's time, to wait in
  const Duration most_late_;  // that is remembered
  std::mutex mutex_;          // of what follows, and of partners; not while it waits
  Duration longest_late_{0};  // after `answer_timeout`
  MonotonicTime last_use_{};
  bool is_restless_ = false;  // bytes came that nobody had asked for
};

}  // namespace rtdata::detail
