// A configuration with GPIO lines of the kernel's simulator, recorded.
#include <doctest/doctest.h>

#include <string>

#include "kernel/bench.hpp"
#include "kernel/gpio_bench.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"

using namespace bench;

TEST_SUITE("drivers") {
  TEST_CASE("US-36 US-17 NFR-3 gpio: a configuration records edges and pulses through an outage, and verifies") {
    if (!standard_registry().sensors().find("edge")) {
      MESSAGE("skipped: there is no libgpiod");
      return;
    }
    gpio_bench::Chip chip;
    recordings::Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop;
      be_quiet(loop);
      loop.on_error([](const ErrorReport&) {});
      const std::string text = R"({"sensors": [
          {"name": "door", "type": "edge", "line": "sim11", "retry_first": "20 ms", "retry_longest": "50 ms"},
          {"name": "fan", "type": "counter", "line": "sim12", "rate": "20 Hz", "per_pulse": 0.5, "unit": "{rev}",
           "per": "min", "retry_first": "20 ms", "retry_longest": "50 ms"}],
          "sinks": [{"type": "sqlite", "path": ")" +
                               path + "\"}]}";
      System system(loop, standard_registry(), parse_config(text, "gpio.json"));
      std::uint64_t edges = 0, pulses = 0;
      const auto of_door = loop.subscribe("door", [&](const EventView& event) {
        edges = static_cast<std::uint64_t>(std::stoull(to_string(event.value("count").value())));
      });
      const auto of_fan = loop.subscribe("fan", [&](const EventView& event) {
        pulses = static_cast<std::uint64_t>(std::stoull(to_string(event.value("count").value())));
      });
      const auto drive = [&](std::uint64_t wanted_edges, std::uint64_t wanted_pulses) {
        bool level = false;
        std::uint64_t door = edges, fan = pulses;
        Ticker driver(loop, 2ms, [&](const Tick&) {
          level = !level;
          if (door++ < wanted_edges) chip.pull(11, level);
          if (fan < wanted_pulses) chip.pull(12, level);
          if (level) ++fan;
          if (edges >= wanted_edges && pulses >= wanted_pulses) loop.stop();
        });
        const Timer patience = limit(loop);
        loop.run();
        CHECK(edges == wanted_edges);
        CHECK(pulses == wanted_pulses);
      };
      drive(100, 50);
      chip.unplug();
      const auto health_is = [&](Health health) {
        Ticker look(loop, 5ms, [&](const Tick&) {
          bool is_so = true;
          for (const SensorStatus& sensor : loop.runtime().sensors()) is_so = is_so && sensor.health == health;
          if (is_so) loop.stop();
        });
        const Timer patience = limit(loop);
        loop.run();
        for (const SensorStatus& sensor : loop.runtime().sensors()) CHECK(sensor.health == health);
      };
      health_is(Health::faulted);
      chip.plug_in();
      health_is(Health::ok);
      drive(200, 100);
      close_balanced(loop);
    }
    check_verifies(path);
  }
}
