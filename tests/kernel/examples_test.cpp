// The configurations of examples/, as they stand, on the kernel's drivers.
#include <array>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "app/process.hpp"
#include "kernel/bench.hpp"
#include "kernel/gpio_bench.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/io/i2c.hpp"

using namespace bench;
using rtdata::test::Process;

namespace {

struct Topic {
  std::string name;
  unsigned address;  // 0: it is on no I2C bus
  std::int64_t least_rows;
};

/// Runs it for a while; what the bench has a chip for has rows, and everything is in the account.
void run_example(const std::string& name, const std::string& recording, const std::vector<Topic>& topics) {
  const rtdata::test::Folder folder;
  const std::string program = rtdata::test::built("rtdata"), path = folder.path() + "/" + recording;
  Process run(folder, program, {"run", rtdata::test::in_source("examples/" + name), "--for", "5s"});
  CHECK(run.end() == 0);
  Process verify(folder, program, {"verify", recording});
  CHECK(verify.end() == 0);
  I2cBus bus({.device = "/dev/i2c-1"});
  for (const Topic& topic : topics) {
    CAPTURE(topic.name);
    CAPTURE(run.err);
    std::array<std::uint8_t, 1> byte{};
    if (topic.address != 0 && !bus.device({topic.address}).read(byte)) {
      MESSAGE("the bench has no chip for " << topic.name);
      CHECK(run.err.find("nothing acknowledges this address") != std::string::npos);
      continue;
    }
    CHECK(recordings::number(path, "SELECT count(*) FROM \"" + topic.name + "\"") >= topic.least_rows);
  }
}

}  // namespace

TEST_SUITE("drivers") {
  TEST_CASE("US-12 NFR-3 examples/weather.json runs as it stands, and its recording verifies") {
    run_example("weather.json", "weather.db",
                {{"weather/air", 0x76, 4}, {"weather/humidity", 0x44, 4}, {"weather/ground", 0, 1}});
  }

  TEST_CASE("US-35 NFR-3 examples/greenhouse runs on a line of the bench, and its recording verifies") {
    if (!standard_registry().outputs().find("gpio")) {
      MESSAGE("skipped: there is no libgpiod");
      return;
    }
    gpio_bench::Chip chip;
    const rtdata::test::Folder folder;
    std::ifstream file(rtdata::test::in_source("examples/greenhouse/greenhouse.json"));
    std::string text{std::istreambuf_iterator<char>(file), {}};
    const auto line = text.find("\"line\": \"GPIO17\"");
    REQUIRE(line != std::string::npos);
    text.replace(line + 8, 8, "\"sim5\"");
    const auto model = text.find("bme280");
    REQUIRE(model != std::string::npos);
    text.replace(model, 6, "bmp280");  // the chip of the bench
    folder.write("greenhouse.json", text);
    const std::string program = rtdata::test::built("rtdata"), path = folder.path() + "/greenhouse.db";
    Process run(folder, program, {"run", "greenhouse.json", "--for", "5s"});
    CHECK(run.end() == 0);
    CAPTURE(run.err);
    Process verify(folder, program, {"verify", "greenhouse.db"});
    CHECK(verify.end() == 0);
    CHECK(recordings::number(path, "SELECT count(*) FROM air") >= 4);
    CHECK(recordings::number(path, "SELECT count(*) FROM fan") >= 1);
    CHECK(recordings::number(path, "SELECT count(*) FROM frost WHERE is_active = 0") == 1);
  }

  TEST_CASE("US-15 NFR-3 examples/rocket_sensors.json runs as it stands, and its recording verifies") {
    run_example("rocket_sensors.json", "rocket.db",
                {{"imu", 0x68, 700}, {"barometer", 0x76, 50}, {"battery", 0x40, 15}});
  }
}
