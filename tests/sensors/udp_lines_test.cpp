// Lines and frames by UDP, from sockets of the test.
#include "rtdata/sensors/udp_lines.hpp"

#include <arpa/inet.h>
#include <doctest/doctest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <string>
#include <vector>

#include "has.hpp"
#include "rtdata/data/event.hpp"
#include "sensors/fixture.hpp"
#include "sensors/lines_bench.hpp"

using namespace rtdata;
using rtdata::test::has;
using namespace std::chrono_literals;

namespace {

class UdpSender {
 public:
  explicit UdpSender(const char* from = "127.0.0.1") : fd_(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in own = address(from, 0);
    REQUIRE(::bind(fd_, reinterpret_cast<const sockaddr*>(&own), sizeof own) == 0);
  }
  UdpSender(const UdpSender&) = delete;
  UdpSender& operator=(const UdpSender&) = delete;
  ~UdpSender() { ::close(fd_); }
  void send(std::uint16_t port, const std::string& bytes) {
    const sockaddr_in to = address("127.0.0.1", port);
    CHECK(::sendto(fd_, bytes.data(), bytes.size(), 0, reinterpret_cast<const sockaddr*>(&to), sizeof to) ==
          static_cast<ssize_t>(bytes.size()));
  }
  std::uint16_t port() const {
    sockaddr_in own{};
    socklen_t size = sizeof own;
    ::getsockname(fd_, reinterpret_cast<sockaddr*>(&own), &size);
    return ntohs(own.sin_port);
  }

 private:
  static sockaddr_in address(const char* host, std::uint16_t port) {
    sockaddr_in one{};
    one.sin_family = AF_INET;
    one.sin_port = htons(port);
    ::inet_pton(AF_INET, host, &one.sin_addr);
    return one;
  }
  const int fd_;
};

/// A port of this machine that nobody has.
std::uint16_t free_port() { return UdpSender().port(); }

using UdpHearing = LinesBench<UdpLines, UdpLinesConfig>;

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-17 datagrams: one line, several, without an end, empty, too long, of somebody else") {
    const std::uint16_t port = free_port();
    UdpHearing bench({.port = port, .from = "127.0.0.1", .lines = {.fields = {{.name = "v"}}}});
    UdpSender sender, other("127.0.0.2");
    sender.send(port, "1");
    sender.send(port, "2\n3\r\n4");
    sender.send(port, "");
    other.send(port, "99");
    sender.send(port, std::string(UdpLinesConfig::longest_datagram + 1, '5'));
    sender.send(port, "x\n6\n");
    REQUIRE(bench.until([&] { return bench.events.size() == 5; }));
    CHECK(bench.events == std::vector<std::string>{"1", "2", "3", "4", "6"});
    const SensorCounts counts = bench.sensor.counts();
    CHECK(counts.filtered == 2);
    CHECK(counts.unreadable == 2);
    CHECK(counts.lost == 0);
    CHECK(counts.balances());
    REQUIRE(bench.errors.size() == 2);
    CHECK(has(bench.errors[0], "longer than 2048 bytes"));
    bench.sensor.close();
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-17 frames of bytes by UDP") {
    const std::uint16_t port = free_port();
    UdpHearing bench({.port = port,
                      .lines = {.format = LineFormat::binary,
                                .fields = {{.name = "a", .type = Kind::u16, .at = 4}},
                                .frame = LineFrame{.start = "DATA", .length = 6}}});
    UdpSender sender;
    sender.send(port, std::string("DATA\x01\x02", 6));
    sender.send(port, std::string("DATA\x00\x07"
                                  "DATA\x00\x08",
                                  12));
    REQUIRE(bench.until([&] { return bench.events.size() == 3; }));
    CHECK(bench.events == std::vector<std::string>{"258", "7", "8"});
    CHECK(bench.errors.empty());
    // A frame that is cut is none, and takes nothing from the next datagram.
    sender.send(port, std::string("DATA\x00", 5));
    sender.send(port, std::string("DATA\x00\x09", 6));
    REQUIRE(bench.until([&] { return bench.events.size() == 4; }));
    CHECK(bench.events.back() == "9");
    CHECK(bench.sensor.counts().unreadable == 1);
    REQUIRE(bench.errors.size() == 1);
    CHECK(bench.errors[0] == "5 bytes came without an end");
  }

  TEST_CASE("US-7 a port that is taken is a fault, and heard once it is free") {
    auto holder = std::make_unique<UdpSender>();
    const std::uint16_t port = holder->port();
    UdpHearing bench({.port = port, .lines = {.fields = {{.name = "v"}}}});
    REQUIRE(bench.until([&] { return bench.sensor.health() == Health::faulted; }));
    holder.reset();
    UdpSender sender;
    REQUIRE(bench.until([&] {
      sender.send(port, "1\n");
      return !bench.events.empty();
    }));
    CHECK(bench.sensor.health() == Health::ok);
  }

  TEST_CASE("US-9 datagrams that the kernel drops are counted, also the last, and once where lines are numbered") {
    const std::string pad(1000, ' ');
    constexpr std::uint64_t sent = 20'000;  // 20 MB, more than any buffer here
    for (const int kind : {0, 1, 2}) {
      const bool is_numbered = kind > 0, is_followed = kind > 1;
      CAPTURE(kind);
      const std::uint16_t port = free_port();
      LineConfig lines{.fields = {{.name = "v", .type = Kind::u32}}};
      if (is_numbered) lines.sequence_field = "v";
      UdpHearing bench({.port = port, .lines = lines});
      UdpSender sender;
      sender.send(port, "0");
      REQUIRE(bench.until([&] { return bench.events.size() == 1; }));
      for (std::uint64_t i = 1; i < sent; ++i) sender.send(port, std::to_string(i) + pad);
      std::size_t before = 0;
      REQUIRE(
          bench.until([&] { return std::exchange(before, bench.events.size()) == bench.events.size() && before > 1; }));
      if (is_numbered && is_followed) {
        sender.send(port, std::to_string(sent));
        REQUIRE(bench.until([&] { return bench.events.back() == std::to_string(sent); }));
        sender.send(port, std::to_string(sent + 1));  // the one before was held until its number was sure
        REQUIRE(bench.until([&] { return bench.events.back() == std::to_string(sent + 1); }));
      }
      bench.sensor.stop();
      const SensorCounts counts = bench.sensor.counts();
      CHECK((is_numbered ? counts.lost : counts.unreadable) > 0);
      CHECK(counts.lost + counts.unreadable + bench.events.size() == (is_followed ? sent + 2 : sent));
      CHECK(counts.balances());
      REQUIRE_FALSE(bench.errors.empty());
      CHECK(has(bench.errors.back(), "its buffer was full"));
    }
  }

  TEST_CASE("US-17 addresses that are none are refused") {
    Loop loop;
    be_quiet(loop);
    const LineConfig lines{.fields = {{.name = "v"}}};
    CHECK_THROWS_AS(UdpLines(loop, {.name = "a"}, {.port = 1, .address = "here", .lines = lines}), SetupError);
    CHECK_THROWS_AS(UdpLines(loop, {.name = "b"}, {.port = 1, .from = "::1", .lines = lines}), SetupError);
    CHECK_THROWS_AS(UdpLines(loop, {.name = "c"}, {.lines = lines}), SetupError);
  }
}
