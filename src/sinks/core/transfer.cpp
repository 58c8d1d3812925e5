#include "sinks/core/transfer.hpp"

#include <algorithm>
#include <utility>

#include "data/saturating.hpp"
#include "loop/core/loop_core.hpp"
#include "rtdata/loop/ledger.hpp"

namespace rtdata {

Answer::Answer(Answer&& other) noexcept
    : transfer_(std::move(other.transfer_)),
      parcel_(other.parcel_),
      transmission_(std::exchange(other.transmission_, 0)) {}

Answer& Answer::operator=(Answer&& other) noexcept {
  if (this != &other) {
    forget();
    transfer_ = std::move(other.transfer_);
    parcel_ = other.parcel_;
    transmission_ = std::exchange(other.transmission_, 0);
  }
  return *this;
}

Answer::~Answer() { forget(); }

void Answer::forget() noexcept {
  try {
    if (*this) {
      if (const auto transfer = transfer_.lock()) transfer->left_unanswered(parcel_, std::exchange(transmission_, 0));
    }
  } catch (...) {  // no memory for the report: its time-out comes
  }
}

Answer::operator bool() const noexcept {
  if (transmission_ == 0) return false;
  const auto transfer = transfer_.lock();
  return transfer != nullptr && transfer->awaited(parcel_, transmission_) != nullptr;
}

void Answer::acknowledge() {
  if (const auto transfer = transfer_.lock()) transfer->acknowledge(parcel_, std::exchange(transmission_, 0));
}

void Answer::confirm(std::size_t rows) {
  if (const auto transfer = transfer_.lock()) transfer->confirm(parcel_, transmission_, rows);
}

std::size_t Answer::confirmed() const noexcept {
  const auto transfer = transfer_.lock();
  return transfer != nullptr ? transfer->confirmed(parcel_, transmission_) : 0;
}

void Answer::refuse(std::size_t row, Error why) {
  if (const auto transfer = transfer_.lock()) transfer->refuse(parcel_, transmission_, row, std::move(why));
}

void Answer::again(Error why, std::optional<Duration> after) {
  if (const auto transfer = transfer_.lock()) transfer->again(parcel_, std::exchange(transmission_, 0), why, after);
}

namespace detail {
namespace {

constexpr int most_in_a_turn = 64;  // then other callbacks have their turn

}  // namespace

Transfer::Transfer(LoopCore& loop, Sender& sender, const SinkConfig& config, Owner& owner)
    : loop_(loop),
      sender_(sender),
      sending_(sender.sending()),
      config_(config),
      owner_(&owner),
      timer_(loop.face, [this] { timer_fired(); }) {}

template <class Call>
std::optional<Error> Transfer::call_sender(const char* name, Call&& call) noexcept {
  const auto threw = [name](std::string_view why) {
    return Error{Errc::handler_threw, "the sender threw", name, std::string(why), ""};
  };
  try {
    try {
      call();
    } catch (const std::exception& e) {
      return threw(reason_of(e));
    } catch (...) {
      return threw("an exception that is not a std::exception");
    }
  } catch (...) {  // no memory for the report
    return Error{};
  }
  return std::nullopt;
}

void Transfer::report(const std::optional<Error>& error) noexcept {
  if (error && owner_ != nullptr) owner_->sender_threw(*error);
}

void Transfer::begin(std::span<const Parcel> parcels) {
  entries_.clear();
  entries_.resize(parcels.size());
  parcels_ = parcels;
  next_ = settled_ = under_way_ = answered_ = 0;
  sent_.clear();
  sent_.reserve(2 * sending_.window);
  first_sent_ = 0;
  go_on();
}

void Transfer::try_now() {
  if (!blocked_until_) return;
  blocked_until_.reset();
  backoff_.reset();
  go_on();
}

void Transfer::end() noexcept {
  owner_ = nullptr;
  const bool is_awaited = under_way_ > 0;
  for (Entry& entry : entries_) entry.transmission = 0;
  entries_.clear();
  settled_ = under_way_ = answered_ = 0;
  timer_.close();
  if (!has_begun_) return;
  // The owner is gone: exceptions of these calls are ignored.
  if (is_awaited) (void)call_sender("cancel", [this] { sender_.cancel(); });
  (void)call_sender("end", [this] { sender_.end(); });
}

Transfer::Entry* Transfer::awaited(std::size_t parcel, std::uint64_t transmission) noexcept {
  if (transmission == 0 || parcel >= entries_.size()) return nullptr;
  Entry& entry = entries_[parcel];
  return entry.state == Entry::State::sent && entry.transmission == transmission ? &entry : nullptr;
}

void Transfer::acknowledge(std::size_t parcel, std::uint64_t transmission) {
  Entry* const entry = awaited(parcel, transmission);
  if (entry == nullptr) return;
  entry->state = Entry::State::answered;
  --under_way_;
  ++answered_;
  backoff_.reset();
  go_on();
}

void Transfer::confirm(std::size_t parcel, std::uint64_t transmission, std::size_t rows) {
  Entry* const entry = awaited(parcel, transmission);
  if (entry == nullptr || rows <= entry->confirmed) return;
  entry->confirmed = std::min(rows, parcels_[parcel].rows().size());
  backoff_.reset();
  const auto self = shared_from_this();
  settle_some();  // and sends nothing: its sender may be about to say that the connection is lost
}

std::size_t Transfer::confirmed(std::size_t parcel, std::uint64_t transmission) noexcept {
  const Entry* const entry = awaited(parcel, transmission);
  return entry != nullptr ? entry->confirmed : 0;
}

void Transfer::refuse(std::size_t parcel, std::uint64_t transmission, std::size_t row, Error why) {
  Entry* const entry = awaited(parcel, transmission);
  if (entry == nullptr || row >= parcels_[parcel].rows().size()) return;
  for (const RefusedRow& other : entry->refused) {
    if (other.row == row) return;
  }
  entry->refused.push_back({row, std::move(why)});
}

void Transfer::again(std::size_t parcel, std::uint64_t transmission, const Error& why, std::optional<Duration> after) {
  Entry* const entry = awaited(parcel, transmission);
  if (entry == nullptr) return;
  entry->wait();
  --under_way_;
  next_ = std::min(next_, parcel);
  wait_after(why, after);
  go_on();
}

/// Several parcels fail together when their connection does: that is one failure.
void Transfer::wait_after(const Error& why, std::optional<Duration> after) {
  const MonotonicTime now = loop_.now();
  if (blocked_until_) {
    if (after) blocked_until_ = std::max(*blocked_until_, later(now, *after));
    return;
  }
  const Duration delay = backoff_.next(config_.retry_first, config_.retry_longest, config_.name);
  blocked_until_ = later(now, after ? std::max(*after, Duration{0}) : delay);
  if (owner_ != nullptr) owner_->sending_failed(why);
}

void Transfer::go_on() {
  is_more_to_do_ = true;
  if (std::exchange(is_going_on_, true)) return;  // an answer within a call of the sender's
  const auto self = shared_from_this();
  while (owner_ != nullptr && std::exchange(is_more_to_do_, false)) {
    settle_some();
    if (owner_ != nullptr) send_some();
  }
  is_going_on_ = false;
  if (owner_ == nullptr) return;
  if (!entries_.empty() && settled_ == entries_.size()) {
    entries_.clear();
    settled_ = answered_ = 0;
    timer_.stop();
    timer_at_.reset();
    owner_->all_settled();
  } else {
    set_timer();
  }
}

void Transfer::settle_some() {
  while (owner_ != nullptr && settled_ < entries_.size() && entries_[settled_].state == Entry::State::answered) {
    const std::size_t parcel = settled_++;
    settle_rows(parcel, parcels_[parcel].rows().size());
  }
  if (owner_ != nullptr && settled_ < entries_.size()) settle_rows(settled_, entries_[settled_].confirmed);
}

void Transfer::settle_rows(std::size_t parcel, std::size_t last) {
  Entry& entry = entries_[parcel];
  if (last <= entry.settled) return;
  const std::size_t first = std::exchange(entry.settled, last);
  std::vector<RefusedRow> refused;
  std::erase_if(entry.refused, [&](RefusedRow& row) {
    if (row.row >= last) return false;
    refused.push_back(std::move(row));
    return true;
  });
  owner_->rows_settled(parcel, first, last, refused);
}

/// False: it threw, and is called again after a while.
bool Transfer::begin_sender() {
  if (has_begun_) return true;
  const auto error = call_sender("begin", [this] { sender_.begin(loop_.face); });
  has_begun_ = !error;
  if (error) wait_after(*error, {});
  return has_begun_;
}

void Transfer::send_some() {
  if (blocked_until_ || next_ >= entries_.size() || !begin_sender()) return;
  int sent = 0;
  while (owner_ != nullptr && !blocked_until_ && under_way_ < sending_.window) {
    while (next_ < entries_.size() && entries_[next_].state != Entry::State::waiting) ++next_;
    if (next_ == entries_.size()) return;
    if (settled_ < due_before(next_)) return;
    if (sending_.bytes_per_second != 0 && paced_until_ > loop_.now()) return;
    if (++sent > most_in_a_turn) return;
    send(next_++);
  }
}

std::size_t Transfer::due_before(std::size_t parcel) const noexcept {
  const auto is_account = [](const Parcel::Row& row) { return row.info->topic == account_topic; };
  if (parcels_[parcel].rows().empty() || !is_account(parcels_[parcel].rows().back())) return 0;
  while (parcel > 0 && !parcels_[parcel - 1].rows().empty() && is_account(parcels_[parcel - 1].rows().front()))
    --parcel;
  return parcel;
}

void Transfer::send(std::size_t parcel) {
  const MonotonicTime now = loop_.now();
  if (sending_.bytes_per_second != 0) {
    const double seconds = static_cast<double>(parcels_[parcel].bytes().size()) /
                           static_cast<double>(sending_.bytes_per_second);
    paced_until_ = later(std::max(paced_until_, now), std::chrono::duration_cast<Duration>(
                                                          std::chrono::duration<double>(std::min(seconds, 3600.0))));
  }
  Entry& entry = entries_[parcel];
  entry.state = Entry::State::sent;
  entry.transmission = ++transmissions_;
  entry.deadline = later(now, sending_.timeout);
  ++under_way_;
  if (sent_.size() == sent_.capacity()) {  // the list has room for twice as many parcels as can be under way
    std::erase_if(sent_, [this](const Sent& sent) { return awaited(sent.parcel, sent.transmission) == nullptr; });
    first_sent_ = 0;
  }
  sent_.push_back({parcel, transmissions_});
  const std::uint64_t transmission = sending_now_ = transmissions_;
  is_left_unanswered_ = false;
  const auto error = call_sender(
      "send", [&] { sender_.send(parcels_[parcel], Answer(weak_from_this(), parcel, transmission)); });
  sending_now_ = 0;
  // After an exception the state of the parcel is unknown.
  if (error && awaited(parcel, transmission) != nullptr) return give_up(*error);
  report(error);
  if (std::exchange(is_left_unanswered_, false)) left_unanswered(parcel, transmission);
}

void Transfer::left_unanswered(std::size_t parcel, std::uint64_t transmission) {
  // Within `send` it may be an exception that destroys the answer: that says more.
  if (transmission == sending_now_)
    is_left_unanswered_ = true;
  else
    again(parcel, transmission, {Errc::io_failed, "cannot send", "", "the sender gave no answer", ""}, {});
}

/// Everything that is under way.
void Transfer::give_up(const Error& why) {
  for (Entry& entry : entries_) {
    if (entry.state != Entry::State::sent) continue;
    entry.wait();
  }
  under_way_ = 0;
  next_ = settled_;
  report(call_sender("cancel", [this] { sender_.cancel(); }));
  if (owner_ != nullptr) wait_after(why, {});
}

void Transfer::timer_fired() {
  const MonotonicTime now = loop_.now();
  timer_at_.reset();
  if (blocked_until_ && *blocked_until_ <= now) blocked_until_.reset();
  if (const auto deadline = next_deadline(); deadline && *deadline <= now) {
    const auto self = shared_from_this();
    give_up({Errc::timed_out, "cannot send", config_.name, "no answer for " + to_string(sending_.timeout),
             "check the peer and the network; everything is sent again"});
    if (owner_ == nullptr) return;
  }
  go_on();
}

void Transfer::set_timer() {
  std::optional<MonotonicTime> at = blocked_until_;
  const auto wake_at = [&at](MonotonicTime time) { at = at ? std::min(*at, time) : time; };
  if (const auto deadline = next_deadline()) wake_at(*deadline);
  const bool is_any_waiting = under_way_ + answered_ < entries_.size();
  if (is_any_waiting && !blocked_until_ && under_way_ < sending_.window)
    wake_at(sending_.bytes_per_second != 0 ? std::max(paced_until_, loop_.now()) : loop_.now());
  if (!at) {
    timer_.stop();
    timer_at_.reset();
  } else if (!timer_at_ || *at < *timer_at_) {  // at a time that is over it looks again
    timer_.start_at(*at);
    timer_at_ = at;
  }
}

std::optional<MonotonicTime> Transfer::next_deadline() noexcept {
  for (; first_sent_ < sent_.size(); ++first_sent_) {
    const Sent& sent = sent_[first_sent_];
    if (const Entry* entry = awaited(sent.parcel, sent.transmission)) return entry->deadline;
  }
  return std::nullopt;
}

}  // namespace detail
}  // namespace rtdata
