// Bosch BMP280, data sheet BST-BMP280-DS001-26: 3.8.1 measurement time, 3.11.3 and 8.1 compensation, 4.3 registers.
#include "rtdata/sensors/bmp280.hpp"

#include <array>
#include <bit>
#include <string>

namespace rtdata {
namespace {

constexpr std::uint8_t calibration_register = 0x88;
constexpr std::uint8_t id_register = 0xd0;
constexpr std::uint8_t status_register = 0xf3;
constexpr std::uint8_t control_register = 0xf4;
constexpr std::uint8_t data_register = 0xf7;
constexpr std::uint8_t identity = 0x58;
constexpr std::uint8_t measuring = 0x08;
constexpr std::uint32_t skipped = 0x80000;  // what the data registers hold after a reset
constexpr std::uint8_t forced_mode = 1;
constexpr const char* what = "cannot read the BMP280";

bool is_oversampling(unsigned count) { return count >= 1 && count <= 16 && std::has_single_bit(count); }

/// 1 for one measurement, 2 for two, 3 for four ...
std::uint8_t oversampling_bits(unsigned count) { return static_cast<std::uint8_t>(std::bit_width(count)); }

std::uint8_t control_of(const Bmp280::Config& config) {
  return static_cast<std::uint8_t>(oversampling_bits(config.temperature_oversampling) << 5 |
                                   oversampling_bits(config.pressure_oversampling) << 2 | forced_mode);
}

}  // namespace

void check_config(const Bmp280::Config& config, const ConfigItem& item, Problems& problems) {
  const auto check = [&](unsigned count, const char* key) {
    const ConfigItem* at = item.find(key);
    if (!is_oversampling(count))
      problems.add(
          (at != nullptr ? *at : item).problem("bad-value", std::to_string(count) + " is none of 1, 2, 4, 8, 16"));
  };
  check(config.pressure_oversampling, "pressure_oversampling");
  check(config.temperature_oversampling, "temperature_oversampling");
}

Bmp280::Bmp280(const Config& config) : config_(config) {
  for (const unsigned count : {config.pressure_oversampling, config.temperature_oversampling}) {
    if (!is_oversampling(count))
      throw SetupError({Errc::bad_argument, "cannot use this oversampling", "BMP280",
                        std::to_string(count) + " was given", "it has 1, 2, 4, 8 and 16"});
  }
}

Result<void> Bmp280::open(I2cDevice& chip) {
  const Result<std::uint8_t> found = chip.read_register(id_register);
  if (!found) return found.error();
  if (*found != identity) {
    return chip.error(Errc::bad_data, "cannot use the chip as a BMP280",
                      "its identity is " + to_string(I2cAddress(*found)) + ", that of a BMP280 is 0x58",
                      *found == 0x60 ? "0x60 is a BME280" : "look at which chip is at this address");
  }
  std::array<std::uint8_t, 24> bytes{};
  if (auto done = chip.read_registers(calibration_register, bytes); !done) return done;
  calibration_ = Calibration::decode(bytes);
  if (calibration_.t1 == 0 || calibration_.p1 == 0)
    return chip.error(Errc::bad_data, "cannot use the BMP280", "its trimming parameters are 0", "the chip is damaged");
  return {};
}

Result<void> Bmp280::start(I2cDevice& chip) { return chip.write_register(control_register, control_of(config_)); }

Duration Bmp280::conversion_time() const noexcept {
  const auto us = 1250 + 2300 * config_.temperature_oversampling + 2300 * config_.pressure_oversampling + 575;
  return std::chrono::microseconds{us};
}

Reading<BarometerReading> Bmp280::read(I2cDevice& chip) {
  std::array<std::uint8_t, 10> bytes{};  // status, control, configuration, one that is none, and the data
  if (auto done = chip.read_registers(status_register, bytes); !done) return std::move(done).error();
  static_assert(data_register - status_register == 4);
  if ((bytes[0] & measuring) != 0)
    return chip.error(Errc::timed_out, what, "it measures still, longer than it may", "");
  constexpr std::uint8_t settings = 0xfc;  // of the control register; it returns to sleep by itself
  if ((bytes[1] & settings) != (control_of(config_) & settings)) {
    return Unreadable{
        chip.error(Errc::bad_data, what, "it has lost its settings since the start", "look at its supply")};
  }
  auto reading = decode(std::span<const std::uint8_t, 10>(bytes).subspan<4>(), calibration_);
  if (!reading) return Unreadable{chip.error(Errc::bad_data, what, reading.error().why, reading.error().advice)};
  return *reading;
}

Bmp280::Calibration Bmp280::Calibration::decode(std::span<const std::uint8_t, 24> bytes) noexcept {
  const auto word = [&](std::size_t at) { return static_cast<std::uint16_t>(bytes[at] | bytes[at + 1] << 8); };
  const auto signed_word = [&](std::size_t at) { return static_cast<std::int16_t>(word(at)); };
  return {word(0),         signed_word(2),  signed_word(4),  word(6),         signed_word(8),  signed_word(10),
          signed_word(12), signed_word(14), signed_word(16), signed_word(18), signed_word(20), signed_word(22)};
}

Result<BarometerReading> Bmp280::decode(std::span<const std::uint8_t, 6> bytes, const Calibration& c) {
  const auto twenty_bits = [&](std::size_t at) {
    return static_cast<std::uint32_t>(bytes[at]) << 12 | static_cast<std::uint32_t>(bytes[at + 1]) << 4 |
           static_cast<std::uint32_t>(bytes[at + 2]) >> 4;
  };
  const std::uint32_t pressure_code = twenty_bits(0), temperature_code = twenty_bits(3);
  const auto failure = [](const char* why) {
    return Error{Errc::bad_data, what, "", why, "it was reset, or is damaged"};
  };
  if (pressure_code == skipped || temperature_code == skipped) return failure("the measurement was skipped");
  const double t = temperature_code;
  const double t_coarse = (t / 16384 - c.t1 / 1024.0) * c.t2 +
                          (t / 131072 - c.t1 / 8192.0) * (t / 131072 - c.t1 / 8192.0) * c.t3;
  const double half = t_coarse / 2 - 64000;
  const double curved = (half * half * c.p6 / 32768 + half * c.p5 * 2) / 4 + c.p4 * 65536.0;
  const double slope = (1 + (c.p3 * half * half / 524288 + c.p2 * half) / 524288 / 32768) * c.p1;
  if (slope == 0) return failure("its trimming parameters give no pressure");
  const double raw = (1048576.0 - pressure_code - curved / 4096) * 6250 / slope;
  const double pressure = raw + (c.p9 * raw * raw / 2147483648.0 + raw * c.p8 / 32768 + c.p7) / 16;
  return BarometerReading{pressure, t_coarse / 5120};
}

}  // namespace rtdata
