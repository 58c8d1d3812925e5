// What every driver that configurations know keeps, whatever its chip does: all of them are tried over buses made of
// memory, made of a configuration, in virtual time. A new driver is tried without a line here; with one in `good_chips`
// its values are looked at, too.
#include <doctest/doctest.h>

#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <optional>
#include <random>
#include <sstream>

#include "app/core/standard_drivers.hpp"
#include "rtdata/app/standard.hpp"
#include "rtdata/chips/sht.hpp"
#include "rtdata/config/change.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "rtdata/testing/fake_spi.hpp"
#include "sanitized.hpp"
#include "sensors/fixture.hpp"
#include "sensors/spi_bridge.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

// ---- what the chip does

enum class Chip {
  good,     // what good_chips says; for one that is not there, random
  absent,   // I2C: no acknowledgement; SPI: ones
  zeros,    // of all that is read
  ones,     //
  random,   //
  failing,  // the bytes of a good one, and an error
};

/// Of the one chip that is tried on a bus.
struct Wires {
  Chip chip = Chip::absent;
  int error = EIO;  // of `failing`
  unsigned failing_percent = 100;
  Duration takes{0};  // each transfer
  std::uint64_t transfers = 0;
  std::mt19937_64 random{1};
  FakeI2c i2c;  // how the chip behaves when it is good
  FakeSpi spi;
  bool has_good_chip = false;

  /// `good` fills what is read.
  template <class Good, class Fill>
  int transfer(bool acknowledges, Good good, Fill fill) {
    ++transfers;
    detail::lane_sleep(takes);
    switch (chip) {
      case Chip::good:
        break;
      case Chip::absent:
        fill([] { return 0xff; });
        return acknowledges ? ENXIO : 0;
      case Chip::zeros:
        fill([] { return 0; });
        return 0;
      case Chip::ones:
        fill([] { return 0xff; });
        return 0;
      case Chip::failing:
        if (random() % 100 >= failing_percent) break;
        if (has_good_chip) good();
        return error;
      case Chip::random:
        fill([this] { return static_cast<int>(random() & 0xff); });
        return 0;
    }
    if (has_good_chip) return good();
    fill([this] { return static_cast<int>(random() & 0xff); });
    return 0;
  }
};

constexpr unsigned neighbour_address = 0x11, neighbour_select = 77;
constexpr std::uint8_t neighbours_byte = 0x5a;

class I2cWires final : public I2cTransport {
 public:
  explicit I2cWires(std::shared_ptr<Wires> wires) : wires_(std::move(wires)) {}
  int transfer(unsigned address, std::span<const std::uint8_t> write, std::span<std::uint8_t> read) noexcept override {
    const auto fill = [&](auto next) {
      for (std::uint8_t& byte : read) byte = static_cast<std::uint8_t>(next());
    };
    if (address == neighbour_address) {
      fill([] { return neighbours_byte; });
      return 0;
    }
    return wires_->transfer(
        true, [&] { return wires_->i2c.transfer(address, write, read); }, fill);
  }

 private:
  std::shared_ptr<Wires> wires_;
};

class SpiWires final : public SpiTransport {
 public:
  explicit SpiWires(std::shared_ptr<Wires> wires) : wires_(std::move(wires)) {}
  int transfer(const SpiPlace& place, std::span<const SpiSegment> segments) noexcept override {
    const auto fill = [&](auto next) {
      for (const SpiSegment& segment : segments)
        for (std::uint8_t& byte : segment.read) byte = static_cast<std::uint8_t>(next());
    };
    if (place.chip_select == neighbour_select) {
      fill([] { return neighbours_byte; });
      return 0;
    }
    return wires_->transfer(
        false, [&] { return wires_->spi.transfer(place, segments); }, fill);
  }

 private:
  std::shared_ptr<Wires> wires_;
};

// ---- drivers of a user's own: tried as the shipped ones are, and the neighbours of those

struct Number {
  double number = 0;
  RTDATA_FIELDS(Number, (number, ""))
};

/// A chip from which one byte is read, which is always the same.
template <class DeviceOnBus>
class Echo {
 public:
  struct Config {
    double factor = 1;
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(parameter("factor", &Config::factor, "of the number"));
    }
  };
  using Value = Number;
  using Device = DeviceOnBus;
  static constexpr std::string_view notes = "\n- The address that one likes.\n";
  explicit Echo(const Config& config) : factor_(config.factor) {}
  Reading<Number> read(Device& chip) {
    std::array<std::uint8_t, 1> byte{};
    if (auto done = chip.read(byte); !done) return done.error();
    if (byte[0] != neighbours_byte)
      return Unreadable{chip.error(Errc::bad_data, "cannot read the echo", "it is another", "")};
    return Number{byte[0] * factor_};
  }

 private:
  double factor_;
};

// ---- buses and chips

/// A kind of bus that drivers are on.
struct FakeBus {
  std::string_view type;
  std::string item, place, neighbour;  // in JSON
  bool tells_absence;                  // of a chip whose driver cannot tell it from one
  void (*add)(Registry&, std::shared_ptr<Wires>);
};
const FakeBus fake_buses[] = {
    {"i2c", R"({"type": "i2c", "device": "none"})", R"("address": "0x23")",
     R"({"name": "neighbour", "type": "own-on-i2c", "bus": "b", "rate": "100 Hz", "address": "0x11"})", true,
     [](Registry& registry, std::shared_ptr<Wires> wires) {
       registry.add_bus<I2cConfig>("i2c", "made of memory",
                                   [wires](Runtime&, const std::string& name, const I2cConfig& config) {
                                     return I2cBus(name, std::make_shared<I2cWires>(wires), config);
                                   });
       app::add_register_drivers(registry);
       app::add_i2c_drivers(registry);
       registry.add_driver<Echo<I2cDevice>>("own-on-i2c", "a user's on I2C");
     }},
    {"spi", R"({"type": "spi", "device": "none"})", R"("chip_select": 3)",
     R"({"name": "neighbour", "type": "own-on-spi", "bus": "b", "rate": "100 Hz", "chip_select": 77})", false,
     [](Registry& registry, std::shared_ptr<Wires> wires) {
       registry.add_bus<SpiConfig>("spi", "made of memory",
                                   [wires](Runtime&, const std::string& name, const SpiConfig& config) {
                                     return SpiBus(name, std::make_shared<SpiWires>(wires), config);
                                   });
       app::add_register_drivers(registry);
       app::add_spi_drivers(registry);
       registry.add_driver<Echo<SpiDevice>>("own-on-spi", "a user's on SPI");
     }},
};

const FakeBus* bus_of(const std::string& type) {
  for (const FakeBus& bus : fake_buses)
    if (bus.type == type) return &bus;
  return nullptr;
}

bool is_near(const EventView& event, std::string_view path, double wanted) {
  const Value value = event.value(path).or_throw();
  return std::abs(std::get<double>(value) - wanted) < 1e-3 * std::abs(wanted);
}

/// What a chip is like that works, at the place where its driver looks for it.
struct GoodChip {
  std::string_view type;
  std::string members;  // of its item in a configuration, beside bus and rate
  void (*put)(Wires&);
  bool (*is_right)(const EventView& event);
  bool has_proof;             // by an identity or a checksum: neither zeros nor ones are taken for values
  std::string_view bus = "";  // where its driver is on several kinds; empty: the first
};

void put_bytes(FakeI2cChip& chip, std::uint8_t first, std::initializer_list<int> words) {
  for (const int word : words) {
    chip.set(first, {static_cast<std::uint8_t>(word & 0xff), static_cast<std::uint8_t>(word >> 8 & 0xff)});
    first = static_cast<std::uint8_t>(first + 2);
  }
}

/// A FIFO with two samples at each look: level, and 1 g upwards.
void put_imu(Wires& wires) {
  FakeI2cChip& chip = wires.i2c.chip(0x68);
  chip.set(0x75, {0x68});
  const auto at_count = std::make_shared<unsigned>(0), at_byte = std::make_shared<unsigned>(0);
  chip.on_read(0x72, [at_count] { return static_cast<std::uint8_t>((*at_count)++ % 2 == 0 ? 0 : 28); });
  chip.on_read(0x74, [at_byte] { return static_cast<std::uint8_t>((*at_byte)++ % 14 == 4 ? 0x08 : 0); });
  chip.on_write(0x6a, [=](std::uint16_t) { *at_byte = *at_count = 0; });
}

/// A LIS3MDL in a field of 1 gauss along X, which has a new sample at each look.
void put_magnetometer(Wires& wires) {
  FakeI2cChip& chip = wires.i2c.chip(0x1c);
  chip.set(0x0f, {0x3d});
  const auto registers = std::make_shared<std::array<std::uint8_t, 0x30>>();
  const auto at = std::make_shared<std::size_t>(0);
  (*registers)[0x27] = 0x08;
  (*registers)[0x28] = 0xba, (*registers)[0x29] = 0x1a;
  for (std::uint8_t number = 0x20; number <= 0x24; ++number)
    chip.on_write(number, [=](std::uint16_t value) { (*registers)[number] = static_cast<std::uint8_t>(value); });
  chip.on_read(0xa0, [=] { return (*registers)[0x20 + (*at)++ % 16]; });
}

/// A BMP280: its data sheet's example.
void put_barometer(Wires& wires) {
  FakeI2cChip& chip = wires.i2c.chip(0x76);
  chip.set(0xd0, {0x58});
  put_bytes(chip, 0x88, {27504, 26435, -1000, 36477, -10685, 3024, 2855, 140, -7, 15500, -14600, 6000});
  chip.set(0xf7, {0x65, 0x5a, 0xc0, 0x7e, 0xed, 0x00});
}
bool has_right_air(const EventView& event) {
  return is_near(event, "pressure", 100653.27) && is_near(event, "temperature", 25.08);
}

const GoodChip good_chips[] = {
    {"own-on-i2c", R"("address": "0x23")",
     [](Wires& wires) { wires.i2c.chip(0x23).on_read(0, [] { return neighbours_byte; }); },
     [](const EventView& event) { return is_near(event, "number", neighbours_byte); }, true},
    {"own-on-spi", R"("chip_select": 3)",
     [](Wires& wires) {
       wires.spi.on_transfer(3, [](auto, std::span<std::uint8_t> read) { std::fill(read.begin(), read.end(), 0x5a); });
     },
     [](const EventView& event) { return is_near(event, "number", neighbours_byte); }, true},
    {"barometer", "", put_barometer, has_right_air, true},
    {"barometer", R"("chip_select": 3)",
     [](Wires& wires) {
       put_barometer(wires);
       bridge(wires.spi, 3, wires.i2c, 0x76, {}, 0x80);
     },
     has_right_air, true, "spi"},
    {"imu", R"("model": "mpu6500", "chip_select": 3)",
     [](Wires& wires) {
       put_imu(wires);
       wires.i2c.chip(0x68).set(0x75, {0x70});
       bridge(wires.spi, 3, wires.i2c, 0x68, {});
     },
     [](const EventView& event) { return is_near(event, "acceleration_z", 9.80665); }, true, "spi"},
    {"magnetometer", R"("chip_select": 3)",
     [](Wires& wires) {
       put_magnetometer(wires);
       bridge(wires.spi, 3, wires.i2c, 0x1c, {.i2c_burst_bit = 0x80, .spi_burst_bit = 0x40});
     },
     [](const EventView& event) { return is_near(event, "magnetic_field_x", 1e-4); }, true, "spi"},
    {"imu", "", put_imu, [](const EventView& event) { return is_near(event, "acceleration_z", 9.80665); }, true},
    {"magnetometer", "", put_magnetometer,
     [](const EventView& event) { return is_near(event, "magnetic_field_x", 1e-4); }, true},
    {"lm75", "",
     [](Wires& wires) {
       FakeI2cChip& chip = wires.i2c.chip(0x48);
       chip.set_width(FakeI2cChip::Width::words);
       chip.set_word(0, 0x1900);
     },
     [](const EventView& event) { return is_near(event, "temperature", 25); }, false},
    {"sht", "",
     [](Wires& wires) {
       const std::array<std::uint8_t, 2> word{0x66, 0x66};
       const std::array<std::uint8_t, 2> status{0x80, 0x10};
       wires.i2c.chip(0x44).set(0xf4, {status[0], status[1], Sht::checksum(status)});
       wires.i2c.chip(0x44).set(0x25, {0x66, 0x66, Sht::checksum(word), 0x66, 0x66, Sht::checksum(word)});
       wires.i2c.chip(0x44).on_write(0x24, [](std::uint16_t) {});
     },
     [](const EventView& event) { return is_near(event, "temperature", 25) && is_near(event, "humidity", 40); }, true},
    {"ina", "",
     [](Wires& wires) {
       FakeI2cChip& chip = wires.i2c.chip(0x40);
       chip.set_width(FakeI2cChip::Width::words);
       chip.set_word(1, 0x1f40);
       chip.set_word(2, 4000 << 3 | 2);  // converted
     },
     [](const EventView& event) { return is_near(event, "voltage", 16) && is_near(event, "current", 0.8); }, true},
    {"mcp3x08", "",
     [](Wires& wires) {
       wires.spi.on_transfer(0, [](auto, std::span<std::uint8_t> read) {
         if (read.size() == 3) std::copy_n(std::array<std::uint8_t, 3>{0, 0x08, 0}.begin(), 3, read.begin());
       });
     },
     [](const EventView& event) { return is_near(event, "ain7", 1.65); }, false},
};

/// A driver is tried on each kind of bus that it is on: `page.bus` is the one.
bool is_on_other_bus(const TypeInfo& type) {
  const auto& others = type.page.other_buses;
  return std::find(others.begin(), others.end(), type.page.bus) != others.end();
}
const GoodChip* good_chip(const TypeInfo& type) {
  for (const GoodChip& chip : good_chips)
    if (chip.type == type.name && chip.bus == (is_on_other_bus(type) ? type.page.bus : "")) return &chip;
  return nullptr;
}

// ---- one driver on its bus, with a neighbour

/// How often the values of a driver are looked at.
enum class Values { good_ones, any };

class Rig {
 public:
  explicit Rig(const TypeInfo& type, std::uint64_t seed = 0)
      : type_(type), bus_(*bus_of(type.page.bus)), good_(good_chip(type)), loop(Loop::Manual{.seed = seed}) {
    began_ = loop.now();
    wires->random.seed(seed + 1);
    if (good_ != nullptr) {
      good_->put(*wires);
      wires->has_good_chip = true;
    }
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) {
      ++errors;
      CHECK_FALSE(report.error.what.empty());
    });
    bus_.add(registry, wires);
    heard_ = loop.subscribe("t", [this](const EventView& event) { take(event); });
  }

  std::string text(const std::string& members = R"("rate": "5 Hz")", bool is_there = true) const {
    return R"({"buses": {"b": )" + bus_.item + R"(}, "sensors": [)" + bus_.neighbour +
           (is_there ? ", " + item("s", members) : "") + "]}";
  }
  std::string item(const std::string& name, const std::string& members = R"("rate": "5 Hz")") const {
    const std::string members_of_chip(good_ != nullptr ? good_->members : is_on_other_bus(type_) ? bus_.place : "");
    const std::string own = members_of_chip.empty() ? "" : members_of_chip + ", ";
    return R"({"name": ")" + name + R"(", "topic": "t", "bus": "b", "type": ")" + type_.name + R"(", )" + own +
           R"("retry_first": "20 ms", "retry_longest": "80 ms", )" + members + "}";
  }
  void run(const std::string& text) { system.emplace(loop, registry, parse_config(text, "rig.json")); }
  void run() { run(text()); }

  AnySensor& sensor() { return system->sensor("s"); }
  AnySensor& neighbour() { return system->sensor("neighbour"); }
  bool has_good_chip() const { return good_ != nullptr; }
  bool has_proof() const { return good_ != nullptr && good_->has_proof; }
  bool tells_absence() const { return bus_.tells_absence || has_proof(); }

  /// A stretch of time, after which everything is accounted for.
  void pass(Duration time) {
    loop.advance(time);
    CHECK(loop.runtime().balances());
    for (const std::string& name : system->sensor_names()) CHECK(system->sensor(name).counts().balances());
  }
  /// Afterwards the sensor is well, with fresh values.
  void expect_good() {
    wires->chip = Chip::good;
    wires->takes = Duration{0};
    pass(3s);
    if (!has_good_chip()) return;
    const std::uint64_t before = events;
    values = Values::good_ones;
    pass(2s);
    CHECK(sensor().health() == Health::ok);
    CHECK(events >= before + 4);
  }
  void expect_nothing_for(Duration time) {
    const std::uint64_t before = events;
    pass(time);
    CHECK(events == before);
    CHECK(sensor().health() != Health::ok);
  }

 private:
  void take(const EventView& event) {
    ++events;
    CHECK(event.time() > last_);
    last_ = event.time();
    // Of samples that came at one instant, each is 1 ns after the one before.
    CHECK(last_ - Time{std::chrono::seconds{1'700'000'000}} <= loop.now() - began_ + 1us);
    for (const Leaf& leaf : event.description().leaves()) {
      const Value value = event.value(leaf);
      if (const double* number = std::get_if<double>(&value)) CHECK_MESSAGE(std::isfinite(*number), leaf.path);
    }
    if (values == Values::good_ones && good_ != nullptr) CHECK(good_->is_right(event));
  }

  const TypeInfo& type_;
  const FakeBus& bus_;
  const GoodChip* good_;
  Time last_{};
  MonotonicTime began_{};

 public:
  std::shared_ptr<Wires> wires = std::make_shared<Wires>();
  Registry registry;
  Loop loop;
  std::uint64_t events = 0, errors = 0;
  Values values = Values::good_ones;

 private:
  Subscription heard_;

 public:
  std::optional<System> system;
};

/// Buses whose devices answer requests in words of their own: their drivers are tried with real peers, on pseudo
/// terminals and sockets (serial_port_test.cpp, modbus_test.cpp, sensor_contract_test.cpp).
constexpr std::string_view buses_of_requests[] = {"serial", "modbus"};

/// All that are on a bus that there is a fake of.
std::vector<TypeInfo> drivers() {
  std::vector<TypeInfo> all;
  for (const FakeBus& bus : fake_buses) {
    Registry registry;
    bus.add(registry, std::make_shared<Wires>());
    for (TypeInfo& type : registry.sensors().types()) {
      type.page.bus = bus.type;
      all.push_back(std::move(type));
    }
  }
  return all;
}

constexpr int errnos[] = {EIO,    ENXIO,  EREMOTEIO, ETIMEDOUT, EAGAIN, EBUSY, EOPNOTSUPP,
                          ENODEV, EINVAL, ENOENT,    EACCES,    EPERM,  EBADF, ENOMEM};

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("driver contract: all drivers of the program are tried, and say what their page needs") {
    std::vector<std::string> tried;
    for (const TypeInfo& type : drivers()) tried.push_back(type.name);
    for (const TypeInfo& type : standard_registry().sensors().types()) {
      if (type.page.bus.empty()) continue;
      CAPTURE(type.name);
      CAPTURE(type.page.bus);
      CHECK_FALSE(type.doc.empty());
      CHECK_FALSE(type.page.notes.empty());
      const auto published = type.page.publishes();
      CHECK((type.page.depends_on_parameters || published != nullptr));
      if (published != nullptr) CHECK(published->leaves().size() >= 1);
      const auto& requests = buses_of_requests;
      if (std::find(std::begin(requests), std::end(requests), type.page.bus) != std::end(requests)) continue;
      CHECK_MESSAGE(bus_of(type.page.bus) != nullptr, "fake_buses lacks a bus of type " << type.page.bus);
      CHECK(std::find(tried.begin(), tried.end(), type.name) != tried.end());
    }
    const Registry own = [] {
      Registry registry;
      registry.add_driver<Echo<I2cDevice>>("echo", "a user's");
      return registry;
    }();
    CHECK(own.sensors().find("echo")->page.notes == "- The address that one likes.");
    CHECK(own.sensors().find("echo")->page.publishes()->leaves()[0].path == "number");
  }

  TEST_CASE("US-27 driver contract: absent at the start, plugged in, unplugged, plugged in again") {
    for (const TypeInfo& type : drivers()) {
      CAPTURE(type.name);
      CAPTURE(type.page.bus);
      Rig rig(type);
      rig.values = Values::any;
      rig.run();
      if (rig.tells_absence()) {
        rig.expect_nothing_for(5s);
        CHECK(rig.errors >= 1);
        CHECK(rig.sensor().counts().failed >= 20);
      }
      rig.pass(1s);
      for (int i = 0; i < 3; ++i) {
        rig.expect_good();
        rig.wires->chip = Chip::absent;
        rig.values = Values::any;
        rig.pass(1s);  // what was read before
        if (!rig.tells_absence()) continue;
        rig.expect_nothing_for(5s);
        CHECK(rig.sensor().health() == Health::faulted);
        CHECK_FALSE(rig.sensor().status().reason.empty());
      }
      rig.expect_good();
      CHECK(rig.neighbour().counts().failed == 0);
      CHECK(rig.neighbour().health() == Health::ok);
      CHECK(rig.events == rig.sensor().counts().published);
    }
  }

  TEST_CASE("US-27 driver contract: a required device that is absent ends the set-up, and nothing is left behind") {
    for (const TypeInfo& type : drivers()) {
      CAPTURE(type.name);
      CAPTURE(type.page.bus);
      Rig rig(type);
      const std::string text = rig.text(R"("rate": "5 Hz", "required": true)");
      if (rig.tells_absence()) {
        CHECK_THROWS_AS(rig.run(text), SetupError);
        CHECK_FALSE(rig.system);
      }
      rig.wires->chip = Chip::good;
      if (!rig.has_good_chip()) continue;
      rig.run(text);
      rig.expect_good();
    }
  }

  TEST_CASE("US-27 driver contract: a transfer that fails gives no value, whatever the bytes and the error") {
    for (const TypeInfo& type : drivers()) {
      CAPTURE(type.name);
      CAPTURE(type.page.bus);
      for (const int error : std::span(errnos).first(rtdata::test::sanitized ? 3 : std::size(errnos))) {
        CAPTURE(error);
        Rig rig(type);
        rig.wires->chip = Chip::good;
        rig.run();
        rig.expect_good();
        rig.wires->chip = Chip::failing;
        rig.wires->error = error;
        rig.pass(1s);
        rig.expect_nothing_for(3s);
        CHECK(rig.errors >= 1);
        rig.expect_good();
      }
    }
  }

  TEST_CASE("US-27 driver contract: transfers that fail at random cost their readings, and make no value wrong") {
    for (const TypeInfo& type : drivers()) {
      CAPTURE(type.name);
      CAPTURE(type.page.bus);
      for (std::uint64_t seed = 1; seed <= 10; seed += rtdata::test::sanitized ? 4 : 1) {
        CAPTURE(seed);
        Rig rig(type, seed);
        if (!rig.has_good_chip()) break;
        rig.wires->chip = Chip::failing;
        rig.wires->failing_percent = static_cast<unsigned>(2 * seed);
        rig.run();
        rig.pass(30s);
        CHECK(rig.events > 0);
        rig.expect_good();
      }
    }
  }

  TEST_CASE("US-27 driver contract: zeros, ones and random bytes are unreadable, or values; never a crash") {
    for (const TypeInfo& type : drivers()) {
      CAPTURE(type.name);
      CAPTURE(type.page.bus);
      for (const Chip chip : {Chip::zeros, Chip::ones, Chip::random}) {
        for (const bool from_the_start : {true, false}) {
          for (std::uint64_t seed = 0; seed < (chip != Chip::random      ? 1u
                                               : rtdata::test::sanitized ? 4u
                                                                         : 20u);
               ++seed) {
            CAPTURE(static_cast<int>(chip));
            CAPTURE(from_the_start);
            CAPTURE(seed);
            Rig rig(type, seed);
            rig.wires->chip = from_the_start ? chip : Chip::good;
            rig.values = Values::any;
            rig.run();
            if (!from_the_start) rig.expect_good();
            rig.values = Values::any;
            rig.wires->chip = chip;
            rig.pass(1s);
            if (rig.has_proof() && chip != Chip::random && from_the_start) {
              rig.expect_nothing_for(5s);
            } else {
              rig.pass(5s);
            }
            const SensorCounts counts = rig.sensor().counts();
            CHECK(counts.scheduled > 0);
            CHECK(rig.events == counts.published);
            rig.expect_good();
            CHECK(rig.neighbour().counts().failed == 0);
          }
        }
      }
    }
  }

  TEST_CASE("NFR-1 driver contract: a transfer that hangs is given up, and others on the bus go on") {
    for (const TypeInfo& type : drivers()) {
      CAPTURE(type.name);
      CAPTURE(type.page.bus);
      Rig rig(type);
      rig.wires->chip = Chip::good;
      rig.run();
      rig.expect_good();
      rig.wires->takes = 1h;
      rig.pass(5s);
      const std::uint64_t others = rig.neighbour().counts().published;
      rig.expect_nothing_for(20s);
      CHECK(rig.neighbour().counts().published > others + 100);
      CHECK(rig.neighbour().counts().failed == 0);
      rig.wires->takes = Duration{0};
      rig.pass(60s);  // threads that were left behind are back
      rig.expect_good();
    }
  }

  TEST_CASE(
      "driver contract: stop, start, another rate, another configuration; no event and no transfer after a stop") {
    for (const TypeInfo& type : drivers()) {
      CAPTURE(type.name);
      CAPTURE(type.page.bus);
      for (std::uint64_t seed = 0; seed < 10; ++seed) {
        CAPTURE(seed);
        Rig rig(type, seed);
        rig.wires->chip = Chip::good;
        rig.run();
        rig.expect_good();
        rig.pass(std::chrono::milliseconds{seed * 23});  // in the middle of a conversion, for some
        rig.sensor().stop();
        rig.loop.advance(5ms);  // what the driver does to close its chip
        const std::uint64_t events = rig.events, transfers = rig.wires->transfers;
        rig.pass(5s);
        CHECK(rig.events == events);
        CHECK(rig.wires->transfers == transfers);
        rig.sensor().start();
        rig.expect_good();
        rig.sensor().set_rate(2_Hz);
        rig.expect_good();

        const auto apply = [&](const std::string& text) {
          rig.system->apply(plan_system(rig.registry, parse_config(text, "rig.json")));
        };
        apply(rig.text(R"("rate": "4 Hz")"));
        CHECK(rig.sensor().rate().period() == 250ms);
        rig.expect_good();
        apply(rig.text(R"("rate": "5 Hz", "faulted_after": 2)"));  // which restarts it
        rig.expect_good();
        apply(rig.text("", false));
        const std::uint64_t before = rig.events, transfers_before = rig.wires->transfers;
        rig.pass(3s);
        CHECK(rig.events == before);
        CHECK(rig.wires->transfers <= transfers_before + 4);  // closed on the lane
        apply(rig.text());
        rig.expect_good();
        rig.sensor().close();
        rig.loop.advance(1s);
        CHECK(rig.loop.runtime().balances());
      }
    }
  }

  TEST_CASE("US-12 driver contract: two sensors at one place are a mistake of the configuration") {
    for (const TypeInfo& type : drivers()) {
      CAPTURE(type.name);
      CAPTURE(type.page.bus);
      Rig rig(type);
      rig.wires->chip = Chip::good;
      const std::string two = R"({"buses": {"b": )" + bus_of(type.page.bus)->item + R"(}, "sensors": [)" +
                              rig.item("s") + ", " + rig.item("again") + "]}";
      const SystemPlan plan = plan_system(rig.registry, parse_config(two, "rig.json"));
      CHECK(plan.problems.text().find("already; give each") != std::string::npos);
      CHECK_THROWS_AS(rig.run(two), ConfigError);
      rig.run();
      CHECK_THROWS_AS(rig.system->add_sensor(parse_config(rig.item("again")).or_throw()), ConfigError);
      rig.expect_good();
    }
  }

  TEST_CASE("driver contract: whatever happens at random") {
    const char* const wanted = std::getenv("RTDATA_TEST_SEEDS");  // "FIRST COUNT", to look for more
    std::uint64_t first = 1, count = 5;
    if (wanted != nullptr) std::istringstream(wanted) >> first >> count;
    for (const TypeInfo& type : drivers()) {
      CAPTURE(type.name);
      CAPTURE(type.page.bus);
      for (std::uint64_t seed = first; seed < first + count; ++seed) {
        CAPTURE(seed);
        Rig rig(type, seed);
        rig.run();
        std::mt19937_64 random(seed);
        constexpr Chip without_garbage[] = {Chip::good, Chip::good, Chip::absent, Chip::failing};
        constexpr Chip all[] = {Chip::good, Chip::absent, Chip::zeros, Chip::ones, Chip::random, Chip::failing};
        const bool has_garbage = seed % 2 == 0 || !rig.has_proof();
        if (has_garbage) rig.values = Values::any;
        for (int step = 0; step < 60; ++step) {
          switch (random() % 8) {
            case 0:
              rig.sensor().stop();
              break;
            case 1:
              rig.sensor().start();
              break;
            case 2:
              rig.sensor().set_rate(Rate::from_period(std::chrono::milliseconds{1 + random() % 500}));
              break;
            case 3:
              rig.wires->takes = random() % 4 == 0 ? Duration{10s}
                                                   : Duration{std::chrono::microseconds{random() % 900}};
              break;
            default:
              rig.wires->chip = has_garbage ? all[random() % std::size(all)]
                                            : without_garbage[random() % std::size(without_garbage)];
              rig.wires->error = errnos[random() % std::size(errnos)];
              rig.wires->failing_percent = static_cast<unsigned>(random() % 101);
              break;
          }
          rig.pass(std::chrono::microseconds{random() % 1'000'000});
        }
        rig.wires->takes = Duration{0};
        rig.wires->chip = Chip::good;
        rig.sensor().set_rate(5_Hz);
        rig.sensor().start();
        rig.values = Values::any;
        rig.pass(60s);
        rig.expect_good();
        CHECK(rig.events == rig.sensor().counts().published);
      }
    }
  }
}
