// What every driver that configurations know keeps, whatever its chip does: all of them are tried over buses made of
// memory, made of a configuration, in virtual time, with the samples that they state (chip.hpp). A new driver is tried
// without a line here.
#include <doctest/doctest.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <memory>
#include <optional>
#include <random>
#include <sstream>
#include <type_traits>
#include <variant>

#include "app/core/standard_drivers.hpp"
#include "app/inspect/types_markdown.hpp"
#include "app/machine/scanner.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/change.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/io/spi.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "sanitized.hpp"
#include "sensors/fixture.hpp"
#include "sensors/sample_chip.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

// ---- what the chip does

enum class Chip {
  good,     // what its sample says
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
  std::optional<SampleChip> good;  // how the chip behaves then
  std::vector<unsigned> places;    // at which it answers

  /// `absent`: what comes of a transfer without the chip. `with_good`: carries it out; `fill`: what is read.
  template <class Good, class Fill>
  int transfer(unsigned place, int absent, Good with_good, Fill fill) {
    if (std::find(places.begin(), places.end(), place) == places.end()) {
      fill([] { return 0xff; });
      return absent;
    }
    ++transfers;
    detail::lane_sleep(takes);
    switch (chip) {
      case Chip::good:
        break;
      case Chip::absent:
        fill([] { return 0xff; });
        return absent;
      case Chip::zeros:
        fill([] { return 0; });
        return 0;
      case Chip::ones:
        fill([] { return 0xff; });
        return 0;
      case Chip::random:
        fill([this] { return static_cast<int>(random() & 0xff); });
        return 0;
      case Chip::failing:
        if (random() % 100 >= failing_percent) break;
        with_good();
        return error;
    }
    with_good();
    return 0;
  }
};

constexpr unsigned neighbour_address = 0x11, neighbour_select = 77, tried_select = 3;
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
    const auto with_good = [&] {
      wires_->good->take(write);
      wires_->good->give(read);
    };
    return wires_->transfer(address, ENXIO, with_good, fill);
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
    const auto with_good = [&] {
      for (const SpiSegment& segment : segments) {
        wires_->good->take(segment.write);
        wires_->good->give(segment.read);
      }
    };
    return wires_->transfer(place.chip_select, 0, with_good, fill);
  }

 private:
  std::shared_ptr<Wires> wires_;
};

// ---- drivers of a user's own: tried as the shipped ones are, and the neighbours of those

struct Number {
  double number = 0;
  RTDATA_FIELDS(Number, (number, ""))
};

struct KnownEcho {
  static constexpr KnownChip chips[] = {{.name = "ECHO1", .addresses = {0x0a}}};
  static constexpr ChipSample samples[] = {{.members = R"("factor": 2)",
                                            .wires = ChipWires::answers,
                                            .bytes = {{{"", "5a"}}},
                                            .values = {{{"number", 180}}},
                                            .has_proof = true}};
};
/// A chip from which one byte is read, which is always the same.
template <class DeviceOnBus>
class Echo : public KnownEcho {
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
  static constexpr typename Device::Place place{0x0a};
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

/// A user's own chip: all that scan, types and these tests know of it.
class OwnChip {
 public:
  static constexpr std::string_view type = "own-chip";
  static constexpr std::string_view description = "a number of an OWN1 on I2C";
  struct Config {
    std::optional<IdentityCode> identity{};
    friend constexpr auto parameters(type_tag<Config>) { return parameter_list(identity_parameter(&Config::identity)); }
  };
  using Value = Number;
  using Device = I2cDevice;
  static constexpr Device::Place place{0x30};
  static constexpr KnownChip chips[] = {{.name = "OWN1", .addresses = {0x30, 0x31}, .identity = {{0x07, 0x42}}}};
  static constexpr ChipSample samples[] = {
      {.bytes = {{{"01", "12"}, {"07", "42"}}}, .values = {{{"number", 18}}}, .has_proof = true}};
  explicit OwnChip(const Config& config) : config_(config) {}

  Result<void> open(Device& chip) { return check_identity(chip, chips[0], config_.identity); }
  Result<Number> read(Device& chip) {
    const Result<std::uint8_t> number = chip.read_register(0x01);
    if (!number) return number.error();
    return Number{static_cast<double>(*number)};
  }

 private:
  Config config_;
};

// ---- buses and chips

/// A kind of bus that drivers are on.
struct FakeBus {
  std::string_view type;
  std::string item, place, neighbour;  // in JSON
  bool tells_absence;                  // of a chip whose driver cannot tell it from one
  SampleChip::On on;
  void (*add)(Registry&, std::shared_ptr<Wires>);
};
const FakeBus fake_buses[] = {
    {"i2c", R"({"type": "i2c", "device": "none"})", "",
     R"({"name": "neighbour", "type": "own-on-i2c", "bus": "b", "rate": "100 Hz", "address": "0x11"})", true,
     SampleChip::On::i2c,
     [](Registry& registry, std::shared_ptr<Wires> wires) {
       registry.add_bus<I2cConfig>("i2c", "made of memory",
                                   [wires](Runtime&, const std::string& name, const I2cConfig& config) {
                                     return I2cBus(name, std::make_shared<I2cWires>(wires), config);
                                   });
       app::add_register_drivers(registry);
       app::add_i2c_drivers(registry);
       app::add_gas_drivers(registry);
       registry.add_driver<Echo<I2cDevice>>("own-on-i2c", "a user's on I2C");
       registry.add_driver<OwnChip>();
     }},
    {"spi", R"({"type": "spi", "device": "none"})", R"("chip_select": 3)",
     R"({"name": "neighbour", "type": "own-on-spi", "bus": "b", "rate": "100 Hz", "chip_select": 77})", false,
     SampleChip::On::spi,
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

const FakeBus* bus_of(std::string_view type) {
  for (const FakeBus& bus : fake_buses)
    if (bus.type == type) return &bus;
  return nullptr;
}

/// A driver with one of its samples, on one of the kinds of bus that it is on.
struct Tried {
  TypeInfo type;
  const FakeBus* bus;
  const ChipSample* sample;
  std::string text() const { return type.name + " on " + std::string(bus->type) + " " + std::string(sample->members); }
};

/// All that are on a bus that there is a fake of.
std::vector<Tried> drivers() {
  std::vector<Tried> all;
  for (const FakeBus& bus : fake_buses) {
    Registry registry;
    bus.add(registry, std::make_shared<Wires>());
    for (const TypeInfo& type : registry.sensors().types()) {
      for (const ChipSample& sample : type.page.samples) {
        const bool is_on_i2c_only = sample.addressing != nullptr && !sample.addressing->without_spi.empty();
        if (bus.on == SampleChip::On::i2c || !is_on_i2c_only) all.push_back({type, &bus, &sample});
      }
    }
  }
  return all;
}

double number_of(const Value& value) {
  return std::visit(
      [](const auto& one) -> double {
        if constexpr (std::is_arithmetic_v<std::remove_cvref_t<decltype(one)>>) return static_cast<double>(one);
        return std::numeric_limits<double>::quiet_NaN();
      },
      value);
}

bool is_right(const ChipSample& sample, const EventView& event) {
  for (const ChipValue& wanted : sample.values) {
    if (wanted.field.empty()) continue;
    const double number = number_of(event.value(wanted.field).or_throw());
    if (!(std::abs(number - wanted.value) < 1e-3 * std::abs(wanted.value))) return false;
  }
  return true;
}

// ---- one driver on its bus, with a neighbour

/// How often the values of a driver are looked at.
enum class Values { good_ones, any };

class Rig {
 public:
  explicit Rig(const Tried& tried, std::uint64_t seed = 0)
      : type_(tried.type), bus_(*tried.bus), sample_(*tried.sample), loop(Loop::Manual{.seed = seed}) {
    began_ = loop.now();
    wires->random.seed(seed + 1);
    wires->good.emplace(sample_, bus_.on);
    if (bus_.on == SampleChip::On::spi) wires->places.push_back(tried_select);
    for (const KnownChip& chip : type_.page.chips)
      if (bus_.on == SampleChip::On::i2c)
        wires->places.insert(wires->places.end(), chip.addresses.begin(), chip.addresses.end());
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
    std::string own;
    for (const std::string_view more : {std::string_view(bus_.place), sample_.members})
      if (!more.empty()) own.append(more).append(", ");
    return R"({"name": ")" + name + R"(", "topic": "t", "bus": "b", "type": ")" + type_.name + R"(", )" + own +
           R"("retry_first": "20 ms", "retry_longest": "80 ms", )" + members + "}";
  }
  void run(const std::string& text) { system.emplace(loop, registry, parse_config(text, "rig.json")); }
  void run() { run(text()); }

  AnySensor& sensor() { return system->sensor("s"); }
  AnySensor& neighbour() { return system->sensor("neighbour"); }
  bool has_proof() const { return sample_.has_proof; }
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
    const std::uint64_t before = events;
    values = Values::good_ones;
    pass(2s);
    const std::string reason = sensor().status().reason;
    // The FIFO of its sample holds the same number whenever it is read, so that some are missing by the driver's clock.
    const bool is_short = type_.name == "accelerometer" && reason.find("the device dropped ") != std::string::npos;
    CHECK_MESSAGE((sensor().health() == Health::ok || is_short), reason);
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
    if (values == Values::good_ones) CHECK(is_right(sample_, event));
  }

  const TypeInfo& type_;
  const FakeBus& bus_;
  const ChipSample& sample_;
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

constexpr int errnos[] = {EIO,    ENXIO,  EREMOTEIO, ETIMEDOUT, EAGAIN, EBUSY, EOPNOTSUPP,
                          ENODEV, EINVAL, ENOENT,    EACCES,    EPERM,  EBADF, ENOMEM};

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("driver contract: all drivers of the program are tried, and say what their page needs") {
    const std::vector<Tried> all = drivers();
    const auto is_tried = [&all](const std::string& type, const std::string& bus) {
      return std::any_of(all.begin(), all.end(),
                         [&](const Tried& one) { return one.type.name == type && one.bus->type == bus; });
    };
    for (const TypeInfo& type : standard_registry().sensors().types()) {
      if (type.page.bus.empty()) continue;
      CAPTURE(type.name);
      CHECK_FALSE(type.doc.empty());
      CHECK_FALSE(type.page.notes.empty());
      const auto published = type.page.publishes();
      CHECK((type.page.depends_on_parameters || published != nullptr));
      if (published != nullptr) CHECK(published->leaves().size() >= 1);
      std::vector<std::string> buses = type.page.other_buses;
      buses.push_back(type.page.bus);
      for (const std::string& bus : buses) {
        CAPTURE(bus);
        const auto& requests = buses_of_requests;
        if (std::find(std::begin(requests), std::end(requests), bus) != std::end(requests)) continue;
        CHECK_MESSAGE(bus_of(bus) != nullptr, "fake_buses lacks a bus of type " << bus);
        CHECK_MESSAGE(is_tried(type.name, bus), "it states no sample (chip.hpp) for this bus");
      }
      for (const ChipSample& sample : type.page.samples) {
        CHECK(sample.values[0].field.empty() == sample.bytes[0].bytes.empty());
        CHECK((!sample.bytes[0].bytes.empty() || type.page.bus == "modbus"));
      }
      // Its chips are the choices of `model`, or it has none.
      std::vector<std::string> models, choices;
      for (const KnownChip& chip : type.page.chips) {
        CHECK_FALSE(chip.name.empty());
        if (!chip.model.empty()) models.emplace_back(chip.model);
      }
      for (const ParameterInfo& parameter : type.parameters)
        if (parameter.key == "model") choices = parameter.type.choices;
      if (!models.empty()) CHECK(models == choices);
    }
    const Registry own = [] {
      Registry registry;
      registry.add_driver<Echo<I2cDevice>>("echo", "a user's");
      return registry;
    }();
    CHECK(own.sensors().find("echo")->page.notes == "- The address that one likes.");
    CHECK(own.sensors().find("echo")->page.publishes()->leaves()[0].path == "number");
  }

  TEST_CASE("US-12 a driver of one's own, one class and one line, is tried, found by scan, and has its page") {
    const std::vector<Tried> all = drivers();
    const auto tried = std::find_if(all.begin(), all.end(),
                                    [](const Tried& one) { return one.type.name == "own-chip"; });
    REQUIRE(tried != all.end());
    Rig rig(*tried);
    rig.wires->chip = Chip::good;
    rig.run();
    rig.expect_good();
    CHECK(rig.events >= 20);

    auto wires = std::make_shared<FakeI2c>();
    const I2cBus bus("i2c1", wires);
    I2cDevice chip = bus.device({0x31});
    wires->chip(0x31).set(0x07, {0x42});
    app::LikelyChip likely = app::likely_chip(chip, rig.registry);
    CHECK(likely.what == "OWN1");
    REQUIRE(likely.drivers.size() == 1);
    CHECK(likely.drivers[0].type == "own-chip");
    CHECK(likely.drivers[0].model.empty());
    wires->chip(0x31).set(0x07, {0x43});
    likely = app::likely_chip(chip, rig.registry);
    CHECK(likely.what == "a chip that is not known here");
    CHECK(likely.drivers.empty());

    const std::string page = app::markdown_of(tried->type);
    CHECK(page.find("| OWN1 |  | `0x30`, `0x31` | register `0x07` is `0x42` |\n") != std::string::npos);
    CHECK(page.find("in hexadecimal: `01`: `12`; `07`: `42`. That is `number` 18.\n") != std::string::npos);
  }

  TEST_CASE("US-27 driver contract: absent at the start, plugged in, unplugged, plugged in again") {
    for (const Tried& tried : drivers()) {
      CAPTURE(tried.text());
      Rig rig(tried);
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
    for (const Tried& tried : drivers()) {
      CAPTURE(tried.text());
      Rig rig(tried);
      const std::string text = rig.text(R"("rate": "5 Hz", "required": true)");
      if (rig.tells_absence()) {
        CHECK_THROWS_AS(rig.run(text), SetupError);
        CHECK_FALSE(rig.system);
      }
      rig.wires->chip = Chip::good;
      rig.run(text);
      rig.expect_good();
    }
  }

  TEST_CASE("US-27 driver contract: a transfer that fails gives no value, whatever the bytes and the error") {
    for (const Tried& tried : drivers()) {
      CAPTURE(tried.text());
      for (const int error : std::span(errnos).first(rtdata::test::sanitized ? 3 : std::size(errnos))) {
        CAPTURE(error);
        Rig rig(tried);
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
    for (const Tried& tried : drivers()) {
      CAPTURE(tried.text());
      for (std::uint64_t seed = 1; seed <= 10; seed += rtdata::test::sanitized ? 4 : 1) {
        CAPTURE(seed);
        Rig rig(tried, seed);
        rig.wires->chip = Chip::failing;
        rig.wires->failing_percent = static_cast<unsigned>(2 * seed);
        rig.run();
        rig.pass(30s);
        // A chip that takes many transfers to open has to be tried often.
        for (int i = 0; i < 20 && rig.events == 0; ++i) rig.pass(30s);
        CHECK(rig.events > 0);
        rig.expect_good();
      }
    }
  }

  TEST_CASE("US-27 driver contract: zeros, ones and random bytes are unreadable, or values; never a crash") {
    for (const Tried& tried : drivers()) {
      CAPTURE(tried.text());
      for (const Chip chip : {Chip::zeros, Chip::ones, Chip::random}) {
        for (const bool from_the_start : {true, false}) {
          for (std::uint64_t seed = 0; seed < (chip != Chip::random      ? 1u
                                               : rtdata::test::sanitized ? 4u
                                                                         : 20u);
               ++seed) {
            CAPTURE(static_cast<int>(chip));
            CAPTURE(from_the_start);
            CAPTURE(seed);
            Rig rig(tried, seed);
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
    for (const Tried& tried : drivers()) {
      CAPTURE(tried.text());
      Rig rig(tried);
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
    for (const Tried& tried : drivers()) {
      CAPTURE(tried.text());
      for (std::uint64_t seed = 0; seed < 10; ++seed) {
        CAPTURE(seed);
        Rig rig(tried, seed);
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
    for (const Tried& tried : drivers()) {
      CAPTURE(tried.text());
      Rig rig(tried);
      rig.wires->chip = Chip::good;
      const std::string two = R"({"buses": {"b": )" + tried.bus->item + R"(}, "sensors": [)" + rig.item("s") + ", " +
                              rig.item("again") + "]}";
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
    for (const Tried& tried : drivers()) {
      CAPTURE(tried.text());
      for (std::uint64_t seed = first; seed < first + count; ++seed) {
        CAPTURE(seed);
        Rig rig(tried, seed);
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
