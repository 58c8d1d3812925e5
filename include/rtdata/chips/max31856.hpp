/// Max31856: a thermocouple of any kind at a MAX31856 of Maxim on SPI.
///
///     rtdata::DriverSensor<rtdata::Max31856> oven(loop, {.name = "oven", .rate = 2_Hz}, bus,
///                                                 {.chip_select = 0, .mode = 1},
///                                                 {.thermocouple = rtdata::Thermocouple::k});
///
/// Each tick starts one measurement and reads it when it is done; the bus is free meanwhile. A measurement takes 0.23 s
/// with a filter for mains of 50 Hz, 0.2 s for 60 Hz, plus 40 or 33 ms for each further measurement of `average`. A
/// reading is unreadable, with the reason, if the thermocouple is open, an input is out of the supply range, or a
/// temperature is out of the range of the thermocouple or the chip.
///
/// There is no identity and no checksum. The settings are read back with each measurement: a chip that was reset is
/// reported and set up again. A bus without a chip reads all ones or zeros, which never match the settings.
///
/// Clock to 5 MHz, modes 1 and 3. Source: Maxim, 19-7534, register map and descriptions; AVGSEL and OCFAULT for times.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/io/spi.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

/// The payload of thermocouple drivers.
struct ThermocoupleReading {
  double temperature = 0;    ///< of the thermocouple's tip, cold junction compensated by the chip
  double cold_junction = 0;  ///< of the chip, where the thermocouple is connected
  friend constexpr auto describe(type_tag<ThermocoupleReading>) {
    return record("thermocouple", field("temperature", &ThermocoupleReading::temperature, "Cel"),
                  field("cold_junction", &ThermocoupleReading::cold_junction, "Cel"));
  }
};

/// In the order of the chip's codes.
enum class Thermocouple { b, e, j, k, n, r, s, t };
/// The mains frequency that a converter filters out.
enum class Mains { hz_50, hz_60 };

class Max31856 {
 public:
  static constexpr std::string_view type = "max31856";
  static constexpr std::string_view description = "temperature of a thermocouple of any kind at a MAX31856 on SPI";
  static constexpr std::string_view notes = R"(
- Pins: SDO to MISO, SDI to MOSI, SCK, CS; `mode` 1 or 3, `clock` to 5 MHz.
- One measurement takes 0.23 s (`mains` of 60 Hz: 0.2 s), and 40 ms (33 ms) more for each further measurement of
  `average`: `rate` to 4 Hz.
- An open thermocouple, an input beyond the supply and a temperature out of range are reported and counted as
  unreadable.
- The settings are read back with each measurement: a chip that was reset or is missing is reported.
)";
  struct Config {
    Thermocouple thermocouple = Thermocouple::k;
    Mains mains = Mains::hz_50;
    unsigned average = 1;  ///< measurements in each reading
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(
          parameter("thermocouple", &Config::thermocouple, "type of the thermocouple",
                    choices(value("b", Thermocouple::b), value("e", Thermocouple::e), value("j", Thermocouple::j),
                            value("k", Thermocouple::k), value("n", Thermocouple::n), value("r", Thermocouple::r),
                            value("s", Thermocouple::s), value("t", Thermocouple::t))),
          parameter("mains", &Config::mains, "mains frequency, whose interference is filtered out",
                    choices(value("50 Hz", Mains::hz_50), value("60 Hz", Mains::hz_60))),
          parameter("average", &Config::average,
                    "number of measurements that are averaged in a reading: 1, 2, 4, 8 or 16"));
    }
  };
  using Value = ThermocoupleReading;
  using Device = SpiDevice;
  static constexpr SpiPlace place{.mode = 1};
  static constexpr KnownChip chips[] = {{.name = "MAX31856"}};
  // A measurement that has ended; both temperatures; no fault.
  static constexpr ChipSample samples[] = {{.wires = ChipWires::registers_with_write_bit,
                                            .bytes = {{{"00", "00", 0x40}, {"0a", "19 00 06 4f 00 00"}}},
                                            .values = {{{"temperature", 100.9375}, {"cold_junction", 25}}},
                                            .has_proof = true}};

  static Result<void> check(const Config& config) {
    for (const unsigned good : {1u, 2u, 4u, 8u, 16u})
      if (config.average == good) return {};
    return Error{Errc::bad_argument, "cannot use these settings of the MAX31856", "average",
                 std::to_string(config.average) + " is not one of its values", "take 1, 2, 4, 8 or 16"};
  }
  explicit Max31856(const Config& config) : config_(config) {}

  Result<void> open(SpiDevice& chip) {
    if (auto done = set_up(chip); !done) return done;
    std::array<std::uint8_t, register_count> bytes{};
    if (auto done = read_registers(chip, bytes); !done) return done;
    if (!has_settings(bytes, config_))
      return chip.error(Errc::bad_data, "cannot use the chip as a MAX31856", "it does not keep its settings",
                        "check its wires and supply, `chip_select`, `mode` and `clock`");
    return {};
  }
  Result<void> start(SpiDevice& chip) {
    return write(chip, control_register, static_cast<std::uint8_t>(control_of(config_) | one_shot));
  }
  static Duration reading_time(const Config& config) { return Max31856(config).conversion_time(); }
  Duration conversion_time() const noexcept {
    using namespace std::chrono_literals;
    constexpr Duration looking_for_an_open_circuit = 44ms;
    const bool is_50 = config_.mains == Mains::hz_50;
    return (is_50 ? 185ms : 155ms) + (config_.average - 1) * (is_50 ? 42ms : 35ms) + looking_for_an_open_circuit;
  }
  Reading<ThermocoupleReading> read(SpiDevice& chip) {
    std::array<std::uint8_t, register_count> bytes{};
    if (auto done = read_registers(chip, bytes); !done) return std::move(done).error();
    if (!has_settings(bytes, config_)) {
      if (auto done = set_up(chip); !done) return std::move(done).error();
      return Unreadable{
          chip.error(Errc::bad_data, what, "it has lost its settings since the start", "check its supply")};
    }
    if ((bytes[0] & one_shot) != 0) return chip.error(Errc::timed_out, what, "the measurement takes too long", "");
    auto reading = decode(bytes);
    if (!reading) return Unreadable{at_place(chip, reading.error())};
    return *reading;
  }

  /// `registers`: all of the chip. Errors: bad-data (the thermocouple), out-of-range (temperatures).
  static Result<ThermocoupleReading> decode(std::span<const std::uint8_t, 16> registers) {
    const unsigned fault = registers[15];
    const auto refused = [](Errc code, const char* why) { return Error{code, what, "", why, "check its wires"}; };
    if ((fault & 0x01) != 0) return refused(Errc::bad_data, "the thermocouple is open");
    if ((fault & 0x02) != 0) return refused(Errc::bad_data, "an input is below ground or above the supply");
    if ((fault & 0x40) != 0) return refused(Errc::out_of_range, "the temperature is outside its thermocouple's range");
    if ((fault & 0xb0) != 0) return refused(Errc::out_of_range, "the cold junction is outside its range");
    const auto cold = static_cast<std::int16_t>(registers[10] << 8 | registers[11]);
    const auto tip = static_cast<std::int32_t>(static_cast<std::uint32_t>(registers[12]) << 24 |
                                               static_cast<std::uint32_t>(registers[13]) << 16 |
                                               static_cast<std::uint32_t>(registers[14]) << 8);
    return ThermocoupleReading{(tip >> 13) / 128.0, (cold >> 2) / 64.0};
  }

 private:
  static constexpr std::size_t register_count = 16;
  static constexpr std::uint8_t control_register = 0, write_bit = 0x80;
  static constexpr std::uint8_t one_shot = 0x40;
  // Mask of the pin FAULT, limits of both temperatures, offset of the cold junction. All are as after a reset, except
  // the upper limit of the cold junction: 126 instead of 127 degrees. Reading 127 back shows a reset; the cold junction
  // never reaches either value.
  static constexpr std::size_t first_limit = 2;
  static constexpr std::array<std::uint8_t, 8> limits{0xff, 0x7e, 0xc0, 0x7f, 0xff, 0x80, 0x00, 0x00};
  static constexpr const char* what = "cannot read the MAX31856";

  /// With open-circuit detection for thermocouples below 5 kOhm.
  static std::uint8_t control_of(const Config& config) noexcept {
    return static_cast<std::uint8_t>(0x10 | (config.mains == Mains::hz_50 ? 1 : 0));
  }
  static std::uint8_t kind_of(const Config& config) noexcept {
    unsigned bits = 0;
    while ((1u << bits) < config.average && bits < 4) ++bits;
    return static_cast<std::uint8_t>(bits << 4 | static_cast<unsigned>(config.thermocouple));
  }
  static bool has_settings(std::span<const std::uint8_t, register_count> registers, const Config& config) noexcept {
    return (registers[0] & ~one_shot) == control_of(config) && registers[1] == kind_of(config) &&
           std::equal(limits.begin(), limits.end(), registers.begin() + first_limit);
  }
  static Result<void> read_registers(SpiDevice& chip, std::span<std::uint8_t, register_count> bytes) {
    const std::uint8_t first = 0;
    return chip.write_read({&first, 1}, bytes);
  }
  static Result<void> write(SpiDevice& chip, std::uint8_t number, std::uint8_t value) {
    const std::array<std::uint8_t, 2> bytes{static_cast<std::uint8_t>(number | write_bit), value};
    return chip.write(bytes);
  }
  Result<void> set_up(SpiDevice& chip) {
    std::array<std::uint8_t, 1 + first_limit + limits.size()> settings{control_register | write_bit,
                                                                       control_of(config_), kind_of(config_)};
    std::copy(limits.begin(), limits.end(), settings.begin() + 1 + first_limit);
    return chip.write(settings);
  }

  Config config_;
};

}  // namespace rtdata
