/// Ads1x15: analog-to-digital converters ADS1015 (12 bits) and ADS1115 (16 bits) of Texas Instruments on I2C.
///
///     rtdata::DriverSensor<rtdata::Ads1x15> adc(
///         loop, {.name = "adc", .rate = 10_Hz}, bus, {.address = 0x48},
///         {.channels = {{.name = "battery", .input = "0", .range = 4.096},
///                       {.name = "bridge", .input = "2-3", .range = 0.256}}});
///     loop.subscribe("adc", [](const rtdata::EventView& event) { ... });  // a record of battery and bridge, in V
///
/// Each tick converts the channels one after the other, each in a single shot with its own range; the bus is free for
/// others while the chip converts, and the chip sleeps between ticks. The event has the time at which the first
/// conversion began. One tick takes the number of channels divided by `data_rate`, plus a tenth; when the rate of the
/// sensor is faster than that, ticks are missed.
///
/// A code at an end of the range means that the input may be out of range: that channel has no value in the event, and
/// the reading is counted as unreadable. Whatever the range is, inputs must stay between ground and the supply: other
/// voltages damage the chip.
///
/// The chip has neither identity nor checksum. The driver reads the settings back before and after each conversion, so
/// it notices and reports a chip that was reset, or another chip. It recognises an ADS1115 that is used as an ADS1015
/// by the lower bits; it does not recognise an ADS1015 that is used as an ADS1115. Addresses: 0x48 to 0x4b.
///
/// Sources: ADS111x SBAS444D and ADS101x SBAS473E, data sheets: 7.4.2.1 single shot, 7.5.4 data format, 8.1.2 and 8.1.3
/// registers.
///
/// Driver (driver.hpp): used on the bus's lane. The kernel's own driver of these chips is used with `analog`.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/describe.hpp"
#include "rtdata/detail/chips/adc_channels.hpp"
#include "rtdata/detail/chips/choice.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

/// The voltages of the channels, in their order; their number and names are in the description of the events.
struct OptionalVoltages {
  std::array<std::optional<double>, detail::most_channels> voltages{};
};

enum class Ads1x15Model { ads1015, ads1115 };

class Ads1x15 {
 public:
  static constexpr std::string_view type = "ads1x15";
  static constexpr std::string_view aliases = "adc";
  static constexpr std::string_view
      description = "voltages by an ADS1015 or ADS1115 on I2C, with a range for each channel";
  static constexpr std::string_view notes = R"(
- Address by the pin ADDR: to GND 0x48, VDD 0x49, SDA 0x4a, SCL 0x4b.
- `input` is one of 0, 1, 2, 3 (against ground) and 0-1, 0-3, 1-3, 2-3 (the first minus the second).
- `range` is 6.144, 4.096, 2.048, 1.024, 0.512 or 0.256 V, plus or minus. No input may be above the supply voltage,
  whatever the range is. A channel at an end of its range has no value, and is counted as unreadable.
- Each channel is a field (`ain0`, `ain0_ain1` unless it has a `name`).
- The channels are converted one after the other: all together take the number of channels divided by `data_rate`, plus
  10 %.
- `data_rate`: ADS1115 8, 16, 32, 64, 128, 250, 475 or 860 a second; ADS1015 128, 250, 490, 920, 1600, 2400 or 3300.
- The chip has no identity: another chip at its address is detected because it does not keep these settings.
)";

  struct Channel {
    std::string name = {};    ///< name of the field; empty: made from the input
    std::string input = "0";  ///< "0" to "3", "0-1", "0-3", "1-3", "2-3"
    double range = 4.096;     ///< V, positive and negative
    friend constexpr auto parameters(type_tag<Channel>) {
      return parameter_list(
          parameter("name", &Channel::name, "name of the field; default: from the input, such as ain0", TextIs::field),
          parameter("input", &Channel::input, "one input against ground, or the first input minus the second",
                    choices("0", "1", "2", "3", "0-1", "0-3", "1-3", "2-3")),
          parameter("range", &Channel::range,
                    "measuring range, plus or minus: 6.144, 4.096, 2.048, 1.024, 0.512 or 0.256", unit("V")));
    }
  };
  struct Config {
    Ads1x15Model model = Ads1x15Model::ads1115;
    std::vector<Channel> channels = {};  ///< empty: each input against ground
    unsigned data_rate = 128;            ///< conversions a second
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(
          parameter("model", &Config::model, "which chip it is",
                    choices(value("ads1015", Ads1x15Model::ads1015), value("ads1115", Ads1x15Model::ads1115))),
          parameter("channels", &Config::channels,
                    "inputs to convert, in this order; empty: each input against ground"),
          parameter("data_rate", &Config::data_rate,
                    "conversions per second; fewer give less noise. ADS1115: 8 to 860; ADS1015: 128 to 3300",
                    unit("Hz")));
    }
  };
  using Value = OptionalVoltages;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x48};
  static constexpr KnownChip chips[] = {{.name = "ADS1115, ADS1015", .addresses = {0x48, 0x49, 0x4a, 0x4b}}};
  static constexpr ChipSample samples[] = {{.wires = ChipWires::word_registers,
                                            .bytes = {{{"00", "40 00"}, {"01", "80 00", 0x80}}},
                                            .values = {{{"ain0", 2.048}, {"ain3", 2.048}}},
                                            .has_proof = true}};

  static Result<void> check(const Config& config) {
    const auto refused = [](std::string where, const auto& value, std::string advice) {
      return Error{Errc::bad_argument, "cannot use these settings of the ADS1x15", std::move(where),
                   std::string(value) + " is not one of its values", std::move(advice)};
    };
    for (std::size_t i = 0; i < config.channels.size(); ++i) {
      if (const auto input = detail::find_input(inputs, config.channels[i].input, i); !input) return input.error();
      if (!detail::place_of(ranges, config.channels[i].range))
        return refused("channels[" + std::to_string(i) + "].range", std::to_string(config.channels[i].range),
                       "take 6.144, 4.096, 2.048, 1.024, 0.512 or 0.256");
    }
    if (!detail::place_of(of(config.model).data_rates, config.data_rate))
      return refused("data_rate", std::to_string(config.data_rate),
                     config.model == Ads1x15Model::ads1015 ? "take 128, 250, 490, 920, 1600, 2400 or 3300"
                                                           : "take 8, 16, 32, 64, 128, 250, 475 or 860");
    return {};
  }
  static Result<std::shared_ptr<const Description>> describe(const Config& config) {
    return detail::describe_channels(detail::chosen_or_all(config.channels, inputs, 4),
                                     DescriptionBuilder::Presence::optional);
  }

  explicit Ads1x15(const Config& config) : config_(config) {
    config_.channels = detail::chosen_or_all(config.channels, inputs, 4);
  }

  Result<void> open(I2cDevice& chip) {
    const std::uint16_t settings = settings_of(config_, config_.channels[0]);
    if (auto done = chip.write_word(settings_register, settings); !done) return done;
    const Result<std::uint16_t> kept = chip.read_word(settings_register);
    if (!kept) return kept.error();
    if ((*kept & ~ready) != settings)
      return chip.error(Errc::bad_data, "cannot use the chip as an ADS1x15", "it does not keep its settings",
                        "check which chip is at this address");
    return {};
  }

  Result<void> start(I2cDevice& chip) {
    if (!goes_on()) next_ = 0;
    if (next_ == 0) voltages_ = {}, mistakes_.clear();
    return restarted_after(chip.write_word(settings_register, settings_of(config_, config_.channels[next_]) | begin));
  }

  static Duration reading_time(const Config& config) {
    const Ads1x15 chip(config);
    return chip.conversion_time() * static_cast<Duration::rep>(chip.config_.channels.size());
  }
  /// The conversion of one channel with the slowest clock that the chip may have (-10 %), and waking up.
  Duration conversion_time() const noexcept {
    return std::chrono::nanoseconds{1'000'000'000 / config_.data_rate * 10 / 9} + std::chrono::microseconds{50};
  }

  bool goes_on() const noexcept { return next_ > 0 && next_ < config_.channels.size(); }

  Result<void> read(I2cDevice& chip, Samples<OptionalVoltages>& out) {
    const Channel& channel = config_.channels[next_];
    const Result<std::uint16_t> before = chip.read_word(settings_register);
    if (!before) return restarted_after(before.error());
    const Result<std::uint16_t> code = chip.read_word(conversion_register);
    if (!code) return restarted_after(code.error());
    const Result<std::uint16_t> after = chip.read_word(settings_register);
    if (!after) return restarted_after(after.error());
    const std::uint16_t settings = settings_of(config_, channel);
    if ((*before & ~ready) != settings || (*after & ~ready) != settings) {
      out.unreadable(chip.error(Errc::bad_data, what, "it has lost its settings since the start", "check its supply"));
      next_ = 0;
      return {};
    }
    if ((*before & ready) == 0)
      return restarted_after(chip.error(Errc::timed_out, what, "the conversion takes too long"));
    const Result<double> voltage = decode(config_.model, *code, channel.range);
    if (voltage) {
      voltages_.voltages[next_] = *voltage;
    } else {
      mistakes_.push_back(at_place(chip, voltage.error()));
      mistakes_.back().why = detail::field_of(channel) + ": " + mistakes_.back().why;
    }
    if (++next_ < config_.channels.size()) return {};
    if (mistakes_.size() < config_.channels.size()) out.add(voltages_);
    for (Error& mistake : mistakes_) out.unreadable(std::move(mistake));
    return {};
  }

  /// The settings register for a channel, without the bit that begins a conversion.
  static std::uint16_t settings_of(const Config& config, const Channel& channel) noexcept {
    const auto input = static_cast<std::size_t>(std::find(inputs.begin(), inputs.end(), channel.input) -
                                                inputs.begin());
    return static_cast<std::uint16_t>(
        multiplexer[input] << 12 | detail::place_of(ranges, channel.range).value_or(1) << 9 | single_shot |
        detail::place_of(of(config.model).data_rates, config.data_rate).value_or(4) << 5 | own_mark | no_comparator);
  }
  /// Converts the conversion register to volts. Errors: out-of-range (a code at an end of the range), bad-data (a code
  /// of the other model).
  static Result<double> decode(Ads1x15Model model, std::uint16_t word, double range) {
    const int code = static_cast<std::int16_t>(word);
    const int step = of(model).step;
    if (code % step != 0)
      return Error{Errc::bad_data, what, "", "its values have more than the 12 bits of an ADS1015",
                   "set `model` to ads1115"};
    if (code >= 32768 - step || code == -32768)
      return Error{Errc::out_of_range, what, "", "the voltage is at the end of its range", "choose a larger `range`"};
    return code * range / 32768;
  }

 private:
  struct Model {
    std::array<unsigned, 8> data_rates;
    int step;  // of the codes in the register
  };
  static const Model& of(Ads1x15Model model) noexcept {
    static constexpr Model models[] = {{{128, 250, 490, 920, 1600, 2400, 3300, 3300}, 16},
                                       {{8, 16, 32, 64, 128, 250, 475, 860}, 1}};
    return models[static_cast<std::size_t>(model)];
  }
  /// The next start begins with the first channel.
  Result<void> restarted_after(Result<void> result) {
    if (!result) next_ = 0;
    return result;
  }

  static constexpr std::array<std::string_view, 8> inputs{"0", "1", "2", "3", "0-1", "0-3", "1-3", "2-3"};
  static constexpr std::array<unsigned, 8> multiplexer{4, 5, 6, 7, 0, 1, 2, 3};
  static constexpr std::array<double, 6> ranges{6.144, 4.096, 2.048, 1.024, 0.512, 0.256};
  static constexpr std::uint8_t conversion_register = 0, settings_register = 1;
  static constexpr std::uint16_t begin = 0x8000, ready = 0x8000;  // the same bit: written to begin, read when ready
  static constexpr std::uint16_t single_shot = 0x0100, no_comparator = 0x0003;
  // The bit "latching comparator" has no effect here. The driver sets it; a reset clears it, which shows the reset.
  static constexpr std::uint16_t own_mark = 0x0004;
  static constexpr const char* what = "cannot read the ADS1x15";

  Config config_;
  std::size_t next_ = 0;  // the channel that is converted
  OptionalVoltages voltages_;
  std::vector<Error> mistakes_;
};

}  // namespace rtdata
