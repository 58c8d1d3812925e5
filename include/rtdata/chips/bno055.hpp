/// Bno055: orientation by a BNO055 of Bosch on I2C, which joins its accelerometer, gyroscope and magnetometer itself.
///
///     rtdata::DriverSensor<rtdata::Bno055> attitude(loop, {.name = "attitude", .rate = 50_Hz}, bus);
///
/// The chip has a new orientation 100 times a second and no FIFO: each tick reads the last one, faster ticks read the
/// same again. For about 0.6 s after power-on the chip does not answer, and the sensor tries again. Until its fusion
/// runs, there is no new data. An invalid orientation (a quaternion whose length is not 1) is unreadable. When the chip
/// has lost its settings or reports an error, the driver reports it and sets the chip up again.
///
/// Orientation is only as good as the chip's calibration, which it makes while it is moved: `calibration_system` and
/// the others go from 0 to 3.
///
/// Source: Bosch BNO055, BST-BNO055-DS000 rev. 1.4: 3.3 modes, 3.6.1 units, 3.6.5 outputs and scales, 3.10
/// calibration, 4.3 registers.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct OrientationReading {
  double quaternion_w = 0, quaternion_x = 0, quaternion_y = 0, quaternion_z = 0;
  double heading = 0, roll = 0, pitch = 0;  ///< the same as angles, clockwise from north
  double linear_acceleration_x = 0, linear_acceleration_y = 0, linear_acceleration_z = 0;  ///< without gravity
  double acceleration_x = 0, acceleration_y = 0, acceleration_z = 0;                       ///< with gravity
  double angular_velocity_x = 0, angular_velocity_y = 0, angular_velocity_z = 0;
  std::optional<double> magnetic_field_x{}, magnetic_field_y{}, magnetic_field_z{};               ///< unset without it
  std::uint8_t calibration_system = 0, calibration_gyroscope = 0, calibration_accelerometer = 0;  ///< 0, none, to 3
  std::optional<std::uint8_t> calibration_magnetometer{};
  double temperature = 0;  ///< of the chip
  friend constexpr auto describe(type_tag<OrientationReading>) {
    using R = OrientationReading;
    return record(
        "orientation", field("quaternion_w", &R::quaternion_w), field("quaternion_x", &R::quaternion_x),
        field("quaternion_y", &R::quaternion_y), field("quaternion_z", &R::quaternion_z),
        field("heading", &R::heading, "rad"), field("roll", &R::roll, "rad"), field("pitch", &R::pitch, "rad"),
        field("linear_acceleration_x", &R::linear_acceleration_x, "m/s2"),
        field("linear_acceleration_y", &R::linear_acceleration_y, "m/s2"),
        field("linear_acceleration_z", &R::linear_acceleration_z, "m/s2"),
        field("acceleration_x", &R::acceleration_x, "m/s2"), field("acceleration_y", &R::acceleration_y, "m/s2"),
        field("acceleration_z", &R::acceleration_z, "m/s2"),
        field("angular_velocity_x", &R::angular_velocity_x, "rad/s"),
        field("angular_velocity_y", &R::angular_velocity_y, "rad/s"),
        field("angular_velocity_z", &R::angular_velocity_z, "rad/s"),
        field("magnetic_field_x", &R::magnetic_field_x, "T"), field("magnetic_field_y", &R::magnetic_field_y, "T"),
        field("magnetic_field_z", &R::magnetic_field_z, "T"), field("calibration_system", &R::calibration_system),
        field("calibration_gyroscope", &R::calibration_gyroscope),
        field("calibration_accelerometer", &R::calibration_accelerometer),
        field("calibration_magnetometer", &R::calibration_magnetometer), field("temperature", &R::temperature, "Cel"));
  }
};

enum class Bno055Mode { ndof, imu };

class Bno055 {
 public:
  static constexpr std::string_view type = "bno055";
  static constexpr std::string_view description = "orientation, linear acceleration and rates of a BNO055 on I2C";
  static constexpr std::string_view notes =
      R"(- Wires: 3.3 V, ground, SDA, SCL. Address: 0x28, with ADR (COM3) high 0x29.
- The chip holds the clock line while it is busy (clock stretching). The I2C controller of Raspberry Pis up to the 4
  reads wrong bytes then: use its software bus (`dtoverlay=i2c-gpio`) instead. Impossible readings are reported as
  unreadable, but not all wrong bytes can be detected.
- A new orientation comes 100 times a second: a `rate` above 100 Hz reads the same value again. There is no FIFO.
- In mode `ndof` the heading follows the earth's magnetic field; in mode `imu` it begins at 0 and drifts, but magnets
  do not disturb it.
- Trust an orientation when `calibration_system` is 3: keep the chip still for the gyroscope, move it in figures of
  eight for the magnetometer, hold it in six positions for the accelerometer. The calibration is made anew after each
  loss of power.
- After switching on it needs 0.7 s; the sensor tries again until then.
)";
  struct Config {
    Bno055Mode mode = Bno055Mode::ndof;
    std::optional<IdentityCode> identity{};  ///< of a clone
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(parameter("mode", &Config::mode, "ndof: with the magnetometer; imu: without",
                                      choices(value("ndof", Bno055Mode::ndof), value("imu", Bno055Mode::imu))),
                            identity_parameter(&Config::identity));
    }
  };
  using Value = OrientationReading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x28};
  static constexpr KnownChip chips[] = {{.name = "BNO055", .addresses = {0x28, 0x29}, .identity = {{0x00, 0xa0}}}};
  // A quarter turn to the right, 1 g downwards.
  static constexpr ChipSample samples[] = {
      {.bytes = {{{"00", "a0"},
                  {"08", "c8 00 00 00 d5 03  40 01 60 ff 10 00  84 03 3e fe 00 00"},
                  {"1a", "86 05 00 00 a6 ff  41 2d 00 00 00 00 bf d2"},
                  {"34", "fb e6 0f"},
                  {"39", "05"}}},
       .values = {{{"quaternion_w", 0.70710678},
                   {"heading", 1.5711111},
                   {"acceleration_z", 9.81},
                   {"magnetic_field_x", 20e-6}}},
       .has_proof = true}};
  explicit Bno055(const Config& config) : config_(config) {}
  static Duration bus_time(const Config&) { return to_configuration + from_configuration; }

  Result<void> open(I2cDevice& chip) {
    if (auto same = check_chip(chip); !same) return same;
    const Result<std::uint8_t> tested = chip.read_register(0x36);
    if (!tested) return tested.error();
    for (unsigned i = 0; i < 4; ++i) {
      constexpr std::array<const char*, 4> parts{"accelerometer", "magnetometer", "gyroscope", "processor"};
      if ((*tested >> i & 1) == 0)
        return chip.error(Errc::bad_data, "cannot use the BNO055",
                          std::string("its self-test found a fault in its ") + parts[i], "the chip is damaged");
    }
    return set_up(chip);
  }

  Reading<OrientationReading> read(I2cDevice& chip) {
    std::array<std::uint8_t, 0x3d - first_register + 1> bytes{};  // to the mode
    if (auto done = chip.read_registers(first_register, bytes); !done) return std::move(done).error();
    const std::uint8_t status = bytes[0x39 - first_register], error = bytes[0x3a - first_register];
    if (bytes[0x3b - first_register] != units || bytes[0x3d - first_register] != mode_code()) {
      if (auto same = check_chip(chip); !same) return std::move(same).error();
      auto lost = chip.error(Errc::bad_data, what, "it has lost its settings", "check its supply");
      if (auto done = set_up(chip); !done) return std::move(done).error();
      return Unreadable{std::move(lost)};
    }
    constexpr std::uint8_t system_error = 1, fusion_runs = 5;
    if (status == system_error) {
      if (auto done = set_up(chip); !done) return std::move(done).error();
      return chip.error(Errc::bad_data, what, "it reports error " + std::to_string(error),
                        "see section 4.3.59 of its data sheet");
    }
    if (status != fusion_runs) {
      constexpr auto patience = std::chrono::seconds{1};
      if (Samples<int>::now() - set_up_at_ < patience) return NothingNew{};
      return chip.error(Errc::timed_out, what,
                        "its sensor fusion does not run: its status is " + std::to_string(status), "");
    }
    const auto reading = decode(bytes, config_.mode);
    if (!reading) return Unreadable{chip.error(Errc::bad_data, what, reading.error().why, reading.error().advice)};
    return *reading;
  }

  /// Sleeps.
  void close(I2cDevice& chip) {
    (void)chip.write_register(mode_register, 0);
    chip.wait(to_configuration);
    (void)chip.write_register(0x3e, 0x02);
  }

  static constexpr std::uint8_t first_register = 0x08;
  /// `bytes`: the registers from 0x08 on, to 0x35 at least. Errors: bad-data (no orientation).
  static Result<OrientationReading> decode(std::span<const std::uint8_t> bytes, Bno055Mode mode) {
    const auto at = [&](unsigned number, unsigned index, double scale) {
      const std::size_t place_of = number - first_register + 2 * index;
      const auto word = static_cast<std::uint16_t>(bytes[place_of] | bytes[place_of + 1] << 8);
      return static_cast<std::int16_t>(word) / scale;
    };
    constexpr double acceleration = 100, field = 16e6, radians = 900, quaternion = 16384;
    OrientationReading reading;
    reading.acceleration_x = at(0x08, 0, acceleration);
    reading.acceleration_y = at(0x08, 1, acceleration);
    reading.acceleration_z = at(0x08, 2, acceleration);
    reading.angular_velocity_x = at(0x14, 0, radians);
    reading.angular_velocity_y = at(0x14, 1, radians);
    reading.angular_velocity_z = at(0x14, 2, radians);
    reading.heading = at(0x1a, 0, radians);
    reading.roll = at(0x1a, 1, radians);
    reading.pitch = at(0x1a, 2, radians);
    reading.quaternion_w = at(0x20, 0, quaternion);
    reading.quaternion_x = at(0x20, 1, quaternion);
    reading.quaternion_y = at(0x20, 2, quaternion);
    reading.quaternion_z = at(0x20, 3, quaternion);
    reading.linear_acceleration_x = at(0x28, 0, acceleration);
    reading.linear_acceleration_y = at(0x28, 1, acceleration);
    reading.linear_acceleration_z = at(0x28, 2, acceleration);
    reading.temperature = static_cast<std::int8_t>(bytes[0x34 - first_register]);
    const unsigned calibration = bytes[0x35 - first_register];
    reading.calibration_system = static_cast<std::uint8_t>(calibration >> 6);
    reading.calibration_gyroscope = static_cast<std::uint8_t>(calibration >> 4 & 3);
    reading.calibration_accelerometer = static_cast<std::uint8_t>(calibration >> 2 & 3);
    if (mode == Bno055Mode::ndof) {
      reading.magnetic_field_x = at(0x0e, 0, field);
      reading.magnetic_field_y = at(0x0e, 1, field);
      reading.magnetic_field_z = at(0x0e, 2, field);
      reading.calibration_magnetometer = static_cast<std::uint8_t>(calibration & 3);
    }
    const double length = std::sqrt(
        reading.quaternion_w * reading.quaternion_w + reading.quaternion_x * reading.quaternion_x +
        reading.quaternion_y * reading.quaternion_y + reading.quaternion_z * reading.quaternion_z);
    if (!(std::abs(length - 1) < 0.02))
      return Error{Errc::bad_data, what, "", "its quaternion has the length " + std::to_string(length) + ", not 1",
                   "bytes were read wrong: use a bus that supports clock stretching"};
    return reading;
  }

 private:
  static constexpr const char* what = "cannot read the BNO055";
  static constexpr std::uint8_t mode_register = 0x3d;
  static constexpr std::uint8_t units = 0x06;  // m/s2, rad/s, rad, degrees Celsius; Windows orientation
  static constexpr auto to_configuration = std::chrono::milliseconds{19},
                        from_configuration = std::chrono::milliseconds{7};

  std::uint8_t mode_code() const noexcept { return config_.mode == Bno055Mode::ndof ? 0x0c : 0x08; }
  Result<void> check_chip(I2cDevice& chip) const {
    return check_identity(chip, chips[0], config_.identity, {},
                          "check which chip is at this address (a BNO055 needs 0.7 s after it was switched on)");
  }
  /// First page, configuration, units, no sleep; then the mode.
  Result<void> set_up(I2cDevice& chip) {
    if (auto done = chip.write_register(0x07, 0); !done) return done;
    if (auto done = chip.write_register(mode_register, 0); !done) return done;
    chip.wait(to_configuration);
    if (auto done = chip.write_register(0x3e, 0); !done) return done;
    if (auto done = chip.write_register(0x3b, units); !done) return done;
    auto done = chip.write_register(mode_register, mode_code());
    chip.wait(from_configuration);
    set_up_at_ = Samples<int>::now();
    return done;
  }

  Config config_;
  MonotonicTime set_up_at_{};
};

}  // namespace rtdata
