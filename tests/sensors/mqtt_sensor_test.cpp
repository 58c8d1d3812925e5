// The mqtt sensor, with the real broker (mosquitto): what comes, what cannot be used, and what becomes of the
// connection.
#ifdef RTDATA_WITH_MQTT
#include <doctest/doctest.h>
#include <mosquitto.h>

#include <algorithm>
#include <fstream>
#include <functional>
#include <set>

#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/mqtt.hpp"
#include "sinks/broker.hpp"
#include "sinks/certificates.hpp"
#include "sinks/scripted_peer.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

struct Charge {
  double level = 0;
  text<40> from = {};
  bool kept = false;
  friend constexpr auto describe(type_tag<Charge>) {
    return record("line", field("level", &Charge::level, "%"), field("from", &Charge::from),
                  field("kept", &Charge::kept));
  }
};

std::vector<LineField> charge_fields() {
  return {{.name = "level", .unit = "%"},
          {.name = "from", .type = Kind::text, .key = "$topic", .length = 40},
          {.name = "kept", .type = Kind::boolean, .key = "$retained"}};
}

/// Publishes on the test's thread, and returns once the broker has it (QoS 1 and 2).
class Publisher {
 public:
  /// `ca`: file of the certificate by which it knows the broker; empty: without TLS.
  explicit Publisher(std::uint16_t port, const std::string& ca = "") : client_(::mosquitto_new(nullptr, true, this)) {
    if (!ca.empty()) ::mosquitto_tls_set(client_, ca.c_str(), nullptr, nullptr, nullptr, nullptr);
    ::mosquitto_publish_callback_set(client_,
                                     [](mosquitto*, void* self, int) { ++static_cast<Publisher*>(self)->done_; });
    REQUIRE(::mosquitto_connect(client_, "127.0.0.1", port, 60) == MOSQ_ERR_SUCCESS);
  }
  Publisher(const Publisher&) = delete;
  Publisher& operator=(const Publisher&) = delete;
  ~Publisher() { ::mosquitto_destroy(client_); }
  void publish(const std::string& topic, const std::string& message, int qos = 1, bool retain = false) {
    ++sent_;
    REQUIRE(::mosquitto_publish(client_, nullptr, topic.c_str(), static_cast<int>(message.size()), message.data(), qos,
                                retain) == MOSQ_ERR_SUCCESS);
    for (int i = 0; i < 2000 && done_ < sent_; ++i) ::mosquitto_loop(client_, 10, 1);
    REQUIRE(done_ == sent_);
  }

 private:
  mosquitto* client_;
  int sent_ = 0, done_ = 0;
};

struct Hearing {
  Loop loop;
  std::vector<std::string> errors;
  std::vector<Charge> heard;
  Subscription subscription;

  Hearing() {
    loop.on_error([this](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error.text());
    });
    subscription = loop.subscribe<Charge>("phone", [this](const Event<Charge>& event) { heard.push_back(*event); });
  }
  MqttSensorConfig from(std::uint16_t port, MqttSensorConfig config) {
    config.broker.host = "127.0.0.1";
    config.broker.port = port;
    config.broker.keepalive = 5s;
    config.retry_first = 20ms;
    config.retry_longest = 100ms;
    if (config.fields.empty()) config.fields = charge_fields();
    return config;
  }
  bool wait_for(const std::function<bool()>& done) {
    bool is_done = false;
    Ticker look(loop, 5ms, [&](const Tick& tick) {
      is_done = done();
      if (is_done || tick.index > 12000) loop.stop();
    });
    loop.run();
    return is_done;
  }
  bool wait_for_start(const AnySensor& sensor) {
    return wait_for([&] { return is_subscribed(sensor); });
  }
  /// The gap before the first subscription has ended.
  bool is_subscribed(const AnySensor& sensor) const { return sensor.health() == Health::ok && sensor.is_running(); }
  std::string first_error() const { return errors.empty() ? "" : errors.front(); }
  bool has_error(const std::string& part) const {
    return std::any_of(errors.begin(), errors.end(),
                       [&](const std::string& one) { return one.find(part) != std::string::npos; });
  }
};

/// Publishes until the sensor has heard one: then it is subscribed.
void until_heard(Hearing& bench, Publisher& publisher, const std::string& topic) {
  const std::size_t before = bench.heard.size();
  int turn = 0;
  REQUIRE(bench.wait_for([&] {
    if (bench.heard.size() == before && ++turn % 10 == 0) publisher.publish(topic, R"({"level": -1})", 0);
    return bench.heard.size() > before;
  }));
  const std::size_t now = bench.heard.size();
  CHECK(bench.wait_for([&, quiet = 0]() mutable { return ++quiet > 10; }));
  CHECK(bench.heard.size() >= now);
  bench.heard.clear();
}

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("FW-4 messages of a broker become events, with each QoS and version") {
    NEEDS_BROKER();
    Broker broker;
    Publisher publisher(broker.port());
    for (const MqttVersion version : {MqttVersion::newest, MqttVersion::v311}) {
      for (const std::uint8_t qos : {std::uint8_t{0}, std::uint8_t{1}, std::uint8_t{2}}) {
        CAPTURE(static_cast<int>(version));
        CAPTURE(int{qos});
        Hearing bench;
        MqttSensor sensor(
            bench.loop, {.name = "phone"},
            bench.from(broker.port(),
                       {.broker = {.version = version}, .topics = {"phones/+/battery", "more/#"}, .qos = qos}));
        until_heard(bench, publisher, "more/x");
        const std::uint64_t before = sensor.counts().published;
        for (int i = 0; i < 300; ++i)
          publisher.publish(i % 2 == 0 ? "phones/anna/battery" : "more/deep/er",
                            R"({"level": )" + std::to_string(i) + R"(, "other": {"a": [1]}})", qos);
        publisher.publish("elsewhere", R"({"level": 1})", qos);
        CHECK(bench.wait_for([&] { return bench.heard.size() >= 300; }));
        REQUIRE(bench.heard.size() == 300);
        for (std::size_t i = 0; i < 300; ++i) {
          CHECK(bench.heard[i].level == static_cast<double>(i));
          CHECK(bench.heard[i].from == (i % 2 == 0 ? "phones/anna/battery" : "more/deep/er"));
          CHECK_FALSE(bench.heard[i].kept);
        }
        CHECK(sensor.health() == Health::ok);
        CHECK(sensor.counts().published == before + 300);
        CHECK_MESSAGE(bench.errors.empty(), bench.first_error());
      }
    }
  }

  TEST_CASE("FW-4 with TLS messages come, and none of a broker whose certificate is not right") {
    NEEDS_BROKER();
    NEEDS_PROGRAM(openssl);
    const Certificates& certificates = Certificates::all();
    const struct {
      const char* certificate;
      bool knows_authority;
    } cases[] = {{"right", true}, {"right", false}, {"self", true}, {"expired", true}, {"other", true}};
    for (const auto& one : cases) {
      CAPTURE(one.certificate);
      CAPTURE(one.knows_authority);
      const auto files = certificates.of(one.certificate);
      Broker broker("allow_anonymous true\ncertfile " + files[0] + "\nkeyfile " + files[1] + "\n");
      Hearing bench;
      const std::string ca = certificates / "ca.pem";
      const bool is_right = std::string(one.certificate) == "right" && one.knows_authority;
      // Before the sensor, since libmosquitto's first use of TLS is not for two threads at once.
      std::optional<Publisher> publisher;
      if (is_right) publisher.emplace(broker.port(), ca);
      MqttSensor sensor(
          bench.loop, {.name = "phone"},
          bench.from(broker.port(),
                     {.broker = {.tls = TlsConfig{.ca_file = one.knows_authority ? ca : ""}}, .topics = {"a/#"}}));
      if (!is_right) {
        CHECK(bench.wait_for([&] { return sensor.health() == Health::faulted && !bench.errors.empty(); }));
        CHECK(bench.has_error("certificate"));
        CHECK(sensor.counts().published == 0);
        continue;
      }
      until_heard(bench, *publisher, "a/b");
      for (int i = 0; i < 50; ++i) publisher->publish("a/b", R"({"level": )" + std::to_string(i) + "}");
      CHECK(bench.wait_for([&] { return bench.heard.size() >= 50; }));
      CHECK(bench.heard.size() == 50);
      CHECK(bench.errors.empty());
    }
  }

  TEST_CASE("FW-5 messages that cannot be used are counted and told, and cost no other one anything") {
    NEEDS_BROKER();
    Broker broker;
    Publisher publisher(broker.port());
    Hearing bench;
    MqttSensor sensor(bench.loop, {.name = "phone"},
                      bench.from(broker.port(), {.topics = {"a/#"}, .max_message = 100}));
    until_heard(bench, publisher, "a/b");
    const SensorCounts before = sensor.counts();
    const std::vector<std::string> garbage{"",
                                           "garbage",
                                           "{",
                                           "[1]",
                                           R"({"level": "high"})",
                                           R"({"battery": 1})",
                                           R"({"level": 1e999})",
                                           R"({"level": 1, "level": 2})",
                                           std::string("\xff\x00\xfe", 3),
                                           std::string(101, 'x'),
                                           R"({"level": 3, "x": ")" + std::string(100, 'y') + R"("})"};
    for (const std::string& one : garbage) {
      publisher.publish("a/b", one);
      publisher.publish("a/c", R"({"level": 7})");
    }
    CHECK(bench.wait_for([&] { return bench.heard.size() == garbage.size(); }));
    CHECK(sensor.counts().unreadable - before.unreadable == garbage.size());
    CHECK(sensor.counts().received - before.received == 2 * garbage.size());
    CHECK(!bench.errors.empty());  // alike ones are joined
    CHECK(bench.has_error("cannot use a message: a/b"));
    CHECK(sensor.health() == Health::ok);
  }

  TEST_CASE("numbers alone are messages, too") {
    NEEDS_BROKER();
    Broker broker;
    Publisher publisher(broker.port());
    Hearing bench;
    MqttSensor sensor(bench.loop, {.name = "phone"},
                      bench.from(broker.port(), {.topics = {"a/#"}, .format = LineFormat::csv}));
    int turn = 0;
    CHECK(bench.wait_for([&] {
      if (++turn % 10 == 0) publisher.publish("a/b", "21.5\n");
      return bench.heard.size() >= 2;
    }));
    CHECK(bench.heard.at(0).level == 21.5);
    CHECK(bench.heard.at(1).from == "a/b");
    CHECK_MESSAGE(bench.errors.empty(), bench.first_error());
  }

  TEST_CASE("FW-4 messages that are not meant are left out and counted") {
    NEEDS_BROKER();
    Broker broker;
    Publisher publisher(broker.port());
    Hearing bench;
    MqttSensor sensor(bench.loop, {.name = "phone"},
                      bench.from(broker.port(), {.topics = {"a/#"},
                                                 .only = LineMatch{.key = "kind", .is = {"battery"}},
                                                 .unreadable_if = LineMatch{.key = "error", .begins = "E"}}));
    int turn = 0;
    CHECK(bench.wait_for([&] {
      if (++turn % 10 == 0) {
        publisher.publish("a/b", R"({"kind": "position", "level": 1})");
        publisher.publish("a/b", R"({"kind": "battery", "level": 2})");
        publisher.publish("a/b", R"({"kind": "battery", "level": 3, "error": "E7"})");
      }
      return bench.heard.size() >= 2 && sensor.counts().filtered >= 2 && sensor.counts().unreadable >= 2;
    }));
    for (const auto& one : bench.heard) CHECK(one.level == 2);
    CHECK(bench.has_error("unreadable_if"));
    CHECK(sensor.counts().balances());
  }

  TEST_CASE("retained messages make no event, or are told apart when they are asked for") {
    NEEDS_BROKER();
    Broker broker;
    Publisher publisher(broker.port());
    publisher.publish("a/old", R"({"level": 5})", 1, true);
    for (const MqttVersion version : {MqttVersion::newest, MqttVersion::v311}) {
      {
        Hearing bench;
        MqttSensor sensor(bench.loop, {.name = "phone"},
                          bench.from(broker.port(), {.broker = {.version = version}, .topics = {"a/#"}}));
        until_heard(bench, publisher, "a/new");
        CHECK(sensor.counts().repeated == (version == MqttVersion::v311 ? 1 : 0));
        CHECK(sensor.counts().received == sensor.counts().published + sensor.counts().repeated);
      }
      Hearing bench;
      MqttSensor sensor(
          bench.loop, {.name = "phone"},
          bench.from(broker.port(),
                     {.broker = {.version = version}, .topics = {"a/#"}, .retained = MqttRetained::take}));
      CHECK(bench.wait_for([&] { return !bench.heard.empty(); }));
      REQUIRE(!bench.heard.empty());
      CHECK(bench.heard[0].kept);
      CHECK(bench.heard[0].level == 5);
    }
  }

  TEST_CASE("NFR-1 a broker that is absent, killed and started again: a gap each time, and it goes on") {
    NEEDS_BROKER();
    Broker broker;
    broker.kill();
    Hearing bench;
    MqttSensor sensor(bench.loop, {.name = "phone"}, bench.from(broker.port(), {.topics = {"a/#"}}));
    CHECK(bench.wait_for([&] { return sensor.health() == Health::faulted; }));
    CHECK(bench.has_error("cannot connect"));
    for (int round = 0; round < 2; ++round) {
      CAPTURE(round);
      broker.start();
      Publisher publisher(broker.port());
      until_heard(bench, publisher, "a/b");
      CHECK(sensor.health() == Health::ok);
      broker.kill();
      CHECK(bench.wait_for([&] { return sensor.health() == Health::faulted; }));
    }
    sensor.stop();
    CHECK_FALSE(sensor.is_running());
    CHECK(bench.loop.close(1s) == 0);
  }

  TEST_CASE("a broker that refuses subscriptions makes the sensor faulted when it is all of them, else degraded") {
    NEEDS_BROKER();
    const char* plugin = "/usr/lib/x86_64-linux-gnu/mosquitto_dynamic_security.so";
    if (::access(plugin, R_OK) != 0) {
      MESSAGE("skipped: mosquitto's dynamic security is not there");
      return;
    }
    const Directory directory;
    const std::string file = directory / "security.json";
    std::ofstream(file) << R"({"defaultACLAccess": {"publishClientSend": true, "publishClientReceive": true,
      "subscribe": false, "unsubscribe": true}, "clients": [], "groups": [{"groupname": "all", "roles": [{"rolename": "r"}]}],
      "roles": [{"rolename": "r", "acls": [{"acltype": "subscribePattern", "topic": "open/#", "priority": 1, "allow": true}]}],
      "anonymousGroup": "all"})";
    Broker broker("allow_anonymous true\nplugin " + std::string(plugin) + "\nplugin_opt_config_file " + file + "\n");
    for (const MqttVersion version : {MqttVersion::newest, MqttVersion::v311}) {
      CAPTURE(static_cast<int>(version));
      Publisher publisher(broker.port());
      {
        Hearing bench;
        MqttSensor sensor(bench.loop, {.name = "phone"},
                          bench.from(broker.port(), {.broker = {.version = version}, .topics = {"closed/#"}}));
        CHECK(bench.wait_for([&] { return sensor.health() == Health::faulted; }));
        CHECK(bench.has_error("the broker refuses a subscription"));
        CHECK(bench.has_error(version == MqttVersion::newest ? "closed/# (Not authorized)" : "closed/#"));
      }
      Hearing bench;
      MqttSensor sensor(bench.loop, {.name = "phone"},
                        bench.from(broker.port(), {.broker = {.version = version}, .topics = {"closed/#", "open/#"}}));
      until_heard(bench, publisher, "open/x");
      CHECK(sensor.health() == Health::degraded);
    }
  }

  TEST_CASE("NFR-1 a server that accepts and says nothing, or garbage, is given up, and closing ends at once") {
    for (const bool is_garbage : {false, true}) {
      FakeGpsd peer;
      Hearing bench;
      MqttSensorConfig config = bench.from(peer.port(), {.topics = {"a/#"}});
      config.broker.connect_timeout = 100ms;
      MqttSensor sensor(bench.loop, {.name = "phone"}, config);
      CHECK(bench.wait_for([&] {
        peer.accept();
        if (is_garbage && peer.has_peer()) peer.send("HTTP/1.1 400 Bad Request\r\n\r\n");
        return sensor.health() == Health::faulted;
      }));
      CHECK(bench.has_error("cannot connect"));
      CHECK(bench.loop.close(1s) == 0);
    }
  }

  TEST_CASE("NFR-1 what a killed program had not stored comes again: the broker hears of it once it is stored") {
    NEEDS_BROKER();
    Broker broker("allow_anonymous true\nmax_queued_messages 0\n");
    Publisher publisher(broker.port());
    const Directory directory;
    const MqttSensorConfig config{
        .broker = {.client_id = "collector"}, .topics = {"$share/all/a/#"}, .session = 1h, .stored_by = "store"};
    std::set<double> stored;
    {
      // As killed: nothing of what came is stored, and no answer written.
      Hearing bench;
      SqliteSink store(bench.loop, {.path = directory / "first.db", .sink = {.name = "store", .batch_time = 1h}});
      MqttSensor sensor(bench.loop, {.name = "phone"}, bench.from(broker.port(), config));
      until_heard(bench, publisher, "a/b");
      for (int i = 0; i < 50; ++i) publisher.publish("a/b", R"({"level": )" + std::to_string(i) + "}");
      CHECK(bench.wait_for([&, turns = 0]() mutable { return ++turns > 20; }));
      CHECK(bench.heard.empty());  // it reads no further while the first one is not stored
      sensor.stop();
    }
    Hearing bench;
    SqliteSink store(bench.loop, {.path = directory / "second.db", .sink = {.name = "store", .batch_time = 10ms}});
    MqttSensor sensor(bench.loop, {.name = "phone"}, bench.from(broker.port(), config));
    CHECK(bench.wait_for([&] { return bench.heard.size() >= 50; }));
    for (const Charge& one : bench.heard) stored.insert(one.level);
    CHECK(stored.size() == 50);
    CHECK(bench.wait_for([&] { return store.counts().queued == 0; }));
    publisher.publish("a/b", R"({"level": 99})");
    CHECK(bench.wait_for([&] { return bench.heard.back().level == 99; }));
    CHECK_MESSAGE(bench.errors.empty(), bench.first_error());
    sensor.close();
    CHECK(bench.loop.close(2s) == 0);
  }

  TEST_CASE("the broker hears of no message before the sink has stored it") {
    NEEDS_BROKER();
    Broker broker("allow_anonymous true\nmax_queued_messages 0\nlog_type all\n");
    Publisher publisher(broker.port());
    const Directory directory;
    const auto said = [&](const char* what) {
      const std::string log = broker.log();
      std::size_t count = 0;
      for (std::size_t at = 0; (at = log.find(what, at)) != std::string::npos; ++at) ++count;
      return count;
    };
    Hearing bench;
    SqliteSink store(bench.loop, {.path = directory / "run.db", .sink = {.name = "store", .batch_time = 1h}});
    MqttSensor sensor(
        bench.loop, {.name = "phone"},
        bench.from(broker.port(),
                   {.broker = {.client_id = "collector"}, .topics = {"a/#"}, .session = 1h, .stored_by = "store"}));
    REQUIRE(bench.wait_for([&] { return said("Sending SUBACK to collector") == 1; }));
    std::size_t sent = 0;
    // One alone, which finds an idle connection, then several at once, which wait behind it.
    for (const std::size_t count : {std::size_t{1}, std::size_t{5}}) {
      for (std::size_t i = 0; i < count; ++i) publisher.publish("a/b", R"({"level": )" + std::to_string(++sent) + "}");
      REQUIRE(bench.wait_for([&] { return said("Sending PUBLISH to collector") == sent; }));
      CHECK(bench.wait_for([&, turns = 0]() mutable { return ++turns > 20; }));
      CHECK(said("Received PUBACK from collector") == 0);
    }
    CHECK(bench.wait_for([&] {
      store.flush();
      return said("Received PUBACK from collector") == sent;
    }));
    CHECK(store.counts().stored == sent);
    sensor.close();
    CHECK(bench.loop.close(2s) == 0);
  }

  TEST_CASE("two sensors of one group share the messages") {
    NEEDS_BROKER();
    Broker broker;
    Publisher publisher(broker.port());
    Hearing one, other;
    MqttSensor first(one.loop, {.name = "phone"}, one.from(broker.port(), {.topics = {"$share/all/a/#"}}));
    MqttSensor second(other.loop, {.name = "phone"}, other.from(broker.port(), {.topics = {"$share/all/a/#"}}));
    CHECK(one.wait_for([&, turns = 0]() mutable { return ++turns > 40; }));
    CHECK(other.wait_for([&, turns = 0]() mutable { return ++turns > 40; }));
    for (int i = 0; i < 100; ++i) publisher.publish("a/b", R"({"level": )" + std::to_string(i) + "}");
    CHECK(one.wait_for([&, turns = 0]() mutable { return ++turns > 40; }));
    CHECK(other.wait_for([&] { return one.heard.size() + other.heard.size() == 100; }));
    CHECK(!one.heard.empty());
    CHECK(!other.heard.empty());
  }

  TEST_CASE("mqtt sensors refuse settings that cannot be right, when they are made") {
    Loop loop;
    const auto why = [&](MqttSensorConfig config) {
      try {
        if (config.fields.empty()) config.fields = charge_fields();
        MqttSensor sensor(loop, {.name = "s"}, config);
        return std::string();
      } catch (const SetupError& error) {
        return std::string(error.what());
      }
    };
    const auto has = [](const std::string& text, const char* part) { return text.find(part) != std::string::npos; };
    CHECK(why({.topics = {"a/#"}, .start = false}).empty());
    CHECK(has(why({.topics = {}}), "there are no topics"));
    for (const char* bad : {"", "a/#/b", "a#", "a+/b", "$share", "$share/g", "$share//a", "$share/g/", "$share/+/a"})
      CHECK_MESSAGE(!why({.topics = {bad}, .start = false}).empty(), bad);
    CHECK(has(why({.broker = {.host = "mqtt://x"}, .topics = {"a"}}), "URL"));
    CHECK(has(why({.topics = {"a"}, .qos = 3}), "0, 1 or 2"));
    CHECK(has(why({.topics = {"a"}, .session = 1h}), "client_id"));
    CHECK(has(why({.topics = {"a"}, .qos = 2, .stored_by = "x"}), "qos"));
    CHECK(has(why({.topics = {"a"}, .stored_by = "x"}), "there is no sink x"));
    CHECK(has(why({.topics = {"a"}, .fields = {{.name = "t", .key = "$topic"}}}), "text"));
    CHECK(has(why({.topics = {"a"}, .fields = {{.name = "t", .key = "$retained"}}}), "bool"));
    CHECK(has(why({.broker = {.tls = TlsConfig{.key = "k"}}, .topics = {"a"}}), "key"));
  }
}
#endif
