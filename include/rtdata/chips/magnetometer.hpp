/// Magnetometer: magnetic flux density of a LIS3MDL, LSM9DS1, AK8963 (in an MPU-9250), HMC5883L or QMC5883L on I2C;
/// of a LIS3MDL or LSM9DS1 on SPI, too.
///
///     rtdata::DriverSensor<rtdata::Magnetometer> compass(loop, {.name = "compass", .rate = 50_Hz}, bus,
///                                                        {.address = 0x1c},
///                                                        {.model = rtdata::MagnetometerModel::lis3mdl});
///
/// The chip measures by itself, `sample_rate` times a second, and keeps the newest sample only: each tick reads it;
/// without a new sample since the last tick there is no event (an HMC5883L cannot tell and gives the same value again).
/// The event has the time of the reading. Axes are those in the data sheet; the axes of an LSM9DS1 and of an AK8963
/// differ from those of the accelerometer in the same package.
///
/// A field out of range is unreadable (out-of-range). A chip that has lost its settings is reported and set up again; a
/// chip that gives no more samples is an error (timed-out). The driver refuses a chip with another identity.
///
/// Sources: LIS3MDL, DocID024204: table 3 scales, 5.1 addresses that go on, 7.1 to 7.9 registers. LSM9DS1, DocID025715:
/// table 3 scales, 8.1 to 8.10 registers. AK8963, MS1356-E-02: 6.3 modes, 8.3 registers, 8.3.11 adjustment. HMC5883L,
/// 900405 rev. E: tables 5 to 17 registers, pointer and identity. QMC5883L, 13-52-04 rev. A: 9.2 registers.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "rtdata/data/describe.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/io/registers.hpp"
#include "rtdata/io/spi.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct MagnetometerReading {
  double magnetic_field_x = 0, magnetic_field_y = 0, magnetic_field_z = 0;  ///< flux density; the earth's: 25 to 65 uT
  std::optional<double> temperature{};                                      ///< of a LIS3MDL
  friend constexpr auto describe(type_tag<MagnetometerReading>) {
    return record("magnetometer", field("magnetic_field_x", &MagnetometerReading::magnetic_field_x, "T"),
                  field("magnetic_field_y", &MagnetometerReading::magnetic_field_y, "T"),
                  field("magnetic_field_z", &MagnetometerReading::magnetic_field_z, "T"),
                  field("temperature", &MagnetometerReading::temperature, "Cel"));
  }
};

enum class MagnetometerModel { lis3mdl, lsm9ds1, ak8963, hmc5883l, qmc5883l };

/// The models, in the order of `MagnetometerModel`. A new chip of this kind is an entry.
namespace magnetometer_models {

using namespace std::chrono_literals;

struct SampleRate {
  double hertz;
  std::uint8_t code;
};
struct FieldRange {
  double gauss;
  std::uint8_t code;
  double counts_per_gauss;
};
/// A register that is written: `value`, and the codes of the settings times their factors.
struct Setting {
  std::uint8_t number, value = 0;
  std::uint8_t by_rate = 0, by_range = 0;
  Duration pause = Duration{0};  ///< that the chip needs afterwards
  int read_at = -1;              ///< position in a reading where the value must read back; -1: not read back
};
/// Registers that are read in one transfer.
struct Piece {
  std::uint8_t first;
  std::size_t count;
};
struct Bit {
  std::size_t at;
  std::uint8_t mask = 0;  ///< 0: the chip has no such bit
};
struct Model {
  KnownChip chip;
  std::span<const SampleRate> rates;
  std::span<const FieldRange> ranges;
  double usual_range;  ///< gauss
  std::span<const Setting> setting_up;
  Setting sleeping;
  std::array<Piece, 2> pieces;  ///< of a reading, one after the other; an empty one is unused
  Bit is_new, is_over;          ///< in a reading
  std::array<std::size_t, 3> axes;
  bool is_big_endian = false;
  std::array<int, 2> ends = {-32768, 32767};  ///< codes at these limits or beyond are out of range
  int temperature_at = -1;                    ///< -1: it has none
  RegisterAddressing addressing = {};
  std::uint8_t adjustment_register = 0;  ///< of the axes' factors, read in a special mode; 0: none
};

// LIS3MDL, and the magnetometer of an LSM9DS1: temperature, best performance, rate; range; all the time; best
// performance of Z; samples that change as a whole. Register addresses auto-increment when bit 7 is set.
inline constexpr SampleRate lis3mdl_rates[] = {{0.625, 0}, {1.25, 1}, {2.5, 2}, {5, 3},
                                               {10, 4},    {20, 5},   {40, 6},  {80, 7}};
inline constexpr FieldRange lis3mdl_ranges[] = {{4, 0, 6842}, {8, 1, 3421}, {12, 2, 2281}, {16, 3, 1711}};
inline constexpr FieldRange lsm9ds1_ranges[] = {
    {4, 0, 1 / 0.14e-3}, {8, 1, 1 / 0.29e-3}, {12, 2, 1 / 0.43e-3}, {16, 3, 1 / 0.58e-3}};
inline constexpr Setting lis3mdl_setting_up[] = {{.number = 0x21, .value = 0x04, .pause = 10ms},
                                                 {.number = 0x20, .value = 0xe0, .by_rate = 1 << 2, .read_at = 0},
                                                 {.number = 0x21, .by_range = 1 << 5, .read_at = 1},
                                                 {.number = 0x23, .value = 0x0c, .read_at = 3},
                                                 {.number = 0x24, .value = 0x40, .read_at = 4},
                                                 {.number = 0x22, .value = 0x00, .read_at = 2}};
constexpr Model lis3mdl(std::string_view name, std::string_view model, std::span<const FieldRange> ranges,
                        int temperature_at) {
  return {.chip = {.name = name, .model = model, .addresses = {0x1c, 0x1e}, .identity = {{0x0f, 0x3d}}},
          .rates = lis3mdl_rates,
          .ranges = ranges,
          .usual_range = 4,
          .setting_up = lis3mdl_setting_up,
          .sleeping = {.number = 0x22, .value = 0x03},
          .pieces = {{{0x20, 16}, {0, 0}}},
          .is_new = {7, 0x08},
          .is_over = {},
          .axes = {8, 10, 12},
          .temperature_at = temperature_at,
          .addressing = {.i2c_burst_bit = 0x80, .spi_burst_bit = 0x40}};
}

// AK8963: off; continuous at 8 or 100 Hz, with 16 bits. Reading the second status register releases the next sample.
inline constexpr SampleRate ak8963_rates[] = {{8, 2}, {100, 6}};
inline constexpr FieldRange ak8963_ranges[] = {{49.12, 0, 1 / 1.5e-3}};
inline constexpr Setting ak8963_setting_up[] = {{.number = 0x0b, .value = 0x01, .pause = 1ms},
                                                {.number = 0x0a, .value = 0x00, .pause = 1ms},
                                                {.number = 0x0a, .value = 0x10, .by_rate = 1, .read_at = 8}};

// HMC5883L: average of 8; the identity is "H43". After the last data register the address returns to the first.
inline constexpr SampleRate hmc5883l_rates[] = {{0.75, 0}, {1.5, 1}, {3, 2}, {7.5, 3}, {15, 4}, {30, 5}, {75, 6}};
inline constexpr FieldRange hmc5883l_ranges[] = {{0.88, 0, 1370}, {1.3, 1, 1090}, {1.9, 2, 820}, {2.5, 3, 660},
                                                 {4.0, 4, 440},   {4.7, 5, 390},  {5.6, 6, 330}, {8.1, 7, 230}};
inline constexpr Setting hmc5883l_setting_up[] = {{.number = 0x00, .value = 0x60, .by_rate = 1 << 2, .read_at = 0},
                                                  {.number = 0x01, .by_range = 1 << 5, .read_at = 1},
                                                  {.number = 0x02, .value = 0x00, .pause = 10ms, .read_at = 2}};

// QMC5883L: reset; the set/reset period of the data sheet; continuous, 512 measurements a sample. Its identity equals
// what an empty bus reads, so only reading back the settings proves that the chip is there.
inline constexpr SampleRate qmc5883l_rates[] = {{10, 0}, {50, 1}, {100, 2}, {200, 3}};
inline constexpr FieldRange qmc5883l_ranges[] = {{2, 0, 12000}, {8, 1, 3000}};
inline constexpr Setting qmc5883l_setting_up[] = {
    {.number = 0x0a, .value = 0x80, .pause = 1ms},
    {.number = 0x0a, .value = 0x00, .read_at = 4},
    {.number = 0x0b, .value = 0x01},
    {.number = 0x09, .value = 0x01, .by_rate = 1 << 2, .by_range = 1 << 4, .read_at = 3}};

inline constexpr Model all[] = {
    lis3mdl("LIS3MDL", "lis3mdl", lis3mdl_ranges, 14),
    lis3mdl("LSM9DS1's magnetometer", "lsm9ds1", lsm9ds1_ranges, -1),
    {.chip = {.name = "AK8963", .model = "ak8963", .addresses = {0x0c}, .identity = {{0x00, 0x48}}},
     .rates = ak8963_rates,
     .ranges = ak8963_ranges,
     .usual_range = 49.12,
     .setting_up = ak8963_setting_up,
     .sleeping = {.number = 0x0a},
     .pieces = {{{0x02, 9}, {0, 0}}},
     .is_new = {0, 0x01},
     .is_over = {7, 0x08},
     .axes = {1, 3, 5},
     .addressing = {.without_spi = "AK8963"},
     .adjustment_register = 0x10},
    {.chip = {.name = "HMC5883L", .model = "hmc5883l", .addresses = {0x1e}, .identity = {{0x0a, 0x483433, 0xffffff}}},
     .rates = hmc5883l_rates,
     .ranges = hmc5883l_ranges,
     .usual_range = 1.3,
     .setting_up = hmc5883l_setting_up,
     .sleeping = {.number = 0x02, .value = 0x02},
     .pieces = {{{0x00, 9}, {0, 0}}},
     .is_new = {},
     .is_over = {},
     .axes = {3, 7, 5},
     .is_big_endian = true,
     .ends = {-4096, 4096},
     .addressing = {.without_spi = "HMC5883L"}},
    {.chip = {.name = "QMC5883L", .model = "qmc5883l", .addresses = {0x0d}, .identity = {{0x0d, 0xff}}},
     .rates = qmc5883l_rates,
     .ranges = qmc5883l_ranges,
     .usual_range = 2,
     .setting_up = qmc5883l_setting_up,
     .sleeping = {.number = 0x09},
     .pieces = {{{0x06, 5}, {0x00, 6}}},
     .is_new = {0, 0x01},
     .is_over = {0, 0x02},
     .axes = {5, 7, 9},
     .addressing = {.without_spi = "QMC5883L"}}};

}  // namespace magnetometer_models

class Magnetometer {
 public:
  static constexpr std::string_view type = "magnetometer";
  static constexpr std::string_view aliases = "compass magnetic gy-271 gy-273";
  static constexpr std::string_view description =
      "magnetic flux density of a LIS3MDL, LSM9DS1, AK8963 (MPU-9250), HMC5883L or QMC5883L on I2C, of the first two "
      "on SPI, too";
  static constexpr std::string_view notes =
      R"(- Wires: 3.3 V, ground, SDA, SCL. Addresses: LIS3MDL and LSM9DS1 0x1c, with SDO (SA1, SDO_M) high 0x1e; AK8963 0x0c;
  HMC5883L 0x1e; QMC5883L 0x0d. Boards that are sold as HMC5883L mostly have a QMC5883L. A LIS3MDL or LSM9DS1 on
  SPI: SDO, SDI (SDA), SCK (SCL), CS; `chip_select` in place of `address`; to 10 MHz.
- An AK8963 is inside an MPU-9250, which connects it to the bus as soon as a sensor of type `imu` with the model
  `mpu9250` has been opened on the same bus; until then no chip answers.
- The chip measures `sample_rate` times a second and keeps the newest sample: a lower `rate` skips samples; at a higher
  one some ticks have nothing new (an HMC5883L gives the same value again).
- Fields are in tesla: the earth's is 25e-6 to 65e-6 T. A field beyond `field_range` is reported as unreadable.
- A LIS3MDL and the magnetometer of an LSM9DS1 have one identity: with the wrong `model`, values are wrong by 4 %.
- Iron, magnets and currents nearby add to the field: calibrate each field with `process`, on the finished device.
)";
  struct Config {
    MagnetometerModel model = MagnetometerModel::lis3mdl;
    std::optional<double> sample_rate{};     ///< Hz of the chip; unset: its fastest
    std::optional<double> field_range{};     ///< gauss; unset: the narrowest from 1.3 on
    std::optional<IdentityCode> identity{};  ///< of a clone
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(
          parameter("model", &Config::model, "which chip it is",
                    choices(value("lis3mdl", MagnetometerModel::lis3mdl), value("lsm9ds1", MagnetometerModel::lsm9ds1),
                            value("ak8963", MagnetometerModel::ak8963), value("hmc5883l", MagnetometerModel::hmc5883l),
                            value("qmc5883l", MagnetometerModel::qmc5883l))),
          parameter(
              "sample_rate", &Config::sample_rate,
              "measurements per second that the chip takes. LIS3MDL, LSM9DS1: 0.625, 1.25, 2.5, 5, 10, 20, 40, 80; "
              "AK8963: 8, 100; HMC5883L: 0.75, 1.5, 3, 7.5, 15, 30, 75; QMC5883L: 10, 50, 100, 200; default: the last",
              unit("Hz"), range(0.625, 200.0)),
          parameter("field_range", &Config::field_range,
                    "measuring range in gauss (1e-4 T). LIS3MDL, LSM9DS1: 4, 8, 12, 16; AK8963: 49.12; HMC5883L: 0.88, "
                    "1.3, 1.9, 2.5, 4, 4.7, 5.6, 8.1; QMC5883L: 2, 8; default: the first, HMC5883L 1.3",
                    unit("G"), range(0.88, 49.12)),
          identity_parameter(&Config::identity));
    }
    const magnetometer_models::Model& chip() const noexcept {
      return magnetometer_models::all[static_cast<std::size_t>(model)];
    }
  };
  using Value = MagnetometerReading;
  using Device = RegisterDevice;
  static RegisterAddressing addressing(const Config& config) { return config.chip().addressing; }
  static constexpr RegisterPlace place{0x1c};
  static constexpr auto chips = chips_of(magnetometer_models::all);
  // A new sample: 1 gauss along X, the temperature of the code 0.
  static constexpr ChipSample samples[] = {{.bytes = {{{"0f", "3d"}, {"27", "08 ba 1a 00 00 00 00 00 00"}}},
                                            .values = {{{"magnetic_field_x", 1e-4}, {"temperature", 25}}},
                                            .has_proof = true,
                                            .addressing = &magnetometer_models::all[0].addressing}};

  static Result<void> check(const Config& config) {
    const Model& model = config.chip();
    const auto refused = [&](const char* key, double number, const std::string& good) -> Result<void> {
      return Error{Errc::bad_argument, "cannot use these settings of the magnetometer", key,
                   text_of(number) + " is not one of " + good + ", which the " + std::string(model.chip.name) + " has",
                   ""};
    };
    if (find_rate(config) == nullptr) {
      std::string good;
      for (const auto& one : model.rates) good += (good.empty() ? "" : ", ") + text_of(one.hertz);
      return refused("sample_rate", *config.sample_rate, good);
    }
    if (find_range(config) == nullptr) {
      std::string good;
      for (const auto& one : model.ranges) good += (good.empty() ? "" : ", ") + text_of(one.gauss);
      return refused("field_range", *config.field_range, good);
    }
    return {};
  }
  /// SetupError (bad-argument): a setting that the chip does not have.
  explicit Magnetometer(const Config& config) : config_(config), model_(config.chip()) {
    check(config).or_throw();
    rate_ = find_rate(config);
    range_ = find_range(config);
  }
  /// The pauses while it is set up.
  static Duration bus_time(const Config& config) {
    Duration all = adjustment_pause;
    for (const Setting& one : config.chip().setting_up) all += one.pause;
    return all;
  }

  /// Checks the identity, reads the factory adjustment, writes the settings and reads them back.
  Result<void> open(RegisterDevice& chip) {
    if (auto same = check_chip(chip); !same) return same;
    if (model_.adjustment_register != 0) {
      if (auto done = read_adjustment(chip); !done) return done;
    }
    if (auto done = set_up(chip); !done) return done;
    std::array<std::uint8_t, most_bytes> bytes{};
    if (auto done = read_pieces(chip, bytes); !done) return done;
    if (!has_settings(bytes))
      return chip.error(Errc::bad_data, "cannot use the chip as " + with_article(model_.chip.name),
                        "it does not keep its settings", "check which chip is at this address, and its supply");
    return {};
  }

  Reading<MagnetometerReading> read(RegisterDevice& chip) {
    std::array<std::uint8_t, most_bytes> bytes{};
    if (auto done = read_pieces(chip, bytes); !done) return std::move(done).error();
    if (!has_settings(bytes)) {
      if (auto same = check_chip(chip); !same) return std::move(same).error();
      auto lost = chip.error(Errc::bad_data, what, "it has lost its settings", "check its supply");
      if (auto done = set_up(chip); !done) return std::move(done).error();
      return Unreadable{std::move(lost)};
    }
    const MonotonicTime now = Samples<int>::now();
    if (model_.is_new.mask != 0 && (bytes[model_.is_new.at] & model_.is_new.mask) == 0) {
      if (now - last_ <= patience()) return NothingNew{};
      return chip.error(Errc::timed_out, what, "it has given no sample for " + to_string(patience()),
                        "check its supply");
    }
    last_ = now;
    auto reading = decode(bytes, config_, adjustment_);
    if (!reading) return Unreadable{chip.error(Errc::out_of_range, what, reading.error().why, reading.error().advice)};
    return *reading;
  }

  /// Sleeps.
  void close(RegisterDevice& chip) { (void)chip.write_register(model_.sleeping.number, model_.sleeping.value); }

  /// `bytes`: a reading, as the pieces of the model say. `adjustment`: factors of the axes, of an AK8963. Errors:
  /// out-of-range (of a field beyond the range).
  static Result<MagnetometerReading> decode(std::span<const std::uint8_t> bytes, const Config& config,
                                            const std::array<double, 3>& adjustment = {1, 1, 1}) {
    const Model& model = config.chip();
    const auto word = [&](std::size_t at) {
      const unsigned low = bytes[at + (model.is_big_endian ? 1 : 0)], high = bytes[at + (model.is_big_endian ? 0 : 1)];
      return static_cast<int>(static_cast<std::int16_t>(static_cast<std::uint16_t>(high << 8 | low)));
    };
    const auto* range = find_range(config);
    bool is_over = model.is_over.mask != 0 && (bytes[model.is_over.at] & model.is_over.mask) != 0;
    std::array<double, 3> tesla{};
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const int code = word(model.axes[axis]);
      is_over = is_over || code <= model.ends[0] || code >= model.ends[1];
      tesla[axis] = code / range->counts_per_gauss * tesla_a_gauss * adjustment[axis];
    }
    if (is_over)
      return Error{Errc::out_of_range, what, "",
                   "the field is outside the range of " + text_of(range->gauss) + " gauss",
                   model.ranges.size() > 1 ? "set a wider `field_range`, or move it away from magnets and iron"
                                           : "move it away from magnets"};
    MagnetometerReading reading{tesla[0], tesla[1], tesla[2], {}};
    if (model.temperature_at >= 0)
      reading.temperature = word(static_cast<std::size_t>(model.temperature_at)) / 8.0 + 25;
    return reading;
  }
  /// AK8963, 8.3.11: from its three registers.
  static std::array<double, 3> adjustment_of(const std::array<std::uint8_t, 3>& codes) noexcept {
    std::array<double, 3> factors{};
    for (std::size_t axis = 0; axis < 3; ++axis) factors[axis] = (codes[axis] - 128) * 0.5 / 128 + 1;
    return factors;
  }

 private:
  using Model = magnetometer_models::Model;
  using Setting = magnetometer_models::Setting;
  static constexpr const char* what = "cannot read the magnetometer";
  static constexpr double tesla_a_gauss = 1e-4;
  static constexpr std::size_t most_bytes = 16;  // of a reading
  static constexpr Duration adjustment_pause = std::chrono::milliseconds{1};

  static const magnetometer_models::SampleRate* find_rate(const Config& config) {
    const auto& rates = config.chip().rates;
    if (!config.sample_rate) return &rates.back();
    for (const auto& one : rates)
      if (std::abs(one.hertz - *config.sample_rate) < 1e-6) return &one;
    return nullptr;
  }
  static const magnetometer_models::FieldRange* find_range(const Config& config) {
    const double wanted = config.field_range.value_or(config.chip().usual_range);
    for (const auto& one : config.chip().ranges)
      if (std::abs(one.gauss - wanted) < 1e-6) return &one;
    return nullptr;
  }
  static std::string text_of(double number) {
    std::string text = std::to_string(number);
    text.erase(text.find_last_not_of('0') + 1);
    if (text.back() == '.') text.pop_back();
    return text;
  }
  Result<void> check_chip(RegisterDevice& chip) const {
    return check_identity(chip, model_.chip, config_.identity, magnetometer_models::all,
                          "check which chip is at this address, and `model`");
  }
  /// How long the chip may give no sample: three periods plus a second.
  Duration patience() const { return Duration{std::llround(3e9 / rate_->hertz)} + Duration{std::chrono::seconds{1}}; }
  std::uint8_t value_of(const Setting& setting) const noexcept {
    return static_cast<std::uint8_t>(setting.value + rate_->code * setting.by_rate + range_->code * setting.by_range);
  }
  Result<void> set_up(RegisterDevice& chip) {
    for (const Setting& one : model_.setting_up) {
      if (auto done = chip.write_register(one.number, value_of(one)); !done) return done;
      if (one.pause > Duration{0}) chip.wait(one.pause);
    }
    last_ = Samples<int>::now();
    return {};
  }
  /// In fuse ROM access mode.
  Result<void> read_adjustment(RegisterDevice& chip) {
    constexpr std::uint8_t mode_register = 0x0a, fuses = 0x0f;
    if (auto done = chip.write_register(mode_register, fuses); !done) return done;
    std::array<std::uint8_t, 3> codes{};
    if (auto done = chip.read_registers(model_.adjustment_register, codes); !done) return done;
    if (auto done = chip.write_register(mode_register, 0); !done) return done;
    chip.wait(adjustment_pause);
    adjustment_ = adjustment_of(codes);
    return {};
  }
  Result<void> read_pieces(RegisterDevice& chip, std::span<std::uint8_t, most_bytes> bytes) {
    std::size_t at = 0;
    for (const auto& piece : model_.pieces) {
      if (piece.count == 0) continue;
      if (auto done = chip.read_registers(piece.first, bytes.subspan(at, piece.count)); !done) return done;
      at += piece.count;
    }
    return {};
  }
  bool has_settings(std::span<const std::uint8_t> bytes) const noexcept {
    return std::all_of(model_.setting_up.begin(), model_.setting_up.end(), [&](const Setting& one) {
      return one.read_at < 0 || bytes[static_cast<std::size_t>(one.read_at)] == value_of(one);
    });
  }

  Config config_;
  const Model& model_;
  const magnetometer_models::SampleRate* rate_ = nullptr;
  const magnetometer_models::FieldRange* range_ = nullptr;
  std::array<double, 3> adjustment_{1, 1, 1};
  MonotonicTime last_{};  // of the newest sample, or of the setting up
};

}  // namespace rtdata
