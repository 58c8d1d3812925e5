// Serial lines over two ports of the kernel that are wired to each other.
#include <asm/ioctls.h>
#include <asm/termbits.h>
#include <doctest/doctest.h>
#include <sys/ioctl.h>

#include "io/tty.hpp"
#include "kernel/bench.hpp"
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
         .format = format,
         .fields = {{.name = "count", .type = Kind::u32}, {.name = "ax", .unit = "m/s2", .key = "imu.ax"}},
         .first_line = FirstLine::keep,
         .sequence_field = "count",
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
