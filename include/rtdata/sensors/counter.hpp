/// CounterSensor: counts the pulses on a GPIO line: a fan, a flow meter, a rain gauge, an energy meter.
///
///     rtdata::CounterSensor fan(loop, {.name = "fan", .rate = 1_Hz},
///                               {.input = {.line = "GPIO17"}, .per_pulse = 0.5, .unit = "{rev}", .per = "min"});
///
/// At its rate it publishes
/// - `count`: pulses since it was made, also those that the kernel dropped, where it numbers them (libgpiod 2);
/// - `total`: count * per_pulse, in `unit`;
/// - `frequency`: pulses a second, from the kernel's times of the last pulse in this interval and the last one before
///   it. No value without a pulse in the interval; 0 after `still_after` without a pulse; the next one is computed from
///   the pulses of its interval alone;
/// - `speed`: frequency * per_pulse, in `unit` a `per`;
/// - `overflows`: how often the kernel's buffer was full, so that `count` may be too low. Always 0 with libgpiod 2,
///   which numbers the pulses.
///
/// Ticks fail while the line cannot be read. It is opened again like any sensor's device and continues its count: the
/// pulses during an outage are unknown, and the gap shows its time.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "rtdata/io/gpio.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace rtdata {

/// As it lies in events.
struct CounterReading {
  std::uint64_t count = 0;
  double total = 0;
  std::optional<double> frequency = {};
  std::optional<double> speed = {};
  std::uint64_t overflows = 0;
};

struct CounterConfig {
  GpioInput input = {.edges = GpioEdgeKind::rising};
  double per_pulse = 1;                            ///< value of one pulse, in `unit`
  std::string unit = {};                           ///< UCUM; empty: pulses
  std::string per = "s";                           ///< of the speed: "s", "min", "h"
  Duration still_after = std::chrono::seconds{5};  ///< without a pulse for this long, the frequency is 0

  friend constexpr auto parameters(type_tag<CounterConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        include_member(&CounterConfig::input),
        parameter("per_pulse", &CounterConfig::per_pulse, "the amount of one pulse, in `unit`", not_zero),
        parameter("unit", &CounterConfig::unit, "unit of `total` (UCUM), such as L, {rev}, mm, kW.h; empty: pulses",
                  TextIs::unit),
        parameter("per", &CounterConfig::per, "time unit of `speed`", choices("s", "min", "h")),
        parameter("still_after", &CounterConfig::still_after, "after this time without a pulse, the frequency is 0",
                  range(Duration{1ms}, Duration{24h})));
  }
};

/// Errors: bad-description (an invalid unit).
Result<std::shared_ptr<const Description>> counter_description(const CounterConfig& config);
ReadTime read_time(const CounterConfig& config);

class CounterSensor : public AnySensor {
 public:
  CounterSensor() noexcept = default;
  /// SetupError: as `Sensor`; bad-argument for a configuration that cannot work.
  CounterSensor(Loop& loop, SensorConfig sensor, CounterConfig config)
      : CounterSensor(loop, std::move(sensor), std::move(config), make_kernel_gpio()) {}
  CounterSensor(Loop& loop, SensorConfig sensor, CounterConfig config, std::shared_ptr<GpioBackend> backend);

 private:
  explicit CounterSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
