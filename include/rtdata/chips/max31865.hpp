/// Max31865: a resistance thermometer (PT100, PT1000) at a MAX31865 of Maxim on SPI.
///
///     rtdata::DriverSensor<rtdata::Max31865> tank(loop, {.name = "tank", .rate = 5_Hz}, bus,
///                                                 {.chip_select = 0, .mode = 1}, {.wires = 3});
///
/// Each tick switches the current through the element on, checks its wires, measures once, and switches the current off
/// again, so that the element does not heat itself. The bus is free while the input settles (10 ms) and the chip
/// converts (66 ms with a filter for mains of 50 Hz, 55 ms for 60 Hz). A reading is unreadable, with the reason, if a
/// wire is open or shorted or the resistance is outside -200 to 850 degrees.
///
/// There is no identity and no checksum. The settings are read back with each measurement: a chip that was reset is
/// reported. A bus without a chip reads all ones or zeros, which never match the settings.
///
/// Clock to 5 MHz, modes 1 and 3. Sources: Maxim, 19-6478, register map, fault detection cycle; IEC 60751 for
/// temperatures (Callendar and Van Dusen).
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "rtdata/chips/max31856.hpp"
#include "rtdata/data/describe.hpp"
#include "rtdata/io/spi.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct RtdReading {
  double temperature = 0;
  double resistance = 0;
  friend constexpr auto describe(type_tag<RtdReading>) {
    return record("rtd", field("temperature", &RtdReading::temperature, "Cel"),
                  field("resistance", &RtdReading::resistance, "Ohm"));
  }
};

enum class RtdElement { pt100, pt1000 };

class Max31865 {
 public:
  static constexpr std::string_view type = "max31865";
  static constexpr std::string_view aliases = "rtd";
  static constexpr std::string_view description = "temperature of a PT100 or PT1000 at a MAX31865 on SPI";
  static constexpr std::string_view notes = R"(
- Pins: SDO to MISO, SDI to MOSI, SCLK, CS; `mode` 1 or 3, `clock` to 5 MHz.
- `reference_resistance` is printed on the board's resistor: 4300 or 430 is 430 Ohm, for a PT100; 4301 or 4.3k is
  4300 Ohm, for a PT1000. Boards have bridges to solder for 2, 3 and 4 wires.
- One measurement takes 77 ms (`mains` of 60 Hz: 66 ms).
- Open and shorted wires, and resistances outside -200 to 850 degrees, are reported and counted as unreadable.
- The settings are read back with each measurement: a chip that was reset or is missing is reported.
)";
  struct Config {
    RtdElement element = RtdElement::pt100;
    unsigned wires = 2;
    std::optional<double> reference_resistance = {};  ///< Ohm; unset: 430 for a PT100, 4300 for a PT1000
    Mains mains = Mains::hz_50;
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(
          parameter("element", &Config::element, "the element, by its resistance at 0 degrees: 100 or 1000 Ohm",
                    choices(value("pt100", RtdElement::pt100), value("pt1000", RtdElement::pt1000))),
          parameter("wires", &Config::wires, "number of wires to the element", range(2, 4)),
          parameter("reference_resistance", &Config::reference_resistance,
                    "resistance of the board's reference resistor; default: 430, for a PT1000 4300", unit("Ohm"),
                    range(10, 100'000)),
          parameter("mains", &Config::mains, "mains frequency, whose interference is filtered out",
                    choices(value("50 Hz", Mains::hz_50), value("60 Hz", Mains::hz_60))));
    }
  };
  using Value = RtdReading;
  using Device = SpiDevice;
  static constexpr SpiPlace place{.mode = 1};
  static constexpr KnownChip chips[] = {{.name = "MAX31865"}};
  // A measurement that has ended, a quarter of the reference, no fault.
  static constexpr ChipSample samples[] = {{.wires = ChipWires::registers_with_write_bit,
                                            .bytes = {{{"00", "00", 0x2e}, {"01", "40 00"}, {"07", "00"}}},
                                            .values = {{{"resistance", 107.5}, {"temperature", 19.24465}}},
                                            .has_proof = true}};

  static Result<void> check(const Config& config) {
    const auto refused = [](const char* where, std::string why) {
      return Error{Errc::bad_argument, "cannot use these settings of the MAX31865", where, std::move(why), ""};
    };
    if (config.wires < 2 || config.wires > 4)
      return refused("wires", std::to_string(config.wires) + " is not 2, 3 or 4");
    const double reference = reference_of(config);
    if (!std::isfinite(reference) || reference <= 0)
      return refused("reference_resistance", std::to_string(reference) + " is not above 0");
    return {};
  }
  explicit Max31865(const Config& config) : config_(config) {}

  Result<void> open(SpiDevice& chip) {
    constexpr std::array<std::uint8_t, 5> no_limits{0x83, 0xff, 0xff, 0x00, 0x00};
    if (auto done = write_settings(chip, 0); !done) return done;
    if (auto done = chip.write(no_limits); !done) return done;
    const Result<std::uint8_t> kept = read_settings(chip);
    if (!kept) return kept.error();
    if (*kept != settings_of(config_))
      return chip.error(Errc::bad_data, "cannot use the chip as a MAX31865", "it does not keep its settings",
                        "check its wires and supply, `chip_select`, `mode` and `clock`");
    return write_settings(chip, 0, Current::off);
  }

  Result<void> start(SpiDevice& chip) {
    auto done = write_settings(chip, step_ == Step::settling ? clear_faults : one_shot);
    if (!done) step_ = Step::settling;
    return done;
  }
  static Duration reading_time(const Config& config) {
    using namespace std::chrono_literals;
    return 10ms + (config.mains == Mains::hz_50 ? 66ms : 55ms);
  }
  Duration conversion_time() const noexcept {
    using namespace std::chrono_literals;
    if (step_ == Step::settling) return 10ms;  // more than ten time constants of the usual 100 nF
    return config_.mains == Mains::hz_50 ? 66ms : 55ms;
  }
  bool goes_on() const noexcept { return step_ == Step::measuring; }

  Reading<RtdReading> read(SpiDevice& chip) {
    const Step step = std::exchange(step_, Step::settling);
    if (step == Step::settling) {
      if (auto done = write_settings(chip, look_for_faults); !done) return std::move(done).error();
      chip.wait(std::chrono::milliseconds{1});  // 0.6 ms
      const Result<std::uint8_t> settings = read_settings(chip);
      if (!settings) return settings.error();
      if (*settings != settings_of(config_)) return lost(chip);
      step_ = Step::measuring;
      return nothing_new;
    }
    std::array<std::uint8_t, 8> bytes{};
    const std::uint8_t first = 0;
    if (auto done = chip.write_read({&first, 1}, bytes); !done) return std::move(done).error();
    if (auto done = write_settings(chip, 0, Current::off); !done) return std::move(done).error();
    if (bytes[0] == (settings_of(config_) | one_shot))
      return chip.error(Errc::timed_out, what, "the measurement takes too long", "");
    if (bytes[0] != settings_of(config_)) return lost(chip);
    auto reading = decode(bytes, config_);
    if (!reading) return Unreadable{at_place(chip, reading.error())};
    return *reading;
  }

  /// `registers`: all of the chip. Errors: bad-data (the wires), out-of-range (no temperature has this resistance).
  static Result<RtdReading> decode(std::span<const std::uint8_t, 8> registers, const Config& config) {
    const auto refused = [](Errc code, const char* why) { return Error{code, what, "", why, "check its wires"}; };
    const unsigned fault = registers[7], code = static_cast<unsigned>(registers[1] << 8 | registers[2]) >> 1;
    if ((fault & 0x04) != 0) return refused(Errc::bad_data, "an input is below ground or above the supply");
    if ((fault & 0x20) != 0) return refused(Errc::bad_data, "the element, or a wire to it, is open");
    if ((fault & 0x10) != 0) return refused(Errc::bad_data, "the wire FORCE- or the reference is open or shorted");
    if ((fault & 0x08) != 0) return refused(Errc::bad_data, "the wire RTDIN- is open or shorted");
    if ((fault & 0xc0) != 0 || (registers[2] & 1) != 0)
      return refused(Errc::bad_data, "it reports a fault of the element");
    if (code == 0x7fff)
      return refused(Errc::out_of_range, "the resistance is as large as the reference resistance, or larger");
    const double resistance = code * reference_of(config) / 32768;
    const double ratio = resistance / (config.element == RtdElement::pt100 ? 100 : 1000);
    const std::optional<double> temperature = temperature_of(ratio);
    if (!temperature)
      return Error{Errc::out_of_range, what, "",
                   std::to_string(resistance) + " Ohm is outside the range of -200 to 850 degrees",
                   "check its wires, `element` and `reference_resistance`"};
    return RtdReading{*temperature, resistance};
  }

  /// Temperature of a platinum element in degrees Celsius. `ratio`: its resistance divided by that at 0 degrees (IEC
  /// 60751). Empty: outside -200 to 850 degrees.
  static std::optional<double> temperature_of(double ratio) noexcept {
    constexpr double a = 3.9083e-3, b = -5.775e-7, c = -4.183e-12;
    const auto ratio_at = [](double t) { return 1 + a * t + b * t * t + (t < 0 ? c * (t - 100) * t * t * t : 0); };
    constexpr double lowest = -200, highest = 850, rounding = 1e-4;
    if (!(ratio >= ratio_at(lowest) - rounding) || !(ratio <= ratio_at(highest) + rounding)) return std::nullopt;
    double t = (-a + std::sqrt(a * a - 4 * b * (1 - ratio))) / (2 * b);
    if (t >= 0) return t;
    for (int i = 0; i < 5; ++i) {  // Newton; the quadratic is within 3 degrees
      const double slope = a + 2 * b * t + c * (4 * t * t * t - 300 * t * t);
      t -= (ratio_at(t) - ratio) / slope;
    }
    return t;
  }

 private:
  enum class Step { settling, measuring };
  enum class Current { on, off };
  static constexpr std::uint8_t one_shot = 0x20, look_for_faults = 0x04, clear_faults = 0x02;
  static constexpr const char* what = "cannot read the MAX31865";

  static double reference_of(const Config& config) noexcept {
    return config.reference_resistance.value_or(config.element == RtdElement::pt100 ? 430 : 4300);
  }
  /// The configuration register, with the current switched on.
  static std::uint8_t settings_of(const Config& config) noexcept {
    return static_cast<std::uint8_t>(0x80 | (config.wires == 3 ? 0x10 : 0) | (config.mains == Mains::hz_50 ? 1 : 0));
  }
  Result<void> write_settings(SpiDevice& chip, std::uint8_t command, Current current = Current::on) {
    const unsigned settings = current == Current::on ? settings_of(config_) : settings_of(config_) & 0x7fu;
    const std::array<std::uint8_t, 2> bytes{0x80, static_cast<std::uint8_t>(settings | command)};
    return chip.write(bytes);
  }
  static Result<std::uint8_t> read_settings(SpiDevice& chip) {
    const std::uint8_t number = 0;
    std::uint8_t value = 0;
    if (auto done = chip.write_read({&number, 1}, {&value, 1}); !done) return std::move(done).error();
    return value;
  }
  Reading<RtdReading> lost(SpiDevice& chip) const {
    return Unreadable{chip.error(Errc::bad_data, what, "it has lost its settings since the start", "check its supply")};
  }

  Config config_;
  Step step_ = Step::settling;
};

}  // namespace rtdata
