/// PpsSensor: the pulses per second of a GPS receiver or clock, timed by the kernel (/dev/pps0, pps-gpio, pps-ldisc).
///
///     rtdata::PpsSensor pps(loop, {.name = "pps"}, {.device = "pps0"});
///     auto s = loop.topic<rtdata::PpsPulse>("pps").subscribe(loop, [](const auto& e) { use(e->clock_error); });
///
/// Each pulse is an event with the kernel's time of the pulse, converted to the monotonic clock. The kernel numbers
/// pulses, so missed ones are counted exactly as lost. A pulse just before the clock was set has an unknown time: its
/// event has the time of the read and no interval.
///
/// It is a time source (`Runtime::note_wall_clock`, source "pps0"). A pulse shows the beginning of a second, but not
/// which second. That comes from the machine's clock, if a service keeps it within 0.4 s, and if the last five pulses
/// were a second apart and agree with the beginning of a second of that clock within its stated accuracy. Pulses with
/// another phase (the other edge, `pps-ktimer`) are not used, which is reported once. `accuracy` 0: never a time
/// source.
///
/// It reads /sys/class/pps/NAME/assert, which needs no permission and does not block. Kernels up to 6.12 cannot notify
/// about a pulse, so it is read some milliseconds later; its time is not affected.
///
/// If the source disappears, the sensor is faulted and tries again; without pulses it has a gap (silent).
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "rtdata/data/parameter.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata {

struct PpsPulse {
  std::uint32_t count = 0;              ///< the kernel's number of it
  std::optional<double> interval = {};  ///< since the previous pulse, if that was read
  double clock_error = 0;               ///< the computer's clock minus the nearest full second
  friend constexpr auto describe(type_tag<PpsPulse>) {
    return record("pps", field("count", &PpsPulse::count), field("interval", &PpsPulse::interval, "s"),
                  field("clock_error", &PpsPulse::clock_error, "s"));
  }
};

/// The kernel's `assert` is the edge that begins a pulse, unless its driver is configured differently.
enum class PpsEdge : std::uint8_t { assert_edge, clear_edge };
constexpr auto describe(type_tag<PpsEdge>) {
  return enumeration("edge", value("assert", PpsEdge::assert_edge), value("clear", PpsEdge::clear_edge));
}

struct PpsConfig {
  std::string device = "pps0";  ///< name, or /dev/pps0
  PpsEdge edge = PpsEdge::assert_edge;
  Duration accuracy = std::chrono::microseconds{50};      ///< of the kernel's time; 0: not a time source
  Duration silence = std::chrono::seconds{3};             ///< silent for longer, it has a gap; 0: it may be silent
  std::string root = {};                                  ///< prefix of /sys, such as a container's mount of the host
  Duration retry_first = std::chrono::milliseconds{100};  ///< first delay before a lost source is opened again
  Duration retry_longest = std::chrono::seconds{10};      ///< the delay doubles up to this
  bool required = false;                                  ///< a source that is missing at the start throws
  bool start = true;                                      ///< start when made

  friend constexpr auto parameters(type_tag<PpsConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("device", &PpsConfig::device, "the source of pulses, such as pps0", TextIs::recorded),
        parameter("edge", &PpsConfig::edge, "which edge of a pulse counts"),
        parameter(
            "accuracy", &PpsConfig::accuracy,
            "longest time from the full second to a pulse, as the kernel sees it; 0: the pulses are not a time source",
            range(Duration{0}, Duration{100ms})),
        parameter("silence", &PpsConfig::silence,
                  "after this time without data, the sensor is degraded and has a gap; 0: never",
                  range(Duration{0}, Duration{24h})),
        parameter("root", &PpsConfig::root, "prefix of /sys, such as the host's root folder in a container",
                  TextIs::device),
        parameter("retry_first", &PpsConfig::retry_first, "first delay before a lost source is opened again",
                  range(Duration{1ms}, Duration{1h})),
        parameter("retry_longest", &PpsConfig::retry_longest, "the delay doubles up to this",
                  range(Duration{1ms}, Duration{24h})),
        parameter("required", &PpsConfig::required, "true: the program ends if the source does not exist at the start"),
        parameter("start", &PpsConfig::start, "start it with the system"));
  }
};

/// Checks that the device is a valid name.
void check_config(const PpsConfig& config, const ConfigItem& item, Problems& problems);
ReadTime read_time(const PpsConfig& config);

class PpsSensor : public AnySensor {
 public:
  PpsSensor() noexcept = default;
  /// SetupError: as `Feed`; bad-argument for a device that is not a name; the error of a required source that is
  /// missing.
  PpsSensor(Loop& loop, FeedConfig feed, PpsConfig config);

 private:
  explicit PpsSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
