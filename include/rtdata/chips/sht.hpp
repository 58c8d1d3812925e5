/// Sht: thermometers and hygrometers SHT30, SHT31, SHT35 and SHT40, SHT41, SHT45 of Sensirion on I2C.
///
///     rtdata::DriverSensor<rtdata::Sht> room(loop, {.name = "room", .rate = 1_Hz}, bus, {.address = 0x44},
///                                            {.model = rtdata::ShtModel::sht3x});
///
/// Each tick starts one measurement of high repeatability and reads it when the chip has had its time (SHT3x 16 ms,
/// SHT4x 9 ms); the bus is free for others meanwhile, and the event has the time of the start. Both numbers have a
/// checksum: a reading with a wrong one is unreadable. When it opens, the driver reads the status of an SHT3x or the
/// serial number of an SHT4x, which have checksums too: another chip, or the other model, is an error. Addresses: 0x44
/// and 0x45 (SHT4x: 0x44 to 0x46). The SHT4x gives humidities from -6 to 119 %, which are limited to 0 and 100 %, as
/// its data sheet has it (4.6).
///
/// Sources: Sensirion SHT3x-DIS, data sheet of December 2022: table 4 measurement time, 4.3 single shot, 4.11 status,
/// 4.12 checksum, 4.13 conversion. SHT4x, data sheet of March 2022: table 4 time, 4.5 commands, 4.6 conversion.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/detail/chips/sensirion.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct HumidityReading {
  double temperature = 0;
  double humidity = 0;  ///< relative
  friend constexpr auto describe(type_tag<HumidityReading>) {
    return record("humidity", field("temperature", &HumidityReading::temperature, "Cel"),
                  field("humidity", &HumidityReading::humidity, "%"));
  }
};

enum class ShtModel { sht3x, sht4x };

class Sht {
 public:
  static constexpr std::string_view type = "sht";
  static constexpr std::string_view aliases = "hygrometer";
  static constexpr std::string_view description = "temperature and humidity of an SHT3x or SHT4x on I2C";
  static constexpr std::string_view notes = R"(
- Addresses: SHT3x 0x44, with the pin ADDR at the supply 0x45; SHT4x 0x44, 0x45 or 0x46 by its type.
- One measurement takes 16 ms (SHT4x: 9 ms), during which the bus is free for other chips. More than two measurements
  per second warm the chip.
- Each number has a checksum. The answer at opening has one too; it shows whether this is another chip or the other
  model.
)";
  struct Config {
    ShtModel model = ShtModel::sht3x;
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(parameter("model", &Config::model, "sht3x: SHT30, SHT31, SHT35; sht4x: SHT40, SHT41, SHT45",
                                      choices(value("sht3x", ShtModel::sht3x), value("sht4x", ShtModel::sht4x))));
    }
  };
  using Value = HumidityReading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x44};
  static constexpr KnownChip chips[] = {{.name = "SHT3x", .model = "sht3x", .addresses = {0x44, 0x45}},
                                        {.name = "SHT4x", .model = "sht4x", .addresses = {0x44, 0x45, 0x46}}};
  static constexpr ChipSample samples[] = {{.wires = ChipWires::answers,
                                            .bytes = {{{"f3 2d", "80 10 e1"}, {"24 00", "66 66 93 66 66 93"}}},
                                            .values = {{{"temperature", 25}, {"humidity", 40}}},
                                            .has_proof = true},
                                           {.members = R"("model": "sht4x")",
                                            .wires = ChipWires::answers,
                                            .bytes = {{{"89", "be ef 92"}, {"fd", "66 66 93 66 66 93"}}},
                                            .values = {{{"temperature", 25}, {"humidity", 44}}},
                                            .has_proof = true}};
  explicit Sht(const Config& config) : config_(config) {}

  Result<void> open(I2cDevice& chip) {
    constexpr std::array<std::uint8_t, 2> status{0xf3, 0x2d};
    constexpr std::array<std::uint8_t, 1> serial_number{0x89};
    std::array<std::uint8_t, 3> bytes{};
    const auto asked = config_.model == ShtModel::sht3x ? chip.write(status) : chip.write(serial_number);
    if (!asked) return asked;
    chip.wait(std::chrono::milliseconds{1});
    if (auto done = chip.read(bytes); !done) return done;
    if (checksum(std::span(bytes).first<2>()) != bytes[2])
      return chip.error(Errc::bad_data, "cannot use the chip as a hygrometer",
                        "the answer with its identity has a wrong checksum",
                        "check which chip is at this address, and `model`");
    return {};
  }
  Result<void> start(I2cDevice& chip) {
    constexpr std::array<std::uint8_t, 2> of_sht3x{0x24, 0x00};  // without clock stretching
    constexpr std::array<std::uint8_t, 1> of_sht4x{0xfd};
    return config_.model == ShtModel::sht3x ? chip.write(of_sht3x) : chip.write(of_sht4x);
  }
  static Duration reading_time(const Config& config) { return Sht(config).conversion_time(); }
  Duration conversion_time() const noexcept {
    using namespace std::chrono_literals;
    return config_.model == ShtModel::sht3x ? 16ms : 9ms;
  }
  Reading<HumidityReading> read(I2cDevice& chip) {
    std::array<std::uint8_t, 6> bytes{};
    if (auto done = chip.read(bytes); !done) return std::move(done).error();
    auto reading = decode(bytes, config_.model);
    if (!reading) return Unreadable{chip.error(Errc::bad_data, what, reading.error().why, reading.error().advice)};
    return *reading;
  }

  /// Polynomial 0x31, begun with 0xff (data sheet of the SHT3x, 4.12): 0x92 for 0xbe, 0xef.
  static std::uint8_t checksum(std::span<const std::uint8_t, 2> bytes) noexcept {
    return detail::sensirion_checksum(bytes);
  }
  /// `bytes`: temperature, checksum, humidity, checksum. Errors: bad-data (a checksum).
  static Result<HumidityReading> decode(std::span<const std::uint8_t, 6> bytes, ShtModel model) {
    if (checksum(bytes.subspan<0, 2>()) != bytes[2] || checksum(bytes.subspan<3, 2>()) != bytes[5])
      return Error{Errc::bad_data, what, "", "a checksum is wrong", "check its wires, and `model`"};
    const auto fraction = [&](std::size_t at) { return (bytes[at] << 8 | bytes[at + 1]) / 65535.0; };
    const double temperature = -45 + 175 * fraction(0);
    const double share = fraction(3);
    return HumidityReading{temperature,
                           std::clamp(model == ShtModel::sht3x ? 100 * share : 125 * share - 6, 0.0, 100.0)};
  }

 private:
  static constexpr const char* what = "cannot read the hygrometer";
  Config config_;
};

}  // namespace rtdata
