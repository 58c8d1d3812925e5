// Lines over TCP, from a server as a test scripts it.
#include "rtdata/sensors/tcp_lines.hpp"

#include <arpa/inet.h>
#include <doctest/doctest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <string>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

#include "has.hpp"
#include "rtdata/data/event.hpp"
#include "rtdata/io/serial.hpp"
#include "rtdata/sensors/query.hpp"
#include "sensors/fake_gpsd.hpp"
#include "sensors/fixture.hpp"
#include "sensors/lines_bench.hpp"

using namespace rtdata;
using rtdata::test::has;
using namespace std::chrono_literals;

namespace {

/// A device that connects to this machine.
class Caller {
 public:
  explicit Caller(std::uint16_t port, const char* from = "127.0.0.1")
      : fd_(::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    ::inet_pton(AF_INET, from, &address.sin_addr);
    REQUIRE(::bind(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0);
    ::inet_pton(AF_INET, "127.0.0.1", &address.sin_addr);
    address.sin_port = htons(port);
    const int status = ::connect(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address);
    REQUIRE((status == 0 || errno == EINPROGRESS));
  }
  Caller(const Caller&) = delete;
  Caller& operator=(const Caller&) = delete;
  ~Caller() { ::close(fd_); }
  void send(std::string_view bytes) const {
    for (int i = 0; i < 2000; ++i) {
      if (::send(fd_, bytes.data(), bytes.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(bytes.size())) return;
      std::this_thread::sleep_for(1ms);
    }
    FAIL_CHECK("nothing was sent");
  }
  /// What has come; "end": the other side has closed.
  std::string received() const {
    char bytes[256];
    const ssize_t got = ::recv(fd_, bytes, sizeof bytes, 0);
    if (got > 0) return {bytes, static_cast<std::size_t>(got)};
    return got == 0 || (errno != EAGAIN && errno != ENOTCONN) ? "end" : "";
  }

 private:
  const int fd_;
};

std::uint16_t free_tcp_port() {
  const FakeGpsd one;
  return one.port();
}

struct CallerBench : LinesBench<TcpLines, TcpLinesConfig> {
  explicit CallerBench(TcpLinesConfig config) : LinesBench(on_this_machine(std::move(config))) {}
  static TcpLinesConfig on_this_machine(TcpLinesConfig config) {
    config.listen = "127.0.0.1";
    config.lines.fields = {{.name = "v"}};
    return config;
  }
};

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-17 US-7 a device that connects to this machine: its lines, its end, its second start") {
    const std::uint16_t port = free_tcp_port();
    CallerBench bench({.port = port, .at_open = {"go\n"}});
    CHECK(bench.sensor.health() == Health::faulted);  // nobody has connected
    {
      const Caller device(port);
      device.send("1\n2\n3");
      REQUIRE(bench.until([&] { return bench.events.size() == 2; }));
      CHECK(bench.sensor.health() == Health::ok);
      std::string told;
      REQUIRE(bench.until([&] { return has(told += device.received(), "go\n"); }));
    }
    REQUIRE(bench.until([&] { return bench.errors.size() >= 2; }));
    CHECK(bench.errors[0] == "1 byte came without an end");
    CHECK(bench.errors[1] == "the device has closed it");
    CHECK(bench.sensor.health() == Health::faulted);

    const Caller before(port);
    before.send("4\n");
    REQUIRE(bench.until([&] { return bench.events.size() == 3; }));
    const Caller after(port);  // it was switched off and on
    after.send("5\n");
    REQUIRE(bench.until([&] { return bench.events.size() == 4; }));
    CHECK(bench.errors.back() == "another connection was made, and nothing has come on this one for 1 s");
    REQUIRE(bench.until([&] { return before.received() == "end"; }));

    const Caller stranger(port);  // while the first one sends
    std::size_t sent = 5;
    REQUIRE(bench.until([&] {
      after.send("6\n");
      ++sent;
      return stranger.received() == "end";
    }));
    CHECK(bench.errors.back() == "another device connected while one is sending");
    REQUIRE(bench.until([&] { return bench.events.size() == sent - 1; }));
    bench.sensor.close();
    CHECK(bench.loop.runtime().balances());
    const TcpLines again(bench.loop, {.name = "again"},
                         {.port = port, .listen = "127.0.0.1", .lines = {.fields = {{.name = "v"}}}});
    CHECK(again.health() == Health::faulted);
    const Caller late(port);  // the port was given back, and is taken again
    late.send("7\n");
    REQUIRE(bench.until([&] { return again.health() == Health::ok; }));
  }

  TEST_CASE("US-17 a sensor that listens: a port that is taken, a device that is not meant, what cannot work") {
    FakeGpsd other;
    const std::uint16_t port = other.port();
    CallerBench bench({.port = port, .from = "127.0.0.2"});
    REQUIRE(bench.until([&] { return !bench.errors.empty(); }));
    CHECK(has(bench.errors.front(), "in use"));
    other.vanish();
    REQUIRE(bench.until([&] { return bench.errors.back() == "no device has connected yet"; }));
    const Caller stranger(port);
    REQUIRE(bench.until([&] { return stranger.received() == "end"; }));
    CHECK(bench.errors.back() == "it did not come from the address `from`");
    const Caller meant(port, "127.0.0.2");
    meant.send("1\n");
    REQUIRE(bench.until([&] { return bench.events.size() == 1; }));
    {  // Neither a stranger nor a look at the port takes the device's place.
      const Caller other_stranger(port);
      REQUIRE(bench.until([&] { return other_stranger.received() == "end"; }));
    }
    { const Caller look(port, "127.0.0.2"); }
    REQUIRE(bench.until([&] { return bench.errors.back() == "it was closed at once"; }));
    meant.send("1.5\n");
    REQUIRE(bench.until([&] { return bench.events.size() == 2; }));
    CHECK(meant.received().empty());
    bench.sensor.stop();
    REQUIRE(bench.until([&] { return meant.received() == "end"; }));
    bench.sensor.start();
    const Caller again(port, "127.0.0.2");
    again.send("2\n");
    REQUIRE(bench.until([&] { return bench.events.size() == 3; }));
    const auto refused = [&](TcpLinesConfig config) {
      config.lines.fields = {{.name = "v"}};
      config.port = 1;
      CHECK_THROWS_AS(TcpLines(bench.loop, {.name = "x"}, std::move(config)), SetupError);
    };
    refused({});
    refused({.host = "127.0.0.1", .listen = "0.0.0.0"});
    refused({.listen = "localhost"});
    refused({.host = "127.0.0.1", .from = "127.0.0.1"});
    refused({.listen = "0.0.0.0", .from = "::1"});
  }

  TEST_CASE("US-17 devices that connect to one port have a sensor each, and disturb no other") {
    const std::uint16_t port = free_tcp_port();
    CallerBench bench({.port = port, .from = "127.0.0.2"});
    std::vector<std::string> others;
    const auto heard = bench.loop.subscribe("other", [&](const EventView& event) {
      others.push_back(to_string(event.value(event.description().leaves()[0])));
    });
    const TcpLinesConfig of_other{
        .port = port, .listen = "127.0.0.1", .from = "127.0.0.3", .lines = {.fields = {{.name = "v"}}}};
    TcpLines other(bench.loop, {.name = "other"}, of_other);
    const TcpLines same(bench.loop, {.name = "same"}, of_other);
    CHECK(same.health() == Health::faulted);  // the other one has this device
    const Caller first(port, "127.0.0.2"), second(port, "127.0.0.3"), stranger(port, "127.0.0.4");
    first.send("1\n");
    second.send("2\n");
    REQUIRE(bench.until([&] { return bench.events.size() == 1 && others.size() == 1; }));
    REQUIRE(bench.until([&] { return stranger.received() == "end"; }));
    CHECK(bench.events == std::vector<std::string>{"1"});
    CHECK(others == std::vector<std::string>{"2"});
    bench.sensor.close();  // who got the port first goes, and the other one stays
    REQUIRE(bench.until([&] { return first.received() == "end"; }));
    second.send("3\n");
    REQUIRE(bench.until([&] { return others.size() == 2; }));
    other.close();
    CHECK(bench.loop.runtime().balances());
  }

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
    CHECK(errors.front() == "the device has closed it");
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

  TEST_CASE(
      "US-9 devices that do not answer at the start hold the others up for a second each, whatever they may take") {
    FakeGpsd silent;
    Loop loop;
    be_quiet(loop);
    SerialPort port({.host = "127.0.0.1", .port = silent.port(), .answer_timeout = 30s, .timeout = 90s});
    const auto begin = std::chrono::steady_clock::now();
    const DriverSensor<Query> mute(loop, {.name = "mute", .rate = Rate::hertz(1)}, port, {},
                                   {.request = "?\n", .at_open = {"*IDN?\n"}, .fields = {{.name = "v"}}});
    CHECK(mute.counts().published == 0);
    CHECK(std::chrono::steady_clock::now() - begin < 25s);
  }

  TEST_CASE("US-42 a program of the user's is asked, and is started again when it has ended") {
    Loop loop;
    be_quiet(loop);
    std::vector<std::string> values, errors;
    const auto heard = loop.subscribe("probe", [&](const EventView& event) {
      values.push_back(to_string(event.value(event.description().leaves()[0])));
    });
    const std::string program = "n=0; while read request; do n=$((n + 1)); echo $n; [ $n = 3 ] && exit 1; done";
    SerialPort port({.run = {"sh", "-c", program}, .answer_timeout = 4s});
    DriverSensor<Query> probe(loop, {.name = "probe", .rate = Rate::hertz(50), .faulted_after = 1, .retry_first = 10ms},
                              port, {}, {.request = "read\n", .fields = {{.name = "v"}}});
    probe.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    for (int i = 0; i < 30000 && values.size() < 5; ++i) loop.run_for(1ms);
    REQUIRE(values.size() >= 5);
    CHECK(std::vector<std::string>(values.begin(), values.begin() + 5) ==
          std::vector<std::string>{"1", "2", "3", "1", "2"});
    REQUIRE_FALSE(errors.empty());
    CHECK((has(errors.front(), "it has ended with status 1") ||
           has(errors.front(), "it has ended, or closed its terminal")));
    CHECK_THROWS_AS(SerialPort({.device = "/dev/ttyS0", .run = {"sh"}}), SetupError);
    CHECK_THROWS_AS(SerialPort({.run = {""}}), SetupError);
    CHECK(SerialPort({.run = {"no-such-program"}}).device().write("x").error().code == Errc::not_found);
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
