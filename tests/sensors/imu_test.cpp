// The IMU on a fake bus whose chip takes samples as virtual time passes: FIFO, overflow, lost settings.
#include <doctest/doctest.h>

#include <cerrno>
#include <cmath>
#include <deque>
#include <numbers>
#include <string>
#include <vector>

#include "rtdata/app/program.hpp"
#include "rtdata/chips/imu.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

/// An MPU-6050: its FIFO has a sample for each period since it was switched on; its Z of the rate is the number.
struct FakeMpu {
  explicit FakeMpu(FakeI2cChip& chip_) : chip(chip_) {
    chip.set(0x75, {0x68});
    chip.set(0x6b, {0x40});
    chip.on_write(0x6b, [this](std::uint16_t value) { is_awake = (value & 0xc0) == 0; });
    chip.on_write(0x6a, [this](std::uint16_t value) {
      take_samples();
      if ((value & 4) != 0) fifo.clear();
      is_on = (value & 0x40) != 0;
    });
    chip.on_read(0x72, [this] {
      take_samples();
      is_high = !is_high;
      return static_cast<std::uint8_t>(is_high ? fifo.size() >> 8 : fifo.size() & 0xff);
    });
    chip.on_read(0x3a, [this] {
      take_samples();
      return static_cast<std::uint8_t>(std::exchange(has_run_over, false) ? 0x11 : 0x01);
    });
    chip.on_read(0x74, [this]() -> std::uint8_t {
      take_samples();
      if (fifo.empty()) return 0xff;
      const std::uint8_t byte = fifo.front();
      fifo.pop_front();
      return byte;
    });
  }
  /// Those that are due. It takes them as long as it has power, whether anybody wants them or not.
  void take_samples() {
    const MonotonicTime now = detail::lane_now();
    if (begun == MonotonicTime{}) begun = next = now;
    for (; next <= now; next += period, ++taken) {
      if (!is_awake || !is_on) continue;
      const auto number = static_cast<std::uint16_t>(taken);
      const std::uint8_t bytes[14] = {0x08,
                                      0,
                                      0,
                                      0,
                                      0xf8,
                                      0,
                                      0x0d,
                                      0x48,
                                      0,
                                      0,
                                      0,
                                      0,
                                      static_cast<std::uint8_t>(number >> 8),
                                      static_cast<std::uint8_t>(number & 0xff)};
      for (const std::uint8_t byte : bytes) {
        if (fifo.size() == 1024) {
          fifo.pop_front();
          has_run_over = true;
        }
        fifo.push_back(byte);
      }
    }
  }
  void lose_power() {
    is_on = is_awake = false;
    fifo.clear();
    chip.set(0x6a, {0, 0x40});
  }
  FakeI2cChip& chip;
  Duration period = 2ms;
  MonotonicTime begun{}, next{};
  std::uint64_t taken = 0;
  std::deque<std::uint8_t> fifo;
  bool is_on = false, is_awake = false, is_high = false, has_run_over = false;
};

/// The number in a sample.
int number_in(const ImuReading& reading) {
  return static_cast<int>(std::lround(reading.angular_velocity_z / (2000 / 32750.0 * std::numbers::pi / 180)));
}

struct ImuBench {
  std::shared_ptr<FakeI2c> wires = std::make_shared<FakeI2c>();
  I2cBus bus{"i2c1", wires, {.timeout = 300ms}};
  FakeMpu mpu{wires->chip(0x68)};
  Loop loop{Loop::Manual{}};
  std::vector<std::string> errors;
  std::vector<int> numbers;
  std::vector<Time> times;
  bool are_whole = true;  // each sample is one of the chip's
  Subscription heard;
  ImuBench() {
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    heard = loop.subscribe<ImuReading>("imu", [this](const Event<ImuReading>& event) {
      numbers.push_back(number_in(*event));
      const auto is = [](double value, int count) { return std::lround(value / (16 * 9.80665 / 32768)) == count; };
      are_whole = are_whole && is(event->acceleration_x, 0x800) && is(event->acceleration_y, 0) &&
                  is(event->acceleration_z, -0x800);
      times.push_back(event.time);
    });
  }
  /// Numbers left out between the first and the last.
  int left_out() const {
    int count = 0;
    for (std::size_t i = 1; i < numbers.size(); ++i) count += numbers[i] - numbers[i - 1] - 1;
    return count;
  }
};

using ImuSensor = DriverSensor<Imu>;

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-15 MPU-6050: counts become m/s2, rad/s and degrees") {
    const Imu::Config config{.acceleration_range = 2, .angular_range = 250};
    // 1 g, -1 g, 2 g less one count; -521: 35 degrees (register map 4.18); 131: 1 degree a second (4.19).
    const std::array<std::uint8_t, 14> bytes{0x40, 0, 0xc0, 0, 0x7f, 0xff, 0xfd, 0xf7, 0, 131, 0xff, 0x7d, 0x80, 0};
    const ImuReading reading = Imu::decode(bytes, config);
    CHECK(reading.acceleration_x == doctest::Approx(9.80665));
    CHECK(reading.acceleration_y == doctest::Approx(-9.80665));
    CHECK(reading.acceleration_z == doctest::Approx(2 * 9.80665).epsilon(1e-4));
    CHECK(reading.temperature.value() == doctest::Approx(35).epsilon(0.0002));
    CHECK(reading.angular_velocity_x == doctest::Approx(std::numbers::pi / 180));
    CHECK(reading.angular_velocity_y == doctest::Approx(-std::numbers::pi / 180));
    CHECK(reading.angular_velocity_z == doctest::Approx(-32768 / 131.0 * std::numbers::pi / 180));
    CHECK(Imu::decode(bytes, {.model = ImuModel::mpu6500}).temperature.value() == doctest::Approx(-521 / 333.87 + 21));
    CHECK(Imu::decode(bytes, {.acceleration_range = 16}).acceleration_x == doctest::Approx(8 * 9.80665));
  }

  TEST_CASE("US-15 each sample of the FIFO is an event, in order, with a time of its own") {
    ImuBench bench;
    {
      ImuSensor imu(bench.loop, {.name = "imu", .rate = 50_Hz}, bench.bus, {0x68}, {.sample_rate = 500});
      bench.loop.advance(2001ms);
      CHECK(imu.health() == Health::ok);
      CHECK(imu.counts().lost == 0);
      CHECK(imu.counts().published == bench.numbers.size());
    }
    CHECK(bench.errors.empty());
    CHECK(bench.left_out() == 0);
    REQUIRE(bench.numbers.size() > 900);  // set-up takes 135 ms, and the last 20 ms are not read yet
    for (std::size_t i = 1; i < bench.times.size(); ++i) {
      CAPTURE(i);
      CHECK(bench.times[i] > bench.times[i - 1]);
      CHECK(bench.times[i] - bench.times[i - 1] <= 5ms);
    }
    CHECK((bench.times.back() - bench.times.front()) / static_cast<int>(bench.times.size() - 1) / 1us ==
          doctest::Approx(2000).epsilon(0.002));
    CHECK(bench.loop.runtime().balances());
    CHECK(bench.wires->chip(0x68).get(0x19) == 1);
    CHECK(bench.wires->chip(0x68).get(0x1a) == 3);
    CHECK(bench.wires->chip(0x68).get(0x1b) == 3 << 3);
    CHECK(bench.wires->chip(0x68).get(0x1c) == 3 << 3);
    CHECK(bench.wires->chip(0x68).get(0x6b) == 0x40);  // closed: it sleeps
  }

  TEST_CASE("US-15 a FIFO that has run over is emptied; what was in it and what found no room is counted as lost") {
    ImuBench bench;
    ImuSensor imu(bench.loop, {.name = "imu", .rate = 50_Hz, .faulted_after = 1000}, bench.bus, {0x68},
                  {.sample_rate = 500});
    bench.loop.advance(500ms);
    CHECK(imu.counts().lost == 0);
    bench.wires->chip(0x68).unplug();  // from the bus; it measures on
    bench.loop.advance(1s);
    bench.wires->chip(0x68).plug_in();
    bench.loop.advance(500ms);
    const int left_out = bench.left_out();
    CHECK(left_out > 400);
    CHECK(std::abs(static_cast<int>(imu.counts().lost) - left_out) <= 1);
    REQUIRE(!bench.errors.empty());
    CHECK(bench.errors.back().find("the device dropped") != std::string::npos);
    CHECK(imu.health() == Health::ok);
    CHECK(bench.loop.runtime().balances());
    for (std::size_t i = 1; i < bench.times.size(); ++i) CHECK(bench.times[i] > bench.times[i - 1]);
  }

  TEST_CASE(
      "US-15 a sensor that is read too seldom for its FIFO is faulted and says what to do; its ticks are failed") {
    ImuBench bench;
    ImuSensor imu(bench.loop, {.name = "imu", .rate = 2_Hz}, bench.bus, {0x68}, {.sample_rate = 500});
    bench.loop.advance(10s);
    CHECK(bench.numbers.empty());
    CHECK(imu.counts().failed > 2);
    CHECK(imu.counts().lost > 700);
    CHECK(imu.counts().lost < bench.mpu.taken);
    CHECK(imu.status().reason.find("read it more often, or set a lower sample rate in the device") !=
          std::string::npos);
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-15 a chip that has lost its settings is told of, set up again, and its samples are counted") {
    ImuBench bench;
    ImuSensor imu(bench.loop, {.name = "imu", .rate = 50_Hz}, bench.bus, {0x68}, {.sample_rate = 500});
    bench.loop.advance(501ms);
    bench.mpu.lose_power();
    bench.loop.advance(500ms);
    CHECK(imu.health() == Health::ok);
    CHECK(imu.counts().unreadable == 1);
    REQUIRE(!bench.errors.empty());
    CHECK(bench.errors[0].find("it has lost its settings") != std::string::npos);
    CHECK(bench.left_out() > 10);
    CHECK(std::abs(static_cast<int>(imu.counts().lost) - bench.left_out()) <= 1);
    CHECK(bench.numbers.size() > 300);
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-15 whichever transfers fail, what is published is whole and in order, and the ledger balances") {
    for (int at = 0; at < 60; ++at) {
      for (const unsigned count : {1u, 2u, 3u, 5u}) {
        CAPTURE(at);
        CAPTURE(count);
        ImuBench bench;
        bench.wires->chip(0x68).set_duration(1ms);
        ImuSensor imu(bench.loop,
                      {.name = "imu", .rate = 20_Hz, .faulted_after = 100, .retry_first = 10ms, .retry_longest = 10ms},
                      bench.bus, {0x68}, {.sample_rate = 500});
        bench.loop.advance(400ms + at * 1ms);
        bench.wires->chip(0x68).fail(count, at % 2 == 0 ? ENXIO : EIO);
        bench.loop.advance(1s);
        CHECK(imu.health() == Health::ok);
        CHECK(bench.numbers.size() > 400);
        CHECK(bench.are_whole);
        for (std::size_t i = 1; i < bench.numbers.size(); ++i) CHECK(bench.numbers[i] > bench.numbers[i - 1]);
        for (std::size_t i = 1; i < bench.times.size(); ++i) CHECK(bench.times[i] > bench.times[i - 1]);
        CHECK(std::abs(static_cast<int>(imu.counts().lost) - bench.left_out()) <= 2);
        CHECK(bench.loop.runtime().balances());
      }
    }
  }

  TEST_CASE("US-15 a FIFO that runs over while it is read gives no sample made of two") {
    std::uint64_t read = 0, lost = 0;
    for (int period = 130; period <= 160; ++period) {
      CAPTURE(period);
      ImuBench bench;
      bench.wires->chip(0x68).set_duration(1ms);
      ImuSensor imu(bench.loop, {.name = "imu", .rate = Rate::from_period(period * 1ms)}, bench.bus, {0x68},
                    {.sample_rate = 500});
      bench.loop.advance(3s);
      CHECK(bench.are_whole);
      for (std::size_t i = 1; i < bench.numbers.size(); ++i) CHECK(bench.numbers[i] > bench.numbers[i - 1]);
      CHECK(bench.loop.runtime().balances());
      read += bench.numbers.size();
      lost += imu.counts().lost;
    }
    CHECK(read > 5000);
    CHECK(lost > 1000);
  }

  TEST_CASE("US-15 garbage from the bus is told, and never a sample") {
    for (const std::uint8_t garbage : {std::uint8_t{0x00}, std::uint8_t{0xff}}) {
      ImuBench bench;
      ImuSensor imu(bench.loop, {.name = "imu", .rate = 50_Hz}, bench.bus, {0x68}, {.sample_rate = 500});
      bench.loop.advance(300ms);
      const std::size_t before = bench.numbers.size();
      FakeI2cChip& chip = bench.wires->chip(0x68);
      for (const std::uint8_t number : {std::uint8_t{0x3a}, std::uint8_t{0x72}, std::uint8_t{0x74}})
        chip.on_read(number, [garbage] { return garbage; });
      chip.set(0x6a, {garbage, garbage});
      bench.loop.advance(200ms);
      CHECK(bench.numbers.size() == before);
      CHECK(!bench.errors.empty());
      CHECK(bench.loop.runtime().balances());
    }
  }

  TEST_CASE("US-15 the self-test of an MPU compares with what the factory has found") {
    struct Change {
      ImuModel model;
      double acceleration, rate;  // g, degrees a second
      const char* words;
    };
    // Codes of the MPU-6050: 16 and 8: 0.34 * (0.92 / 0.34)^(15 / 30) = 0.559 g, 25 * 1.046^7 = 34.25 degrees a second;
    // of the MPU-6500: 100 and 50: 2620 / 16384 * 1.01^99 = 0.428 g, 20 * 1.01^49 = 32.57.
    for (const Change& change : {Change{ImuModel::mpu6050, 0.559, 34.25, ""},
                                 {ImuModel::mpu6050, 0.49, 34.25, ""},
                                 {ImuModel::mpu6050, 0.46, 34.25, "its acceleration x changes by 4.5"},
                                 {ImuModel::mpu6050, 0.66, 34.25, "its acceleration x changes by 6.4"},
                                 {ImuModel::mpu6050, 0.559, -30.5, ""},
                                 {ImuModel::mpu6050, 0.559, 40, "its angular velocity x changes by 0.69"},
                                 {ImuModel::mpu6500, 0.3, 40, ""},
                                 {ImuModel::mpu6500, 0.2, 40, "its acceleration x changes by 1.9"},
                                 {ImuModel::mpu6500, 0.3, 15, "its angular velocity x changes by 0.26"}}) {
      CAPTURE(change.acceleration);
      CAPTURE(change.rate);
      ImuBench bench;
      I2cBus slow("i2c2", bench.wires, {.timeout = 1s});
      FakeI2cChip& chip = bench.wires->chip(0x68);
      const bool is_old = change.model == ImuModel::mpu6050;
      if (is_old) {
        chip.set(0x0d, {4 << 5 | 8, 4 << 5 | 8, 4 << 5 | 8, 0});
      } else {
        chip.set(0x75, {0x70});
        chip.set(0x00, {50, 50, 50});
        chip.set(0x0d, {100, 100, 100});
      }
      bool pushes = false, turns = false;
      std::size_t at = 0;
      chip.on_write(0x1c, [&](std::uint16_t value) { pushes = value >> 5 == 7; });
      chip.on_write(0x1b, [&](std::uint16_t value) { turns = value >> 5 == 7; });
      const auto byte_of = [&](double counts) {
        const int number = static_cast<int>(std::lround(counts));
        return static_cast<std::uint8_t>(at++ % 2 == 0 ? number >> 8 & 0xff : number & 0xff);
      };
      chip.on_read(0x3b, [&] { return byte_of(123 + (pushes ? change.acceleration * (is_old ? 4096 : 16384) : 0)); });
      chip.on_read(0x43, [&] { return byte_of(-7 + (turns ? change.rate * 131 : 0)); });
      ImuSensor imu(bench.loop, {.name = "imu", .rate = 50_Hz}, slow, {0x68},
                    {.model = change.model, .sample_rate = 500, .self_test = true});
      CHECK(!pushes);
      if (std::string(change.words).empty()) {
        CHECK_MESSAGE(imu.health() == Health::ok, imu.status().reason);
        bench.loop.advance(1s);
        CHECK(bench.numbers.size() > 400);
        CHECK(bench.are_whole);
      } else {
        CHECK(imu.health() == Health::faulted);
        CHECK_MESSAGE(imu.status().reason.find(change.words) != std::string::npos, imu.status().reason);
      }
    }
  }

  TEST_CASE("US-15 another chip, and settings that it does not have, are told with what there is") {
    ImuBench bench;
    bench.wires->chip(0x68).set(0x75, {0x71});
    ImuSensor imu(bench.loop, {.name = "imu", .rate = 50_Hz}, bench.bus);
    REQUIRE(bench.errors.size() == 1);
    CHECK(bench.errors[0] ==
          "cannot use the chip as an MPU-6050: bus i2c1, 0x68: its identity is 0x71, that of an MPU-6050 is 0x68: it "
          "seems to be an MPU-9250: set `model`");
    CHECK_THROWS_WITH_AS(ImuSensor(bench.loop, {.name = "b", .rate = 50_Hz}, bench.bus, {0x69}, {.sample_rate = 300}),
                         doctest::Contains("300 is not one of 4, 5, 8"), SetupError);
    const std::string
        problems = plan_system(
                       standard_registry(),
                       parse_config(
                           R"({"buses": {"i2c1": {"type": "i2c", "device": "/dev/i2c-9"}}, "sensors": [{"name": "imu",
          "type": "imu", "rate": "50 Hz", "bus": "i2c1", "sample_rate": 300, "acceleration_range": 3,
          "angular_range": 300, "bandwidth": 50}]})",
                           "f.json"))
                       .problems.text();
    for (const char* part :
         {"300 is not one of 4, 5, 8", "3 is not one of 2, 4, 8, 16", "300 is not one of 250", "50 is not one of 188"})
      CHECK(problems.find(part) != std::string::npos);
  }
}
