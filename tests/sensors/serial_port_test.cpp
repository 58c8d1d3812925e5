// Serial ports as buses: bytes and arrays on pseudo terminals, requests and answers of drivers on a fake.
#include "has.hpp"
#include "rtdata/io/serial.hpp"

#include <doctest/doctest.h>
#include <sys/file.h>
#include <sys/wait.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <thread>

#include "data/hex_bytes.hpp"
#include "io/tty.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/chips/mhz19.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/query.hpp"
#include "rtdata/testing/fake_serial.hpp"
#include "sensors/fixture.hpp"
#include "sensors/pty.hpp"
#include "sensors/termios2.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

using rtdata::test::has;

std::string read_all(int fd, std::size_t size) {
  std::string text;
  for (int i = 0; i < 1000 && text.size() < size; ++i) {  // of what was written: it is there at once
    char bytes[512];
    const ssize_t got = ::read(fd, bytes, sizeof bytes);
    if (got > 0) text.append(bytes, static_cast<std::size_t>(got));
  }
  return text;
}

struct Line {
  ScratchDirectory directory;
  Pty pty{directory.file("tty")};
  Line() { pty.plug_in(); }
  SerialPortConfig config() const { return {.device = pty.path(), .answer_timeout = 2s, .timeout = 10s}; }
};

}  // namespace

TEST_SUITE_BEGIN("sensors" * doctest::skip(!terminals_can_be_set_up()));

TEST_CASE("US-13 US-42 a serial port writes and reads bytes, arrays and texts") {
  Line line;
  SerialPort port(line.config());
  SerialDevice device = port.device();
  device.write(std::uint8_t{0x00}).or_throw();
  std::array<std::uint8_t, 256> every{};
  for (std::size_t i = 0; i < every.size(); ++i) every[i] = static_cast<std::uint8_t>(i);
  device.write(every).or_throw();
  device.write("MEAS?\n").or_throw();
  std::string wanted(1, '\0');
  wanted.append(reinterpret_cast<const char*>(every.data()), every.size());
  CHECK(read_all(line.pty.master(), 263) == wanted + "MEAS?\n");

  line.pty.send(wanted + "1.5\r\nrest");
  CHECK(device.read_byte().or_throw() == 0);
  std::array<std::uint8_t, 256> back{};
  device.read(back).or_throw();
  CHECK(back == every);
  CHECK(device.read_until('\n').or_throw() == "1.5\r");
  std::array<std::uint8_t, 16> some{};
  CHECK(device.read_some(some).or_throw() == 4);
  CHECK(std::string(reinterpret_cast<const char*>(some.data()), 4) == "rest");

  line.pty.send("stale");
  device.drop_input().or_throw();
  line.pty.send("x");
  CHECK(device.read_byte().or_throw() == 'x');
  CHECK(port.counts().failed == 0);
  CHECK(port.counts().transfers >= 5);
}

TEST_CASE("US-13 US-42 a serial port has the settings that it is given, 9600 8N1 by default, and is one program's") {
  Line line;
  {
    SerialPort port(SerialPortConfig{.device = line.pty.path()});
    port.device().look_at().or_throw();
    CHECK(terminal_settings(line.pty.device()).output_speed == 9600);
    CHECK(terminal_settings(line.pty.device()).is_exclusive);
    // A second one is refused, and is told who has it.
    SerialPort second("second", line.config());
    const Error error = second.device().look_at().error();
    CHECK(error.code == Errc::busy);
    CHECK(has(error.text(), "this program has already opened it"));
  }
  CHECK_FALSE(terminal_settings(line.pty.device()).is_exclusive);
  SerialPort fast(SerialPortConfig{.device = line.pty.path(), .serial = {.baud_rate = 250000}});
  fast.device().look_at().or_throw();
  CHECK(terminal_settings(line.pty.device()).input_speed == 250000);
  CHECK_THROWS_AS(SerialPort(SerialPortConfig{.device = "x", .serial = {.character_size = 9}}), SetupError);
}

TEST_CASE("US-13 who holds a serial line is named: another program by its name and process") {
  Line line;
  int ready[2];
  REQUIRE(::pipe(ready) == 0);
  const pid_t other = ::fork();
  if (other == 0) {
    const int fd = ::open(line.pty.path().c_str(), O_RDWR | O_NOCTTY);
    const char is_locked = ::flock(fd, LOCK_EX) == 0 ? 'y' : 'n';
    [[maybe_unused]] const ssize_t told = ::write(ready[1], &is_locked, 1);
    ::pause();
    ::_exit(0);
  }
  char is_locked = 'n';
  CHECK(::read(ready[0], &is_locked, 1) == 1);
  CHECK(is_locked == 'y');
  const auto refused = detail::open_tty(line.pty.path(), {});
  REQUIRE_FALSE(refused);
  CHECK(refused.error().code == Errc::busy);
  CHECK(has(refused.error().why, "(process " + std::to_string(other) + ") uses it"));
  ::kill(other, SIGKILL);
  ::waitpid(other, nullptr, 0);
  ::close(ready[0]);
  ::close(ready[1]);
}

TEST_CASE("US-13 US-42 no answer, half an answer and one without an end are errors that say so, after their time") {
  Line line;
  SerialPort port(line.config());
  SerialDevice device = port.device();
  std::array<std::uint8_t, 4> four{};
  CHECK(device.read(four, 1ms).error().code == Errc::timed_out);
  line.pty.send("ab");
  const Error half = device.read(four, 20ms).error();
  CHECK(half.code == Errc::timed_out);
  CHECK(has(half.text(), "2 of 4 bytes came within 20 ms"));
  device.drop_input().or_throw();
  line.pty.send(std::string(100, 'a'));
  CHECK(device.read_until('\n', 1s, 50).error().code == Errc::does_not_fit);
  CHECK(device.read_until('\n', 1ms).error().code == Errc::timed_out);
  device.abandon();
  CHECK(device.write("x").error().code == Errc::closed);
  CHECK(device.read(four, 1ms).error().code == Errc::closed);
}

TEST_CASE("US-13 US-42 an adapter that is unplugged is told, and comes back by its path") {
  Line line;
  SerialPort port(line.config());
  SerialDevice device = port.device();
  device.write("a").or_throw();
  line.pty.unplug();
  const Error lost = device.read_byte().error();
  CHECK(lost.code == Errc::disconnected);
  CHECK(device.write("a").error().code == Errc::not_found);
  line.pty.plug_in();
  device.write("b").or_throw();
  CHECK(read_all(line.pty.master(), 1) == "b");
}

TEST_CASE("US-13 US-42 a request drops what came too late for the one before it") {
  Line line;
  SerialPort port(line.config());
  SerialDevice device = port.device();
  device.look_at().or_throw();
  line.pty.send("late answer\n");
  // A peer needs a thread: both sides of a request block.
  std::thread peer([&] {
    std::string request;
    while (request != "ask\n") request += read_all(line.pty.master(), 1);
    line.pty.send("right\n");
  });
  CHECK(device.transact("ask\n", '\n').or_throw() == "right");
  peer.join();
}

TEST_CASE("US-13 NFR-1 a silent device on a real port holds its lane alone; an unplugged one comes back") {
  Line line;
  Loop loop;
  be_quiet(loop);
  loop.on_error([](const ErrorReport&) {});
  SerialPortConfig config = line.config();
  config.answer_timeout = 5ms;
  SerialPort port("meter", config);
  DriverSensor<Query> meter(loop, {.name = "meter", .rate = 200_Hz, .retry_first = 2ms, .retry_longest = 4ms}, port, {},
                            {.request = "V?\n", .fields = {{.name = "v"}}});
  int values = 0;
  const auto heard = loop.subscribe("meter", [&](const EventView&) { ++values; });
  bool is_silent = true;
  const auto until = [&](const std::function<bool()>& is_so) {
    bool done = false;
    Timer limit(loop, 60s, [&] { loop.stop(); });
    Ticker look(loop, 1ms, [&](const Tick&) {
      char bytes[64];
      while (line.pty.master() >= 0 && ::read(line.pty.master(), bytes, sizeof bytes) > 0) {
        if (!is_silent) line.pty.send("2.5\r\n");
      }
      done = is_so();
      if (done) loop.stop();
    });
    loop.run();
    CHECK(done);
  };
  until([&] { return meter.counts().failed > 3; });
  CHECK(values == 0);
  is_silent = false;
  until([&] { return values > 3; });
  line.pty.unplug();
  until([&] { return meter.health() == Health::faulted; });
  line.pty.plug_in();
  const int before = values;
  until([&] { return values > before + 3 && meter.health() == Health::ok; });
  meter.stop();
  CHECK(meter.counts().balances());
}

TEST_CASE("US-13 settings that a line cannot do are refused, and leave it free") {
  Line line;
  const auto refused = [&](const SerialSettings& settings) {
    const auto opened = detail::open_tty(line.pty.path(), settings);
    REQUIRE_FALSE(opened);
    CHECK(opened.error().code == Errc::out_of_range);
    return opened.error().text();
  };
  CHECK(has(refused({.dtr = false}), "it has no line that `dtr` could set"));
  CHECK(has(refused({.rts = true}), "it has no line that `rts` could set"));
  CHECK(has(refused({.hangup = true}), "it has no lines that `hangup` could clear"));
  CHECK(has(refused({.rs485 = Rs485::rts_low}), "its driver cannot switch an RS-485 line in this way: remove `rs485`"));
  const auto opened = detail::open_tty(line.pty.path(), {});
  REQUIRE(opened);
  detail::close_tty(*opened);
}

TEST_SUITE_END();

namespace {

struct SerialPortBench {
  std::shared_ptr<FakeSerial> wires = std::make_shared<FakeSerial>();
  SerialPort port{"meter", wires, {.answer_timeout = 50ms, .timeout = 1s}};
  Loop loop{Loop::Manual{}};
  std::vector<std::string> errors;
  std::vector<std::string> values;
  Subscription heard;
  SerialPortBench() {
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error.text());
    });
    heard = loop.subscribe("#", [this](const EventView& event) {
      if (event.topic().starts_with("$")) return;
      std::string text;
      for (const Leaf& leaf : event.description().leaves())
        text += (text.empty() ? "" : " ") + to_string(event.value(leaf));
      values.push_back(text);
    });
  }
};

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-42 a query sends its request each tick and takes the answer's columns") {
    SerialPortBench bench;
    bench.wires->on_write(
        [](std::string_view request) { return request == "READ?\r\n" ? "+1.25E+00,V,7\r\n" : std::string(); });
    DriverSensor<Query> meter(bench.loop, {.name = "meter", .rate = 10_Hz}, bench.port, {},
                              {.request = "READ?\r\n",
                               .at_open = {"*RST\n", "CONF:VOLT\n"},
                               .fields = {{.name = "voltage", .unit = "V"}, {}, {.name = "range", .type = Kind::u8}}});
    bench.loop.advance(450ms);
    CHECK(bench.values == std::vector<std::string>(5, "1.25 7"));
    CHECK(bench.wires->written()[0] == "*RST\n");
    CHECK(bench.wires->written()[1] == "CONF:VOLT\n");
    CHECK(bench.wires->written()[2] == "READ?\r\n");
    CHECK(bench.wires->written().size() == 7);
    CHECK(meter.counts().balances());
    CHECK(bench.errors.empty());
  }

  TEST_CASE("US-42 a query: hexadecimal requests, echoes, other ends, JSON") {
    SerialPortBench bench;
    bench.wires->on_write([](std::string_view request) {
      if (request == std::string_view("\x02M\r", 3)) return "echo\r" + std::string("12 g\r");
      return std::string("{\"air\":{\"t\":21.5}}\n");
    });
    DriverSensor<Query> scale(bench.loop, {.name = "scale", .rate = 10_Hz}, bench.port, {},
                              {.request_hex = "02 4d0D",
                               .answer_end = '\r',
                               .skip_lines = 1,
                               .fields = {{.name = "mass", .type = Kind::i32, .unit = "g"}, {}},
                               .separator = ' '});
    bench.loop.advance(50ms);
    CHECK(bench.values == std::vector<std::string>{"12"});
    DriverSensor<Query> air(bench.loop, {.name = "air", .rate = 10_Hz}, bench.port, {},
                            {.request = "?", .format = LineFormat::json, .fields = {{.name = "t", .key = "air.t"}}});
    bench.loop.advance(1ms);
    CHECK(bench.values.back() == "21.5");
    CHECK(bench.errors.empty());
  }

  TEST_CASE("US-42 the answer to a question at the opening is not taken for that of the first request") {
    SerialPortBench bench;
    bench.wires->on_write([](std::string_view asked) {
      return asked == "*OPC?\n" ? "1\n" : asked == "MEAS?\n" ? "12.5\n" : asked == "ATE0\n" ? "OK\n" : "";
    });
    bench.wires->set_delay(40ms);
    DriverSensor<Query> meter(bench.loop, {.name = "meter", .rate = 2_Hz}, bench.port, {},
                              {.request = "MEAS?\n", .at_open = {"*RST\n", "*OPC?\n"}, .fields = {{.name = "v"}}});
    bench.loop.advance(3s);
    CHECK(bench.values.size() >= 5);
    CHECK(std::count(bench.values.begin(), bench.values.end(), "12.5") == std::ssize(bench.values));
    CHECK(bench.errors.empty());
    meter.close();
    bench.values.clear();
    DriverSensor<Query> modem(bench.loop, {.name = "meter", .rate = 2_Hz}, bench.port, {},
                              {.request = "MEAS?\n",
                               .at_open = {"ATE0\n"},
                               .at_open_hex = {"41 54 45 30 0a"},
                               .at_open_answers = true,
                               .fields = {{.name = "v"}}});
    bench.loop.advance(3s);
    CHECK(bench.values.size() >= 5);
    CHECK(bench.errors.empty());
  }

  TEST_CASE("US-42 a device that measures when it is told to is asked for its values afterwards") {
    SerialPortBench bench;
    // As a sensor of SDI-12: how long it will take, then its address when it has measured, then the values.
    std::string mistake;
    bench.wires->on_write([&](std::string_view asked) -> std::string {
      if (asked == "0M!") return "00012\r\n0\r\n" + mistake;
      return asked == "0D0!" ? "0+3.14-5\r\n" : "";
    });
    bench.wires->set_delay(20ms);
    DriverSensor<Query> soil(bench.loop, {.name = "soil", .rate = 1_Hz}, bench.port, {},
                             {.request = "0D0!",
                              .prepare = {"0M!"},
                              .prepare_wait = 300ms,
                              .fields = {{.name = "rest", .type = Kind::text}}});
    const MonotonicTime begin = bench.loop.now();
    bench.loop.advance(3s);
    CHECK(bench.values == std::vector<std::string>(3, "0+3.14-5"));
    CHECK(bench.loop.now() - begin == 3s);
    const std::vector<std::string> written = bench.wires->written();
    CHECK(std::vector<std::string>(written.begin(), written.begin() + 4) ==
          std::vector<std::string>{"0M!", "0D0!", "0M!", "0D0!"});
    CHECK_THROWS_AS(DriverSensor<Query>(bench.loop, {.name = "long", .rate = 1_Hz}, bench.port, {},
                                        {.request = "0D0!",
                                         .prepare = {"0M!"},
                                         .prepare_wait = 1s,
                                         .fields = {{.name = "rest", .type = Kind::text}}}),
                    SetupError);  // the port gives up after as long
    // What comes too late is not taken for the values.
    mistake = "0+1-1\r\n";
    bench.loop.advance(2s);
    CHECK(std::count(bench.values.begin(), bench.values.end(), "0+3.14-5") == std::ssize(bench.values));
    // Without an answer it has no values, and the reason names the setting.
    CHECK(bench.errors.empty());
    bench.wires->on_write([](std::string_view asked) { return asked == "0D0!" ? "0+3.14-5\r\n" : ""; });
    bench.loop.advance(3s);
    REQUIRE(!bench.errors.empty());
    CHECK(has(bench.errors.back(), "the answer to one of `prepare`"));
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-42 bytes that prepare a reading are answered by a frame, and are put back where they are stuffed") {
    SerialPortBench bench;
    const auto hex = [](const char* text) { return detail::bytes_of_hex(text).value(); };
    bench.wires->on_write([&](std::string_view asked) -> std::string {
      if (asked == hex("7e 00 56 00 a9 7e")) return hex("7e 00 56 00 00 a9 7e");
      return asked == hex("7e 00 03 00 fc 7e") ? hex("7e 00 03 00 02 7d 5e 7d 31 6b 7e") : "";
    });
    const LineChecksum sum{.type = ChecksumType::sum8, .form = ChecksumForm::big, .complement = Complement::ones};
    DriverSensor<Query> dust(bench.loop, {.name = "dust", .rate = 1_Hz}, bench.port, {},
                             {.request_hex = "7e 00 03 00 fc 7e",
                              .prepare_hex = {"7e 00 56 00 a9 7e"},
                              .format = LineFormat::binary,
                              .fields = {{.name = "size", .type = Kind::u16, .at = 4}},
                              .frame = LineFrame{.stuffing = Stuffing::hdlc},
                              .checksum = sum});
    bench.loop.advance(3s);
    CHECK(bench.values == std::vector<std::string>(3, std::to_string(0x7e11)));
    CHECK(bench.errors.empty());
  }

  TEST_CASE("US-42 a device that was away for a moment is set up again before it is asked, by each of its sensors") {
    SerialPortBench bench;
    bool is_set_up = false;
    bench.wires->on_write([&](std::string_view asked) {
      if (asked == "MODE\n") is_set_up = true;
      return asked == "?" ? is_set_up ? "1\n" : "-1\n" : "";
    });
    const Query::Config config{.request = "?", .at_open = {"MODE\n"}, .fields = {{.name = "v"}}};
    DriverSensor<Query> first(bench.loop, {.name = "first", .rate = 10_Hz, .faulted_after = 100}, bench.port, {},
                              config);
    DriverSensor<Query> second(bench.loop, {.name = "second", .rate = 10_Hz, .faulted_after = 100}, bench.port, {},
                               config);
    bench.loop.advance(1s);
    for (int i = 0; i < 3; ++i) {
      bench.wires->unplug();
      is_set_up = false;
      bench.loop.advance(150ms);
      bench.wires->plug_in();
      bench.loop.advance(1s);
    }
    CHECK(bench.values.size() >= 40);
    CHECK(std::count(bench.values.begin(), bench.values.end(), "1") == std::ssize(bench.values));
    const auto written = bench.wires->written();
    CHECK(std::count(written.begin(), written.end(), "MODE\n") >= 8);
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-42 a device that says that it has no value has answered: the next one is asked at once") {
    SerialPortBench bench;
    bench.wires->on_write([](std::string_view asked) { return asked == "A?" ? "NO DATA\n" : "5\n"; });
    const Query::Config none{
        .request = "A?", .fields = {{.name = "a"}}, .unreadable_if = LineMatch{.contains = "NO DATA"}};
    const Query::Config other{.request = "B?", .fields = {{.name = "b"}}};
    DriverSensor<Query> first(bench.loop, {.name = "first", .rate = 1_Hz}, bench.port, {}, none);
    DriverSensor<Query> second(bench.loop, {.name = "second", .rate = 1_Hz}, bench.port, {}, other);
    bench.loop.advance(10s);
    CHECK(second.counts().failed == 0);
    CHECK(second.counts().published >= 10);
    CHECK(first.counts().unreadable >= 8);
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-42 an answer may be a number of bytes, without a mark") {
    SerialPortBench bench;
    bench.wires->on_write([](std::string_view) { return std::string("\x00\x1c", 2); });
    DriverSensor<Query> geiger(bench.loop, {.name = "meter", .rate = 1_Hz}, bench.port, {},
                               {.request = "<GETCPM>>",
                                .format = LineFormat::binary,
                                .fields = {{.name = "cpm", .type = Kind::u16, .at = 0}},
                                .frame = LineFrame{.length = 2}});
    bench.loop.advance(2s);
    REQUIRE_FALSE(bench.values.empty());
    CHECK(bench.values.front() == "28");
    CHECK(bench.errors.empty());
  }

  TEST_CASE("US-42 an answer that comes while the next sensor's is awaited is taken for nobody's") {
    SerialPortBench bench;
    bench.wires->on_write([](std::string_view request) { return request == "V?" ? "230\n" : "5\n"; });
    const Query::Config of_volts{.request = "V?", .fields = {{.name = "v"}}},
        of_current{.request = "C?", .fields = {{.name = "c"}}};
    const SensorConfig volts{.name = "volts", .rate = 2_Hz, .faulted_after = 100};
    const SensorConfig current{.name = "current", .rate = 2_Hz, .faulted_after = 100};
    DriverSensor<Query> first(bench.loop, volts, bench.port, {}, of_volts);
    DriverSensor<Query> second(bench.loop, current, bench.port, {}, of_current);
    std::size_t wrong = 0;
    const auto heard = bench.loop.subscribe("current", [&](const EventView& event) {
      if (std::get<double>(event.value("c").or_throw()) != 5) ++wrong;
    });
    for (const Duration delay : {0ms, 60ms, 75ms, 90ms, 120ms, 145ms, 0ms}) {
      bench.wires->set_delay(delay);
      bench.loop.advance(2s);
    }
    CHECK(wrong == 0);
    CHECK(first.health() == Health::ok);
    CHECK(second.health() == Health::ok);
    CHECK(second.counts().published >= 6);
    CHECK(second.counts().failed >= 10);
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-42 a query that is answered too late, wrongly or not at all fails, and takes no answer for another's") {
    SerialPortBench bench;
    int asked = 0;
    bench.wires->on_write([&](std::string_view) { return std::to_string(++asked) + "\n"; });
    DriverSensor<Query> meter(bench.loop, {.name = "meter", .rate = 10_Hz, .faulted_after = 100}, bench.port, {},
                              {.request = "?", .fields = {{.name = "n", .type = Kind::i32}}});
    bench.loop.advance(50ms);
    CHECK(bench.values == std::vector<std::string>{"1"});
    bench.wires->set_delay(70ms);  // longer than it waits: 50 ms
    bench.loop.advance(330ms);
    CHECK(bench.values.size() == 1);
    CHECK(meter.counts().failed == 3);
    REQUIRE_FALSE(bench.errors.empty());
    CHECK(has(bench.errors[0], "bus meter: nothing came within 50 ms"));
    bench.wires->set_delay(0ms);
    bench.loop.advance(800ms);  // it is left still until the late answer 2 can no longer come
    CHECK(bench.values == std::vector<std::string>{"1", "3"});
    bench.wires->on_write([](std::string_view) { return "ERROR\n"; });
    bench.loop.advance(100ms);
    CHECK(meter.counts().unreadable == 1);
    CHECK_MESSAGE(has(bench.errors.back(), "field n: \"ERROR\" is not an int32"), bench.errors.back());
    bench.wires->unplug();
    bench.loop.advance(200ms);
    CHECK(has(bench.errors.back(), "the device has disappeared"));
    bench.wires->plug_in();
    bench.wires->on_write([](std::string_view) { return "9\n"; });
    bench.loop.advance(1s);  // after the one that made no sense, too
    CHECK(bench.values.back() == "9");
    CHECK(meter.health() == Health::ok);
    CHECK(meter.counts().balances());
  }

  TEST_CASE("US-42 MH-Z19: the manual's example, checksums, and what it does not measure") {
    const std::array<std::uint8_t, 9> request{0xff, 0x01, 0x86, 0, 0, 0, 0, 0, 0x79};
    CHECK(MhZ19::checksum(request) == 0x79);
    const auto answer = [](unsigned ppm) {
      std::array<std::uint8_t, 9> bytes{
          0xff, 0x86, static_cast<std::uint8_t>(ppm >> 8), static_cast<std::uint8_t>(ppm & 0xff), 0x47, 0, 0, 0, 0};
      bytes[8] = MhZ19::checksum(bytes);
      return bytes;
    };
    CHECK(MhZ19::decode(answer(608)).or_throw().co2 == 608);  // 0x02, 0x60
    CHECK(MhZ19::decode(answer(10000)).or_throw().co2 == 10000);
    const auto none = MhZ19::decode(answer(0));
    REQUIRE_FALSE(none);
    CHECK(none.error().why == "it reports 0 ppm, as it does while it warms up");
    CHECK(MhZ19::decode(answer(10001)).error().code == Errc::bad_data);
    for (std::size_t byte = 0; byte < 9; ++byte) {
      for (int bit = 0; bit < 8; ++bit) {
        auto wrong = answer(608);
        wrong[byte] = static_cast<std::uint8_t>(wrong[byte] ^ 1 << bit);
        CHECK(MhZ19::decode(wrong).error().code == Errc::bad_data);
      }
    }
    SerialPortBench bench;
    const auto good = answer(415);
    std::string text(reinterpret_cast<const char*>(good.data()), good.size());
    bench.wires->on_write(
        [&](std::string_view asked) { return asked.size() == 9 && asked[2] == '\x86' ? text : std::string(); });
    DriverSensor<MhZ19> air(bench.loop, {.name = "air", .rate = 1_Hz}, bench.port);
    bench.loop.advance(500ms);
    CHECK(bench.values == std::vector<std::string>{"415"});
    text.pop_back();  // one byte is lost on the way
    bench.loop.advance(1s);
    CHECK(air.counts().failed == 1);
    text += "x";
    bench.loop.advance(1s);
    CHECK(air.counts().unreadable == 1);
    text = std::string(reinterpret_cast<const char*>(good.data()), good.size());
    bench.loop.advance(1s);
    CHECK(bench.values.size() == 2);
    CHECK(air.counts().balances());
  }

  TEST_CASE("US-42 US-17 check refuses what a serial port or a query cannot be, and a device that two have") {
    const auto report = [](const std::string& buses, const std::string& sensors) {
      const SystemPlan plan = plan_system(standard_registry(),
                                          parse_config(R"({"buses": {)" + buses + R"(}, "sensors": [)" + sensors +
                                                           R"(], "sinks": [{"type": "console"}]})",
                                                       "f.json"));
      return plan.report();
    };
    const std::string bus = R"("m": {"type": "serial", "device": "/dev/ttyUSB0"})";
    const auto query = [](const std::string& more) {
      return R"({"name": "q", "type": "query", "rate": "1 Hz", "bus": "m", "fields": [{"name": "x"}])" + more + "}";
    };
    CHECK(report(bus, query(R"(, "request": "?\n")")).empty());
    // Two sensors may ask one device for different things.
    CHECK(
        report(
            bus,
            query(R"(, "request": "A\n")") +
                R"(, {"name": "p", "type": "query", "rate": "1 Hz", "bus": "m", "fields": [{"name": "x"}], "request": "B\n"})")
            .empty());
    CHECK(has(report(bus, query("")), "there is no request"));
    CHECK(has(report(bus, query(R"(, "request": "?", "request_hex": "00")")), "there is also a `request`"));
    CHECK(has(report(bus, query(R"(, "request_hex": "0")")), "these are not bytes"));
    CHECK(has(report(bus, query(R"(, "request_hex": "0g")")), "these are not bytes"));
    CHECK(has(report(bus, query(R"(, "request": "?", "separator": "1")")),
              "separator: numbers may contain this character"));
    CHECK(has(
        report(R"("m": {"type": "serial", "device": "/dev/x", "answer_timeout": "9 s"})", query(R"(, "request": "?")")),
        "make `timeout` longer"));
    const std::string both = R"("rts": true, "rs485": "rts_high")", why = "with `rs485` the kernel sets RTS";
    CHECK(
        has(report(R"("m": {"type": "serial", "device": "/dev/x", )" + both + "}", query(R"(, "request": "?")")), why));
    CHECK(has(
        report("", R"({"name": "l", "type": "serial", "device": "/dev/x", "fields": [{"name": "x"}], )" + both + "}"),
        why));
    CHECK(report(R"("m": {"type": "serial", "device": "/dev/x", "echo": true, "dtr": false, "hangup": true})",
                 query(R"(, "request": "?")"))
              .empty());
    const std::string line = R"({"name": "l", "type": "serial", "device": "/dev/ttyUSB0", "fields": [{"name": "x"}]})";
    CHECK(has(report(bus, line), "bus m, at f.json:1:"));
    CHECK(has(report(bus, line), "has this device already; a device belongs to one sensor or one bus only"));
    // Sensors of one tier with the same settings share a device.
    const auto second = [&](const std::string& more) {
      return line + R"(, {"name": "k", "type": "serial", "device": "/dev/ttyUSB0", "fields": [{"name": "x"}])" + more +
             "}";
    };
    CHECK(report("", second("")).empty());
    CHECK(has(report("", second(R"(, "baud_rate": 4800)")), "sensor l, at f.json:1:"));
    CHECK(has(report("", second(R"(, "baud_rate": 4800)")), "need the same `baud_rate` and so on, and the same tier"));
    const std::string ask = query(R"(, "request": "?")");
    CHECK(report(R"("m": {"type": "serial", "host": "scope.local", "port": 5025})", ask).empty());
    CHECK(has(report(R"("m": {"type": "serial"})", ask), "one of `device`, `host` and `run` is needed"));
    CHECK(has(report(R"("m": {"type": "serial", "host": "a"})", ask), "there is no `port`"));
    CHECK(has(report(R"("m": {"type": "serial", "device": "/dev/x", "host": "a", "port": 1})", ask),
              "only one of `device`, `host` and `run` is possible"));
    CHECK(has(report(R"("m": {"type": "serial", "host": "a", "port": 1, "dtr": true})", ask),
              "work only with a serial `device`"));
    CHECK(has(report(R"("m": {"type": "serial", "host": "a", "port": 1, "baud_rate": 9600})", ask),
              "buses.m.baud_rate: it works only with a serial `device`"));
    CHECK(has(report(R"("m": {"type": "serial", "run": ["cat"], "parity": "even"})", ask),
              "it works only with a serial `device`"));
    const auto caller = [](const std::string& name, const std::string& from) {
      return R"({"name": ")" + name + R"(", "type": "tcp", "listen": "0.0.0.0", "port": 5000)" + from +
             R"(, "fields": [{"name": "v"}]})";
    };
    const std::string two = R"(, "from": "192.168.1.2")", three = R"(, "from": "192.168.1.3")";
    CHECK(report("", caller("a", two) + ", " + caller("b", three)).empty());
    CHECK(has(report("", caller("a", two) + ", " + caller("b", two)), "one sensor takes all of a device"));
    CHECK(has(report("", caller("a", two) + ", " + caller("b", "")), "set the `from` of each"));
    CHECK(has(report("", caller("a", two + R"(, "connect_timeout": "1 s")")),
              "connect_timeout: with `listen`, the device makes the connection"));
    CHECK(has(report("", R"({"name": "l", "type": "serial", "device": "/dev/ttyUSB0"})"), "no field has a name"));
    CHECK(report("", R"({"name": "l", "type": "serial", "device": "/dev/ttyUSB0", "format": "nmea"})").empty());
  }
}
