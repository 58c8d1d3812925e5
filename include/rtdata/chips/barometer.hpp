/// Barometer: pressure, temperature and altitude of a BMP280, BME280 (humidity too), BMP388, BMP390, BMP581, BMP585 or
/// MS5611 on I2C or SPI.
///
///     rtdata::DriverSensor<rtdata::Barometer> air(loop, {.name = "air", .rate = 10_Hz}, bus, {.address = 0x76},
///                                                 {.model = rtdata::BarometerModel::bmp280,
///                                                  .pressure_oversampling = 16});
///
/// Each tick starts one measurement and reads it when the chip has had its time (7 ms, with 16-fold oversampling of
/// both 76 ms; a BMP581: 5 and 17 ms); the bus is free for others meanwhile, and the event has the time of the start.
/// An MS5611 measures its temperature after the pressure, for which it holds the bus (0.6 to 9 ms, as
/// `temperature_oversampling` says).
///
/// The driver refuses a chip with another identity; an MS5611 has no identity and is checked by its checksum. It also
/// refuses trimming parameters that are all zeros or all ones; a BMP581 has none that are read, and says itself whether
/// its memory is right. A reading is unreadable when the chip was reset during the measurement, has lost its settings,
/// or has skipped the measurement; the next tick sets the chip up again.
///
/// `altitude` is the pressure altitude in the ICAO standard atmosphere (`pressure_altitude`) minus the altitude of
/// `reference_pressure`: an altimeter that is set to this pressure shows the same. With the pressure at sea level it is
/// the height above the sea; with the pressure at the launch pad it is the height above the pad.
///
/// Sources: BMP280, BST-BMP280-DS001: 3.8.1 times, 3.11.3 and 8.1 compensation, 4.3 registers. BME280,
/// BST-BME280-DS002: 4.2.3 and 8.1 compensation, 5.4 registers, 9.1 times. BMP388, BST-BMP388-DS001, and BMP390,
/// BST-BMP390-DS002: 3.9.2 times, 4.3 registers, 9.1 to 9.3 compensation. BMP581, BST-BMP581-DS004: 2 times, 4.3 modes,
/// 4.5 data, 5.1 choice of the bus, 7 registers; Bosch's BMP5 SensorAPI, which has the BMP585, too. MS5611-01BA03, TE
/// data sheet of 2017: commands, conversion times, figures 2 and 3 compensation; checksum: AN520. Atmosphere: ICAO Doc
/// 7488, the same as ISO 2533 and US Standard Atmosphere 1976 up to 80 km.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "rtdata/data/config_item.hpp"
#include "rtdata/data/describe.hpp"
#include "rtdata/detail/chips/air_measurement.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/io/registers.hpp"
#include "rtdata/io/spi.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

/// Geopotential height in m at which the standard atmosphere has this pressure in Pa: 0 at 101325 Pa, to 80 km (below 0
/// Pa: NaN). Geometric heights are greater, by 35 m at 15 km. Layers: Doc 7488, table D; pressures at their bases
/// follow from them.
inline double pressure_altitude(double pressure) noexcept {
  struct Layer {
    double height, temperature, gradient;  // base of the layer: m, K; K/m
  };
  constexpr Layer layers[] = {{0, 288.15, -0.0065},    {11000, 216.65, 0}, {20000, 216.65, 0.001},
                              {32000, 228.65, 0.0028}, {47000, 270.65, 0}, {51000, 270.65, -0.0028},
                              {71000, 214.65, -0.002}};
  constexpr double gravity_by_gas_constant = 9.80665 / 287.05287;
  if (!(pressure > 0)) return std::numeric_limits<double>::quiet_NaN();
  double base_pressure = 101325;
  for (std::size_t i = 0;; ++i) {
    const Layer& layer = layers[i];
    const bool is_last = i + 1 == std::size(layers);
    const double thickness = is_last ? 0 : layers[i + 1].height - layer.height;
    const double top = layer.gradient == 0
                           ? base_pressure * std::exp(-gravity_by_gas_constant * thickness / layer.temperature)
                           : base_pressure * std::pow(1 + layer.gradient * thickness / layer.temperature,
                                                      -gravity_by_gas_constant / layer.gradient);
    if (is_last || pressure >= top) {
      if (layer.gradient == 0)
        return layer.height - std::log(pressure / base_pressure) * layer.temperature / gravity_by_gas_constant;
      return layer.height + layer.temperature / layer.gradient *
                                (std::pow(pressure / base_pressure, -layer.gradient / gravity_by_gas_constant) - 1);
    }
    base_pressure = top;
  }
}

struct BarometerReading {
  double pressure = 0;
  double temperature = 0;            ///< of the chip
  double altitude = 0;               ///< height above the level with `reference_pressure`
  std::optional<double> humidity{};  ///< of a BME280
  friend constexpr auto describe(type_tag<BarometerReading>) {
    return record("barometer", field("pressure", &BarometerReading::pressure, "Pa"),
                  field("temperature", &BarometerReading::temperature, "Cel"),
                  field("altitude", &BarometerReading::altitude, "m"),
                  field("humidity", &BarometerReading::humidity, "%"));
  }
};

enum class BarometerModel { bmp280, bme280, bmp388, bmp390, bmp581, bmp585, ms5611 };

class Barometer {
  /// Chips whose registers and compensation are alike.
  enum class Family { bmp2, bmp3, bmp5, ms5 };
  struct Model {
    KnownChip chip;
    Family family;
    bool has_humidity;
    unsigned least_oversampling, most_oversampling;  // and the powers of 2 between
    unsigned usual_pressure, usual_temperature;
  };
  static constexpr Model models[] = {
      {{"BMP280", "bmp280", {0x76, 0x77}, {{0xd0, 0x58}}}, Family::bmp2, false, 1, 16, 1, 1},
      {{"BME280", "bme280", {0x76, 0x77}, {{0xd0, 0x60}}}, Family::bmp2, true, 1, 16, 1, 1},
      {{"BMP388", "bmp388", {0x76, 0x77}, {{0x00, 0x50}}}, Family::bmp3, false, 1, 32, 1, 1},
      {{"BMP390", "bmp390", {0x76, 0x77}, {{0x00, 0x60}}}, Family::bmp3, false, 1, 32, 1, 1},
      {{"BMP581", "bmp581", {0x46, 0x47}, {{0x01, 0x50}}}, Family::bmp5, false, 1, 128, 1, 1},
      {{"BMP585", "bmp585", {0x46, 0x47}, {{0x01, 0x51}}}, Family::bmp5, false, 1, 128, 1, 1},
      {{"MS5611", "ms5611", {0x76, 0x77}}, Family::ms5, false, 256, 4096, 4096, 1024}};

 public:
  static constexpr std::string_view type = "barometer";
  static constexpr std::string_view aliases = "altimeter gy-68 gy-91";
  static constexpr std::string_view description =
      "pressure, temperature and altitude of a BMP280, BME280, BMP388, BMP390, BMP581, BMP585 or MS5611 on I2C or SPI";
  static constexpr std::string_view notes =
      R"(- Wires: 3.3 V, ground, SDA, SCL. The pin SDO (of an MS5611: CSB) chooses the address: 0x76 when it is low,
  0x77 when it is high (a BMP581 or BMP585: 0x46, 0x47; an MS5611: the other way round). Boards with a pin CS have it on
  3.3 V for I2C. On SPI: SDO, SDI (SDA), SCK (SCL), CS (of an MS5611 PS is low then); `chip_select` in place of
  `address`; to 10 MHz.
- Range: 300 to 1100 hPa (BMP390, BMP581, BMP585: 1250; MS5611: 10 to 1200), which is 9 km, with an MS5611 30 km. A
  chip also measures beyond it, with a larger error.
- `altitude` follows the ICAO standard atmosphere, in geopotential metres; weather moves it by 8 m a hPa. Set
  `reference_pressure` to today's pressure at sea level, or to the pressure at the ground level from which you count
  heights.
- Only a BME280 has `humidity`; for the others it is absent. A BMP388 and a BMP390, a BMP280 and a BME280 differ in
  identity; a wrong `model` is refused, and the error names the chip that it seems to be. For a BMP580 use the model
  `bmp581`: both have the same identity and registers.
- Oversampling averages: less noise, and a longer measurement, which must fit into the period of `rate`.
)";
  struct Config {
    BarometerModel model = BarometerModel::bmp280;
    std::optional<unsigned> pressure_oversampling{};     ///< unset: 1; of an MS5611 4096
    std::optional<unsigned> temperature_oversampling{};  ///< unset: 1; of an MS5611 1024
    std::optional<unsigned> humidity_oversampling{};     ///< of a BME280; unset: 1
    double reference_pressure = 101325;                  ///< Pa: where the altitude is 0
    std::optional<IdentityCode> identity{};              ///< of a clone
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(
          parameter("model", &Config::model, "which chip it is",
                    choices(value("bmp280", BarometerModel::bmp280), value("bme280", BarometerModel::bme280),
                            value("bmp388", BarometerModel::bmp388), value("bmp390", BarometerModel::bmp390),
                            value("bmp581", BarometerModel::bmp581), value("bmp585", BarometerModel::bmp585),
                            value("ms5611", BarometerModel::ms5611))),
          parameter("pressure_oversampling", &Config::pressure_oversampling,
                    "number of measurements that are averaged: 1, 2, 4, 8 or 16 (BMP388, BMP390: 32 too; BMP581, "
                    "BMP585: to 128); MS5611: 256, 512, 1024, 2048 or 4096; default: 1, MS5611 4096",
                    range(1, 4096)),
          parameter("temperature_oversampling", &Config::temperature_oversampling,
                    "like `pressure_oversampling`; default: 1, MS5611 1024", range(1, 4096)),
          parameter("humidity_oversampling", &Config::humidity_oversampling,
                    "number of measurements that are averaged: 1, 2, 4, 8 or 16; default: 1",
                    only_with("model", "bme280"), range(1, 16)),
          parameter("reference_pressure", &Config::reference_pressure,
                    "pressure at which `altitude` is 0: the pressure at sea level, or on the ground", unit("Pa"),
                    range(1000, 120000)),
          identity_parameter(&Config::identity));
    }
    friend void check_config(const Config& config, const ConfigItem& item, Problems& problems) {
      config.check(item, problems);
    }

   private:
    void check(const ConfigItem& item, Problems& problems) const {
      for (const Setting& setting : settings_of(*this)) {
        if (setting.mistake.empty()) continue;
        const ConfigItem* at = item.find(setting.key);
        problems.add((at != nullptr ? *at : item).problem("bad-value", setting.mistake));
      }
    }
  };
  using Value = BarometerReading;
  using Device = RegisterDevice;
  /// BMP388 and BMP390 send one extra byte before the data. An MS5611 has commands, which are the same on both buses.
  static RegisterAddressing addressing(const Config& config) {
    switch (models[static_cast<std::size_t>(config.model)].family) {
      case Family::bmp2:
      case Family::bmp5:
        return {};
      case Family::bmp3:
        return {.spi_dummy_bytes = 1};
      case Family::ms5:
        return {.spi_read_bit = 0};
    }
    return {};
  }
  static constexpr RegisterPlace place{0x76};
  static constexpr auto chips = chips_of(models);
  // A BMP280: its data sheet's example, with trimming parameters and codes of temperature and pressure.
  static constexpr ChipSample samples[] = {
      {.bytes = {{{"d0", "58"},
                  {"88", "70 6b 43 67 18 fc  7d 8e 43 d6 d0 0b 27 0b 8c 00 f9 ff 8c 3c f8 c6 70 17"},
                  {"f7", "65 5a c0 7e ed 00"}}},
       .values = {{{"pressure", 100653.27}, {"temperature", 25.08}}},
       .has_proof = true},
      {.members = R"("model": "bmp581")",
       .bytes = {{{"01", "50"}, {"1d", "00 80 f5 50 4b 62"}, {"27", "11 02"}}},
       .values = {{{"pressure", 100653.25}, {"temperature", -10.5}}},
       .has_proof = true}};

  /// SetupError (bad-argument): an oversampling that the chip does not have.
  explicit Barometer(const Config& config) : config_(config) {
    const std::array<Setting, 3> settings = settings_of(config);
    for (const Setting& setting : settings) {
      if (!setting.mistake.empty())
        throw SetupError(
            {Errc::bad_argument, "cannot use this oversampling", std::string(setting.key), setting.mistake, ""});
    }
    pressure_ = settings[0].count;
    temperature_ = settings[1].count;
    humidity_ = settings[2].count;
  }

  /// The start-up time, for a BMP581 with the time until standby; for an MS5611 the temperature measurement, which
  /// follows the pressure.
  static Duration bus_time(const Config& config) {
    constexpr Duration start_up = std::chrono::milliseconds{3};
    if (models[static_cast<std::size_t>(config.model)].family == Family::bmp5) return 2 * start_up;
    const unsigned count = config.temperature_oversampling.value_or(1024);
    return config.model == BarometerModel::ms5611 && std::has_single_bit(count) && count >= 256 && count <= 4096
               ? std::max(start_up, ms5611_time(count))
               : start_up;
  }

  /// Resets it, and reads identity and trimming parameters.
  Result<void> open(RegisterDevice& chip) {
    switch (model().family) {
      case Family::bmp2:
        return open_bosch(chip, 0xe0, bmp2_);
      case Family::bmp3:
        return open_bosch(chip, 0x7e, bmp3_);
      case Family::bmp5:
        return open_bmp5(chip);
      case Family::ms5:
        return open_ms5611(chip);
    }
    return {};
  }

  Result<void> start(RegisterDevice& chip) {
    switch (model().family) {
      case Family::bmp2:
        // A change of the humidity setting takes effect when the other register is written (BME280, 5.4.3).
        if (model().has_humidity) {
          if (auto done = chip.write_register(bmp2_humidity_register, humidity_bits()); !done) return done;
        }
        return chip.write_register(bmp2_control_register, static_cast<std::uint8_t>(bmp2_control() | forced));
      case Family::bmp3:
        if (auto done = chip.write_register(bmp3_oversampling_register, bmp3_oversampling()); !done) return done;
        return chip.write_register(bmp3_power_register, bmp3_enabled | bmp3_forced);
      case Family::bmp5:
        if (auto done = chip.write_register(bmp5_interrupt_register, bmp5_data_ready); !done) return done;
        if (auto done = chip.write_register(bmp5_oversampling_register, bmp5_oversampling()); !done) return done;
        return chip.write_register(bmp5_power_register, bmp5_standby | bmp5_forced);
      case Family::ms5:
        return chip.command(static_cast<std::uint8_t>(0x40 | ms5611_index(pressure_) << 1));
    }
    return {};
  }

  static Duration reading_time(const Config& config) { return Barometer(config).conversion_time(); }
  Duration conversion_time() const noexcept {
    const auto microseconds = [](unsigned count) { return Duration{std::chrono::microseconds{count}}; };
    switch (model().family) {
      case Family::bmp2:  // at most
        return microseconds(1250 + 2300 * temperature_ + 2300 * pressure_ + 575 +
                            (model().has_humidity ? 2300 * humidity_ + 575 : 0));
      case Family::bmp3:  // typical time plus a fifth
        return microseconds((234 + 392 + 2020 * pressure_ + 163 + 2020 * temperature_) * 6 / 5);
      case Family::bmp5: {  // typical times plus a twentieth, and at most 2.5 ms until it has begun
        constexpr unsigned pressure[] = {1000, 1700, 2900, 5400, 10400, 20400, 40400, 80400};
        constexpr unsigned temperature[] = {1000, 1100, 1500, 2100, 3300, 5800, 10800, 20800};
        return microseconds((pressure[log_of(pressure_)] + temperature[log_of(temperature_)]) * 21 / 20 + 2500);
      }
      case Family::ms5:
        return ms5611_time(pressure_);
    }
    return {};
  }

  Reading<BarometerReading> read(RegisterDevice& chip) {
    switch (model().family) {
      case Family::bmp2:
        return read_bmp2(chip);
      case Family::bmp3:
        return read_bmp3(chip);
      case Family::bmp5:
        return read_bmp5(chip);
      case Family::ms5:
        return read_ms5611(chip);
    }
    return NothingNew{};
  }

  /// The measurement with its altitude. Errors: out-of-range (none of these chips measures such a pressure).
  static Result<BarometerReading> reading(const AirMeasurement& air, double reference_pressure) {
    constexpr double most = 200'000;
    if (!(air.pressure > 0 && air.pressure <= most))
      return Error{Errc::out_of_range, what, "", std::to_string(air.pressure) + " Pa is outside the range of the chip",
                   "check its wires and its supply"};
    return BarometerReading{air.pressure, air.temperature,
                            pressure_altitude(air.pressure) - pressure_altitude(reference_pressure), air.humidity};
  }

 private:
  static constexpr const char* what = "cannot read the barometer";
  static constexpr std::string_view otherwise = "check which chip is at this address, and `model`";
  static constexpr std::uint8_t reset_command = 0xb6;
  static constexpr std::uint8_t bmp2_humidity_register = 0xf2, bmp2_control_register = 0xf4, forced = 1;
  static constexpr std::uint8_t bmp3_power_register = 0x1b, bmp3_oversampling_register = 0x1c;
  static constexpr std::uint8_t bmp3_enabled = 0x03, bmp3_forced = 0x10;
  static constexpr std::uint8_t bmp5_interrupt_register = 0x15, bmp5_data_ready = 0x01, bmp5_status_register = 0x27;
  static constexpr std::uint8_t bmp5_oversampling_register = 0x36, bmp5_power_register = 0x37;
  static constexpr std::uint8_t bmp5_standby = 0xf0, bmp5_forced = 0x02;  // at rest it is not in deep standby

  struct Setting {
    std::string_view key;
    unsigned count;
    std::string mistake;
  };
  static std::array<Setting, 3> settings_of(const Config& config) {
    const Model& model = models[static_cast<std::size_t>(config.model)];
    std::array<Setting, 3> all{
        {{"pressure_oversampling", config.pressure_oversampling.value_or(model.usual_pressure), {}},
         {"temperature_oversampling", config.temperature_oversampling.value_or(model.usual_temperature), {}},
         {"humidity_oversampling", config.humidity_oversampling.value_or(1), {}}}};
    std::string list;
    for (unsigned count = model.least_oversampling; count <= model.most_oversampling; count *= 2)
      list += (list.empty() ? "" : ", ") + std::to_string(count);
    for (std::size_t i = 0; i < all.size(); ++i) {
      const unsigned count = all[i].count;
      const bool is_of_humidity = i == 2;
      if (is_of_humidity && !model.has_humidity) {
        if (config.humidity_oversampling)
          all[i].mistake = "the " + std::string(model.chip.name) +
                           " measures no humidity; remove this, or set another `model`";
        continue;
      }
      if (!std::has_single_bit(count) || count < model.least_oversampling || count > model.most_oversampling)
        all[i].mistake = std::to_string(count) + " is not one of " + list + ", which the " +
                         std::string(model.chip.name) + " has";
    }
    return all;
  }
  const Model& model() const noexcept { return models[static_cast<std::size_t>(config_.model)]; }

  /// Names the chip that answered, for an error message; empty if it is not a chip that is known here.
  static std::string other_chip(RegisterDevice& chip) {
    if (std::string other = seems_to_be(chip, models); !other.empty()) return other;
    const Result<std::uint8_t> found = chip.read_register(0xd0);
    if (found && *found == 0x55) return "it seems to be a BMP180, which has no driver here";
    if (found && *found == 0x61) return "it seems to be a BME680 or BME688: use the type `bme680`";
    return {};
  }

  template <class Trimming>
  Result<void> open_bosch(RegisterDevice& chip, std::uint8_t reset_register, Trimming& trimming) {
    if (auto same = check_identity(chip, model().chip, config_.identity, &other_chip, otherwise); !same) return same;
    const std::string name(model().chip.name);
    if (auto done = chip.write_register(reset_register, reset_command); !done) return done;
    chip.wait(std::chrono::milliseconds{3});  // start-up: 2 ms
    std::array<std::uint8_t, std::is_same_v<Trimming, Bmp280Trimming> ? 24 : 21> bytes{};
    if (auto done = chip.read_registers(Trimming::first_register, bytes); !done) return done;
    trimming = Trimming::decode(bytes);
    const bool are_alike = std::all_of(bytes.begin(), bytes.end(), [&](std::uint8_t byte) { return byte == bytes[0]; });
    if (are_alike || !trimming.is_usable()) {
      return chip.error(Errc::bad_data, "cannot use the " + name,
                        are_alike ? "its trimming parameters are all " + to_string(I2cAddress(bytes[0]))
                                  : "some of its trimming parameters are 0",
                        "the chip is damaged, or its wires are bad");
    }
    if constexpr (std::is_same_v<Trimming, Bmp280Trimming>) {
      if (model().has_humidity) {
        const Result<std::uint8_t> first = chip.read_register(0xa1);
        if (!first) return first.error();
        std::array<std::uint8_t, 7> rest{};
        if (auto done = chip.read_registers(0xe1, rest); !done) return done;
        trimming.decode_humidity(*first, rest);
        if (trimming.h2 == 0 || trimming.h2 == -1)
          return chip.error(Errc::bad_data, "cannot use the " + name, "it has no trimming parameters for humidity",
                            "the chip is damaged");
      }
    }
    return {};
  }

  Result<void> open_bmp5(RegisterDevice& chip) {
    const std::uint8_t identity_register = model().chip.identity->number;
    const auto choose_spi = [&] {  // by the first access after power-on or reset, whose answer does not count
      if (chip.is_on_spi()) static_cast<void>(chip.read_register(identity_register));
    };
    choose_spi();
    if (auto same = check_identity(chip, model().chip, config_.identity, &other_chip, otherwise); !same) return same;
    // By the data sheet it does not acknowledge the command on I2C; by its status it says that it was reset.
    static_cast<void>(chip.write_register(0x7e, reset_command));
    chip.wait(std::chrono::milliseconds{3});  // 2 ms
    choose_spi();
    constexpr std::uint8_t was_reset = 0x10, memory_is_ready = 0x02, memory_error = 0x04;
    std::array<std::uint8_t, 2> status{};  // of interrupts, and of the chip
    if (auto done = chip.read_registers(bmp5_status_register, status); !done) return done;
    const bool is_reset = (status[0] & was_reset) != 0;
    if (!is_reset || (status[1] & (memory_is_ready | memory_error)) != memory_is_ready)
      return chip.error(Errc::bad_data, "cannot use the " + std::string(model().chip.name),
                        is_reset ? "its memory has an error" : "it does not reset",
                        "the chip is damaged, or its wires are bad");
    if (auto done = chip.write_register(bmp5_power_register, bmp5_standby); !done) return done;
    chip.wait(std::chrono::milliseconds{3});  // 2.5 ms
    return {};
  }

  /// 1 for one measurement, 2 for two, 3 for four ...
  static std::uint8_t one_and_log(unsigned count) { return static_cast<std::uint8_t>(std::bit_width(count)); }
  static std::uint8_t log_of(unsigned count) { return static_cast<std::uint8_t>(std::bit_width(count) - 1); }
  std::uint8_t humidity_bits() const { return one_and_log(humidity_); }
  std::uint8_t bmp2_control() const {
    return static_cast<std::uint8_t>(one_and_log(temperature_) << 5 | one_and_log(pressure_) << 2);
  }
  std::uint8_t bmp3_oversampling() const {
    return static_cast<std::uint8_t>(log_of(temperature_) << 3 | log_of(pressure_));
  }
  std::uint8_t bmp5_oversampling() const {
    constexpr std::uint8_t has_pressure = 0x40;
    return static_cast<std::uint8_t>(has_pressure | log_of(pressure_) << 3 | log_of(temperature_));
  }

  static Unreadable lost_settings(RegisterDevice& chip) {
    return Unreadable{chip.error(Errc::bad_data, what, "it has lost its settings since the start", "check its supply")};
  }
  static Error measures_still(RegisterDevice& chip) {
    return chip.error(Errc::timed_out, what, "the measurement takes too long", "");
  }
  Reading<BarometerReading> reading_of(RegisterDevice& chip, const Result<AirMeasurement>& air) const {
    auto made = air ? reading(*air, config_.reference_pressure) : Result<BarometerReading>(air.error());
    if (!made) return Unreadable{at_place(chip, made.error())};
    return *made;
  }

  Reading<BarometerReading> read_bmp2(RegisterDevice& chip) {
    // Humidity, status, control, configuration, an unused register, and the data.
    constexpr std::size_t data = 0xf7 - bmp2_humidity_register;
    constexpr std::uint8_t measuring = 0x08, mode = 0x03;
    std::array<std::uint8_t, data + 8> bytes{};
    const auto used = std::span(bytes).first(data + (model().has_humidity ? 8 : 6));
    if (auto done = chip.read_registers(bmp2_humidity_register, used); !done) return std::move(done).error();
    if ((bytes[1] & measuring) != 0) return measures_still(chip);
    if ((bytes[2] & ~mode) != bmp2_control()) return lost_settings(chip);  // it returns to sleep by itself
    if (model().has_humidity && bytes[0] != humidity_bits()) return lost_settings(chip);
    return reading_of(chip, bmp2_.measurement(used.subspan(data)));
  }

  Reading<BarometerReading> read_bmp3(RegisterDevice& chip) {
    std::array<std::uint8_t, 2> settings{};
    if (auto done = chip.read_registers(bmp3_power_register, settings); !done) return std::move(done).error();
    if ((settings[0] & bmp3_enabled) != bmp3_enabled || settings[1] != bmp3_oversampling()) return lost_settings(chip);
    constexpr std::uint8_t both_ready = 0x60;
    std::array<std::uint8_t, 7> bytes{};  // status and data
    if (auto done = chip.read_registers(0x03, bytes); !done) return std::move(done).error();
    if ((bytes[0] & both_ready) != both_ready) return measures_still(chip);
    return reading_of(chip, bmp3_.measurement(std::span(bytes).subspan(1)));
  }

  Reading<BarometerReading> read_bmp5(RegisterDevice& chip) {
    std::array<std::uint8_t, 2> settings{};
    if (auto done = chip.read_registers(bmp5_oversampling_register, settings); !done) return std::move(done).error();
    constexpr std::uint8_t mode = 0x03;
    if (settings[0] != bmp5_oversampling() || (settings[1] & ~mode) != bmp5_standby) return lost_settings(chip);
    const Result<std::uint8_t> status = chip.read_register(bmp5_status_register);  // which reading sets back
    if (!status) return status.error();
    if ((*status & bmp5_data_ready) == 0) return measures_still(chip);
    std::array<std::uint8_t, 6> bytes{};
    if (auto done = chip.read_registers(0x1d, bytes); !done) return std::move(done).error();
    return reading_of(chip, bmp581_measurement(bytes));
  }

  /// 0 for 256, 1 for 512 ...
  static unsigned ms5611_index(unsigned oversampling) {
    return static_cast<unsigned>(std::bit_width(oversampling)) - 9;
  }
  /// At most.
  static Duration ms5611_time(unsigned oversampling) {
    constexpr int microseconds[] = {600, 1170, 2280, 4540, 9040};
    return std::chrono::microseconds{microseconds[ms5611_index(oversampling)]};
  }
  static Result<std::uint32_t> ms5611_result(RegisterDevice& chip) {
    std::array<std::uint8_t, 3> bytes{};
    if (auto done = chip.read_registers(0x00, bytes); !done) return std::move(done).error();
    return static_cast<std::uint32_t>(bytes[0] << 16 | bytes[1] << 8 | bytes[2]);
  }

  Result<void> open_ms5611(RegisterDevice& chip) {
    if (auto done = chip.command(0x1e); !done) return done;  // reset
    chip.wait(std::chrono::milliseconds{3});                 // 2.8 ms
    for (std::size_t i = 0; i < prom_.words.size(); ++i) {
      const Result<std::uint16_t> word = chip.read_word(static_cast<std::uint8_t>(0xa0 + 2 * i));
      if (!word) return word.error();
      prom_.words[i] = *word;
    }
    if (prom_.is_usable()) return {};
    const bool are_alike = std::all_of(prom_.words.begin(), prom_.words.end(),
                                       [&](std::uint16_t word) { return word == prom_.words[0]; });
    const std::string other = other_chip(chip);
    return chip.error(Errc::bad_data, "cannot use the chip as an MS5611",
                      are_alike ? "all words of its PROM are the same" : "the checksum of its PROM is wrong",
                      other.empty() ? std::string(otherwise) : other);
  }

  Reading<BarometerReading> read_ms5611(RegisterDevice& chip) {
    const Result<std::uint32_t> pressure = ms5611_result(chip);
    if (!pressure) return pressure.error();
    if (auto done = chip.command(static_cast<std::uint8_t>(0x50 | ms5611_index(temperature_) << 1)); !done)
      return std::move(done).error();
    chip.wait(ms5611_time(temperature_));
    const Result<std::uint32_t> temperature = ms5611_result(chip);
    if (!temperature) return temperature.error();
    return reading_of(chip, prom_.measurement(*pressure, *temperature));
  }

  Config config_;
  unsigned pressure_ = 1, temperature_ = 1, humidity_ = 1;  // oversampling
  Bmp280Trimming bmp2_;
  Bmp388Trimming bmp3_;
  Ms5611Prom prom_;
};

}  // namespace rtdata
