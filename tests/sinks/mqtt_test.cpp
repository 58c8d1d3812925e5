// The mqtt sender, with the real broker (mosquitto) and what it refuses, and what becomes of it.
#ifdef RTDATA_WITH_MQTT
#include <arpa/inet.h>
#include <doctest/doctest.h>
#include <mosquitto.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <thread>

#include "rtdata/data/codec.hpp"
#include "rtdata/loop/ledger.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sinks/mqtt.hpp"
#include "sensors/fake_gpsd.hpp"
#include "sinks/broker.hpp"
#include "sinks/certificates.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

/// Hears all that the broker publishes, on the test's thread.
class Listener {
 public:
  explicit Listener(std::uint16_t port, const char* user = nullptr, const char* name = nullptr)
      : client_(::mosquitto_new(name, true, this)) {
    ::mosquitto_message_callback_set(client_, [](mosquitto*, void* self, const mosquitto_message* message) {
      static_cast<Listener*>(self)->messages.emplace_back(
          message->topic, std::string(static_cast<const char*>(message->payload), message->payloadlen));
    });
    ::mosquitto_subscribe_callback_set(client_, [](mosquitto*, void* self, int, int, const int*) {
      static_cast<Listener*>(self)->is_subscribed_ = true;
    });
    if (user != nullptr) ::mosquitto_username_pw_set(client_, user, user);
    REQUIRE(::mosquitto_connect(client_, "127.0.0.1", port, 60) == MOSQ_ERR_SUCCESS);
    for (int i = 0; i < 50; ++i) ::mosquitto_loop(client_, 10, 1);
    ::mosquitto_subscribe(client_, nullptr, "#", 2);
    for (int i = 0; i < 1000 && !is_subscribed_; ++i) ::mosquitto_loop(client_, 10, 1);
    REQUIRE(is_subscribed_);
  }
  Listener(const Listener&) = delete;
  Listener& operator=(const Listener&) = delete;
  ~Listener() { ::mosquitto_destroy(client_); }
  void hear() {
    for (int i = 0; i < 50; ++i) ::mosquitto_loop(client_, 0, 1);
  }
  std::vector<std::pair<std::string, std::string>> messages;

 private:
  mosquitto* client_;
  bool is_subscribed_ = false;
};

struct Bench {
  Loop loop;
  std::vector<std::string> errors;
  double published = 0;

  Bench() {
    loop.on_error([this](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error.text());  // of a loaded machine
    });
  }
  MqttConfig to(std::uint16_t port, MqttConfig config = {}) {
    config.broker.host = "127.0.0.1";
    config.broker.port = port;
    config.sink.batch_time = 10ms;
    config.sink.retry_first = 50ms;
    config.sink.retry_longest = 200ms;
    return config;
  }
  void publish(int count, const char* topic = "a/b") {
    for (int i = 0; i < count; ++i) loop.topic<Number>(topic).publish({++published});
  }
  template <class Done>
  bool wait_for(Done&& done) {
    bool is_done = false;
    Ticker look(loop, 10ms, [&](const Tick& tick) {
      is_done = done();
      if (is_done || tick.index > 6000) loop.stop();
    });
    loop.run();
    return is_done;
  }
  bool has_error(const std::string& part) const {
    return std::any_of(errors.begin(), errors.end(),
                       [&](const std::string& one) { return one.find(part) != std::string::npos; });
  }
};

struct Words {
  text<1000> words;
  RTDATA_FIELDS(Words, (words))
};

double value_of(const std::string& message) {
  auto codec = make_json_codec();
  return decode<Number>(*codec, std::as_bytes(std::span(message))).or_throw().data.value;
}

constexpr auto refused = static_cast<std::size_t>(DropReason::refused);

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("US-32 a message an event goes to an MQTT broker, with each QoS and version") {
    NEEDS_BROKER();
    Broker broker;
    for (const MqttVersion version : {MqttVersion::newest, MqttVersion::v311}) {
      for (const std::uint8_t qos : {std::uint8_t{0}, std::uint8_t{1}, std::uint8_t{2}}) {
        CAPTURE(static_cast<int>(version));
        CAPTURE(int{qos});
        Bench bench;
        Listener listener(broker.port());
        MqttSink sink(bench.loop,
                      bench.to(broker.port(), {.broker = {.version = version}, .topic = "plant/{topic}", .qos = qos}));
        bench.publish(500);
        CHECK(bench.wait_for([&] { return listener.hear(), listener.messages.size() >= 500; }));
        REQUIRE(listener.messages.size() == 500);
        std::set<double> values;
        for (const auto& [topic, message] : listener.messages) {
          CHECK(topic == "plant/a/b");
          values.insert(value_of(message));
        }
        CHECK(values.size() == 500);
        CHECK(bench.wait_for([&] { return sink.counts().queued == 0; }));
        CHECK(sink.counts().stored == 500);
        CHECK(sink.counts().balances());
        CHECK_FALSE(bench.has_error("connect"));
        CHECK(bench.loop.close(2s) == 0);
      }
    }
  }

  TEST_CASE("US-32 a broker that throws away what nobody is subscribed to: that is told, dropped and counted") {
    NEEDS_BROKER();
    Broker broker;
    Bench bench;
    {
      MqttSink sink(bench.loop, bench.to(broker.port(), {.topic = "plant/{topic}", .qos = 1}));
      bench.publish(20);
      constexpr auto refused = static_cast<std::size_t>(DropReason::refused);
      CHECK(bench.wait_for([&] { return sink.counts().dropped[refused] == 20; }));
      CHECK(sink.counts().stored == 0);
      CHECK(sink.counts().balances());
      CHECK(bench.has_error("there was no subscriber"));
      CHECK(bench.loop.runtime().has_loss());
      CHECK(bench.loop.close(2s) == 0);
    }
    {
      Bench kept;  // by the broker, for those who come later
      MqttSink sink(kept.loop, kept.to(broker.port(), {.topic = "plant/{topic}", .qos = 1, .retain = true}));
      kept.publish(20);
      CHECK(kept.wait_for([&] { return sink.counts().stored == 20; }));
      CHECK(kept.loop.close(2s) == 0);
    }
  }

  TEST_CASE("US-32 an event that nobody is subscribed to waits for a subscriber, when that is asked for") {
    NEEDS_BROKER();
    Broker broker;
    Bench bench;
    MqttSink sink(bench.loop,
                  bench.to(broker.port(), {.topic = "plant/{topic}", .qos = 1, .wait_for_subscriber = true}));
    bench.publish(20);
    CHECK(bench.wait_for([&] { return bench.has_error("there is no subscriber"); }));
    CHECK(sink.counts().stored == 0);
    Listener listener(broker.port());
    CHECK(bench.wait_for([&] { return sink.counts().stored == 20; }));
    CHECK(bench.wait_for([&] {
      listener.hear();
      return listener.messages.size() >= 20;
    }));
    CHECK(bench.loop.close(2s) == 0);
    CHECK_THROWS_AS(MqttSink(bench.loop, {.qos = 0, .wait_for_subscriber = true}), SetupError);
    CHECK_THROWS_AS(MqttSink(bench.loop, {.qos = 2, .wait_for_subscriber = true}), SetupError);
    CHECK_THROWS_AS(MqttSink(bench.loop, {.broker = {.version = MqttVersion::v311}, .wait_for_subscriber = true}),
                    SetupError);
  }

  TEST_CASE("US-32 a broker gets the final account as the last message, when it is asked for") {
    NEEDS_BROKER();
    Broker broker;
    Bench bench;
    Listener listener(broker.port());
    MqttConfig config = bench.to(broker.port(), {.topic = "plant/{topic}"});
    config.sink.topics = {"#", account_topic};
    MqttSink sink(bench.loop, config);
    Feed<Number> feed(bench.loop, {.name = "chamber", .topic = "a/b"});
    for (int i = 1; i <= 5; ++i) feed.publish({static_cast<double>(i)});
    CHECK(bench.wait_for([&] { return listener.hear(), listener.messages.size() == 5; }));
    feed.publish({6});
    CHECK(bench.loop.close(5s) == 0);
    for (int i = 0; i < 6000 && listener.messages.size() < 7; ++i) {
      listener.hear();
      std::this_thread::sleep_for(10ms);  // the broker is another program
    }
    REQUIRE(listener.messages.size() == 7);
    CHECK(listener.messages.back().first == std::string("plant/") + account_topic);
    const auto account = nlohmann::json::parse(listener.messages.back().second);
    CHECK(account["data"]["name"] == "chamber");
    CHECK(account["data"]["published"] == 6);
  }

  TEST_CASE("US-32 a broker that is absent, killed and started again gets everything: nothing is lost") {
    NEEDS_BROKER();
    Broker broker;
    broker.kill();
    Bench bench;
    MqttSink sink(bench.loop, bench.to(broker.port()));
    bench.publish(300);
    CHECK(bench.wait_for([&] { return sink.health() == Health::faulted; }));
    CHECK(sink.counts().queued == 300);
    std::set<double> values;
    std::uint64_t ticks = 0, missed = 0;
    Ticker ticker(bench.loop, 50ms, [&](const Tick& tick) { ++ticks, missed += tick.missed; });
    for (int round = 0; round < 3; ++round) {
      broker.start();
      Listener listener(broker.port());
      bench.publish(300);
      const std::uint64_t wanted = sink.counts().stored + (round < 2 ? 150U : 0U);
      CHECK(bench.wait_for([&] {
        listener.hear();
        return round < 2 ? sink.counts().stored > wanted : sink.counts().queued == 0;
      }));
      // The sender is idle here: what it has given to the broker, the listener hears before that is killed.
      for (int quiet = 0; quiet < 200; ++quiet) {
        listener.hear();
        if (!listener.messages.empty()) quiet = 0;
        for (const auto& [topic, message] : listener.messages) values.insert(value_of(message));
        listener.messages.clear();
        std::this_thread::sleep_for(5ms);  // the broker is another program
      }
      CHECK(values.size() >= sink.counts().stored);
      if (round < 2) broker.kill();
    }
    CHECK(sink.counts().stored == 1200);
    CHECK(sink.counts().balances());
    CHECK(sink.health() == Health::ok);
    CHECK(bench.loop.close(2s) == 0);
    CHECK(values.size() == 1200);
  }

  TEST_CASE("what the broker's access control does not permit is kept, told, and sent once it is permitted") {
    NEEDS_BROKER();
    Directory directory;
    std::ofstream(directory / "acl") << "topic read #\ntopic write good\n";
    Broker broker("allow_anonymous true\nacl_file " + (directory / "acl") + "\n");
    for (const std::uint8_t qos : {std::uint8_t{1}, std::uint8_t{2}}) {
      CAPTURE(int{qos});
      Bench bench;
      std::ofstream(directory / "acl") << "topic read #\ntopic write good\n";
      broker.kill();
      broker.start();
      Listener listener(broker.port());
      MqttSink sink(bench.loop, bench.to(broker.port(), {.qos = qos}));
      bench.publish(5, "good");
      bench.publish(3, "bad");
      CHECK(bench.wait_for([&] { return sink.health() == Health::faulted; }));
      CHECK(sink.status().reason.find("the broker refuses the event") != std::string::npos);
      CHECK(sink.status().reason.find("ot authorized") != std::string::npos);
      // However often it is tried: nothing is thrown away, and what the broker has is not sent again.
      for (int turn = 0; turn < 60; ++turn) CHECK(bench.wait_for([&] { return listener.hear(), true; }));
      CHECK(sink.counts().queued == 8);
      CHECK(sink.counts().all_dropped() == 0);
      CHECK(listener.messages.size() == 5);
      std::ofstream(directory / "acl") << "topic read #\ntopic write good\ntopic write bad\n";
      broker.signal(SIGHUP);  // it reads the file again
      CHECK(bench.wait_for([&] { return listener.hear(), listener.messages.size() >= 8; }));
      CHECK(bench.wait_for([&] { return sink.counts().queued == 0; }));
      CHECK(sink.counts().stored == 8);
      CHECK(listener.messages.size() == 8);
      CHECK(sink.health() == Health::ok);
      CHECK(sink.counts().balances());
      CHECK(bench.loop.close(2s) == 0);
    }
  }

  TEST_CASE("US-32 of MQTT 3.1.1 an event that is too large for the broker is found and refused, the others arrive") {
    NEEDS_BROKER();
    Broker broker("allow_anonymous true\nmax_packet_size 600\n");
    for (const MqttVersion version : {MqttVersion::newest, MqttVersion::v311}) {
      CAPTURE(static_cast<int>(version));
      Bench bench;
      Listener listener(broker.port());
      MqttSink sink(bench.loop, bench.to(broker.port(), {.broker = {.version = version}}));
      bench.publish(20);
      bench.loop.topic<Words>("words").publish({"short"});
      bench.loop.topic<Words>("words").publish({std::string(900, 'x')});
      bench.loop.topic<Words>("words").publish({"short, too"});
      bench.publish(20);
      CHECK(bench.wait_for([&] { return listener.hear(), sink.counts().queued == 0; }));
      CHECK(sink.counts().stored == 42);
      CHECK(sink.counts().dropped[refused] == 1);
      // What was on its way when the broker ended a connection comes a second time.
      std::set<std::pair<std::string, std::string>> once;
      CHECK(bench.wait_for([&] {
        listener.hear();
        once.insert(listener.messages.begin(), listener.messages.end());
        return once.size() >= 42;
      }));
      CHECK(once.size() == 42);
      CHECK(bench.has_error(version == MqttVersion::v311 ? "is larger than the broker's packet limit"
                                                         : "size of the event"));
      CHECK(bench.wait_for([&] { return sink.health() == Health::ok; }));
      CHECK(sink.counts().balances());
      CHECK(bench.loop.close(2s) == 0);
    }
  }

  TEST_CASE("of MQTT 3.1.1 a broker that goes away again and again costs no event") {
    NEEDS_BROKER();
    Broker broker;
    broker.kill();
    Bench bench;
    MqttSink sink(bench.loop, bench.to(broker.port(), {.broker = {.version = MqttVersion::v311}}));
    bench.publish(200);
    for (int round = 0; round < 6; ++round) {
      broker.start();
      const MonotonicTime begin = bench.loop.now();
      CHECK(bench.wait_for([&] { return bench.loop.now() - begin > 100ms * round; }));
      bench.publish(20);
      broker.kill();
    }
    broker.start();
    CHECK(bench.wait_for([&] { return sink.counts().queued == 0; }));
    CHECK(sink.counts().stored == 320);
    CHECK(sink.counts().all_dropped() == 0);
    CHECK(sink.counts().balances());
    CHECK(bench.loop.close(2s) == 0);
  }

  TEST_CASE("a broker that refuses the password keeps the sink faulted, and costs no event") {
    NEEDS_BROKER();
    Broker broker("allow_anonymous false\n");
    Bench bench;
    MqttSink sink(bench.loop, bench.to(broker.port(), {.broker = {.user = "me", .password = "wrong-password"}}));
    bench.publish(10);
    CHECK(bench.wait_for([&] { return sink.health() == Health::faulted && bench.errors.size() >= 1; }));
    CHECK_MESSAGE(bench.has_error("the broker refuses the connection"), bench.errors.front());
    CHECK_FALSE(bench.has_error("wrong-password"));
    CHECK(sink.counts().queued == 10);
    CHECK(bench.loop.close(100ms) == 10);
  }

  TEST_CASE("US-32 a broker that refuses the client's name keeps the sink faulted; with another name all arrives") {
    NEEDS_BROKER();
    Broker broker("allow_anonymous true\nclientid_prefixes node-\n");
    Listener listener(broker.port(), nullptr, "node-listener");
    for (const MqttVersion version : {MqttVersion::newest, MqttVersion::v311}) {
      CAPTURE(static_cast<int>(version));
      Bench bench;
      MqttSink refused(bench.loop, bench.to(broker.port(), {.broker = {.version = version, .client_id = "phone-1"}}));
      bench.publish(10);
      CHECK(bench.wait_for([&] { return refused.health() == Health::faulted && !bench.errors.empty(); }));
      CHECK_MESSAGE(bench.has_error("the broker refuses the connection"), bench.errors.front());
      CHECK(bench.has_error("`client_id`"));
      CHECK(refused.counts().queued == 10);
      refused.close();
      listener.messages.clear();
      MqttSink taken(bench.loop, bench.to(broker.port(), {.broker = {.version = version, .client_id = "node-1"}}));
      bench.publish(10);
      CHECK(bench.wait_for([&] { return taken.counts().stored == 10; }));
      CHECK(bench.wait_for([&] {
        listener.hear();
        return listener.messages.size() == 10;
      }));
      CHECK(bench.loop.close(1s) == 0);
    }
  }

  TEST_CASE("US-32 two senders with one client's name throw each other out, and nothing is lost") {
    NEEDS_BROKER();
    Broker broker;
    Listener listener(broker.port());
    Bench bench;
    MqttConfig one = bench.to(broker.port(), {.broker = {.client_id = "node"}}), two = one;
    one.topic = "one";
    two.topic = "two";
    one.sink.name = "one";
    two.sink.name = "two";
    MqttSink first(bench.loop, one), second(bench.loop, two);
    for (int round = 0; round < 5; ++round) {
      bench.publish(20);
      bench.loop.run_for(100ms);
    }
    CHECK(bench.wait_for([&] { return first.counts().stored == 100 && second.counts().stored == 100; }));
    CHECK(broker.log().find("already connected") != std::string::npos);
    std::map<std::string, std::set<std::uint64_t>> arrived;
    CHECK(bench.wait_for([&] {
      listener.hear();
      for (const auto& [topic, payload] : std::exchange(listener.messages, {}))
        arrived[topic].insert(nlohmann::json::parse(payload)["sequence"].get<std::uint64_t>());
      return arrived["one"].size() == 100 && arrived["two"].size() == 100;
    }));
    CHECK(bench.loop.close(1s) == 0);
  }

  TEST_CASE("NFR-1 a server that accepts and says nothing, or garbage, is given up, and closing ends in time") {
    for (const std::string& says :
         {std::string(), std::string("HTTP/1.1 400 Bad Request\r\n\r\n"), std::string(5000, '\xff')}) {
      CAPTURE(says.substr(0, 8));
      Bench bench;
      FakeGpsd server;
      MqttConfig config = bench.to(server.port());
      config.sending.timeout = 300ms;
      config.sink.close_deadline = 100ms;
      MqttSink sink(bench.loop, config);
      bench.publish(10);
      CHECK(bench.wait_for([&] {
        if (server.accept() && !says.empty()) server.send(says);
        return sink.health() == Health::faulted;
      }));
      CHECK(sink.counts().queued == 10);
      CHECK(sink.counts().balances());
      CHECK(bench.loop.close(1s) == 10);
    }
  }

  TEST_CASE("a broker that knows MQTT 3.1.1 only is spoken to in that") {
    Bench bench;
    FakeGpsd server;
    MqttSink sink(bench.loop, bench.to(server.port(), {.qos = 0}));
    bench.publish(3);
    std::string got;
    std::vector<int> versions;
    CHECK(bench.wait_for([&] {
      if (server.accept()) got.clear();
      if (!server.has_peer()) return false;
      got += server.received();
      if (got.size() > 8 && got[0] == 0x10) {  // CONNECT: protocol name, level
        versions.push_back(got[8]);
        got.clear();
        server.send(versions.back() == 5 ? std::string("\x20\x02\x00\x01", 4) : std::string("\x20\x02\x00\x00", 4));
      }
      return sink.counts().queued == 0;
    }));
    CHECK(versions == std::vector<int>{5, 4});
    CHECK(sink.counts().stored == 3);
    CHECK_FALSE(bench.has_error("connect"));
    CHECK(bench.loop.close(1s) == 0);
  }

  TEST_CASE("the last will is published when the sender vanishes, and not when it closes") {
    NEEDS_BROKER();
    Broker broker;
    Listener listener(broker.port());
    Bench bench;
    MqttSink sink(bench.loop, bench.to(broker.port(), {.will = MqttWill{.topic = "state/node", .message = "gone"}}));
    bench.publish(1);
    CHECK(bench.wait_for([&] { return listener.hear(), listener.messages.size() == 1; }));
    CHECK(bench.loop.close(1s) == 0);
    for (int i = 0; i < 20; ++i) listener.hear(), std::this_thread::sleep_for(5ms);  // another program
    CHECK(listener.messages.size() == 1);
  }

  TEST_CASE("US-32 with TLS events arrive, and not at a broker whose certificate nobody vouches for") {
    NEEDS_BROKER();
    Directory directory;
    const std::string make = "cd " + directory.path +
                             " && openssl req -x509 -newkey rsa:2048 -nodes -keyout key.pem -out cert.pem -days 2"
                             " -subj /CN=127.0.0.1 -addext subjectAltName=IP:127.0.0.1 >/dev/null 2>&1";
    if (std::system(make.c_str()) != 0) {
      MESSAGE("skipped: there is no openssl");
      return;
    }
    Broker broker("allow_anonymous true\ncertfile " + (directory / "cert.pem") + "\nkeyfile " +
                  (directory / "key.pem") + "\n");
    for (const bool is_trusted : {true, false}) {
      CAPTURE(is_trusted);
      Bench bench;
      MqttSink sink(
          bench.loop,
          bench.to(broker.port(), {.broker = {.tls = TlsConfig{.ca_file = is_trusted ? directory / "cert.pem" : ""}},
                                   .retain = true}));
      bench.publish(200);
      CHECK(
          bench.wait_for([&] { return is_trusted ? sink.counts().stored == 200 : sink.health() == Health::faulted; }));
      CHECK(sink.counts().stored == (is_trusted ? 200U : 0U));
      CHECK(bench.has_error("connect") != is_trusted);
      if (!is_trusted) CHECK(bench.has_error("certificate verify failed"));
      CHECK(bench.loop.close(200ms) == (is_trusted ? 0U : 200U));
    }
  }

  TEST_CASE("US-32 with TLS it is told which check of the broker's certificate failed, and what to do") {
    NEEDS_BROKER();
    NEEDS_PROGRAM(openssl);
    const Certificates& certificates = Certificates::all();
    const struct {
      const char* certificate;
      bool knows_authority;
      const char *why, *advice;
    } cases[] = {
        {"expired", true, "certificate has expired", "renew the server's certificate"},
        {"self", true, "self-signed certificate", "the server's self-signed certificate"},
        {"right", false, "unable to get local issuer certificate", "the certificate of the authority that signed"},
        {"other", true, "hostname mismatch", "use the name of the server's certificate in `host`"}};
    for (const auto& one : cases) {
      CAPTURE(one.certificate);
      const auto files = certificates.of(one.certificate);
      Broker broker("allow_anonymous true\ncertfile " + files[0] + "\nkeyfile " + files[1] + "\n");
      Bench bench;
      MqttSink sink(
          bench.loop,
          bench.to(broker.port(),
                   {.broker = {.tls = TlsConfig{.ca_file = one.knows_authority ? certificates / "ca.pem" : ""}}}));
      bench.publish(3);
      CHECK(bench.wait_for([&] { return sink.health() == Health::faulted && !bench.errors.empty(); }));
      REQUIRE_FALSE(bench.errors.empty());
      CHECK(bench.has_error("certificate verify failed"));
      CHECK_MESSAGE(bench.has_error(one.why), bench.errors.front());
      CHECK_MESSAGE(bench.has_error(one.advice), bench.errors.front());
      CHECK(sink.counts().queued == 3);
    }
  }

  TEST_CASE("US-32 TLS at a port that speaks none, and none at one of TLS: each is told") {
    NEEDS_BROKER();
    NEEDS_PROGRAM(openssl);
    const auto files = Certificates::all().of("right");
    for (const bool is_encrypted : {true, false}) {
      CAPTURE(is_encrypted);
      const std::string more = is_encrypted ? "certfile " + files[0] + "\nkeyfile " + files[1] + "\n" : "";
      Broker broker("allow_anonymous true\n" + more);
      MqttConfig config;
      if (!is_encrypted) config.broker.tls = TlsConfig{};
      Bench bench;
      MqttSink sink(bench.loop, bench.to(broker.port(), config));
      bench.publish(3);
      CHECK(bench.wait_for([&] { return sink.health() == Health::faulted && !bench.errors.empty(); }));
      REQUIRE_FALSE(bench.errors.empty());
      CHECK_MESSAGE(bench.has_error(is_encrypted ? "if the broker speaks TLS at this port, set `tls`"
                                                 : "check that the broker speaks TLS at this port"),
                    bench.errors.front());
      CHECK(sink.counts().queued == 3);
    }
  }

  TEST_CASE("US-32 with TLS this machine proves who it is where the broker asks for it, with a password on its key") {
    NEEDS_BROKER();
    NEEDS_PROGRAM(openssl);
    const Certificates& certificates = Certificates::all();
    const auto files = certificates.of("right");
    Broker broker("allow_anonymous true\nrequire_certificate true\ncafile " + certificates / "ca.pem" + "\ncertfile " +
                  files[0] + "\nkeyfile " + files[1] + "\n");
    const TlsConfig right{.ca_file = certificates / "ca.pem",
                          .certificate = certificates / "client.pem",
                          .key = certificates / "locked.key",
                          .key_password = "key-s3cret"};
    TlsConfig wrong = right, nobody{.ca_file = right.ca_file};
    wrong.key_password = "another";
    for (const auto& one : {std::pair{right, true}, std::pair{wrong, false}, std::pair{nobody, false}}) {
      const TlsConfig& tls = one.first;
      const bool is_good = one.second;
      INFO("certificate " << tls.certificate << ", password " << tls.key_password);
      Bench bench;
      MqttSink sink(bench.loop,
                    bench.to(broker.port(), {.broker = {.tls = tls}, .retain = true}));  // there is no subscriber
      bench.publish(20);
      CHECK(bench.wait_for([&] { return is_good ? sink.counts().stored == 20 : sink.health() == Health::faulted; }));
      CHECK(sink.counts().stored == (is_good ? 20U : 0U));
      CHECK(sink.counts().balances());
      CHECK_FALSE(bench.has_error("s3cret"));
      CHECK(bench.loop.close(200ms) == (is_good ? 0U : 20U));
    }
  }

  TEST_CASE("with TLS and `verify` false anybody is believed, which is what it says") {
    NEEDS_BROKER();
    NEEDS_PROGRAM(openssl);
    const auto files = Certificates::all().of("self");
    Broker broker("allow_anonymous true\ncertfile " + files[0] + "\nkeyfile " + files[1] + "\n");
    for (const char* host : {"127.0.0.1", "localhost"}) {  // the certificate is for the former
      CAPTURE(host);
      Bench bench;
      MqttConfig config = bench.to(broker.port(), {.broker = {.tls = TlsConfig{.verify = false}}, .retain = true});
      config.broker.host = host;
      MqttSink sink(bench.loop, config);
      bench.publish(20);
      CHECK(bench.wait_for([&] { return sink.counts().stored == 20; }));
      CHECK(bench.errors.empty());
    }
  }

  TEST_CASE("mqtt sinks refuse settings that cannot be right, when they are made") {
    Loop loop{Loop::Manual{}};
    CHECK_THROWS_AS(MqttSink(loop, {.broker = {.host = ""}}), SetupError);
    CHECK_THROWS_AS(MqttSink(loop, {.topic = ""}), SetupError);
    CHECK_THROWS_AS(MqttSink(loop, {.topic = "a/#"}), SetupError);
    CHECK_THROWS_AS(MqttSink(loop, {.format = "csv"}), SetupError);
    CHECK_THROWS_AS(MqttSink(loop, {.qos = 3}), SetupError);
    CHECK_THROWS_AS(MqttSink(loop, {.broker = {.tls = TlsConfig{.certificate = "x"}}}), SetupError);
    CHECK_THROWS_AS(MqttSink(loop, {.will = MqttWill{.topic = "+"}}), SetupError);
  }
}
#endif
