// Analog sensors on the kernel's own drivers for converters: mcp320x (SPI) and ti-ads1015 (I2C).
#include <doctest/doctest.h>

#include <cerrno>
#include <functional>

#include "kernel/bench.hpp"
#include "rtdata/sensors/analog.hpp"

using namespace bench;

namespace {

struct Converter {
  AnalogConfig config;
  Chip chip;
  std::function<void(std::int64_t code)> set;
};

Converter mcp3208() {
  const Chip chip("spi");
  return {{.file = device("MCP3208") + "/in_voltage3_raw", .scale = 100, .span_voltage = 5, .unit = "bar"},
          chip,
          [chip](std::int64_t code) { chip.set_input(3, static_cast<std::uint16_t>(code)); }};
}

Converter ads1015() {
  const Chip chip("i2c-49");
  return {{.file = device("ADS1015") + "/in_voltage0_raw",
           .scale = 4.096,
           .zero_voltage = 0,
           .span_voltage = 4.096,
           .unit = "V",
           .signed_adc = true},
          chip,
          [chip](std::int64_t code) { chip.set_word(0, static_cast<int>(code) * 16); }};  // twelve bits, on the left
}

/// Sets the chip to one code after the other, each when the one before has been read.
void check_follows(const Converter& converter, const std::vector<std::int64_t>& codes) {
  recordings::Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop;
    SqliteSink sink(loop, {.path = path});
    std::size_t at = 0;
    std::uint64_t strays = 0, wrong = 0;
    converter.set(codes[0]);
    const auto heard = loop.subscribe("pressure/chamber", [&](const EventView& event) {
      const AnalogReading reading = analog_reading(event).value();
      if (reading.value != convert(converter.config, reading.raw)) ++wrong;
      if (reading.raw == codes[at]) {
        if (++at < codes.size()) return converter.set(codes[at]);
        return loop.stop();
      }
      if (at == 0 || reading.raw != codes[at - 1]) ++strays;  // one read before the change may still come
    });
    AnalogSensor sensor(loop, {.name = "chamber", .topic = "pressure/chamber", .rate = 100_Hz}, converter.config);
    const Timer patience = limit(loop);
    loop.run();
    CHECK(at == codes.size());
    CHECK(strays == 0);
    CHECK(wrong == 0);
    CHECK(sensor.counts().failed == 0);
    close_balanced(loop);
  }
  check_verifies(path);
}

/// Transfers fail `count` times in a row, then no more.
void check_recovers(const Converter& converter, std::uint32_t count, int number, std::string_view id) {
  CAPTURE(id);
  recordings::Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop;
    be_quiet(loop);
    SqliteSink sink(loop, {.path = path});
    std::uint64_t before = 0, after = 0;
    std::vector<std::string> errors;
    converter.set(1234);
    AnalogSensor sensor(loop, {.name = "chamber", .rate = 100_Hz, .faulted_after = count + 1}, converter.config);
    sensor.on_error([&](const ErrorReport& report) { errors.emplace_back(report.error.id()); });
    const auto heard = loop.subscribe("chamber", [&](const EventView& event) {
      CHECK(analog_reading(event)->raw == 1234);
      if (sensor.counts().failed == 0) {
        if (++before == 5) converter.chip.fail(count, number);
      } else if (++after == 5) {
        loop.stop();
      }
    });
    const Timer patience = limit(loop);
    loop.run();
    CHECK(after >= 5);  // those that waited when the loop was stopped come, too
    CHECK(sensor.health() == Health::ok);
    CHECK(sensor.counts().failed == count);
    CHECK(errors == std::vector<std::string>(count, std::string(id)));
    close_balanced(loop);
  }
  const Recording recording = Recording::open(path).or_throw();
  std::uint64_t failed = 0;
  const std::vector<RecordedGap> gaps = recording.gaps(1).or_throw();
  for (const RecordedGap& gap : gaps) {
    if (gap.kind != "failed") continue;
    failed += gap.count;
    CAPTURE(gap.reason);
    CHECK(gap.reason.find(id) != std::string::npos);
  }
  CHECK(failed == count);
  check_verifies(path);
}

/// The chip answers nothing for so long that the sensor is faulted, then answers again.
void check_comes_back(const Converter& converter, const std::function<void()>& go, const std::function<void()>& come,
                      std::string_view id) {
  recordings::Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop;
    be_quiet(loop);
    SqliteSink sink(loop, {.path = path});
    converter.set(77);
    bool has_gone = false, has_come = false;
    std::uint64_t readings = 0;
    std::vector<std::string> errors;
    AnalogSensor sensor(loop, {.name = "chamber", .rate = 100_Hz, .retry_first = 20ms, .retry_longest = 50ms},
                        converter.config);
    sensor.on_error([&](const ErrorReport& report) { errors.emplace_back(report.error.id()); });
    const auto heard = loop.subscribe("chamber", [&](const EventView&) {
      if (!has_gone && ++readings == 5) {
        has_gone = true;
        go();
      }
      if (has_come && ++readings == 10) loop.stop();
    });
    Ticker look(loop, 10ms, [&](const Tick&) {
      if (!has_gone || has_come || sensor.health() != Health::faulted) return;
      has_come = true;
      come();
    });
    const Timer patience = limit(loop);
    loop.run();
    CHECK(readings == 10);
    CHECK(sensor.health() == Health::ok);
    CHECK(sensor.counts().failed >= 3);
    REQUIRE(!errors.empty());
    CHECK(errors.front() == id);
    look.close();
    close_balanced(loop);
  }
  check_verifies(path);
}

}  // namespace

TEST_SUITE("drivers") {
  TEST_CASE("US-10 NFR-3 mcp320x: readings follow the chip over its whole range") {
    check_follows(mcp3208(), {0, 1, 2, 511, 1024, 2047, 2048, 4094, 4095, 0, 4095});
  }
  TEST_CASE("US-10 NFR-3 ti-ads1015: readings follow the chip, below zero too") {
    check_follows(ads1015(), {0, 1, 1300, 2047, -1, -2048, 2047, 0});
  }
  TEST_CASE(
      "US-10 NFR-3 mcp320x: transfers that fail are failed ticks and a gap with the reason, and sampling goes on") {
    check_recovers(mcp3208(), 5, EIO, "io-failed");
    check_recovers(mcp3208(), 1, ETIMEDOUT, "timed-out");
  }
  TEST_CASE(
      "US-10 NFR-3 ti-ads1015: transfers that fail are failed ticks and a gap with the reason, and sampling goes on") {
    check_recovers(ads1015(), 5, EREMOTEIO, "io-failed");
    check_recovers(ads1015(), 3, ENXIO, "disconnected");  // not acknowledged
    check_recovers(ads1015(), 1, ETIMEDOUT, "timed-out");
  }
  TEST_CASE("US-10 NFR-3 a converter that is silent for long is faulted, and read again when it answers") {
    for (const Converter& converter : {mcp3208(), ads1015()}) {
      CAPTURE(converter.config.file);
      check_comes_back(
          converter, [&] { converter.chip.fail(1'000'000, EIO); }, [&] { converter.chip.fail(0, EIO); }, "io-failed");
    }
  }
  TEST_CASE("US-10 NFR-3 a converter that is taken from its driver is disconnected, and read again when it is back") {
    const std::string bus = "/sys/bus/i2c/devices" + device("I2C").substr(4);
    check_comes_back(
        ads1015(), [&] { put(bus + "/delete_device", "0x49"); }, [&] { put(bus + "/new_device", "ads1015 0x49"); },
        "disconnected");
  }
}
