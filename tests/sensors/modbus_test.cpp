// Modbus against the servers of libmodbus: units on one RS-485 line made of a pseudo terminal, and a server of TCP.
#include <doctest/doctest.h>

#ifndef RTDATA_WITH_MODBUS

TEST_CASE("US-42 Modbus is tested where libmodbus is") {
  MESSAGE("skipped: Modbus, since libmodbus is not installed (script/bootstrap --all installs it)");
}

#else

#include <modbus.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <array>
#include <atomic>
#include <bit>
#include <cerrno>
#include <functional>
#include <mutex>
#include <thread>

#include "app/run/data_at_risk.hpp"
#include "has.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/modbus.hpp"
#include "sensors/fixture.hpp"
#include "sensors/pty.hpp"
#include "sensors/termios2.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

using rtdata::test::has;

/// What a server has: holding register n is 1000 + n, input register n is 2000 + n; coil 3 and discrete input 5 are
/// set.
modbus_mapping_t* new_mapping() {
  modbus_mapping_t* const mapping = ::modbus_mapping_new(16, 16, 200, 200);
  for (int i = 0; i < 200; ++i) {
    mapping->tab_registers[i] = static_cast<std::uint16_t>(1000 + i);
    mapping->tab_input_registers[i] = static_cast<std::uint16_t>(2000 + i);
  }
  mapping->tab_bits[3] = mapping->tab_input_bits[5] = 1;
  return mapping;
}

/// A unit of libmodbus behind a socket, on a thread: its calls block.
class Unit {
 public:
  explicit Unit(int number)
      : number_(number), context_(::modbus_new_rtu("/dev/null", 9600, 'N', 8, 1)), mapping_(new_mapping()) {
    REQUIRE(::socketpair(AF_UNIX, SOCK_STREAM, 0, ends_) == 0);
    ::modbus_set_slave(context_, number);
    ::modbus_set_socket(context_, ends_[1]);
    thread_ = std::thread([this] {
      std::uint8_t request[MODBUS_RTU_MAX_ADU_LENGTH];
      for (;;) {
        const int length = ::modbus_receive(context_, request);
        if (length < 0 && errno != EMBBADCRC) return;
        if (length > 0) ::modbus_reply(context_, request, length, mapping_);
      }
    });
  }
  Unit(const Unit&) = delete;
  Unit& operator=(const Unit&) = delete;
  ~Unit() {
    ::shutdown(ends_[0], SHUT_RDWR);
    thread_.join();
    ::close(ends_[0]);
    ::close(ends_[1]);
    ::modbus_free(context_);
    ::modbus_mapping_free(mapping_);
  }
  int number() const { return number_; }
  /// The line's end.
  int line() const { return ends_[0]; }
  /// To be set before it is asked.
  modbus_mapping_t& mapping() { return *mapping_; }

 private:
  const int number_;
  modbus_t* context_;
  modbus_mapping_t* mapping_;
  int ends_[2] = {-1, -1};
  std::thread thread_;
};

/// Carries what is sent on a line to the units, and their answers back, with faults. A unit hears what is for it alone:
/// libmodbus takes what comes after another's request for the answer to that.
class Carrier {
 public:
  enum class Fault { none, silent, broken, half, noise };
  enum class Echo { none, right, wrong };
  explicit Carrier(std::vector<Unit*> units) : units_(std::move(units)) {}
  void set(Fault fault) { fault_ = fault; }
  void set(Echo echo) { echo_ = echo; }
  unsigned requests() const { return requests_; }

 protected:
  /// Until `stop` is closed, or the end is.
  void carry(int end, int stop) {
    std::vector<pollfd> ends{{stop, POLLIN, 0}, {end, POLLIN, 0}};
    for (const Unit* unit : units_) ends.push_back({unit->line(), POLLIN, 0});
    while (::poll(ends.data(), ends.size(), -1) >= 0 && ends[0].revents == 0) {
      std::uint8_t bytes[300];
      if (ends[1].revents != 0) {
        const ssize_t got = ::read(end, bytes, sizeof bytes);
        if (got == 0) return;
        if (got > 0) ++requests_;
        if (const Echo echo = echo_; echo != Echo::none && got > 0) {
          std::uint8_t back[300];
          std::copy_n(bytes, got, back);
          if (echo == Echo::wrong) back[2] ^= 0x01;
          send(end, back, got);
        }
        for (const Unit* unit : units_) {
          if (got > 0 && bytes[0] == unit->number()) send(unit->line(), bytes, got);
        }
      }
      for (std::size_t i = 2; i < ends.size(); ++i) {
        if (ends[i].revents == 0) continue;
        ssize_t got = ::read(ends[i].fd, bytes, sizeof bytes);
        const Fault fault = fault_;
        if (fault == Fault::silent || got <= 0) continue;
        if (fault == Fault::broken) bytes[3] = static_cast<std::uint8_t>(bytes[3] ^ 0x10);
        if (fault == Fault::half) got /= 2;
        if (fault == Fault::noise) {
          const std::uint8_t noise[] = {0x00, 0xff, bytes[0]};
          send(end, noise, sizeof noise);
        }
        send(end, bytes, got);
      }
    }
  }
  static void send(int fd, const std::uint8_t* bytes, ssize_t size) {
    if (size > 0) [[maybe_unused]]
      const ssize_t sent = ::write(fd, bytes, static_cast<std::size_t>(size));
  }

 private:
  std::vector<Unit*> units_;
  std::atomic<Fault> fault_{Fault::none};
  std::atomic<Echo> echo_{Echo::none};
  std::atomic<unsigned> requests_{0};
};

/// An RS-485 line. A thread carries it, since both ends of it block.
class Rs485Line : public Carrier {
 public:
  explicit Rs485Line(std::vector<Unit*> units) : Carrier(std::move(units)), pty_(directory_.file("tty")) { plug_in(); }
  Rs485Line(const Rs485Line&) = delete;
  Rs485Line& operator=(const Rs485Line&) = delete;
  ~Rs485Line() { unplug(); }
  void plug_in() {
    pty_.plug_in();
    REQUIRE(::pipe(stop_) == 0);
    thread_ = std::thread([this] { carry(pty_.master(), stop_[0]); });
  }
  void unplug() {
    if (!thread_.joinable()) return;
    ::close(stop_[1]);
    thread_.join();
    ::close(stop_[0]);
    pty_.unplug();
  }
  const std::string& path() const { return pty_.path(); }
  int device() const { return pty_.device(); }

 private:
  ScratchDirectory directory_;
  Pty pty_;
  int stop_[2] = {-1, -1};
  std::thread thread_;
};

/// A serial server that passes bytes on and converts nothing, one connection at a time.
class SerialServer : public Carrier {
 public:
  explicit SerialServer(std::vector<Unit*> units, std::uint16_t port = 0) : Carrier(std::move(units)) {
    listening_ = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    const int on = 1;
    ::setsockopt(listening_, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    REQUIRE(::bind(listening_, reinterpret_cast<sockaddr*>(&address), size) == 0);
    REQUIRE(::listen(listening_, 4) == 0);
    ::getsockname(listening_, reinterpret_cast<sockaddr*>(&address), &size);
    port_ = ntohs(address.sin_port);
    REQUIRE(::pipe(stop_) == 0);
    thread_ = std::thread([this] {
      for (int peer = -1; (peer = ::accept(listening_, nullptr, nullptr)) >= 0;) {
        ++connections_;
        peer_ = peer;
        carry(peer, stop_[0]);
        peer_ = -1;
        ::close(peer);
      }
    });
  }
  SerialServer(const SerialServer&) = delete;
  SerialServer& operator=(const SerialServer&) = delete;
  ~SerialServer() {
    ::shutdown(listening_, SHUT_RDWR);
    ::close(stop_[1]);
    thread_.join();
    ::close(stop_[0]);
    ::close(listening_);
  }
  /// Ends the connection.
  void drop() {
    if (const int peer = peer_; peer >= 0) ::shutdown(peer, SHUT_RDWR);
  }
  std::uint16_t port() const { return port_; }
  unsigned connections() const { return connections_; }

 private:
  int listening_ = -1;
  std::uint16_t port_ = 0;
  std::atomic<int> peer_{-1};
  std::atomic<unsigned> connections_{0};
  int stop_[2] = {-1, -1};
  std::thread thread_;
};

/// A server of Modbus TCP on the loopback, one connection at a time.
class TcpServer {
 public:
  explicit TcpServer(int port = 0) : context_(::modbus_new_tcp("127.0.0.1", port)), mapping_(new_mapping()) {
    listening_ = ::modbus_tcp_listen(context_, 4);
    REQUIRE(listening_ >= 0);
    sockaddr_in address{};
    socklen_t size = sizeof address;
    ::getsockname(listening_, reinterpret_cast<sockaddr*>(&address), &size);
    port_ = ntohs(address.sin_port);
    thread_ = std::thread([this] {
      int socket = listening_;
      while (::modbus_tcp_accept(context_, &socket) >= 0) {
        {
          const std::lock_guard lock(mutex_);
          peer_ = ::modbus_get_socket(context_);
        }
        std::uint8_t request[MODBUS_TCP_MAX_ADU_LENGTH];
        for (int length = 0; (length = ::modbus_receive(context_, request)) >= 0;) {
          if (length > 0) note(request + ::modbus_get_header_length(context_));
          if (length > 0 && !is_silent_) ::modbus_reply(context_, request, length, mapping_);
        }
        const std::lock_guard lock(mutex_);
        peer_ = -1;
        ::modbus_close(context_);
        socket = listening_;
      }
    });
  }
  TcpServer(const TcpServer&) = delete;
  TcpServer& operator=(const TcpServer&) = delete;
  ~TcpServer() {
    ::shutdown(listening_, SHUT_RDWR);
    drop();
    thread_.join();
    ::close(listening_);
    ::modbus_free(context_);
    ::modbus_mapping_free(mapping_);
  }
  /// Ends the connection.
  void drop() {
    const std::lock_guard lock(mutex_);
    if (peer_ >= 0) ::shutdown(peer_, SHUT_RDWR);
  }
  void set_silent(bool is_silent) { is_silent_ = is_silent; }
  std::uint16_t port() const { return port_; }
  /// To be set before it is asked.
  modbus_mapping_t& mapping() { return *mapping_; }
  unsigned requests() const { return requests_; }
  /// Of one request.
  unsigned most_asked() const { return most_asked_; }

 private:
  void note(const std::uint8_t* pdu) {
    const auto count = static_cast<unsigned>(pdu[3] << 8 | pdu[4]);
    if (pdu[0] <= 4) most_asked_ = std::max(most_asked_.load(), count);
    ++requests_;
  }
  std::atomic<unsigned> requests_{0}, most_asked_{0};
  modbus_t* context_;
  modbus_mapping_t* mapping_;
  int listening_ = -1;
  std::uint16_t port_ = 0;
  std::mutex mutex_;
  int peer_ = -1;
  std::atomic<bool> is_silent_{false};
  std::thread thread_;
};

struct Stage {
  Loop loop;
  std::vector<std::string> errors;
  std::vector<std::string> values;
  Subscription heard;
  Stage() {
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    heard = loop.subscribe("#", [this](const EventView& event) {
      if (event.topic().starts_with("$")) return;
      std::string text;
      for (const Leaf& leaf : event.description().leaves())
        text += (text.empty() ? "" : " ") + to_string(event.value(leaf));
      values.push_back(std::string(event.topic()) + ": " + text);
    });
  }
  void until(const std::function<bool()>& is_so) {
    bool done = false;
    Timer limit(loop, 60s, [&] { loop.stop(); });
    Ticker look(loop, 1ms, [&](const Tick&) {
      done = is_so();
      if (done) loop.stop();
    });
    loop.run();
    CHECK(done);
  }
  bool has_error(const std::string& part) const {
    return std::any_of(errors.begin(), errors.end(), [&](const std::string& one) { return has(one, part); });
  }
};

SensorConfig common(const char* name) {
  return {.name = name, .rate = 100_Hz, .faulted_after = 3, .retry_first = 2ms, .retry_longest = 4ms};
}

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-42 Modbus: numbers of registers in every order, scaled, and those that are none") {
    const auto word = [](std::uint32_t bits) {
      return std::array<std::uint16_t, 2>{static_cast<std::uint16_t>(bits >> 16),
                                          static_cast<std::uint16_t>(bits & 0xffff)};
    };
    const ModbusField number{.name = "x", .type = Kind::f32};
    const auto a = word(std::bit_cast<std::uint32_t>(123.5f));
    const auto swapped = [](std::uint16_t one) { return static_cast<std::uint16_t>(one >> 8 | one << 8); };
    CHECK(Modbus::decode(number, a, WordOrder::abcd).or_throw() == 123.5);
    CHECK(Modbus::decode(number, std::array{a[1], a[0]}, WordOrder::cdab).or_throw() == 123.5);
    CHECK(Modbus::decode(number, std::array{swapped(a[0]), swapped(a[1])}, WordOrder::badc).or_throw() == 123.5);
    CHECK(Modbus::decode(number, std::array{swapped(a[1]), swapped(a[0])}, WordOrder::dcba).or_throw() == 123.5);
    CHECK(Modbus::decode(number, word(0x7fc00000), WordOrder::abcd).error().code == Errc::not_a_number);
    CHECK(Modbus::decode(number, word(0x7f800000), WordOrder::abcd).error().code == Errc::not_a_number);
    const ModbusField small{.name = "x", .type = Kind::i16, .scale = 0.1, .offset = 5};
    const std::array<std::uint16_t, 1> minus{0xff9c};
    CHECK(Modbus::decode(small, minus, WordOrder::abcd).or_throw() == doctest::Approx(-5));
    const ModbusField one{.name = "x"};
    const std::array<std::uint16_t, 1> low_first{0x3412};
    CHECK(Modbus::decode(one, low_first, WordOrder::badc).or_throw() == 4660);
    CHECK(Modbus::decode(one, low_first, WordOrder::dcba).or_throw() == 4660);
    CHECK(Modbus::decode(one, low_first, WordOrder::cdab).or_throw() == 0x3412);
    const ModbusField large{.name = "x", .type = Kind::i64};
    const std::array<std::uint16_t, 4> all{0xffff, 0xffff, 0xffff, 0xfffe};
    CHECK(Modbus::decode(large, all, WordOrder::abcd).or_throw() == -2);
    const ModbusField wide{.name = "x", .type = Kind::f64};
    const auto bits = std::bit_cast<std::uint64_t>(-0.125);
    const std::array<std::uint16_t, 4> eight{static_cast<std::uint16_t>(bits), static_cast<std::uint16_t>(bits >> 16),
                                             static_cast<std::uint16_t>(bits >> 32),
                                             static_cast<std::uint16_t>(bits >> 48)};
    CHECK(Modbus::decode(wide, eight, WordOrder::cdab).or_throw() == -0.125);
  }

  TEST_CASE("US-42 Modbus: what lies one behind the other is one request, up to what a request may bring") {
    Modbus::Config config;
    const auto add = [&](ModbusTable table, unsigned address, Kind type = Kind::u16) {
      config.fields.push_back({.name = "f" + std::to_string(config.fields.size()),
                               .table = table,
                               .address = static_cast<std::uint16_t>(address),
                               .type = type});
    };
    add(ModbusTable::holding, 12);
    add(ModbusTable::holding, 10, Kind::f32);
    add(ModbusTable::input, 13);
    add(ModbusTable::holding, 16);
    add(ModbusTable::coil, 13);
    add(ModbusTable::holding, 10);  // the same register again, as another number
    auto requests = Modbus::requests(config);
    REQUIRE(requests.size() == 4);
    CHECK(requests[0].first == 10);
    CHECK(requests[0].count == 3);
    CHECK(requests[0].fields == std::vector<std::size_t>{1, 5, 0});
    CHECK(requests[1].first == 16);
    config.gap = 3;
    requests = Modbus::requests(config);
    REQUIRE(requests.size() == 3);
    CHECK(requests[0].count == 7);
    config = {};
    for (unsigned i = 0; i < 300; ++i) add(ModbusTable::holding, i);
    requests = Modbus::requests(config);
    REQUIRE(requests.size() == 3);
    CHECK(requests[0].count == 125);
    CHECK(requests[2].count == 50);
    config = {};
    add(ModbusTable::holding, 65535);
    CHECK(Modbus::describe(config));
    add(ModbusTable::holding, 65535, Kind::f32);
    CHECK_FALSE(Modbus::describe(config));
  }

  TEST_CASE("US-42 Modbus TCP: every function, the device's exceptions by name, limits") {
    TcpServer server;
    ModbusBus bus("plc", {.host = "127.0.0.1", .port = server.port(), .answer_timeout = 5s, .timeout = 10s});
    ModbusDevice device = bus.device({.unit = 7});
    std::array<std::uint16_t, 3> words{};
    device.read_registers(ModbusTable::holding, 10, words).or_throw();
    CHECK(words == std::array<std::uint16_t, 3>{1010, 1011, 1012});
    device.read_registers(ModbusTable::input, 10, words).or_throw();
    CHECK(words == std::array<std::uint16_t, 3>{2010, 2011, 2012});
    std::array<std::uint8_t, 8> bits{};
    device.read_bits(ModbusTable::coil, 0, bits).or_throw();
    CHECK(bits == std::array<std::uint8_t, 8>{0, 0, 0, 1, 0, 0, 0, 0});
    device.read_bits(ModbusTable::discrete, 0, bits).or_throw();
    CHECK(bits == std::array<std::uint8_t, 8>{0, 0, 0, 0, 0, 1, 0, 0});
    const std::array<std::uint16_t, 1> one{77};
    const std::array<std::uint16_t, 2> two{88, 99};
    device.write_registers(10, one).or_throw();
    device.write_registers(11, two).or_throw();
    device.write_coil(0, 1).or_throw();
    device.read_registers(ModbusTable::holding, 10, words).or_throw();
    CHECK(words == std::array<std::uint16_t, 3>{77, 88, 99});
    device.read_bits(ModbusTable::coil, 0, bits).or_throw();
    CHECK(bits[0] == 1);

    const Error address = device.read_registers(ModbusTable::holding, 199, words).error();
    CHECK(address.code == Errc::bad_argument);
    CHECK(has(address.text(), "bus plc, unit 7: it answers with exception 2, illegal data address"));
    CHECK(has(address.advice, "if the manual counts from 1 or from 40001, it is one less than there"));
    device.read_registers(ModbusTable::holding, 0, words).or_throw();  // over the same connection
    std::array<std::uint16_t, 126> many{};
    CHECK(device.read_registers(ModbusTable::holding, 0, many).error().code == Errc::bad_argument);
    CHECK(device.read_registers(ModbusTable::coil, 0, words).error().code == Errc::bad_argument);
    CHECK(bus.counts(7).failed == 1);
    CHECK(bus.counts(7).transfers == 11);
    CHECK_THROWS_AS((void)bus.device({.unit = 256}), SetupError);
    for (const unsigned unit : {0u, 248u, 255u}) {
      bus.device({.unit = unit}).read_registers(ModbusTable::input, 1, words).or_throw();
      CHECK(words == std::array<std::uint16_t, 3>{2001, 2002, 2003});
      CHECK(bus.counts(unit).transfers == 1);
    }
    device.abandon();
    CHECK(device.read_registers(ModbusTable::holding, 0, words).error().code == Errc::closed);
  }

  TEST_CASE("US-42 Modbus: a device has no value, whichever way its data sheet writes the raw number") {
    TcpServer server;
    Stage stage;
    ModbusBus bus("plc", {.host = "127.0.0.1", .port = server.port()});
    const auto raw = std::bit_cast<std::uint32_t>(-9999.9f);
    const std::array<std::uint16_t, 10> words{
        0x8000, 0x8000, 0xffff, 0xffff, static_cast<std::uint16_t>(raw >> 16), static_cast<std::uint16_t>(raw & 0xffff),
        0xffff, 0xffff, 0xffff, 0xffff};
    bus.device({.unit = 1}).write_registers(20, words).or_throw();
    DriverSensor<Modbus> meter(
        stage.loop, common("meter"), bus, {.unit = 1},
        {.fields = {{.name = "a", .address = 20, .type = Kind::i16, .scale = 0.1, .no_value = {32768}},
                    {.name = "b", .address = 21, .type = Kind::i16, .no_value = {-32768}},
                    {.name = "c", .address = 22, .type = Kind::u16, .no_value = {-1}},
                    {.name = "d", .address = 22, .type = Kind::i16, .no_value = {65535}},
                    {.name = "e", .address = 22, .type = Kind::i32, .no_value = {4294967295}},
                    {.name = "f", .address = 24, .type = Kind::f32, .no_value = {-9999.9}},
                    {.name = "g", .address = 26, .type = Kind::u64, .no_value = {-1}},
                    {.name = "h", .address = 26, .type = Kind::u64, .no_value = {18446744073709551615.0}},
                    {.name = "is", .address = 20, .type = Kind::i16, .no_value = {32767}}}});
    stage.until([&] { return !stage.values.empty(); });
    CHECK(stage.values[0] == "meter: absent absent absent absent absent absent absent absent -32768");
  }

  TEST_CASE("US-42 Modbus: texts, single bits, masks, an order for each field, several numbers for none") {
    TcpServer server;
    const auto raw = std::bit_cast<std::uint32_t>(-12.75f);
    const std::array<std::uint16_t, 15> words{0x5761,  // "Wa"
                                              0x7474,  // "tt"
                                              0x2000,  // " ", then NUL
                                              0x4142,  // not part of the text
                                              0xa5c3,  // bits
                                              0x8000,
                                              0xffff,
                                              0x0007,                                    // none, none, and a number
                                              static_cast<std::uint16_t>(raw & 0xffff),  // cdab
                                              static_cast<std::uint16_t>(raw >> 16),
                                              0x0001,
                                              0x0002,  // abcd
                                              0x6157,
                                              0x7474,  // "Watt" with its bytes swapped
                                              0x2020};
    std::copy(words.begin(), words.end(), server.mapping().tab_registers + 20);
    Stage stage;
    ModbusBus bus("plc", {.host = "127.0.0.1", .port = server.port()});
    const auto none = [](const char* name, unsigned address) {
      return ModbusField{.name = name, .address = static_cast<std::uint16_t>(address), .no_value = {32768, 65535}};
    };
    DriverSensor<Modbus> meter(
        stage.loop, common("meter"), bus, {.unit = 1},
        {.fields = {
             {.name = "text", .address = 20, .type = Kind::text, .registers = 4},
             {.name = "bit0", .address = 24, .bit = 0},
             {.name = "bit2", .address = 24, .bit = 2},
             {.name = "bit15", .address = 24, .type = Kind::i16, .bit = 15},
             {.name = "of_two", .address = 30, .type = Kind::u32, .bit = 16},
             {.name = "high", .address = 24, .mask = 0xff00},
             {.name = "nibble", .address = 24, .scale = 0.5, .mask = 0x00f0},
             none("a", 25),
             none("b", 26),
             none("c", 27),
             {.name = "word", .address = 28, .type = Kind::f32, .word_order = WordOrder::cdab},
             {.name = "number", .address = 30, .type = Kind::u32},
             {.name = "swapped", .address = 32, .type = Kind::text, .word_order = WordOrder::badc, .registers = 3},
             {.name = "blank", .address = 34, .type = Kind::text, .registers = 1},
             {.name = "gone", .address = 25, .no_value = {0x8000}, .bit = 15}}});
    stage.until([&] { return !stage.values.empty(); });
    CHECK(stage.values[0] == "meter: Watt true false true true 165 6 absent absent 7 -12.75 65538 Watt  absent");
    CHECK(server.requests() == 1);
  }

  TEST_CASE("US-42 Modbus: a scale factor from another register, which is there, is none or makes no sense") {
    TcpServer server;
    std::uint16_t* const registers = server.mapping().tab_registers;
    registers[10] = 2301;
    registers[50] = 0xffff;  // -1
    registers[11] = 12;
    registers[51] = 3;
    registers[12] = 7;
    registers[52] = 0x8000;  // not implemented
    Stage stage;
    ModbusBus bus("inverter", {.host = "127.0.0.1", .port = server.port()});
    const Modbus::Config config{.fields = {{.name = "v", .address = 10, .unit = "V", .scale_from = 50},
                                           {.name = "w", .address = 11, .scale = 2, .offset = 1, .scale_from = 51},
                                           {.name = "none", .address = 12, .scale_from = 52},
                                           {.name = "gone", .address = 12, .no_value = {7}, .scale_from = 50}}};
    DriverSensor<Modbus> sun(stage.loop, common("sun"), bus, {.unit = 126}, config);
    stage.until([&] { return !stage.values.empty(); });
    CHECK(stage.values[0] == "sun: 230.1 24001 absent absent");
    CHECK(server.requests() == 2);  // 10 to 12, and 50 to 52
    sun.close();
    const std::array<std::uint16_t, 1> wrong{11};
    bus.device({.unit = 126}).write_registers(50, wrong).or_throw();
    DriverSensor<Modbus> other(stage.loop, common("other"), bus, {.unit = 126}, config);
    stage.until([&] { return other.counts().unreadable > 0; });
    CHECK(other.counts().published == 0);
    CHECK(stage.has_error(
        "field v: its scale factor is 11, but scale factors of SunSpec are -10 to 10: check `scale_from`"));
  }

  TEST_CASE("US-42 Modbus: no request asks for more registers than the device gives, and none ends within a field") {
    TcpServer server;
    Modbus::Config config;
    for (unsigned i = 0; i < 40; ++i)
      config.fields.push_back({.name = "f" + std::to_string(i),
                               .address = static_cast<std::uint16_t>(2 * i + 1),
                               .type = Kind::u32,
                               .word_order = i % 2 == 0 ? std::nullopt : std::optional(WordOrder::cdab)});
    config.most_registers = 9;
    const auto requests = Modbus::requests(config);
    CHECK(requests.size() == 10);
    CHECK(std::all_of(requests.begin(), requests.end(), [](const auto& one) { return one.count == 8; }));
    Stage stage;
    ModbusBus bus("plc", {.host = "127.0.0.1", .port = server.port()});
    DriverSensor<Modbus> meter(stage.loop, common("meter"), bus, {.unit = 1}, config);
    stage.until([&] { return !stage.values.empty(); });
    std::string expected = "meter:";
    for (std::uint32_t i = 0; i < 40; ++i) {
      const std::uint32_t first = 1001 + 2 * i, second = first + 1;
      expected += " " + std::to_string(i % 2 == 0 ? first << 16 | second : second << 16 | first);
    }
    CHECK(stage.values[0] == expected);
    CHECK(server.most_asked() == 8);
    config.most_registers = 1;
    CHECK(Modbus::describe(config).error().text().find("it has 2 registers, but a request may have only 1") !=
          std::string::npos);
    config.most_registers = 126;
    CHECK_FALSE(Modbus::describe(config));
  }

  TEST_CASE("US-42 NFR-1 Modbus TCP: a server that is absent, silent, closes and comes back") {
    auto server = std::make_unique<TcpServer>();
    const std::uint16_t port = server->port();
    Stage stage;
    ModbusBus bus("plc", {.host = "127.0.0.1", .port = port, .answer_timeout = 20ms});
    DriverSensor<Modbus> meter(
        stage.loop, common("meter"), bus, {.unit = 1},
        {.fields = {{.name = "a", .address = 5},
                    {.name = "b", .table = ModbusTable::input, .address = 7, .scale = 0.5, .unit = "V"},
                    {.name = "c", .table = ModbusTable::coil, .address = 3}}});
    stage.until([&] { return stage.values.size() > 3; });
    CHECK(stage.values[0] == "meter: 1005 1003.5 true");
    server->set_silent(true);
    stage.until([&] {
      return stage.has_error("bus plc, unit 1: no answer within 20 ms") && meter.health() == Health::faulted;
    });
    server->set_silent(false);
    std::size_t before = stage.values.size();
    stage.until([&] { return stage.values.size() > before + 3 && meter.health() == Health::ok; });
    const std::uint64_t failed = meter.counts().failed;
    server->drop();
    before = stage.values.size();
    stage.until([&] { return stage.values.size() > before + 3; });
    CHECK(meter.counts().failed == failed);  // it is asked by a new connection
    server.reset();
    stage.until([&] { return meter.health() == Health::faulted && stage.has_error("cannot connect: 127.0.0.1 port"); });
    server = std::make_unique<TcpServer>(port);
    before = stage.values.size();
    stage.until([&] { return stage.values.size() > before + 3 && meter.health() == Health::ok; });
    meter.stop();
    CHECK(meter.counts().balances());
  }

  TEST_CASE("US-42 US-17 check warns of units that no device has by RTU") {
    const auto warned = [](const std::string& bus, const char* unit) {
      SystemPlan plan = plan_system(
          standard_registry(),
          parse_config(R"({"buses": {"b": {"type": "modbus", )" + bus +
                           R"(}}, "sensors": [{"name": "m", "type": "modbus", "rate": "1 Hz", "bus": "b", "unit": )" +
                           unit + R"(, "fields": [{"name": "x", "address": 0}]}], "sinks": [{"type": "console"}]})",
                       "f.json"));
      REQUIRE_MESSAGE(plan.good(), plan.report());
      app::warn_of_losses(plan);
      return plan.warnings.empty() ? std::string() : plan.warnings[0].id + " " + plan.warnings[0].path;
    };
    for (const char* rtu : {R"("device": "/dev/ttyUSB0")", R"("host": "10.0.0.1", "rtu_over_tcp": true)"}) {
      for (const char* unit : {"0", "248", "255"}) CHECK(warned(rtu, unit) == "unlikely-address sensors[0].unit");
      for (const char* unit : {"1", "9", "99", "247"}) CHECK(warned(rtu, unit).empty());
    }
    for (const char* tcp : {R"("host": "10.0.0.1")", R"("host": "10.0.0.1", "rtu_over_tcp": false)"})
      for (const char* unit : {"0", "1", "255"}) CHECK(warned(tcp, unit).empty());
  }

  TEST_CASE(
      "US-42 NFR-1 Modbus RTU over TCP: noise, broken, half and missing answers, a server that closes or is away") {
    Unit first(1), last(247);
    auto server = std::make_unique<SerialServer>(std::vector<Unit*>{&first, &last});
    const std::uint16_t port = server->port();
    Stage stage;
    ModbusBus bus("server", {.host = "127.0.0.1", .port = port, .rtu_over_tcp = true, .answer_timeout = 60ms});
    std::array<std::uint16_t, 1> none{};
    CHECK(bus.device({.unit = 1}).read_registers(ModbusTable::holding, 200, none).error().code == Errc::bad_argument);
    DriverSensor<Modbus> one(stage.loop, common("one"), bus, {.unit = 1},
                             {.fields = {{.name = "a", .address = 20}, {.name = "b", .address = 120}}});
    DriverSensor<Modbus> other(stage.loop, common("other"), bus, {.unit = 247},
                               {.fields = {{.name = "x", .table = ModbusTable::input, .address = 2}}});
    const auto are_back = [&] {
      const std::uint64_t a = one.counts().published, b = other.counts().published;
      stage.until([&, a, b] { return one.counts().published > a + 3 && other.counts().published > b + 3; });
    };
    are_back();
    CHECK(server->connections() == 1);
    CHECK(bus.counts(1).skipped_bytes == 0);

    server->set(Carrier::Fault::noise);
    stage.until([&] { return bus.counts(1).skipped_bytes >= 9 && bus.counts(247).skipped_bytes >= 9; });
    const std::uint64_t failed = one.counts().failed;
    CHECK(failed == 0);
    CHECK(one.counts().unreadable == 0);
    server->set(Carrier::Fault::broken);
    stage.until([&] { return one.counts().unreadable > 0; });
    CHECK(stage.has_error("bus server, unit 1: the checksum of its answer is wrong"));
    server->set(Carrier::Fault::half);
    stage.until([&] { return stage.has_error("unit 247: its answer was not complete within 60 ms"); });
    CHECK(server->connections() == 1);
    server->set(Carrier::Fault::silent);
    stage.until([&] { return server->connections() > 1; });  // after three requests in a row
    CHECK(stage.has_error("no answer within 60 ms"));
    server->set(Carrier::Fault::none);
    are_back();

    const std::uint64_t before = one.counts().failed + other.counts().failed;
    const unsigned connections = server->connections();
    server->drop();
    stage.until([&] { return server->connections() > connections; });
    are_back();
    CHECK(one.counts().failed + other.counts().failed <= before + 1);  // one may have been on its way
    server.reset();
    stage.until([&] { return one.health() == Health::faulted && stage.has_error("cannot connect: 127.0.0.1 port"); });
    server = std::make_unique<SerialServer>(std::vector<Unit*>{&first, &last}, port);
    are_back();
    for (const std::string& value : stage.values)
      CHECK_MESSAGE((value == "one: 1020 1120" || value == "other: 2002"), value);
    one.stop();
    other.stop();
    CHECK(one.counts().balances());
    CHECK(other.counts().balances());
    CHECK(stage.loop.runtime().balances());
  }

  TEST_CASE("US-42 US-17 check refuses what a Modbus bus or sensor cannot be") {
    const auto report = [](const std::string& bus, const std::string& sensor) {
      return plan_system(
                 standard_registry(),
                 parse_config(R"({"buses": {"b": {"type": "modbus", )" + bus +
                                  R"(}}, "sensors": [{"name": "m", "type": "modbus", "rate": "1 Hz", "bus": "b", )" +
                                  sensor + R"(}], "sinks": [{"type": "console"}]})",
                              "f.json"))
          .report();
    };
    const std::string tcp = R"("host": "plc.local")", field = R"("fields": [{"name": "x", "address": 0}])";
    CHECK(report(tcp, field).empty());
    CHECK(
        report(R"("device": "/dev/ttyUSB0", "baud_rate": 19200, "parity": "even")", field + R"(, "unit": 247)").empty());
    CHECK(has(report(R"("port": 502)", field), "neither a `device` (RTU) nor a `host` (TCP)"));
    CHECK(has(report(R"("device": "/dev/x", "host": "h")", field), "there is a `device` too"));
    CHECK(has(report(tcp + R"(, "answer_timeout": "5 s")", field), "make `timeout` longer"));
    CHECK(report(tcp, field + R"(, "unit": 0)").empty());
    CHECK(report(tcp, field + R"(, "unit": 255)").empty());
    CHECK(has(report(tcp, field + R"(, "unit": 256)"), "unit"));
    CHECK(has(report(tcp, field + R"(, "unit": -1)"), "unit"));
    const std::string rtu = R"("device": "/dev/ttyUSB0")";
    CHECK(report(tcp + R"(, "rtu_over_tcp": true, "echo": true)", field).empty());
    CHECK(report(rtu + R"(, "echo": true, "hangup": true, "dtr": false, "rs485": "rts_high")", field).empty());
    CHECK(has(report(rtu + R"(, "rtu_over_tcp": true)", field), "a serial line always uses RTU"));
    CHECK(has(report(tcp + R"(, "echo": true)", field), "Modbus TCP has no echo"));
    CHECK(has(report(rtu + R"(, "rts": true, "rs485": "rts_low")", field), "with `rs485` the kernel sets RTS"));
    for (const char* line : {R"("dtr": true)", R"("rts": false)", R"("hangup": true)", R"("rs485": "rts_low")"})
      CHECK_MESSAGE(has(report(tcp + ", " + line, field), "it works only with a serial line (`device`)"), line);
    const auto none = [&](const std::string& kind, const std::string& number) {
      return report(
          tcp, R"("fields": [{"name": "x", "address": 0, "type": ")" + kind + R"(", "no_value": [)" + number + "]}]");
    };
    using Said = std::pair<const char*, const char*>;
    for (const Said& said :
         {Said{"uint16", "65536"}, Said{"uint16", "-32769"}, Said{"int16", "65536"}, Said{"int16", "0.5"},
          Said{"int32", "4294967296"}, Said{"int64", "-1e19"}, Said{"uint64", "2e19"}, Said{"float", "1e39"}})
      CHECK(has(none(said.first, said.second), "can never contain its `no_value`"));
    for (const Said& said : {Said{"uint16", "65535"}, Said{"uint16", "-1"}, Said{"int16", "32768"},
                             Said{"int32", "4294967295"}, Said{"int64", "-1"}, Said{"uint64", "1.8446744073709552e19"},
                             Said{"float", "-9999.9"}, Said{"double", "1e39"}})
      CHECK(none(said.first, said.second).empty());
    const auto one = [&](const std::string& members) {
      return report(tcp, R"("fields": [{"name": "x", "address": 0, )" + members + "}]");
    };
    for (const Said& said :
         {Said{R"("type": "text")", "a text needs `registers`"},
          Said{R"("type": "text", "registers": 126)", "registers"},
          Said{R"("type": "text", "registers": 8, "scale": 2)", "a text is not a number"},
          Said{R"("type": "text", "registers": 8, "no_value": [0])", "a text is not a number"},
          Said{R"("registers": 2)", "only a text can have `registers`"}, Said{R"("bit": 16)", "a uint16 has no bit 16"},
          Said{R"("bit": 64)", "bit"}, Said{R"("type": "float", "bit": 1)", "a float has no bit 1"},
          Said{R"("bit": 1, "scale": 2)", "a single bit is not a number"},
          Said{R"("bit": 1, "mask": 2)", "a single bit is not a number"},
          Said{R"("mask": 65536)", "has none of the bits of its `mask`, or not all"}, Said{R"("mask": 0)", "mask"},
          Said{R"("type": "int16", "mask": 1)", "`mask` works only for numbers without a sign"},
          Said{R"("scale_from": 65536)", "scale_from"}, Said{R"("word_order": "acbd")", "word_order"},
          Said{R"("no_value": [1, 65536])", "never contain its `no_value`"}})
      CHECK_MESSAGE(has(one(said.first), said.second), said.first);
    for (const char* good : {R"("type": "text", "registers": 125)", R"("type": "uint64", "bit": 63)",
                             R"("mask": 65280, "scale": 0.1)", R"("scale_from": 65535, "scale": 0.1)",
                             R"("type": "float", "word_order": "cdab")", R"("no_value": [32768, -1])"})
      CHECK_MESSAGE(one(good).empty(), good);
    CHECK(has(report(tcp, field + R"(, "most_registers": 0)"), "most_registers"));
    CHECK(has(report(tcp, field + R"(, "most_registers": 126)"), "most_registers"));
    CHECK(has(report(tcp, R"("most_registers": 3, "fields": [{"name": "x", "address": 0, "type": "double"}])"),
              "it has 4 registers, but a request may have only 3"));
    CHECK(has(report(tcp, R"("fields": [])"), "there are no fields"));
    CHECK(has(report(tcp, R"("fields": [{"name": "x", "address": 65535, "type": "float"}])"), "beyond address 65535"));
    CHECK(has(report(tcp, R"("fields": [{"name": "x", "address": 0}, {"name": "x", "address": 1}])"), "x"));
    CHECK_THROWS_AS(ModbusBus("b", {}), SetupError);
  }
}

TEST_SUITE_BEGIN("sensors" * doctest::skip(!terminals_can_be_set_up()));

TEST_CASE("US-42 Modbus RTU: units on one line share it; broken, half and missing answers; unplugged and back") {
  Unit first(1), third(3);
  first.mapping().tab_registers[20] = 0xffff;
  first.mapping().tab_registers[21] = 0x8000;
  Rs485Line line({&first, &third});
  Stage stage;
  ModbusBus bus(
      "rs485",
      {.device = line.path(), .serial = {.baud_rate = 115200, .parity = Parity::even}, .answer_timeout = 50ms});
  DriverSensor<Modbus> one(stage.loop, common("one"), bus, {.unit = 1},
                           {.fields = {{.name = "a", .address = 20, .type = Kind::i16},
                                       {.name = "none", .address = 21, .no_value = {0x8000}},
                                       {.name = "b", .address = 22}}});
  DriverSensor<Modbus> three(stage.loop, common("three"), bus, {.unit = 3},
                             {.fields = {{.name = "x", .table = ModbusTable::input, .address = 2, .type = Kind::u32},
                                         {.name = "y", .table = ModbusTable::discrete, .address = 5}}});
  DriverSensor<Modbus> nobody(stage.loop, common("nobody"), bus, {.unit = 9},
                              {.fields = {{.name = "x", .address = 0}}});
  stage.until(
      [&] { return one.counts().published > 3 && three.counts().published > 3 && nobody.health() == Health::faulted; });
  CHECK(terminal_settings(line.device()).output_speed == 115200);
  CHECK(std::count(stage.values.begin(), stage.values.end(), "one: -1 absent 1022") > 3);
  CHECK(std::count(stage.values.begin(), stage.values.end(),
                   "three: " + std::to_string(2002u << 16 | 2003u) + " true") > 3);
  CHECK(stage.has_error("bus rs485, unit 9: no answer within 50 ms: check the device, its wires, `unit`"));
  CHECK(bus.counts(1).transfers > 3);
  CHECK(bus.counts(9).transfers == bus.counts(9).failed);
  nobody.close();

  line.set(Rs485Line::Fault::broken);
  stage.until([&] { return one.counts().unreadable > 0 && three.counts().unreadable > 0; });
  CHECK(stage.has_error("bus rs485, unit 1: the checksum of its answer is wrong"));
  line.set(Rs485Line::Fault::half);
  const std::uint64_t failed = one.counts().failed;
  stage.until([&] { return one.counts().failed > failed + 1; });
  line.set(Rs485Line::Fault::none);
  const auto are_back = [&] {
    const std::uint64_t a = one.counts().published, b = three.counts().published;
    stage.until([&, a, b] {
      return one.counts().published > a + 3 && three.counts().published > b + 3 && one.health() == Health::ok &&
             three.health() == Health::ok;
    });
  };
  are_back();
  line.unplug();
  stage.until([&] { return one.health() == Health::faulted && three.health() == Health::faulted; });
  CHECK(stage.has_error("has disappeared"));
  line.plug_in();
  are_back();
  // Nothing but right values came.
  for (const std::string& value : stage.values)
    CHECK_MESSAGE(
        (value == "one: -1 absent 1022" || value == "three: " + std::to_string(2002u << 16 | 2003u) + " true"), value);
  one.stop();
  three.stop();
  CHECK(one.counts().balances());
  CHECK(three.counts().balances());
  CHECK(stage.loop.runtime().balances());
}

TEST_CASE("US-42 Modbus RTU: an adapter's echo is dropped, and told where it differs or is missing; noise is skipped") {
  Unit third(3);
  Rs485Line line({&third});
  Stage stage;
  line.set(Carrier::Echo::right);
  ModbusBus bus("rs485", {.device = line.path(), .echo = true, .answer_timeout = 50ms});
  ModbusDevice device = bus.device({.unit = 3});
  const std::array<std::uint16_t, 1> one{7};
  device.write_registers(30, one).or_throw();  // answered by what was asked
  std::array<std::uint16_t, 1> back{};
  device.read_registers(ModbusTable::holding, 30, back).or_throw();
  CHECK(back == one);
  DriverSensor<Modbus> meter(stage.loop, common("meter"), bus, {.unit = 3},
                             {.fields = {{.name = "a", .address = 20}, {.name = "b", .address = 21}}});
  stage.until([&] { return meter.counts().published > 5; });
  CHECK(stage.errors.empty());
  CHECK(bus.counts(3).skipped_bytes == 0);
  line.set(Carrier::Fault::noise);
  stage.until([&] { return bus.counts(3).skipped_bytes >= 9; });
  CHECK(stage.errors.empty());
  line.set(Carrier::Fault::none);

  line.set(Carrier::Echo::wrong);
  stage.until([&] { return stage.has_error("bus rs485: the returned bytes differ from the sent bytes"); });
  CHECK(meter.counts().unreadable > 0);
  line.set(Carrier::Fault::silent);
  line.set(Carrier::Echo::none);
  stage.until([&] { return stage.has_error("bus rs485: the sent bytes did not come back within 50 ms"); });
  line.set(Carrier::Fault::none);
  line.set(Carrier::Echo::right);
  const std::uint64_t published = meter.counts().published;
  stage.until([&] { return meter.counts().published > published + 3; });
  for (const std::string& value : stage.values) CHECK_MESSAGE(value == "meter: 1020 1021", value);
  meter.stop();
  CHECK(meter.counts().balances());
}

TEST_SUITE_END();

#endif
