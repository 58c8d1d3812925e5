// Devices on one line that answer too late, twice, to another, with an echo, with glitches or not at all: what is
// published is the answer to what was asked, or nothing.
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <functional>
#include <map>
#include <random>
#include <sstream>

#include "rtdata/chips/mhz19.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/io/serial.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/sensors/query.hpp"
#include "sanitized.hpp"
#include "sensors/fixture.hpp"

#ifdef RTDATA_WITH_MODBUS
#include "io/modbus_rtu.hpp"
#include "rtdata/sensors/modbus.hpp"
#endif

using namespace rtdata;
using namespace rtdata::literals;

namespace {

/// A line whose devices are a function: it is given each request, and sends what it likes when it likes.
class ScriptedLine final : public SerialTransport {
 public:
  std::function<void(const std::string& request)> on_request;
  void send(Duration after, std::string bytes) {
    if (!bytes.empty()) under_way_.emplace(detail::lane_now() + after, std::move(bytes));
  }
  Result<void> open() override { return {}; }
  Result<void> write(std::span<const std::uint8_t> bytes, Duration) override {
    on_request(std::string(reinterpret_cast<const char*>(bytes.data()), bytes.size()));
    return {};
  }
  Result<std::size_t> read(std::span<std::uint8_t> bytes, Duration timeout) override {
    const MonotonicTime now = detail::lane_now();
    detail::lane_sleep(under_way_.empty() ? timeout
                                          : std::clamp(under_way_.begin()->first - now, Duration{0}, timeout));
    if (under_way_.empty() || under_way_.begin()->first > detail::lane_now()) return std::size_t{0};
    std::string& first = under_way_.begin()->second;
    const std::size_t count = std::min(first.size(), bytes.size());
    std::copy_n(first.begin(), count, bytes.begin());
    first.erase(0, count);
    if (first.empty()) under_way_.erase(under_way_.begin());
    return count;
  }

 private:
  std::multimap<MonotonicTime, std::string> under_way_;
};

struct Stage {
  std::shared_ptr<ScriptedLine> line = std::make_shared<ScriptedLine>();
  Loop loop{Loop::Manual{}};
  const Duration offset = loop.time().time_since_epoch() - loop.now().time_since_epoch();
  std::vector<std::string> errors;
  std::vector<std::pair<std::string, double>> values;
  Subscription heard;
  Stage() {
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    heard = loop.subscribe("#", [this](const EventView& event) {
      if (event.topic().starts_with("$")) return;
      values.emplace_back(std::string(event.topic()), std::get<double>(event.value("v").or_throw()));
    });
  }
  bool has_error(const std::string& part) const {
    return std::any_of(errors.begin(), errors.end(),
                       [&](const std::string& one) { return one.find(part) != std::string::npos; });
  }
  Time time_on_lane() const { return Time{detail::lane_now().time_since_epoch() + offset}; }
  std::size_t count_of(const std::string& name, double value) const {
    return static_cast<std::size_t>(std::count(values.begin(), values.end(), std::pair(name, value)));
  }
};

SensorConfig patient(const char* name, Rate rate) { return {.name = name, .rate = rate, .faulted_after = 1000}; }

/// What a device does with an answer, at random; the answer that was asked for may come up to a second after its time.
template <class Random>
void misbehave(Random& random, ScriptedLine& line, Duration answer_timeout, const std::string& answer,
               const std::string& request, const std::string& foreign, const std::string& glitch) {
  const auto below = [&](int count) { return static_cast<int>(random() % static_cast<unsigned>(count)); };
  if (below(8) == 0) line.send(std::chrono::milliseconds{below(1500)}, glitch);
  const Duration soon = std::chrono::microseconds{below(static_cast<int>(answer_timeout / 1us))};
  const Duration late = answer_timeout + std::chrono::milliseconds{below(1000)};
  const Duration at = below(10) == 0 ? late : soon / 2;
  switch (below(14)) {
    case 0:  // twice
      line.send(at, answer);
      line.send(at + std::chrono::milliseconds{below(10)}, answer);
      break;
    case 1:  // somebody else first
      line.send(soon / 3, foreign);
      line.send(at, answer);
      break;
    case 2:  // somebody else instead
      line.send(at, foreign);
      break;
    case 3:
      line.send(0ms, request);
      line.send(at, answer);
      break;
    case 4:
      line.send(at, glitch + answer);
      break;
    case 5:
      line.send(at, answer + glitch);
      break;
    case 6: {  // damaged
      std::string damaged = answer;
      damaged[static_cast<std::size_t>(below(static_cast<int>(answer.size())))] = glitch[0];
      line.send(at, damaged);
      break;
    }
    case 7:  // in two pieces
      line.send(at, answer.substr(0, answer.size() / 2));
      line.send(at + std::chrono::milliseconds{below(20)}, answer.substr(answer.size() / 2));
      break;
    case 8:  // lost
      break;
    case 9:  // half of it is lost
      line.send(at, answer.substr(0, answer.size() / 2));
      break;
    case 10:
      line.send(late, answer);
      break;
    default:
      line.send(at, answer);
  }
}

std::pair<unsigned, unsigned> seeds() {
  unsigned from = 1, count = rtdata::test::sanitized ? 8 : 40;
  // "FIRST COUNT", to look for more
  if (const char* const wanted = std::getenv("RTDATA_TEST_SEEDS")) std::istringstream(wanted) >> from >> count;
  return {from, count};
}

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-42 a query after an answer that makes no sense takes no answer for another's") {
    // VOLT? is answered by BUSY once, and by 230.1 only then; CURR? is asked right after it.
    Stage stage;
    int volts = 0;
    stage.line->on_request = [&](const std::string& request) {
      if (request == "CURR?\n") return stage.line->send(60ms, "5.2\n");
      if (++volts != 3) return stage.line->send(60ms, "230.1\n");
      stage.line->send(0ms, "BUSY\n");
      stage.line->send(40ms, "230.1\n");
    };
    SerialPort port("meter", stage.line);
    DriverSensor<Query> first(stage.loop, patient("volt", 1_Hz), port, {},
                              {.request = "VOLT?\n", .fields = {{.name = "v"}}});
    DriverSensor<Query> second(stage.loop, patient("curr", 1_Hz), port, {},
                               {.request = "CURR?\n", .fields = {{.name = "v"}}});
    stage.loop.advance(10s);
    CHECK(stage.count_of("curr", 230.1) == 0);
    CHECK(stage.count_of("volt", 5.2) == 0);
    CHECK(stage.count_of("curr", 5.2) >= 8);
    CHECK(first.counts().unreadable == 1);
  }

  TEST_CASE("US-42 a query that is answered by an empty line first, and by the value later") {
    Stage stage;
    stage.line->on_request = [&](const std::string& request) {
      stage.line->send(0ms, "\n");
      stage.line->send(40ms, request == "VOLT?\n" ? "230.1\n" : "5.2\n");
    };
    SerialPort port("meter", stage.line);
    DriverSensor<Query> first(stage.loop, patient("volt", 1_Hz), port, {},
                              {.request = "VOLT?\n", .fields = {{.name = "v"}}});
    DriverSensor<Query> second(stage.loop, patient("curr", 1_Hz), port, {},
                               {.request = "CURR?\n", .fields = {{.name = "v"}}});
    stage.loop.advance(20s);
    CHECK(stage.values.empty());
    CHECK(first.counts().unreadable > 3);
  }

  TEST_CASE("US-42 a device that sends all the time is told, and none of it is taken for an answer") {
    Stage stage;
    stage.line->on_request = [&](const std::string&) {
      for (int i = 0; i < 1000; ++i) stage.line->send(600ms + i * 10ms, "7\n");
    };
    SerialPort port("meter", stage.line);
    DriverSensor<Query> meter(stage.loop, patient("volt", 1_Hz), port, {},
                              {.request = "VOLT?\n", .fields = {{.name = "v"}}});
    stage.loop.advance(5s);
    CHECK(stage.values.empty());
    CHECK(stage.has_error("it sends without being asked"));
  }

  TEST_CASE("US-42 an answer may be a frame of bytes, with its checksum, after garbage, cut off, or damaged") {
    // As a battery's controller answers: A5, what it is, 8 bytes of data, the sum of all.
    Stage stage;
    std::string before, answer;
    stage.line->on_request = [&](const std::string& request) {
      CHECK(request == std::string("\xa5\x40\x90", 3));
      stage.line->send(0ms, before);
      stage.line->send(5ms, answer);
    };
    SerialPort port("meter", stage.line);
    DriverSensor<Query> battery(stage.loop, patient("pack", 1_Hz), port, {},
                                {.request_hex = "a5 40 90",
                                 .format = LineFormat::binary,
                                 .fields = {{.name = "v", .unit = "V", .scale = 0.1, .at = 4, .wire = Kind::u16}},
                                 .frame = LineFrame{.start_hex = "a5", .length = 13},
                                 .checksum = LineChecksum{.type = ChecksumType::sum8, .form = ChecksumForm::big}});
    const std::string good("\xa5\x01\x90\x08\x02\x10\x00\x00\x75\x30\x03\x84\x7c", 13);
    answer = good;
    stage.loop.advance(3s);
    CHECK(stage.count_of("pack", 52.8) == 3);
    CHECK(stage.errors.empty());
    before = "xy";
    stage.loop.advance(3s);
    CHECK(stage.count_of("pack", 52.8) >= 5);
    before.clear();
    answer = good.substr(0, 7);
    stage.loop.advance(6s);
    CHECK(stage.has_error("7 bytes came within 500 ms, but no complete frame"));
    const std::size_t count = stage.values.size();
    answer = good;
    answer[5] = '\x11';
    stage.loop.advance(10s);
    CHECK(stage.values.size() == count);
    CHECK(stage.has_error("its checksum is 7c, but should be 7d"));
    CHECK(battery.counts().unreadable > 0);
    answer.clear();
    stage.loop.advance(10s);
    CHECK(stage.has_error("nothing came within 500 ms"));
    answer = good;
    stage.loop.advance(10s);
    CHECK(stage.values.size() > count);
    CHECK(battery.health() == Health::ok);
  }

  TEST_CASE("US-42 the echo of a request that has the shape of its answer is no value") {
    Stage stage;
    const std::string good("\xa5\x01\x90\x08\x02\x10\x00\x00\x75\x30\x03\x84\x7c", 13);
    stage.line->on_request = [&](const std::string& request) {
      stage.line->send(0ms, request);
      stage.line->send(5ms, good);
    };
    SerialPort port("meter", stage.line);
    DriverSensor<Query> battery(stage.loop, patient("pack", 1_Hz), port, {},
                                {.request_hex = "a5 40 90 08 00 00 00 00 00 00 00 00 7d",
                                 .format = LineFormat::binary,
                                 .fields = {{.name = "v", .unit = "V", .scale = 0.1, .at = 4, .wire = Kind::u16}},
                                 .frame = LineFrame{.start_hex = "a5", .length = 13},
                                 .checksum = LineChecksum{.type = ChecksumType::sum8, .form = ChecksumForm::big}});
    stage.loop.advance(10s);
    CHECK(stage.values.empty());
    CHECK(stage.has_error("it echoes the request"));
    CHECK(battery.counts().unreadable > 0);
  }

  TEST_CASE("US-42 a serial adapter that sends back what it is given is told, and nothing is taken from it") {
    Stage stage;
    std::string answer;
    stage.line->on_request = [&](const std::string& request) {
      stage.line->send(0ms, request);
      stage.line->send(4ms, answer);
    };
    SerialPort port("meter", stage.line);
    answer = "230.1\n";
    {
      // A request that is a number itself.
      DriverSensor<Query> meter(stage.loop, patient("volt", 1_Hz), port, {},
                                {.request = "7\r\n", .fields = {{.name = "v"}}});
      stage.loop.advance(5s);
      CHECK(meter.counts().unreadable > 0);
      CHECK(stage.has_error("bus meter: it echoes the request: switch off the echo"));
    }
    DriverSensor<Query> skipping(stage.loop, patient("volt", 1_Hz), port, {},
                                 {.request = "7\r\n", .skip_lines = 1, .fields = {{.name = "v"}}});
    stage.loop.advance(5s);
    CHECK(stage.values.size() >= 3);
    CHECK(stage.count_of("volt", 230.1) == stage.values.size());
    skipping.close();
    stage.errors.clear();
    answer = std::string("\xff\x86\x02\x60\x47\0\0\0\xd1", 9);
    DriverSensor<MhZ19> air(stage.loop, patient("air", 1_Hz), port);
    stage.loop.advance(5s);
    CHECK(air.counts().published == 0);
    CHECK(stage.has_error("bus meter: it echoes the request"));
  }

  TEST_CASE("US-42 an echo is dropped where the port says that there is one, and told where it differs") {
    Stage stage;
    bool differs = false;
    stage.line->on_request = [&](const std::string& request) {
      stage.line->send(0ms, differs ? "8" + request.substr(1) : request);
      stage.line->send(4ms, "230.1\n");
    };
    SerialPort port("meter", stage.line, {.echo = true});
    DriverSensor<Query> meter(stage.loop, patient("volt", 1_Hz), port, {},
                              {.request = "7\n", .fields = {{.name = "v"}}});
    stage.loop.advance(5500ms);
    CHECK(stage.values.size() >= 4);
    CHECK(stage.errors.empty());
    const std::size_t before = stage.values.size();
    differs = true;
    stage.loop.advance(10s);
    CHECK(stage.values.size() == before);
    CHECK(stage.count_of("volt", 230.1) == before);
    CHECK(stage.has_error("bus meter: the returned bytes differ from the sent bytes"));
    CHECK(stage.loop.runtime().balances());
  }

  TEST_CASE("US-42 queries of devices with any habit publish the answer to what was asked, and when, or nothing") {
    const auto [from, count] = seeds();
    std::size_t published = 0;
    for (unsigned seed = from; seed < from + count; ++seed) {
      CAPTURE(seed);
      std::mt19937 random(seed);
      Stage stage;
      const Duration answer_timeout = std::array<Duration, 3>{50ms, 200ms, 500ms}[random() % 3];
      std::map<std::string, unsigned> asked;
      std::map<std::string, Time> asked_at;
      unsigned number = 0;
      stage.line->on_request = [&](const std::string& request) {
        const unsigned kind = request[0] == 'A' ? 1 : 2;
        asked[request.substr(0, 1)] = ++number;
        asked_at[request.substr(0, 1)] = stage.time_on_lane();
        misbehave(random, *stage.line, answer_timeout, std::to_string(kind * 100000 + number) + "\n", request,
                  random() % 2 == 0 ? "BUSY\n" : "\n", random() % 2 == 0 ? "\xff" : "x");
      };
      SerialPort port("meter", stage.line, {.answer_timeout = answer_timeout, .timeout = 5s});
      const auto rate = [&] { return Rate::hertz(1 + static_cast<double>(random() % 20)); };
      DriverSensor<Query> first(stage.loop, patient("A", rate()), port, {},
                                {.request = "A?\n", .fields = {{.name = "v"}}});
      DriverSensor<Query> second(stage.loop, patient("B", rate()), port, {},
                                 {.request = "B?\n", .fields = {{.name = "v"}}});
      std::size_t wrong = 0;
      const auto heard = stage.loop.subscribe("#", [&](const EventView& event) {
        if (event.topic().starts_with("$")) return;
        const unsigned kind = event.topic() == "A" ? 1 : 2;
        const double value = std::get<double>(event.value("v").or_throw());
        const std::string topic(event.topic());
        if (value != kind * 100000 + asked[topic] || event.time() != asked_at[topic]) ++wrong;
        ++published;
      });
      for (int i = 0; i < 6000; ++i) stage.loop.advance(10ms);
      CHECK(wrong == 0);
      CHECK(stage.loop.runtime().balances());
    }
    CHECK(published > 5 * count);
  }
}

#ifdef RTDATA_WITH_MODBUS

namespace {

std::string framed(std::string bytes) {
  const auto sum = detail::modbus_checksum({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()});
  bytes += static_cast<char>(sum & 0xff);
  bytes += static_cast<char>(sum >> 8);
  return bytes;
}
std::string answer_of(unsigned unit, std::initializer_list<unsigned> words, int function = 3) {
  std::string bytes{static_cast<char>(unit), static_cast<char>(function), static_cast<char>(2 * words.size())};
  for (const unsigned word : words) bytes += {static_cast<char>(word >> 8), static_cast<char>(word & 0xff)};
  return framed(std::move(bytes));
}
unsigned unit_of(const std::string& request) { return static_cast<std::uint8_t>(request[0]); }
unsigned register_of(const std::string& request) {
  return static_cast<unsigned>(static_cast<std::uint8_t>(request[2]) << 8 | static_cast<std::uint8_t>(request[3]));
}

/// As a double, whatever the kind of the register.
Modbus::Config one_register(unsigned address, Kind type = Kind::u16) {
  return {.fields = {{.name = "v", .address = static_cast<std::uint16_t>(address), .type = type, .scale = 2}}};
}

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-42 Modbus RTU: functions, exceptions and writes, byte for byte") {
    auto line = std::make_shared<ScriptedLine>();
    std::vector<std::string> asked;
    std::string answer;
    line->on_request = [&](const std::string& request) {
      asked.push_back(request);
      line->send(1ms, answer.empty() ? request : answer);
    };
    ModbusBus bus("rs485", line, {});
    ModbusDevice device = bus.device({.unit = 17});
    std::array<std::uint16_t, 3> words{};
    // The example of the protocol's document, 6.3.
    answer = framed(std::string("\x11\x03\x06\x02\x2b\x00\x00\x00\x64", 9));
    device.read_registers(ModbusTable::holding, 0x6b, words).or_throw();
    CHECK(words == std::array<std::uint16_t, 3>{0x022b, 0, 0x64});
    CHECK(asked.back() == std::string("\x11\x03\x00\x6b\x00\x03\x76\x87", 8));
    answer = framed(std::string("\x11\x04\x02\x00\x0a", 5));
    std::array<std::uint16_t, 1> one{};
    device.read_registers(ModbusTable::input, 8, one).or_throw();
    CHECK(one[0] == 10);
    answer = framed(std::string("\x11\x01\x03\xcd\x6b\x05", 6));
    std::array<std::uint8_t, 19> bits{};
    device.read_bits(ModbusTable::coil, 0x13, bits).or_throw();
    CHECK(bits == std::array<std::uint8_t, 19>{1, 0, 1, 1, 0, 0, 1, 1, 1, 1, 0, 1, 0, 1, 1, 0, 1, 0, 1});
    answer = framed("\x11\x83\x02");
    const Error refused = device.read_registers(ModbusTable::holding, 0, one).error();
    CHECK(refused.code == Errc::bad_argument);
    CHECK(refused.text().find("exception 2, illegal data address") != std::string::npos);
    answer = "";
    one[0] = 3;
    device.write_registers(1, one).or_throw();
    CHECK(asked.back().substr(0, 6) == std::string("\x11\x06\x00\x01\x00\x03", 6));
    device.write_coil(0xac, 1).or_throw();
    CHECK(asked.back().substr(0, 6) == std::string("\x11\x05\x00\xac\xff\x00", 6));
    answer = framed(std::string("\x11\x10\x00\x01\x00\x02", 6));
    const std::array<std::uint16_t, 2> two{0x0a, 0x0102};
    device.write_registers(1, two).or_throw();
    CHECK(asked.back().substr(0, 11) == std::string("\x11\x10\x00\x01\x00\x02\x04\x00\x0a\x01\x02", 11));
    CHECK(bus.counts(17).failed == 1);
    for (const unsigned unit : {0u, 248u, 255u}) {
      answer = answer_of(unit, {7}, 4);
      bus.device({.unit = unit}).read_registers(ModbusTable::input, 8, one).or_throw();
      CHECK(one[0] == 7);
      CHECK(unit_of(asked.back()) == unit);
    }
  }

  TEST_CASE("US-42 Modbus RTU: the late answer of one unit moves no value of another to the wrong register") {
    Stage stage;
    int sixes = 0;
    stage.line->on_request = [&](const std::string& request) {
      const unsigned unit = unit_of(request);
      const bool is_late = unit == 6 && ++sixes == 3;
      stage.line->send(is_late ? 530ms : 60ms, answer_of(unit, {1000 * unit + register_of(request)}));
    };
    ModbusBus bus("rs485", stage.line, {.answer_timeout = 500ms});
    DriverSensor<Modbus> six(stage.loop, patient("six", Rate::hertz(0.5)), bus, {.unit = 6}, one_register(0));
    DriverSensor<Modbus> a(stage.loop, patient("a", Rate::hertz(0.5)), bus, {.unit = 5}, one_register(16));
    DriverSensor<Modbus> b(stage.loop, patient("b", Rate::hertz(0.5)), bus, {.unit = 5}, one_register(30));
    stage.loop.advance(20s);
    CHECK(stage.count_of("a", 2 * 5016.) == a.counts().published);
    CHECK(stage.count_of("b", 2 * 5030.) == b.counts().published);
    CHECK(a.counts().published == 10);
    CHECK(b.counts().published == 10);
    CHECK(six.counts().failed == 1);
  }

  TEST_CASE("US-42 Modbus RTU: an adapter that sends back what it is given is told, and nothing is taken from it") {
    Stage stage;
    stage.line->on_request = [&](const std::string& request) {
      stage.line->send(0ms, request);
      stage.line->send(4ms, answer_of(unit_of(request), {4000 + register_of(request)}));
    };
    ModbusBus bus("rs485", stage.line, {});
    DriverSensor<Modbus> a(stage.loop, patient("a", 4_Hz), bus, {.unit = 5}, one_register(50));
    DriverSensor<Modbus> b(stage.loop, patient("b", 4_Hz), bus, {.unit = 5}, one_register(60));
    stage.loop.advance(10s);
    CHECK(stage.values.empty());
    CHECK(stage.has_error("bus rs485, unit 5: it echoes the request: switch off the echo"));
    CHECK_FALSE(stage.has_error("may still be sending"));
    CHECK(a.counts().unreadable + b.counts().unreadable >= 6);
  }

  TEST_CASE("US-42 Modbus RTU: units with any habit publish the answer to what was asked, and when, or nothing") {
    const auto [from, count] = seeds();
    std::size_t published = 0;
    for (unsigned seed = from; seed < from + count; ++seed) {
      CAPTURE(seed);
      std::mt19937 random(seed);
      Stage stage;
      const Duration answer_timeout = std::array<Duration, 3>{50ms, 200ms, 500ms}[random() % 3];
      std::map<unsigned, unsigned> asked;
      std::map<unsigned, Time> asked_at;
      unsigned number = 0;
      stage.line->on_request = [&](const std::string& request) {
        const unsigned what = unit_of(request) * 256 + register_of(request);
        asked[what] = ++number;
        asked_at[what] = stage.time_on_lane();
        misbehave(random, *stage.line, answer_timeout, answer_of(unit_of(request), {what, number}), request,
                  answer_of(7, {1, 2}), std::string(1, static_cast<char>(random())));
      };
      ModbusBus bus("rs485", stage.line, {.answer_timeout = answer_timeout});
      const auto rate = [&] { return Rate::hertz(1 + static_cast<double>(random() % 20)); };
      const std::array<std::pair<unsigned, unsigned>, 4> places{{{6, 0}, {5, 16}, {5, 30}, {5, 32}}};
      std::vector<DriverSensor<Modbus>> sensors;
      for (const auto& [unit, address] : places)
        sensors.emplace_back(stage.loop, patient(std::to_string(unit * 256 + address).c_str(), rate()), bus,
                             ModbusDevice::Place{.unit = unit}, one_register(address, Kind::u32));
      std::size_t wrong = 0;
      const auto heard = stage.loop.subscribe("#", [&](const EventView& event) {
        if (event.topic().starts_with("$")) return;
        const auto what = static_cast<unsigned>(std::stoul(std::string(event.topic())));
        const double value = std::get<double>(event.value("v").or_throw()) / 2;
        if (value != what * 65536. + asked[what] || event.time() != asked_at[what]) ++wrong;
        ++published;
      });
      for (int i = 0; i < 6000; ++i) stage.loop.advance(10ms);
      CHECK(wrong == 0);
      CHECK(stage.loop.runtime().balances());
    }
    CHECK(published > 5 * count);
  }
}

#endif
