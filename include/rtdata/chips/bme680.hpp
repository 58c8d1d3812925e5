/// Bme680: temperature, pressure, humidity and the resistance of a gas sensor by a BME680 or BME688 on I2C.
///
///     rtdata::DriverSensor<rtdata::Bme680> air(loop, {.name = "air", .rate = 0.33_Hz}, bus, {.address = 0x76},
///                                              {.heater_temperature = 320, .heater_duration = 150ms});
///
/// Each tick starts one measurement and reads it when the chip has had its time: about 20 ms plus `heater_duration`;
/// the bus is free for others meanwhile, and the event has the time of the start. The gas sensor is heated to
/// `heater_temperature` for this time; its resistance falls when there are more volatile organic compounds. Bosch's air
/// quality index is not computed. While the heater has not reached its temperature the event has no `gas_resistance`,
/// and the reading is counted as unreadable.
///
/// The driver refuses a chip with another identity, and trimming parameters that are all zeros or all ones; it detects
/// by itself whether it is a BME680 or a BME688. A reading is unreadable when the chip has lost its settings, or has
/// skipped a measurement; the next tick sets it up again. Ranges: -40 to 85 degrees, 300 to 1100 hPa, 0 to 100 %.
///
/// Sources: Bosch BME680, BST-BME680-DS001: 3.3.1 to 3.3.3 compensation, 3.3.5 heater, 3.4.1 gas, 5.2, 5.3 registers;
/// BME688, BST-BME688-DS000: 3.6.1 to 3.6.5 and 3.7.1, the same with another formula of the gas, 5.2 and 5.3 registers.
/// Times: Bosch's BME68x SensorAPI 4.4.8, "get_meas_dur".
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "rtdata/data/describe.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct Bme680Reading {
  double temperature = 0;  ///< of the chip
  double pressure = 0;
  double humidity = 0;                     ///< relative
  std::optional<double> gas_resistance{};  ///< empty: not measured, or the heater had not reached its temperature
  friend constexpr auto describe(type_tag<Bme680Reading>) {
    return record("bme680", field("temperature", &Bme680Reading::temperature, "Cel"),
                  field("pressure", &Bme680Reading::pressure, "Pa"), field("humidity", &Bme680Reading::humidity, "%"),
                  field("gas_resistance", &Bme680Reading::gas_resistance, "Ohm"));
  }
};

/// Trimming parameters, and what follows from them.
struct Bme680Trimming {
  std::uint16_t t1 = 0;
  std::int16_t t2 = 0;
  std::int8_t t3 = 0;
  std::uint16_t p1 = 0;
  std::int16_t p2 = 0, p4 = 0, p5 = 0, p8 = 0, p9 = 0;
  std::int8_t p3 = 0, p6 = 0, p7 = 0;
  std::uint8_t p10 = 0;
  std::uint16_t h1 = 0, h2 = 0;
  std::int8_t h3 = 0, h4 = 0, h5 = 0, h7 = 0;
  std::uint8_t h6 = 0;
  std::int8_t heater1 = 0, heater3 = 0, heater_value = 0;
  std::int16_t heater2 = 0;
  std::uint8_t heater_range = 0;
  int switching_error = 0;  // of the ranges of a BME680
  bool is_bme688 = false;

  /// From registers 0x8a to 0xa0, 0xe1 to 0xee, and 0x00 to 0x04.
  static Bme680Trimming decode(std::span<const std::uint8_t, 23> first, std::span<const std::uint8_t, 14> second,
                               std::span<const std::uint8_t, 5> third) noexcept {
    const auto word = [](auto bytes, std::size_t at) {
      return static_cast<std::uint16_t>(bytes[at] | bytes[at + 1] << 8);
    };
    const auto signed_word = [&](auto bytes, std::size_t at) { return static_cast<std::int16_t>(word(bytes, at)); };
    const auto small = [](std::uint8_t byte) { return static_cast<std::int8_t>(byte); };
    Bme680Trimming all;
    all.t1 = word(second, 8);
    all.t2 = signed_word(first, 0);
    all.t3 = small(first[2]);
    all.p1 = word(first, 4);
    all.p2 = signed_word(first, 6);
    all.p3 = small(first[8]);
    all.p4 = signed_word(first, 10);
    all.p5 = signed_word(first, 12);
    all.p7 = small(first[14]);
    all.p6 = small(first[15]);
    all.p8 = signed_word(first, 18);
    all.p9 = signed_word(first, 20);
    all.p10 = first[22];
    // Two values of 12 bits, which share one register for 4 bits each.
    all.h1 = static_cast<std::uint16_t>(second[2] << 4 | (second[1] & 15));
    all.h2 = static_cast<std::uint16_t>(second[0] << 4 | second[1] >> 4);
    all.h3 = small(second[3]);
    all.h4 = small(second[4]);
    all.h5 = small(second[5]);
    all.h6 = second[6];
    all.h7 = small(second[7]);
    all.heater2 = signed_word(second, 10);
    all.heater1 = small(second[12]);
    all.heater3 = small(second[13]);
    all.heater_value = small(third[0]);
    all.heater_range = static_cast<std::uint8_t>(third[2] >> 4 & 3);
    all.switching_error = small(third[4]) >> 4;
    return all;
  }
  bool is_usable() const noexcept { return t1 != 0 && t2 != 0 && p1 != 0; }

  /// `bytes`: registers 0x1d to 0x2d. `has_gas`: the gas was measured. Errors: bad-data (a measurement was skipped),
  /// out-of-range (such a pressure is not measured).
  Result<Bme680Reading> measurement(std::span<const std::uint8_t, 17> bytes, bool has_gas) const {
    const auto refused = [](Errc code, std::string why) {
      return Error{code, "cannot read the BME680", "", std::move(why),
                   "check its supply; if this repeats, the chip is damaged"};
    };
    const auto twenty_bits = [&](std::size_t at) {
      return static_cast<std::uint32_t>(bytes[at]) << 12 | static_cast<std::uint32_t>(bytes[at + 1]) << 4 |
             static_cast<std::uint32_t>(bytes[at + 2]) >> 4;
    };
    constexpr std::uint32_t skipped = 0x80000, skipped_humidity = 0x8000;
    const std::uint32_t pressure_code = twenty_bits(2), temperature_code = twenty_bits(5);
    const auto humidity_code = static_cast<std::uint32_t>(bytes[8] << 8 | bytes[9]);
    if (pressure_code == skipped || temperature_code == skipped || humidity_code == skipped_humidity)
      return refused(Errc::bad_data, "a measurement was skipped");

    Bme680Reading reading;
    const double off = temperature_code / 131072.0 - t1 / 8192.0;
    const double fine = 8 * off * t2 + off * off * t3 * 16;
    reading.temperature = fine / 5120;

    const double half = fine / 2 - 64000;
    const double curved = (half * half * p6 / 131072 + half * p5 * 2) / 4 + p4 * 65536.0;
    const double slope = (1 + (p3 * half * half / 16384 + p2 * half) / 524288 / 32768) * p1;
    if (slope == 0) return refused(Errc::bad_data, "its trimming parameters give no pressure");
    const double raw = (1048576.0 - pressure_code - curved / 4096) * 6250 / slope;
    const double cube = raw / 256 * (raw / 256) * (raw / 256);
    reading.pressure = raw + (p9 * raw * raw / 2147483648.0 + raw * p8 / 32768 + cube * p10 / 131072 + p7 * 128.0) / 16;
    constexpr double most = 200'000;
    if (!(reading.pressure > 0 && reading.pressure <= most))
      return refused(Errc::out_of_range, std::to_string(reading.pressure) + " Pa is outside the range of the chip");

    const double t = reading.temperature;
    const double wet = (humidity_code - (h1 * 16.0 + h3 / 2.0 * t)) * (h2 / 262144.0) *
                       (1 + h4 / 16384.0 * t + h5 / 1048576.0 * t * t);
    reading.humidity = std::clamp(wet + (h6 / 16384.0 + h7 / 2097152.0 * t) * wet * wet, 0.0, 100.0);

    const std::size_t at = is_bme688 ? 15 : 13;
    constexpr std::uint8_t valid_and_stable = 0x30;
    if (has_gas && (bytes[at + 1] & valid_and_stable) == valid_and_stable)
      reading.gas_resistance = gas(static_cast<unsigned>(bytes[at] << 2 | bytes[at + 1] >> 6), bytes[at + 1] & 15u);
    return reading;
  }

  /// Ohm, of a code of 10 bits in one of 16 ranges.
  double gas(unsigned code, unsigned range) const noexcept {
    const double from_middle = static_cast<double>(code) - 512;
    if (is_bme688) return 1e6 * (262144u >> range) / (4096 + 3 * from_middle);
    constexpr std::array<double, 16> first{0, 0, 0, 0, 0, -1, 0, -0.8, 0, 0, -0.2, -0.5, 0, -1, 0, 0};  // %
    constexpr std::array<double, 16> second{0, 0, 0, 0, 0.1, 0.7, 0, -0.8, -0.1, 0, 0, 0, 0, 0, 0, 0};  // %
    const double scale = (1340.0 + 5 * switching_error) * (1 + first[range] / 100);
    return 1 / ((1 + second[range] / 100) * 0.125e-6 * (1u << range) * (from_middle / scale + 1));
  }

  /// The heater's code for a temperature, where the air has another: degrees.
  std::uint8_t heater_code(double temperature, double air) const noexcept {
    const double at_zero = heater1 / 16.0 + 49;
    const double slope = heater2 / 32768.0 * 0.0005 + 0.00235;
    const double resistance = at_zero * (1 + slope * temperature) + heater3 / 1024.0 * air;
    const double code = 3.4 * (resistance * (4 / (4.0 + heater_range)) / (1 + heater_value * 0.002) - 25);
    return static_cast<std::uint8_t>(std::clamp(code, 0.0, 255.0));
  }
};

class Bme680 {
 public:
  static constexpr std::string_view type = "bme680";
  static constexpr std::string_view aliases = "bme688 voc air-quality";
  static constexpr std::string_view
      description = "temperature, pressure, humidity and gas resistance of a BME680 or BME688 on I2C";
  static constexpr std::string_view notes = R"(
- Wires: 3.3 V, ground, SDA, SCL. The pin SDO chooses the address: 0x76 when it is low, 0x77 when it is high.
- `gas_resistance` falls when there are more volatile organic compounds; it also depends on humidity. Bosch's air
  quality index is not computed.
- The heater is on for `heater_duration` in each reading, which must fit into the period of `rate`, and warms the chip:
  `"rate": "0.33 Hz"` is usual. With `"heater_duration": "0 s"` gas is not measured.
- A new gas sensor needs two days to settle, and half an hour after each start; the chip does not mark these values.
  While the heater has not reached its temperature, `gas_resistance` is absent, and the reading is counted as unreadable.
- The driver detects whether it is a BME680 or a BME688.
)";
  struct Config {
    double heater_temperature = 320;                            ///< degrees Celsius
    Duration heater_duration = std::chrono::milliseconds{150};  ///< 0: no gas is measured
    unsigned temperature_oversampling = 2, pressure_oversampling = 4, humidity_oversampling = 1;
    std::optional<IdentityCode> identity{};  ///< of a clone
    friend constexpr auto parameters(type_tag<Config>) {
      using namespace std::chrono_literals;
      return parameter_list(
          parameter("heater_temperature", &Config::heater_temperature,
                    "temperature of the gas sensor when it is measured", unit("Cel"), range(200, 400)),
          parameter("heater_duration", &Config::heater_duration,
                    "how long the gas sensor is heated before it is measured; 0 s: gas is not measured",
                    range(Duration{0}, Duration{4032ms})),
          parameter("temperature_oversampling", &Config::temperature_oversampling,
                    "number of measurements that are averaged: 1, 2, 4, 8 or 16", range(1, 16)),
          parameter("pressure_oversampling", &Config::pressure_oversampling,
                    "number of measurements that are averaged: 1, 2, 4, 8 or 16", range(1, 16)),
          parameter("humidity_oversampling", &Config::humidity_oversampling,
                    "number of measurements that are averaged: 1, 2, 4, 8 or 16", range(1, 16)),
          identity_parameter(&Config::identity));
    }
  };
  using Value = Bme680Reading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x76};
  static constexpr KnownChip chips[] = {
      {.name = "BME680, BME688", .addresses = {0x76, 0x77}, .identity = {{0xd0, 0x61}}}};
  // A BME680 with trimming parameters as chips have them; the heater is stable.
  static constexpr ChipSample samples[] = {
      {.bytes = {{{"d0", "61"},
                  {"f0", "00"},
                  {"8a", "3d 67 03 00 b3 8e c0 d6 58 00 e4 1c 9c ff 21 1e 00 00 02 fd 5e f3 1e"},
                  {"e1", "3f 4c 2e 00 2d 14 78 9c 94 65 1f dc ea 12"},
                  {"00", "2c 00 16 00 13"},
                  {"1d", "80 00 4b 1d 40 75 c8 40 4d 2c 00 00 00 7f b4 00 00"}}},
       .values = {{{"temperature", 20.91345},
                   {"pressure", 105873.907},
                   {"humidity", 38.53947},
                   {"gas_resistance", 500244.36}}},
       .has_proof = true}};

  static Result<void> check(const Config& config) {
    const auto refused = [](const char* where, std::string why) {
      return Error{Errc::bad_argument, "cannot use these settings of the BME680", where, std::move(why), ""};
    };
    if (!(config.heater_temperature >= 200 && config.heater_temperature <= 400))
      return refused("heater_temperature", "it is not in the range 200 to 400 degrees");
    if (config.heater_duration < Duration{0} || config.heater_duration > longest_heating)
      return refused("heater_duration", "it is not in the range 0 to 4.032 s");
    const std::pair<const char*, unsigned> counts[] = {{"temperature_oversampling", config.temperature_oversampling},
                                                       {"pressure_oversampling", config.pressure_oversampling},
                                                       {"humidity_oversampling", config.humidity_oversampling}};
    for (const auto& [where, count] : counts)
      if (!std::has_single_bit(count) || count > 16)
        return refused(where, std::to_string(count) + " is not one of 1, 2, 4, 8, 16");
    return {};
  }
  explicit Bme680(const Config& config) : config_(config) {}
  static Duration bus_time(const Config&) { return start_up; }

  /// Resets it, and reads identity and trimming parameters.
  Result<void> open(I2cDevice& chip) {
    if (auto same = check_identity(chip, chips[0], config_.identity, {},
                                   "check which chip is at this address (others have the type `barometer`)");
        !same)
      return same;
    constexpr std::uint8_t reset_register = 0xe0, reset_command = 0xb6, variant_register = 0xf0;
    if (auto done = chip.write_register(reset_register, reset_command); !done) return done;
    chip.wait(start_up);
    std::array<std::uint8_t, 23> first{};
    std::array<std::uint8_t, 14> second{};
    std::array<std::uint8_t, 5> third{};
    if (auto done = chip.read_registers(0x8a, first); !done) return done;
    if (auto done = chip.read_registers(0xe1, second); !done) return done;
    if (auto done = chip.read_registers(0x00, third); !done) return done;
    trimming_ = Bme680Trimming::decode(first, second, third);
    const bool are_alike = std::all_of(first.begin(), first.end(), [&](std::uint8_t byte) { return byte == first[0]; });
    if (are_alike || !trimming_.is_usable())
      return chip.error(Errc::bad_data, "cannot use the BME680",
                        are_alike ? "its trimming parameters are all " + to_string(I2cAddress(first[0]))
                                  : "some of its trimming parameters are 0",
                        "the chip is damaged, or its wires are bad");
    const Result<std::uint8_t> variant = chip.read_register(variant_register);
    if (!variant) return variant.error();
    constexpr std::uint8_t of_bme680 = 0, of_bme688 = 1;
    if (*variant != of_bme680 && *variant != of_bme688)
      return chip.error(Errc::bad_data, "cannot use the chip as a BME680 or BME688",
                        "its variant is " + to_string(I2cAddress(*variant)) + ", but these chips have 0x00 or 0x01",
                        "check which chip is at this address");
    trimming_.is_bme688 = *variant == of_bme688;
    return {};
  }

  Result<void> start(I2cDevice& chip) {
    if (has_gas()) {
      const std::uint8_t heater = trimming_.heater_code(config_.heater_temperature, air_);
      if (auto done = chip.write_register(heater_register, heater); !done) return done;
      if (auto done = chip.write_register(wait_register, wait_code(config_.heater_duration)); !done) return done;
    }
    if (auto done = chip.write_register(gas_register, gas_bits()); !done) return done;
    if (auto done = chip.write_register(humidity_register, humidity_bits()); !done) return done;
    return chip.write_register(control_register, static_cast<std::uint8_t>(control_bits() | forced));
  }

  static Duration reading_time(const Config& config) { return Bme680(config).conversion_time(); }
  Duration conversion_time() const noexcept {
    const unsigned cycles = config_.temperature_oversampling + config_.pressure_oversampling +
                            config_.humidity_oversampling;
    return std::chrono::microseconds{1963 * cycles + 477 * 4 + 477 * 5 + 1000} + config_.heater_duration;
  }

  Result<void> read(I2cDevice& chip, Samples<Bme680Reading>& out) {
    std::array<std::uint8_t, 4> settings{};  // gas, humidity, one of SPI, temperature and pressure
    if (auto done = chip.read_registers(gas_register, settings); !done) return done;
    constexpr std::uint8_t mode = 0x03;  // it returns to sleep by itself
    if (settings[0] != gas_bits() || settings[1] != humidity_bits() || (settings[3] & ~mode) != control_bits()) {
      out.unreadable(chip.error(Errc::bad_data, what, "it has lost its settings since the start", "check its supply"));
      return {};
    }
    std::array<std::uint8_t, 17> bytes{};
    if (auto done = chip.read_registers(0x1d, bytes); !done) return done;
    constexpr std::uint8_t new_data = 0x80;
    if ((bytes[0] & new_data) == 0) return chip.error(Errc::timed_out, what, "the measurement takes too long");
    const auto reading = trimming_.measurement(bytes, has_gas());
    if (!reading) {
      out.unreadable(at_place(chip, reading.error()));
      return {};
    }
    air_ = std::clamp(reading->temperature, -40.0, 85.0);
    out.add(*reading);
    if (has_gas() && !reading->gas_resistance)
      out.unreadable(chip.error(Errc::bad_data, what, "the gas sensor's heater has not reached its temperature",
                                "set a longer `heater_duration`"));
    return {};
  }

  /// 6 bits of ms, times 1, 4, 16 or 64.
  static std::uint8_t wait_code(Duration time) noexcept {
    auto number = static_cast<unsigned>(
        std::chrono::duration_cast<std::chrono::milliseconds>(std::clamp(time, Duration{0}, longest_heating)).count());
    unsigned factor = 0;
    for (; number > 63; number /= 4) ++factor;
    return static_cast<std::uint8_t>(factor << 6 | number);
  }

 private:
  bool has_gas() const noexcept { return config_.heater_duration > Duration{0}; }
  std::uint8_t gas_bits() const noexcept {
    constexpr std::uint8_t of_bme680 = 0x10, of_bme688 = 0x20;
    return !has_gas() ? 0 : trimming_.is_bme688 ? of_bme688 : of_bme680;
  }
  /// 1 for one measurement, 2 for two, 3 for four ...
  static std::uint8_t one_and_log(unsigned count) noexcept { return static_cast<std::uint8_t>(std::bit_width(count)); }
  std::uint8_t humidity_bits() const noexcept { return one_and_log(config_.humidity_oversampling); }
  std::uint8_t control_bits() const noexcept {
    return static_cast<std::uint8_t>(one_and_log(config_.temperature_oversampling) << 5 |
                                     one_and_log(config_.pressure_oversampling) << 2);
  }

  static constexpr std::uint8_t heater_register = 0x5a, wait_register = 0x64, gas_register = 0x71;
  static constexpr std::uint8_t humidity_register = 0x72, control_register = 0x74, forced = 1;
  static constexpr Duration start_up = std::chrono::milliseconds{10};
  static constexpr Duration longest_heating = std::chrono::milliseconds{4032};
  static constexpr const char* what = "cannot read the BME680";

  Config config_;
  Bme680Trimming trimming_;
  double air_ = 25;  // of the last reading, for the heater
};

}  // namespace rtdata
