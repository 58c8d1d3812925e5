/// Bmp280: a barometer and thermometer BMP280 of Bosch on I2C.
///
///     rtdata::DriverSensor<rtdata::Bmp280> air(loop, {.name = "air", .rate = 10_Hz}, bus, {.address = 0x76},
///                                              {.pressure_oversampling = 16});
///
/// Each tick starts one measurement and reads it when the chip has had its time (7 ms, with 16-fold oversampling of
/// both 76 ms); the bus is free for others meanwhile, and the event has the time of the start. Addresses: 0x76 and
/// 0x77. A chip of another identity is refused. One that has lost its settings (it was without power), or that gives
/// the value of a measurement that was skipped, is counted as unreadable.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <cstdint>
#include <span>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct BarometerReading {
  double pressure = 0;
  double temperature = 0;
  friend constexpr auto describe(type_tag<BarometerReading>) {
    return record("barometer", field("pressure", &BarometerReading::pressure, "Pa"),
                  field("temperature", &BarometerReading::temperature, "Cel"));
  }
};

class Bmp280 {
 public:
  static constexpr std::string_view type = "bmp280";
  static constexpr std::string_view description = "pressure and temperature of a Bosch BMP280 on I2C";
  static constexpr std::string_view notes = R"(
- Address `0x76` with SDO at ground, `0x77` with SDO at the supply. 1.71 to 3.6 V: a board without a regulator takes no 5 V.
- 300 to 1100 hPa, -40 to 85 degrees. One measurement takes 7 ms, with 16-fold oversampling of both 76 ms.
- A chip with another identity is refused; a BME280, with humidity, is one.
- A chip that has lost its settings, or gives the value of a measurement that it skipped, is unreadable for that reading.
)";
  struct Config {
    unsigned pressure_oversampling = 1;     ///< measurements that are averaged: 1, 2, 4, 8, 16
    unsigned temperature_oversampling = 1;  ///< the same
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(parameter("pressure_oversampling", &Config::pressure_oversampling,
                                      "measurements that are averaged: 1, 2, 4, 8 or 16", range(1, 16)),
                            parameter("temperature_oversampling", &Config::temperature_oversampling,
                                      "measurements that are averaged: 1, 2, 4, 8 or 16", range(1, 16)));
    }
    friend void check_config(const Config& config, const ConfigItem& item, Problems& problems);
  };
  /// The chip's trimming parameters.
  struct Calibration {
    std::uint16_t t1 = 0;
    std::int16_t t2 = 0, t3 = 0;
    std::uint16_t p1 = 0;
    std::int16_t p2 = 0, p3 = 0, p4 = 0, p5 = 0, p6 = 0, p7 = 0, p8 = 0, p9 = 0;
    /// From registers 0x88 to 0x9f.
    static Calibration decode(std::span<const std::uint8_t, 24> bytes) noexcept;
  };
  using Value = BarometerReading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x76};

  /// SetupError (bad-argument): an oversampling that the chip does not have.
  explicit Bmp280(const Config& config);
  Result<void> open(I2cDevice& chip);
  Result<void> start(I2cDevice& chip);
  Duration conversion_time() const noexcept;
  Reading<BarometerReading> read(I2cDevice& chip);

  /// From registers 0xf7 to 0xfc. Errors: bad-data (the measurement was skipped).
  static Result<BarometerReading> decode(std::span<const std::uint8_t, 6> bytes, const Calibration& calibration);

 private:
  Config config_;
  Calibration calibration_;
};

}  // namespace rtdata
