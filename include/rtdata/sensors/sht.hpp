/// Sht: thermometers and hygrometers SHT30, SHT31, SHT35 and SHT40, SHT41, SHT45 of Sensirion on I2C.
///
///     rtdata::DriverSensor<rtdata::Sht> room(loop, {.name = "room", .rate = 1_Hz}, bus, {.address = 0x44},
///                                            {.model = ShtModel::sht3x});
///
/// Each tick starts one measurement of high repeatability and reads it when the chip has had its time (SHT3x 16 ms,
/// SHT4x 9 ms); the bus is free for others meanwhile, and the event has the time of the start. Both numbers have a
/// checksum: a reading with a wrong one is unreadable. Addresses: 0x44 and 0x45 (SHT4x: 0x44 to 0x46). The SHT4x
/// gives humidities from -6 to 119 %, which are limited to 0 and 100 %, as its data sheet has it (4.6).
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

struct HumidityReading {
  double temperature = 0;
  double humidity = 0;  ///< relative
  friend constexpr auto describe(type_tag<HumidityReading>) {
    return record("humidity", field("temperature", &HumidityReading::temperature, "Cel"),
                  field("humidity", &HumidityReading::humidity, "%"));
  }
};

enum class ShtModel { sht3x, sht4x };

class Sht {
 public:
  static constexpr std::string_view type = "sht";
  static constexpr std::string_view description = "temperature and humidity of an SHT3x or SHT4x on I2C";
  static constexpr std::string_view notes = R"(
- Addresses: SHT3x `0x44` with ADDR at ground, `0x45` with ADDR at the supply; SHT4x as ordered, `0x44` to `0x46`.
- -40 to 125 degrees, 0 to 100 %. One measurement takes 16 ms (SHT3x) or 9 ms (SHT4x).
- Both numbers have a checksum: a reading with a wrong one is unreadable.
- Nothing of the chip says which model it is: the wrong `model` has no answer, or wrong values.
)";
  struct Config {
    ShtModel model = ShtModel::sht3x;
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(parameter("model", &Config::model, "sht3x: SHT30, SHT31, SHT35; sht4x: SHT40, SHT41, SHT45",
                                      choices(value("sht3x", ShtModel::sht3x), value("sht4x", ShtModel::sht4x))));
    }
  };
  using Value = HumidityReading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x44};
  explicit Sht(const Config& config) : config_(config) {}

  Result<void> start(I2cDevice& chip);
  Duration conversion_time() const noexcept;
  Reading<HumidityReading> read(I2cDevice& chip);

  /// Polynomial 0x31, begun with 0xff (data sheet of the SHT3x, 4.12): 0x92 for 0xbe, 0xef.
  static std::uint8_t checksum(std::span<const std::uint8_t, 2> bytes) noexcept;
  /// Of temperature, checksum, humidity, checksum. Errors: bad-data (a checksum).
  static Result<HumidityReading> decode(std::span<const std::uint8_t, 6> bytes, ShtModel model);

 private:
  Config config_;
};

}  // namespace rtdata
