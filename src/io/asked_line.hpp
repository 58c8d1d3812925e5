// A serial line with requests and answers, which never takes an answer for the wrong request.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <string>

#include "rtdata/io/serial.hpp"

namespace rtdata::detail {

/// After a missing or wrong answer the right one may still come. The next request to the same partner waits until that
/// is no longer possible: `answer_timeout` and as long again, at least a second, or the longest delay seen so far.
/// Bytes received meanwhile are dropped.
///
/// Shared by a bus and its devices. Thread: that of the bus's lane, and those of jobs that were given up.
class AskedLine {
 public:
  static constexpr Duration least_patience = std::chrono::seconds{1};
  /// After this time, bytes directly after an answer (a copy, a prompt, the rest of a USB packet) have arrived.
  static constexpr Duration stillness = std::chrono::milliseconds{20};

  /// `has_echo`: sent bytes come back, and are discarded.
  AskedLine(std::string bus, std::shared_ptr<SerialTransport> transport, Duration answer_timeout, Duration timeout,
            bool has_echo);

  /// Devices whose answers cannot be distinguished: all devices of a line, or one unit. The line's lock protects it.
  struct Partner {
    MonotonicTime asked{};          // last
    MonotonicTime heard{};          // last
    MonotonicTime in_doubt_from{};  // the first request whose answer may still come; epoch: there is none
    MonotonicTime answers_until{};
  };

  /// Before a request: waits until no earlier answer or copy can arrive. `silence`: the pause that the line needs
  /// between two frames. Returns how many bytes were dropped. Errors: timed-out (the wait would be longer than a
  /// reading may take), and those of the transport.
  Result<std::size_t> settle(Partner& partner, Duration silence = Duration{0});
  /// Errors, with an echo: timed-out (it does not come), bad-data (it differs from the sent bytes).
  Result<void> write(Partner& partner, std::span<const std::uint8_t> bytes);
  /// 0: nothing came in time.
  Result<std::size_t> read(Partner& partner, std::span<std::uint8_t> bytes, MonotonicTime until);
  /// The answer is complete. `has_more`: further bytes followed.
  void answered(Partner& partner, bool has_more);
  /// The answer to the last request is missing or may be wrong.
  void distrust(Partner& partner);

  Result<void> open() { return noted(transport_->open()); }
  /// How often the line was lost. The set-up of a device must then be sent again after the next `settle`.
  std::uint64_t losses();

 private:
  /// Notes that the line was lost.
  template <class Value>
  Result<Value> noted(Result<Value> result) {
    if (!result && result.error().code == make_error_code(Errc::disconnected)) note_loss();
    return result;
  }
  void note_loss();
  /// After a loss: opens it, so that the first bytes that a device sends are dropped.
  Result<void> open_again();
  Duration patience() const noexcept;
  Result<void> drop_echo(Partner& partner, std::span<const std::uint8_t> sent);

  const std::string bus_;
  const std::shared_ptr<SerialTransport> transport_;
  const Duration answer_timeout_;
  const Duration spare_;      // limit for waiting within one reading
  const Duration most_late_;  // longest delay that is remembered
  const bool has_echo_;
  std::mutex mutex_;          // protects the members below, and partners; not held while it waits
  Duration longest_late_{0};  // after `answer_timeout`
  MonotonicTime last_use_{};
  bool is_restless_ = false;  // bytes came without a request
  bool is_lost_ = false;
  std::uint64_t losses_ = 0;
};

}  // namespace rtdata::detail
