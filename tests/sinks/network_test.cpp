// The tcp and udp senders, with real peers on this machine and what these do wrong.
#include <dlfcn.h>
#include <doctest/doctest.h>
#include <netdb.h>

#include <atomic>
#include <cstring>
#include <nlohmann/json.hpp>
#include <numeric>
#include <sstream>

#include "rtdata/app/program.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/loop/ledger.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sinks/tcp.hpp"
#include "rtdata/sinks/udp.hpp"
#include "sensors/fake_gpsd.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

/// What a name of the tests stands for now.
std::atomic<const char*> moving_address{"127.0.0.1"};

}  // namespace

/// Of the whole test program: one name is another address whenever a test says so. All others are asked for as ever.
extern "C" int getaddrinfo(const char* node, const char* service, const addrinfo* hints, addrinfo** found) {
  static const auto real = reinterpret_cast<decltype(&::getaddrinfo)>(::dlsym(RTLD_NEXT, "getaddrinfo"));
  const bool is_moving = node != nullptr && std::strcmp(node, "moving.invalid") == 0 &&
                         (hints == nullptr || (hints->ai_flags & AI_NUMERICHOST) == 0);
  return real(is_moving ? moving_address.load() : node, service, hints, found);
}

namespace {

/// A server on a port that was free, which does what the test tells it.
using TcpPeer = FakeGpsd;

class UdpPeer {
 public:
  UdpPeer() { open(0); }
  UdpPeer(const UdpPeer&) = delete;
  UdpPeer& operator=(const UdpPeer&) = delete;
  ~UdpPeer() { vanish(); }
  void open(std::uint16_t port, std::uint32_t host = INADDR_LOOPBACK) {
    fd_ = ::socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(host);
    address.sin_port = htons(port);
    socklen_t size = sizeof address;
    REQUIRE(::bind(fd_, reinterpret_cast<sockaddr*>(&address), size) == 0);
    ::getsockname(fd_, reinterpret_cast<sockaddr*>(&address), &size);
    port_ = ntohs(address.sin_port);
  }
  void vanish() {
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
  }
  std::uint16_t port() const { return port_; }
  /// The next datagram; empty: there is none.
  std::string received() const {
    std::string all(65536, '\0');
    const ssize_t got = ::recv(fd_, all.data(), all.size(), 0);
    all.resize(got > 0 ? static_cast<std::size_t>(got) : 0);
    return all;
  }

 private:
  int fd_ = -1;
  std::uint16_t port_ = 0;
};

struct Bench {
  Loop loop{Loop::Manual{}};
  std::vector<std::string> errors;
  double published = 0;
  std::uint64_t ticks = 0, missed = 0;
  Ticker ticker{loop, 10ms, [this](const Tick& tick) { ++ticks, missed += tick.missed; }};

  Bench() {
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
  }
  void publish(int count) {
    for (int i = 0; i < count; ++i) loop.topic<Number>("a/b").publish({++published});
  }
  /// Lets virtual time pass, and the sockets of this process have their turns.
  template <class Done>
  bool wait_for(Done&& done, int turns = 2000) {
    for (int i = 0; i < turns; ++i) {
      if (done()) return true;
      loop.advance(10ms);
      loop.poll();
    }
    return done();
  }
  bool has_error(const std::string& part) const {
    return std::any_of(errors.begin(), errors.end(),
                       [&](const std::string& one) { return one.find(part) != std::string::npos; });
  }
};

struct Long {
  text<500> words;
  RTDATA_FIELDS(Long, (words))
};

TcpConfig to(std::uint16_t port, TcpConfig config = {}) {
  config.host = "127.0.0.1";
  config.port = port;
  config.sink.retry_longest = 1s;
  return config;
}

/// What a peer has received in a format, taken apart.
struct Received {
  explicit Received(const std::string& format) : codec(CodecRegistry::standard().make(format).or_throw()) {}
  void take(const std::string& bytes) {
    text += bytes;
    for (;;) {
      const auto left = std::as_bytes(std::span(text));
      const std::size_t size = text.empty() ? 0 : codec->first_event(left);
      if (size == 0) return;
      const auto event = codec->decode(left.first(size), *description_of<Number>()).or_throw();
      Number number;
      std::memcpy(&number, event.payload.data(), sizeof number);
      values.push_back(number.value);
      topics.push_back(event.topic);
      runs.push_back(event.run);
      text.erase(0, size);
    }
  }
  void begin_connection() { text.clear(); }
  bool has_all(double count) const {
    for (double value = 1; value <= count; ++value)
      if (std::find(values.begin(), values.end(), value) == values.end()) return false;
    return true;
  }
  std::unique_ptr<Codec> codec;
  std::string text;
  std::vector<double> values;
  std::vector<std::string> topics, runs;
};

std::vector<double> up_to(int count) {
  std::vector<double> values(static_cast<std::size_t>(count));
  std::iota(values.begin(), values.end(), 1);
  return values;
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("US-32 events go to a TCP server in each format, in order, each with its key where the format has one") {
    for (const char* format : {"json", "cbor", "influx", "raw"}) {
      CAPTURE(format);
      Bench bench;
      TcpPeer peer;
      TcpSink sink(bench.loop, to(peer.port(), {.format = format}));
      Received received(format);
      bench.publish(2500);
      CHECK(bench.wait_for([&] {
        (void)peer.accept();
        if (peer.has_peer()) received.take(peer.received());
        return received.values.size() >= 2500;
      }));
      CHECK(received.values == up_to(2500));
      CHECK(received.topics.back() == "a/b");
      if (format != std::string("raw")) CHECK(received.runs.back().size() == 36);
      CHECK(sink.counts().stored == 2500);
      CHECK(sink.counts().balances());
      CHECK(bench.errors.empty());
      CHECK(bench.loop.close(1s) == 0);
      CHECK(bench.missed == 0);
    }
  }

  TEST_CASE("US-32 a TCP server gets the final account as the last of all, when it is asked for") {
    for (const bool is_wanted : {true, false}) {
      CAPTURE(is_wanted);
      Bench bench;
      TcpPeer peer;
      TcpConfig config = to(peer.port());
      if (is_wanted) config.sink.topics = {"#", account_topic};
      TcpSink sink(bench.loop, config);
      Feed<Number> feed(bench.loop, {.name = "chamber", .topic = "a/b"});
      feed.publish({1});
      REQUIRE(bench.wait_for([&] { return peer.accept(); }));
      for (int i = 2; i <= 5; ++i) feed.publish({static_cast<double>(i)});
      CHECK(bench.loop.close(2s) == 0);
      std::string text;
      for (int i = 0; i < 100; ++i) text += peer.received();
      std::vector<nlohmann::json> lines;
      std::istringstream stream(text);
      for (std::string line; std::getline(stream, line);) lines.push_back(nlohmann::json::parse(line));
      REQUIRE(lines.size() == (is_wanted ? 6 : 5));
      if (!is_wanted) continue;
      CHECK(lines.back()["topic"] == account_topic);
      CHECK(lines.back()["run"] == lines.front()["run"]);
      CHECK(lines.back()["data"]["name"] == "chamber");
      CHECK(lines.back()["data"]["topic"] == "a/b");
      CHECK(lines.back()["data"]["published"] == 5);
      CHECK(lines.back()["data"]["lost_is_known"] == false);
    }
  }

  TEST_CASE("US-32 raw events carry their number when it is asked for") {
    Bench bench;
    TcpPeer peer;
    TcpSink sink(bench.loop, to(peer.port(), {.format = "raw", .sequence = true}));
    bench.publish(1);
    std::string bytes;
    CHECK(bench.wait_for([&] {
      (void)peer.accept();
      if (peer.has_peer()) bytes += peer.received();
      return !bytes.empty();
    }));
    auto codec = make_raw_codec({.sequence = RawConfig::Sequence::include});
    CHECK(decode<Number>(*codec, std::as_bytes(std::span(bytes))).or_throw().sequence == 1U);
  }

  TEST_CASE("NFR-1 a server that is absent at the start delays nothing, and gets everything once it is there") {
    Bench bench;
    TcpPeer peer;
    peer.vanish();
    TcpSink sink(bench.loop, to(peer.port()));
    bench.publish(700);
    bench.wait_for([] { return false; }, 300);
    CHECK(sink.health() == Health::faulted);
    CHECK(sink.status().reason.find("refused") != std::string::npos);
    CHECK(sink.counts().queued == 700);
    CHECK(sink.counts().balances());
    peer.listen();
    REQUIRE(peer.listens());
    Received received("json");
    CHECK(bench.wait_for([&] {
      (void)peer.accept();
      if (peer.has_peer()) received.take(peer.received());
      return received.values.size() >= 700;
    }));
    CHECK(received.values == up_to(700));
    CHECK(sink.health() == Health::ok);
    CHECK(bench.missed == 0);
    CHECK(bench.ticks > 300);
  }

  TEST_CASE("US-32 with acknowledgement nothing is lost: closed in the middle, vanished, back again, doubles only") {
    for (const Acknowledge how : {Acknowledge::byte, Acknowledge::line}) {
      CAPTURE(static_cast<int>(how));
      Bench bench;
      TcpPeer peer;
      TcpSink sink(bench.loop,
                   to(peer.port(), {.acknowledge = how, .sending = {.window = 4, .parcel_rows = 50, .timeout = 5s}}));
      Received received("json");
      std::size_t confirmed = 0, connections = 0;
      std::uint32_t chance = 12345;
      const auto serve = [&] {
        if (!peer.listens()) peer.listen();
        if (peer.accept()) {
          ++connections;
          received.begin_connection();
          confirmed = received.values.size();
        }
        if (!peer.has_peer()) return;
        received.take(peer.received());
        for (; confirmed < received.values.size(); ++confirmed)
          if (!peer.send(how == Acknowledge::byte ? "\x06" : "ok\r\n")) break;
        chance = chance * 1664525 + 1013904223;
        if (connections < 6 && chance >> 28 == 0) {
          if ((chance >> 20 & 1) != 0)
            peer.hang_up();
          else
            peer.vanish();
        }
      };
      bench.publish(2000);
      CHECK(bench.wait_for([&] { return serve(), sink.counts().stored == 2000; }, 20000));
      CHECK(connections >= 6);
      CHECK(received.has_all(2000));
      CHECK(received.values.size() >= 2000);
      CHECK(sink.counts().balances());
      CHECK(sink.counts().dropped[static_cast<std::size_t>(DropReason::refused)] == 0);
      CHECK(bench.missed == 0);
      CHECK(bench.loop.close(1s) == 0);
    }
  }

  TEST_CASE("what the peer refuses is dropped, counted and reported with its reason") {
    Bench bench;
    TcpPeer peer;
    TcpSink sink(bench.loop, to(peer.port(), {.acknowledge = Acknowledge::line}));
    Received received("json");
    std::size_t answered = 0;
    bench.publish(30);
    CHECK(bench.wait_for([&] {
      (void)peer.accept();
      if (peer.has_peer()) received.take(peer.received());
      for (; answered < received.values.size(); ++answered)
        peer.send(answered % 10 == 3 ? "no it is too hot\n" : "ok\n");
      return sink.counts().queued == 0;
    }));
    CHECK(sink.counts().stored == 27);
    CHECK(sink.counts().dropped[static_cast<std::size_t>(DropReason::refused)] == 3);
    CHECK(bench.has_error("it is too hot"));
    CHECK(sink.health() == Health::ok);
    CHECK(sink.counts().balances());
  }

  TEST_CASE("acknowledgements that are garbage, too many or too long cost the connection and no event") {
    for (const std::string& garbage :
         {std::string("okay\n"), std::string("\x06\x06\n"), std::string(1000, 'o'), std::string("ok\nok\nok\n")}) {
      CAPTURE(garbage);
      Bench bench;
      TcpPeer peer;
      TcpSink sink(bench.loop, to(peer.port(), {.acknowledge = Acknowledge::line}));
      bench.publish(2);
      REQUIRE(bench.wait_for([&] { return peer.accept() && peer.send(garbage); }));
      Received received("json");
      std::size_t answered = 0;
      bool is_second = false;
      if (garbage.starts_with("ok\n")) {  // confirmed all, and one more: told with what comes next
        CHECK(bench.wait_for([&] { return sink.counts().stored == 2; }));
        bench.publish(1);
      }
      CHECK(bench.wait_for([&] {
        if (peer.accept()) is_second = true;
        if (!is_second) return false;
        received.take(peer.received());
        for (; answered < received.values.size(); ++answered) peer.send("ok\n");
        return sink.counts().queued == 0;
      }));
      CHECK(sink.counts().stored == static_cast<std::uint64_t>(bench.published));
      CHECK(bench.has_error("cannot understand the peer"));
      CHECK(sink.counts().balances());
    }
  }

  TEST_CASE("NFR-1 a peer that accepts and never reads is given up after the timeout; closing ends in time") {
    Bench bench;
    TcpPeer peer;
    TcpSink sink(bench.loop, to(peer.port(), {.sending = {.window = 4, .timeout = 2s},
                                              .sink = {.queue_bytes = std::size_t{256} << 20, .close_deadline = 1s}}));
    for (int i = 0; i < 100; ++i) {  // more than the kernel's buffers hold
      bench.publish(1000);
      bench.loop.advance(10ms);
      (void)peer.accept();
    }
    CHECK(bench.wait_for([&] { return bench.has_error("no answer for"); }));
    CHECK(sink.counts().queued > 0);
    CHECK(sink.counts().balances());
    CHECK(bench.missed == 0);
    const std::uint64_t queued = sink.counts().queued;
    CHECK(bench.loop.close(1s) <= queued);
    CHECK(bench.ticks > 100);
  }

  TEST_CASE("without acknowledgement, what was in the kernel's buffers when the peer vanished is told") {
    Bench bench;
    TcpPeer peer;
    TcpSink sink(bench.loop, to(peer.port()));
    bench.publish(1);
    REQUIRE(bench.wait_for([&] { return peer.accept(); }));
    for (int i = 0; i < 60; ++i) {
      bench.publish(1000);
      bench.loop.advance(200ms);
    }
    peer.vanish();
    bench.publish(10);
    CHECK(bench.wait_for([&] { return bench.has_error("bytes that had been sent are lost"); }));
    CHECK(sink.counts().balances());
  }

  TEST_CASE("a name that does not resolve is an error that says so, again and again, and closing ends in time") {
    Loop loop;
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    TcpConfig config{.host = "no-such-host.invalid", .port = 9, .sink = {.batch_time = 10ms, .close_deadline = 100ms}};
    TcpSink tcp(loop, config);
    UdpSink udp(loop,
                {.host = "no-such-host.invalid", .port = 9, .sink = {.batch_time = 10ms, .close_deadline = 100ms}});
    loop.topic<Number>("a").publish({1});
    Ticker look(loop, 10ms, [&](const Tick&) {
      if (tcp.health() == Health::faulted && udp.health() == Health::faulted) loop.stop();
    });
    loop.run_for(30s);  // name servers may be slow to say no
    CHECK(tcp.status().reason.find("no-such-host.invalid") != std::string::npos);
    CHECK(udp.status().reason.find("no-such-host.invalid") != std::string::npos);
    CHECK(loop.close(1s) == 2);
  }

  TEST_CASE("US-32 a tunnel that accepts and hangs up does not swallow what waits") {
    TcpPeer tunnel;
    Bench bench;
    TcpSink sink(bench.loop, to(tunnel.port(), {.sending = {.window = 1, .parcel_rows = 10},
                                                .sink = {.batch_time = 10ms, .queue_bytes = 1 << 20}}));
    int connections = 0;
    bench.wait_for([&] {
      if (bench.published < 2000) bench.publish(5);
      if (tunnel.accept()) {
        ++connections;
        tunnel.hang_up();
      }
      return connections >= 10;
    });
    CHECK(connections == 10);
    CHECK(static_cast<double>(sink.counts().stored) < bench.published / 4);  // what the first connection has taken
    CHECK(bench.has_error("the peer has closed it"));
    // One that lasts gets what is left.
    std::string got;
    CHECK(bench.wait_for([&] {
      (void)tunnel.accept();
      got += tunnel.received();
      return got.find("\"value\":" + std::to_string(static_cast<int>(bench.published))) != std::string::npos;
    }));
    CHECK(sink.counts().queued == 0);
    CHECK(bench.missed == 0);
  }

  TEST_CASE("tcp and udp sinks refuse settings that cannot be right, when they are made") {
    Loop loop{Loop::Manual{}};
    CHECK_THROWS_AS(TcpSink(loop, {.host = "", .port = 1}), SetupError);
    CHECK_THROWS_AS(TcpSink(loop, {.host = "a"}), SetupError);
    CHECK_THROWS_AS(TcpSink(loop, {.host = "tcp://a", .port = 1}), SetupError);
    CHECK_THROWS_AS(TcpSink(loop, {.host = "a", .port = 1, .format = "csv"}), SetupError);
    CHECK_THROWS_AS(TcpSink(loop, {.host = "a", .port = 1, .format = "xml"}), SetupError);
    CHECK_THROWS_AS(UdpSink(loop, {.host = "a b"}), SetupError);
    CHECK_THROWS_AS(UdpSink(loop, {.format = "csv"}), SetupError);
  }

  TEST_CASE("US-17 two senders of one topic to one server are a warning") {
    const auto warnings = [](const std::string& first, const std::string& second) {
      return plan_system(standard_registry(), parse_config(R"({"sensors": [
  {"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"},
  {"name": "used", "type": "host", "quantity": "memory", "rate": "10 Hz"}], "sinks": [{"name": "a", )" +
                                                               first + R"(}, {"name": "b", )" + second + "}]}",
                                                           "f.json"))
          .warnings.text();
    };
    const std::string tcp = R"("type": "tcp", "host": "10.0.0.1", "port": 7000)";
    CHECK(warnings(tcp, tcp + R"(, "topics": ["used"])")
              .find("sends to the same server: it has each event of topic \"used\" twice") != std::string::npos);
    CHECK(warnings(tcp + R"(, "topics": ["load"])", tcp + R"(, "topics": ["used"])").empty());
    CHECK(warnings(tcp, R"("type": "tcp", "host": "10.0.0.1", "port": 7001)").empty());
    CHECK(warnings(tcp, R"("type": "udp", "host": "10.0.0.1", "port": 7000)").empty());
  }

  TEST_CASE("US-32 a datagram an event: an object with the time in seconds and the fields by their topic") {
    Bench bench;
    UdpPeer peer;
    UdpSink sink(bench.loop, {.host = "127.0.0.1", .port = peer.port()});
    bench.publish(100);
    std::vector<std::string> datagrams;
    CHECK(bench.wait_for([&] {
      for (std::string one; !(one = peer.received()).empty();) datagrams.push_back(one);
      return datagrams.size() == 100;
    }));
    const auto first = nlohmann::json::parse(datagrams.at(0));
    CHECK(first.at("timestamp").is_number_float());
    CHECK(first.at("a/b").at("value") == 1);
    CHECK(first.at("a/b").at("sequence") == 1);
    CHECK(first.at("a/b").at("run").get<std::string>().size() == 36);
    CHECK(sink.counts().stored == 100);
    CHECK(sink.counts().balances());
    CHECK(bench.errors.empty());
    CHECK(bench.loop.close(1s) == 0);
  }

  TEST_CASE("US-32 datagrams follow a name to its new address within a minute or two, and the loop goes on meanwhile") {
    Bench bench;
    UdpPeer first, second;
    second.vanish();
    second.open(first.port(), INADDR_LOOPBACK + 1);
    moving_address = "127.0.0.1";
    UdpSink sink(bench.loop, {.host = "moving.invalid", .port = first.port()});
    std::size_t at_first = 0, at_second = 0;
    const auto is_all_there = [&] {
      while (!first.received().empty()) ++at_first;
      while (!second.received().empty()) ++at_second;
      return at_first + at_second == static_cast<std::size_t>(bench.published);
    };
    bench.publish(10);
    REQUIRE(bench.wait_for(is_all_there));
    moving_address = "127.0.0.2";
    for (int i = 0; i < 30; ++i) {
      bench.loop.advance(10s);
      bench.publish(1);
      REQUIRE(bench.wait_for(is_all_there));
      if (i == 2) CHECK(at_second == 0);  // it is not asked for with each
    }
    CHECK(at_second >= 20);
    CHECK(bench.errors.empty());
    CHECK(bench.missed == 0);
    // An address that there is no way to, and none at all, are no news.
    for (const char* away : {"255.255.255.256", "127.0.0.2"}) {
      moving_address = away;
      bench.loop.advance(2min);
      for (int i = 0; i < 3; ++i) bench.publish(1);
      REQUIRE(bench.wait_for(is_all_there));
    }
    CHECK(bench.errors.empty());
    CHECK(sink.counts().balances());
  }

  TEST_CASE(
      "US-32 datagrams that nobody receives are told and counted, and sending goes on; too long ones are refused") {
    Bench bench;
    UdpPeer peer;
    const std::uint16_t port = peer.port();
    peer.vanish();
    UdpSink sink(bench.loop, {.host = "127.0.0.1", .port = port, .longest = 400});
    bench.publish(10);
    bench.wait_for([] { return false; }, 20);
    CHECK(bench.has_error("no program receives it"));
    CHECK(sink.counts().dropped[static_cast<std::size_t>(DropReason::refused)] > 0);
    CHECK(sink.health() == Health::ok);
    CHECK(sink.counts().queued == 0);
    CHECK(sink.counts().balances());
    peer.open(port);
    bench.publish(10);
    std::size_t got = 0;
    CHECK(bench.wait_for([&] {
      while (!peer.received().empty()) ++got;
      return got == 10;
    }));
    const std::uint64_t before = sink.counts().stored;
    bench.loop.topic<Long>("long").publish({text<500>(std::string(450, 'x'))});
    bench.wait_for([] { return false; }, 20);
    CHECK(sink.counts().stored == before);
    CHECK(bench.has_error("a datagram at most 400"));
    CHECK(bench.missed == 0);
  }
}
