/// Sps30: particles in the air by an SPS30 of Sensirion on I2C.
///
///     rtdata::DriverSensor<rtdata::Sps30> dust(loop, {.name = "dust", .rate = 1_Hz}, bus);
///
/// The chip measures by itself, once a second; a tick reads what is new. A tick before that is counted as repeated; no
/// measurement for 15 s is an error (its fan cleans itself for 10 s, once a week, and gives nothing new then). All
/// words have a checksum: a reading with a wrong one is unreadable, and so is one during which the chip reports that
/// its laser or its fan fails (of firmware 2.2 and newer). Ranges: mass 0 to 1000 ug/m3, number 0 to 3000 /cm3.
///
/// Opening reads the version of the firmware, whose checksum shows whether it is another chip, and starts fan and
/// laser, which stop when the sensor stops. Address: 0x69.
///
/// Source: Sensirion SPS30, data sheet V1.0 of March 2020: 4.1 and 4.2 start and stop, 4.3 data ready, 4.4 values,
/// "device status register", 6.1 and 6.2 commands and checksum.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <array>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/detail/chips/sensirion.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

/// Of the particles from 0.3 um up to the size in the name.
struct ParticleReading {
  double mass_1_0 = 0, mass_2_5 = 0, mass_4_0 = 0, mass_10 = 0;
  double number_0_5 = 0, number_1_0 = 0, number_2_5 = 0, number_4_0 = 0, number_10 = 0;
  double typical_size = 0;
  friend constexpr auto describe(type_tag<ParticleReading>) {
    return record(
        "particles", field("mass_1_0", &ParticleReading::mass_1_0, "ug/m3"),
        field("mass_2_5", &ParticleReading::mass_2_5, "ug/m3"), field("mass_4_0", &ParticleReading::mass_4_0, "ug/m3"),
        field("mass_10", &ParticleReading::mass_10, "ug/m3"), field("number_0_5", &ParticleReading::number_0_5, "/cm3"),
        field("number_1_0", &ParticleReading::number_1_0, "/cm3"),
        field("number_2_5", &ParticleReading::number_2_5, "/cm3"),
        field("number_4_0", &ParticleReading::number_4_0, "/cm3"),
        field("number_10", &ParticleReading::number_10, "/cm3"),
        field("typical_size", &ParticleReading::typical_size, "um"));
  }
};

class Sps30 {
 public:
  static constexpr std::string_view type = "sps30";
  static constexpr std::string_view aliases = "dust particles pm25 pm10";
  static constexpr std::string_view description = "particles in the air (PM1, PM2.5, PM4, PM10) of an SPS30 on I2C";
  static constexpr std::string_view notes = R"(
- Wires: 5 V, ground, SDA, SCL (3.3 V levels), the pin SEL to ground. One address: 0x69. To 100 kHz.
- It measures once a second by itself. A reading before the next measurement is counted as repeated.
- `mass_2_5` is PM2.5. Each field counts the particles from 0.3 um up to its size.
- After a start it needs 8 s, in clean air 30 s, for its full accuracy; the chip does not mark the values of that time.
- Once a week its fan cleans itself for 10 s, without a new value.
- Firmware 2.2 and newer reports a laser or a fan that fails: its readings are then counted as unreadable.
)";
  struct Config {
    friend constexpr auto parameters(type_tag<Config>) { return parameter_list(); }
  };
  using Value = ParticleReading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x69};
  static constexpr KnownChip chips[] = {{.name = "SPS30", .addresses = {0x69}}};
  // 1, 2, 3, 4 ug/m3, 5, 6, 7, 8, 9 /cm3 and 0.5 um, as numbers of 32 bits.
  static constexpr ChipSample samples[] = {
      {.wires = ChipWires::answers,
       .bytes = {{{"d1 00", "02 02 3a"},
                  {"02 02", "00 01 b0"},
                  {"d2 06", "00 00 81 00 00 81"},
                  {"03 00",
                   "3f 80 d0 00 00 81 40 00 08 00 00 81 40 40 35 00 00 81 40 80 72 00 00 81 40 a0 f4 00 00 81 "
                   "40 c0 4f 00 00 81 40 e0 c9 00 00 81 41 00 fc 00 00 81 41 10 bf 00 00 81 3f 00 aa 00 00 81"}}},
       .values = {{{"mass_2_5", 2}, {"mass_10", 4}, {"number_10", 9}, {"typical_size", 0.5}}},
       .has_proof = true}};
  explicit Sps30(const Config&) {}
  static Duration bus_time(const Config&) { return 2 * command_time; }

  Result<void> open(I2cDevice& chip) {
    const auto answer = ask<3>(chip, version);
    if (!answer) return answer.error();
    const auto words = detail::sensirion_words(*answer);
    if (!words)
      return chip.error(Errc::bad_data, "cannot use the chip as an SPS30", "its version has a wrong checksum",
                        "check which chip is at this address, and its wires");
    constexpr std::uint16_t first_with_status = 0x0202;
    has_status_ = (*words)[0] >= first_with_status;
    constexpr std::uint16_t as_floating_point = 0x0300;
    if (auto done = chip.write(detail::sensirion_command(start_measuring, as_floating_point)); !done) return done;
    last_ = Samples<ParticleReading>::now();
    return {};
  }
  void close(I2cDevice& chip) { (void)chip.write(detail::sensirion_command(stop_measuring)); }

  Reading<ParticleReading> read(I2cDevice& chip) {
    const auto state = ask<3>(chip, data_ready);
    if (!state) return state.error();
    const auto ready = detail::sensirion_words(*state);
    if (!ready) return unreadable(chip, "a checksum is wrong", "check its wires");
    const MonotonicTime now = Samples<ParticleReading>::now();
    if (((*ready)[0] & 0xff) == 0) {
      if (now - last_ > longest_silence)
        return chip.error(Errc::timed_out, what, "it has stopped measuring", "check its supply");
      return nothing_new;
    }
    if (has_status_) {
      const auto bytes = ask<6>(chip, status);
      if (!bytes) return bytes.error();
      const auto words = detail::sensirion_words(*bytes);
      if (!words) return unreadable(chip, "a checksum is wrong", "check its wires");
      const auto flags = static_cast<std::uint32_t>((*words)[0]) << 16 | (*words)[1];
      if ((flags & laser_fails) != 0) return unreadable(chip, "its laser fails", "the chip is damaged, or too warm");
      if ((flags & fan_fails) != 0)
        return unreadable(chip, "its fan does not turn", "clean it; if that does not help, it is damaged");
      if ((flags & fan_off_speed) != 0)
        return unreadable(chip, "its fan turns too fast or too slowly", "check its supply of 5 V; let it warm up");
    }
    const auto bytes = ask<60>(chip, read_values);
    if (!bytes) return bytes.error();
    last_ = now;
    const auto words = detail::sensirion_words(*bytes);
    if (!words) return unreadable(chip, "a checksum is wrong", "check its wires");
    const auto reading = decode(*words);
    if (!reading) return unreadable(chip, reading.error().why, reading.error().advice);
    return *reading;
  }

  /// `words`: ten numbers of 32 bits (IEEE 754), the high word first. Errors: bad-data (no amount of particles).
  static Result<ParticleReading> decode(const std::array<std::uint16_t, 20>& words) {
    std::array<double, 10> numbers{};
    for (std::size_t i = 0; i < numbers.size(); ++i) {
      numbers[i] = std::bit_cast<float>(static_cast<std::uint32_t>(words[2 * i]) << 16 | words[2 * i + 1]);
      if (!(numbers[i] >= 0) || std::isinf(numbers[i]))
        return Error{Errc::bad_data, what, "", "it gives a number that cannot be an amount of particles",
                     "switch it off and on"};
    }
    return ParticleReading{numbers[0], numbers[1], numbers[2], numbers[3], numbers[4],
                           numbers[5], numbers[6], numbers[7], numbers[8], numbers[9]};
  }

 private:
  template <std::size_t size>
  static Result<std::array<std::uint8_t, size>> ask(I2cDevice& chip, std::uint16_t command) {
    std::array<std::uint8_t, size> bytes{};
    if (auto done = chip.write(detail::sensirion_command(command)); !done) return std::move(done).error();
    chip.wait(command_time);
    if (auto done = chip.read(bytes); !done) return std::move(done).error();
    return bytes;
  }
  static Unreadable unreadable(const I2cDevice& chip, std::string why, std::string advice) {
    return Unreadable{chip.error(Errc::bad_data, what, std::move(why), std::move(advice))};
  }
  static constexpr std::uint16_t start_measuring = 0x0010, stop_measuring = 0x0104, data_ready = 0x0202;
  static constexpr std::uint16_t read_values = 0x0300, version = 0xd100, status = 0xd206;
  static constexpr std::uint32_t fan_fails = 1u << 4, laser_fails = 1u << 5, fan_off_speed = 1u << 21;
  static constexpr Duration command_time = std::chrono::milliseconds{5};
  static constexpr Duration longest_silence = std::chrono::seconds{15};
  static constexpr const char* what = "cannot read the SPS30";

  bool has_status_ = false;
  MonotonicTime last_{};
};

}  // namespace rtdata
