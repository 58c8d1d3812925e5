/// IioSensor, IioBufferSensor: any converter, IMU, barometer, ... that a driver of the kernel serves (Industrial I/O).
///
///     rtdata::IioSensor weather(loop, {.name = "weather", .rate = 1_Hz},
///                               {.device = "bmp280", .channels = {"temp", "pressure"}});
///     rtdata::IioBufferSensor imu(loop, {.name = "imu"},
///                                 {.device = "mpu6050", .channels = {"accel_x", "anglvel_z"}, .rate = 200_Hz});
///
/// `IioSensor` asks for each channel at its own rate, by a file each. `IioBufferSensor` takes what the kernel's driver
/// puts into its buffer, all channels of one instant together, at the rate of a trigger: of the chip's own data-ready
/// interrupt, of a timer of the kernel. For more than some 10 Hz that is the way.
///
/// Events: a record "iio" of one double for each channel (four for a quaternion), in the order of `channels`, named as
/// the channel ("-" as "_"), in SI units (iio.hpp). All of it is known from the configuration, without the device.
///
/// - The device is found by name, label, number or path, and again each time that it is opened: one that is unplugged
///   makes the sensor faulted, and it is looked for until it is back.
/// - Opening and closing, which can make a driver talk to its chip for long, is done on a lane, one for each `device`.
/// - Buffered, an event's time is the kernel's: its clock is set to the monotonic one where the kernel can (4.8 and
///   later), else converted from the time of day. A time that cannot be is replaced by that of the read, and told.
/// - Buffered: the kernel does not tell of scans that it dropped, so `lost` is not detectable. But a buffer that was
///   found full, and times that are further apart than the rate says, are reported and recorded as a gap (silent).
/// - A device whose buffer another program has is an error (busy) that names it where that may be seen. One whose
///   buffer is on while nobody has it, as after a kill, is taken over, which is logged.
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
  std::string root = {};                       ///< put before /sys: where a container sees its host's
  Duration timeout = std::chrono::seconds{1};  ///< a read of all channels that takes longer is given up

  friend constexpr auto parameters(type_tag<IioConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("device", &IioConfig::device, "the IIO device: its name, label, number or path", required,
                  TextIs::device),
        parameter("channels", &IioConfig::channels, "what is read, such as accel_x or voltage0", required,
                  TextIs::recorded),
        parameter("root", &IioConfig::root, "put before /sys: where a container sees its host's", TextIs::device),
        parameter("timeout", &IioConfig::timeout, "a read of all channels that takes longer is given up",
                  range(Duration{1ms}, Duration{1h})));
  }
};

struct IioBufferConfig {
  std::string device = {};                                ///< name, label, number, or path below /sys or /dev
  std::vector<std::string> channels = {};                 ///< "accel_x", "voltage0-voltage1"
  std::string trigger = {};                               ///< its name; empty: the device's own, or the one that it has
  std::optional<Rate> rate = {};                          ///< set in trigger or device; unset: left as it is
  std::size_t length = 512;                               ///< scans that the kernel's buffer holds
  std::size_t watermark = 1;                              ///< scans at a time: more cost less, and come later
  std::string root = {};                                  ///< put before /sys and /dev
  Duration timeout = std::chrono::seconds{5};             ///< opening that takes longer is given up
  Duration silence{0};                                    ///< silent for longer, it has a gap; 0: it may be silent
  Duration retry_first = std::chrono::milliseconds{100};  ///< wait before a lost device is opened again
  Duration retry_longest = std::chrono::seconds{10};      ///< the wait doubles up to this
  bool required = false;                                  ///< a device that cannot be opened at the start throws
  bool start = true;                                      ///< start when made

  friend constexpr auto parameters(type_tag<IioBufferConfig>) {
    using namespace std::chrono_literals;
    using C = IioBufferConfig;
    return parameter_list(
        parameter("device", &C::device, "the IIO device: its name, label, number or path", rtdata::required,
                  TextIs::device),
        parameter("channels", &C::channels, "what is in a scan, such as accel_x or voltage0", rtdata::required,
                  TextIs::recorded),
        parameter("trigger", &C::trigger, "name of the trigger; empty: the device's own, or the one that it has",
                  TextIs::recorded),
        parameter("rate", &C::rate, "scans a second, set in the trigger or the device; unset: left as it is"),
        parameter("length", &C::length, "scans that the kernel's buffer holds", range(2, 65536)),
        parameter("watermark", &C::watermark, "scans that are taken at a time: more cost less, and come later",
                  range(1, 65536)),
        parameter("root", &C::root, "put before /sys and /dev: where a container sees its host's", TextIs::device),
        parameter("timeout", &C::timeout, "opening that takes longer is given up", range(Duration{1ms}, Duration{1h})),
        parameter("silence", &C::silence, "silent for longer, it is degraded and has a gap; 0: never",
                  range(Duration{0}, Duration{24h})),
        parameter("retry_first", &C::retry_first, "wait before a lost device is opened again",
                  range(Duration{1ms}, Duration{1h})),
        parameter("retry_longest", &C::retry_longest, "the wait doubles up to this",
                  range(Duration{1ms}, Duration{24h})),
        parameter("required", &C::required, "a device that cannot be opened at the start ends the program"),
        parameter("start", &C::start, "start it with the system"));
  }
};

/// The description of the events of a sensor with these channels. Errors: bad-argument (no channel, or an unknown one),
/// bad-description.
Result<std::shared_ptr<const Description>> iio_description(const std::vector<std::string>& channels);

/// What no parameter says by itself: that the channels are some, and that the watermark is no longer than the buffer.
void check_config(const IioConfig& config, const ConfigItem& item, Problems& problems);
void check_config(const IioBufferConfig& config, const ConfigItem& item, Problems& problems);
/// The loop's part; how long the chip takes is for its data sheet to say, and so not known.
ReadTime read_time(const IioConfig& config);
ReadTime read_time(const IioBufferConfig& config);

class IioSensor : public AnySensor {
 public:
  IioSensor() noexcept = default;
  /// SetupError: as `Sensor`; bad-argument for channels that are none.
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
