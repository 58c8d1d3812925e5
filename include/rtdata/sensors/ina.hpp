/// Ina: voltage, current and power by an INA219 or INA226 of Texas Instruments on I2C.
///
///     rtdata::DriverSensor<rtdata::Ina> battery(loop, {.name = "battery", .rate = 10_Hz}, bus, {.address = 0x40},
///                                               {.model = InaModel::ina219, .shunt_resistance = 0.1});
///
/// The chip measures by itself, some 900 times a second (INA219) or 450 times (INA226, both inputs); a tick reads
/// the last of each. Current is the voltage at the shunt over `shunt_resistance`; one beyond the chip's range
/// (INA219 0.32 V, INA226 0.08 V) is unreadable. Addresses: 0x40 to 0x4f. The INA226 has an identity, which is
/// checked; a chip that has lost its settings is counted as unreadable and set up again.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <cstdint>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct PowerReading {
  double voltage = 0;  ///< at the load
  double current = 0;  ///< positive towards the load
  double power = 0;
  friend constexpr auto describe(type_tag<PowerReading>) {
    return record("power", field("voltage", &PowerReading::voltage, "V"), field("current", &PowerReading::current, "A"),
                  field("power", &PowerReading::power, "W"));
  }
};

enum class InaModel { ina219, ina226 };

class Ina {
 public:
  static constexpr std::string_view type = "ina";
  static constexpr std::string_view description = "voltage, current and power of an INA219 or INA226 on I2C";
  static constexpr std::string_view notes = R"(
- Addresses `0x40` to `0x4f`, by what A0 and A1 are connected to.
- The load's supply goes through the shunt, from IN+ to IN-. To 26 V (INA219) or 36 V (INA226).
- Current is the voltage at the shunt over `shunt_resistance`. To 0.32 V at the shunt (INA219) or 0.08 V (INA226): 3.2 A or
  0.8 A with 0.1 Ohm; more is unreadable.
- It measures by itself, some 900 times a second (INA219) or 450 times (INA226); a reading takes the last value.
- The INA226 has an identity, which is checked. A chip that has lost its settings is unreadable once, and set up again.
)";
  struct Config {
    InaModel model = InaModel::ina219;
    double shunt_resistance = 0.1;  ///< Ohm
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(parameter("model", &Config::model, "which chip it is",
                                      choices(value("ina219", InaModel::ina219), value("ina226", InaModel::ina226))),
                            parameter("shunt_resistance", &Config::shunt_resistance, "of the shunt: 0.1 on most boards",
                                      unit("Ohm"), range(1e-6, 1e3)));
    }
  };
  using Value = PowerReading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x40};
  /// SetupError (bad-argument): a resistance that is not above 0.
  explicit Ina(const Config& config);

  Result<void> open(I2cDevice& chip);
  Reading<PowerReading> read(I2cDevice& chip);

  /// Of the registers of shunt voltage and bus voltage. Errors: out-of-range.
  static Result<PowerReading> decode(std::uint16_t shunt, std::uint16_t bus, const Config& config);

 private:
  Config config_;
};

}  // namespace rtdata
