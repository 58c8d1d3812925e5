// A GPIO line's edges: their times and numbers, loss, debounce, and a chip that goes away.
#include <algorithm>
#include <array>
#include <cerrno>

#include "io/gpio_failure.hpp"
#include "loop/core/handler.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/io/gpio.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"

namespace rtdata {

namespace detail {
namespace {

constexpr std::size_t most_read = 64;                      // edges in one turn of the loop
constexpr Duration look_period = std::chrono::seconds{1};  // for checking that the chip is still there

}  // namespace

class GpioEdgesNode final : public Node {
 public:
  GpioEdgesNode(LoopCore& loop, GpioInput settings, Callback<void(const GpioEdge&)> callback,
                std::shared_ptr<GpioBackend> backend)
      : Node(loop),
        settings_(std::move(settings)),
        backend_(std::move(backend)),
        name_("GPIO line " + settings_.line.text),
        callback_(std::move(callback)) {
    if (!callback_) refuse_empty("cannot watch the GPIO line", settings_.line.text);
  }

  Result<void> open() {
    GpioInput asked = settings_;
    software_debounce_ = settings_.debounce > Duration{0} && !backend_->debounces();
    if (software_debounce_) asked.edges = GpioEdgeKind::both;
    from_ = loop()->now();
    Error error;
    request_ = take_gpio_input(*backend_, asked, true, place_, error);
    if (request_ == nullptr) return error;
    name_ = "GPIO line " + place_;
    if (software_debounce_) {
      const int value = request_->value();
      if (value < 0) return gpio_failure(-value, "cannot read the GPIO line", place_);
      level_ = value != 0;
      settle_ = Timer(loop()->face, {.name = name_}, [this] { settle(); });
    }
    watch_ = FdWatch(loop()->face, request_->descriptor(), FdWatch::readable, name_,
                     [this](const FdEvent& event) { ready(event.hung_up); });
    look_ = Timer(loop()->face, {.name = name_}, [this] { look(); });
    look_.start(look_period);
    return {};
  }

  Result<bool> read() const {
    constexpr const char* what = "cannot read the GPIO line";
    if (failure_) return *failure_;
    if (request_ == nullptr) return Error{Errc::closed, what, place_, "it is closed", ""};
    const int value = request_->value();
    if (value < 0) return gpio_failure(-value, what, place_);
    return value != 0;
  }
  void take_waiting() {
    Call call(*this);
    // Bounded: a continuous flood is left to the next turn.
    for (std::size_t left = 4096 / most_read; left > 0 && request_ != nullptr && take_some(false); --left) {
    }
  }
  const GpioEdgeCounts& counts() const noexcept { return counts_; }
  bool lost_is_known() const noexcept { return backend_->numbers_edges(); }
  const std::optional<Error>& failure() const noexcept { return failure_; }
  void set_on_error(Callback<void(const ErrorReport&)> handler) { on_error_.set(std::move(handler)); }
  std::string callback_name() const override { return name_; }

 private:
  void ready(bool has_hung_up) {
    Call call(*this);
    take_some(has_hung_up);
  }
  /// False: there were no more edges, or it has ended.
  bool take_some(bool has_hung_up) {
    std::array<GpioRawEdge, most_read> edges;
    const int got = request_->read(edges);
    if (got < 0 || (got == 0 && has_hung_up)) {
      end(gpio_failure(got < 0 ? -got : ENODEV, "lost the GPIO line", place_));
      return false;
    }
    const MonotonicTime now = loop()->now();
    const auto count = static_cast<std::size_t>(got);
    const std::uint64_t lost_before = counts_.lost;
    for (std::size_t i = 0; i < count; ++i) {
      take(edges[i], now);
      if (request_ == nullptr) return false;  // the callback has closed it
    }
    if (counts_.lost != lost_before) {
      tell({Errc::backlog, "edges are lost", place_,
            std::to_string(counts_.lost - lost_before) + " edges came faster than they were read",
            "find what holds the loop, move the sensor to its own tier, or set `debounce`"});
    } else if (const std::size_t kept = backend_->kept_edges();
               !backend_->numbers_edges() && kept != 0 && count >= kept && !software_debounce_) {
      ++counts_.overflows;
      tell({Errc::backlog, "edges may be lost", place_,
            "the kernel's buffer for " + std::to_string(kept) +
                " edges was full, and libgpiod 1 does not report how many it dropped",
            "find what holds the loop, move the sensor to its own tier, or use libgpiod 2"});
    }
    return count == edges.size() || (count != 0 && count == backend_->kept_edges());
  }

  void take(const GpioRawEdge& edge, MonotonicTime now) {
    std::uint64_t step = 1;
    if (backend_->numbers_edges()) {
      const std::uint32_t raw_step = edge.number - last_number_;
      last_number_ = edge.number;
      step = raw_step != 0 ? raw_step : 1;
      counts_.lost += step - 1;
    }
    MonotonicTime time{Duration{edge.time}};
    if (time > now || time < from_) time = now;  // the kernel used another clock
    if (!software_debounce_) return give({edge.is_rising, time, number_ += step});
    ++bounces_;
    last_bounce_ = time;
    settle_.start_at(later(time, settings_.debounce));
  }
  void give(const GpioEdge& edge) {
    ++counts_.edges;
    loop()->call_user(name_, [&] { callback_(edge); });
  }

  /// The debounce time has passed without an edge. Reads the level again, because edges may have been dropped.
  void settle() {
    Call call(*this);
    if (request_ == nullptr) return;
    const std::uint64_t bounces = std::exchange(bounces_, 0);
    const int value = request_->value();
    if (value < 0) return end(gpio_failure(-value, "lost the GPIO line", place_));
    const bool has_changed = (value != 0) != level_;
    counts_.filtered += has_changed ? bounces - std::min<std::uint64_t>(bounces, 1) : bounces;
    if (!has_changed) return;
    level_ = value != 0;
    if (settings_.edges == (level_ ? GpioEdgeKind::falling : GpioEdgeKind::rising)) return;
    give({level_, last_bounce_, ++number_});
  }
  void look() {
    Call call(*this);
    if (request_ == nullptr) return;
    if (!request_->is_there()) return end(gpio_failure(ENODEV, "lost the GPIO line", place_));
    look_.start(look_period);
  }

  void end(Error error) {
    give_back();
    failure_ = std::move(error);
    tell(*failure_);
  }
  void tell(const Error& error) {
    LoopCore& on = *loop();
    if (on_error_) {
      on.call_user(name_, [&] { on_error_({name_, error, 1}); });
    } else {
      on.runtime.report(&on, name_, error);
    }
  }
  void give_back() noexcept {
    watch_.close();  // before the descriptor
    look_.close();
    settle_.close();
    request_.reset();
  }
  void on_close() noexcept override { give_back(); }
  void drop_callbacks() noexcept override {
    callback_.reset();
    on_error_.reset();
  }

  const GpioInput settings_;
  const std::shared_ptr<GpioBackend> backend_;
  std::string name_;
  std::string place_;
  std::unique_ptr<GpioRequest> request_;
  FdWatch watch_;
  Timer look_;
  Timer settle_;
  MonotonicTime from_{};  // when the line was opened: no edge is older
  std::uint32_t last_number_ = 0;
  std::uint64_t number_ = 0;
  GpioEdgeCounts counts_;
  bool software_debounce_ = false;  // the backend does not debounce: done here
  bool level_ = false;              // the debounced level
  std::uint64_t bounces_ = 0;       // raw edges since the last check of the level
  MonotonicTime last_bounce_{};     // the time of the last raw edge
  std::optional<Error> failure_;
  Callback<void(const GpioEdge&)> callback_;
  Handler<ErrorReport> on_error_;
};

namespace {

GpioEdgesNode* edges(Node* node) noexcept {
  return node != nullptr && node->is_open() ? static_cast<GpioEdgesNode*>(node) : nullptr;
}

}  // namespace
}  // namespace detail

GpioEdges::GpioEdges(Loop& loop, GpioInput settings, Callback<void(const GpioEdge&)> callback,
                     const std::shared_ptr<GpioBackend>& backend)
    : Handle(new detail::GpioEdgesNode(loop.core(), std::move(settings), std::move(callback), backend)) {
  const Result<void> opened = static_cast<detail::GpioEdgesNode*>(node())->open();
  if (opened) return;
  close();
  throw SetupError(opened.error());
}

Result<bool> GpioEdges::read() const {
  if (auto* open = detail::edges(node())) return open->read();
  return Error{Errc::closed, "cannot read the GPIO line", "", "it is closed", ""};
}
void GpioEdges::take_waiting() {
  if (auto* open = detail::edges(node())) {
    open->loop()->check_thread("cannot take edges of", open->callback_name());
    open->take_waiting();
  }
}
GpioEdgeCounts GpioEdges::counts() const noexcept {
  const auto* open = detail::edges(node());
  return open != nullptr ? open->counts() : GpioEdgeCounts{};
}
bool GpioEdges::lost_is_known() const noexcept {
  const auto* open = detail::edges(node());
  return open != nullptr && open->lost_is_known();
}
std::optional<Error> GpioEdges::failure() const {
  const auto* open = detail::edges(node());
  return open != nullptr ? open->failure() : std::nullopt;
}
void GpioEdges::on_error(Callback<void(const ErrorReport&)> handler) {
  if (auto* open = detail::edges(node())) open->set_on_error(std::move(handler));
}

}  // namespace rtdata
