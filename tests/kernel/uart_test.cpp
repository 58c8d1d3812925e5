// Serial lines over two ports of the kernel that are wired to each other.
#include <asm/ioctls.h>
#include <asm/termbits.h>
#include <doctest/doctest.h>
#include <sys/ioctl.h>

#include <array>

#include "io/tty.hpp"
#include "kernel/bench.hpp"
#include "rtdata/io/serial.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/sensors/query.hpp"
#include "rtdata/sensors/serial_line.hpp"

using namespace bench;

namespace {

/// Sends numbered lines from one port to the other, one of them broken.
void check_lines(const std::string& sender, const std::string& receiver, LineFormat format, std::uint32_t baud_rate) {
  CAPTURE(baud_rate);
  CAPTURE(receiver);
  constexpr std::uint64_t lines = 1000, broken = 500;
  std::string text;
  for (std::uint64_t i = 0; i < lines; ++i) {
    const std::string number = std::to_string(i),
                      value = i == broken ? "?" : std::to_string(0.25 * static_cast<double>(i));
    text += format == LineFormat::csv ? number + "," + value + "\r\n"
                                      : "{\"imu\":{\"ax\":" + value + "},\"count\":" + number + "}\n";
  }
  const int port = detail::open_tty(sender, {.baud_rate = baud_rate}).or_throw();
  {
    Loop loop;
    be_quiet(loop);
    std::vector<std::string> errors;
    std::uint64_t next = 0, wrong = 0;
    SerialLineSensor sensor(
        loop, {.name = "board"},
        {.device = receiver,
         .serial = {.baud_rate = baud_rate},
         .lines = {.format = format,
                   .fields = {{.name = "count", .type = Kind::u32}, {.name = "ax", .unit = "m/s2", .key = "imu.ax"}},
                   .first_line = FirstLine::keep,
                   .sequence_field = "count"},
         .required = true});
    sensor.on_error([&](const ErrorReport& report) { errors.emplace_back(report.error.id()); });
    const auto heard = loop.subscribe("board", [&](const EventView& event) {
      if (next == broken) ++next;
      const std::string is = to_string(event.value("count").value()) + " " + to_string(event.value("ax").value());
      if (is != std::to_string(next) + " " + to_string(Value(0.25 * static_cast<double>(next)))) ++wrong;
      ++next;
      if (next == lines) loop.stop();
    });
    struct termios2 tty {};
    CHECK(::ioctl(port, TCGETS2, &tty) == 0);
    CHECK(tty.c_ospeed == baud_rate);
    std::size_t sent = 0;
    Ticker feeder(loop, 1ms, [&](const Tick&) {
      while (sent < text.size()) {
        const ssize_t now = ::write(port, text.data() + sent, text.size() - sent);
        if (now <= 0) break;
        sent += static_cast<std::size_t>(now);
      }
    });
    const Timer patience = limit(loop);
    loop.run();
    feeder.close();
    CHECK(sent == text.size());
    CHECK(next == lines);
    CHECK(wrong == 0);
    const SensorCounts counts = sensor.counts();
    CHECK(counts.received == lines);
    CHECK(counts.published == lines - 1);
    CHECK(counts.unreadable == 1);
    CHECK(counts.repeated == 0);
    CHECK(errors == std::vector<std::string>{format == LineFormat::csv ? "not-a-number" : "bad-data"});
    close_balanced(loop);
  }
  detail::close_tty(port);
}

}  // namespace

TEST_SUITE("drivers") {
  TEST_CASE("US-13 US-42 NFR-3 serial ports: every byte goes both ways, at several speeds and with every parity") {
    std::array<std::uint8_t, 256> every{};
    for (std::size_t i = 0; i < every.size(); ++i) every[i] = static_cast<std::uint8_t>(i);
    for (const std::uint32_t baud_rate : {9600u, 250000u}) {
      for (const Parity parity : {Parity::none, Parity::even, Parity::odd, Parity::mark, Parity::space}) {
        const SerialSettings settings{.baud_rate = baud_rate, .parity = parity, .stop_bits = 2};
        SerialPort a({.device = device("TTY_A"), .serial = settings, .answer_timeout = 10s, .timeout = 20s});
        SerialPort b({.device = device("TTY_B"), .serial = settings, .answer_timeout = 10s, .timeout = 20s});
        SerialDevice here = a.device(), there = b.device();
        here.drop_input().or_throw();
        there.drop_input().or_throw();
        for (auto [from, to] : {std::pair(&here, &there), std::pair(&there, &here)}) {
          from->write(every).or_throw();
          std::array<std::uint8_t, 256> came{};
          to->read(came).or_throw();
          CHECK(came == every);
        }
      }
    }
  }
  TEST_CASE("US-42 NFR-3 serial ports: requests and answers between two of them, and silence") {
    Loop loop;
    be_quiet(loop);
    loop.on_error([](const ErrorReport&) {});
    const int instrument = detail::open_tty(device("TTY_B"), {.baud_rate = 115200}).or_throw();
    {
      bool is_silent = false;
      std::string asked;
      std::uint64_t answers = 0;
      FdWatch answering(loop, instrument, FdWatch::readable, "instrument", [&](const FdEvent&) {
        char bytes[64];
        const ssize_t got = ::read(instrument, bytes, sizeof bytes);
        if (got > 0) asked.append(bytes, static_cast<std::size_t>(got));
        for (auto end = asked.find('\n'); end != std::string::npos; end = asked.find('\n')) {
          CHECK(asked.substr(0, end) == "MEAS?");
          asked.erase(0, end + 1);
          if (is_silent) continue;
          const std::string answer = std::to_string(++answers) + ".5\r\n";
          CHECK(::write(instrument, answer.data(), answer.size()) == static_cast<ssize_t>(answer.size()));
        }
      });
      SerialPort port({.device = device("TTY_A"), .serial = {.baud_rate = 115200}, .answer_timeout = 200ms});
      DriverSensor<Query> meter(loop, {.name = "meter", .rate = 20_Hz, .required = true}, port, {},
                                {.request = "MEAS?\n", .fields = {{.name = "voltage", .unit = "V"}}});
      double last = 0;
      const auto heard = loop.subscribe("meter", [&](const EventView& event) {
        const double value = std::stod(to_string(event.value("voltage").value()));
        CHECK(value > last);
        last = value;
        if (meter.counts().published == 20 || meter.counts().failed > 0) loop.stop();
      });
      Timer patience = limit(loop);
      loop.run();
      CHECK(meter.counts().published == 20);
      is_silent = true;
      Ticker look(loop, 10ms, [&](const Tick&) {
        if (meter.counts().failed >= 2) is_silent = false;
      });
      patience.start(20s);
      loop.run();  // until the first value after the silence
      CHECK(meter.counts().failed >= 2);
      CHECK(meter.health() == Health::ok);
      meter.stop();
      CHECK(meter.counts().balances());
      close_balanced(loop);
    }
    detail::close_tty(instrument);
  }
  TEST_CASE("US-13 NFR-3 serial ports: lines of CSV arrive whole and in order at several speeds") {
    for (const std::uint32_t baud_rate : {9600u, 115200u, 250000u, 1000000u}) {
      check_lines(device("TTY_A"), device("TTY_B"), LineFormat::csv, baud_rate);
    }
  }
  TEST_CASE("US-13 NFR-3 serial ports: lines of JSON arrive whole and in order at several speeds") {
    for (const std::uint32_t baud_rate : {9600u, 115200u, 250000u, 1000000u}) {
      check_lines(device("TTY_B"), device("TTY_A"), LineFormat::json, baud_rate);
    }
  }
}
