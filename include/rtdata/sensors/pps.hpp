/// PpsSensor: the pulses per second of a GPS receiver or clock, timed by the kernel (/dev/pps0, pps-gpio, pps-ldisc).
///
///     rtdata::PpsSensor pps(loop, {.name = "pps"}, {.device = "pps0"});
///     auto s = loop.topic<rtdata::PpsPulse>("pps").subscribe(loop, [](const auto& e) { use(e->clock_error); });
///
/// Each pulse is an event at the instant at which the kernel saw it, put on the monotonic line. The kernel numbers
/// pulses: those that nobody saw are lost, exactly counted. One that came just before the clock was set has no known
/// instant: its event has the time at which it was noticed, and no interval.
///
/// A source of the time of day (`Runtime::note_wall_clock`, source "pps0"): a pulse tells when a second begins, not
/// which. That is taken from the machine's clock while a service keeps it to better than 0.4 s, and only if the last
/// five pulses came a second apart and begin a second of that clock, as exactly as it claims to be: pulses of another
/// phase (the other edge, `pps-ktimer`) are not used, which is reported once. `accuracy` 0: never.
///
/// What is read is /sys/class/pps/NAME/assert, which everybody may read and which does not block; kernels up to 6.12
/// cannot be waited for, so that a pulse is noticed some milliseconds after it came. That moves no time.
///
/// A source that goes away makes the sensor faulted, and is tried again; one without pulses is silent, a gap.
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
  std::optional<double> interval = {};  ///< since the one before, if that was seen
  double clock_error = 0;               ///< the machine's clock less the nearest whole second
  friend constexpr auto describe(type_tag<PpsPulse>) {
    return record("pps", field("count", &PpsPulse::count), field("interval", &PpsPulse::interval, "s"),
                  field("clock_error", &PpsPulse::clock_error, "s"));
  }
};

/// `assert` of the kernel's is the edge that begins a pulse, unless its driver was told otherwise.
enum class PpsEdge : std::uint8_t { assert_edge, clear_edge };
constexpr auto describe(type_tag<PpsEdge>) {
  return enumeration("edge", value("assert", PpsEdge::assert_edge), value("clear", PpsEdge::clear_edge));
}

struct PpsConfig {
  std::string device = "pps0";  ///< name, or /dev/pps0
  PpsEdge edge = PpsEdge::assert_edge;
  Duration accuracy = std::chrono::microseconds{50};      ///< of the pulse as the kernel sees it; 0: no source of time
  Duration silence = std::chrono::seconds{3};             ///< silent for longer, it has a gap; 0: it may be silent
  std::string root = {};                                  ///< put before /sys: where a container sees its host's
  Duration retry_first = std::chrono::milliseconds{100};  ///< wait before a lost source is opened again
  Duration retry_longest = std::chrono::seconds{10};      ///< the wait doubles up to this
  bool required = false;                                  ///< a source that is not there at the start throws
  bool start = true;                                      ///< start when made

  friend constexpr auto parameters(type_tag<PpsConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("device", &PpsConfig::device, "the source of pulses, such as pps0", TextIs::recorded),
        parameter("edge", &PpsConfig::edge, "which edge of a pulse counts"),
        parameter("accuracy", &PpsConfig::accuracy,
                  "how far a pulse, as the kernel sees it, may be from the second; 0: it is no source of the time",
                  range(Duration{0}, Duration{100ms})),
        parameter("silence", &PpsConfig::silence, "silent for longer, it is degraded and has a gap; 0: never",
                  range(Duration{0}, Duration{24h})),
        parameter("root", &PpsConfig::root, "put before /sys: where a container sees its host's", TextIs::device),
        parameter("retry_first", &PpsConfig::retry_first, "wait before a lost source is opened again",
                  range(Duration{1ms}, Duration{1h})),
        parameter("retry_longest", &PpsConfig::retry_longest, "the wait doubles up to this",
                  range(Duration{1ms}, Duration{24h})),
        parameter("required", &PpsConfig::required, "a source that is not there at the start ends the program"),
        parameter("start", &PpsConfig::start, "start it with the system"));
  }
};

/// What no parameter says by itself: that the device is a name.
void check_config(const PpsConfig& config, const ConfigItem& item, Problems& problems);
ReadTime read_time(const PpsConfig& config);

class PpsSensor : public AnySensor {
 public:
  PpsSensor() noexcept = default;
  /// SetupError: as `Feed`; bad-argument for a device that is no name; the error of a required one that is not there.
  PpsSensor(Loop& loop, FeedConfig feed, PpsConfig config);

 private:
  explicit PpsSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
