// InvenSense MPU-6000/MPU-6050, register map RM-MPU-6000A-00 4.2: 4.2 to 4.5 settings, 4.7 FIFO, 4.15 overflow, 4.17 to
// 4.19 measurements, 4.27 FIFO reset, 4.28 power, 4.30 and 4.31 FIFO, 4.32 identity. MPU-6500: RM-MPU-6500A-00 2.1;
// MPU-9250: RM-MPU-9250A-00 1.6.
#include <algorithm>
#include <numbers>
#include <string>
#include <vector>

#include "rtdata/sensors/imu.hpp"

namespace rtdata {
namespace {

constexpr std::uint8_t divider_register = 0x19;  // then low-pass filter, angular range, acceleration range
constexpr std::uint8_t filter_register_of_acceleration = 0x1d;  // not of the MPU-6050, where one filter is for both
constexpr std::uint8_t fifo_enable_register = 0x23;
constexpr std::uint8_t interrupt_register = 0x3a;
constexpr std::uint8_t user_register = 0x6a;
constexpr std::uint8_t power_register = 0x6b;
constexpr std::uint8_t fifo_count_register = 0x72;
constexpr std::uint8_t fifo_register = 0x74;
constexpr std::uint8_t identity_register = 0x75;

constexpr std::uint8_t reset = 0x80, sleep_mode = 0x40, clock_of_gyroscope = 0x01;  // power
constexpr std::uint8_t fifo_on = 0x40, fifo_reset = 0x04;                           // user
constexpr std::uint8_t fifo_overflow = 0x10;                                        // interrupt
constexpr std::uint8_t all_measurements = 0xf8;                                     // FIFO enable
constexpr const char* what = "cannot read the IMU";

struct Model {
  ImuModel model;
  const char* name;
  std::uint8_t identity;
  std::size_t fifo_bytes;
  double counts_per_degree, degrees_at_zero;  // temperature
};
constexpr Model models[] = {
    {ImuModel::mpu6050, "MPU-6050", 0x68, 1024, 340, 36.53},
    {ImuModel::mpu6500, "MPU-6500", 0x70, 512, 333.87, 21},
    {ImuModel::mpu9250, "MPU-9250", 0x71, 512, 333.87, 21},
};
const Model& of(ImuModel model) noexcept { return models[static_cast<std::size_t>(model)]; }

/// The numbers that a setting can have, in the order of its codes.
using Choices = std::vector<unsigned>;
const Choices accelerations{2, 4, 8, 16};
const Choices angles{250, 500, 1000, 2000};
const Choices bandwidths{188, 98, 42, 20, 10, 5};  // from code 1 on

std::optional<std::uint8_t> code_of(const Choices& choices, unsigned number) {
  const auto found = std::find(choices.begin(), choices.end(), number);
  if (found == choices.end()) return std::nullopt;
  return static_cast<std::uint8_t>(found - choices.begin());
}

std::string list_of(const Choices& choices) {
  std::string list;
  for (const unsigned one : choices) list += (list.empty() ? "" : ", ") + std::to_string(one);
  return list;
}

/// The key that is wrong, and why.
struct Mistake {
  const char* key;
  std::string why;
};

std::vector<Mistake> mistakes_in(const Mpu6050::Config& config) {
  std::vector<Mistake> mistakes;
  const auto check = [&](const char* key, const Choices& choices, unsigned number) {
    if (!code_of(choices, number))
      mistakes.push_back({key, std::to_string(number) + " is none of " + list_of(choices)});
  };
  check("acceleration_range", accelerations, config.acceleration_range);
  check("angular_range", angles, config.angular_range);
  check("bandwidth", bandwidths, config.bandwidth);
  const unsigned rate = config.sample_rate;
  if (rate < 4 || rate > 1000 || 1000 % rate != 0)
    mistakes.push_back({"sample_rate", std::to_string(rate) +
                                           " Hz is no whole number of milliseconds: 4, 5, 8, 10, 20, 25, 40, "
                                           "50, 100, 125, 200, 250, 500 and 1000 are"});
  return mistakes;
}

}  // namespace

void check_config(const Mpu6050::Config& config, const ConfigItem& item, Problems& problems) {
  for (const Mistake& mistake : mistakes_in(config)) {
    const ConfigItem* at = item.find(mistake.key);
    problems.add((at != nullptr ? *at : item).problem("bad-value", mistake.why));
  }
}

Mpu6050::Mpu6050(const Config& config) : config_(config), period_(0) {
  const std::vector<Mistake> mistakes = mistakes_in(config);
  if (!mistakes.empty())
    throw SetupError({Errc::bad_argument, "cannot use this setting", mistakes.front().key, mistakes.front().why, ""});
  period_ = std::chrono::milliseconds{1000 / config.sample_rate};
}

Result<void> Mpu6050::open(I2cDevice& chip) {
  const Model& model = of(config_.model);
  const Result<std::uint8_t> found = chip.read_register(identity_register);
  if (!found) return found.error();
  if (*found != model.identity) {
    std::string advice = "look at which chip is at this address";
    for (const Model& other : models)
      if (other.identity == *found) advice = std::string("it is an ") + other.name + ": set `model`";
    return chip.error(Errc::bad_data, std::string("cannot use the chip as an ") + model.name,
                      "its identity is " + to_string(I2cAddress(*found)) + ", that of an " + model.name + " is " +
                          to_string(I2cAddress(model.identity)),
                      std::move(advice));
  }
  if (auto done = chip.write_register(power_register, reset); !done) return done;
  chip.wait(std::chrono::milliseconds{100});  // register map 4.28
  auto done = set_up(chip);
  last_ = Samples<ImuReading>::now();
  return done;
}

/// All settings of a chip that was reset, then the FIFO.
Result<void> Mpu6050::set_up(I2cDevice& chip) {
  if (auto done = chip.write_register(power_register, clock_of_gyroscope); !done) return done;
  chip.wait(std::chrono::milliseconds{35});  // until the gyroscope turns: its data sheet, 6.1
  const auto divider = static_cast<std::uint8_t>(1000 / config_.sample_rate - 1);
  const auto filter = static_cast<std::uint8_t>(code_of(bandwidths, config_.bandwidth).value_or(0) + 1);
  const auto angle = static_cast<std::uint8_t>(code_of(angles, config_.angular_range).value_or(0) << 3);
  const auto acceleration = static_cast<std::uint8_t>(code_of(accelerations, config_.acceleration_range).value_or(0)
                                                      << 3);
  const std::array<std::uint8_t, 5> settings{divider_register, divider, filter, angle, acceleration};
  if (auto done = chip.write(settings); !done) return done;
  if (config_.model != ImuModel::mpu6050) {
    if (auto done = chip.write_register(filter_register_of_acceleration, filter); !done) return done;
  }
  if (auto done = chip.write_register(fifo_enable_register, all_measurements); !done) return done;
  return empty_fifo(chip);
}

Result<void> Mpu6050::empty_fifo(I2cDevice& chip) {
  if (auto done = chip.write_register(user_register, fifo_reset); !done) return done;
  if (auto done = chip.read_register(interrupt_register); !done) return done.error();  // which clears it
  auto done = chip.write_register(user_register, fifo_on);
  if (done) is_torn_ = false;
  return done;
}

/// Those that it has taken since the last one that was read are lost. Whole periods are counted; what is left of one
/// goes on, so that no sample is counted twice or left out in the long run.
void Mpu6050::give_up_samples(MonotonicTime now, Samples<ImuReading>& out) {
  if (now <= last_) return;
  const auto count = (now - last_) / period_;
  out.lost(static_cast<std::uint64_t>(count));
  last_ += count * period_;
}

Result<void> Mpu6050::read(I2cDevice& chip, Samples<ImuReading>& out) {
  // Settings that are lost would look like a chip without news.
  std::array<std::uint8_t, 2> user_and_power{};
  if (auto done = chip.read_registers(user_register, user_and_power); !done) return done;
  if ((user_and_power[0] & fifo_on) == 0 || (user_and_power[1] & (reset | sleep_mode)) != 0) {
    out.unreadable(chip.error(Errc::bad_data, what, "it has lost its settings", "look at its supply"));
    auto done = set_up(chip);
    if (done) give_up_samples(Samples<ImuReading>::now(), out);
    return done;
  }
  std::array<std::uint8_t, 2> count_bytes{};
  if (auto done = chip.read_registers(fifo_count_register, count_bytes); !done) return done;
  const MonotonicTime now = Samples<ImuReading>::now();
  const std::size_t filled = std::size_t{count_bytes[0]} << 8 | count_bytes[1];
  if (filled > of(config_.model).fifo_bytes)
    return chip.error(Errc::bad_data, what, "its FIFO has " + std::to_string(filled) + " bytes, more than there are",
                      "look at its wires");
  if (is_torn_ || filled + sample_bytes > of(config_.model).fifo_bytes) return restart(chip, out);
  const std::size_t samples = filled / sample_bytes;
  if (samples == 0) return {};
  std::array<std::uint8_t, 1024> bytes{};
  is_torn_ = true;  // if this fails, nobody knows how much of it has come, and where a sample begins
  if (auto done = chip.read_registers(fifo_register, std::span(bytes).first(samples * sample_bytes)); !done) {
    (void)restart(chip, out);
    return done;
  }
  // Asked for afterwards: one that ran over meanwhile has dropped bytes of the samples that were being read.
  const Result<std::uint8_t> interrupt = chip.read_register(interrupt_register);
  if (!interrupt) return interrupt.error();
  if ((*interrupt & fifo_overflow) != 0) return restart(chip, out);
  is_torn_ = false;
  // The last one is between now and one period ago; see imu.hpp.
  const MonotonicTime newest = std::clamp(last_ + static_cast<std::int64_t>(samples) * period_, now - period_, now);
  const Duration step = (newest - last_) / static_cast<std::int64_t>(samples);
  for (std::size_t i = 0; i < samples; ++i) {
    const auto sample = std::span<const std::uint8_t>(bytes).subspan(i * sample_bytes).first<sample_bytes>();
    out.add(decode(sample, config_), newest - static_cast<std::int64_t>(samples - 1 - i) * step);
  }
  last_ = newest;
  return {};
}

/// Empties a FIFO of which nobody knows where a sample begins.
Result<void> Mpu6050::restart(I2cDevice& chip, Samples<ImuReading>& out) {
  auto begun = empty_fifo(chip);
  if (begun) give_up_samples(Samples<ImuReading>::now(), out);
  return begun;  // otherwise the next read does it
}

void Mpu6050::close(I2cDevice& chip) { (void)chip.write_register(power_register, sleep_mode); }

ImuReading Mpu6050::decode(std::span<const std::uint8_t, sample_bytes> bytes, const Config& config) noexcept {
  const auto word = [&](std::size_t at) {
    return static_cast<double>(static_cast<std::int16_t>(static_cast<std::uint16_t>(bytes[at] << 8 | bytes[at + 1])));
  };
  constexpr double gravity = 9.80665;
  const double acceleration = config.acceleration_range * gravity / 32768;
  // The chip has 131, 65.5, 32.8, 16.4 counts a degree a second (register map 4.19): 250 degrees are 32750 counts.
  const double angular = config.angular_range / 32750.0 * std::numbers::pi / 180;
  const Model& model = of(config.model);
  return {word(0) * acceleration,
          word(2) * acceleration,
          word(4) * acceleration,
          word(8) * angular,
          word(10) * angular,
          word(12) * angular,
          word(6) / model.counts_per_degree + model.degrees_at_zero};
}

}  // namespace rtdata
