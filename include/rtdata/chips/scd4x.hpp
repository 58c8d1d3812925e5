/// Scd4x: CO2, temperature and humidity by an SCD40 or SCD41 of Sensirion on I2C.
///
///     rtdata::DriverSensor<rtdata::Scd4x> air(loop, {.name = "air", .rate = 1_Hz}, bus, {}, {.altitude = 520});
///
/// The chip measures by itself, every 5 s; a tick reads what is new. A tick before that is counted as repeated; no
/// measurement for 15 s is an error. All words have a checksum: a reading with a wrong one is unreadable, and so is one
/// of 0 ppm, which means that the sample is not valid. Ranges: 0 to 40000 ppm (specified: SCD40 400 to 2000, SCD41 to
/// 5000), -45 to 130 degrees, 0 to 100 %.
///
/// Opening stops a running measurement (0.5 s, while the driver holds the bus), reads the serial number, whose
/// checksums show whether it is another chip, and writes the altitude. Address: 0x62.
///
/// Source: Sensirion SCD4x, data sheet V1.3 of September 2022: 3.4 commands and their times, 3.5 measurement, 3.6
/// altitude, 3.8 data ready, 3.9 serial number.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/detail/chips/sensirion.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct Scd4xReading {
  double co2 = 0;
  double temperature = 0;
  double humidity = 0;  ///< relative
  friend constexpr auto describe(type_tag<Scd4xReading>) {
    return record("scd4x", field("co2", &Scd4xReading::co2, "[ppm]"),
                  field("temperature", &Scd4xReading::temperature, "Cel"),
                  field("humidity", &Scd4xReading::humidity, "%"));
  }
};

class Scd4x {
 public:
  static constexpr std::string_view type = "scd4x";
  static constexpr std::string_view aliases = "scd40 scd41";
  static constexpr std::string_view description = "CO2, temperature and humidity of an SCD40 or SCD41 on I2C";
  static constexpr std::string_view notes = R"(
- Wires: 3.3 V (in a measurement 0.2 A for a moment), ground, SDA, SCL. One address: 0x62.
- It measures every 5 s by itself: `"rate": "1 Hz"` or less. A reading before the next measurement is counted as
  repeated.
- Set `altitude` in the mountains: 500 m change the CO2 value by 6 %.
- The chip corrects itself: it assumes that the least CO2 of some days is that of fresh air (automatic
  self-calibration).
- The first values after switching on are less accurate; the chip does not mark them. 0 ppm is counted as unreadable.
- At each start it holds the bus for 0.5 s.
)";
  struct Config {
    double altitude = 0;  ///< m above the sea, for the pressure of the air
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(parameter("altitude", &Config::altitude,
                                      "height of the chip above sea level, from which it computes the air pressure",
                                      unit("m"), range(0, 3000)));
    }
  };
  using Value = Scd4xReading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x62};
  static constexpr KnownChip chips[] = {{.name = "SCD40, SCD41", .addresses = {0x62}}};
  // The data sheet's examples (3.5.2, 3.9.2): 500 ppm, 25 degrees, 37 %, ready.
  static constexpr ChipSample samples[] = {{.wires = ChipWires::answers,
                                            .bytes = {{{"36 82", "f8 96 31 9f 07 c2 3b be 89"},
                                                       {"e4 b8", "80 06 04"},
                                                       {"ec 05", "01 f4 33 66 67 a2 5e b9 3c"}}},
                                            .values = {{{"co2", 500}, {"temperature", 25.002}, {"humidity", 37.0}}},
                                            .has_proof = true}};

  static Result<void> check(const Config& config) {
    if (config.altitude >= 0 && config.altitude <= 3000) return {};
    return Error{Errc::bad_argument, "cannot use this altitude", "altitude", "it is not in the range 0 to 3000 m", ""};
  }
  explicit Scd4x(const Config& config) : config_(config) {}
  static Duration bus_time(const Config&) { return stopping + 3 * command_time; }

  Result<void> open(I2cDevice& chip) {
    if (auto done = chip.write(detail::sensirion_command(stop_measuring)); !done) return done;
    chip.wait(stopping);
    if (auto done = chip.write(detail::sensirion_command(serial_number)); !done) return done;
    chip.wait(command_time);
    std::array<std::uint8_t, 9> bytes{};
    if (auto done = chip.read(bytes); !done) return done;
    if (!detail::sensirion_words(bytes))
      return chip.error(Errc::bad_data, "cannot use the chip as an SCD40 or SCD41",
                        "its serial number has a wrong checksum", "check which chip is at this address, and its wires");
    const auto metres = static_cast<std::uint16_t>(std::lround(config_.altitude));
    if (auto done = chip.write(detail::sensirion_command(set_altitude, metres)); !done) return done;
    chip.wait(command_time);
    last_ = Samples<Scd4xReading>::now();
    return chip.write(detail::sensirion_command(start_measuring));
  }
  void close(I2cDevice& chip) { (void)chip.write(detail::sensirion_command(stop_measuring)); }

  Reading<Scd4xReading> read(I2cDevice& chip) {
    if (auto done = chip.write(detail::sensirion_command(data_ready)); !done) return std::move(done).error();
    chip.wait(command_time);
    std::array<std::uint8_t, 3> state{};
    if (auto done = chip.read(state); !done) return std::move(done).error();
    const auto ready = detail::sensirion_words(state);
    if (!ready) return wrong_checksum(chip);
    const MonotonicTime now = Samples<Scd4xReading>::now();
    constexpr unsigned ready_bits = 0x07ff;
    if (((*ready)[0] & ready_bits) == 0) {
      if (now - last_ > longest_silence)
        return chip.error(Errc::timed_out, what, "it has stopped measuring", "check its supply");
      return nothing_new;
    }
    if (auto done = chip.write(detail::sensirion_command(read_measurement)); !done) return std::move(done).error();
    chip.wait(command_time);
    std::array<std::uint8_t, 9> bytes{};
    if (auto done = chip.read(bytes); !done) return std::move(done).error();
    last_ = now;
    const auto words = detail::sensirion_words(bytes);
    if (!words) return wrong_checksum(chip);
    auto reading = decode(*words);
    if (!reading) return Unreadable{chip.error(Errc::bad_data, what, reading.error().why, reading.error().advice)};
    return *reading;
  }

  /// `words`: the answer to `read_measurement`. Errors: bad-data (the sample is not valid).
  static Result<Scd4xReading> decode(const std::array<std::uint16_t, 3>& words) {
    if (words[0] == 0)
      return Error{Errc::bad_data, what, "", "it reports 0 ppm: the sample is not valid", "wait for the next one"};
    return Scd4xReading{static_cast<double>(words[0]), -45 + 175 * (words[1] / 65535.0), 100 * (words[2] / 65535.0)};
  }

 private:
  static Unreadable wrong_checksum(const I2cDevice& chip) {
    return Unreadable{chip.error(Errc::bad_data, what, "a checksum is wrong", "check its wires")};
  }
  static constexpr std::uint16_t start_measuring = 0x21b1, stop_measuring = 0x3f86, read_measurement = 0xec05;
  static constexpr std::uint16_t data_ready = 0xe4b8, serial_number = 0x3682, set_altitude = 0x2427;
  static constexpr Duration stopping = std::chrono::milliseconds{500}, command_time = std::chrono::milliseconds{1};
  static constexpr Duration longest_silence = std::chrono::seconds{15};
  static constexpr const char* what = "cannot read the SCD4x";

  Config config_;
  MonotonicTime last_{};
};

}  // namespace rtdata
