/// Mpu6050: inertial measurement units MPU-6050, MPU-6500 and MPU-9250 (without its magnetometer) of InvenSense on I2C.
///
///     rtdata::DriverSensor<rtdata::Mpu6050> imu(loop, {.name = "imu", .rate = 50_Hz}, bus, {.address = 0x68},
///                                               {.model = ImuModel::mpu6050, .sample_rate = 500});
///
/// The chip measures by itself at `sample_rate` and keeps its samples in a FIFO, which each tick of the sensor empties:
/// at 50 Hz and 500 samples a second, some ten at a time. The FIFO holds 73 samples (MPU-6500, MPU-9250: 36); one that
/// has run over is emptied, and the samples in it and those that it had no room for are counted as lost. So is what a
/// chip missed that has lost its settings: it is set up again.
///
/// Times: the chip has no clock that can be read. The last sample of a read is at most one period old; the others are
/// spread evenly since the last one of the read before. So they follow the chip's rate, which may be 1 % off, and are
/// right within a period.
///
/// Axes as printed in the data sheet. Addresses: 0x68, and 0x69 with AD0 high. A chip of another identity is refused.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct ImuReading {
  double acceleration_x = 0, acceleration_y = 0, acceleration_z = 0;              ///< with gravity
  double angular_velocity_x = 0, angular_velocity_y = 0, angular_velocity_z = 0;  ///< right-handed
  double temperature = 0;                                                         ///< of the chip
  friend constexpr auto describe(type_tag<ImuReading>) {
    return record("imu", field("acceleration_x", &ImuReading::acceleration_x, "m/s2"),
                  field("acceleration_y", &ImuReading::acceleration_y, "m/s2"),
                  field("acceleration_z", &ImuReading::acceleration_z, "m/s2"),
                  field("angular_velocity_x", &ImuReading::angular_velocity_x, "rad/s"),
                  field("angular_velocity_y", &ImuReading::angular_velocity_y, "rad/s"),
                  field("angular_velocity_z", &ImuReading::angular_velocity_z, "rad/s"),
                  field("temperature", &ImuReading::temperature, "Cel"));
  }
};

enum class ImuModel { mpu6050, mpu6500, mpu9250 };

class Mpu6050 {
 public:
  static constexpr std::string_view type = "imu";
  static constexpr std::string_view
      description = "acceleration and angular velocity of an MPU-6050, 6500 or 9250 on I2C";
  static constexpr std::string_view notes = R"(
- Address `0x68` with AD0 at ground, `0x69` with AD0 at the supply. The magnetometer of the MPU-9250 is not read.
- The chip takes `sample_rate` samples a second by itself and keeps them in a FIFO, which each tick empties: `rate` says how
  often. Each sample is an event.
- The FIFO holds 73 samples (MPU-6500 and 9250: 36): read it at least twice as often as it fills. What one that has run over
  did not keep is counted as lost.
- The chip has no clock that can be read: times are right within a period, and follow the chip's own rate (1 % at most off).
- Axes as printed in the data sheet. A chip of another identity is refused.
)";
  struct Config {
    ImuModel model = ImuModel::mpu6050;
    unsigned sample_rate = 100;        ///< Hz of the chip: 1000 / n with n from 1 to 256
    unsigned acceleration_range = 16;  ///< g: 2, 4, 8 or 16
    unsigned angular_range = 2000;     ///< degrees a second: 250, 500, 1000 or 2000
    unsigned bandwidth = 42;           ///< Hz of the chip's low-pass filter: 188, 98, 42, 20, 10 or 5
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(
          parameter("model", &Config::model, "which chip it is",
                    choices(value("mpu6050", ImuModel::mpu6050), value("mpu6500", ImuModel::mpu6500),
                            value("mpu9250", ImuModel::mpu9250))),
          parameter(
              "sample_rate", &Config::sample_rate,
              "samples a second of the chip, a whole number of milliseconds apart; `rate` says how often they are "
              "fetched",
              unit("Hz"), range(4, 1000)),
          parameter("acceleration_range", &Config::acceleration_range, "2, 4, 8 or 16 times 9.80665 m/s2",
                    range(2, 16)),
          parameter("angular_range", &Config::angular_range, "250, 500, 1000 or 2000 degrees a second",
                    range(250, 2000)),
          parameter("bandwidth", &Config::bandwidth, "of the chip's low-pass filter: 188, 98, 42, 20, 10 or 5",
                    unit("Hz"), range(5, 188)));
    }
    friend void check_config(const Config& config, const ConfigItem& item, Problems& problems);
  };
  using Value = ImuReading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x68};
  static constexpr std::size_t sample_bytes = 14;

  /// SetupError (bad-argument): a setting that the chip does not have.
  explicit Mpu6050(const Config& config);
  Result<void> open(I2cDevice& chip);
  Result<void> read(I2cDevice& chip, Samples<ImuReading>& out);
  /// Puts it to sleep.
  void close(I2cDevice& chip);

  /// Of a sample as the registers 0x3b to 0x48 and the FIFO have it: acceleration, temperature, angular velocity.
  static ImuReading decode(std::span<const std::uint8_t, sample_bytes> bytes, const Config& config) noexcept;

 private:
  Result<void> set_up(I2cDevice& chip);
  Result<void> empty_fifo(I2cDevice& chip);
  Result<void> restart(I2cDevice& chip, Samples<ImuReading>& out);
  void give_up_samples(MonotonicTime now, Samples<ImuReading>& out);

  Config config_;
  Duration period_;
  MonotonicTime last_{};  ///< of the last sample that was read, or of the start
  bool is_torn_ = false;  ///< where a sample begins in the FIFO is not known
};

}  // namespace rtdata
