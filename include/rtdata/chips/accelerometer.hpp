/// Accelerometer: acceleration of an ADXL345 (16 g), ADXL375 (200 g) or LIS3DH (16 g) on I2C or SPI.
///
///     rtdata::DriverSensor<rtdata::Accelerometer> shock(loop, {.name = "shock", .rate = 100_Hz}, bus,
///                                                       {.address = 0x53},
///                                                       {.model = rtdata::AccelerometerModel::adxl375,
///                                                        .sample_rate = 800});
///
/// The chip measures by itself at `sample_rate` and keeps up to 32 samples in a FIFO, which each tick of the sensor
/// empties. Times, losses, lost settings: inertial.hpp. Both ADXL have the same identity, so the driver cannot tell
/// which one it is; a wrong `model` gives wrong values. An LIS3DH measures in its mode of high resolution, 12 bits; its
/// first seven samples after power-on, while it settles, are discarded.
///
/// Sources: Analog Devices ADXL345, data sheet rev. E: table 1 scale and self-test, "FIFO", register map (table 19);
/// ADXL375, rev. B: table 1 scale, register map. STMicroelectronics LIS3DH, DocID17530 rev. 2: table 4 scale, "high
/// resolution", turn-on time (table 11), "FIFO", register description.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include "rtdata/chips/inertial.hpp"
#include "rtdata/data/describe.hpp"

namespace rtdata {

struct AccelerometerReading {
  double acceleration_x = 0, acceleration_y = 0, acceleration_z = 0;  ///< with gravity
  static AccelerometerReading of(const InertialSample& sample) noexcept {
    return {sample.acceleration[0], sample.acceleration[1], sample.acceleration[2]};
  }
  friend constexpr auto describe(type_tag<AccelerometerReading>) {
    return record("accelerometer", field("acceleration_x", &AccelerometerReading::acceleration_x, "m/s2"),
                  field("acceleration_y", &AccelerometerReading::acceleration_y, "m/s2"),
                  field("acceleration_z", &AccelerometerReading::acceleration_z, "m/s2"));
  }
};

enum class AccelerometerModel { adxl345, adxl375, lis3dh };

/// The models, in the order of `AccelerometerModel`.
namespace accelerometer_models {

using namespace std::chrono_literals;

inline constexpr InertialChoice rates[] = {{6.25, 6}, {12.5, 7}, {25, 8},   {50, 9},   {100, 10},
                                           {200, 11}, {400, 12}, {800, 13}, {1600, 14}};
// With full resolution, 256 counts a g at each range.
inline constexpr InertialChoice adxl345_ranges[] = {{2, 0, standard_gravity / 256},
                                                    {4, 1, standard_gravity / 256},
                                                    {8, 2, standard_gravity / 256},
                                                    {16, 3, standard_gravity / 256}};
inline constexpr InertialChoice adxl375_ranges[] = {{200, 3, 0.049 * standard_gravity}};
// Standby, no interrupts, rate, format, and on. There is no reset.
inline constexpr InertialWrite setting_up[] = {{.number = 0x2d},
                                               {.number = 0x2e},
                                               {.number = 0x2c, .by_rate = 1},
                                               {.number = 0x31, .value = 0x08, .by_acceleration = 1},
                                               {.number = 0x2d, .value = 0x08, .pause = 12ms}};
inline constexpr InertialWrite sleeping[] = {{.number = 0x2d}};
constexpr InertialModel adxl(std::string_view name, std::string_view model, std::span<const InertialChoice> ranges,
                             InertialSelfTest self_test) {
  return {.chip = {.name = name, .model = model, .addresses = {0x53, 0x1d}, .identity = {{0x00, 0xe5}}},
          .rates = rates,
          .accelerations = ranges,
          .angles = {},
          .filters = {},
          .setting_up = setting_up,
          .sleeping = sleeping,
          .fifo = {.off = {.number = 0x38},
                   .on = {.number = 0x38, .value = 0x80},
                   .status = 0x39,
                   .count_mask = 0x3f,
                   .over_register = 0x30,
                   .over_bit = 0x01,
                   .count_bytes = 6,
                   .capacity = 33 * 6,  // the output registers hold one more than the FIFO
                   .keeps_whole_samples = true,
                   .data = 0x32},
          .self_test = self_test,
          .addressing = {.spi_burst_bit = 0x40}};
}
/// At 2.5 V, to the most at 3.3 V.
inline constexpr InertialSelfTest adxl345_self_test{.acceleration_register = 0x31,
                                                    .acceleration_on = 0x80,
                                                    .acceleration_output = 0x32,
                                                    .acceleration_range = 16,
                                                    .limits = {{{0.2 * standard_gravity, 3.72 * standard_gravity},
                                                                {0.2 * standard_gravity, 3.72 * standard_gravity},
                                                                {0.3 * standard_gravity, 5.0 * standard_gravity}}}};

// At 1344 a second, too, with 12 bits. 1, 2, 4 and 12 mg a count of these, which are the upper ones of 16.
inline constexpr InertialChoice lis3dh_rates[] = {{10, 2}, {25, 3}, {50, 4}, {100, 5}, {200, 6}, {400, 7}, {1344, 9}};
inline constexpr InertialChoice lis3dh_ranges[] = {{2, 0, 0.001 / 16 * standard_gravity},
                                                   {4, 1, 0.002 / 16 * standard_gravity},
                                                   {8, 2, 0.004 / 16 * standard_gravity},
                                                   {16, 3, 0.012 / 16 * standard_gravity}};
// Off; no filter, no interrupts; block data update, range, high resolution; FIFO; rate and axes. There is no reset.
inline constexpr InertialWrite lis3dh_setting_up[] = {{.number = 0x20},
                                                      {.number = 0x21},
                                                      {.number = 0x22},
                                                      {.number = 0x23, .value = 0x88, .by_acceleration = 1 << 4},
                                                      {.number = 0x24, .value = 0x40},
                                                      {.number = 0x20, .value = 0x07, .by_rate = 1 << 4}};
inline constexpr InertialWrite lis3dh_sleeping[] = {{.number = 0x20}};
inline constexpr InertialModel lis3dh{
    .chip = {.name = "LIS3DH", .model = "lis3dh", .addresses = {0x18, 0x19}, .identity = {{0x0f, 0x33}}},
    .rates = lis3dh_rates,
    .accelerations = lis3dh_ranges,
    .angles = {},
    .filters = {},
    .setting_up = lis3dh_setting_up,
    .sleeping = lis3dh_sleeping,
    .fifo = {.off = {.number = 0x2e},
             .on = {.number = 0x2e, .value = 0x80},
             .status = 0x2f,
             .count_mask = 0x1f,
             .over_mask = 0x40,
             .count_bytes = 6,
             .capacity = 32 * 6,
             .keeps_whole_samples = true,
             .data = 0x28,
             .to_discard = 7},
    .addressing = {.i2c_burst_bit = 0x80, .spi_burst_bit = 0x40}};

inline constexpr InertialModel all[] = {adxl("ADXL345", "adxl345", adxl345_ranges, adxl345_self_test),
                                        adxl("ADXL375", "adxl375", adxl375_ranges, {}), lis3dh};

}  // namespace accelerometer_models

struct AccelerometerConfig {
  AccelerometerModel model = AccelerometerModel::adxl345;
  std::optional<double> sample_rate{};         ///< output data rate in Hz; unset: 100
  std::optional<double> acceleration_range{};  ///< g; unset: the widest
  bool self_test = false;                      ///< at each start, of an ADXL345
  std::optional<IdentityCode> identity{};
  friend constexpr auto parameters(type_tag<AccelerometerConfig>) {
    return parameter_list(
        parameter("model", &AccelerometerConfig::model, "which chip it is",
                  choices(value("adxl345", AccelerometerModel::adxl345), value("adxl375", AccelerometerModel::adxl375),
                          value("lis3dh", AccelerometerModel::lis3dh))),
        parameter("sample_rate", &AccelerometerConfig::sample_rate,
                  "samples per second that the chip takes: 6.25, 12.5, 25, 50, 100, 200, 400, 800 or 1600; LIS3DH: 10, "
                  "25, 50, 100, 200, 400 or 1344; `rate` is how often the program fetches them; default: 100",
                  unit("Hz"), range(6.25, 1600.0)),
        parameter(
            "acceleration_range", &AccelerometerConfig::acceleration_range,
            "measuring range in g (9.80665 m/s2). ADXL345, LIS3DH: 2, 4, 8 or 16; ADXL375: 200; default: the largest",
            range(2, 200)),
        parameter("self_test", &AccelerometerConfig::self_test,
                  "tests the chip at each start; it must lie still during the test", only_with("model", "adxl345")),
        identity_parameter(&AccelerometerConfig::identity));
  }
  static std::span<const InertialModel> models() noexcept { return accelerometer_models::all; }
  const InertialModel& chip() const noexcept { return models()[static_cast<std::size_t>(model)]; }
  InertialSettings settings() const { return {sample_rate, acceleration_range, {}, {}, self_test, identity}; }
  friend void check_config(const AccelerometerConfig& config, const ConfigItem& item, Problems& problems) {
    InertialChip::check(config.chip(), config.settings(), item, problems);
  }
};

class Accelerometer : public InertialDriver<AccelerometerConfig, AccelerometerReading> {
 public:
  static constexpr std::string_view type = "accelerometer";
  static constexpr std::string_view description = "acceleration of an ADXL345, ADXL375 or LIS3DH on I2C or SPI";
  static constexpr std::string_view notes =
      R"(- Wires: 3.3 V, ground, SDA, SCL; CS on 3.3 V for I2C. Address: 0x53, with SDO (ALT ADDRESS) high 0x1d; LIS3DH:
  0x18, with SDO (SA0) high 0x19.
On SPI: SDO, SDI (SDA), SCK (SCL), CS; `chip_select` in place of `address`; to 1.6 MHz, because the FIFO needs some
  time between two readings.
- The chip takes `sample_rate` samples a second by itself and keeps up to 32 in its FIFO; `rate` is how often the
  program empties it. Each sample is an event. At 800 samples a second it is full after 40 ms: `"rate": "50 Hz"` or
  more.
- Samples that do not fit are counted as `lost`, from the time and the chip's rate, with an error of at most one each
  time.
- Times are accurate to one period: the chip's clock is not read; the program learns its rate.
- An ADXL345 and an ADXL375 have one identity: a wrong `model` is not noticed, and its values are wrong by a factor of
  12.5. An LIS3DH and an LIS2DH12 also have one identity, but their values differ little.
- `"self_test": true` (ADXL345) takes 0.35 s at each start; the chip must lie still meanwhile, and the `timeout` of the
  bus must be longer.
- A read on a bus of 400 kHz takes 0.25 ms a sample.
)";
  static constexpr RegisterPlace place{0x53};
  static constexpr auto chips = chips_of(accelerometer_models::all);
  // 20 samples in the FIFO (0.2 s at 100 Hz), of 256 counts a g; -32, 20 and 127 counts of 12 mg.
  static constexpr ChipSample samples[] = {{.bytes = {{{"00", "e5"}, {"32", "80 ff 40 00 00 01"}, {"39", "14"}}},
                                            .values = {{{"acceleration_x", -0.5 * standard_gravity},
                                                        {"acceleration_y", 0.25 * standard_gravity},
                                                        {"acceleration_z", standard_gravity}}},
                                            .has_proof = true,
                                            .addressing = &accelerometer_models::all[0].addressing},
                                           {.members = R"("model": "lis3dh")",
                                            .bytes = {{{"0f", "33"}, {"28", "00 fe 40 01 f0 07"}, {"2f", "14"}}},
                                            .values = {{{"acceleration_x", -0.384 * standard_gravity},
                                                        {"acceleration_y", 0.24 * standard_gravity},
                                                        {"acceleration_z", 1.524 * standard_gravity}}},
                                            .has_proof = true,
                                            .addressing = &accelerometer_models::all[2].addressing}};

  using InertialDriver::InertialDriver;
  /// `bytes`: the registers 0x32 to 0x37; LIS3DH: 0x28 to 0x2d.
  using InertialDriver::decode;
};

}  // namespace rtdata
