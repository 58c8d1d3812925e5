/// Imu: acceleration and angular velocity of an MPU-6050, MPU-6500, MPU-9250, ICM-20948, LSM6DS3, LSM6DS3TR-C, LSM6DSO,
/// LSM6DSOX or LSM9DS1 on I2C or SPI (an MPU-6050: I2C).
///
///     rtdata::DriverSensor<rtdata::Imu> imu(loop, {.name = "imu", .rate = 50_Hz}, bus, {.address = 0x6a},
///                                           {.model = rtdata::ImuModel::lsm6dso, .sample_rate = 416});
///
/// The chip measures by itself at `sample_rate` and keeps its samples in a FIFO, which each tick of the sensor empties:
/// at 50 Hz and 416 samples a second, some eight at a time. Times, losses, lost settings: inertial.hpp. When the FIFO
/// of an MPU, ICM or LSM6DS3 overflows, the driver empties it, because it cannot tell where a sample begins; the other
/// chips keep the newest samples.
///
/// The magnetometers of an MPU-9250 and an LSM9DS1 are separate chips (magnetometer.hpp); this driver connects the one
/// of an MPU-9250 to the bus, and does not use the one of an ICM-20948. Axes are those in the data sheet. The driver
/// refuses a chip with another identity.
///
/// Sources: MPU-6050, register map RM-MPU-6000A-00 rev. 4.2: 4.4 to 4.6 settings, 4.14 to 4.34 FIFO, 4.17 to 4.19
/// scales, 4.28 to 4.32 power and identity; MPU-6500 RM-MPU-6500A-00, MPU-9250 RM-MPU-9250A-00. LSM6DS3, DocID026899:
/// 5.5 FIFO, table 3 scales and self-test, 9.7 to 9.14 settings, 9.42 to 9.46 FIFO; LSM6DS3TR-C, DocID030071, the same
/// with half the FIFO. LSM6DSO, DS12140, and LSM6DSOX, DS12814: 6.5 FIFO, table 2 scales and self-test, 9.5 to 9.16
/// settings, 9.39 to 9.49 FIFO. LSM9DS1, DocID025715: 3.5 FIFO, table 3 scales and self-test, 7.12 to 7.34 registers.
/// ICM-20948, DS-000189 rev. 1.3: 3.1 and 3.2 scales, 4.16 FIFO, 8 registers of bank 0 (power, FIFO), 10 of bank 2
/// (rates, ranges, filters). The order in its FIFO, acceleration and then angular velocity, is the one in which two
/// drivers that do not come from each other read it: those of PX4 and of ArduPilot.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include "rtdata/chips/inertial.hpp"
#include "rtdata/data/describe.hpp"

namespace rtdata {

struct ImuReading {
  double acceleration_x = 0, acceleration_y = 0, acceleration_z = 0;              ///< with gravity
  double angular_velocity_x = 0, angular_velocity_y = 0, angular_velocity_z = 0;  ///< right-handed
  std::optional<double> temperature{};  ///< of the chip; without it in the FIFO, of the newest sample only
  static ImuReading of(const InertialSample& sample) noexcept {
    return {sample.acceleration[0],     sample.acceleration[1],     sample.acceleration[2], sample.angular_velocity[0],
            sample.angular_velocity[1], sample.angular_velocity[2], sample.temperature};
  }
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

enum class ImuModel { mpu6050, mpu6500, mpu9250, lsm6ds3, lsm6ds3trc, lsm6dso, lsm6dsox, lsm9ds1, icm20948 };

/// The models, in the order of `ImuModel`. A new chip of one of these kinds is an entry.
namespace imu_models {

using namespace std::chrono_literals;

constexpr double g(double count) { return count * standard_gravity; }
constexpr double degrees(double count) { return count * radians_a_degree; }

// InvenSense. 1 kHz divided by 1 to 256; 131, 65.5, 32.8 and 16.4 counts a degree a second: 250 degrees are 32750.
inline constexpr InertialChoice mpu_rates[] = {{4, 249}, {5, 199}, {8, 124}, {10, 99}, {20, 49}, {25, 39}, {40, 24},
                                               {50, 19}, {100, 9}, {125, 7}, {200, 4}, {250, 3}, {500, 1}, {1000, 0}};
inline constexpr InertialChoice mpu_accelerations[] = {
    {2, 0, g(2 / 32768.0)}, {4, 1, g(4 / 32768.0)}, {8, 2, g(8 / 32768.0)}, {16, 3, g(16 / 32768.0)}};
inline constexpr InertialChoice mpu_angles[] = {{250, 0, degrees(250 / 32750.0)},
                                                {500, 1, degrees(500 / 32750.0)},
                                                {1000, 2, degrees(1000 / 32750.0)},
                                                {2000, 3, degrees(2000 / 32750.0)}};
inline constexpr InertialChoice mpu_filters[] = {{188, 1}, {98, 2}, {42, 3}, {20, 4}, {10, 5}, {5, 6}};
// Reset; the gyroscope's clock, and a wait until it has started; rate, filter, ranges; acceleration, temperature and
// angular velocity into the FIFO. MPU-6500 and MPU-9250 have a separate filter for acceleration.
inline constexpr InertialWrite mpu6050_setting_up[] = {{.number = 0x6b, .value = 0x80, .pause = 100ms},
                                                       {.number = 0x6b, .value = 0x01, .pause = 35ms},
                                                       {.number = 0x19, .by_rate = 1},
                                                       {.number = 0x1a, .by_filter = 1},
                                                       {.number = 0x1b, .by_angle = 1 << 3},
                                                       {.number = 0x1c, .by_acceleration = 1 << 3},
                                                       {.number = 0x23, .value = 0xf8}};
// An MPU-9250 also connects its magnetometer to the bus, which an MPU-6500 does not have.
inline constexpr InertialWrite mpu9250_setting_up[] = {{.number = 0x6b, .value = 0x80, .pause = 100ms},
                                                       {.number = 0x6b, .value = 0x01, .pause = 35ms},
                                                       {.number = 0x19, .by_rate = 1},
                                                       {.number = 0x1a, .by_filter = 1},
                                                       {.number = 0x1b, .by_angle = 1 << 3},
                                                       {.number = 0x1c, .by_acceleration = 1 << 3},
                                                       {.number = 0x1d, .by_filter = 1},
                                                       {.number = 0x23, .value = 0xf8},
                                                       {.number = 0x37, .value = 0x02}};
inline constexpr std::span mpu6500_setting_up = std::span(mpu9250_setting_up).first<8>();
inline constexpr InertialWrite mpu_sleeping[] = {{.number = 0x6b, .value = 0x40}};
/// The factory's self-test values, with a tolerance of 14 % (register map 4.1): codes of 5 bits; those of acceleration
/// are split over two registers.
inline Result<InertialSixLimits> mpu6050_limits(RegisterDevice& chip) {
  std::array<std::uint8_t, 4> bytes{};
  if (auto done = chip.read_registers(0x0d, bytes); !done) return std::move(done).error();
  InertialSixLimits limits;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const int acceleration = bytes[axis] >> 5 << 2 | (bytes[3] >> (4 - 2 * axis) & 3), angle = bytes[axis] & 0x1f;
    const double by = g(0.34 * std::pow(0.92 / 0.34, (acceleration - 1) / 30.0));
    const double turns = degrees(25 * std::pow(1.046, angle - 1));
    if (acceleration == 0 || angle == 0)
      return chip.error(Errc::bad_data, "cannot test the MPU-6050", "it has no factory values to compare with",
                        "remove `self_test`");
    limits[axis] = {0.86 * by, 1.14 * by};
    limits[3 + axis] = {0.86 * turns, 1.14 * turns};
  }
  return limits;
}
/// 0.5 to 1.5 times the factory's value (AN-MPU-9250A-03); if the chip has none, the limits of the data sheet.
inline Result<InertialSixLimits> mpu6500_limits(RegisterDevice& chip) {
  std::array<std::uint8_t, 3> angles{}, accelerations{};
  if (auto done = chip.read_registers(0x00, angles); !done) return std::move(done).error();
  if (auto done = chip.read_registers(0x0d, accelerations); !done) return std::move(done).error();
  const auto by = [](std::uint8_t code, double of_first) { return of_first * std::pow(1.01, code - 1); };
  InertialSixLimits limits;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const double acceleration = by(accelerations[axis], g(2620 / 16384.0));
    const double angle = by(angles[axis], degrees(2620 / 131.0));
    limits[axis] = accelerations[axis] != 0 ? InertialLimits{0.5 * acceleration, 1.5 * acceleration}
                                            : InertialLimits{g(0.225), g(0.675)};
    limits[3 + axis] = angles[axis] != 0 ? InertialLimits{0.5 * angle, 1.5 * angle}
                                         : InertialLimits{degrees(60), degrees(250)};
  }
  return limits;
}
constexpr InertialSelfTest mpu_self_test(double acceleration_range,
                                         Result<InertialSixLimits> (*limits_of)(RegisterDevice&)) {
  return {.acceleration_register = 0x1c,
          .acceleration_on = 0xe0,
          .angle_register = 0x1b,
          .angle_on = 0xe0,
          .acceleration_output = 0x3b,
          .angle_output = 0x43,
          .acceleration_range = acceleration_range,
          .angle_range = 250,
          .limits_of = limits_of};
}
constexpr InertialModel mpu(std::string_view name, std::string_view model, std::uint8_t identity,
                            std::size_t fifo_bytes, std::span<const InertialWrite> setting_up,
                            InertialSelfTest self_test, double counts_per_degree, double degrees_at_zero,
                            std::string_view without_spi = {}) {
  return {.chip = {.name = name, .model = model, .addresses = {0x68, 0x69}, .identity = {{0x75, identity}}},
          .rates = mpu_rates,
          .accelerations = mpu_accelerations,
          .angles = mpu_angles,
          .filters = mpu_filters,
          .setting_up = setting_up,
          .sleeping = mpu_sleeping,
          .fifo = {.off = {.number = 0x6a, .value = 0x04, .on_spi = 0x10},  // no I2C
                   .on = {.number = 0x6a, .value = 0x40, .on_spi = 0x10},
                   .status = 0x72,
                   .status_bytes = 2,
                   .count_mask = 0xffff,
                   .over_register = 0x3a,
                   .over_bit = 0x10,
                   .capacity = fifo_bytes,
                   .data = 0x74,
                   .is_stream = true},
          .big_endian = true,
          .sample_bytes = 14,
          .acceleration_at = 0,
          .angle_at = 8,
          .temperature_at = 6,
          .counts_per_degree = counts_per_degree,
          .degrees_at_zero = degrees_at_zero,
          .self_test = self_test,
          .addressing = {.without_spi = without_spi}};
}

// STMicroelectronics, LSM6D family. The lowest rate is left out: there the rates of accelerometer and gyroscope differ.
inline constexpr InertialChoice lsm6_rates[] = {{26, 2}, {52, 3}, {104, 4}, {208, 5}, {416, 6}, {833, 7}, {1660, 8}};
inline constexpr InertialChoice lsm6_accelerations[] = {
    {2, 0, g(0.061e-3)}, {4, 2, g(0.122e-3)}, {8, 3, g(0.244e-3)}, {16, 1, g(0.488e-3)}};
inline constexpr InertialChoice lsm6_angles[] = {{125, 1, degrees(4.375e-3)},
                                                 {250, 0, degrees(8.75e-3)},
                                                 {500, 2, degrees(17.5e-3)},
                                                 {1000, 4, degrees(35e-3)},
                                                 {2000, 6, degrees(70e-3)}};
// Reset; address auto-increment and block data update; both sensors on, and a wait until the gyroscope has started (70
// ms); both into the FIFO.
inline constexpr InertialWrite lsm6ds3_setting_up[] = {
    {.number = 0x12, .value = 0x01, .pause = 20ms},
    {.number = 0x12, .value = 0x44},
    {.number = 0x13, .on_spi = 0x04},  // no I2C
    {.number = 0x10, .by_rate = 1 << 4, .by_acceleration = 1 << 2},
    {.number = 0x11, .by_rate = 1 << 4, .by_angle = 1 << 1, .pause = 80ms},
    {.number = 0x08, .value = 0x09}};
inline constexpr InertialWrite lsm6dso_setting_up[] = {
    {.number = 0x12, .value = 0x01, .pause = 20ms},
    {.number = 0x12, .value = 0x44},
    {.number = 0x13, .on_spi = 0x04},  // no I2C
    {.number = 0x18, .value = 0xe2},   // without I3C
    {.number = 0x10, .by_rate = 1 << 4, .by_acceleration = 1 << 2},
    {.number = 0x11, .by_rate = 1 << 4, .by_angle = 1 << 1, .pause = 80ms},
    {.number = 0x09, .by_rate = 1 << 4 | 1}};
inline constexpr InertialWrite lsm6_sleeping[] = {{.number = 0x10}, {.number = 0x11}};
constexpr InertialSelfTest lsm6_self_test(double least_acceleration) {
  const InertialLimits acceleration{g(least_acceleration), g(1.7)}, angle{degrees(150), degrees(700)};
  return {.acceleration_register = 0x14,
          .acceleration_on = 0x01,
          .angle_register = 0x14,
          .angle_on = 0x04,
          .acceleration_output = 0x28,
          .angle_output = 0x22,
          .acceleration_range = 4,
          .angle_range = 2000,
          .limits = {{acceleration, acceleration, acceleration, angle, angle, angle}}};
}
/// Angular velocity and acceleration as words of 16 bits, one after the other.
constexpr InertialModel lsm6ds3(std::string_view name, std::string_view model, std::uint8_t identity,
                                std::size_t fifo_bytes, std::uint32_t count_mask, double counts_per_degree) {
  return {.chip = {.name = name, .model = model, .addresses = {0x6a, 0x6b}, .identity = {{0x0f, identity}}},
          .rates = lsm6_rates,
          .accelerations = lsm6_accelerations,
          .angles = lsm6_angles,
          .filters = {},
          .setting_up = lsm6ds3_setting_up,
          .sleeping = lsm6_sleeping,
          .fifo = {.off = {.number = 0x0a},
                   .on = {.number = 0x0a, .value = 0x06, .by_rate = 1 << 3},
                   .status = 0x3a,
                   .status_bytes = 4,
                   .count_mask = count_mask,
                   .over_mask = 0x6000,      // overrun, full
                   .torn_mask = 0x03ff0000,  // the word that comes next
                   .count_bytes = 2,
                   .capacity = fifo_bytes,
                   .data = 0x3e,
                   .is_stream = true,
                   .to_discard = 1},
          .sample_bytes = 12,
          .acceleration_at = 6,
          .angle_at = 0,
          .temperature_register = 0x20,
          .counts_per_degree = counts_per_degree,
          .degrees_at_zero = 25,
          .self_test = lsm6_self_test(0.09)};
}
/// Words of 6 bytes, each after a tag byte.
constexpr InertialModel lsm6dso(std::string_view name, std::string_view model) {
  return {.chip = {.name = name, .model = model, .addresses = {0x6a, 0x6b}, .identity = {{0x0f, 0x6c}}},
          .rates = lsm6_rates,
          .accelerations = lsm6_accelerations,
          .angles = lsm6_angles,
          .filters = {},
          .setting_up = lsm6dso_setting_up,
          .sleeping = lsm6_sleeping,
          .fifo = {.off = {.number = 0x0a},
                   .on = {.number = 0x0a, .value = 0x06},
                   .status = 0x3a,
                   .status_bytes = 2,
                   .count_mask = 0x03ff,
                   .over_mask = 0x4800,  // overrun now, and overrun latched
                   .count_bytes = 7,
                   .capacity = 512 * 7,
                   .keeps_whole_samples = true,
                   .data = 0x78,
                   .is_stream = true,
                   .is_tagged = true,
                   .to_discard = 1},
          .sample_bytes = 12,
          .acceleration_at = 6,
          .angle_at = 0,
          .temperature_register = 0x20,
          .counts_per_degree = 256,
          .degrees_at_zero = 25,
          .self_test = lsm6_self_test(0.05)};
}

// LSM9DS1: slots of a sample each, read from the output registers.
inline constexpr InertialChoice lsm9ds1_rates[] = {{14.9, 1}, {59.5, 2}, {119, 3}, {238, 4}, {476, 5}, {952, 6}};
inline constexpr InertialChoice lsm9ds1_accelerations[] = {
    {2, 0, g(0.061e-3)}, {4, 2, g(0.122e-3)}, {8, 3, g(0.244e-3)}, {16, 1, g(0.732e-3)}};
inline constexpr InertialChoice lsm9ds1_angles[] = {
    {245, 0, degrees(8.75e-3)}, {500, 1, degrees(17.5e-3)}, {2000, 3, degrees(70e-3)}};
inline constexpr InertialWrite lsm9ds1_setting_up[] = {
    {.number = 0x22, .value = 0x01, .pause = 20ms},
    {.number = 0x22, .value = 0x44},
    {.number = 0x10, .by_rate = 1 << 5, .by_angle = 1 << 3},
    {.number = 0x20, .by_rate = 1 << 5, .by_acceleration = 1 << 3, .pause = 80ms},
    {.number = 0x23, .value = 0x02, .on_spi = 0x04}};  // no I2C
inline constexpr InertialWrite lsm9ds1_sleeping[] = {{.number = 0x10}, {.number = 0x20}};
inline constexpr InertialModel lsm9ds1{
    .chip = {.name = "LSM9DS1", .model = "lsm9ds1", .addresses = {0x6a, 0x6b}, .identity = {{0x0f, 0x68}}},
    .rates = lsm9ds1_rates,
    .accelerations = lsm9ds1_accelerations,
    .angles = lsm9ds1_angles,
    .filters = {},
    .setting_up = lsm9ds1_setting_up,
    .sleeping = lsm9ds1_sleeping,
    .fifo = {.off = {.number = 0x2e},
             .on = {.number = 0x2e, .value = 0xc0},
             .status = 0x2f,
             .count_mask = 0x3f,
             .over_mask = 0x40,
             .count_bytes = 12,
             .capacity = 32 * 12,
             .keeps_whole_samples = true,
             .data = 0x18,
             .second_data = 0x28,
             .to_discard = 1},
    .sample_bytes = 12,
    .acceleration_at = 6,
    .angle_at = 0,
    .temperature_register = 0x15,
    .counts_per_degree = 16,
    .degrees_at_zero = 25,
    .self_test = {.acceleration_register = 0x24,
                  .acceleration_on = 0x01,
                  .angle_register = 0x24,
                  .angle_on = 0x04,
                  .acceleration_output = 0x28,
                  .angle_output = 0x18,
                  .acceleration_range = 2,
                  .angle_range = 2000,
                  .limits = {{{g(0.07), g(1.5)},
                              {g(0.07), g(1.5)},
                              {g(0.07), g(1.5)},
                              {degrees(150), degrees(1000)},
                              {degrees(150), degrees(1000)},
                              {degrees(150), degrees(1000)}}}}};

// ICM-20948: 1125 Hz divided by 1 to 256, with the filters on; the rates of both sensors are counted from one instant.
// The bandwidths are those of the gyroscope; the accelerometer's differ by little.
inline constexpr InertialChoice icm20948_rates[] = {{4.5, 249},  {5, 224}, {9, 124},   {12.5, 89}, {25, 44},
                                                    {45, 24},    {75, 14}, {112.5, 9}, {125, 8},   {225, 4},
                                                    {281.25, 3}, {375, 2}, {562.5, 1}, {1125, 0}};
inline constexpr InertialChoice icm20948_filters[] = {{197, 0}, {152, 1}, {120, 2}, {51, 3}, {24, 4}, {12, 5}, {6, 6}};
// Reset; the best clock, and a wait until the gyroscope has started; bank 2: one instant, rates, filters and ranges;
// bank 0: what is in the FIFO stays when it is full, and is told; the FIFO can be read.
inline constexpr InertialWrite icm20948_setting_up[] = {
    {.number = 0x06, .value = 0x80, .pause = 100ms},
    {.number = 0x06, .value = 0x01, .pause = 35ms},
    {.number = 0x7f, .value = 0x20},
    {.number = 0x09, .value = 0x01},
    {.number = 0x00, .by_rate = 1},
    {.number = 0x01, .value = 0x01, .by_angle = 1 << 1, .by_filter = 1 << 3},
    {.number = 0x11, .by_rate = 1},
    {.number = 0x14, .value = 0x01, .by_acceleration = 1 << 1, .by_filter = 1 << 3},
    {.number = 0x7f},
    {.number = 0x69, .value = 0x01},
    {.number = 0x12, .value = 0x01},
    {.number = 0x03, .value = 0x40, .on_spi = 0x10}};  // no I2C
inline constexpr InertialWrite icm20948_sleeping[] = {{.number = 0x06, .value = 0x41}};
inline constexpr InertialWrite icm20948_emptying[] = {{.number = 0x68, .value = 0x1f}, {.number = 0x68}};
inline constexpr InertialModel icm20948{
    .chip = {.name = "ICM-20948", .model = "icm20948", .addresses = {0x68, 0x69}, .identity = {{0x00, 0xea}}},
    .rates = icm20948_rates,
    .accelerations = mpu_accelerations,
    .angles = mpu_angles,
    .filters = icm20948_filters,
    .setting_up = icm20948_setting_up,
    .sleeping = icm20948_sleeping,
    .fifo = {.off = {.number = 0x67},
             .on = {.number = 0x67, .value = 0x1e},  // acceleration, and angular velocity around X, Y, Z
             .emptying = icm20948_emptying,
             .status = 0x70,
             .status_bytes = 2,
             .count_mask = 0x1fff,
             .over_register = 0x1b,
             .over_bit = 0x1f,
             .capacity = 512,
             .data = 0x72,
             .is_stream = true},
    .big_endian = true,
    .sample_bytes = 12,
    .acceleration_at = 0,
    .angle_at = 6,
    .temperature_register = 0x39,
    .counts_per_degree = 333.87,
    .degrees_at_zero = 21,
    .bank_register = 0x7f};

inline constexpr InertialModel all[] = {
    mpu("MPU-6050", "mpu6050", 0x68, 1024, mpu6050_setting_up, mpu_self_test(8, mpu6050_limits), 340, 36.53,
        "MPU-6050"),
    mpu("MPU-6500", "mpu6500", 0x70, 512, mpu6500_setting_up, mpu_self_test(2, mpu6500_limits), 333.87, 21),
    mpu("MPU-9250", "mpu9250", 0x71, 512, mpu9250_setting_up, mpu_self_test(2, mpu6500_limits), 333.87, 21),
    lsm6ds3("LSM6DS3", "lsm6ds3", 0x69, 8192, 0x0fff, 16),
    lsm6ds3("LSM6DS3TR-C", "lsm6ds3trc", 0x6a, 4096, 0x07ff, 256),
    lsm6dso("LSM6DSO", "lsm6dso"),
    lsm6dso("LSM6DSOX", "lsm6dsox"),
    lsm9ds1,
    icm20948};

}  // namespace imu_models

struct ImuConfig {
  ImuModel model = ImuModel::mpu6050;
  std::optional<double> sample_rate{};         ///< output data rate in Hz; unset: the lowest from 100 on
  std::optional<double> acceleration_range{};  ///< g; unset: the widest
  std::optional<double> angular_range{};       ///< degrees a second; unset: the widest
  std::optional<double> bandwidth{};           ///< Hz of the low-pass filter of an MPU or ICM; unset: 42 or 51
  bool self_test = false;                      ///< at each start
  std::optional<IdentityCode> identity{};
  friend constexpr auto parameters(type_tag<ImuConfig>) {
    return parameter_list(
        parameter("model", &ImuConfig::model, "which chip it is",
                  choices(value("mpu6050", ImuModel::mpu6050), value("mpu6500", ImuModel::mpu6500),
                          value("mpu9250", ImuModel::mpu9250), value("lsm6ds3", ImuModel::lsm6ds3),
                          value("lsm6ds3trc", ImuModel::lsm6ds3trc), value("lsm6dso", ImuModel::lsm6dso),
                          value("lsm6dsox", ImuModel::lsm6dsox), value("lsm9ds1", ImuModel::lsm9ds1),
                          value("icm20948", ImuModel::icm20948))),
        parameter("sample_rate", &ImuConfig::sample_rate,
                  "samples per second that the chip takes; `rate` is how often the program fetches them. MPU: 1000, "
                  "ICM-20948: 1125, divided by a whole number; LSM6: 26, 52, 104, 208, 416, 833, 1660; LSM9DS1: 14.9, "
                  "59.5, 119, 238, 476, 952; default: the lowest that is at least 100",
                  unit("Hz"), range(4, 2000)),
        parameter("acceleration_range", &ImuConfig::acceleration_range,
                  "measuring range in g (9.80665 m/s2): 2, 4, 8 or 16; default: 16", range(2, 16)),
        parameter("angular_range", &ImuConfig::angular_range,
                  "measuring range in degrees per second. MPU, ICM: 250, 500, 1000, 2000; LSM6: also 125; LSM9DS1: "
                  "245, 500, 2000; default: 2000",
                  range(125, 2000)),
        parameter("bandwidth", &ImuConfig::bandwidth,
                  "cut-off frequency of the low-pass filter. MPU: 188, 98, 42, 20, 10 or 5 (default 42); ICM-20948: "
                  "197, 152, 120, 51, 24, 12 or 6 (default 51)",
                  unit("Hz"), range(5, 197), only_with("model", "mpu6050", "mpu6500", "mpu9250", "icm20948")),
        parameter("self_test", &ImuConfig::self_test,
                  "tests the chip at each start; it must lie still during the test"),
        identity_parameter(&ImuConfig::identity));
  }
  static std::span<const InertialModel> models() noexcept { return imu_models::all; }
  const InertialModel& chip() const noexcept { return models()[static_cast<std::size_t>(model)]; }
  InertialSettings settings() const {
    return {sample_rate, acceleration_range, angular_range, bandwidth, self_test, identity};
  }
  friend void check_config(const ImuConfig& config, const ConfigItem& item, Problems& problems) {
    InertialChip::check(config.chip(), config.settings(), item, problems);
  }
};

class Imu : public InertialDriver<ImuConfig, ImuReading> {
 public:
  static constexpr std::string_view type = "imu";
  static constexpr std::string_view aliases = "gyroscope gyro gy-521 gy-91 gy-9250";
  static constexpr std::string_view description =
      "acceleration and angular velocity of an MPU-6050, 6500, 9250, ICM-20948, LSM6DS3, DSO, DSOX or LSM9DS1 on "
      "I2C or SPI";
  static constexpr std::string_view notes =
      R"(- Wires: 3.3 V, ground, SDA, SCL. Addresses: MPU and ICM 0x68, with AD0 high 0x69; LSM 0x6a, with SDO (SA0) high 0x6b.
  Boards with a pin CS have it on 3.3 V for I2C. On SPI: SDO, SDI (SDA), SCK (SCL), CS; `chip_select` in place of
`address`; an MPU to 1 MHz, an ICM to 7 MHz, the others to 10 MHz. An MPU-6050 does not support SPI.
- The chip takes `sample_rate` samples a second by itself and keeps them in its FIFO; `rate` is how often the program
  empties it. Each sample is an event. The FIFO holds 73 samples of an MPU-6050, 36 of an MPU-6500 or 9250, 42 of an
  ICM-20948, 682 of an LSM6DS3 (TR-C: 341), 256 of an LSM6DSO or DSOX, 32 of an LSM9DS1. Empty it at least twice as
  often as it fills.
- Samples that do not fit are counted as `lost`: exactly with an LSM6DSO or DSOX; with the others from the time and the
  chip's rate, with an error of at most one each time.
- Times are accurate to one period: the chips' clocks are not read; the program learns their rates.
- An LSM6DSO and an LSM6DSOX have one identity and are used in the same way. The magnetometers of an MPU-9250 and an
  LSM9DS1 are separate chips, of type `magnetometer`. The magnetometer of an ICM-20948 is not read.
- Boards with an ICM-20948 have a regulator: the chip itself has 1.8 V on its bus.
- An MPU gives `temperature` with each sample; the others only with the newest sample of each read.
- `"self_test": true` takes 0.4 s at each start (MPU: 0.6 s); the chip must lie still meanwhile, and the `timeout` of
  the bus must be longer.
- A read on a bus of 400 kHz takes 0.3 to 0.45 ms a sample: 1000 samples a second need a third of it or more.
)";
  static constexpr RegisterPlace place{0x68};
  static constexpr auto chips = chips_of(imu_models::all);
  // Two samples in the FIFO: 1 g upwards, the temperature of the code 0, 8 degrees a second around X.
  static constexpr ChipSample samples[] = {
      {.bytes = {{{"75", "68"}, {"72", "00 1c"}, {"74", "00 00 00 00 08 00 00 00 00 83 00 00 00 00", 0, true}}},
       .values = {{{"acceleration_z", standard_gravity},
                   {"temperature", 36.53},
                   {"angular_velocity_x", 8 * radians_a_degree}}},
       .has_proof = true,
       .addressing = &imu_models::all[0].addressing},
      {.members = R"("model": "mpu6500")",
       .bytes = {{{"75", "70"}, {"72", "00 1c"}, {"74", "00 00 00 00 08 00 00 00 00 83 00 00 00 00", 0, true}}},
       .values = {{{"acceleration_z", standard_gravity},
                   {"temperature", 21},
                   {"angular_velocity_x", 8 * radians_a_degree}}},
       .has_proof = true,
       .addressing = &imu_models::all[1].addressing},
      {.members = R"("model": "icm20948")",
       .bytes = {{{"00", "ea", 0xff}, {"70", "00 18"}, {"72", "00 00 00 00 08 00 00 83 00 00 00 00", 0, true}}},
       .values = {{{"acceleration_z", standard_gravity}, {"angular_velocity_x", 8 * radians_a_degree}}},
       .has_proof = true}};

  using InertialDriver::InertialDriver;
  /// `bytes`: a sample as the FIFO has it.
  using InertialDriver::decode;
};

}  // namespace rtdata
