// The tcp sink with TLS: a real server with certificates of every kind, and peers that break off or dawdle.
#ifdef RTDATA_WITH_OPENSSL
#include <doctest/doctest.h>
#include <poll.h>
#include <uv.h>

#include <algorithm>
#include <optional>
#include <set>
#include <sstream>

#include "app/process.hpp"
#include "paths.hpp"
#include "rtdata/config/registry.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sinks/tcp.hpp"
#include "sensors/fake_gpsd.hpp"
#include "sinks/certificates.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

const std::string python = "/usr/bin/python3";

class TlsServer {
 public:
  TlsServer(const std::string& certificate, bool acknowledges, const std::string& authority = "")
      : words_{rtdata::test::in_source("tests/sinks/tls_server.py"), folder_.path(),
               Certificates::all() / (certificate + ".pem"), Certificates::all() / (certificate + ".key"),
               acknowledges ? "yes" : "no"} {
    if (!authority.empty()) words_.push_back(authority);
    start();
  }
  void start() {
    process_.emplace(folder_, python, words_);
    REQUIRE_MESSAGE(process_->wait_for("listening"), process_->err);
  }
  void kill() { process_.reset(); }
  std::uint16_t port() const { return static_cast<std::uint16_t>(std::stoi(folder_.read("port"))); }
  bool has_heard_goodbye() const { return folder_.read("goodbye") == "yes"; }
  /// The values of the events that came, in order; a line that is cut off by the end of a connection is left out.
  std::vector<double> values() const {
    std::vector<double> all;
    std::istringstream lines(folder_.read("received"));
    auto codec = make_json_codec();
    for (std::string line; std::getline(lines, line);) {
      const auto event = decode<Number>(*codec, std::as_bytes(std::span(line)));
      if (event) all.push_back(event->data.value);
    }
    return all;
  }

 private:
  rtdata::test::Folder folder_;
  std::vector<std::string> words_;
  std::optional<rtdata::test::Process> process_;
};

/// In virtual time, of which hardly any passes while a server of another process is waited for.
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
    for (int i = 0; i < count; ++i) loop.topic<Number>("a").publish({++published});
    loop.advance(200ms);
  }
  template <class Done>
  bool wait_for(Done&& done, Duration step = 1ms) {
    const auto limit = std::chrono::steady_clock::now() + 30s;
    while (!done()) {
      if (std::chrono::steady_clock::now() > limit) return false;
      pollfd ready{uv_backend_fd(loop.uv()), POLLIN, 0};
      ::poll(&ready, 1, 2);
      loop.advance(step);
    }
    return true;
  }
  bool has_error(const std::string& part) const {
    return std::any_of(errors.begin(), errors.end(),
                       [&](const std::string& one) { return one.find(part) != std::string::npos; });
  }
};

TcpConfig to(std::uint16_t port, TlsConfig tls, TcpConfig config = {}) {
  config.host = "127.0.0.1";
  config.port = port;
  config.tls = std::move(tls);
  config.sink.retry_longest = 1s;
  return config;
}

std::vector<double> up_to(int count) {
  std::vector<double> values;
  for (int i = 1; i <= count; ++i) values.push_back(i);
  return values;
}

}  // namespace

TEST_SUITE_BEGIN("sinks");

TEST_CASE("US-32 tcp with TLS: the server's certificate is checked, and what is wrong with it is said") {
  NEEDS_PROGRAM(python);
  NEEDS_PROGRAM(openssl);
  const Certificates& certificates = Certificates::all();
  const struct {
    const char* certificate;
    bool knows_authority;
    const char* reason;
  } cases[] = {{"right", true, ""},
               {"right", false, "tls.ca_file"},
               {"self", true, "tls.ca_file"},
               {"expired", true, "renew the server's certificate"},
               {"other", true, "use the name of the server's certificate"}};
  for (const auto& one : cases) {
    CAPTURE(one.certificate);
    CAPTURE(one.knows_authority);
    TlsServer server(one.certificate, true);
    Bench bench;
    TlsConfig tls;
    if (one.knows_authority) tls.ca_file = certificates / "ca.pem";
    TcpSink sink(bench.loop, to(server.port(), tls, {.acknowledge = Acknowledge::line}));
    bench.publish(10);
    const bool is_right = std::string(one.reason).empty();
    CHECK(bench.wait_for([&] { return is_right ? sink.counts().stored == 10 : sink.health() == Health::faulted; }));
    CHECK(server.values().size() == (is_right ? 10 : 0));
    CHECK(sink.counts().queued == (is_right ? 0 : 10));
    CHECK(sink.counts().balances());
    if (!is_right) CHECK_MESSAGE(sink.status().reason.find(one.reason) != std::string::npos, sink.status().reason);
    CHECK(bench.loop.close(2s) == (is_right ? 0 : 10));
    CHECK(bench.missed == 0);
    if (is_right) continue;
    Bench trusting;
    TcpSink unsafe(trusting.loop, to(server.port(), {.verify = false}, {.acknowledge = Acknowledge::line}));
    trusting.publish(3);
    CHECK(trusting.wait_for([&] { return unsafe.counts().stored == 3; }));
  }
}

TEST_CASE("US-32 tcp with TLS: a name is checked as an address is") {
  NEEDS_PROGRAM(python);
  NEEDS_PROGRAM(openssl);
  TlsServer server("right", true);
  Bench bench;
  TcpConfig config = to(server.port(), {.ca_file = Certificates::all() / "ca.pem"}, {.acknowledge = Acknowledge::line});
  config.host = "localhost";
  TcpSink sink(bench.loop, config);
  bench.publish(5);
  CHECK(bench.wait_for([&] { return sink.counts().stored == 5; }));
}

TEST_CASE("US-32 tcp with TLS: this machine proves who it is where the server asks for it") {
  NEEDS_PROGRAM(python);
  NEEDS_PROGRAM(openssl);
  const Certificates& certificates = Certificates::all();
  for (const Acknowledge how : {Acknowledge::line, Acknowledge::none}) {
    CAPTURE(static_cast<int>(how));
    TlsServer server("right", how == Acknowledge::line, certificates / "ca.pem");
    TlsConfig tls{.ca_file = certificates / "ca.pem"};
    {
      Bench bench;  // without a certificate: of TLS 1.3 the server says so after the handshake, and nothing may be lost
      TcpSink sink(bench.loop, to(server.port(), tls, {.acknowledge = how}));
      bench.publish(1);
      CHECK(bench.wait_for([&] { return sink.health() == Health::faulted; }));
      CHECK_MESSAGE(sink.status().reason.find("certificate") != std::string::npos, sink.status().reason);
      CHECK(sink.counts().queued == 1);
      CHECK(server.values().empty());
    }
    tls.certificate = certificates / "client.pem";
    for (const char* key : {"client.key", "locked.key"}) {
      tls.key = certificates / key;
      tls.key_password = std::string(key) == "locked.key" ? "key-s3cret" : "";
      Bench bench;
      TcpSink sink(bench.loop, to(server.port(), tls, {.acknowledge = how}));
      bench.publish(4);
      CHECK_MESSAGE(bench.wait_for([&] { return sink.counts().stored == 4; }), sink.status().reason);
    }
    CHECK(Bench{}.wait_for([&] { return server.values().size() == 8; }));
    tls.key_password = "wrong-s3cret";
    Bench bench;
    TcpSink sink(bench.loop, to(server.port(), tls, {.acknowledge = how}));
    bench.publish(1);
    CHECK(bench.wait_for([&] { return sink.health() == Health::faulted; }));
    CHECK(bench.has_error("tls.key_password"));
    CHECK_FALSE(bench.has_error("s3cret"));
  }
}

TEST_CASE("US-32 tcp with TLS: all arrives in order, over a server that is killed and started again, and a goodbye") {
  NEEDS_PROGRAM(python);
  NEEDS_PROGRAM(openssl);
  TlsServer server("right", true);
  Bench bench;
  TcpSink sink(bench.loop, to(server.port(), {.ca_file = Certificates::all() / "ca.pem"},
                              {.acknowledge = Acknowledge::line, .sending = {.parcel_rows = 500}}));
  bench.publish(5000);
  CHECK(bench.wait_for([&] { return sink.counts().stored >= 1000; }));
  server.kill();
  CHECK(bench.wait_for([&] { return sink.health() == Health::faulted || sink.counts().queued == 0; }));
  bench.publish(3000);
  server.start();
  CHECK(bench.wait_for([&] { return sink.counts().stored == 8000; }));
  CHECK(sink.counts().balances());
  const std::vector<double> values = server.values();
  const std::set<double> once(values.begin(), values.end());
  CHECK(std::vector<double>(once.begin(), once.end()) == up_to(8000));
  // In order within each connection: what comes a second time begins anew.
  CHECK(std::adjacent_find(values.begin(), values.end(), [](double a, double b) { return b > a + 1; }) == values.end());
  CHECK(bench.loop.close(2s) == 0);
  CHECK(Bench{}.wait_for([&] { return server.has_heard_goodbye(); }));
  CHECK(bench.missed == 0);
}

TEST_CASE(
    "NFR-1 tcp with TLS: a peer that breaks off in the handshake, or takes its time, costs no tick and no event") {
  for (const char* how : {"closes", "byte", "silent", "garbage"}) {
    CAPTURE(how);
    Bench bench;
    FakeGpsd peer;
    TcpSink sink(bench.loop, to(peer.port(), {}, {.connect_timeout = 5s}));
    bench.publish(20);
    const std::string kind = how;
    int connections = 0;
    MonotonicTime last_byte{};
    const std::string hello("\x16\x03\x03\x00\x7a\x02\x00\x00\x76\x03\x03", 11);
    std::size_t sent = 0;
    const auto serve = [&] {
      if (peer.accept()) {
        ++connections;
        sent = 0;
        if (kind == "garbage") peer.send("HTTP/1.1 400 Bad Request\r\n\r\n");
      }
      if (!peer.has_peer()) return;
      (void)peer.received();
      if (kind == "closes") peer.hang_up();
      if (kind == "byte" && bench.loop.now() - last_byte >= 1s && sent < hello.size()) {
        last_byte = bench.loop.now();
        peer.send(hello.substr(sent++, 1));
      }
    };
    CHECK(bench.wait_for([&] { return serve(), connections >= 3; }, 10ms));
    CHECK(bench.wait_for([&] { return sink.health() == Health::faulted; }, 10ms));
    CHECK(bench.has_error(kind == "closes"    ? "during the TLS handshake"
                          : kind == "garbage" ? "check that the server speaks TLS at this port"
                                              : "the TLS handshake took longer than 5 s"));
    CHECK(sink.counts().queued == 20);
    CHECK(sink.counts().stored == 0);
    const MonotonicTime begin = bench.loop.now();
    CHECK(bench.loop.close(2s) == 20);
    CHECK(bench.loop.now() - begin <= 3s);
    CHECK(bench.missed == 0);
  }
}

TEST_CASE("tcp with TLS: settings that cannot be right are refused when the sink is made") {
  NEEDS_PROGRAM(openssl);
  Loop loop{Loop::Manual{}};
  const auto make = [&](TlsConfig tls) { TcpSink(loop, to(9, std::move(tls))); };
  CHECK_THROWS_WITH_AS(make({.ca_file = "/nowhere/ca.pem"}), doctest::Contains("cannot read the file"), SetupError);
  CHECK_THROWS_WITH_AS(make({.certificate = Certificates::all() / "client.pem"}), doctest::Contains("private key"),
                       SetupError);
}

TEST_SUITE_END();
#endif
