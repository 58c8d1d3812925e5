/// EncoderSensor: a counter of the kernel (/sys/bus/counter): a quadrature encoder, or pulses that hardware counts.
///
///     rtdata::EncoderSensor shaft(loop, {.name = "shaft", .rate = 100_Hz},
///                                 {.device = "44000000.timer:counter", .per_count = 1.0 / 4096, .unit = "{rev}"});
///
/// At its rate it publishes
/// - `count`: the kernel's counter, extended when it wraps around;
/// - `position`: count * per_count, in `unit`;
/// - `speed`: the change of position since the last reading, in `unit` a `per`; absent in the first reading;
/// - `direction`: forward or backward, as the hardware saw it last; absent if the driver does not report it.
///
/// The counter wraps around after `ceiling`, if the driver has that attribute; after 2^bits, if `bits` is set; and
/// after 32 bits, if the kernel shows negative numbers of 32 bits, as interrupt-cnt does. Between two readings a
/// counter in both directions may move by less than half of that range, an upward counter by less than the whole range:
/// faster changes are not detected. If an upward counter without a known range goes back, another program has set it:
/// that reading fails, and the next one starts with the new count.
///
/// The driver's `function` decides how many edges of a quadrature encoder count (one, two or four a period). If set
/// here, it is written to the driver when the counter is opened; otherwise it does not change. `per_count` must match
/// it.
///
/// Opening switches the counter on (`enable`) if it is off; it stays on. If the counter disappears, the sensor is
/// faulted and searches for it by name; the count then restarts with the counter's value.
///
/// The kernel's interface: Documentation/ABI/testing/sysfs-bus-counter. It is read on a lane, one for each device.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "rtdata/data/parameter.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace rtdata {

enum class EncoderDirection : std::int8_t { backward = -1, forward = 1 };

/// As it lies in events.
struct EncoderReading {
  std::int64_t count = 0;
  double position = 0;
  std::optional<double> speed = {};
  std::optional<EncoderDirection> direction = {};
};

struct EncoderConfig {
  std::string device = {};                     ///< name, number ("0", "counter0") or path; empty: the only one
  std::string channel = {};                    ///< name, number ("0", "count0"); empty: the only one
  std::string function = {};                   ///< of the driver, such as "quadrature x4"; empty: as it is
  double per_count = 1;                        ///< value of one count, in `unit`
  std::string unit = {};                       ///< UCUM; empty: counts
  std::string per = "s";                       ///< of the speed: "s", "min", "h"
  unsigned bits = 0;                           ///< of a counter without a ceiling; 0: as the driver says
  std::string root = {};                       ///< prefix of /sys, such as the host's root folder in a container
  Duration timeout = std::chrono::seconds{1};  ///< a read that takes longer is given up

  friend constexpr auto parameters(type_tag<EncoderConfig>) {
    using namespace std::chrono_literals;
    using C = EncoderConfig;
    return parameter_list(
        parameter("device", &C::device, "name, number or path of the counter; empty: the only one", TextIs::device),
        parameter("channel", &C::channel, "name or number of a count of that counter; empty: the only one",
                  TextIs::recorded),
        parameter("function", &C::function,
                  "which signals are counted and how, in the words of the driver, such as \"quadrature x4\"; empty: "
                  "unchanged",
                  TextIs::recorded),
        parameter("per_count", &C::per_count, "the amount of one count, in `unit`", not_zero),
        parameter("unit", &C::unit, "unit of `position` (UCUM), such as {rev}, mm, rad, L; empty: counts",
                  TextIs::unit),
        parameter("per", &C::per, "time unit of `speed`", choices("s", "min", "h")),
        parameter("bits", &C::bits, "number of bits after which the count wraps around; 0: as the driver says",
                  range(0, 63)),
        parameter("root", &C::root, "prefix of /sys, such as the host's root folder in a container", TextIs::device),
        parameter("timeout", &C::timeout, "a read that takes longer is given up", range(Duration{1ms}, Duration{1h})));
  }
};

/// Errors: bad-description (a unit that makes none).
Result<std::shared_ptr<const Description>> encoder_description(const EncoderConfig& config);
/// The time on the lane is unknown: it depends on the counter's hardware.
ReadTime read_time(const EncoderConfig& config);

/// Extends a counter that wraps around.
class CountTracker {
 public:
  enum class Way { up, down, both };
  /// `range`: how many counts there are before it wraps around; 0: not known.
  CountTracker(Way way, std::uint64_t range) noexcept : way_(way), range_(range) {}
  CountTracker() noexcept : CountTracker(Way::both, 0) {}

  /// Takes a number from the kernel. False: counting cannot give this number; the count restarts with it.
  bool take(std::uint64_t raw) noexcept;
  std::int64_t count() const noexcept { return count_; }
  /// The change since the last take; empty after the first one and after a restart.
  std::optional<std::int64_t> change() const noexcept { return change_; }

 private:
  void begin(std::uint64_t raw) noexcept;
  Way way_;
  std::uint64_t range_;
  std::optional<std::uint64_t> last_;
  std::int64_t count_ = 0;
  std::optional<std::int64_t> change_;
};

class EncoderSensor : public AnySensor {
 public:
  EncoderSensor() noexcept = default;
  /// SetupError: as `Sensor`; bad-argument for a configuration that cannot work.
  EncoderSensor(Loop& loop, SensorConfig sensor, EncoderConfig config);

 private:
  explicit EncoderSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
