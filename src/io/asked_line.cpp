#include "io/asked_line.hpp"

#include <algorithm>
#include <array>
#include <utility>

#include "rtdata/detail/loop/lane.hpp"

namespace rtdata::detail {

AskedLine::AskedLine(std::string bus, std::shared_ptr<SerialTransport> transport, Duration answer_timeout,
                     Duration timeout, bool has_echo)
    : bus_(std::move(bus)),
      transport_(std::move(transport)),
      answer_timeout_(answer_timeout),
      spare_((timeout - answer_timeout) / 2),
      most_late_(timeout / 2),
      has_echo_(has_echo) {}

Duration AskedLine::patience() const noexcept { return std::max({answer_timeout_, least_patience, longest_late_}); }

Result<std::size_t> AskedLine::settle(Partner& partner, Duration silence) {
  if (const Result<void> opened = open_again(); !opened) return opened.error();
  const MonotonicTime limit = lane_now() + spare_;
  std::size_t all_dropped = 0;
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
    const Result<std::size_t> got = noted(
        transport_->read(dropped, waits ? std::max(still_from - now, Duration{0}) : Duration{0}));
    if (!got) return got.error();
    all_dropped += *got;
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
                   "the device may still be sending an earlier answer, or it sends without being asked",
                   "the device is asked again " +
                       to_string(std::chrono::ceil<std::chrono::milliseconds>(still_from - now)) +
                       " from now; find out why answers come late, or which device sends without being asked"};
    if (*got == 0 && lane_now() >= still_from) {
      is_restless_ = false;
      return all_dropped;
    }
    is_drained = is_drained || *got == 0;
  }
}

Result<void> AskedLine::write(Partner& partner, std::span<const std::uint8_t> bytes) {
  {
    const std::lock_guard lock(mutex_);
    partner.asked = lane_now();
  }
  Result<void> written = noted(transport_->write(bytes, answer_timeout_));
  return written && has_echo_ ? drop_echo(partner, bytes) : written;
}

Result<void> AskedLine::drop_echo(Partner& partner, std::span<const std::uint8_t> sent) {
  const MonotonicTime until = lane_now() + answer_timeout_;
  const auto failure = [&](Errc code, std::string why, std::string advice) {
    distrust(partner);
    return Error{code, "cannot ask the device", "bus " + bus_, std::move(why), std::move(advice)};
  };
  std::array<std::uint8_t, 512> bytes{};
  while (!sent.empty()) {
    // Reads only the echo: the answer may follow at once.
    const auto got = read(partner, std::span(bytes).first(std::min(bytes.size(), sent.size())), until);
    if (!got) return got.error();
    if (*got == 0)
      return failure(Errc::timed_out, "the sent bytes did not come back within " + to_string(answer_timeout_),
                     "set `echo` only for adapters that return what they receive; check the wires");
    if (!std::equal(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(*got), sent.begin()))
      return failure(
          Errc::bad_data, "the returned bytes differ from the sent bytes",
          "check whether another device sends at the same time; check the termination of the line, and `echo`");
    sent = sent.subspan(*got);
  }
  return {};
}

Result<std::size_t> AskedLine::read(Partner& partner, std::span<std::uint8_t> bytes, MonotonicTime until) {
  Result<std::size_t> got = noted(transport_->read(bytes, std::max(until - lane_now(), Duration{0})));
  if (!got || *got == 0) return got;
  const std::lock_guard lock(mutex_);
  partner.heard = last_use_ = lane_now();
  return got;
}

std::uint64_t AskedLine::losses() {
  const std::lock_guard lock(mutex_);
  return losses_;
}

void AskedLine::note_loss() {
  const std::lock_guard lock(mutex_);
  if (!std::exchange(is_lost_, true)) ++losses_;
}

Result<void> AskedLine::open_again() {
  {
    const std::lock_guard lock(mutex_);
    if (!is_lost_) return {};
  }
  if (auto opened = transport_->open(); !opened) return opened;
  const std::lock_guard lock(mutex_);
  is_lost_ = false;
  is_restless_ = true;
  last_use_ = lane_now();
  return {};
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
