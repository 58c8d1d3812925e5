/// What the codes of barometers mean: compensation by the data sheets of Bosch's and TE's chips.
///
/// Values and pure functions; any thread. Sources: rtdata/chips/barometer.hpp.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

#include "rtdata/data/error.hpp"

namespace rtdata {

/// What a chip has measured, in Pa, degrees Celsius and percent.
struct AirMeasurement {
  double pressure = 0, temperature = 0;
  std::optional<double> humidity{};
};

/// Trimming parameters of BMP280 and BME280, and their compensation.
struct Bmp280Trimming {
  static constexpr std::uint8_t first_register = 0x88;
  std::uint16_t t1 = 0;
  std::int16_t t2 = 0, t3 = 0;
  std::uint16_t p1 = 0;
  std::int16_t p2 = 0, p3 = 0, p4 = 0, p5 = 0, p6 = 0, p7 = 0, p8 = 0, p9 = 0;
  std::uint8_t h1 = 0, h3 = 0;
  std::int16_t h2 = 0, h4 = 0, h5 = 0;
  std::int8_t h6 = 0;

  /// From registers 0x88 to 0x9f.
  static Bmp280Trimming decode(std::span<const std::uint8_t, 24> bytes) noexcept {
    const auto word = [&](std::size_t at) { return static_cast<std::uint16_t>(bytes[at] | bytes[at + 1] << 8); };
    const auto signed_word = [&](std::size_t at) { return static_cast<std::int16_t>(word(at)); };
    return {word(0),         signed_word(2),  signed_word(4),  word(6),         signed_word(8),  signed_word(10),
            signed_word(12), signed_word(14), signed_word(16), signed_word(18), signed_word(20), signed_word(22)};
  }
  /// Humidity of a BME280: register 0xa1, and 0xe1 to 0xe7.
  void decode_humidity(std::uint8_t first, std::span<const std::uint8_t, 7> bytes) noexcept {
    h1 = first;
    h2 = static_cast<std::int16_t>(static_cast<std::uint16_t>(bytes[0] | bytes[1] << 8));
    h3 = bytes[2];
    // Two signed values of 12 bits, which share one register for 4 bits each.
    h4 = static_cast<std::int16_t>(static_cast<std::int8_t>(bytes[3]) * 16 + (bytes[4] & 15));
    h5 = static_cast<std::int16_t>(static_cast<std::int8_t>(bytes[5]) * 16 + (bytes[4] >> 4));
    h6 = static_cast<std::int8_t>(bytes[6]);
  }
  bool is_usable() const noexcept { return t1 != 0 && p1 != 0; }

  /// From registers 0xf7 to 0xfc, of a BME280 to 0xfe. Errors: bad-data (a measurement was skipped).
  Result<AirMeasurement> measurement(std::span<const std::uint8_t> bytes) const {
    const auto twenty_bits = [&](std::size_t at) {
      return static_cast<std::uint32_t>(bytes[at]) << 12 | static_cast<std::uint32_t>(bytes[at + 1]) << 4 |
             static_cast<std::uint32_t>(bytes[at + 2]) >> 4;
    };
    constexpr std::uint32_t skipped = 0x80000, skipped_humidity = 0x8000;  // as after a reset
    const std::uint32_t pressure_code = twenty_bits(0), temperature_code = twenty_bits(3);
    const auto failure = [](const char* why) {
      return Error{Errc::bad_data, "cannot read the barometer", "", why,
                   "check its supply; if this repeats, the chip is damaged"};
    };
    if (pressure_code == skipped || temperature_code == skipped) return failure("the measurement was skipped");
    const double t = temperature_code;
    const double fine = (t / 16384 - t1 / 1024.0) * t2 + (t / 131072 - t1 / 8192.0) * (t / 131072 - t1 / 8192.0) * t3;
    const double half = fine / 2 - 64000;
    const double curved = (half * half * p6 / 32768 + half * p5 * 2) / 4 + p4 * 65536.0;
    const double slope = (1 + (p3 * half * half / 524288 + p2 * half) / 524288 / 32768) * p1;
    if (slope == 0) return failure("its trimming parameters give no pressure");
    const double raw = (1048576.0 - pressure_code - curved / 4096) * 6250 / slope;
    AirMeasurement result{raw + (p9 * raw * raw / 2147483648.0 + raw * p8 / 32768 + p7) / 16, fine / 5120, {}};
    if (bytes.size() < 8) return result;
    const auto humidity_code = static_cast<std::uint32_t>(bytes[6] << 8 | bytes[7]);
    if (humidity_code == skipped_humidity) return failure("the measurement of humidity was skipped");
    const double off = fine - 76800;
    const double dry = (humidity_code - (h4 * 64.0 + h5 / 16384.0 * off)) *
                       (h2 / 65536.0 * (1 + h6 / 67108864.0 * off * (1 + h3 / 67108864.0 * off)));
    result.humidity = std::clamp(dry * (1 - h1 * dry / 524288), 0.0, 100.0);
    return result;
  }
};

/// Trimming parameters of BMP388 and BMP390, and their compensation.
struct Bmp388Trimming {
  static constexpr std::uint8_t first_register = 0x31;
  double t1 = 0, t2 = 0, t3 = 0;
  double p1 = 0, p2 = 0, p3 = 0, p4 = 0, p5 = 0, p6 = 0, p7 = 0, p8 = 0, p9 = 0, p10 = 0, p11 = 0;

  /// From registers 0x31 to 0x45; scales: 9.1.
  static Bmp388Trimming decode(std::span<const std::uint8_t, 21> bytes) noexcept {
    const auto word = [&](std::size_t at) { return static_cast<std::uint16_t>(bytes[at] | bytes[at + 1] << 8); };
    const auto scaled = [](int number, int bits) { return std::ldexp(static_cast<double>(number), bits); };
    const auto word_by = [&](std::size_t at, int bits) { return scaled(word(at), bits); };
    const auto signed_by = [&](std::size_t at, int offset, int bits) {
      return scaled(static_cast<std::int16_t>(word(at)) - offset, bits);
    };
    const auto byte_by = [&](std::size_t at, int bits) { return scaled(static_cast<std::int8_t>(bytes[at]), bits); };
    return {
        word_by(0, 8),    word_by(2, -30),       byte_by(4, -48),  signed_by(5, 16384, -20), signed_by(7, 16384, -29),
        byte_by(9, -32),  byte_by(10, -37),      word_by(11, 3),   word_by(13, -6),          byte_by(15, -8),
        byte_by(16, -15), signed_by(17, 0, -48), byte_by(19, -48), byte_by(20, -65)};
  }
  bool is_usable() const noexcept { return t1 != 0 && t2 != 0; }

  /// From registers 0x04 to 0x09. Errors: bad-data (a measurement was skipped).
  Result<AirMeasurement> measurement(std::span<const std::uint8_t> bytes) const {
    const auto code = [&](std::size_t at) {
      return static_cast<std::uint32_t>(bytes[at] | bytes[at + 1] << 8 | bytes[at + 2] << 16);
    };
    constexpr std::uint32_t skipped = 0x800000;
    if (code(0) == skipped || code(3) == skipped)
      return Error{Errc::bad_data, "cannot read the barometer", "", "the measurement was skipped",
                   "check its supply; if this repeats, the chip is damaged"};
    const double p = code(0);
    const double from_first = code(3) - t1;
    const double t = from_first * t2 + from_first * from_first * t3;
    const double offset = p5 + p6 * t + p7 * t * t + p8 * t * t * t;
    const double slope = p1 + p2 * t + p3 * t * t + p4 * t * t * t;
    return AirMeasurement{offset + p * slope + p * p * (p9 + p10 * t) + p * p * p * p11, t, {}};
  }
};

/// What a BMP581 or BMP585 has compensated by itself: registers 0x1d to 0x22. Errors: bad-data (a measurement was
/// skipped).
inline Result<AirMeasurement> bmp581_measurement(std::span<const std::uint8_t, 6> bytes) {
  const auto code = [&](std::size_t at) { return bytes[at] | bytes[at + 1] << 8 | bytes[at + 2] << 16; };
  constexpr int skipped = 0x7f7f7f, sign = 0x800000;  // skipped: as after a reset
  if (code(0) == skipped || code(3) == skipped)
    return Error{Errc::bad_data, "cannot read the barometer", "", "the measurement was skipped",
                 "check its supply; if this repeats, the chip is damaged"};
  return AirMeasurement{code(3) / 64.0, ((code(0) ^ sign) - sign) / 65536.0, {}};
}

/// The eight words of an MS5611's PROM, and its compensation.
struct Ms5611Prom {
  std::array<std::uint16_t, 8> words{};

  /// AN520: computed over all words except the low byte of the last one; that byte's last four bits hold the checksum.
  std::uint8_t checksum() const noexcept {
    unsigned remainder = 0;
    for (unsigned i = 0; i < 16; ++i) {
      const unsigned word = i / 2 == 7 ? words[7] & 0xff00u : words[i / 2];
      remainder ^= i % 2 == 1 ? word & 0xff : word >> 8;
      for (int bit = 0; bit < 8; ++bit)
        remainder = ((remainder & 0x8000) != 0 ? remainder << 1 ^ 0x3000 : remainder << 1) & 0xffff;
    }
    return static_cast<std::uint8_t>(remainder >> 12);
  }
  /// The checksum of a PROM of zeros is correct, so zeros are refused separately.
  bool is_usable() const noexcept { return checksum() == (words[7] & 15) && words[1] != 0 && words[5] != 0; }

  /// Computes the measurement from the codes D1 (pressure) and D2 (temperature). Errors: bad-data (there was no
  /// conversion).
  Result<AirMeasurement> measurement(std::uint32_t pressure_code, std::uint32_t temperature_code) const {
    if (pressure_code == 0 || temperature_code == 0)  // "ADC read" without a conversion
      return Error{Errc::bad_data, "cannot read the barometer", "", "it has no measurement",
                   "check its supply: it was reset in the meantime"};
    const double difference = temperature_code - words[5] * 256.0;
    double hundredths = 2000 + difference * words[6] / 8388608;
    double offset = words[2] * 65536.0 + words[4] * difference / 128;
    double slope = words[1] * 32768.0 + words[3] * difference / 256;
    if (hundredths < 2000) {  // figure 3
      const double cold = (hundredths - 2000) * (hundredths - 2000);
      const double very = hundredths < -1500 ? (hundredths + 1500) * (hundredths + 1500) : 0;
      offset -= 5 * cold / 2 + 7 * very;
      slope -= 5 * cold / 4 + 11 * very / 2;
      hundredths -= difference * difference / 2147483648.0;
    }
    return AirMeasurement{(pressure_code * slope / 2097152 - offset) / 32768, hundredths / 100, {}};
  }
};

}  // namespace rtdata
