/// EdgeSensor: the edges of a GPIO line (a button, a limit switch, a trigger), each an event.
///
///     rtdata::EdgeSensor door(loop, {.name = "door"},
///                             {.input = {.line = "GPIO17", .bias = rtdata::GpioBias::pull_up}});
///     auto heard = loop.subscribe<rtdata::EdgeReading>("door", [](const rtdata::Event<rtdata::EdgeReading>& edge) {
///       std::puts(edge->level ? "active" : "inactive");
///     });
///
/// The event has the kernel's time of the edge. `count` continues after outages; the gap shows the time of an outage.
///
/// - With libgpiod 2, edges dropped by the kernel are counted as lost, included in `count`, and reported. With libgpiod
///   1 `lost` is unknown: the sensor reports possible losses when the kernel's buffer was full.
/// - Bounces suppressed by the library (`debounce`, with libgpiod 1) count as filtered.
/// - If the chip disappears or is missing at the start, the sensor is faulted and tries again after `retry_first`,
///   doubling to `retry_longest`; the time without the chip is a gap (disconnected). If the kernel does not report it,
///   the sensor detects the missing chip file within 1 s.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstdint>
#include <memory>
#include <utility>

#include "rtdata/io/gpio.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata {

struct EdgeReading {
  bool level = false;       ///< after it: a rising edge makes the line active
  std::uint64_t count = 0;  ///< of the edges so far, this one included
  friend constexpr auto describe(type_tag<EdgeReading>) {
    return record("edge", field("level", &EdgeReading::level), field("count", &EdgeReading::count));
  }
};

struct EdgeConfig {
  GpioInput input = {};
  Duration silence{0};                                    ///< without an edge for longer, it has a gap; 0: no limit
  Duration retry_first = std::chrono::milliseconds{100};  ///< first delay before trying a lost chip again
  Duration retry_longest = std::chrono::seconds{10};      ///< the delay doubles up to this
  bool required = false;                                  ///< a line that cannot be used at the start throws
  bool start = true;                                      ///< start when made

  friend constexpr auto parameters(type_tag<EdgeConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        include_member(&EdgeConfig::input),
        parameter("silence", &EdgeConfig::silence,
                  "after this time without an edge, the sensor is degraded and has a gap; 0: never",
                  range(Duration{0}, Duration{24h})),
        parameter("retry_first", &EdgeConfig::retry_first, "first delay before the program looks for a lost chip again",
                  range(Duration{1ms}, Duration{1h})),
        parameter("retry_longest", &EdgeConfig::retry_longest, "the delay doubles up to this",
                  range(Duration{1ms}, Duration{24h})),
        parameter("required", &EdgeConfig::required, "true: the program ends if the line cannot be used at the start"),
        parameter("start", &EdgeConfig::start, "start it with the system"));
  }
};

/// How long the longest read takes.
ReadTime read_time(const EdgeConfig& config);

class EdgeSensor : public AnySensor {
 public:
  EdgeSensor() noexcept = default;
  /// SetupError: as `Feed`; bad-argument for a configuration that cannot work; the error of a required line.
  EdgeSensor(Loop& loop, FeedConfig feed, EdgeConfig config)
      : EdgeSensor(loop, std::move(feed), std::move(config), make_kernel_gpio()) {}
  EdgeSensor(Loop& loop, FeedConfig feed, EdgeConfig config, std::shared_ptr<GpioBackend> backend);

 private:
  explicit EdgeSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
