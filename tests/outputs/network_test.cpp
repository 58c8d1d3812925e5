// Outputs over the network: a real server of HTTP and a real broker of MQTT, which come and go.
#include <doctest/doctest.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <thread>
#include <vector>

#include "app/process.hpp"
#include "outputs/output_log.hpp"
#include "paths.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/outputs/guard.hpp"
#ifdef RTDATA_WITH_HTTP
#include "rtdata/outputs/http.hpp"
#include "sinks/http_bench.hpp"
#endif
#ifdef RTDATA_WITH_MQTT
#include <mosquitto.h>

#include "rtdata/outputs/mqtt.hpp"
#include "sinks/broker.hpp"
#endif

using namespace rtdata;
using namespace std::chrono_literals;
using outputs_test::OutputLog;
using Lines = std::vector<std::string>;

namespace {

Lines problems_of(const std::string& output) {
  Lines lines;
  for (const Problem& problem :
       plan_system(standard_registry(), parse_config(R"({"outputs": [)" + output + "]}", "f.json")).problems)
    lines.push_back(problem.text());
  return lines;
}
[[maybe_unused]] bool is_refused(const std::string& output, const std::string& why) {
  const Lines problems = problems_of(output);
  const bool is_so = problems.size() == 1 && problems[0].find(why) != std::string::npos;
  for (const std::string& problem : problems)
    if (!is_so) MESSAGE(problem);
  return is_so;
}

}  // namespace

#ifdef RTDATA_WITH_HTTP
namespace {

Lines requests_of(const sinks::HttpServer& server) {
  Lines lines;
  for (const auto& request : server.requests())
    lines.push_back(request["method"].get<std::string>() + " " + request["path"].get<std::string>() + " " +
                    request["body"].get<std::string>());
  return lines;
}

}  // namespace

TEST_SUITE("outputs") {
  TEST_CASE("US-35 what is at a URL is set by requests, with words for its values") {
    if (!sinks::is_program(sinks::python)) return;
    const sinks::HttpServer server;
    {
      HttpActuator relay({.server = {.url = server.url("/relay?turn={value}")},
                          .method = HttpMethod::get,
                          .words = {{"0", "off"}, {"1", "on"}}});
      CHECK(relay.open(0).has_value());
      CHECK(relay.set(1).has_value());
    }
    HttpActuator dimmer({.server = {.url = server.url("/dim"), .bearer = "token of mine"},
                         .method = HttpMethod::put,
                         .text = "{\"level\": {value}}",
                         .content_type = "application/json"});
    CHECK(dimmer.open({}).has_value());  // as it is: nothing is sent
    CHECK(dimmer.set(0.25).has_value());
    CHECK(requests_of(server) == Lines{"GET /relay?turn=off ", "GET /relay?turn=on ", "PUT /dim {\"level\": 0.25}"});
    const auto headers = server.requests().back()["headers"];
    CHECK(headers["Authorization"] == "Bearer token of mine");
    CHECK(headers["Content-Type"] == "application/json");
  }

  TEST_CASE("US-35 what a server answers to a value, or that it does not, is why it was not set") {
    if (!sinks::is_program(sinks::python)) return;
    sinks::HttpServer server;
    HttpActuator relay({.server = {.url = server.url("/relay"), .bearer = "secret-token"}, .timeout = 300ms});
    const auto error_in = [&](const std::string& mode) {
      server.become(mode);
      const auto done = relay.set(1);
      return done ? Error{} : done.error();
    };
    Error error = error_in("status 404 -- no relay secret-token");
    CHECK(error.code == Errc::not_found);
    CHECK(error.why == "the server answers 404 Not Found: no relay (secret)");
    CHECK(error_in("status 307 Location:http://127.0.0.1:1/").why.find("307") != std::string::npos);
    CHECK(error_in("status 503").code == Errc::busy);
    error = error_in("hang");
    CHECK(error.code == Errc::disconnected);
    CHECK(error.why == "it did not answer within 300 ms");
    CHECK(error_in("drip").code == Errc::disconnected);
    CHECK(error_in("garbage").code != Errc::ok);
    CHECK(error_in("endless").why.find("1 MiB") != std::string::npos);
    server.kill();
    error = error_in("ok");
    CHECK(error.code == Errc::disconnected);
    CHECK(error.why == "Connection refused");
    server.start();
    CHECK(relay.set(1).has_value());
  }

  TEST_CASE("US-35 an output over HTTP begins without its server, and is safe as soon as that is there") {
    if (!sinks::is_program(sinks::python)) return;
    sinks::HttpServer server;
    const std::string url = server.url("/relay");
    server.kill();
    Loop loop{Loop::Manual{}};
    OutputLog log(loop, "relay");
    {
      Output relay(loop, {.name = "relay", .lease = 500ms},
                   [&] { return std::make_unique<HttpActuator>(HttpActuatorConfig{.server = {.url = url}}); });
      loop.advance(1ms);
      CHECK(log.lines == Lines{"start 0 failed: Connection refused"});
      CHECK(relay.health() == Health::faulted);
      CHECK(relay.set(1).error().code == Errc::io_failed);
      loop.advance(1ms);
      CHECK(log.lines.back() == "set 1 failed: the device has failed");
      log.lines.clear();
      loop.advance(1s);
      CHECK(sinks::wait_for(loop, [&] { return !log.lines.empty(); }));
      CHECK(log.lines.front() == "failure 0 failed: Connection refused");
      server.start();
      loop.advance(1s);
      CHECK(sinks::wait_for(loop, [&] { return relay.value() == 0.0; }));
      CHECK(log.lines.back() == "failure 0 done");
      CHECK(relay.health() == Health::ok);
      log.lines.clear();
      CHECK(relay.set(1, "somebody").has_value());
      CHECK(sinks::wait_for(loop, [&] { return relay.value() == 1.0; }));
      loop.advance(500ms);  // the lease
      CHECK(sinks::wait_for(loop, [&] { return relay.value() == 0.0; }));
      CHECK(log.lines == Lines{"set 1 done", "lease 0 done"});
      CHECK(relay.set(1).has_value());
      CHECK(sinks::wait_for(loop, [&] { return relay.value() == 1.0; }));
    }
    CHECK(requests_of(server) == Lines{"POST /relay 0", "POST /relay 1", "POST /relay 0", "POST /relay 1",
                                       "POST /relay 0"});  // the last: its end
  }

  TEST_CASE("US-35 an output over HTTP whose server says no does not begin") {
    if (!sinks::is_program(sinks::python)) return;
    sinks::HttpServer server;
    server.become("status 401");
    Loop loop{Loop::Manual{}};
    const auto make = [&] {
      return std::make_unique<HttpActuator>(HttpActuatorConfig{.server = {.url = server.url("/relay")}});
    };
    CHECK_THROWS_WITH_AS(Output(loop, {.name = "relay"}, make), doctest::Contains("401 Unauthorized"), SetupError);
  }

  TEST_CASE("US-35 check finds the mistakes of outputs over HTTP") {
    const std::string http = R"({"name": "r", "type": "http", )";
    CHECK(problems_of(http + R"("url": "http://x/{value}", "method": "get"})").empty());
    CHECK(is_refused(http + R"("url": "ftp://x/{value}", "method": "get"})", "the scheme is ftp"));
    CHECK(is_refused(http + R"("url": "http://x/", "method": "get"})", "every value would send the same request"));
    CHECK(is_refused(http + R"("url": "http://x/", "text": "on"})", "every value would send the same request"));
    CHECK(is_refused(http + R"("url": "http://x/", "words": {"1.0": "on"}})", "it is written 1"));
    CHECK(is_refused(http + R"("url": "http://x/", "words": {"one": "on"}})", "\"one\" is not a value"));
    CHECK(is_refused(http + R"("url": "http://x/{value}", "words": {"1": "turn on"}})",
                     "a URL contains only ASCII letters"));
    CHECK(is_refused(http + R"("url": "http://x/", "timeout": "2 s"})", "timeout"));
    CHECK(is_refused(R"({"name": "r", "type": "http"})", "url"));

    // Two outputs that send the same requests set one device. No path is shown: it may hold a secret.
    const auto two = [&](const std::string& one, const std::string& other) {
      std::string told;
      for (const std::string& line : problems_of(R"({"name": "a", "type": "http", )" + one +
                                                 R"(}, {"name": "b", "type": "http", )" + other + "}"))
        told += line + "\n";
      return told;
    };
    const std::string told = two(R"("url": "http://x/secret-path")",
                                 R"("url": "http://x/secret-path", "timeout": "500 ms")");
    CHECK(told.find("has the server http://x already; two outputs with the same requests") != std::string::npos);
    CHECK(told.find("secret-path") == std::string::npos);
    CHECK(two(R"("url": "http://x/a")", R"("url": "http://x/b")").empty());
    CHECK(two(R"("url": "http://x/a", "text": "1={value}")", R"("url": "http://x/a", "text": "2={value}")").empty());
    const std::string get = R"("method": "get", "url": "http://x/{value}")";
    CHECK_FALSE(two(get, get + R"(, "text": "other {value}")").empty());
  }
}
#endif

#ifdef RTDATA_WITH_MQTT
namespace {

using namespace sinks;

/// Reads everything that the broker publishes, as "topic message".
class Reader {
 public:
  explicit Reader(std::uint16_t port) : client_(::mosquitto_new(nullptr, true, this)) {
    ::mosquitto_message_callback_set(client_, [](mosquitto*, void* self, const mosquitto_message* message) {
      static_cast<Reader*>(self)->lines.push_back(
          std::string(message->topic) + " " +
          std::string(static_cast<const char*>(message->payload), static_cast<std::size_t>(message->payloadlen)) +
          (message->retain ? " kept" : ""));
    });
    ::mosquitto_subscribe_callback_set(client_, [](mosquitto*, void* self, int, int, const int*) {
      static_cast<Reader*>(self)->is_subscribed_ = true;
    });
    REQUIRE(::mosquitto_connect(client_, "127.0.0.1", port, 60) == MOSQ_ERR_SUCCESS);
    for (int i = 0; i < 50; ++i) ::mosquitto_loop(client_, 10, 1);
    ::mosquitto_subscribe(client_, nullptr, "#", 2);
    for (int i = 0; i < 6000 && !is_subscribed_; ++i) ::mosquitto_loop(client_, 10, 1);
    REQUIRE(is_subscribed_);
  }
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;
  ~Reader() { ::mosquitto_destroy(client_); }
  /// Waits until there are so many; a little longer, so that more would be seen.
  const Lines& read(std::size_t count) {
    const auto limit = std::chrono::steady_clock::now() + 30s;
    while (lines.size() < count && std::chrono::steady_clock::now() < limit) ::mosquitto_loop(client_, 10, 1);
    for (int i = 0; i < 10; ++i) ::mosquitto_loop(client_, 10, 1);
    return lines;
  }
  Lines lines;

 private:
  mosquitto* client_;
  bool is_subscribed_ = false;
};

/// Of the program that runs in this folder.
bool kill_guard_in(const std::string& folder) {
  for (const auto& process : std::filesystem::directory_iterator("/proc")) {
    std::error_code failed;
    if (std::filesystem::read_symlink(process.path() / "cwd", failed) != folder || failed) continue;
    std::string name;
    std::getline(std::ifstream(process.path() / "comm"), name);
    if (name == "rtdata-guard") return ::kill(std::stoi(process.path().filename()), SIGKILL) == 0;
  }
  return false;
}

MqttActuatorConfig config_of(const Broker& broker) {
  return {
      .broker = {.host = "127.0.0.1", .port = broker.port()}, .to = "pump/set", .words = {{"0", "OFF"}, {"1", "ON"}}};
}

}  // namespace

TEST_SUITE("outputs") {
  TEST_CASE("US-35 what listens to a broker of MQTT is set by messages, whatever their quality") {
    NEEDS_BROKER();
    const Broker broker;
    Reader reader(broker.port());
    for (const std::uint8_t qos : {std::uint8_t{0}, std::uint8_t{1}, std::uint8_t{2}}) {
      for (const MqttVersion version : {MqttVersion::v5, MqttVersion::v311}) {
        reader.lines.clear();
        MqttActuatorConfig config = config_of(broker);
        config.qos = qos;
        config.broker.version = version;
        {
          MqttActuator pump(config);
          CHECK(pump.open(0).has_value());
          CHECK(pump.set(1).has_value());
          CHECK(pump.set(0.5).has_value());
        }
        CHECK(reader.read(3) == Lines{"pump/set OFF", "pump/set ON", "pump/set 0.5"});  // no will: it said goodbye
      }
    }
    reader.lines.clear();
    MqttActuatorConfig config = config_of(broker);
    config.retain = true;
    MqttActuator kept(config);
    CHECK(kept.open({}).has_value());
    CHECK(kept.set(1).has_value());
    CHECK(reader.read(1) == Lines{"pump/set ON"});
    CHECK(Reader(broker.port()).read(1) == Lines{"pump/set ON kept"});
  }

  TEST_CASE("US-35 a broker that is not there, does not answer, or refuses is why a value was not set") {
    NEEDS_BROKER();
    Broker broker;
    MqttActuatorConfig config = config_of(broker);
    config.timeout = 500ms;
    MqttActuator pump(config);
    CHECK(pump.open(0).has_value());
    broker.signal(SIGSTOP);
    CHECK(pump.set(1).error().why == "the broker did not confirm the message within 500 ms");
    broker.kill();
    const Error error = pump.set(1).error();
    CHECK(error.code == Errc::disconnected);
    CHECK(error.why.find("connection") != std::string::npos);
    const Error away = MqttActuator(config).open(0).error();
    CHECK(away.code == Errc::disconnected);
    CHECK(away.why == "there is no connection to the broker: Connection refused");
    const Broker closed("allow_anonymous false\n");
    const Error refused = MqttActuator(config_of(closed)).open(0).error();
    CHECK(refused.code == Errc::not_permitted);
    CHECK(refused.why == "Not authorized");
    // A broker that refuses the message says so with MQTT 5.
    Broker strict;
    strict.kill();
    strict.write("acl", "topic read #\n");
    const Broker limited("allow_anonymous true\nacl_file " + strict.write("acl", "topic read #\n") + "\n");
    const Error message = MqttActuator(config_of(limited)).open(0).error();
    CHECK(message.code == Errc::not_permitted);
    CHECK(message.why.find("the broker refuses the message") != std::string::npos);
  }

  TEST_CASE("US-35 an output over MQTT begins without its broker, and finds it again") {
    NEEDS_BROKER();
    Broker broker;
    broker.kill();
    Loop loop{Loop::Manual{}};
    OutputLog log(loop, "pump");
    Output pump(loop, {.name = "pump"}, [&] { return std::make_unique<MqttActuator>(config_of(broker)); });
    loop.advance(1ms);
    CHECK(log.lines == Lines{"start 0 failed: there is no connection to the broker: Connection refused"});
    CHECK(pump.health() == Health::faulted);
    broker.start();
    Reader reader(broker.port());
    loop.advance(1s);
    CHECK(wait_for(loop, [&] { return pump.value() == 0.0; }));
    CHECK(pump.health() == Health::ok);
    CHECK(log.lines.back() == "failure 0 done");
    CHECK(pump.set(1).has_value());
    CHECK(wait_for(loop, [&] { return pump.value() == 1.0; }));
    pump.close();
    CHECK(reader.read(3) == Lines{"pump/set OFF", "pump/set ON", "pump/set OFF"});
  }

  TEST_CASE("US-35 a connection to a broker that was lost after a value is told, and the safe value is set again") {
    NEEDS_BROKER();
    Broker broker;
    OutputGuard guard([&](const std::string&) { return std::make_unique<MqttActuator>(config_of(broker)); });
    Runtime runtime({.guard = &guard});
    Loop loop(runtime, {});
    runtime.on_log([](const LogRecord&) {});
    OutputLog log(loop, "pump");
    Output pump(loop, {.name = "pump", .watchdog = 1h}, {}, "pump");  // the loop stands while a broker is started
    const auto turn_until = [&](const std::function<bool()>& condition) {
      for (int i = 0; i < 6000 && !condition(); ++i) loop.run_for(10ms);
      return condition();
    };
    pump.set(1).or_throw();
    CHECK(turn_until([&] { return pump.value() == 1.0; }));
    broker.kill();
    CHECK(turn_until([&] { return log.lines.size() >= 3; }));
    CHECK(log.lines[2].starts_with("failure 0 failed: the connection was lost"));
    CHECK(log.lines[2].ends_with("; the broker may have published the safe value"));
    CHECK(pump.health() == Health::faulted);
    broker.start();
    Reader reader(broker.port());
    CHECK(turn_until([&] { return pump.value() == 0.0; }));
    CHECK(pump.health() == Health::ok);
    pump.set(1).or_throw();
    CHECK(turn_until([&] { return pump.value() == 1.0; }));
    for (int i = 0; i < 100 && (reader.lines.empty() || reader.lines.back() != "pump/set ON"); ++i) reader.read(0);
    CHECK(reader.lines.back() == "pump/set ON");
    pump.close();
  }

  TEST_CASE("US-35 US-17 rtdata run: the broker has the safe value, also when program and guard are killed at once") {
    NEEDS_BROKER();
    const Broker broker;
    for (const bool is_alone : {false, true}) {
      CAPTURE(is_alone);
      Reader reader(broker.port());
      const test::Folder folder;
      folder.write("f.json", R"({"sensors": [{"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"}],
        "outputs": [{"name": "pump", "type": "mqtt", "host": "127.0.0.1", "port": )" +
                                 std::to_string(broker.port()) +
                                 R"(, "to": "pump/set", "on": "load", "expression": "minutes_1 >= 0"}]})");
      test::Process run(folder, test::built("rtdata"), {"run", "f.json"});
      CHECK(reader.read(2) == Lines{"pump/set 0", "pump/set 1"});
      if (is_alone) {
        run.signal(SIGSTOP);  // so that it does not notice
        CHECK(kill_guard_in(folder.path()));
      }
      run.signal(SIGKILL);
      CHECK(reader.read(3) == Lines{"pump/set 0", "pump/set 1", "pump/set 0"});
    }
  }

  TEST_CASE("US-35 check finds the mistakes of outputs over MQTT") {
    const std::string mqtt = R"({"name": "p", "type": "mqtt", )";
    CHECK(problems_of(mqtt + R"("to": "pump/set"})").empty());
    CHECK(is_refused(mqtt + R"("qos": 1})", "to"));
    CHECK(is_refused(mqtt + R"("to": "pump/#"})", "cannot contain + or #"));
    CHECK(is_refused(mqtt + R"("to": "pump", "text": "ON"})", "every value would send the same message"));
    CHECK(is_refused(mqtt + R"("to": "pump", "qos": 3})", "qos"));
    CHECK(is_refused(mqtt + R"("to": "pump", "words": {"01": "ON"}})", "it is written 1"));
    const Lines keyless = problems_of(mqtt + R"("to": "pump", "tls": {"key": "/no/such/key"}})");
    CHECK(std::any_of(keyless.begin(), keyless.end(), [](const std::string& line) {
      return line.find("a key needs its certificate") != std::string::npos;
    }));
    CHECK(is_refused(mqtt + R"("to": "pump"}, {"name": "q", "type": "mqtt", "to": "pump"})", "MQTT topic"));
  }
}
#endif
