#include "rtdata/sensors/edge.hpp"

#include "sensors/core/stream_node.hpp"

namespace rtdata {
namespace detail {

class EdgeNode final : public StreamNode {
 public:
  EdgeNode(LoopCore& loop, const FeedConfig& feed, EdgeConfig config, std::shared_ptr<GpioBackend> backend)
      : StreamNode(loop, feed, payload_type<EdgeReading>(), {config.silence, config.retry_first, config.retry_longest}),
        config_(std::move(config)),
        backend_(std::move(backend)) {
    origin_.counts.lost_is_known = backend_->numbers_edges();
  }

  void start() override {
    if (!is_open() || is_running()) return;
    Result<GpioEdges> edges = take_line();
    if (!edges && config_.required) throw SetupError(std::move(edges).error());
    begin();
    use(std::move(edges));
  }
  std::optional<SensorLoad> load() const override {
    return SensorLoad{origin_.name, Duration{0}, {}, read_time(config_)};
  }

 private:
  void open_stream() override { use(take_line()); }
  Result<GpioEdges> take_line() {
    try {
      return GpioEdges(
          loop()->face, config_.input, [this](const GpioEdge& edge) { take(edge); }, backend_);
    } catch (const SetupError& error) {
      return error.error();
    }
  }
  void use(Result<GpioEdges> edges) {
    if (!edges) return lose(edges.error(), loop()->now());
    edges_ = *std::move(edges);
    edges_.on_error([this](const ErrorReport& told) {
      Call call(*this);
      const Error error = told.error;
      settle_accounts();
      if (edges_.failure()) {
        lose(error, loop()->now());
      } else {
        degrade(error);
      }
    });
    before_ = count_;
    accounted_ = {};
    opened();
    set_healthy();  // although no edge came
  }
  void close_stream() noexcept override {
    settle_accounts();
    edges_.close();
  }

  /// Takes over the counts of the line besides its edges.
  void settle_accounts() noexcept {
    if (!edges_.is_open()) return;
    const GpioEdgeCounts now = edges_.counts();
    origin_.counts.lost += now.lost - accounted_.lost;
    origin_.counts.received += now.filtered - accounted_.filtered;
    origin_.counts.filtered += now.filtered - accounted_.filtered;
    if (now.overflows != accounted_.overflows) {  // the number of missing edges is unknown: a gap shows this
      origin_.begin_absence(Gap::Kind::silent, id(Errc::backlog), last_);
      origin_.end_absence(loop()->now());
    }
    accounted_ = now;
  }
  void take(const GpioEdge& edge) {
    Call call(*this);
    heard();
    settle_accounts();
    count_ = before_ + edge.number;
    last_ = edge.time;
    EdgeReading reading{edge.level, count_};
    ++origin_.counts.received;
    ++origin_.counts.published;
    origin_.topic.publish(origin_, loop()->runtime.event_time(edge.time), &reading);
    if (is_open() && is_running()) succeed();
  }

  Error silence_error() const override {
    return {Errc::timed_out, "nothing comes", "line " + config_.input.line.text,
            "no edge for " + to_string(config_.silence),
            "check what drives the line; `silence` is how long the line may have no edge"};
  }
  void on_close() noexcept override {
    StreamNode::on_close();
    edges_.close();
  }

  const EdgeConfig config_;
  const std::shared_ptr<GpioBackend> backend_;
  GpioEdges edges_;
  std::uint64_t count_ = 0;
  std::uint64_t before_ = 0;  // count_ when the line was taken
  MonotonicTime last_{};      // of the last edge
  GpioEdgeCounts accounted_;
};

}  // namespace detail

ReadTime read_time(const EdgeConfig&) { return {.on_loop = std::chrono::microseconds{200}}; }

EdgeSensor::EdgeSensor(Loop& loop, FeedConfig feed, EdgeConfig config, std::shared_ptr<GpioBackend> backend) {
  const auto refuse = [&](const char* why, const char* advice) {
    throw SetupError({Errc::bad_argument, "cannot use this GPIO line", "sensor " + feed.name, why, advice});
  };
  if (config.input.line.text.empty()) refuse("it has no line", "set `line`, such as \"GPIO17\"");
  if (config.retry_first <= Duration{0}) refuse("retry_first is not positive", "such as 100 ms");
  if (config.input.consumer == GpioInput{}.consumer) config.input.consumer += " " + feed.name;
  const bool starts = config.start;
  auto* node = new detail::EdgeNode(loop.core(), feed, std::move(config), std::move(backend));
  EdgeSensor made(node);
  if (starts) node->start();
  *this = std::move(made);
}

}  // namespace rtdata
