// Peers that say anything: whatever they send, the program does not end, and tells nobody of an event that it has
// delivered which the peer never had. `RTDATA_TEST_SEEDS="1000 100"` tries a hundred others than each time.
#include <doctest/doctest.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdlib>
#include <functional>
#include <mutex>
#include <random>
#include <sstream>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "rtdata/loop/topic.hpp"
#include "rtdata/sensors/gps.hpp"
#include "sensors/fake_gpsd.hpp"
#include "sinks/answered_senders.hpp"
#ifdef RTDATA_WITH_HTTP
#include "rtdata/sinks/http.hpp"
#endif
#ifdef RTDATA_WITH_MODBUS
#include "rtdata/io/modbus.hpp"
#endif
#ifdef RTDATA_WITH_MQTT
#include <mosquitto.h>

#include "net/mqtt_packet.hpp"
#include "rtdata/outputs/mqtt.hpp"
#include "rtdata/sensors/mqtt.hpp"
#include "rtdata/sinks/mqtt.hpp"
#endif
#ifdef RTDATA_WITH_POSTGRESQL
#include "rtdata/postgresql/sink.hpp"
#endif

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;
using namespace std::string_literals;

namespace {

using Random = std::minstd_rand;

std::vector<unsigned> seeds_of_peers() {
  unsigned first = 1, count = 6;
  if (const char* const text = std::getenv("RTDATA_TEST_SEEDS")) std::istringstream(text) >> first >> count;
  std::vector<unsigned> seeds;
  for (unsigned i = 0; i < count; ++i) seeds.push_back(first + i);
  return seeds;
}

unsigned below(Random& random, std::size_t limit) {
  return static_cast<unsigned>(random() >> 4) % static_cast<unsigned>(limit);
}

std::string garbage_of(Random& random, std::size_t most) {
  std::string bytes(1 + below(random, most), '\0');
  for (char& c : bytes) c = static_cast<char>(below(random, 256));
  return bytes;
}

/// What a peer says in place of `answer`; from `first_mutable` on its bytes may change.
std::string mutated(std::string answer, std::size_t first_mutable, Random& random) {
  switch (below(random, 5)) {
    case 0:
      return garbage_of(random, 40);
    case 1:
      return answer.substr(0, below(random, answer.size()));
    case 2:
      return answer + garbage_of(random, 20);
    case 3:
      return garbage_of(random, 3) + answer;
    default:
      if (first_mutable < answer.size())
        answer[first_mutable + below(random, answer.size() - first_mutable)] ^= static_cast<char>(1U
                                                                                                  << below(random, 8));
      return answer;
  }
}

/// A server on a thread of its own, for clients that block.
class WildServer {
 public:
  /// `talk` has the connection until it returns; `is_over` says that it should.
  using Talk = std::function<void(int connection, const std::atomic<bool>& is_over)>;
  explicit WildServer(Talk talk) : talk_(std::move(talk)) {
    thread_ = std::thread([this] {
      while (!is_over_) {
        const int connection = server_.take();
        if (connection < 0) {
          std::this_thread::sleep_for(1ms);
          continue;
        }
        ++connections;
        talk_(connection, is_over_);
        ::close(connection);
      }
    });
  }
  WildServer(const WildServer&) = delete;
  WildServer& operator=(const WildServer&) = delete;
  ~WildServer() {
    is_over_ = true;
    thread_.join();
  }
  std::uint16_t port() const { return server_.port(); }
  std::atomic<int> connections{0};

 private:
  FakeGpsd server_;
  const Talk talk_;
  std::atomic<bool> is_over_{false};
  std::thread thread_;
};

/// What has come, within 20 ms; empty: nothing. False: the client has closed it.
[[maybe_unused]] bool hear(int connection, std::string& heard) {
  pollfd ready{connection, POLLIN, 0};
  heard.clear();
  if (::poll(&ready, 1, 20) <= 0) return true;
  heard.resize(65536);
  const ssize_t got = ::recv(connection, heard.data(), heard.size(), MSG_DONTWAIT);
  heard.resize(got > 0 ? static_cast<std::size_t>(got) : 0);
  return got > 0;
}

/// What there is to say of all this is not shown.
void hush(Loop& loop) {
  loop.on_error([](const ErrorReport&) {});
  loop.runtime().on_log([](const LogRecord&) {});
}

[[maybe_unused]] void say(int connection, std::string_view text) {
  (void)::send(connection, text.data(), text.size(), MSG_NOSIGNAL);
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("US-32 NFR-3 whatever a peer answers, the program goes on, and no event counts that the peer never had") {
    for (const unsigned seed : seeds_of_peers()) {
      for (AnsweredSender kind : answered_senders()) {
        CAPTURE(seed);
        CAPTURE(kind.name);
        Random random(seed);
        bool is_calm = false;
        const bool is_mqtt = kind.name == "mqtt"s;
        kind.answering = [&, right = kind.answering](std::string& in, std::string& got) {
          std::string answer = right(in, got);
          if (answer.empty() || is_calm || below(random, 3) > 0) return answer;
          // A changed number would be another event's: then the peer says that it has that.
          answer = mutated(std::move(answer), is_mqtt ? 4 : 0, random);
          std::replace(answer.begin(), answer.end(), '\n', ' ');
          return answer.empty() ? " "s : answer;
        };
        AnsweredBench bench(kind);
        for (int round = 0; round < 20; ++round) {
          bench.publish(10);
          (void)bench.wait_for([] { return false; }, 5);
          if (below(random, 3) == 0) bench.peer.close_connections();
        }
        is_calm = true;
        bench.peer.close_connections();
        const auto counts = [&] { return bench.sink.counts(); };
        REQUIRE(bench.wait_for([&] { return counts().stored + counts().all_dropped() == 200; }, 20000));
        std::uint64_t missing = 0;
        for (int i = 1; i <= 200; ++i) {
          const std::string value = "\"value\":" + std::to_string(i);
          missing += bench.peer.got().find(value + "}") == std::string::npos &&
                     bench.peer.got().find(value + ",") == std::string::npos;
        }
        CHECK(missing <= counts().all_dropped());
        CHECK(counts().balances());
        CHECK(bench.missed == 0);
      }
    }
  }

  TEST_CASE("US-32 a link that breaks after so many confirmed events brings each of them once") {
    int confirmed = 0;  // on this connection
    const auto kinds = answered_senders();
    AnsweredSender kind = kinds.front();
    REQUIRE(kind.name == "tcp"s);
    kind.answering = [&](std::string& in, std::string& got) -> std::string {
      if (confirmed == 3) return "";
      const std::string answer = answer_line(in, got);
      if (!answer.empty()) ++confirmed;
      return answer;
    };
    AnsweredBench bench(kind);  // five events a parcel
    bench.publish(50);
    std::uint64_t before = 0;
    for (int i = 0; i < 40 && bench.sink.counts().stored < 50; ++i) {
      (void)bench.wait_for([&] { return confirmed == 3; }, 500);
      (void)bench.wait_for([] { return false; }, 3);  // the answers arrive
      CHECK(bench.sink.counts().stored >= before + (before + 3 <= 50 ? 3 : 50 - before));
      before = bench.sink.counts().stored;
      bench.peer.close_connections();
      confirmed = 0;
    }
    CHECK(bench.sink.counts().stored == 50);
    CHECK(std::count(bench.peer.got().begin(), bench.peer.got().end(), '\n') == 50);
    CHECK(bench.sink.counts().balances());
  }

#ifdef RTDATA_WITH_HTTP
  TEST_CASE("US-32 a request whose answer is cut off is sent four times, and then counts as cut_answer says") {
    for (const HttpCutAnswer cut_answer : {HttpCutAnswer::delivered, HttpCutAnswer::again}) {
      CAPTURE(static_cast<int>(cut_answer));
      int requests = 0;
      AnsweredSender kind = answered_senders()[1];
      kind.answering = [&](std::string& in, std::string& got) -> std::string {
        if (answer_request(in, got).empty()) return "";
        ++requests;
        return "HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\nabc";
      };
      kind.make = [cut_answer](Loop& loop, const std::string& host, std::uint16_t port) -> Sink {
        return HttpSink(loop, {.server = {.url = "http://" + host + ":" + std::to_string(port) + "/"},
                               .format = "jsonl",
                               .cut_answer = cut_answer,
                               .sending = {.window = 1, .parcel_rows = 5, .timeout = answer_timeout},
                               .sink = sink_config});
      };
      AnsweredBench bench(kind);
      std::vector<std::string> log;
      bench.loop.runtime().on_log([&](const LogRecord& record) { log.emplace_back(record.text); });
      bench.publish(5);
      for (int i = 0; i < 8; ++i) {
        const int before = requests;
        (void)bench.wait_for([&] { return requests > before; }, 300);
        bench.peer.close_connections();
      }
      (void)bench.wait_for([] { return false; }, 300);
      const auto said = [&](std::string_view part) {
        return std::any_of(log.begin(), log.end(),
                           [&](const std::string& line) { return line.find(part) != std::string::npos; });
      };
      if (cut_answer == HttpCutAnswer::delivered) {
        CHECK(requests == 4);
        CHECK(bench.sink.counts().stored == 5);
        CHECK(said("the events count as delivered"));
        bench.sink.close();
        CHECK(said("5 events count as delivered though their answers were cut off"));
      } else {
        CHECK(requests >= 8);
        CHECK(bench.sink.counts().stored == 0);
      }
    }
  }
#endif

#ifdef RTDATA_WITH_MQTT
  TEST_CASE("a packet of MQTT is good, cut or bad, and what is cut is no more than that") {
    using State = detail::MqttPacket::State;
    const auto look = [](const std::string& bytes, bool is_v5, bool is_accepted) {
      return detail::look_at_mqtt(bytes, {.is_v5 = is_v5, .is_accepted = is_accepted, .takes_messages = true});
    };
    struct Case {
      std::string bytes;
      bool is_v5, is_accepted;
    };
    const std::vector<Case> good{{"\x20\x03\0\0\0"s, true, false},
                                 {"\x20\x02\0\0"s, false, false},
                                 {"\x20\x02\0\x01"s, true, false},  // of a broker that has no MQTT 5
                                 {"\x20\x06\0\0\x03\x21\0\x14"s, true, false},
                                 {"\x40\x02\0\x01"s, true, true},
                                 {"\x40\x03\0\x01\x10"s, true, true},
                                 {"\x40\x08\0\x01\x80\x04\x1f\0\x01n"s, true, true},
                                 {"\x50\x02\0\x01"s, false, true},
                                 {"\x62\x02\0\x01"s, false, true},
                                 {"\x90\x04\0\x01\0\x01"s, true, true},
                                 {"\x90\x03\0\x01\x80"s, false, true},
                                 {"\xd0\0"s, true, true},
                                 {"\xe0\0"s, true, true},
                                 {"\xe0\x02\x8e\0"s, true, true}};
    for (const Case& one : good) {
      CAPTURE(one.bytes);
      const auto packet = look(one.bytes + "more", one.is_v5, one.is_accepted);
      CHECK(packet.state == State::good);
      CHECK(packet.head == one.bytes.size());
      for (std::size_t size = 0; size < one.bytes.size(); ++size)
        CHECK(look(one.bytes.substr(0, size), one.is_v5, one.is_accepted).state == State::cut);
    }
    const auto message = look("\x32\x0c\0\x01t\0\x07\0hello"s, true, true);
    CHECK(message.state == State::good);
    CHECK(message.head == 8);
    CHECK(message.payload == 6);
    const std::vector<Case> bad{{"\x20\x05\0\0\x02\x7f\0"s, true, false},                // a property that there is not
                                {"\x20\x05\0\0\x02\x7f\0"s, false, false},               // longer than it has to say
                                {"\x20\x03\0\0\0"s, true, true},                         // once more
                                {"\xd0\0"s, true, false},                                // before anything else
                                {"\x20\x02\0\0"s, true, false},                          // without properties
                                {"\x20\x06\0\0\x03\x21\0\0"s, true, false},              // no message at a time
                                {"\x20\x09\0\0\x06\x21\0\x01\x21\0\x01"s, true, false},  // twice
                                {"\x40\x02\0\0"s, true, true},
                                {"\x41\x02\0\x01"s, true, true},
                                {"\x40\x01\0"s, true, true},
                                {"\x90\x03\0\x01\0"s, true, true},
                                {"\x90\x02\0\x01"s, false, true},
                                {"\x36\x06\0\x01t\0\x01\0"s, true, true},  // QoS 3
                                {"\x30\x03\0\x01#"s, false, true},
                                {"\x30\x04\0\x02\xff\xfe"s, false, true},
                                {"\x30\x02\0\0"s, false, true},
                                {"\x30\x07\0\x01t\x03\x23\0\x01"s, true, true},  // an alias
                                {"\xe0\0"s, false, true},
                                {"\xf0\0"s, true, true},
                                {"\0\0"s, true, true},
                                {"\xd0\x80\x80\x80\x80\x01"s, true, true},
                                {"\xd0\x80\0"s, true, true}};
    for (const Case& one : bad) {
      CAPTURE(one.bytes);
      const auto packet = look(one.bytes, one.is_v5, one.is_accepted);
      CHECK(packet.state == State::bad);
      CHECK(packet.why != ""s);
    }
    CHECK(detail::look_at_mqtt("\x30\x03\0\x01t"s, {.is_v5 = false, .is_accepted = true, .takes_messages = false})
              .state == State::bad);
    Random random(1);
    for (int i = 0; i < 20000; ++i) {
      std::string bytes = good[below(random, good.size())].bytes + garbage_of(random, 8);
      bytes[below(random, bytes.size())] ^= static_cast<char>(1U << below(random, 8));
      const auto packet = look(bytes, below(random, 2) == 0, below(random, 2) == 0);
      CHECK((packet.state != State::good || packet.head <= bytes.size()));
    }
  }

  TEST_CASE("US-32 US-12 a broker whose packets are none ends no program: sink, sensor and output") {
    struct Answer {
      std::string bytes;
      const char* says;
    };
    for (const Answer& answer :
         {Answer{"\x20\x05\0\0\x02\x7f\0"s, "a property that MQTT does not allow there"},
          Answer{"\x20\x03\0\0\0\x30\x05\0\x01t\x02\x7f"s, nullptr},
          Answer{"\x20\x03\0\0\0\x40\x06\0\x01\0\x02\x7f\0"s, nullptr}, Answer{"\xff\xff\xff\xff\xff\xff"s, nullptr}}) {
      CAPTURE(answer.bytes);
      WildServer broker([&](int connection, const std::atomic<bool>& is_over) {
        std::string heard;
        while (!is_over && hear(connection, heard))
          if (!heard.empty()) say(connection, answer.bytes);
      });
      Loop loop;
      hush(loop);
      std::vector<std::string> errors;
      loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
      const MqttBroker at{.host = "127.0.0.1", .port = broker.port(), .version = MqttVersion::v5};
      MqttConfig config;
      config.broker = at;
      config.sink = {.name = "peer", .batch_time = 10ms, .retry_first = 10ms, .retry_longest = 20ms};
      MqttSink sink(loop, config);
      MqttSensor sensor(loop, {.name = "phone"},
                        {.broker = at, .topics = {"x"}, .fields = {{.name = "v"}}, .retry_first = 10ms});
      MqttActuator output({.broker = at, .to = "pump/set", .timeout = 200ms});
      CHECK_FALSE(output.open(0).has_value());
      loop.topic<Number>("a").publish({1});
      loop.run_for(200ms);
      CHECK(sink.counts().stored == 0);
      CHECK(sink.counts().queued == 1);
      CHECK(sink.health() == Health::faulted);
      CHECK(sensor.health() != Health::ok);
      CHECK_FALSE(output.set(1).has_value());
      if (answer.says != nullptr)
        CHECK(std::any_of(errors.begin(), errors.end(),
                          [&](const std::string& error) { return error.find(answer.says) != std::string::npos; }));
    }
  }

  TEST_CASE("US-12 a broker that sends anything ends no subscriber, whichever version it speaks") {
    for (const unsigned seed : seeds_of_peers()) {
      for (const bool is_v5 : {true, false}) {
        CAPTURE(seed);
        Random random(seed);
        std::atomic<int> sent{0};
        WildServer broker([&](int connection, const std::atomic<bool>& is_over) {
          const std::string accepted = is_v5 ? "\x20\x03\0\0\0"s : "\x20\x02\0\0"s;
          const std::string granted = is_v5 ? "\x90\x04\0\x01\0\x01"s : "\x90\x03\0\x01\x01"s;
          const std::string message = is_v5 ? "\x32\x0d\0\x01x\0\x07\0{\"v\":1}"s : "\x32\x0c\0\x01x\0\x07{\"v\":1}"s;
          std::string heard;
          const auto maybe = [&](const std::string& right) {
            return below(random, 4) == 0 ? mutated(right, 0, random) : right;
          };
          if (!hear(connection, heard)) return;
          say(connection, maybe(accepted));
          if (!hear(connection, heard)) return;
          say(connection, maybe(granted));
          for (int i = 0; i < 30 && !is_over; ++i) {
            const std::string all = maybe(message) + maybe(message);
            const std::size_t middle = below(random, all.size());  // as parts, too
            say(connection, std::string_view(all).substr(0, middle));
            if (!hear(connection, heard)) return;
            say(connection, std::string_view(all).substr(middle));
            ++sent;
          }
        });
        Loop loop;
        hush(loop);
        MqttSensor sensor(loop, {.name = "phone"},
                          {.broker = {.host = "127.0.0.1",
                                      .port = broker.port(),
                                      .version = is_v5 ? MqttVersion::v5 : MqttVersion::v311},
                           .topics = {"x"},
                           .fields = {{.name = "v"}},
                           .retry_first = 1ms,
                           .retry_longest = 2ms});
        loop.run_for(300ms);
        sensor.stop();
        CHECK(sensor.counts().balances());
      }
    }
  }

  TEST_CASE("US-12 of a message that is longer than it may be no more is kept, and those after it come") {
    WildServer broker([](int connection, const std::atomic<bool>& is_over) {
      std::string heard;
      if (!hear(connection, heard)) return;
      say(connection, "\x20\x02\0\0"s);
      if (!hear(connection, heard)) return;
      say(connection, "\x90\x03\0\x01\0"s);
      const std::string long_one = "\x30\x83\x80\x40\0\x01x"s + std::string(1 << 20, ' ');
      for (std::size_t at = 0; at < long_one.size() && !is_over;) {
        const ssize_t sent = ::send(connection, long_one.data() + at, long_one.size() - at, MSG_NOSIGNAL);
        if (sent <= 0) return;
        at += static_cast<std::size_t>(sent);
      }
      say(connection, "\x30\x0a\0\x01x{\"v\":5}"s);
      while (!is_over && hear(connection, heard)) {
      }
    });
    Loop loop;
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    int heard = 0;
    const Subscription all = loop.subscribe("phone", [&](const EventView& event) {
      heard += event.value("v").or_throw() == Value{5.0};
      loop.stop();
    });
    MqttSensor sensor(loop, {.name = "phone"},
                      {.broker = {.host = "127.0.0.1", .port = broker.port(), .version = MqttVersion::v311},
                       .topics = {"x"},
                       .fields = {{.name = "v"}},
                       .max_message = 1000});
    loop.run_for(20s);
    CHECK(heard == 1);
    CHECK(std::any_of(errors.begin(), errors.end(),
                      [](const std::string& error) { return error.find("longer than 1000") != std::string::npos; }));
  }
#endif

  TEST_CASE("US-14 a gpsd that sends anything ends no program, and one that is right again is heard") {
    for (const unsigned seed : seeds_of_peers()) {
      CAPTURE(seed);
      Random random(seed);
      Loop loop{Loop::Manual{}};
      hush(loop);
      FakeGpsd server;
      GpsSensor gps(loop, {.name = "gps"}, {.host = "127.0.0.1", .port = server.port()});
      const std::string report =
          "{\"class\":\"TPV\",\"device\":\"/dev/ttyS0\",\"mode\":3,\"time\":\"2026-01-01T00:00:00.000Z\",\"lat\":47.5,"
          "\"lon\":8.5,\"altHAE\":400.0}\n";
      for (int i = 0; i < 200; ++i) {
        server.accept();
        if (server.has_peer()) server.send(below(random, 2) == 0 ? report : mutated(report, 0, random));
        if (below(random, 20) == 0) server.hang_up();
        loop.advance(50ms);
        loop.poll();
      }
      CHECK(gps.counts().balances());
    }
  }

#ifdef RTDATA_WITH_MODBUS
  TEST_CASE("US-42 of a server of Modbus TCP that sends anything a reading is the right one, or none") {
    for (const unsigned seed : seeds_of_peers()) {
      CAPTURE(seed);
      Random random(seed);
      std::atomic<bool> is_calm{false};
      WildServer server([&](int connection, const std::atomic<bool>& is_over) {
        std::string heard;
        while (!is_over && hear(connection, heard)) {
          if (heard.size() < 12) continue;
          // The value is the address.
          const std::string answer = heard.substr(0, 4) + "\0\x05"s + heard[6] + "\x03\x02"s + heard.substr(8, 2);
          if (is_calm || below(random, 2) == 0) {
            say(connection, answer);
            continue;
          }
          switch (below(random, 6)) {
            case 0:
              say(connection, garbage_of(random, 6) + answer);
              break;
            case 1:
              say(connection, answer.substr(0, below(random, answer.size())));
              break;
            case 2:  // of another request
              say(connection, "\x7f"s + answer.substr(1));
              break;
            case 3:  // late
              if (!hear(connection, heard)) return;
              say(connection, answer);
              break;
            case 4:
              return;
            default:
              break;
          }
        }
      });
      ModbusBus bus("plc", {.host = "127.0.0.1", .port = server.port(), .answer_timeout = 20ms, .timeout = 2s});
      ModbusDevice device = bus.device({.unit = 1});
      int right = 0;
      for (std::uint16_t i = 1; i <= 60; ++i) {
        if (i == 50) is_calm = true;
        std::array<std::uint16_t, 1> word{};
        if (!device.read_registers(ModbusTable::holding, i, word)) continue;
        CHECK(word[0] == i);
        ++right;
      }
      CHECK(right >= 5);
    }
  }
#endif

#ifdef RTDATA_WITH_POSTGRESQL
  TEST_CASE("US-46 a server that is none of PostgreSQL ends no program, and has nothing") {
    for (const unsigned seed : seeds_of_peers()) {
      CAPTURE(seed);
      Random random(seed);
      WildServer server([&](int connection, const std::atomic<bool>& is_over) {
        // Of a connection that is accepted: authenticated, the parameters, ready.
        const std::string accepted = "R\0\0\0\x08\0\0\0\0S\0\0\0\x19server_encoding\0UTF8\0Z\0\0\0\x05I"s;
        std::string heard;
        for (int i = 0; i < 10 && !is_over && hear(connection, heard); ++i)
          if (!heard.empty()) say(connection, below(random, 2) == 0 ? accepted : mutated(accepted, 0, random));
      });
      Loop loop{Loop::Manual{}};
      hush(loop);
      PostgresqlSink sink(loop, {.url = "postgresql://x@127.0.0.1:" + std::to_string(server.port()) +
                                        "/x?sslmode=disable&gssencmode=disable",
                                 .timeout = 100ms,
                                 .sink = {.name = "server", .batch_time = 10ms}});
      loop.topic<Number>("a").publish({1});
      for (int i = 0; i < 10; ++i) loop.advance(500ms);
      CHECK(sink.counts().stored == 0);
      CHECK(sink.counts().balances());
    }
  }
#endif

#ifdef RTDATA_WITH_OPENSSL
  TEST_CASE("US-32 a server of TLS that sends anything has no event") {
    for (const unsigned seed : seeds_of_peers()) {
      CAPTURE(seed);
      Random random(seed);
      WildServer server([&](int connection, const std::atomic<bool>& is_over) {
        std::string heard;
        for (int i = 0; i < 5 && !is_over && hear(connection, heard); ++i)
          if (!heard.empty()) say(connection, mutated("\x16\x03\x03\0\x2a\x02\0\0\x26\x03\x03"s, 3, random));
      });
      Loop loop;
      hush(loop);
      TcpSink sink(loop, {.host = "127.0.0.1",
                          .port = server.port(),
                          .acknowledge = Acknowledge::line,
                          .tls = TlsConfig{},
                          .sink = {.name = "peer", .batch_time = 10ms, .retry_first = 5ms, .retry_longest = 10ms}});
      loop.topic<Number>("a").publish({1});
      loop.run_for(100ms);
      CHECK(sink.counts().stored == 0);
      CHECK(sink.counts().balances());
    }
  }
#endif
}
