// An output's device in the guard.
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/tier_core.hpp"
#include "outputs/guard_link.hpp"
#include "outputs/port.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"

namespace rtdata::detail {
namespace {

constexpr const char* guard_cannot_set = "cannot set the output";
constexpr int beat_ms = 10;

class GuardPort final : public OutputPort {
 public:
  GuardPort(Loop& loop, const std::string& name, std::shared_ptr<OutputGuard::Link> link, const std::string& guarded,
            double safe, Listener& listener)
      : link_(std::move(link)),
        guarded_(guarded),
        safe_(safe),
        listener_(listener),
        loop_(loop),
        name_(name),
        patience_(loop, {.name = name}, [this] { tell(no_answer()); }) {
    introduce().or_throw();
  }
  ~GuardPort() override {
    if (const int socket = close(); socket >= 0) ::close(socket);
  }

  Result<void> open(std::optional<double> value) override {
    late_trip_.reset();
    if (socket_ < 0)
      if (const auto known = introduce(); !known) return known;
    return exchange({GuardOrder::open, value ? 1U : 0U, value.value_or(0)});
  }
  Result<void> begin_open(std::optional<double> value) override {
    late_trip_.reset();
    if (Result<void> sent = send({GuardOrder::open, value ? 1U : 0U, value.value_or(0)}); !sent) return sent;
    patience_.start(longest_wait);
    return {};
  }
  Result<void> set(double value) override { return send({GuardOrder::set, 1U, value}); }
  /// Afterwards the guard does not know the output any more.
  Result<void> finish(std::optional<double> value) override {
    wants_safe_ = value.has_value();
    return finished(exchange({GuardOrder::finish, value ? 1U : 0U, value.value_or(0)}));
  }
  Result<void> begin_finish(std::optional<double> value) override {
    wants_safe_ = value.has_value();
    if (Result<void> sent = send({GuardOrder::finish, value ? 1U : 0U, value.value_or(0)}); !sent)
      return finished(std::move(sent));
    is_finishing_ = true;
    patience_.start(longest_wait);
    return {};
  }
  Result<void> wait_for_end() override {
    patience_.stop();
    is_finishing_ = false;
    return finished(await());
  }
  std::optional<Result<void>> late_trip() const override { return late_trip_; }
  void beat(MonotonicTime until) noexcept override {
    if (socket_ < 0) return;
    link_->beats[slot_].until.store(until.time_since_epoch().count(), std::memory_order_release);
    link_->patience[slot_].time.store((until - loop_.now()).count(), std::memory_order_relaxed);
    link_->patience[slot_].loop.store(&loop_, std::memory_order_relaxed);
  }
  std::optional<MonotonicTime> guard_seen() const noexcept override {
    if (socket_ < 0) return {};
    return MonotonicTime{Duration{link_->beats[slot_].seen.load(std::memory_order_acquire)}};
  }
  bool is_to_end() const noexcept override { return link_->is_ending.load(std::memory_order_acquire); }
  void arm() noexcept override { (void)send({GuardOrder::arm, 0U, 0}); }
  void disarm() noexcept override { (void)send({GuardOrder::disarm, 0U, 0}); }
  bool is_guarded() const noexcept override { return true; }

 private:
  Result<void> introduce() {
    Result<int> socket = link_->introduce(name_, safe_, guarded_, above_tiers(), slot_);
    if (!socket) return std::move(socket).error();
    socket_ = *socket;
    watch_ = FdWatch(loop_, socket_, FdWatch::readable, name_, [this](const FdEvent&) { receive(); });
    loop_.core().lanes.while_waiting.emplace_back(this, [this] { link_->beat_for(loop_); });
    return {};
  }
  /// A priority with which the guard's thread runs although real-time tiers use all processors; 0: no such tiers.
  int above_tiers() const {
    int highest = 0;
    for (const TierCore* tier : loop_.core().runtime.main().tiers)
      if (tier->config.policy != SchedulingPolicy::other) highest = std::max(highest, tier->config.priority);
    return highest > 0 ? std::min(highest + 1, priority_range(SchedulingPolicy::fifo).highest) : 0;
  }
  /// Passes the socket to the caller; -1: there is none.
  int close() noexcept {
    if (socket_ < 0) return -1;
    watch_.close();
    std::erase_if(loop_.core().lanes.while_waiting, [this](const auto& one) { return one.first == this; });
    link_->release(slot_);
    return std::exchange(socket_, -1);
  }
  Result<void> finished(Result<void> result) {
    if (wants_safe_) link_->note(name_, result.has_value());
    const int socket = close();
    if (socket < 0) return result;
    if (result || !wants_safe_)
      ::close(socket);
    else
      link_->await_end(loop_, name_, socket);
    return result;
  }
  /// The result of the last order.
  void tell(Result<void> result) {
    patience_.stop();
    if (std::exchange(is_finishing_, false)) result = finished(std::move(result));
    listener_.answered(std::move(result));  // the last use of this object
  }
  static Error no_answer() {
    return {Errc::timed_out, guard_cannot_set, "", "its guard does not answer", "check the device"};
  }
  static Error ended() {
    return {Errc::disconnected, guard_cannot_set, "", "its guard has ended", "start the program again"};
  }

  Result<void> send(const GuardOrder& order) {
    if (socket_ >= 0 && ::send(socket_, &order, sizeof order, MSG_NOSIGNAL | MSG_DONTWAIT) == sizeof order) {
      if (order.kind != GuardOrder::arm && order.kind != GuardOrder::disarm) ++unanswered_;
      return {};
    }
    if (socket_ >= 0 && (errno == EAGAIN || errno == ENOBUFS))
      return Error{Errc::backlog, guard_cannot_set, "", "its guard accepts no more orders", "check the device"};
    return ended();
  }
  Result<void> exchange(const GuardOrder& order) {
    if (const Result<void> sent = send(order); !sent) return sent;
    return await();
  }
  /// Waits for the answer to the last order, while the loop's other outputs are held.
  Result<void> await() {
    const auto until = std::chrono::steady_clock::now() + longest_wait;
    while (std::chrono::steady_clock::now() < until) {
      pollfd one{socket_, POLLIN, 0};
      if (::poll(&one, 1, beat_ms) <= 0) {
        link_->beat_for(loop_);
        continue;
      }
      GuardAnswer answer;
      const ssize_t got = ::recv(socket_, &answer, sizeof answer, MSG_DONTWAIT);
      if (got < 0 && (errno == EAGAIN || errno == EINTR)) continue;
      if (got != sizeof answer) return ended();
      if (answer.kind == GuardAnswer::tripped) late_trip_ = answer.result();
      if (answer.kind != GuardAnswer::answered || --unanswered_ > 0) continue;
      return answer.result();
    }
    return no_answer();
  }

  void receive() {
    GuardAnswer answer;
    const ssize_t got = ::recv(socket_, &answer, sizeof answer, MSG_DONTWAIT);
    if (got < 0 && (errno == EAGAIN || errno == EINTR)) return;
    if (got != sizeof answer) {
      watch_.close();
      if (is_finishing_) return tell(ended());
      return listener_.lost(ended());  // the last use of this object
    }
    if (answer.kind == GuardAnswer::tripped) return listener_.tripped(answer.result());
    if (answer.kind == GuardAnswer::vanished) return listener_.vanished(answer.result().error());
    if (answer.kind != GuardAnswer::answered) return;
    --unanswered_;
    if (!is_finishing_ || unanswered_ == 0) tell(answer.result());
  }

  const std::shared_ptr<OutputGuard::Link> link_;
  const std::string guarded_;
  const double safe_;
  Listener& listener_;
  Loop& loop_;
  const std::string name_;
  std::uint32_t slot_ = 0;
  int socket_ = -1;
  int unanswered_ = 0;
  bool wants_safe_ = false;    // at its end
  bool is_finishing_ = false;  // and the loop turns meanwhile
  std::optional<Result<void>> late_trip_;
  FdWatch watch_;
  Timer patience_;
};

}  // namespace

std::unique_ptr<OutputPort> make_guard_port(Loop& loop, const std::string& name, OutputGuard& guard,
                                            const std::string& guarded, double safe, OutputPort::Listener& listener) {
  return std::make_unique<GuardPort>(loop, name, guard.link(), guarded, safe, listener);
}

}  // namespace rtdata::detail
