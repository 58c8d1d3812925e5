/// Sgp30, Sgp40: gas sensors of Sensirion for the air in rooms on I2C.
///
///     rtdata::DriverSensor<rtdata::Sgp40> air(loop, {.name = "air", .rate = 1_Hz}, bus, {},
///                                             {.temperature = 21, .humidity = 45});
///
/// An SGP30 gives a CO2 equivalent and the sum of volatile organic compounds (TVOC), both from its own baseline, and
/// the two raw signals from which it computes them. It needs one reading a second: `"rate": "1 Hz"`. For 15 s after
/// each opening the chip gives fixed numbers in place of both; these events have the raw signals only. The baseline
/// begins anew with each opening.
///
/// An SGP40 gives its raw signal, which falls when there is more gas: it is proportional to the logarithm of a
/// resistance, in steps without a unit. The chip corrects it for the temperature and humidity of the air, which are
/// settings; Sensirion's VOC index is not computed.
///
/// Each tick starts the measurement and reads it when the chip has had its time (SGP30: 12 ms, then 25 ms; SGP40: 30
/// ms); the bus is free for others meanwhile. All words have a checksum: a reading with a wrong one is unreadable.
/// Opening reads the serial number, whose checksums show whether it is another chip, and for an SGP30 the product type.
/// Addresses: 0x58 (SGP30), 0x59 (SGP40).
///
/// Sources: Sensirion SGP30, data sheet V1.0 of May 2020: "air quality signals", "sensor raw signals", "feature set",
/// table 10 commands and times. SGP40, data sheet V1.0 of July 2020: tables 9 to 11 measurement; serial number.
///
/// Drivers (driver.hpp): used on the bus's lane.
#pragma once

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "rtdata/data/describe.hpp"
#include "rtdata/detail/chips/sensirion.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct Sgp30Reading {
  std::optional<double> co2_equivalent{};  ///< empty: the chip warms up
  std::optional<double> tvoc{};            ///< empty: the chip warms up
  double hydrogen_signal = 0;              ///< steps; 512 less mean e times the concentration
  double ethanol_signal = 0;
  friend constexpr auto describe(type_tag<Sgp30Reading>) {
    return record("sgp30", field("co2_equivalent", &Sgp30Reading::co2_equivalent, "[ppm]"),
                  field("tvoc", &Sgp30Reading::tvoc, "[ppb]"), field("hydrogen_signal", &Sgp30Reading::hydrogen_signal),
                  field("ethanol_signal", &Sgp30Reading::ethanol_signal));
  }
};

struct Sgp40Reading {
  double signal = 0;  ///< steps
  friend constexpr auto describe(type_tag<Sgp40Reading>) {
    return record("sgp40", field("signal", &Sgp40Reading::signal));
  }
};

namespace detail {

/// Sends a command, waits, and reads what `sensirion_words` takes.
template <std::size_t size>
Result<std::array<std::uint8_t, size>> ask_sgp(I2cDevice& chip, std::uint16_t command, Duration time) {
  std::array<std::uint8_t, size> bytes{};
  if (auto done = chip.write(sensirion_command(command)); !done) return std::move(done).error();
  chip.wait(time);
  if (auto done = chip.read(bytes); !done) return std::move(done).error();
  return bytes;
}

inline Result<void> check_sgp_serial_number(I2cDevice& chip, const char* name) {
  const auto answer = ask_sgp<9>(chip, 0x3682, std::chrono::milliseconds{1});
  if (!answer) return answer.error();
  if (sensirion_words(*answer)) return {};
  return chip.error(Errc::bad_data, std::string("cannot use the chip as an ") + name,
                    "its serial number has a wrong checksum", "check which chip is at this address, and its wires");
}

inline Unreadable wrong_sgp_checksum(const I2cDevice& chip, const char* what) {
  return Unreadable{chip.error(Errc::bad_data, what, "a checksum is wrong", "check its wires")};
}

}  // namespace detail

class Sgp30 {
 public:
  static constexpr std::string_view type = "sgp30";
  static constexpr std::string_view aliases = "voc tvoc eco2";
  static constexpr std::string_view description = "CO2 equivalent and TVOC of an SGP30 on I2C";
  static constexpr std::string_view notes = R"(
- Wires: 1.8 V (boards mostly take 3.3 V), ground, SDA, SCL. One address: 0x58.
- `"rate": "1 Hz"`: the chip's own baseline needs exactly one reading per second.
- For 15 s after each start `co2_equivalent` and `tvoc` are absent; they are correct some hours later. The baseline is
  not stored: it is lost at each start.
- `co2_equivalent` is computed from hydrogen, not measured: for CO2 take an SCD4x.
- A reading takes 37 ms, during which the bus is free for other chips.
)";
  struct Config {
    friend constexpr auto parameters(type_tag<Config>) { return parameter_list(); }
  };
  using Value = Sgp30Reading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x58};
  static constexpr KnownChip chips[] = {{.name = "SGP30", .addresses = {0x58}}};
  static constexpr ChipSample samples[] = {{.wires = ChipWires::answers,
                                            .bytes = {{{"36 82", "00 00 81 01 a2 eb 31 c2 e2"},
                                                       {"20 2f", "00 22 65"},
                                                       {"20 08", "01 90 4c 00 00 81"},
                                                       {"20 50", "34 08 09 48 01 0e"}}},
                                            .values = {{{"hydrogen_signal", 0x3408}, {"ethanol_signal", 0x4801}}},
                                            .has_proof = true}};
  explicit Sgp30(const Config&) {}
  static Duration bus_time(const Config&) { return std::chrono::milliseconds{1} + 2 * command_time; }

  Result<void> open(I2cDevice& chip) {
    if (auto done = detail::check_sgp_serial_number(chip, "SGP30"); !done) return done;
    const auto answer = detail::ask_sgp<3>(chip, feature_set, command_time);
    if (!answer) return answer.error();
    const auto features = detail::sensirion_words(*answer);
    constexpr unsigned product_type = 0xf000;
    if (!features || ((*features)[0] & product_type) != 0)
      return chip.error(Errc::bad_data, "cannot use the chip as an SGP30", "it does not answer with its product type",
                        "check which chip is at this address");
    if (auto done = chip.write(detail::sensirion_command(begin_air_quality)); !done) return done;
    chip.wait(command_time);
    began_ = Samples<Sgp30Reading>::now();
    is_raw_ = false;
    return {};
  }

  Result<void> start(I2cDevice& chip) {
    return begun(chip.write(detail::sensirion_command(is_raw_ ? measure_raw : measure_air_quality)));
  }
  static Duration reading_time(const Config&) { return air_quality_time + raw_time; }
  Duration conversion_time() const noexcept { return is_raw_ ? raw_time : air_quality_time; }
  bool goes_on() const noexcept { return is_raw_; }

  Reading<Sgp30Reading> read(I2cDevice& chip) {
    std::array<std::uint8_t, 6> bytes{};
    const bool was_raw = std::exchange(is_raw_, false);
    if (auto done = chip.read(bytes); !done) return std::move(done).error();
    const auto words = detail::sensirion_words(bytes);
    if (!words) return detail::wrong_sgp_checksum(chip, "cannot read the SGP30");
    if (!was_raw) {
      air_quality_ = *words;
      is_raw_ = true;
      return nothing_new;
    }
    const bool is_warm = Samples<Sgp30Reading>::now() - began_ > warm_up;
    return decode(is_warm ? std::optional(air_quality_) : std::nullopt, *words);
  }

  /// `air_quality`, `raw`: the answers to both commands; empty: the chip warms up.
  static Sgp30Reading decode(const std::optional<std::array<std::uint16_t, 2>>& air_quality,
                             const std::array<std::uint16_t, 2>& raw) noexcept {
    Sgp30Reading reading{{}, {}, static_cast<double>(raw[0]), static_cast<double>(raw[1])};
    if (!air_quality) return reading;
    reading.co2_equivalent = (*air_quality)[0];
    reading.tvoc = (*air_quality)[1];
    return reading;
  }

 private:
  /// After an error the next start begins with the first measurement.
  Result<void> begun(Result<void> result) {
    if (!result) is_raw_ = false;
    return result;
  }
  static constexpr std::uint16_t begin_air_quality = 0x2003, measure_air_quality = 0x2008, feature_set = 0x202f;
  static constexpr std::uint16_t measure_raw = 0x2050;
  static constexpr Duration command_time = std::chrono::milliseconds{10};
  static constexpr Duration air_quality_time = std::chrono::milliseconds{12}, raw_time = std::chrono::milliseconds{25};
  static constexpr Duration warm_up = std::chrono::seconds{15};

  MonotonicTime began_{};
  bool is_raw_ = false;  // the second measurement of a reading is next
  std::array<std::uint16_t, 2> air_quality_{};
};

class Sgp40 {
 public:
  static constexpr std::string_view type = "sgp40";
  static constexpr std::string_view aliases = "voc";
  static constexpr std::string_view description = "the raw signal for volatile organic compounds of an SGP40 on I2C";
  static constexpr std::string_view notes = R"(
- Wires: 3.3 V, ground, SDA, SCL. One address: 0x59.
- `signal` is in steps, proportional to the logarithm of the sensor's resistance: it falls when there is more gas. The
  VOC index of Sensirion, 0 to 500, is not computed.
- The chip corrects the signal for `temperature` and `humidity` of the air, which the configuration sets.
- `"rate": "1 Hz"`: between readings the chip keeps its heater on. It is switched off when the sensor stops. A reading
  takes 30 ms, during which the bus is free for other chips.
- It needs a minute to warm up, and days to settle; the chip does not mark the values of this time.
)";
  struct Config {
    double temperature = 25;  ///< degrees Celsius, of the air
    double humidity = 50;     ///< %, of the air
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(parameter("temperature", &Config::temperature, "air temperature, for the chip's correction",
                                      unit("Cel"), range(-45, 130)),
                            parameter("humidity", &Config::humidity, "relative air humidity, for the chip's correction",
                                      unit("%"), range(0, 100)));
    }
  };
  using Value = Sgp40Reading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x59};
  static constexpr KnownChip chips[] = {{.name = "SGP40", .addresses = {0x59}}};
  static constexpr ChipSample samples[] = {
      {.wires = ChipWires::answers,
       .bytes = {{{"36 82", "00 00 81 01 a2 eb 31 c2 e2"}, {"26 0f 80 00 a2 66 66 93", "75 30 08"}}},
       .values = {{{"signal", 30000}}},
       .has_proof = true}};

  static Result<void> check(const Config& config) {
    const auto refused = [](const char* where, const char* why) {
      return Error{Errc::bad_argument, "cannot use these settings of the SGP40", where, why, ""};
    };
    if (!(config.temperature >= -45 && config.temperature <= 130))
      return refused("temperature", "it is not in the range -45 to 130 degrees");
    if (!(config.humidity >= 0 && config.humidity <= 100))
      return refused("humidity", "it is not in the range 0 to 100 %");
    return {};
  }
  explicit Sgp40(const Config& config) : config_(config) {}
  static Duration bus_time(const Config&) { return std::chrono::milliseconds{1}; }

  Result<void> open(I2cDevice& chip) { return detail::check_sgp_serial_number(chip, "SGP40"); }
  void close(I2cDevice& chip) { (void)chip.write(detail::sensirion_command(heater_off)); }
  Result<void> start(I2cDevice& chip) { return chip.write(request(config_)); }
  static Duration reading_time(const Config&) { return measuring; }
  Duration conversion_time() const noexcept { return measuring; }
  Reading<Sgp40Reading> read(I2cDevice& chip) {
    std::array<std::uint8_t, 3> bytes{};
    if (auto done = chip.read(bytes); !done) return std::move(done).error();
    const auto words = detail::sensirion_words(bytes);
    if (!words) return detail::wrong_sgp_checksum(chip, "cannot read the SGP40");
    return Sgp40Reading{static_cast<double>((*words)[0])};
  }

  /// What begins a measurement: the command, humidity and temperature.
  static std::array<std::uint8_t, 8> request(const Config& config) noexcept {
    const auto steps = [](double share) {
      return static_cast<std::uint16_t>(std::lround(std::clamp(share, 0.0, 1.0) * 65535));
    };
    return detail::sensirion_command(measure, steps(config.humidity / 100), steps((config.temperature + 45) / 175));
  }

 private:
  static constexpr std::uint16_t measure = 0x260f, heater_off = 0x3615;
  static constexpr Duration measuring = std::chrono::milliseconds{30};

  Config config_;
};

}  // namespace rtdata
