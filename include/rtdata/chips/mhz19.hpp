/// MhZ19: the CO2 sensors MH-Z19, MH-Z19B and MH-Z19C of Winsen on a serial line.
///
///     rtdata::SerialPort port({.device = "/dev/ttyS0"});  // 9600 8N1
///     rtdata::DriverSensor<rtdata::MhZ19> air(loop, {.name = "air", .rate = 0.5_Hz}, port);
///
/// Each tick sends a request of nine bytes and reads an answer of nine, with a checksum. A reading is unreadable with a
/// wrong checksum, above 10000 ppm (the sensor's range), and at 0 ppm, which the sensor sends while it warms up. It
/// needs three minutes after power-on (MH-Z19C: one minute); other wrong values during that time are not recognisable.
///
/// Source: Winsen, MH-Z19B User's Manual V1.6, "UART output", command 0x86 and checksum.
///
/// Driver (driver.hpp): used on the port's lane.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/io/serial.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct Co2Reading {
  double co2 = 0;
  friend constexpr auto describe(type_tag<Co2Reading>) {
    return record("co2", field("co2", &Co2Reading::co2, "[ppm]"));
  }
};

class MhZ19 {
 public:
  static constexpr std::string_view type = "mhz19";
  static constexpr std::string_view description = "CO2 of a Winsen MH-Z19 on a serial line";
  static constexpr std::string_view notes = R"(
- Wiring: 5 V, ground, its TX to the board's RX, its RX to TX (3.3 V levels). The bus is a `serial` one with 9600 Bd.
- It has no address: connect only one to a line.
- It measures at most every 2 s: `"rate": "0.2 Hz"` is enough.
- It needs 3 minutes after switching on. Values of this time are wrong: 0 ppm is counted as unreadable; the chip does
  not mark the other values.
)";
  struct Config {
    friend constexpr auto parameters(type_tag<Config>) { return parameter_list(); }
  };
  using Value = Co2Reading;
  using Device = SerialDevice;
  static constexpr KnownChip chips[] = {{.name = "MH-Z19"}};
  static constexpr ChipSample samples[] = {{.wires = ChipWires::answers,
                                            .bytes = {{{"ff 01 86 00 00 00 00 00 79", "ff 86 02 60 47 00 00 00 d1"}}},
                                            .values = {{{"co2", 608}}},
                                            .has_proof = true}};
  explicit MhZ19(const Config&) {}
  /// Sends nothing: the port is open, and a sensor that warms up answers later.
  Result<void> open(SerialDevice&) { return {}; }

  Reading<Co2Reading> read(SerialDevice& line) {
    constexpr std::array<std::uint8_t, 9> request{0xff, 0x01, 0x86, 0, 0, 0, 0, 0, 0x79};
    std::array<std::uint8_t, 9> answer{};
    if (auto done = line.transact(request, answer); !done) return std::move(done).error();
    if (answer == request)
      return Unreadable{line.error(
          Errc::bad_data, "cannot read the MH-Z19", "it echoes the request",
          "switch off the echo of the adapter, or check that its RX and TX are not connected to each other")};
    Result<Co2Reading> reading = decode(answer);
    if (!reading) return Unreadable{at_place(line, reading.error())};
    return *reading;
  }

  /// The checksum of all bytes but the first and the last.
  static constexpr std::uint8_t checksum(std::span<const std::uint8_t, 9> bytes) noexcept {
    unsigned sum = 0;
    for (std::size_t i = 1; i < 8; ++i) sum += bytes[i];
    return static_cast<std::uint8_t>((256 - sum % 256) % 256);
  }
  /// `answer`: to command 0x86. Errors: bad-data.
  static Result<Co2Reading> decode(std::span<const std::uint8_t, 9> answer) {
    constexpr unsigned most = 10000;
    const auto refuse = [](std::string why) {
      return Error{Errc::bad_data, "cannot read the MH-Z19", "", std::move(why), "check its wires and its supply"};
    };
    if (answer[8] != checksum(answer)) return refuse("the checksum of its answer is wrong");
    if (answer[0] != 0xff || answer[1] != 0x86) return refuse("this is not the answer to the request");
    const unsigned ppm = static_cast<unsigned>(answer[2]) << 8 | answer[3];
    if (ppm == 0) return refuse("it reports 0 ppm, as it does while it warms up");
    if (ppm > most) return refuse(std::to_string(ppm) + " ppm is outside its range, 0 to 10000 ppm");
    return Co2Reading{static_cast<double>(ppm)};
  }
};

}  // namespace rtdata
