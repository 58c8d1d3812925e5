/// IioSensor, IioBufferSensor: any converter, IMU, barometer, ... that a driver of the kernel serves (Industrial I/O).
///
///     rtdata::IioSensor weather(loop, {.name = "weather", .rate = 1_Hz},
///                               {.device = "bmp280", .channels = {"temp", "pressure"}});
///     rtdata::IioBufferSensor imu(loop, {.name = "imu"},
///                                 {.device = "mpu6050", .channels = {"accel_x", "anglvel_z"}, .rate = 200_Hz});
///
/// `IioSensor` reads one file for each channel at the sensor's rate. `IioBufferSensor` takes scans from the kernel's
/// buffer, with all channels of one instant together, at the rate of a trigger: the chip's data-ready interrupt or a
/// timer of the kernel. Use it above about 10 Hz.
///
/// Events: a record "iio" of one double for each channel (four for a quaternion), in the order of `channels`, named as
/// the channel ("-" as "_"), in SI units (iio.hpp). The configuration alone defines them, without the device.
///
/// - The device is searched by name, label, number or path each time it is opened: if it is unplugged, the sensor is
///   faulted and searches until it is back.
/// - Opening and closing, which may take long in a driver, run on a lane, one for each `device`.
/// - Buffered events have the kernel's time: from the monotonic clock if the kernel supports it (4.8 and later),
///   otherwise converted from the time of day. An impossible time is replaced by the time of the read, and reported.
/// - Buffered: the kernel does not report dropped scans, so `lost` is unknown. But a full buffer, and times further
///   apart than the rate allows, are reported and recorded as a gap (silent).
/// - If another program has the buffer, that is an error (busy), which names the program if visible. If the buffer is
///   enabled but no program has it, for example after a kill, the sensor takes it over and logs this.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/data/parameter.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace rtdata {

struct IioConfig {
  std::string device = {};                     ///< name, label, number, or path below /sys or /dev
  std::vector<std::string> channels = {};      ///< "accel_x", "voltage0-voltage1"
  std::string root = {};                       ///< prefix of /sys, such as the host's root folder in a container
  Duration timeout = std::chrono::seconds{1};  ///< a read of all channels that takes longer is given up

  friend constexpr auto parameters(type_tag<IioConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("device", &IioConfig::device, "name, label, number or path of the IIO device", required,
                  TextIs::device),
        parameter("channels", &IioConfig::channels, "channels to read, such as accel_x or voltage0", required,
                  TextIs::recorded),
        parameter("root", &IioConfig::root, "prefix of /sys, such as the host's root folder in a container",
                  TextIs::device),
        parameter("timeout", &IioConfig::timeout, "a read of all channels that takes longer is given up",
                  range(Duration{1ms}, Duration{1h})));
  }
};

struct IioBufferConfig {
  std::string device = {};                     ///< name, label, number, or path below /sys or /dev
  std::vector<std::string> channels = {};      ///< "accel_x", "voltage0-voltage1"
  std::string trigger = {};                    ///< its name; empty: the device's own, or the present one
  std::optional<Rate> rate = {};               ///< set in trigger or device; unset: unchanged
  std::size_t length = 512;                    ///< scans that the kernel's buffer holds
  std::size_t watermark = 1;                   ///< scans read at a time: more need less time, but arrive later
  std::string root = {};                       ///< put before /sys and /dev
  Duration timeout = std::chrono::seconds{5};  ///< opening that takes longer is given up
  Duration silence{0};                         ///< silent for longer, it has a gap; 0: it may be silent
  Duration retry_first = std::chrono::milliseconds{100};  ///< first delay before a lost device is opened again
  Duration retry_longest = std::chrono::seconds{10};      ///< the delay doubles up to this
  bool required = false;                                  ///< a device that cannot be opened at the start throws
  bool start = true;                                      ///< start when made

  friend constexpr auto parameters(type_tag<IioBufferConfig>) {
    using namespace std::chrono_literals;
    using C = IioBufferConfig;
    return parameter_list(
        parameter("device", &C::device, "name, label, number or path of the IIO device", rtdata::required,
                  TextIs::device),
        parameter("channels", &C::channels, "channels of a scan, such as accel_x or voltage0", rtdata::required,
                  TextIs::recorded),
        parameter("trigger", &C::trigger,
                  "name of the trigger; empty: the device's own, or the one that is set already", TextIs::recorded),
        parameter("rate", &C::rate, "scans per second, set in the trigger or the device; unset: unchanged"),
        parameter("length", &C::length, "number of scans that the kernel's buffer holds", range(2, 65536)),
        parameter("watermark", &C::watermark,
                  "number of scans that are read at a time; more need less processor time, but arrive later",
                  range(1, 65536)),
        parameter("root", &C::root, "prefix of /sys and /dev, such as the host's root folder in a container",
                  TextIs::device),
        parameter("timeout", &C::timeout, "opening that takes longer is given up", range(Duration{1ms}, Duration{1h})),
        parameter("silence", &C::silence,
                  "after this time without data, the sensor is degraded and has a gap; 0: never",
                  range(Duration{0}, Duration{24h})),
        parameter("retry_first", &C::retry_first, "first delay before a lost device is opened again",
                  range(Duration{1ms}, Duration{1h})),
        parameter("retry_longest", &C::retry_longest, "the delay doubles up to this",
                  range(Duration{1ms}, Duration{24h})),
        parameter("required", &C::required, "true: the program ends if the device cannot be opened at the start"),
        parameter("start", &C::start, "start it with the system"));
  }
};

/// The description of the events of a sensor with these channels. Errors: bad-argument (no channel, or an unknown one),
/// bad-description.
Result<std::shared_ptr<const Description>> iio_description(const std::vector<std::string>& channels);

/// Checks that there are channels, and that the watermark is not larger than the buffer.
void check_config(const IioConfig& config, const ConfigItem& item, Problems& problems);
void check_config(const IioBufferConfig& config, const ConfigItem& item, Problems& problems);
/// The time on the loop; the time on the lane depends on the chip and is unknown.
ReadTime read_time(const IioConfig& config);
ReadTime read_time(const IioBufferConfig& config);

class IioSensor : public AnySensor {
 public:
  IioSensor() noexcept = default;
  /// SetupError: as `Sensor`; bad-argument for invalid channels.
  IioSensor(Loop& loop, SensorConfig sensor, IioConfig config);

 private:
  explicit IioSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

class IioBufferSensor : public AnySensor {
 public:
  IioBufferSensor() noexcept = default;
  /// SetupError: as `Feed`; bad-argument for a configuration that cannot work; the error of opening a required device.
  IioBufferSensor(Loop& loop, FeedConfig feed, IioBufferConfig config);

 private:
  explicit IioBufferSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
