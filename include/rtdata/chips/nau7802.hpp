/// Nau7802: a load cell, or another bridge, at a NAU7802 of Nuvoton on I2C.
///
///     rtdata::DriverSensor<rtdata::Nau7802> scale(loop, {.name = "scale", .rate = 10_Hz}, bus, {.address = 0x2a},
///                                                 {.gain = 128, .data_rate = 10, .tare_samples = 20});
///
/// The value is the bridge's output divided by its supply, in mV/V, as in the data sheets of load cells: a cell of 5 kg
/// and 2 mV/V gives 2 at 5 kg. Supply the bridge from the chip's AVDD pin, which is also the reference.
///
/// Tare: with `tare_samples`, the average of that many first samples is subtracted from all later ones. Each event has
/// the tare and the raw code; there is no value until the tare is known. The sensor takes the tare once: after a fault,
/// when there may be a load on the cell, it keeps the old one.
///
/// The chip measures by itself, `data_rate` times a second; a tick without a new sample is counted as repeated, and
/// samples between two ticks are left out. After opening, and after it has lost its settings, it calibrates its own
/// offset, which takes some 0.5 s with the bus free for others. A code at an end of the range is unreadable. One
/// address: 0x2a; the revision code is its identity.
///
/// Source: Nuvoton NAU7802, data sheet V1.7: 8.1 power-on, 8.3 calibration, 9 registers.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/detail/chips/choice.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct BridgeReading {
  std::optional<double> value = {};  ///< minus the tare; empty until the tare is known
  std::int32_t raw = 0;              ///< the code of the converter, 24 bits
  std::optional<double> tare = {};   ///< the tare that was subtracted; empty: none, or not yet known
  friend constexpr auto describe(type_tag<BridgeReading>) {
    return record("bridge", field("value", &BridgeReading::value, "mV/V"), field("raw", &BridgeReading::raw),
                  field("tare", &BridgeReading::tare, "mV/V"));
  }
};

class Nau7802 {
 public:
  static constexpr std::string_view type = "nau7802";
  static constexpr std::string_view aliases = "scale weight";
  static constexpr std::string_view description = "a load cell or another bridge at a NAU7802 on I2C";
  static constexpr std::string_view notes = R"(
- Address 0x2a. Connect the bridge's supply to AVDD and ground (E+, E-), its output to VIN1P and VIN1N (A+, A-).
- `supply_voltage` is the voltage that the chip makes for the bridge; it must be 0.3 V below the supply of the chip.
- `value` is in mV/V, as load cells are specified: the `scale` is their full load divided by their sensitivity. The
  range is plus or minus 500 mV/V divided by `gain`.
- With `tare_samples`, the mean of this number of first samples is subtracted. It is the field `tare`, and is measured
  once in the life of the sensor.
- A `rate` above `data_rate` gives no new values.
)";
  struct Config {
    unsigned gain = 128;
    unsigned data_rate = 10;                 ///< samples a second
    double supply_voltage = 3.0;             ///< V that the chip gives to the bridge
    unsigned tare_samples = 0;               ///< how many samples to average for the tare; 0: no tare
    std::optional<IdentityCode> identity{};  ///< of a clone
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(
          parameter("gain", &Config::gain,
                    "1, 2, 4, 8, 16, 32, 64 or 128; the measuring range is 500 mV/V divided by the gain"),
          parameter("data_rate", &Config::data_rate, "samples per second: 10, 20, 40, 80 or 320", unit("Hz")),
          parameter("supply_voltage", &Config::supply_voltage,
                    "voltage that the chip gives to the bridge: 2.4, 2.7, 3.0, 3.3, 3.6, 3.9, 4.2 or 4.5", unit("V")),
          parameter("tare_samples", &Config::tare_samples,
                    "number of first samples whose mean is subtracted as the tare; 0: no tare", range(0, 100'000)),
          identity_parameter(&Config::identity));
    }
  };
  /// The tare, or its samples so far.
  struct Memory {
    unsigned count = 0;
    double sum = 0;  // of ratios
  };
  using Value = BridgeReading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x2a};
  static constexpr KnownChip chips[] = {{.name = "NAU7802", .addresses = {0x2a}, .identity = {{0x1f, 0x0f, 0x0f}}}};
  // Powered up, a sample ready; calibrated; half of the range.
  static constexpr ChipSample samples[] = {
      {.bytes = {{{"00", "28", 0x28}, {"02", "00", 0x0c}, {"12", "40 00 00"}, {"1f", "0f"}}},
       .values = {{{"value", 1.953125}, {"raw", 0x400000}}},
       .has_proof = true}};

  static Result<void> check(const Config& config) {
    const auto refused = [](const char* where, const std::string& value, const char* advice) {
      return Error{Errc::bad_argument, "cannot use these settings of the NAU7802", where,
                   value + " is not one of its values", advice};
    };
    if (!detail::place_of(gains, config.gain))
      return refused("gain", std::to_string(config.gain), "take 1, 2, 4, 8, 16, 32, 64 or 128");
    if (config.data_rate == 0 || !detail::place_of(data_rates, config.data_rate))
      return refused("data_rate", std::to_string(config.data_rate), "take 10, 20, 40, 80 or 320");
    if (!detail::place_of(supplies, config.supply_voltage))
      return refused("supply_voltage", std::to_string(config.supply_voltage),
                     "take 2.4, 2.7, 3.0, 3.3, 3.6, 3.9, 4.2 or 4.5");
    return {};
  }
  explicit Nau7802(const Config& config) : config_(config) {}
  void remember(const Memory& memory) { memory_ = memory; }
  Memory memory() const { return memory_; }

  Result<void> open(I2cDevice& chip) {
    using namespace std::chrono_literals;
    if (auto same = check_identity(chip, chips[0], config_.identity); !same) return same;
    if (auto done = chip.write_register(power_register, reset); !done) return done;
    if (auto done = chip.write_register(power_register, digital_on); !done) return done;
    chip.wait(1ms);  // 0.2 ms
    std::array<std::uint8_t, 3> found{};
    if (auto done = chip.read_registers(power_register, found); !done) return done;
    if ((found[0] & powered_up) == 0)
      return chip.error(Errc::bad_data, "cannot use the NAU7802", "it does not power up", "check its supply");
    const std::array<std::array<std::uint8_t, 2>, 5> settings{{{gain_register, gain_of(config_)},
                                                               {rate_register, rate_of(config_)},
                                                               {chopper_register, no_chopper},
                                                               {capacitor_register, with_capacitor},
                                                               {power_register, running & ~powered_up}}};
    for (const auto& setting : settings)
      if (auto done = chip.write(setting); !done) return done;
    step_ = Step::settling;
    return {};
  }

  Result<void> start(I2cDevice& chip) {
    if (step_ == Step::settling) {
      waited_ = 0;
      return {};
    }
    if (step_ == Step::calibrating && waited_ == 0)
      return chip.write_register(rate_register, rate_of(config_) | calibrate_offset);
    return {};
  }
  Duration conversion_time() const noexcept {
    using namespace std::chrono_literals;
    return step_ == Step::settling ? 250ms : step_ == Step::calibrating ? 50ms : 0ms;
  }
  bool goes_on() const noexcept { return goes_on_; }

  Reading<BridgeReading> read(I2cDevice& chip) {
    goes_on_ = false;
    if (step_ == Step::settling) {  // the supply of the bridge has come up
      step_ = Step::calibrating;
      goes_on_ = true;
      return nothing_new;
    }
    std::array<std::uint8_t, 3> settings{};
    if (auto done = chip.read_registers(power_register, settings); !done) return std::move(done).error();
    if (step_ == Step::calibrating) return calibrated(chip, settings);
    if ((settings[0] & ~sample_ready) != running || settings[1] != gain_of(config_) ||
        settings[2] != rate_of(config_)) {
      if (auto done = open(chip); !done) return std::move(done).error();
      return Unreadable{
          chip.error(Errc::bad_data, what, "it has lost its settings, and is set up again", "check its supply")};
    }
    const MonotonicTime now = Samples<BridgeReading>::now();
    if ((settings[0] & sample_ready) == 0) {
      if (now - last_ > longest_silence)
        return chip.error(Errc::timed_out, what, "it has stopped measuring", "check its supply");
      return nothing_new;
    }
    last_ = now;
    std::array<std::uint8_t, 3> bytes{};
    if (auto done = chip.read_registers(data_register, bytes); !done) return std::move(done).error();
    const std::int32_t code = decode(bytes);
    if (code >= most || code <= -most - 1)
      return Unreadable{chip.error(Errc::out_of_range, what, "the signal of the bridge is at the end of the range",
                                   "check its wires, or choose a smaller `gain`")};
    return tared(code);
  }

  /// The converter's code, of the three data registers.
  static std::int32_t decode(std::span<const std::uint8_t, 3> bytes) noexcept {
    return static_cast<std::int32_t>(static_cast<std::uint32_t>(bytes[0]) << 24 |
                                     static_cast<std::uint32_t>(bytes[1]) << 16 |
                                     static_cast<std::uint32_t>(bytes[2]) << 8) >>
           8;
  }
  /// mV/V of a code: the ends of the range are half of the reference, which is the bridge's supply, over the gain.
  static double ratio_of(std::int32_t code, unsigned gain) noexcept { return code * 500.0 / (most + 1) / gain; }

 private:
  enum class Step { settling, calibrating, running };

  Reading<BridgeReading> calibrated(I2cDevice& chip, std::span<const std::uint8_t, 3> settings) {
    constexpr unsigned longest_calibration = 20;  // times 50 ms
    if ((settings[2] & calibrate_offset) != 0) {
      goes_on_ = ++waited_ < longest_calibration;
      if (goes_on_) return nothing_new;
      step_ = Step::settling;
      return chip.error(Errc::timed_out, what, "its calibration does not end", "check its supply");
    }
    if ((settings[2] & calibration_failed) != 0) {
      step_ = Step::settling;
      return chip.error(Errc::bad_data, what, "its calibration has failed",
                        "check the supply of the chip and of the bridge");
    }
    std::array<std::uint8_t, 3> of_before{};  // discards a sample from before the calibration
    if (auto done = chip.read_registers(data_register, of_before); !done) return std::move(done).error();
    step_ = Step::running;
    last_ = Samples<BridgeReading>::now();
    return nothing_new;
  }
  BridgeReading tared(std::int32_t code) {
    BridgeReading reading;
    reading.raw = code;
    const double ratio = ratio_of(code, config_.gain);
    if (memory_.count < config_.tare_samples) {
      memory_.sum += ratio;
      ++memory_.count;
      return reading;
    }
    if (config_.tare_samples > 0) reading.tare = memory_.sum / memory_.count;
    reading.value = ratio - reading.tare.value_or(0);
    return reading;
  }

  static constexpr std::array<unsigned, 8> gains{1, 2, 4, 8, 16, 32, 64, 128};
  static constexpr std::array<unsigned, 8> data_rates{10, 20, 40, 80, 0, 0, 0, 320};  // 0: reserved
  static constexpr std::array<double, 8> supplies{4.5, 4.2, 3.9, 3.6, 3.3, 3.0, 2.7, 2.4};
  static std::uint8_t gain_of(const Config& config) noexcept {
    return static_cast<std::uint8_t>(detail::place_of(supplies, config.supply_voltage).value_or(5) << 3 |
                                     detail::place_of(gains, config.gain).value_or(7));
  }
  static std::uint8_t rate_of(const Config& config) noexcept {
    return static_cast<std::uint8_t>(detail::place_of(data_rates, config.data_rate).value_or(0) << 4);
  }

  static constexpr std::uint8_t power_register = 0x00, gain_register = 0x01, rate_register = 0x02;
  static constexpr std::uint8_t data_register = 0x12;
  static constexpr std::uint8_t chopper_register = 0x15, capacitor_register = 0x1c;
  // Power: internal supply, sample ready, cycling, powered up, analog on, digital on, reset.
  static constexpr std::uint8_t running = 0x9e, sample_ready = 0x20, powered_up = 0x08;
  static constexpr std::uint8_t digital_on = 0x02, reset = 0x01;
  static constexpr std::uint8_t calibration_failed = 0x08, calibrate_offset = 0x04;
  static constexpr std::uint8_t no_chopper = 0x30, with_capacitor = 0x80;
  static constexpr std::int32_t most = 0x7f'ffff;
  static constexpr Duration longest_silence = std::chrono::seconds{1};
  static constexpr const char* what = "cannot read the NAU7802";

  Config config_;
  Memory memory_;
  Step step_ = Step::settling;
  bool goes_on_ = false;
  unsigned waited_ = 0;
  MonotonicTime last_{};
};

}  // namespace rtdata
