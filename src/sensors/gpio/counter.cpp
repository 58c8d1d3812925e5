#include "rtdata/sensors/counter.hpp"

#include <cmath>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "sensors/core/per_time.hpp"
#include "sensors/core/source_node.hpp"

namespace rtdata {
namespace {

double seconds(Duration duration) { return std::chrono::duration<double>(duration).count(); }

class CounterDevice final : public detail::SensorDevice {
 public:
  CounterDevice(Loop& loop, std::string name, CounterConfig config, std::shared_ptr<GpioBackend> backend)
      : loop_(loop), name_(std::move(name)), config_(std::move(config)), backend_(std::move(backend)) {}

  Result<void> open() override {
    try {
      edges_ = GpioEdges(
          loop_, config_.input, [this](const GpioEdge& edge) { take(edge); }, backend_);
    } catch (const SetupError& error) {
      return error.error();
    }
    edges_.on_error([this](const ErrorReport& report) { tell(report.error); });
    opened_ = loop_.core().now();
    before_ = count_;
    overflows_before_ = overflows_;
    in_interval_ = 0;
    last_ = earlier_ = std::nullopt;
    return {};
  }
  void close() override { edges_.close(); }
  ReadTime read_time() const override { return rtdata::read_time(config_); }

  detail::Sampled sample(detail::SamplePort& port) override {
    edges_.take_waiting();
    if (auto failure = edges_.failure()) return port.fail(*std::move(failure));
    overflows_ = overflows_before_ + edges_.counts().overflows;
    CounterReading reading;
    reading.count = count_;
    reading.total = static_cast<double>(count_) * config_.per_pulse;
    reading.frequency = frequency();
    if (reading.frequency) reading.speed = *reading.frequency * config_.per_pulse * detail::seconds_of(config_.per);
    reading.overflows = overflows_;
    in_interval_ = 0;
    earlier_ = last_;
    port.publish(&reading);
    return detail::Sampled::value;
  }

 private:
  void take(const GpioEdge& edge) {
    const std::uint64_t count = before_ + edge.number;
    const std::uint64_t more = count - count_;
    // The first pulse of an interval can be measured only from an earlier pulse that is not too old.
    if (in_interval_ == 0 && (!earlier_ || edge.time - *earlier_ >= config_.still_after)) {
      earlier_ = edge.time;
      in_interval_ = 0;
      is_begun_ = true;
    } else {
      in_interval_ += more;
    }
    count_ = count;
    last_ = edge.time;
  }

  std::optional<double> frequency() {
    const bool has_begun = std::exchange(is_begun_, false);
    if (in_interval_ > 0) {
      const double took = seconds(*last_ - *earlier_);
      if (took > 0) return static_cast<double>(in_interval_) / took;
      return {};
    }
    if (has_begun) return {};  // one pulse has no frequency
    const MonotonicTime since = last_.value_or(opened_);
    if (loop_.core().now() - since >= config_.still_after) return 0.0;
    return {};
  }

  void tell(const Error& error) {
    if (edges_.failure()) return;           // the next tick fails with it
    if (backend_->numbers_edges()) return;  // dropped pulses are in the count
    loop_.core().runtime.report(&loop_.core(), "sensor " + name_, error);
  }

  Loop& loop_;
  const std::string name_;
  const CounterConfig config_;
  const std::shared_ptr<GpioBackend> backend_;
  GpioEdges edges_;
  MonotonicTime opened_{};
  std::uint64_t count_ = 0;
  std::uint64_t before_ = 0;  // count_ when the line was taken
  std::uint64_t overflows_ = 0;
  std::uint64_t overflows_before_ = 0;
  std::uint64_t in_interval_ = 0;         // pulses after `earlier_`
  std::optional<MonotonicTime> earlier_;  // the pulse that this interval is measured from
  std::optional<MonotonicTime> last_;
  bool is_begun_ = false;  // in this interval, by a pulse that is measured from
};

}  // namespace

Result<std::shared_ptr<const Description>> counter_description(const CounterConfig& config) {
  const std::string unit = config.unit.empty() ? "{pulse}" : config.unit;
  using Presence = DescriptionBuilder::Presence;
  return DescriptionBuilder("counter")
      .field("count", Kind::u64)
      .field("total", Kind::f64, unit)
      .field("frequency", Kind::f64, "Hz", Presence::optional)
      .field("speed", Kind::f64, detail::unit_of_speed(unit, config.per), Presence::optional)
      .field("overflows", Kind::u64)
      .build();
}

ReadTime read_time(const CounterConfig&) { return {.on_loop = std::chrono::microseconds{200}}; }

CounterSensor::CounterSensor(Loop& loop, SensorConfig sensor, CounterConfig config,
                             std::shared_ptr<GpioBackend> backend) {
  const auto refuse = [&](const char* why, const char* advice) {
    throw SetupError({Errc::bad_argument, "cannot use this counter", "sensor " + sensor.name, why, advice});
  };
  if (config.input.line.text.empty()) refuse("it has no line", "set `line`, such as \"GPIO17\"");
  if (!std::isfinite(config.per_pulse) || config.per_pulse == 0) refuse("per_pulse is 0 or not a number", "such as 1");
  if (config.per != "s" && config.per != "min" && config.per != "h")
    refuse("`per` is not a unit of time", "use s, min or h");
  if (config.still_after <= Duration{0}) refuse("still_after is not positive", "such as 5 s");
  if (config.input.consumer == GpioInput{}.consumer) config.input.consumer += " " + sensor.name;
  auto type = detail::described_type(counter_description(config).or_throw());
  auto device = std::make_unique<CounterDevice>(loop, sensor.name, std::move(config), std::move(backend));
  *this = CounterSensor(detail::make_sensor(loop, std::move(sensor), std::move(type), std::move(device)));
}

}  // namespace rtdata
