// Accelerometers and gyroscopes with a FIFO, beside the MPU-6050: chips that take samples as virtual time passes.
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <deque>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/app/program.hpp"
#include "rtdata/chips/accelerometer.hpp"
#include "rtdata/chips/imu.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "sensors/bus_bench.hpp"
#include "sensors/fixture.hpp"
#include "sensors/spi_bridge.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

constexpr double gravity = 9.80665, degree = std::numbers::pi / 180;

enum class ChipKind { lsm6ds3, lsm6dso, lsm9ds1, adxl, icm20948 };

/// A chip whose samples hold their number: X of the rate (of an ADXL: of the acceleration) its low 8 bits, Z the others
/// above them.
class FakeInertial {
 public:
  FakeInertial(FakeI2cChip& chip, ChipKind kind, Duration period) : chip_(chip), kind_(kind), period_(period) {
    switch (kind) {
      case ChipKind::lsm6ds3:
        identity(0x0f, 0x69);
        switched_by(0x0a, 7, 6);
        chip.on_read(0x3a, [this] { return status_byte(4); });
        chip.on_read(0x3e, [this] { return next(12); });
        chip.set(0x20, {16, 0});
        break;
      case ChipKind::lsm6dso:
        identity(0x0f, 0x6c);
        switched_by(0x0a, 7, 6);
        chip.on_read(0x3a, [this] { return status_byte(2); });
        chip.on_read(0x78, [this] { return next(7); });
        chip.set(0x20, {0, 1});
        break;
      case ChipKind::lsm9ds1:
        identity(0x0f, 0x68);
        switched_by(0x2e, 0xe0, 0xc0);
        chip.on_read(0x2f, [this] { return status_byte(1); });
        chip.on_read(0x18, [this] { return peek(0); });
        chip.on_read(0x28, [this] { return peek(6); });
        chip.set(0x15, {16, 0});
        break;
      case ChipKind::adxl:
        identity(0x00, 0xe5);
        switched_by(0x38, 0xc0, 0x80);
        chip.on_read(0x39, [this] { return status_byte(1); });
        chip.on_read(0x30, [this] {
          take_samples();
          return static_cast<std::uint8_t>(has_run_over_ ? 1 : 0);
        });
        chip.on_read(0x32, [this] { return peek(0); });
        break;
      case ChipKind::icm20948:
        switched_by(0x67, 0x1f, 0x1e);
        chip.on_read(0x00, [this] { return static_cast<std::uint8_t>(bank_ == 0 ? 0xea : 0x42); });
        chip.on_write(0x7f, [this](std::uint16_t value) { bank_ = value; });
        chip.on_read(0x70, [this] { return status_byte(2); });
        chip.on_read(0x1b, [this] {
          take_samples();
          return static_cast<std::uint8_t>(std::exchange(has_run_over_, false) ? 1 : 0);
        });
        chip.on_read(0x72, [this] { return next(12); });
        chip.set(0x39, {0x06, 0x85});  // 1669
        break;
    }
  }
  void choose_bank(unsigned bank) { bank_ = bank; }
  void leave_bank(std::uint8_t bank) {
    bank_ = bank;
    chip_.set(0x7f, {bank});
  }
  void lose_power() {
    is_on_ = false;
    units_.clear();
    chip_.set(kind_ == ChipKind::adxl       ? 0x38
              : kind_ == ChipKind::lsm9ds1  ? 0x2e
              : kind_ == ChipKind::icm20948 ? 0x67
                                            : 0x0a,
              {0});
  }
  std::uint64_t taken() const { return number_; }
  /// The next samples come to nothing.
  void drop(unsigned count) { number_ += count, next_ += static_cast<int>(count) * period_; }
  bool spoils_parity = false;

 private:
  void identity(std::uint8_t number, std::uint8_t value) { chip_.set(number, {value}); }
  void switched_by(std::uint8_t number, unsigned mask, unsigned on) {
    chip_.on_write(number, [this, mask, on](std::uint16_t value) {
      take_samples();
      is_on_ = (value & mask) == on;
      if (!is_on_) units_.clear(), at_ = 0, has_run_over_ = false;
    });
  }
  /// Those that are due. It takes them as long as it has power, whether anybody wants them or not.
  void take_samples() {
    const MonotonicTime now = detail::lane_now();
    if (next_ == MonotonicTime{}) next_ = now;
    for (; next_ <= now; next_ += period_, ++number_) {
      if (!is_on_) continue;
      const auto low = static_cast<std::uint8_t>(number_ & 0xff), high = static_cast<std::uint8_t>(number_ >> 8 & 0x3f);
      const std::vector<std::uint8_t> numbered{low, 0, 0, 0, high, 0}, acceleration{0, 8, 0, 0, 0, 0xf8};
      std::vector<std::uint8_t> both = numbered;
      both.insert(both.end(), acceleration.begin(), acceleration.end());
      if (kind_ == ChipKind::lsm6dso) {
        push(tagged(1, numbered), 512);
        push(tagged(2, acceleration), 512);
      } else if (kind_ == ChipKind::lsm6ds3) {
        push(both, 682);
      } else if (kind_ == ChipKind::icm20948) {  // the high byte first, and what is in there stays
        const std::vector<std::uint8_t> bytes{8, 0, 0, 0, 0xf8, 0, 0, low, 0, 0, 0, high};
        if (units_.size() < 42)
          units_.push_back(bytes);
        else
          has_run_over_ = true;
      } else {
        push(kind_ == ChipKind::adxl ? numbered : both, 32);
      }
    }
  }
  std::vector<std::uint8_t> tagged(unsigned kind, std::vector<std::uint8_t> bytes) const {
    auto tag = static_cast<std::uint8_t>(kind << 3 | (number_ & 3) << 1);
    unsigned ones = 0;
    for (int bit = 0; bit < 8; ++bit) ones += tag >> bit & 1;
    tag = static_cast<std::uint8_t>(tag | ((ones & 1) ^ (spoils_parity ? 1 : 0)));
    bytes.insert(bytes.begin(), tag);
    return bytes;
  }
  void push(std::vector<std::uint8_t> unit, std::size_t most) {
    if (units_.size() == most) {
      units_.pop_front();
      has_run_over_ = true;
    }
    units_.push_back(std::move(unit));
  }
  std::uint8_t status_byte(std::size_t bytes) {
    take_samples();
    const std::size_t count = units_.size();
    std::uint32_t status = 0;
    if (kind_ == ChipKind::lsm6ds3)
      status = static_cast<std::uint32_t>(count * 6 & 0xfff) | (has_run_over_ ? 0x4000u : 0u);
    else if (kind_ == ChipKind::lsm6dso)
      status = static_cast<std::uint32_t>(count & 0x3ff) | (has_run_over_ ? 0x0800u : 0u);
    else if (kind_ == ChipKind::icm20948)
      status = static_cast<std::uint32_t>(count * 12 << 8 | count * 12 >> 8);
    else
      status = static_cast<std::uint32_t>(count) | (has_run_over_ && kind_ == ChipKind::lsm9ds1 ? 0x40u : 0u);
    const auto byte = static_cast<std::uint8_t>(status >> 8 * status_at_ & 0xff);
    if (++status_at_ == bytes) {
      status_at_ = 0;
      if (kind_ != ChipKind::adxl && kind_ != ChipKind::icm20948) has_run_over_ = false;
    }
    return byte;
  }
  /// Of a FIFO that is read on and on.
  std::uint8_t next(std::size_t size) {
    take_samples();
    if (units_.empty()) return 0xff;
    const std::uint8_t byte = units_.front()[at_];
    if (++at_ == size) {
      at_ = 0;
      units_.pop_front();
    }
    return byte;
  }
  /// Of a sample that goes when its last byte was read.
  std::uint8_t peek(std::size_t from) {
    take_samples();
    if (units_.empty()) return 0xff;
    const std::uint8_t byte = units_.front()[from + at_];
    if (++at_ == 6) {
      at_ = 0;
      if (from + 6 == units_.front().size()) units_.pop_front(), has_run_over_ = false;
    }
    return byte;
  }

  FakeI2cChip& chip_;
  ChipKind kind_;
  Duration period_;
  MonotonicTime next_{};
  std::uint64_t number_ = 0;
  std::deque<std::vector<std::uint8_t>> units_;
  std::size_t at_ = 0, status_at_ = 0;
  bool is_on_ = false, has_run_over_ = false;
  unsigned bank_ = 0;
};

struct Model {
  ChipKind kind;
  ImuModel imu;
  double rate;
  unsigned address;
  int capacity;
  const char* name;
};
constexpr Model models[] = {{ChipKind::lsm6ds3, ImuModel::lsm6ds3, 416, 0x6a, 682, "LSM6DS3"},
                            {ChipKind::lsm6dso, ImuModel::lsm6dso, 416, 0x6a, 256, "LSM6DSO"},
                            {ChipKind::lsm9ds1, ImuModel::lsm9ds1, 476, 0x6b, 32, "LSM9DS1"},
                            {ChipKind::adxl, ImuModel::mpu6050, 400, 0x53, 32, "ADXL345"},
                            {ChipKind::icm20948, ImuModel::icm20948, 375, 0x69, 42, "ICM-20948"}};

/// Its FIFO is emptied when it ran over: nobody knows where a sample begins.
bool is_emptied(const Model& model) { return model.kind == ChipKind::lsm6ds3 || model.kind == ChipKind::icm20948; }

/// One of the models on a fake bus, with all that its samples say.
struct InertialBench {
  explicit InertialBench(const Model& model_, double chip_is_faster = 1)
      : model(model_),
        fake(wires->chip(model_.address), model_.kind, Duration{std::llround(1e9 / model_.rate / chip_is_faster)}) {
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    if (model.kind == ChipKind::adxl) {
      heard = loop.subscribe<AccelerometerReading>("s", [this](const Event<AccelerometerReading>& event) {
        take(event->acceleration_x * 256 / gravity, event->acceleration_z * 256 / gravity, event.time);
      });
      return;
    }
    heard = loop.subscribe<ImuReading>("s", [this](const Event<ImuReading>& event) {
      const bool is_icm = model.kind == ChipKind::icm20948;
      const double count = is_icm ? 2000 / 32750.0 * degree : 70e-3 * degree;
      take(event->angular_velocity_x / count, event->angular_velocity_z / count, event.time);
      const double per_count = (is_icm                            ? 16 / 32768.0
                                : model.kind == ChipKind::lsm9ds1 ? 0.732e-3
                                                                  : 0.488e-3) *
                               gravity;
      are_whole = are_whole && std::lround(event->acceleration_x / per_count) == 0x800 &&
                  std::lround(event->acceleration_z / per_count) == -0x800 && event->acceleration_y == 0;
      if (event->temperature) temperatures.push_back(*event->temperature);
    });
  }
  void take(double low, double high, Time time) {
    numbers.push_back(static_cast<int>(std::lround(low) + (std::lround(high) << 8)));
    times.push_back(time);
  }
  AnySensor make(SensorConfig config) {
    if (model.kind == ChipKind::adxl)
      return DriverSensor<Accelerometer>(loop, std::move(config), bus, {model.address}, {.sample_rate = model.rate});
    return DriverSensor<Imu>(loop, std::move(config), bus, {model.address},
                             {.model = model.imu, .sample_rate = model.rate});
  }
  /// Numbers left out between the first and the last.
  int left_out() const {
    return numbers.empty() ? 0 : numbers.back() - numbers.front() + 1 - static_cast<int>(numbers.size());
  }
  bool is_in_order() const {
    for (std::size_t i = 1; i < numbers.size(); ++i)
      if (numbers[i] <= numbers[i - 1] || times[i] <= times[i - 1]) return false;
    return true;
  }
  /// Within which the account of what was lost is right.
  int accuracy() const { return model.kind == ChipKind::lsm6dso ? 0 : 1; }

  const Model& model;
  std::shared_ptr<FakeI2c> wires = std::make_shared<FakeI2c>();
  I2cBus bus{"i2c1", wires, {.timeout = 900ms}};
  FakeInertial fake;
  Loop loop{Loop::Manual{}};
  std::vector<std::string> errors;
  std::vector<int> numbers;
  std::vector<Time> times;
  std::vector<double> temperatures;
  bool are_whole = true;
  Subscription heard;
};

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-15 LSM6DS3, LSM6DSO, LSM9DS1, ADXL345, ADXL375: counts become m/s2 and rad/s by the data sheets") {
    // Angular velocity, then acceleration, low byte first: 1000, -1000, 2; 16384, -2, 1.
    const std::array<std::uint8_t, 12> bytes{0xe8, 0x03, 0x18, 0xfc, 2, 0, 0, 0x40, 0xfe, 0xff, 1, 0};
    const ImuReading dso = Imu::decode(bytes,
                                       {.model = ImuModel::lsm6dso, .acceleration_range = 2, .angular_range = 250});
    CHECK(dso.angular_velocity_x == doctest::Approx(8.75 * degree));  // 8.75 mdps a count
    CHECK(dso.angular_velocity_y == doctest::Approx(-8.75 * degree));
    CHECK(dso.angular_velocity_z == doctest::Approx(0.0175 * degree));
    CHECK(dso.acceleration_x == doctest::Approx(16384 * 0.061e-3 * gravity));  // 0.061 mg a count
    CHECK(dso.acceleration_y == doctest::Approx(-0.122e-3 * gravity));
    CHECK(!dso.temperature);
    CHECK(Imu::decode(bytes, {.model = ImuModel::lsm6ds3}).angular_velocity_x == doctest::Approx(70 * degree));
    CHECK(Imu::decode(bytes, {.model = ImuModel::lsm6ds3}).acceleration_z == doctest::Approx(0.488e-3 * gravity));
    const ImuReading dof = Imu::decode(bytes, {.model = ImuModel::lsm9ds1});
    CHECK(dof.acceleration_z == doctest::Approx(0.732e-3 * gravity));
    CHECK(dof.angular_velocity_z == doctest::Approx(0.14 * degree));
    const std::array<std::uint8_t, 6> g{0x00, 0x01, 0x00, 0xff, 20, 0};
    const AccelerometerReading small = Accelerometer::decode(g, {});
    CHECK(small.acceleration_x == doctest::Approx(gravity));
    CHECK(small.acceleration_y == doctest::Approx(-gravity));
    CHECK(Accelerometer::decode(g, {.model = AccelerometerModel::adxl375}).acceleration_z ==
          doctest::Approx(20 * 0.049 * gravity));
    // LIS3DH, AN3308, 4.2.3: at 2 g and high resolution 350 mg, -350 mg, and 1024 counts of 1 mg.
    const std::array<std::uint8_t, 6> tilted{0xe0, 0x15, 0x20, 0xea, 0x00, 0x40};
    const AccelerometerReading fine = Accelerometer::decode(
        tilted, {.model = AccelerometerModel::lis3dh, .acceleration_range = 2});
    CHECK(fine.acceleration_x == doctest::Approx(0.35 * gravity));
    CHECK(fine.acceleration_y == doctest::Approx(-0.35 * gravity));
    CHECK(fine.acceleration_z == doctest::Approx(1.024 * gravity));
    CHECK(Accelerometer::decode(tilted, {.model = AccelerometerModel::lis3dh}).acceleration_x ==
          doctest::Approx(350 * 0.012 * gravity));
  }

  TEST_CASE(
      "US-15 US-27 LIS3DH: its settings, another chip, the samples in which it settles, lost settings, unplugged") {
    I2cBench bench;
    FakeI2cChip& chip = bench.wires->chip(0x18);
    chip.set(0x0f, {0x32});                                // an LIS331DLH
    chip.set(0xa8, {0xe0, 0x15, 0x20, 0xea, 0x00, 0x40});  // from 0x28 on, with the bit of several registers
    std::vector<AccelerometerReading> all;
    const auto heard = bench.loop.subscribe<AccelerometerReading>(
        "s", [&](const Event<AccelerometerReading>& event) { all.push_back(*event); });
    DriverSensor<Accelerometer> sensor(bench.loop, {.name = "s", .rate = 10_Hz, .retry_longest = 100ms}, bench.bus,
                                       {.address = 0x18},
                                       {.model = AccelerometerModel::lis3dh, .acceleration_range = 2});
    CHECK(bench.told("its identity is 0x32, that of an LIS3DH is 0x33"));
    chip.set(0x0f, {0x33});
    bench.loop.advance(150ms);
    CHECK(sensor.health() == Health::ok);
    CHECK(chip.get(0x20) == 0x57);  // 100 Hz, three axes
    CHECK(chip.get(0x23) == 0x88);  // 2 g, high resolution
    CHECK(chip.get(0x24) == 0x40);
    CHECK(chip.get(0x2e) == 0x80);
    CHECK(all.empty());
    chip.set(0x2f, {9});
    bench.loop.advance(100ms);
    REQUIRE(all.size() == 2);  // without the first seven
    CHECK(all[0].acceleration_x == doctest::Approx(0.35 * gravity));
    bench.loop.advance(100ms);
    CHECK(all.size() == 11);
    chip.set(0x2f, {0x20});  // empty
    bench.loop.advance(100ms);
    CHECK(all.size() == 11);
    chip.set(0x2e, {0});
    bench.loop.advance(100ms);
    CHECK(sensor.status().reason.find("it has lost its settings") != std::string::npos);
    CHECK(sensor.counts().unreadable == 1);
    CHECK(chip.get(0x2e) == 0x80);
    chip.unplug();
    bench.loop.advance(1s);
    CHECK(sensor.health() == Health::faulted);
    CHECK(all.size() == 11);
    chip.plug_in();
    chip.set(0x2f, {9});
    bench.loop.advance(1s);
    CHECK(sensor.health() == Health::ok);
    CHECK(all.size() > 11);
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-15 each sample in the FIFO of each model is an event, in order, whole, with a time of its own") {
    for (const Model& model : models) {
      CAPTURE(std::string(model.name));
      for (const double faster : {1.0, 1.03, 0.97}) {
        CAPTURE(faster);
        InertialBench bench(model, faster);
        AnySensor sensor = bench.make({.name = "s", .rate = 50_Hz});
        bench.loop.advance(4s);
        CHECK(bench.errors.empty());
        CHECK(sensor.counts().lost == 0);
        CHECK(sensor.counts().published == bench.numbers.size());
        CHECK(bench.left_out() == 0);
        CHECK(bench.is_in_order());
        CHECK(bench.are_whole);
        REQUIRE(bench.numbers.size() > static_cast<std::size_t>(3.7 * model.rate * faster));
        const double period = static_cast<double>((bench.times.back() - bench.times.front()) / 1ns) /
                              static_cast<double>(bench.times.size() - 1);
        CHECK(period == doctest::Approx(1e9 / model.rate / faster).epsilon(0.002));
        if (model.kind != ChipKind::adxl) {
          CHECK(bench.temperatures.size() > 150);
          CHECK(bench.temperatures.size() < 202);
          CHECK(bench.temperatures[0] == doctest::Approx(26).epsilon(0.0005));
        }
        CHECK(bench.loop.runtime().balances());
      }
    }
  }

  TEST_CASE("US-11 US-15 on SPI each sample in the FIFO of each model is an event, and I2C is switched off") {
    for (const Model& model : models) {
      CAPTURE(model.name);
      InertialBench bench(model);
      const bool is_adxl = model.kind == ChipKind::adxl;
      auto wires = std::make_shared<FakeSpi>();
      bridge(*wires, 2, *bench.wires, model.address, {.spi_burst_bit = static_cast<std::uint8_t>(is_adxl ? 0x40 : 0)});
      SpiBus spi("spi0", wires, {.timeout = 900ms});
      const SensorConfig config{.name = "s", .rate = 50_Hz};
      AnySensor sensor;
      if (is_adxl) {
        sensor = DriverSensor<Accelerometer>(bench.loop, config, spi, {.chip_select = 2}, {.sample_rate = model.rate});
      } else {
        sensor = DriverSensor<Imu>(bench.loop, config, spi, {.chip_select = 2},
                                   {.model = model.imu, .sample_rate = model.rate});
      }
      bench.loop.advance(5s);
      CHECK(bench.errors.empty());
      CHECK(static_cast<double>(bench.numbers.size()) == doctest::Approx(5 * model.rate).epsilon(0.03));
      CHECK(bench.left_out() == 0);
      CHECK(bench.is_in_order());
      CHECK(bench.are_whole);
      CHECK(sensor.counts().lost == 0);
      const FakeI2cChip& chip = bench.wires->chip(model.address);
      if (model.kind == ChipKind::lsm9ds1) CHECK(chip.get(0x23) == 0x06);
      if (model.kind == ChipKind::lsm6dso || model.kind == ChipKind::lsm6ds3) CHECK(chip.get(0x13) == 0x04);
      if (model.kind == ChipKind::icm20948) CHECK(chip.get(0x03) == 0x50);
      CHECK(bench.loop.runtime().balances());
    }
  }

  TEST_CASE("US-15 ICM-20948: the data sheet's scales; its settings by banks; a bank that another program has left") {
    // 2048, -2048 and 16384 counts at 16 g; 16.4 counts a degree a second at 2000.
    const std::array<std::uint8_t, 12> bytes{0x08, 0, 0xf8, 0, 0x40, 0, 0x06, 0x68, 0xf9, 0x98, 0, 0};
    const ImuReading reading = Imu::decode(bytes, {.model = ImuModel::icm20948});
    CHECK(reading.acceleration_x == doctest::Approx(gravity));
    CHECK(reading.acceleration_y == doctest::Approx(-gravity));
    CHECK(reading.acceleration_z == doctest::Approx(8 * gravity));
    CHECK(reading.angular_velocity_x == doctest::Approx(100 * degree).epsilon(0.002));
    CHECK(reading.angular_velocity_y == doctest::Approx(-100 * degree).epsilon(0.002));
    CHECK_FALSE(reading.temperature);

    InertialBench bench(models[4]);
    FakeI2cChip& chip = bench.wires->chip(0x69);
    std::vector<std::pair<unsigned, unsigned>> writes;  // with the bank before the number
    unsigned bank = 0;
    for (const unsigned number : {0x00u, 0x01u, 0x03u, 0x06u, 0x09u, 0x11u, 0x12u, 0x14u, 0x68u, 0x69u})
      chip.on_write(static_cast<std::uint8_t>(number), [&writes, &bank, number](std::uint16_t value) {
        writes.emplace_back(bank << 4 | number, value);  // 0x20 becomes 0x200
      });
    chip.on_write(0x7f, [&](std::uint16_t value) {
      bank = value;
      bench.fake.choose_bank(value);
    });
    bench.fake.leave_bank(0x20);
    DriverSensor<Imu> imu(bench.loop, {.name = "s", .rate = 50_Hz}, bench.bus, {0x69},
                          {.model = ImuModel::icm20948,
                           .sample_rate = 375,
                           .acceleration_range = 4,
                           .angular_range = 500,
                           .bandwidth = 24});
    CHECK(bench.errors.empty());
    const std::vector<std::pair<unsigned, unsigned>> wanted{{0x06, 0x80},  {0x06, 0x01}, {0x209, 0x01}, {0x200, 2},
                                                            {0x201, 0x23}, {0x211, 2},   {0x214, 0x23}, {0x69, 0x01},
                                                            {0x12, 0x01},  {0x03, 0x40}, {0x68, 0x1f},  {0x68, 0}};
    CHECK(writes == wanted);
    CHECK(bank == 0);
    bench.loop.advance(1s);
    CHECK(bench.numbers.size() > 350);
    imu.close();
    bench.loop.advance(10ms);
    CHECK(chip.get(0x06) == 0x41);
    // Another chip is not written to.
    chip.set(0x7f, {0x21});
    writes.clear();
    chip.on_read(0x00, [] { return std::uint8_t{0x12}; });
    DriverSensor<Imu> other(bench.loop, {.name = "t", .rate = 50_Hz}, bench.bus, {0x69}, {.model = ImuModel::icm20948});
    CHECK(other.status().reason.find("its identity is 0x12, that of an ICM-20948 is 0xea") != std::string::npos);
    CHECK(writes.empty());
    CHECK(chip.get(0x7f) == 0x21);
    CHECK_THROWS_WITH_AS(DriverSensor<Imu>(bench.loop, {.name = "b", .rate = 50_Hz}, bench.bus, {0x68},
                                           {.model = ImuModel::icm20948, .self_test = true}),
                         doctest::Contains("no limits are known for the self-test of the ICM-20948"), SetupError);
  }

  TEST_CASE("US-15 a FIFO that ran over: each sample that is gone is counted, of an LSM6DSO exactly") {
    for (const Model& model : models) {
      CAPTURE(std::string(model.name));
      for (const double faster : {1.0, 1.03, 0.97}) {
        CAPTURE(faster);
        for (int outage = 2000; outage < 2020; outage += 3) {
          CAPTURE(outage);
          InertialBench bench(model, faster);
          AnySensor sensor = bench.make({.name = "s", .rate = 50_Hz, .faulted_after = 10000});
          bench.loop.advance(5s);
          CHECK(sensor.counts().lost == 0);
          const std::size_t before = bench.numbers.size();
          bench.wires->chip(model.address).unplug();  // from the bus; it measures on
          bench.loop.advance(outage * 1ms);
          CHECK(bench.numbers.size() == before);
          bench.wires->chip(model.address).plug_in();
          bench.loop.advance(500ms);
          CHECK(bench.left_out() > 100);
          CHECK(std::abs(static_cast<int>(sensor.counts().lost) - bench.left_out()) <= bench.accuracy());
          CHECK(bench.is_in_order());
          CHECK(bench.are_whole);
          CHECK(sensor.health() == Health::ok);
          CHECK(bench.loop.runtime().balances());
        }
      }
    }
  }

  TEST_CASE("US-15 a sensor that is read too seldom for its FIFO loses samples, and says how many and what to do") {
    for (const Model& model : models) {
      CAPTURE(std::string(model.name));
      InertialBench bench(model);
      AnySensor sensor = bench.make({.name = "s", .rate = Rate::from_period(model.capacity * 1ms * 4)});
      bench.loop.advance(30s);
      CHECK(sensor.counts().lost > 1000);
      CHECK(sensor.counts().lost < bench.fake.taken());
      CHECK(sensor.status().reason.find("read it more often, or set a lower sample rate in the device") !=
            std::string::npos);
      // A FIFO that is emptied cannot be used when it ran over. An ICM-20948 is opened again for so long that the next
      // tick comes before its small one is full.
      if (model.kind != ChipKind::icm20948) CHECK(bench.numbers.empty() == is_emptied(model));
      if (!is_emptied(model)) {
        const int ticks = static_cast<int>(sensor.counts().taken + sensor.counts().failed);
        CHECK(std::abs(static_cast<int>(sensor.counts().lost) - bench.left_out() - (bench.numbers[0] - 1)) <=
              (model.kind == ChipKind::lsm6dso ? 60 : 60 + ticks));
      }
      CHECK(bench.is_in_order());
      CHECK(bench.loop.runtime().balances());
    }
  }

  TEST_CASE("US-15 a FIFO that runs over while it is read, or just before: no sample is gone without being counted") {
    for (const Model& model : models) {
      if (is_emptied(model)) continue;  // as that of an MPU-6050
      CAPTURE(std::string(model.name));
      int left_out = 0;
      const int full = static_cast<int>(model.capacity * 1000 / model.rate);
      for (int period = full - 16; period <= full + 24; period += 2) {
        CAPTURE(period);
        InertialBench bench(model);
        bench.wires->chip(model.address).set_duration(model.kind == ChipKind::lsm9ds1 ? 500us : 1ms);
        AnySensor sensor = bench.make({.name = "s", .rate = 40_Hz, .faulted_after = 10000});
        bench.loop.advance(3s);
        CHECK(sensor.counts().lost == 0);
        sensor.set_rate(Rate::from_period(period * 1ms));
        bench.loop.advance(5s);
        CHECK(bench.is_in_order());
        CHECK(bench.are_whole);
        CHECK(bench.loop.runtime().balances());
        const int here = static_cast<int>(sensor.counts().lost);
        // By the time, with a rate that is known to 0.3 % after three seconds.
        const int accuracy = 2 + static_cast<int>(0.003 * 5 * model.rate);
        CHECK(std::abs(here - bench.left_out()) <= (model.kind == ChipKind::lsm6dso ? 0 : accuracy));
        left_out += bench.left_out();
      }
      CHECK(left_out > 400);
    }
  }

  TEST_CASE("US-15 samples that go without a sign are missed by the time, or by their counter") {
    for (const Model& model : models) {
      if (is_emptied(model)) continue;  // each of its bytes would be one of another sample
      CAPTURE(std::string(model.name));
      InertialBench bench(model, 1.02);
      AnySensor sensor = bench.make({.name = "s", .rate = 40_Hz});
      bench.loop.advance(3s);
      CHECK(sensor.counts().lost == 0);
      for (int i = 1; i <= 10; ++i) {
        bench.fake.drop(5);
        bench.loop.advance(200ms);
        CHECK(bench.left_out() == 5 * i);
        // A counter of two bits sees one of five.
        const int seen = model.kind == ChipKind::lsm6dso ? 1 : 5;
        CHECK(std::abs(static_cast<int>(sensor.counts().lost) - seen * i) <= 1);
      }
      CHECK(bench.is_in_order());
      CHECK(sensor.health() == Health::ok);
      CHECK(bench.loop.runtime().balances());
    }
  }

  TEST_CASE("US-15 settings that are lost are told and set again, and what was not sampled is counted") {
    for (const Model& model : models) {
      CAPTURE(std::string(model.name));
      InertialBench bench(model);
      AnySensor sensor = bench.make({.name = "s", .rate = 50_Hz});
      bench.loop.advance(2001ms);
      bench.fake.lose_power();
      bench.loop.advance(500ms);
      CHECK(sensor.health() == Health::ok);
      CHECK(sensor.counts().unreadable == 1);
      REQUIRE(!bench.errors.empty());
      CHECK(bench.errors[0].find("it has lost its settings") != std::string::npos);
      CHECK(bench.left_out() > 5);
      CHECK(std::abs(static_cast<int>(sensor.counts().lost) - bench.left_out()) <= 1);
      CHECK(bench.is_in_order());
      CHECK(bench.loop.runtime().balances());
    }
  }

  TEST_CASE("US-15 whichever transfers of any model fail, what is published is whole, and the account balances") {
    for (const Model& model : models) {
      CAPTURE(std::string(model.name));
      for (int at = 0; at < 40; ++at) {
        CAPTURE(at);
        for (const unsigned count : {1u, 4u}) {
          InertialBench bench(model);
          bench.wires->chip(model.address).set_duration(200us);
          AnySensor sensor = bench.make(
              {.name = "s", .rate = 50_Hz, .faulted_after = 100, .retry_first = 10ms, .retry_longest = 10ms});
          bench.loop.advance(300ms + at * 500us);
          bench.wires->chip(model.address).fail(count, at % 2 == 0 ? ENXIO : EIO);
          bench.loop.advance(500ms);
          CHECK(sensor.health() == Health::ok);
          CHECK(bench.numbers.size() > 200);
          CHECK(bench.are_whole);
          CHECK(bench.is_in_order());
          CHECK(std::abs(static_cast<int>(sensor.counts().lost) - bench.left_out()) <= 2);
          CHECK(bench.loop.runtime().balances());
        }
      }
    }
  }

  TEST_CASE("US-15 what a chip took while it could not be read is lost, by the time and its rate, and has its gap") {
    for (const Model& model : models) {
      CAPTURE(std::string(model.name));
      for (const int outage : {300, 2000, 7000}) {
        CAPTURE(outage);
        InertialBench bench(model);
        AnySensor sensor = bench.make({.name = "s", .rate = 50_Hz, .retry_first = 50ms, .retry_longest = 200ms});
        bench.loop.advance(2001ms);
        CHECK(sensor.counts().lost == 0);
        bench.wires->chip(model.address).unplug();
        bench.loop.advance(outage * 1ms);
        CHECK(sensor.health() == Health::faulted);
        CHECK(sensor.counts().lost == 0);
        bench.wires->chip(model.address).plug_in();
        bench.loop.advance(2s);
        CHECK(sensor.health() == Health::ok);
        CHECK(sensor.counts().failed > 0);
        CHECK(bench.left_out() > outage / 1000.0 * model.rate);
        // Within what is known of the chip's rate.
        CHECK(std::abs(static_cast<int>(sensor.counts().lost) - bench.left_out()) <= 2 + bench.left_out() / 400);
        CHECK(bench.is_in_order());
        // Once more: what was counted is not counted again.
        bench.wires->chip(model.address).unplug();
        bench.loop.advance(500ms);
        bench.wires->chip(model.address).plug_in();
        bench.loop.advance(2s);
        CHECK(std::abs(static_cast<int>(sensor.counts().lost) - bench.left_out()) <= 4 + bench.left_out() / 400);
        CHECK(bench.loop.runtime().balances());
      }
    }
  }

  TEST_CASE(
      "US-15 what a chip took until its sensor was stopped in a fault is lost; what it took when stopped is not") {
    for (const Model& model : models) {
      CAPTURE(std::string(model.name));
      InertialBench bench(model);
      AnySensor sensor = bench.make({.name = "s", .rate = 50_Hz});
      bench.loop.advance(2001ms);
      sensor.stop();
      bench.loop.advance(1s);
      sensor.start();
      bench.loop.advance(1001ms);
      CHECK(sensor.counts().lost == 0);
      bench.wires->chip(model.address).unplug();
      bench.loop.advance(1500ms);
      sensor.stop();
      const auto lost = static_cast<double>(sensor.counts().lost);
      CHECK(lost == doctest::Approx(1.5 * model.rate).epsilon(0.03));
      bench.wires->chip(model.address).plug_in();
      bench.loop.advance(5s);
      sensor.start();
      bench.loop.advance(1s);
      CHECK(static_cast<double>(sensor.counts().lost) == lost);
      CHECK(bench.loop.runtime().balances());
    }
  }

  TEST_CASE("US-15 garbage, and tags with a wrong parity, are told, and never a sample") {
    for (const Model& model : models) {
      CAPTURE(std::string(model.name));
      InertialBench bench(model);
      AnySensor sensor = bench.make({.name = "s", .rate = 50_Hz});
      bench.loop.advance(1s);
      const std::size_t before = bench.numbers.size();
      FakeI2cChip& chip = bench.wires->chip(model.address);
      for (const int number : {0x0a, 0x2e, 0x38, 0x2f, 0x39, 0x3a, 0x3e, 0x78, 0x18, 0x28, 0x32, 0x67, 0x70, 0x72})
        chip.on_read(static_cast<std::uint8_t>(number), [] { return std::uint8_t{0xff}; });
      bench.loop.advance(500ms);
      CHECK(bench.numbers.size() == before);
      CHECK(!bench.errors.empty());
      CHECK(bench.loop.runtime().balances());
    }
    InertialBench bench(models[1]);
    AnySensor sensor = bench.make({.name = "s", .rate = 50_Hz});
    bench.loop.advance(1s);
    const std::size_t before = bench.numbers.size();
    bench.fake.spoils_parity = true;
    bench.loop.advance(100ms);
    CHECK(bench.numbers.size() <= before + 10);
    CHECK(sensor.status().reason.find("words of its FIFO have a wrong parity") != std::string::npos);
    bench.fake.spoils_parity = false;
    bench.loop.advance(10s);
    CHECK(sensor.health() == Health::ok);
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-15 a self-test at the start passes within the data sheet's limits, and tells the axis that does not") {
    struct Change {
      double acceleration, rate;  // g, degrees a second
      const char* words;
    };
    for (const Change& change : {Change{0.3, 300, ""},
                                 {0.01, 300, "its acceleration x changes by 0.09"},
                                 {1.9, 300, "its acceleration x changes by 18.6"},
                                 {0.3, 100, "its angular velocity x changes by 1.74"},
                                 {0.3, 0, "its angular velocity x changes by 0 rad/s, not by 2.617994 to 12.217305"}}) {
      CAPTURE(change.acceleration);
      CAPTURE(change.rate);
      InertialBench bench(models[1]);
      FakeI2cChip& chip = bench.wires->chip(0x6a);
      std::uint16_t test = 0, tests = 0;
      std::size_t at = 0;
      chip.on_write(0x14, [&](std::uint16_t value) { test = value, tests |= value; });
      const auto byte_of = [&](double counts) {
        const int number = static_cast<int>(std::lround(counts));
        return static_cast<std::uint8_t>(at++ % 2 == 0 ? number & 0xff : number >> 8 & 0xff);
      };
      chip.on_read(0x28, [&] { return byte_of(100 + ((test & 1) != 0 ? change.acceleration / 0.122e-3 : 0)); });
      chip.on_read(0x22, [&] { return byte_of(-50 - ((test & 4) != 0 ? change.rate / 70e-3 : 0)); });
      DriverSensor<Imu> sensor(bench.loop, {.name = "s", .rate = 50_Hz}, bench.bus, {0x6a},
                               {.model = ImuModel::lsm6dso, .sample_rate = 416, .self_test = true});
      CHECK(tests == 5);
      CHECK(chip.get(0x14) == 0);
      if (std::string(change.words).empty()) {
        CHECK(sensor.health() == Health::ok);
        CHECK(chip.get(0x10) == (6 << 4 | 1 << 2));  // of the configuration again
        bench.loop.advance(1s);
        CHECK(bench.numbers.size() > 350);
      } else {
        CHECK(sensor.health() == Health::faulted);
        CHECK(sensor.status().reason.find("the self-test of the LSM6DSO failed") != std::string::npos);
        CHECK_MESSAGE(sensor.status().reason.find(change.words) != std::string::npos, sensor.status().reason);
      }
    }
  }

  TEST_CASE("US-15 NFR-6 other chips and settings that a model does not have are told with what there is") {
    InertialBench bench(models[2]);
    DriverSensor<Imu> imu(bench.loop, {.name = "a", .rate = 50_Hz}, bench.bus, {0x6b}, {.model = ImuModel::lsm6dso});
    REQUIRE(!bench.errors.empty());
    CHECK(bench.errors[0].find("its identity is 0x68, that of an LSM6DSO is 0x6c: it seems to be an LSM9DS1: set "
                               "`model`") != std::string::npos);
    const auto problems = [&](const std::string& sensor) {
      return plan_system(standard_registry(),
                         parse_config(R"({"buses": {"i2c1": {"type": "i2c", "device": "/dev/i2c-9"}}, "sensors": [
            {"name": "b", "rate": "50 Hz", "bus": "i2c1", )" +
                                          sensor + "}]}",
                                      "f.json"))
          .problems.text();
    };
    CHECK(problems(R"("type": "imu", "model": "lsm6dsox", "sample_rate": 104, "angular_range": 125)") == "");
    CHECK(problems(R"("type": "imu", "model": "lsm9ds1", "sample_rate": 59.5)") == "");
    CHECK(problems(R"("type": "accelerometer", "sample_rate": 12.5, "self_test": true)") == "");
    CHECK(problems(R"("type": "accelerometer", "model": "adxl375")") == "");
    CHECK(problems(R"("type": "imu", "model": "lsm6dso", "sample_rate": 100)")
              .find("100 is not one of 26, 52, 104, 208, 416, 833, 1660, which the LSM6DSO has") != std::string::npos);
    CHECK(problems(R"("type": "imu", "model": "lsm9ds1", "angular_range": 1000)")
              .find("1000 is not one of 245, 500, 2000") != std::string::npos);
    CHECK(problems(R"("type": "imu", "model": "lsm9ds1", "bandwidth": 42)").find("the LSM9DS1 has no such setting") !=
          std::string::npos);
    CHECK(problems(R"("type": "accelerometer", "model": "adxl375", "acceleration_range": 16)")
              .find("16 is not one of 200") != std::string::npos);
    CHECK(problems(R"("type": "accelerometer", "model": "adxl375", "self_test": true)")
              .find("no limits are known for the self-test of the ADXL375") != std::string::npos);
  }
}
