// Drivers of user space on the kernel's SPI controllers.
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <string>

#include "kernel/bench.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/chips/mcp3x08.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/io/spi.hpp"

using namespace bench;

namespace {

/// "/dev/spidev0" of "/dev/spidev0.3".
std::string controller() { return device("SPIDEV").substr(0, device("SPIDEV").rfind('.')); }
unsigned chip_select_of(const char* name) {
  return static_cast<unsigned>(std::stoul(device(name).substr(device(name).rfind('.') + 1)));
}

}  // namespace

TEST_SUITE("drivers") {
  TEST_CASE("US-11 US-38 NFR-3 spi: full duplex, several pieces in one message, modes, and a chip that is not there") {
    SpiBus bus({.device = controller()});
    SpiDevice loopback = bus.device({.chip_select = chip_select_of("SPIDEV")});
    const std::array<std::uint8_t, 4> out{1, 2, 3, 254};
    std::array<std::uint8_t, 4> in{};
    loopback.transfer(out, in).or_throw();
    CHECK(in == out);
    SpiDevice registers = bus.device({.chip_select = chip_select_of("SPIDEV_REGS"), .mode = 3});
    const std::array<std::uint8_t, 4> write{0x10, 7, 8, 9}, ask{0x90, 0, 0, 0};
    registers.write(write).or_throw();
    registers.write_read(std::span(ask).first(1), std::span(in).first(3)).or_throw();
    CHECK(in[0] == 7);
    CHECK(in[1] == 8);
    CHECK(in[2] == 9);
    CHECK(number_in(device("SIM") + "/spi/last_mode") == 3);
    SpiDevice nobody = bus.device({.chip_select = chip_select_of("SPIDEV_NONE")});
    nobody.read(in).or_throw();
    CHECK(in == std::array<std::uint8_t, 4>{255, 255, 255, 255});
    CHECK(bus.device({.chip_select = 99}).write(out).error().code == Errc::not_found);
  }

  TEST_CASE("US-11 US-38 NFR-3 mcp3x08: a configuration records what the converter has, through faults, and verifies") {
    recordings::Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop;
      const Chip chip("spi");
      for (unsigned channel = 0; channel < 8; ++channel)
        chip.set_input(channel, static_cast<std::uint16_t>(channel * 500));
      const std::string text = R"({"buses": {"spi0": {"type": "spi", "device": ")" + controller() +
                               R"("}}, "sensors": [{"name": "adc", "type": "mcp3x08", "rate": "50 Hz", "bus": "spi0",
          "reference_voltage": 4.096, "chip_select": )" +
                               std::to_string(chip_select_of("SPIDEV_ADC")) + R"(, "faulted_after": 10},
          {"name": "none", "type": "mcp3x08", "rate": "10 Hz", "bus": "spi0", "chip_select": )" +
                               std::to_string(chip_select_of("SPIDEV_NONE")) + R"(}],
          "sinks": [{"type": "sqlite", "path": ")" +
                               path + "\"}]}";
      System system(loop, standard_registry(), parse_config(text, "adc.json"));
      loop.on_error([](const ErrorReport&) {});
      int events = 0;
      const auto heard = loop.subscribe("adc", [&](const EventView& event) {
        std::array<double, 8> voltages{};
        CHECK(event.payload().size() == sizeof voltages);
        std::memcpy(&voltages, event.payload().data(), std::min(event.payload().size(), sizeof voltages));
        for (std::size_t channel = 0; channel < 8; ++channel)
          CHECK(voltages[channel] == doctest::Approx(static_cast<double>(channel) * 0.5));
        if (++events == 10) chip.fail(2, EIO);
        if (events >= 30) loop.stop();
      });
      const Timer patience = limit(loop);
      loop.run();
      CHECK(events >= 30);
      for (const SensorStatus& sensor : loop.runtime().sensors()) {
        CAPTURE(sensor.name);
        CHECK(sensor.counts.published == (sensor.name == "adc" ? sensor.counts.received : 0));
        if (sensor.name == "none") CHECK(sensor.health == Health::faulted);
      }
      close_balanced(loop);
    }
    check_verifies(path);
  }
}
