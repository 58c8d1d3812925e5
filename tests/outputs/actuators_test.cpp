// The shipped devices of outputs: a GPIO chip of memory, a PWM chip of files, a pseudo terminal.
#include <doctest/doctest.h>
#include <poll.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <memory>
#include <string>
#include <thread>

#include "has.hpp"
#include "outputs/terminal.hpp"
#include "rtdata/outputs/command.hpp"
#include "rtdata/outputs/gpio.hpp"
#include "rtdata/outputs/pwm.hpp"
#include "rtdata/outputs/serial.hpp"
#include "rtdata/testing/fake_gpio.hpp"
#include "sensors/fake_gpsd.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace std::chrono_literals;
using outputs_test::Terminal;

namespace {

std::string text_of(const std::string& path) {
  std::string text;
  std::getline(std::ifstream(path), text);
  return text;
}

/// The files of a PWM chip with a channel that is exported.
struct PwmFiles {
  ScratchDirectory directory;
  PwmConfig config;
  std::string channel;
  PwmFiles(const std::string& period, const std::string& duty, const std::string& enable) {
    config = {.chip = 2, .channel = 1, .frequency = Rate::hertz(50), .root = directory.path()};
    directory.file("pwmchip2/npwm", "2\n");
    directory.file("pwmchip2/pwm1/period", period);
    directory.file("pwmchip2/pwm1/duty_cycle", duty);
    directory.file("pwmchip2/pwm1/polarity", "normal\n");
    directory.file("pwmchip2/pwm1/enable", enable);
    channel = directory.path() + "/pwmchip2/pwm1/";
  }
  std::string all() const {
    return text_of(channel + "period") + " " + text_of(channel + "duty_cycle") + " " + text_of(channel + "polarity") +
           " " + text_of(channel + "enable");
  }
};

}  // namespace

TEST_SUITE("outputs") {
  TEST_CASE("US-35 US-36 a GPIO line is taken with its value, or as it is, and has two levels") {
    auto pins = std::make_shared<FakeGpio>();
    pins->add_chip("gpiochip0", 8);
    const auto is_high = [&] { return pins->level("gpiochip0", 3); };
    {
      GpioActuator line({.line = 3}, pins);
      CHECK(line.open(1).has_value());
      CHECK(is_high());
      CHECK(line.set(0).has_value());
      CHECK_FALSE(is_high());
      CHECK(line.set(0.5).error().code == Errc::out_of_range);
      CHECK(line.set(1).has_value());
      CHECK(pins->is_taken("gpiochip0", 3));
      CHECK(GpioActuator({.line = 3}, pins).open(0).error().code == Errc::busy);
    }
    CHECK_FALSE(pins->is_taken("gpiochip0", 3));
    CHECK(is_high());  // as it was left
    {
      GpioActuator line({.line = 4}, pins);
      CHECK(line.check().error().code == Errc::disconnected);
      CHECK(line.open(1).has_value());
      CHECK(line.check().has_value());
      CHECK(pins->level("gpiochip0", 4));  // asking leaves it alone
      pins->unplug("gpiochip0");
      CHECK(line.check().error().code == Errc::disconnected);
      pins->plug_in("gpiochip0");
      CHECK(line.check().error().code == Errc::disconnected);  // another chip
      CHECK(line.open(0).has_value());
      CHECK(line.check().has_value());
      pins->drive("gpiochip0", 3, true, MonotonicTime{});
    }
    {
      GpioActuator line({.line = 3}, pins);
      CHECK(line.open({}).has_value());
      CHECK(is_high());
    }
    GpioActuator low({.line = 3, .active_low = true}, pins);
    CHECK(low.open(1).has_value());
    CHECK_FALSE(is_high());
    CHECK(GpioActuator({.line = 9}, pins).open(0).error().code == Errc::not_found);
    CHECK(GpioActuator({.line = 4}, pins).open(2).error().code == Errc::out_of_range);
    pins->unplug("gpiochip0");
    CHECK_FALSE(low.set(0).has_value());
  }

  TEST_CASE("US-35 a PWM channel has its period and duty cycle before it is enabled, or stays as it is") {
    PwmFiles off("0", "0", "0");
    PwmActuator pwm(off.config);
    CHECK(pwm.open(0.25).has_value());
    CHECK(off.all() == "20000000 5000000 normal 1");
    CHECK(pwm.set(1).has_value());
    CHECK(off.all() == "20000000 20000000 normal 1");
    CHECK(pwm.set(1.5).error().code == Errc::out_of_range);

    PwmFiles on("1000", "700", "1");
    PwmActuator kept(on.config);
    CHECK(kept.open({}).has_value());
    CHECK(on.all() == "1000 700 normal 1");
    CHECK(kept.set(0.5).has_value());  // of the period that it has
    CHECK(on.all() == "1000 500 normal 1");

    PwmFiles other("1000", "700", "0");
    other.config.inverted = true;
    PwmActuator inverted(other.config);
    CHECK(inverted.open({}).has_value());
    CHECK(other.all() == "20000000 0 inversed 1");

    PwmConfig absent = off.config;
    absent.channel = 2;
    CHECK(PwmActuator(absent).open(0).error().code == Errc::not_found);
    absent.chip = 7;
    CHECK(PwmActuator(absent).open(0).error().code == Errc::not_found);
  }

  TEST_CASE("US-35 a serial device is sent bytes, and answers with bytes") {
    Terminal line;
    {
      SerialActuator relay({.device = line.name, .words_hex = {{"0", "a0 01 00 a1"}, {"1", "A00101A2"}}});
      CHECK(relay.open(1).has_value());
      CHECK(line.read() == "\xa0\x01\x01\xa2");
      CHECK(relay.set(0).has_value());
      CHECK(line.read() == std::string("\xa0\x01\x00\xa1", 4));
      CHECK(rtdata::test::has(relay.set(0.5).error().text(), "`words_hex` has no bytes for 0.5"));
    }
    SerialActuator asked({.device = line.name, .words_hex = {{"1", "01"}}, .answer_hex = "06 00", .timeout = 1500ms});
    std::thread device([&] {
      while (line.read().empty()) {
      }
      CHECK(::write(line.master, "\x06\x00", 2) == 2);
    });
    const auto opened = asked.open(1);
    device.join();
    CHECK(opened.has_value());
  }

  TEST_CASE("US-35 a device behind a TCP port is sent its value, answers, and may end the connection") {
    FakeGpsd device;
    SerialActuator valve(
        {.host = "127.0.0.1", .port = device.port(), .text = "V{value}\n", .answer = "OK", .timeout = 1500ms});
    REQUIRE(valve.open({}).has_value());
    REQUIRE(device.accept());
    std::thread server([&] {
      while (!rtdata::test::has(device.received(), "V0.5\n")) std::this_thread::sleep_for(1ms);
      device.send("OK\n");
    });
    const auto set = valve.set(0.5);
    server.join();
    CHECK(set.has_value());
    CHECK(valve.check().has_value());
    device.hang_up();
    for (int i = 0; i < 2000 && valve.check().has_value(); ++i) std::this_thread::sleep_for(1ms);
    CHECK(valve.check().error().why == "the device has closed the connection");
    CHECK(valve.set(1).error().code == Errc::disconnected);
  }

  TEST_CASE("US-35 what a device behind a TCP port says at first is no answer") {
    FakeGpsd device;
    std::thread server([&] {
      while (!device.accept()) std::this_thread::sleep_for(1ms);
      device.send("OK> ");
    });
    SerialActuator valve(
        {.host = "127.0.0.1", .port = device.port(), .text = "V{value}\n", .answer = "OK", .timeout = 500ms});
    const auto opened = valve.open(1);
    server.join();
    CHECK(opened.error().code == Errc::timed_out);
    CHECK(rtdata::test::has(device.received(), "V1\n"));
  }

  TEST_CASE("US-35 a program of the user's sets the value: its status, its reason, its time") {
    CommandActuator well({.run = {"test", "{value}", "-gt", "0"}});
    CHECK(well.open({}).has_value());
    CHECK(well.set(1).has_value());
    CHECK(well.set(0).error().why == "it has ended with status 1");
    CommandActuator says(
        {.run = {"sh", "-c", "echo is out >&2; echo it is $0 >&2; exit 3", "{value}"}, .words = {{"1", "on"}}});
    CHECK(says.open(1).error().why == "it has ended with status 3; it said: it is on");
    CommandActuator slow({.run = {"sh", "-c", "exec sleep 100", "{value}"}, .timeout = 50ms});
    CHECK(slow.open(1).error().code == Errc::timed_out);
    CommandActuator loud({.run = {"sh", "-c", "yes $0 | head -n 200000", "{value}"}, .timeout = 1500ms});
    CHECK(loud.open(1).has_value());  // nobody waits for what it prints
    CommandActuator mute({.run = {"sh", "-c", "exec >&- 2>&-; exec sleep 0.1", "{value}"}, .timeout = 1500ms});
    CHECK(mute.open(1).has_value());
    CommandActuator none({.run = {"no-such-program", "{value}"}});
    CHECK(none.open(1).error().code == Errc::not_found);
  }

  TEST_CASE("US-35 a serial device is sent its value, and one that answers is waited for") {
    Terminal line;
    {
      SerialActuator valve({.device = line.name, .text = "VALVE {value}\n"});
      CHECK(valve.open(0).has_value());
      CHECK(line.read() == "VALVE 0\n");
      CHECK(valve.set(0.5).has_value());
      CHECK(line.read() == "VALVE 0.5\n");
    }
    SerialActuator asked({.device = line.name, .text = "S{value}\r", .answer = "OK", .timeout = 1500ms});
    std::thread device([&] {
      std::string got;
      while (got.find("S3\r") == std::string::npos) got += line.read();
      const std::string answer = "noise OK\r\n";
      CHECK(::write(line.master, answer.data(), answer.size()) == static_cast<ssize_t>(answer.size()));
    });
    const auto opened = asked.open(3);
    device.join();
    CHECK(opened.has_value());
    // One that takes no more in the middle of a text, and later goes on: it gets that text whole before the next.
    {
      Terminal slow;
      const std::string long_text = "VALUE " + std::string(300, 'p') + "{value};\n";
      // A busy kernel moves bytes late.
      SerialActuatorConfig settings{.device = slow.name, .text = long_text, .timeout = 1s};
      int taken = 0;
      {
        SerialActuator valve(settings);
        REQUIRE(valve.open({}).has_value());
        while (taken < 1000 && valve.set(taken).has_value()) ++taken;
        const auto refused = valve.set(1000);  // nothing of it is sent, or ever will be
        REQUIRE_FALSE(refused.has_value());
        CHECK(refused.error().code == Errc::timed_out);
      }
      REQUIRE(taken > 2);
      REQUIRE(taken < 1000);
      std::string got;
      const auto read_all = [&] {
        for (pollfd ready{slow.master, POLLIN, 0}; ::poll(&ready, 1, 200) > 0;) got += slow.read();
      };
      read_all();
      SerialActuator valve(settings);  // after a failure another one takes the device
      REQUIRE(valve.open(-5).has_value());
      read_all();
      std::string expected;
      for (int i = 0; i <= taken; ++i) expected += "VALUE " + std::string(300, 'p') + std::to_string(i) + ";\n";
      expected += "VALUE " + std::string(300, 'p') + "-5;\n";
      CHECK(got == expected);
    }
    {  // What has come before a text is no answer to it.
      const Terminal late;
      SerialActuator valve({.device = late.name, .answer = "OK", .timeout = 5ms});
      REQUIRE(valve.open({}).has_value());
      int believed = 0;
      for (int i = 0; i < 100; ++i) {
        late.write("OK\r\n");
        believed += valve.set(i).has_value() ? 1 : 0;
      }
      CHECK(believed == 0);
    }
    SerialActuator deaf({.device = line.name, .answer = "OK", .timeout = 50ms});
    CHECK(deaf.open({}).error().code == Errc::busy);  // it is opened for one alone
    CHECK(SerialActuator({.device = "/dev/no-such"}).open(0).error().code == Errc::not_found);
  }
}
