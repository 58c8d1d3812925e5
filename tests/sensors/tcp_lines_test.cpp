// Lines over TCP, from a server as a test scripts it.
#include "rtdata/sensors/tcp_lines.hpp"

#include <doctest/doctest.h>

#include <atomic>
#include <string>
#include <thread>
#include <vector>

#include "has.hpp"
#include "rtdata/data/event.hpp"
#include "rtdata/io/serial.hpp"
#include "rtdata/sensors/query.hpp"
#include "sensors/fake_gpsd.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using rtdata::test::has;
using namespace std::chrono_literals;

TEST_SUITE("sensors") {
  TEST_CASE("US-17 US-7 a device behind a TCP port: its lines, its end, its return, and what it is told at first") {
    FakeGpsd server;
    Loop loop;
    be_quiet(loop);
    std::vector<std::string> events, errors;
    const auto heard = loop.subscribe("t", [&](const EventView& event) {
      events.push_back(to_string(event.value(event.description().leaves()[0])));
    });
    TcpLines sensor(
        loop, {.name = "t"},
        {.host = "127.0.0.1",
         .port = server.port(),
         .at_open = {"go\n"},
         .lines = {
             .fields = {{.name = "v"}}, .first_line = FirstLine::keep, .retry_first = 10ms, .retry_longest = 10ms}});
    sensor.on_error([&](const ErrorReport& report) { errors.push_back(report.error.why); });
    const auto until = [&](auto done) {
      for (int i = 0; i < 20000; ++i) {
        if (done()) return true;
        loop.run_for(1ms);
      }
      return false;
    };
    REQUIRE(until([&] { return server.accept(); }));
    server.send("1\n2");
    REQUIRE(until([&] { return events.size() == 1; }));
    server.send("5\n");
    REQUIRE(until([&] { return events.size() == 2; }));
    CHECK(events == std::vector<std::string>{"1", "25"});
    CHECK(has(server.received(), "go\n"));
    server.hang_up();
    REQUIRE(until([&] { return !errors.empty(); }));
    CHECK(errors.front() == "the device has ended it");
    CHECK(sensor.health() == Health::faulted);
    REQUIRE(until([&] { return server.accept(); }));
    server.send("3\n");
    REQUIRE(until([&] { return events.size() == 3; }));
    CHECK(sensor.health() == Health::ok);
    server.vanish();  // nobody listens
    const std::size_t before = errors.size();
    REQUIRE(until([&] { return errors.size() >= before + 2; }));
    CHECK(has(errors.back(), "refused"));
    sensor.close();
    CHECK(loop.runtime().balances());
    CHECK_THROWS_AS(TcpLines(loop, {.name = "u"}, {.host = "127.0.0.1", .lines = {.fields = {{.name = "v"}}}}),
                    SetupError);
    CHECK_THROWS_AS(TcpLines(loop, {.name = "w"}, {.host = "a b", .port = 1, .lines = {.fields = {{.name = "v"}}}}),
                    SetupError);
  }

  TEST_CASE("US-42 an instrument behind a TCP port answers as one on a serial line does, and again when it is back") {
    FakeGpsd server;
    std::atomic<bool> is_over = false, hangs_up = false;
    std::thread instrument([&] {
      while (!is_over) {
        server.accept();
        if (hangs_up.exchange(false)) server.hang_up();
        if (has(server.received(), "MEAS?\n")) server.send("1.25\n");
        std::this_thread::sleep_for(1ms);
      }
    });
    {
      Loop loop;
      be_quiet(loop);
      int values = 0, errors = 0;
      const auto heard = loop.subscribe("scope", [&](const EventView& event) {
        CHECK(std::get<double>(event.value("v").or_throw()) == 1.25);
        ++values;
      });
      SerialPort port({.host = "127.0.0.1", .port = server.port()});
      DriverSensor<Query> scope(loop,
                                {.name = "scope", .rate = Rate::hertz(50), .faulted_after = 1, .retry_first = 10ms},
                                port, {}, {.request = "MEAS?\n", .fields = {{.name = "v"}}});
      scope.on_error([&](const ErrorReport&) { ++errors; });
      for (int i = 0; i < 20000 && values < 3; ++i) loop.run_for(1ms);
      CHECK(values >= 3);
      hangs_up = true;
      for (int i = 0; i < 20000 && errors == 0; ++i) loop.run_for(1ms);
      CHECK(errors > 0);
      const int before = values;
      for (int i = 0; i < 20000 && values < before + 3; ++i) loop.run_for(1ms);
      CHECK(values >= before + 3);
    }
    is_over = true;
    instrument.join();
    CHECK_THROWS_AS(SerialPort({.host = "127.0.0.1"}), SetupError);
    CHECK_THROWS_AS(SerialPort(SerialPortConfig{}), SetupError);
  }
}
