// Converters, thermometers and power monitors of user space on the kernel's buses, and what goes wrong with buses.
#include <doctest/doctest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <map>
#include <optional>
#include <string>

#include "kernel/bench.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/chips/ina.hpp"
#include "rtdata/chips/max31855.hpp"
#include "rtdata/chips/nau7802.hpp"
#include "rtdata/chips/sht.hpp"
#include "rtdata/config/system.hpp"

using namespace bench;

namespace {

struct Board {
  std::optional<double> battery;
  std::optional<double> ain2;
  std::optional<double> ain2_ain3;
  friend constexpr auto describe(type_tag<Board>) {
    return record("adc", field("battery", &Board::battery, "V"), field("ain2", &Board::ain2, "V"),
                  field("ain2_ain3", &Board::ain2_ain3, "V"));
  }
};

std::string spi_controller() { return device("SPIDEV").substr(0, device("SPIDEV").rfind('.')); }
std::string buses(const std::string& more = "") {
  return R"({"buses": {"i2c1": {"type": "i2c", "device": ")" + device("I2C") + R"(", "timeout": "300 ms"},
    "spi0": {"type": "spi", "device": ")" +
         spi_controller() + "\"}" + more + R"(}, "sensors": [)";
}
const char* const
    thermocouple = R"({"name": "oven", "type": "max31855", "rate": "10 Hz", "bus": "spi0", "chip_select": 5})";

SensorStatus status_of(Loop& loop, const std::string& name) {
  for (const SensorStatus& sensor : loop.runtime().sensors())
    if (sensor.name == name) return sensor;
  FAIL("no sensor ", name);
  return {};
}

}  // namespace

TEST_SUITE("drivers") {
  TEST_CASE("US-12 NFR-3 ads1x15: chosen channels with ranges of their own are recorded, through faults, and verify") {
    recordings::Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop;
      be_quiet(loop);
      const Chip chip("i2c-4a");
      const std::string text = buses() + R"({"name": "adc", "type": "ads1x15", "rate": "10 Hz", "bus": "i2c1",
          "address": "0x4a", "data_rate": 475, "faulted_after": 10, "channels": [{"name": "battery", "input": "0"},
          {"input": "2", "range": 2.048}, {"input": "2-3", "range": 0.256}]}],
          "sinks": [{"type": "sqlite", "path": ")" +
                               path + "\"}]}";
      loop.on_error([](const ErrorReport&) {});
      System system(loop, standard_registry(), parse_config(text, "adc.json"));
      int events = 0, saturated = 0;
      const auto heard = loop.subscribe<Board>("adc", [&](const Event<Board>& event) {
        if (event->battery) {
          CHECK(*event->battery == doctest::Approx(0x1000 * 4.096 / 32768));
        } else {
          ++saturated;
        }
        CHECK(event->ain2 == doctest::Approx(0x3000 * 2.048 / 32768));
        CHECK(event->ain2_ain3 == doctest::Approx(-0x1000 * 0.256 / 32768));
        if (++events == 5) chip.fail(2, ENXIO);
        if (events == 10) chip.set_word(0x40 + 4, 0x7fff);
        if (events == 15) chip.set_word(0x40 + 4, 0x1000);
        if (events >= 20) loop.stop();
      });
      const Timer patience = limit(loop);
      loop.run();
      CHECK(events >= 20);
      CHECK(saturated >= 4);
      const SensorStatus adc = status_of(loop, "adc");
      CHECK(adc.counts.failed >= 1);
      CHECK(adc.counts.unreadable == static_cast<std::uint64_t>(saturated));
      CHECK(adc.health == Health::ok);
      close_balanced(loop);
    }
    check_verifies(path);
  }

  TEST_CASE("US-11 US-12 NFR-3 sht, ina, nau7802, max31855: recorded, spoiled, reset while they run, and verify") {
    recordings::Folder folder;
    const std::string path = folder / "run.db";
    const std::string sht = device("SIM") + "/i2c-44/regs", nau = device("SIM") + "/i2c-2a/regs";
    {
      Loop loop;
      be_quiet(loop);
      const std::string text = buses() + thermocouple +
                               R"(, {"name": "room", "type": "sht", "rate": "10 Hz", "bus": "i2c1"},
          {"name": "power", "type": "ina", "rate": "10 Hz", "bus": "i2c1", "model": "ina226", "shunt_resistance": 0.01},
          {"name": "scale", "type": "nau7802", "rate": "10 Hz", "bus": "i2c1", "tare_samples": 3}],
          "sinks": [{"type": "sqlite", "path": ")" +
                               path + "\"}]}";
      loop.on_error([](const ErrorReport&) {});
      System system(loop, standard_registry(), parse_config(text, "chips.json"));
      const auto oven = loop.subscribe<ThermocoupleReading>("oven", [&](const Event<ThermocoupleReading>& event) {
        CHECK(event->temperature == 100.75);
        CHECK(event->cold_junction == 25);
      });
      const auto room = loop.subscribe<HumidityReading>("room", [&](const Event<HumidityReading>& event) {
        CHECK(event->temperature == doctest::Approx(25));
        CHECK(event->humidity == doctest::Approx(50).epsilon(0.001));
      });
      const auto power = loop.subscribe<PowerReading>("power", [&](const Event<PowerReading>& event) {
        CHECK(event->voltage == doctest::Approx(12));
        CHECK(event->current == doctest::Approx(8));
        CHECK(event->power == doctest::Approx(96));
      });
      int weighed = 0;
      const auto scale = loop.subscribe<BridgeReading>("scale", [&](const Event<BridgeReading>& event) {
        CHECK(event->raw == 0x010000);
        CHECK(event->value.has_value() == (++weighed > 3));
        if (event->value) CHECK(*event->value == 0);
        if (weighed == 5) {  // a brown-out, wires, an open thermocouple
          put(nau, std::string_view("\0\0\0", 3));
          put(device("SIM") + "/i2c-40/regs", std::string_view("\0\0", 2));
          put(sht, "\x55", 4);
          put(device("SIM") + "/spi/thermocouple", "0x01931901");
          put(device("SIM") + "/spi/thermocouple", "0x064d1901");
        }
        if (weighed == 10) {
          put(sht, std::string_view("\0", 1), 4);
          put(device("SIM") + "/spi/thermocouple", "0x064c1900");
        }
        if (weighed >= 15) loop.stop();
      });
      const Timer patience = limit(loop);
      loop.run();
      CHECK(weighed >= 15);
      for (const SensorStatus& sensor : loop.runtime().sensors()) {
        CAPTURE(sensor.name);
        CHECK(sensor.counts.unreadable >= 1);
        CHECK(sensor.counts.published >= 5);
        if (sensor.name == "power" || sensor.name == "scale") CHECK(sensor.counts.unreadable == 1);
      }
      close_balanced(loop);
    }
    put(sht, std::string_view("\0", 1), 4);
    check_verifies(path);
  }

  TEST_CASE("NFR-1 NFR-3 a chip that holds its bus is given up; the bus's others are told, other buses never notice") {
    Loop loop;
    be_quiet(loop);
    const std::string hang = device("SIM") + "/i2c-44/hang_ms";
    const std::string
        text = buses(R"(, "other": {"type": "i2c", "device": ")" + device("I2C_STUB") + "\"}") + thermocouple +
               R"(, {"name": "room", "type": "sht", "rate": "10 Hz", "bus": "i2c1", "retry_longest": "200 ms"},
          {"name": "power", "type": "ina", "rate": "10 Hz", "bus": "i2c1", "model": "ina226", "retry_longest": "200 ms"},
          {"name": "stub", "type": "lm75", "rate": "10 Hz", "bus": "other", "address": "0x76"},
          {"name": "load", "type": "host", "rate": "10 Hz", "quantity": "load"}]})";
    std::map<std::string, int> told;
    loop.on_error(
        [&](const ErrorReport& report) { ++told[std::string(report.object) + " " + std::string(report.error.id())]; });
    System system(loop, standard_registry(), parse_config(text, "chips.json"));
    std::uint64_t before = 0;
    const Timer begin(loop, 1s, [&] { put(hang, "1500"); });
    const Timer end(loop, 4s, [&] {
      put(hang, "0");
      before = status_of(loop, "power").counts.published;
    });
    const Timer stop(loop, 9s, [&] { loop.stop(); });
    const Timer patience = limit(loop);
    loop.run();
    CHECK(told["sensor room timed-out"] > 0);
    CHECK(told["sensor power timed-out"] > 0);
    CHECK(status_of(loop, "room").health == Health::ok);
    CHECK(status_of(loop, "power").health == Health::ok);
    CHECK(status_of(loop, "power").counts.published > before);
    for (const char* name : {"oven", "stub", "load"}) {
      CAPTURE(name);
      const SensorStatus sensor = status_of(loop, name);
      CHECK(sensor.counts.missed == 0);
      CHECK(sensor.counts.failed == 0);
      CHECK(sensor.counts.published >= 85);
    }
    close_balanced(loop);
  }

  TEST_CASE("US-27 NFR-3 an adapter that may not be opened or is none, a chip that the kernel has: told, then over") {
    recordings::Folder folder;
    const std::string link = folder / "adapter", clients = "/sys/bus/i2c/devices/" + device("I2C").substr(5);
    REQUIRE(::symlink("/dev/null", link.c_str()) == 0);
    REQUIRE(std::system("modprobe bmp280-i2c") == 0);
    put(clients + "/new_device", "bmp280 0x76");
    Loop loop;
    be_quiet(loop);
    const std::string text = R"({"buses": {"i2c1": {"type": "i2c", "device": ")" + device("I2C") +
                             R"("}, "none": {"type": "i2c", "device": ")" + link + R"("}}, "sensors": [
          {"name": "air", "type": "barometer", "rate": "20 Hz", "bus": "i2c1", "retry_longest": "200 ms"},
          {"name": "power", "type": "ina", "rate": "20 Hz", "bus": "none", "model": "ina226", "retry_longest": "200 ms"}]})";
    std::map<std::string, int> told;
    loop.on_error(
        [&](const ErrorReport& report) { ++told[std::string(report.object) + " " + std::string(report.error.id())]; });
    System system(loop, standard_registry(), parse_config(text, "chips.json"));
    const Timer second(loop, 1s, [&] {
      CHECK(status_of(loop, "air").health == Health::faulted);
      CHECK(status_of(loop, "power").health == Health::faulted);
      CHECK(told["sensor air busy"] > 0);
      CHECK(status_of(loop, "power").reason.find("Inappropriate ioctl") != std::string::npos);
      put(clients + "/delete_device", "0x76");
      REQUIRE(::unlink(link.c_str()) == 0);
      REQUIRE(::symlink(device("I2C").c_str(), link.c_str()) == 0);
      REQUIRE(::chmod(device("I2C").c_str(), 0600) == 0);
      REQUIRE(::seteuid(65534) == 0);
    });
    const Timer third(loop, 2s, [&] {
      REQUIRE(::seteuid(0) == 0);
      CHECK(status_of(loop, "air").health == Health::ok);  // its bus was open
      CHECK(told["sensor power not-permitted"] + told["sensor power not-found"] > 0);
      CHECK(status_of(loop, "power").health == Health::faulted);
    });
    const Timer last(loop, 4s, [&] { loop.stop(); });
    const Timer patience = limit(loop);
    loop.run();
    CHECK(status_of(loop, "air").counts.published > 0);
    CHECK(status_of(loop, "power").counts.published > 0);
    CHECK(status_of(loop, "power").health == Health::ok);
    ::unlink(link.c_str());
    close_balanced(loop);
  }
}
