#include "io/asked_line.hpp"

#include <algorithm>
#include <array>

#include "rtdata/detail/loop/lane.hpp"

namespace rtdata::detail {

AskedLine::AskedLine(std::string bus, std::shared_ptr<SerialTransport> transport, Duration answer_timeout,
                     Duration timeout)
    : bus_(std::move(bus)),
      transport_(std::move(transport)),
      answer_timeout_(answer_timeout),
      spare_((timeout - answer_timeout) / 2),
      most_late_(timeout / 2) {}

Duration AskedLine::patience() const noexcept { return std::max({answer_timeout_, least_patience, longest_late_}); }

Result<void> AskedLine::settle(Partner& partner, Duration silence) {
  const MonotonicTime limit = lane_now() + spare_;
  for (bool is_drained = false;;) {  // drop older bytes
    MonotonicTime still_from;
    {
      const std::lock_guard lock(mutex_);
      const Duration pause = is_restless_ ? std::max(stillness, silence) : silence;
      still_from = std::max({partner.answers_until, partner.heard + stillness, last_use_ + pause});
    }
    const MonotonicTime now = lane_now();
    const bool is_too_long = still_from > std::max(limit, now);
    const bool waits = is_drained && !is_too_long;
    std::array<std::uint8_t, 512> dropped{};
    const Result<std::size_t> got = transport_->read(dropped,
                                                     waits ? std::max(still_from - now, Duration{0}) : Duration{0});
    if (!got) return got.error();
    const std::lock_guard lock(mutex_);
    if (*got > 0) {
      last_use_ = lane_now();
      is_restless_ = true;
      // Too late to answer the last request: these bytes may answer the oldest unanswered one, so note how late that
      // is.
      if (waits && partner.in_doubt_from != MonotonicTime{} && last_use_ > partner.asked + answer_timeout_)
        longest_late_ = std::max(longest_late_,
                                 std::min(last_use_ - partner.in_doubt_from - answer_timeout_, most_late_));
    }
    if (is_too_long)
      return Error{Errc::timed_out, "cannot ask the device", "bus " + bus_,
                   "the answer to an earlier request may still come, or the device sends without a request",
                   "the device is asked again " +
                       to_string(std::chrono::ceil<std::chrono::milliseconds>(still_from - now)) +
                       " from now; find out why answers come late, or what sends without being asked"};
    if (*got == 0 && lane_now() >= still_from) {
      is_restless_ = false;
      return {};
    }
    is_drained = is_drained || *got == 0;
  }
}

Result<void> AskedLine::write(Partner& partner, std::span<const std::uint8_t> bytes) {
  {
    const std::lock_guard lock(mutex_);
    partner.asked = lane_now();
  }
  return transport_->write(bytes, answer_timeout_);
}

Result<std::size_t> AskedLine::read(Partner& partner, std::span<std::uint8_t> bytes, MonotonicTime until) {
  Result<std::size_t> got = transport_->read(bytes, std::max(until - lane_now(), Duration{0}));
  if (!got || *got == 0) return got;
  const std::lock_guard lock(mutex_);
  partner.heard = last_use_ = lane_now();
  return got;
}

void AskedLine::answered(Partner& partner, bool has_more) {
  const std::lock_guard lock(mutex_);
  partner.in_doubt_from = partner.answers_until = {};
  is_restless_ = is_restless_ || has_more;
}

void AskedLine::distrust(Partner& partner) {
  const std::lock_guard lock(mutex_);
  last_use_ = lane_now();
  if (partner.asked == MonotonicTime{}) return;
  if (partner.in_doubt_from == MonotonicTime{}) partner.in_doubt_from = partner.asked;
  partner.answers_until = std::max(partner.asked + answer_timeout_, last_use_) + patience();
}

}  // namespace rtdata::detail
