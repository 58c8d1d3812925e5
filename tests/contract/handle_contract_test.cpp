// The rules of handle.hpp, each one test run over every type of handle. A new type is one more entry below and in
// HANDLES: docs_test.py holds the public headers to that, but for those that it has a reason to leave out.
#include <doctest/doctest.h>
#include <fcntl.h>
#include <sys/socket.h>
#include <unistd.h>
#include <uv.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "contract/host.hpp"
#include "data/payloads.hpp"
#include "loop/core/loop_core.hpp"
#include "recording/database.hpp"
#include "rtdata/chips/lm75.hpp"
#include "rtdata/fsm/machine.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/recording/replay.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/analog.hpp"
#include "rtdata/sensors/command.hpp"
#include "rtdata/sensors/counter.hpp"
#include "rtdata/sensors/derived.hpp"
#include "rtdata/sensors/driver.hpp"
#include "rtdata/sensors/edge.hpp"
#include "rtdata/sensors/encoder.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/gps.hpp"
#include "rtdata/sensors/host.hpp"
#include "rtdata/sensors/iio.hpp"
#include "rtdata/sensors/levels.hpp"
#include "rtdata/sensors/limit.hpp"
#include "rtdata/sensors/lines.hpp"
#include "rtdata/sensors/pps.hpp"
#include "rtdata/sensors/serial_line.hpp"
#include "rtdata/sensors/tcp_lines.hpp"
#include "rtdata/sensors/trigger.hpp"
#include "rtdata/sensors/udp_lines.hpp"
#include "rtdata/sensors/vertical.hpp"
#include "rtdata/sensors/w1.hpp"
#include "rtdata/sinks/console.hpp"
#include "rtdata/sinks/file.hpp"
#include "rtdata/sinks/sink.hpp"
#include "rtdata/sinks/tcp.hpp"
#include "rtdata/sinks/udp.hpp"
#include "rtdata/testing/fake_gpio.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "sensors/fake_gpsd.hpp"
#include "sensors/fixture.hpp"
#include "sensors/pty.hpp"
#include "sinks/sink_kinds.hpp"
#ifdef RTDATA_WITH_HTTP
#include "rtdata/sensors/http.hpp"
#include "rtdata/sinks/http.hpp"
#endif
#ifdef RTDATA_WITH_MQTT
#include "rtdata/sensors/mqtt.hpp"
#include "rtdata/sinks/mqtt.hpp"
#endif
#ifdef RTDATA_WITH_POSTGRESQL
#include "rtdata/postgresql/sink.hpp"
#endif

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;
using payloads::Climate;

namespace {

/// A callback that counts, may do something more, and whose captures can be seen to go.
struct Probe {
  std::shared_ptr<int> token = std::make_shared<int>(0);
  std::weak_ptr<int> seen = token;
  int calls = 0;
  std::function<void()> action;
  bool captures_are_gone() const { return seen.expired(); }
  auto callback() {
    return [this, held = std::move(token)] {
      ++calls;
      ++*held;
      if (action) action();
      ++*held;  // the captures live for as long as the callback is on the stack
    };
  }
};

/// The probe's callback is the handler of its errors.
template <class Type>
Type heard(Type made, Probe& probe) {
  made.on_error([f = probe.callback()](const ErrorReport&) mutable { f(); });
  return made;
}

// An entry: how to make a handle whose callback is the probe's, and how to make it be called again and again.

struct OfTimer {
  using Type = Timer;
  Type make(Loop& loop, Probe& probe) { return Timer(loop, 0ns, probe.callback()); }
  void provoke(Loop&, Type& handle) { handle.start(0ns); }
};
struct OfTicker {
  using Type = Ticker;
  Type make(Loop& loop, Probe& probe) {
    return Ticker(loop, 1ms, [f = probe.callback()](const Tick&) mutable { f(); });
  }
  void provoke(Loop&, Type&) {}
};
struct OfFdWatch {
  using Type = FdWatch;
  int fds[2];
  OfFdWatch() { REQUIRE(::socketpair(AF_UNIX, SOCK_STREAM, 0, fds) == 0); }
  ~OfFdWatch() {
    ::close(fds[0]);
    ::close(fds[1]);
  }
  Type make(Loop& loop, Probe& probe) {
    REQUIRE(::write(fds[1], "x", 1) == 1);  // never read: readable from now on
    return FdWatch(loop, fds[0], FdWatch::readable, [f = probe.callback()](const FdEvent&) mutable { f(); });
  }
  void provoke(Loop&, Type&) {}
};
struct OfSignalWatch {
  using Type = SignalWatch;
  OfSignalWatch() { std::signal(SIGUSR1, SIG_IGN); }  // as it must not end the tests when nothing watches it any more
  Type make(Loop& loop, Probe& probe) {
    Type made(loop, SIGUSR1, probe.callback());
    std::raise(SIGUSR1);
    return made;
  }
  void provoke(Loop&, Type& handle) {
    if (handle.is_open()) std::raise(SIGUSR1);
  }
};
struct OfTypedSubscription {
  using Type = Subscription;
  Type make(Loop& loop, Probe& probe) {
    auto made = loop.topic<Climate>("t").subscribe(loop,
                                                   [f = probe.callback()](const Event<Climate>&) mutable { f(); });
    provoke(loop, made);
    return made;
  }
  void provoke(Loop& loop, Type&) { loop.topic<Climate>("t").publish({}); }
};
struct OfViewSubscription {
  using Type = Subscription;
  Type make(Loop& loop, Probe& probe) {
    auto made = loop.subscribe("+", [f = probe.callback()](const EventView&) mutable { f(); });
    provoke(loop, made);
    return made;
  }
  void provoke(Loop& loop, Type&) { loop.topic<Climate>("t").publish({}); }
};
struct OfSensor {
  using Type = Sensor<Climate>;
  Type make(Loop& loop, Probe& probe) {
    return Sensor<Climate>(loop, {.name = "s", .rate = 1_kHz}, [f = probe.callback()]() mutable {
      f();
      return Climate{};
    });
  }
  void provoke(Loop&, Type&) {}
};
struct OfFeed {
  using Type = Feed<Climate>;  // its callback is the handler of its errors
  Type make(Loop& loop, Probe& probe) {
    Feed<Climate> made(loop, {.name = "f"});
    made.on_error([f = probe.callback()](const ErrorReport&) mutable { f(); });
    current = &made;
    return made;
  }
  void provoke(Loop& loop, Type& handle) {
    // Called from the loop, as a parser on a port would.
    timer = Timer(loop, 0ns, [&handle] { handle.fail({Errc::bad_data, "bad", "", "", ""}); });
  }
  Type* current = nullptr;
  Timer timer;
};

struct OfAnalogSensor {
  using Type = AnalogSensor;  // on a lane; as with those below, its callback is the handler of its errors
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "a", .rate = 1_kHz}, {.file = "/nowhere/in_voltage0_raw"}), probe);
  }
  void provoke(Loop&, Type&) {}
};
struct OfEncoderSensor {
  using Type = EncoderSensor;  // as the one before: there is no such counter
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "e", .rate = 1_kHz}, {.root = "/nowhere"}), probe);
  }
  void provoke(Loop&, Type&) {}
};
struct OfW1Sensor {
  using Type = W1Sensor;  // as the one before: there is no such thermometer
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "w", .rate = 1_kHz}, {.device = "28-1", .root = "/nowhere"}), probe);
  }
  void provoke(Loop&, Type&) {}
};
struct OfDerivedSensor {
  using Type = DerivedSensor;  // it divides by the zero that it is given
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "d"}, {.on = "zeros", .expression = "1 / temperature"}), probe);
  }
  void provoke(Loop& loop, Type&) { loop.topic<Climate>("zeros").publish({}); }
};
struct OfTriggerSensor {
  using Type = TriggerSensor;  // its condition divides by zero
  Type make(Loop& loop, Probe& probe) {
    (void)loop.topic<Climate>("zeros");
    return heard(Type(loop, {.name = "trigger"}, {.on = "zeros", .when = "1 / temperature > 0"}), probe);
  }
  void provoke(Loop& loop, Type&) { loop.topic<Climate>("zeros").publish({}); }
};
struct OfLimitSensor {
  using Type = LimitSensor;  // the topic has no such number
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "l"}, {.on = "zeros", .field = "none", .high = 1}), probe);
  }
  void provoke(Loop& loop, Type&) { loop.topic<Climate>("zeros").publish({}); }
};
struct OfMachine {
  using Type = fsm::Machine;  // its callback is a condition
  Type make(Loop& loop, Probe& probe) {
    Type made(loop, {.name = "machine", .start = "a"});
    made.add_state("a");
    made.add_transition({.from = "a", .to = "a", .when = [f = probe.callback()]() mutable {
                           f();
                           return false;
                         }});
    made.start();
    return made;
  }
  void provoke(Loop& loop, Type& handle) {
    timer = Timer(loop, 0ns, [&handle] { handle.look(); });
  }
  Timer timer;
};
struct OfOutput {
  using Type = Output;  // its device refuses each value but the safe one
  struct Refusing final : Actuator {
    int refused = 0;
    Result<void> open(std::optional<double>) override { return {}; }
    Result<void> set(double value) override {
      if (value == 0) return {};
      return Error{Errc::io_failed, "cannot set", "", "it is broken in way " + std::to_string(++refused), ""};
    }
  };
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "output"}, [] { return std::make_unique<Refusing>(); }), probe);
  }
  void provoke(Loop& loop, Type& handle) {
    // Again and again: what has failed takes no value until it is safe.
    ticker = Ticker(loop, 1ms, [&handle](const Tick&) { (void)handle.set(1); });
  }
  Ticker ticker;
};
/// It controls its input with a PID controller.
struct OfController {
  using Type = Output;
  Type make(Loop& loop, Probe& probe) {
    (void)loop.topic<Climate>("t");
    return heard(Type(loop, {.name = "controller", .on = "t", .expression = "temperature", .pid = PidConfig{.kp = 1}},
                      [] { return std::make_unique<OfOutput::Refusing>(); }),
                 probe);
  }
  void provoke(Loop& loop, Type&) {
    ticker = Ticker(loop, 1ms, [&loop](const Tick&) { loop.topic<Climate>("t").publish({-1, 0}); });
  }
  Ticker ticker;
};
struct OfIioSensor {
  using Type = IioSensor;
  Type make(Loop& loop, Probe& probe) {
    return heard(
        Type(loop, {.name = "i", .rate = 1_kHz}, {.device = "adc", .channels = {"voltage0"}, .root = "/nowhere"}),
        probe);
  }
  void provoke(Loop&, Type&) {}
};
struct OfDriverSensor {
  using Type = DriverSensor<Lm75>;  // on a bus without a chip
  Type make(Loop& loop, Probe& probe) { return heard(Type(loop, {.name = "d", .rate = 1_kHz}, bus), probe); }
  void provoke(Loop&, Type&) {}
  I2cBus bus{"i2c1", std::make_shared<FakeI2c>()};
};
struct OfLevelsSensor {
  using Type = LevelsSensor;  // of a chip that is not there
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "v", .rate = 1_kHz}, {.lines = {{.name = "x", .line = 3}}}, pins), probe);
  }
  void provoke(Loop&, Type&) {}
  std::shared_ptr<FakeGpio> pins = std::make_shared<FakeGpio>();
};
struct OfHostSensor {
  using Type = HostSensor;  // inline; its /proc/stat is none
  OfHostSensor() {
    std::filesystem::create_directory(directory.file("proc"));
    std::ofstream(directory.file("proc/stat")) << "no numbers\n";
  }
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "h", .rate = 1_kHz}, {.quantity = HostQuantity::cpu, .root = directory.file("")}),
                 probe);
  }
  void provoke(Loop&, Type&) {}
  ScratchDirectory directory;
};
struct OfSerialLineSensor {
  using Type = SerialLineSensor;
  OfSerialLineSensor() { pty.plug_in(); }
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "l"},
                      {.device = pty.path(), .lines = {.fields = {{.name = "value"}}, .first_line = FirstLine::keep}}),
                 probe);
  }
  void provoke(Loop&, Type&) { REQUIRE(pty.send("no number\n") > 0); }
  ScratchDirectory directory;
  Pty pty{directory.file("tty")};
};
struct OfGpsSensor {
  using Type = GpsSensor;
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "g"}, {.host = "127.0.0.1", .port = gpsd.port()}), probe);
  }
  void provoke(Loop&, Type&) {
    gpsd.accept();
    REQUIRE(gpsd.send("garbage\n"));
  }
  FakeGpsd gpsd;
};
/// A line that is driven each time it is to speak.
struct OfGpio {
  OfGpio() { pins->add_chip("gpiochip0", 4); }
  void drive(Loop& loop) {
    level = !level;
    pins->drive("gpiochip0", 2, level, loop.core().now());
  }
  std::shared_ptr<FakeGpio> pins = std::make_shared<FakeGpio>();
  bool level = false;
};
struct OfGpioEdges : OfGpio {
  using Type = GpioEdges;
  Type make(Loop& loop, Probe& probe) {
    Type made(
        loop, {.line = 2}, [f = probe.callback()](const GpioEdge&) mutable { f(); }, pins);
    drive(loop);
    return made;
  }
  void provoke(Loop& loop, Type&) { drive(loop); }
};
struct OfEdgeSensor : OfGpio {
  using Type = EdgeSensor;  // its callback is the handler of its errors: the chip goes away
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "e"}, {.input = {.line = 2}, .retry_first = 1ms, .retry_longest = 1ms}, pins),
                 probe);
  }
  void provoke(Loop&, Type&) {
    pins->unplug("gpiochip0", true);
    pins->plug_in("gpiochip0");
  }
};
struct OfCounterSensor : OfGpio {
  using Type = CounterSensor;
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "n", .rate = 1_kHz}, {.input = {.line = 3}}, pins), probe);
  }
  void provoke(Loop&, Type&) { pins->unplug("gpiochip0", true); }
};
struct OfVerticalSensor {
  using Type = VerticalSensor;  // what the topic has is no height
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "v"}, {.barometer = "zeros", .height = "humidity"}), probe);
  }
  void provoke(Loop& loop, Type&) { loop.topic<Climate>("zeros").publish({}); }
};

// Of devices that are not there, and are looked for again and again.

struct OfPpsSensor {
  using Type = PpsSensor;
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "p"}, {.root = "/nowhere", .retry_first = 1ms, .retry_longest = 1ms}), probe);
  }
  void provoke(Loop&, Type&) {}
};
struct OfIioBufferSensor {
  using Type = IioBufferSensor;
  Type make(Loop& loop, Probe& probe) {
    return heard(
        Type(loop, {.name = "b"},
             {.device = "adc", .channels = {"voltage0"}, .root = "/nowhere", .retry_first = 1ms, .retry_longest = 1ms}),
        probe);
  }
  void provoke(Loop&, Type&) {}
};
const LineConfig hasty_lines = {.fields = {{.name = "value"}}, .retry_first = 1ms, .retry_longest = 1ms};
struct OfCommandSensor {
  using Type = CommandSensor;
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "c"}, {.run = {"/nowhere/program"}, .lines = hasty_lines}), probe);
  }
  void provoke(Loop&, Type&) {}
};
struct OfUdpLines {
  using Type = UdpLines;  // this machine has no such address
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "u"}, {.port = 5005, .address = "192.0.2.1", .lines = hasty_lines}), probe);
  }
  void provoke(Loop&, Type&) {}
};
/// A port of this machine at which nobody listens.
struct RefusedPort {
  RefusedPort() { server.vanish(); }
  std::uint16_t port() const { return server.port(); }
  std::string url() const { return "http://127.0.0.1:" + std::to_string(port()) + "/"; }

 private:
  FakeGpsd server;
};
struct OfTcpLines {
  using Type = TcpLines;
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "l"}, {.host = "127.0.0.1", .port = refused.port(), .lines = hasty_lines}), probe);
  }
  void provoke(Loop&, Type&) {}
  RefusedPort refused;
};
#ifdef RTDATA_WITH_HTTP
struct OfHttpSensor {
  using Type = HttpSensor;
  Type make(Loop& loop, Probe& probe) {
    return heard(
        Type(loop, {.name = "h", .rate = 1_kHz}, {.server = {.url = refused.url()}, .fields = {{.name = "v"}}}), probe);
  }
  void provoke(Loop&, Type&) {}
  RefusedPort refused;
};
#define HTTP_HANDLES , OfHttpSensor, OfHttpSink
#else
#define HTTP_HANDLES
#endif
#ifdef RTDATA_WITH_MQTT
struct OfMqttSensor {
  using Type = MqttSensor;
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "m"},
                      {.broker = {.host = "127.0.0.1", .port = refused.port()},
                       .topics = {"a"},
                       .fields = {{.name = "v"}},
                       .retry_first = 1ms,
                       .retry_longest = 1ms}),
                 probe);
  }
  void provoke(Loop&, Type&) {}
  RefusedPort refused;
};
#define MQTT_HANDLES , OfMqttSensor, OfMqttSink
#else
#define MQTT_HANDLES
#endif

/// Its callback hears of the end, which comes once: of rule 8, that it is called again after it threw does not apply.
struct OfReplay {
  using Type = Replay;
  static constexpr bool is_called_once = true;
  /// Of one event.
  static const std::string& recording() {
    static const sinks::Directory directory;
    static const std::string path = [] {
      Loop loop(Loop::Manual{});
      be_quiet(loop);
      SqliteSink sink(loop, {.path = directory / "run.db"});
      loop.topic<Climate>("t").publish({});
      return directory / "run.db";
    }();
    return path;
  }
  Type make(Loop& loop, Probe& probe) {
    Type made(loop, {.file = recording()});
    made.on_done([f = probe.callback()](const Result<void>&) mutable { f(); });
    return made;
  }
  void provoke(Loop&, Type&) {}
};

// Each of the sinks fails with what it is given, and tries again at once.

struct OfSink {
  using Type = Sink;
  struct Broken final : Writer {
    Result<void> open() override { return {}; }
    Result<void> write(Batch&) override { return Error{Errc::storage_full, "cannot store", "", "", ""}; }
  };
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.name = "broken", .close_deadline = 0ns}, std::make_unique<Broken>()), probe);
  }
  void provoke(Loop& loop, Sink& handle) {
    loop.topic<Climate>("t").publish({});
    handle.flush();
  }
};
SinkConfig hasty_sink() { return {.name = "sink", .retry_first = 1ms, .retry_longest = 1ms, .close_deadline = 10ms}; }
struct OfFileSink {
  using Type = FileSink;  // raw bytes have no absent values
  struct Absent {
    std::optional<double> value;
    RTDATA_FIELDS(Absent, (value))
  };
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.path = directory / "run", .format = "raw", .sink = hasty_sink()}), probe);
  }
  void provoke(Loop& loop, Type& handle) {
    loop.topic<Absent>("t").publish({});
    handle.flush();
  }
  sinks::Directory directory;
};
struct OfSqliteSink : OfSink {
  using Type = SqliteSink;  // somebody else has made the table
  Type make(Loop& loop, Probe& probe) {
    Type made(loop, {.path = directory / "run.db", .profile = SqliteProfile::fast, .sink = hasty_sink()});
    sqlite::Database::open(directory / "run.db", sqlite::Database::Mode::write).execute("CREATE TABLE t (x)");
    return heard(std::move(made), probe);
  }
  sinks::Directory directory;
};
struct OfConsoleSink : OfSink {
  using Type = ConsoleSink;
  ~OfConsoleSink() { ::close(full); }
  Type make(Loop& loop, Probe& probe) { return heard(Type(loop, {.descriptor = full, .sink = hasty_sink()}), probe); }
  int full = ::open("/dev/full", O_WRONLY | O_CLOEXEC);
};
struct OfTcpSink : OfSink {
  using Type = TcpSink;
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.host = "127.0.0.1", .port = refused.port(), .sink = hasty_sink()}), probe);
  }
  RefusedPort refused;
};
struct OfUdpSink : OfSink {
  using Type = UdpSink;
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.host = "127.0.0.1", .port = refused.port(), .sink = hasty_sink()}), probe);
  }
  RefusedPort refused;
};
#ifdef RTDATA_WITH_HTTP
struct OfHttpSink : OfSink {
  using Type = HttpSink;
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.server = {.url = refused.url()}, .sink = hasty_sink()}), probe);
  }
  RefusedPort refused;
};
#endif
#ifdef RTDATA_WITH_MQTT
struct OfMqttSink : OfSink {
  using Type = MqttSink;
  Type make(Loop& loop, Probe& probe) {
    return heard(Type(loop, {.broker = {.host = "127.0.0.1", .port = refused.port()}, .sink = hasty_sink()}), probe);
  }
  RefusedPort refused;
};
#endif
#ifdef RTDATA_WITH_POSTGRESQL
struct OfPostgresqlSink : OfSink {
  using Type = PostgresqlSink;
  Type make(Loop& loop, Probe& probe) {
    return heard(
        Type(loop,
             {.host = "127.0.0.1", .port = refused.port(), .database = "none", .user = "nobody", .sink = hasty_sink()}),
        probe);
  }
  RefusedPort refused;
};
#define POSTGRESQL_HANDLES , OfPostgresqlSink
#else
#define POSTGRESQL_HANDLES
#endif

#define HANDLES                                                                                                      \
  OfTimer, OfTicker, OfFdWatch, OfSignalWatch, OfTypedSubscription, OfViewSubscription, OfSensor, OfFeed,            \
      OfDerivedSensor, OfTriggerSensor, OfLimitSensor, OfMachine, OfOutput, OfController, OfAnalogSensor,            \
      OfEncoderSensor, OfW1Sensor, OfIioSensor, OfDriverSensor, OfLevelsSensor, OfHostSensor, OfSerialLineSensor,    \
      OfGpsSensor, OfGpioEdges, OfEdgeSensor, OfCounterSensor, OfVerticalSensor, OfPpsSensor, OfIioBufferSensor,     \
      OfCommandSensor, OfUdpLines, OfTcpLines, OfReplay, OfSink, OfFileSink, OfSqliteSink, OfConsoleSink, OfTcpSink, \
      OfUdpSink HTTP_HANDLES MQTT_HANDLES POSTGRESQL_HANDLES
/// Of these, those that have a verb `finish`, and others that are given something to call; a kind each of sinks.
#define FINISHED OfOutput, OfController, OfSink, OfFileSink, OfConsoleSink, OfTcpSink

/// Lets a real loop run until `done`, or some turns long when it is never done; true when it was.
template <class Done>
bool turn(Loop& loop, Done done) {
  for (int turns = 0; turns < 20'000; ++turns) {
    if (done()) return true;
    loop.run_for(200us);
  }
  return done();
}

struct Quiet {
  Loop loop;
  Quiet() {
    loop.on_error([](const ErrorReport&) {});
    be_quiet(loop);
  }
};

/// Armed at the end. `finish` has a test of its own.
void use_verbs_of_output(Output& output) {
  const bool is_controller = output.change_setpoint(20).has_value();
  CHECK(output.is_setpoint_commanded() == is_controller);
  CHECK(output.change_pid({.kp = 2}).has_value() == is_controller);
  CHECK(output.disarm("test"));
  CHECK_FALSE(output.is_armed());
  CHECK(output.set(1).error().code == (is_controller ? Errc::bad_argument : Errc::not_permitted));
  CHECK(output.arm("test"));
  CHECK(output.is_armed());
  output.when_published([] {});
  output.when_taken([](const Result<void>&) {});
}

/// Every verb of a handle but close, with what keeps it going at the end.
template <class Type>
void use_verbs(Type& handle) {
  if constexpr (std::is_same_v<Type, Timer>) {
    handle.stop();
    CHECK_FALSE(handle.is_running());
    handle.start(1h);
    CHECK(handle.is_running());
  } else if constexpr (std::is_same_v<Type, Ticker>) {
    handle.stop();
    handle.set_period(2ms);
    handle.start();
    CHECK(handle.fired() > 0);
  } else if constexpr (std::is_same_v<Type, FdWatch>) {
    handle.set_events(FdWatch::writable);
    handle.set_events(FdWatch::readable);
  } else if constexpr (std::is_same_v<Type, Subscription>) {
    handle.set_name("x");
    CHECK(handle.counts().offered > 0);
  } else if constexpr (std::is_base_of_v<Sink, Type>) {
    handle.flush();
    handle.sync([] {});
    CHECK(handle.counts().offered > 0);
    CHECK_FALSE(handle.status().name.empty());
  } else if constexpr (std::is_same_v<Type, Replay>) {
    CHECK(handle.is_done());
    CHECK(handle.counts().events == 1);
    CHECK(handle.run() == 1);
  } else if constexpr (std::is_same_v<Type, GpioEdges>) {
    handle.take_waiting();
    handle.on_error([](const ErrorReport&) {});
    CHECK(handle.read().has_value());
    CHECK_FALSE(handle.failure());
    CHECK(handle.counts().edges > 0);
  } else if constexpr (std::is_same_v<Type, fsm::Machine>) {
    handle.add_state("b");
    handle.raise("nothing");
    handle.look();
    CHECK(handle.remove_transitions("a", "b") == 0);
    handle.remove_state("b");
    CHECK(handle.counts().events > 0);
    CHECK(handle.state() == "a");
  } else if constexpr (!std::is_same_v<Type, SignalWatch>) {
    if (handle.rate())
      handle.set_rate(1_kHz);
    else
      CHECK_THROWS_AS(handle.set_rate(1_kHz), SetupError);
    handle.set_processing({});
    if constexpr (std::is_same_v<Type, Output>) use_verbs_of_output(handle);
    handle.stop();
    CHECK_FALSE(handle.is_running());
    handle.start();
    CHECK(handle.is_running());
    CHECK_FALSE(handle.status().name.empty());
  }
}

}  // namespace

TEST_SUITE("contract") {
  TEST_CASE_TEMPLATE("handle rule 1: a handle is a move-only value, and moving keeps it going", Of, HANDLES) {
    using Type = typename Of::Type;
    static_assert(!std::is_copy_constructible_v<Type> && !std::is_copy_assignable_v<Type>);
    static_assert(std::is_nothrow_move_constructible_v<Type> && std::is_nothrow_move_assignable_v<Type>);
    static_assert(std::is_nothrow_default_constructible_v<Type>);
    Quiet quiet;
    Of of;
    Probe probe;
    Type first = of.make(quiet.loop, probe);
    Type second = std::move(first);
    Type third;
    third = std::move(second);
    CHECK(third.is_open());
    of.provoke(quiet.loop, third);
    CHECK(turn(quiet.loop, [&] { return probe.calls > 0; }));
  }

  TEST_CASE_TEMPLATE("handle rule 2: after close the callback never runs again and its captures are gone", Of,
                     HANDLES) {
    Quiet quiet;
    Of of;
    Probe probe;
    auto handle = of.make(quiet.loop, probe);
    of.provoke(quiet.loop, handle);
    REQUIRE(turn(quiet.loop, [&] { return probe.calls > 0; }));
    of.provoke(quiet.loop, handle);  // one more is on its way
    handle.close();
    CHECK(probe.captures_are_gone());
    const int calls = probe.calls;
    quiet.loop.run_for(3ms);
    CHECK(probe.calls == calls);
    CHECK_FALSE(handle.is_open());
  }

  TEST_CASE_TEMPLATE("handle rule 2: the destructor does the same, also of one that never ran", Of, HANDLES) {
    Quiet quiet;
    Of of;
    Probe probe;
    { auto handle = of.make(quiet.loop, probe); }
    CHECK(probe.captures_are_gone());
    quiet.loop.run_for(3ms);
    CHECK(probe.calls == 0);
  }

  TEST_CASE_TEMPLATE("handle rule 3: it may be destroyed from its own callback", Of, HANDLES) {
    Quiet quiet;
    Of of;
    Probe probe;
    std::optional<typename Of::Type> handle(of.make(quiet.loop, probe));
    bool lived_in_callback = false;
    probe.action = [&] {
      handle.reset();
      lived_in_callback = !probe.captures_are_gone();
    };
    of.provoke(quiet.loop, *handle);
    REQUIRE(turn(quiet.loop, [&] { return probe.calls > 0; }));
    quiet.loop.run_for(3ms);
    CHECK(probe.calls == 1);
    CHECK(lived_in_callback);
    CHECK(probe.captures_are_gone());
  }

  TEST_CASE_TEMPLATE("handle rule 3: it may be replaced by a new one from its own callback", Of, HANDLES) {
    Quiet quiet;
    Of of;
    Probe probe;
    auto handle = of.make(quiet.loop, probe);
    probe.action = [&] { handle = typename Of::Type(); };
    of.provoke(quiet.loop, handle);
    REQUIRE(turn(quiet.loop, [&] { return probe.calls > 0; }));
    quiet.loop.run_for(3ms);
    CHECK(probe.calls == 1);
    CHECK(probe.captures_are_gone());
  }

  TEST_CASE_TEMPLATE("handle rule 3: it may be destroyed from another handle's callback", Of, HANDLES) {
    Quiet quiet;
    auto of = std::make_unique<Of>();
    Probe probe;
    std::optional<typename Of::Type> handle(of->make(quiet.loop, probe));
    of->provoke(quiet.loop, *handle);
    int calls_then = -1;
    const auto destroy = [&] {
      if (handle) of->provoke(quiet.loop, *handle);
      handle.reset();
      if (calls_then < 0) calls_then = probe.calls;
      CHECK(probe.captures_are_gone());
    };
    const auto destroyed_in_time = [&] {
      CHECK(turn(quiet.loop, [&] { return calls_then >= 0; }));
      quiet.loop.run_for(3ms);
    };
    SUBCASE("a timer's") {
      Timer other(quiet.loop, 0ns, destroy);
      destroyed_in_time();
    }
    SUBCASE("a subscription's") {
      const auto topic = quiet.loop.topic<Climate>("other");
      auto other = topic.subscribe(quiet.loop, [&](const Event<Climate>&) { destroy(); });
      topic.publish({});
      destroyed_in_time();
    }
    SUBCASE("a sensor's of the same rate") {
      Sensor<Climate> other(quiet.loop, {.name = "other", .rate = 1_kHz}, [&] {
        destroy();
        return Climate{};
      });
      destroyed_in_time();
    }
    SUBCASE("a posted function") {
      quiet.loop.post(destroy);
      destroyed_in_time();
    }
    CHECK(probe.calls == calls_then);
  }

  TEST_CASE_TEMPLATE("handle rule 4: one that outlives its loop is closed and harmless", Of, HANDLES) {
    Of of;
    Probe probe;
    typename Of::Type handle;
    {
      Quiet quiet;
      handle = of.make(quiet.loop, probe);
      of.provoke(quiet.loop, handle);
    }
    CHECK(probe.captures_are_gone());
    CHECK_FALSE(handle.is_open());
    auto moved = std::move(handle);
    moved.close();
    CHECK_FALSE(moved.is_open());
  }

  TEST_CASE("handle rule 4: one that looks up the name of its host may outlive its loop too") {
    constexpr const char* host = "nobody.invalid";
    TcpLines lines;
    GpsSensor gps;
    TcpSink tcp;
    UdpSink udp;
    {
      Quiet quiet;
      lines = TcpLines(quiet.loop, {.name = "lines"}, {.host = host, .port = 9, .lines = hasty_lines});
      gps = GpsSensor(quiet.loop, {.name = "gps"}, {.host = host});
      SinkConfig config = hasty_sink();
      tcp = TcpSink(quiet.loop, {.host = host, .port = 9, .sink = config});
      config.name = "udp";
      udp = UdpSink(quiet.loop, {.host = host, .port = 9, .sink = config});
      quiet.loop.topic<Climate>("t").publish({});
      tcp.flush();
      udp.flush();
      quiet.loop.run_for(1ms);
    }
    CHECK_FALSE((lines.is_open() || gps.is_open() || tcp.is_open() || udp.is_open()));
  }

  TEST_CASE_TEMPLATE("handle rule 5: a moved-from and a default-made one are closed and harmless", Of, HANDLES) {
    using Type = typename Of::Type;
    Quiet quiet;
    Of of;
    Probe probe;
    Type handle = of.make(quiet.loop, probe);
    Type other = std::move(handle);
    Type never;
    for (Type* closed : {&handle, &never}) {
      CHECK_FALSE(closed->is_open());
      closed->close();
      if constexpr (std::is_same_v<Type, Timer>) {
        closed->start(1ms);
        closed->stop();
        CHECK_FALSE(closed->is_running());
      } else if constexpr (std::is_same_v<Type, Ticker>) {
        closed->start();
        closed->stop();
        closed->set_period(1ms);
        CHECK(closed->fired() + closed->missed() + closed->times().count == 0);
      } else if constexpr (std::is_same_v<Type, FdWatch>) {
        closed->set_events(FdWatch::writable);
      } else if constexpr (std::is_same_v<Type, Subscription>) {
        closed->set_name("x");
        CHECK(closed->counts().offered + closed->times().count == 0);
      } else if constexpr (std::is_base_of_v<Sink, Type>) {
        closed->flush();
        closed->sync([] { FAIL_CHECK("it was called"); });
        std::optional<std::uint64_t> lost;
        closed->finish([&](std::uint64_t count) { lost = count; });
        CHECK(lost == 0);
        closed->end_before("another");
        closed->on_error([](const ErrorReport&) {});
        CHECK(closed->counts().offered == 0);
        CHECK(closed->status().name.empty());
      } else if constexpr (std::is_same_v<Type, Replay>) {
        closed->on_done([](const Result<void>&) {});
        CHECK(closed->is_done());
        CHECK(closed->counts().events == 0);
        CHECK(closed->run() == 0);
      } else if constexpr (std::is_same_v<Type, GpioEdges>) {
        closed->take_waiting();
        closed->on_error([](const ErrorReport&) {});
        CHECK(closed->read().error().code == Errc::closed);
        CHECK_FALSE(closed->failure());
        CHECK(closed->counts().edges == 0);
      } else if constexpr (std::is_same_v<Type, fsm::Machine>) {
        closed->start();
        closed->start_in("a");
        closed->raise("nothing");
        closed->look();
        closed->add_state("a");
        closed->add_transition({.from = "a", .to = "a"});
        CHECK(closed->remove_transitions("a", "a") == 0);
        closed->remove_state("a");
        CHECK(closed->state().empty());
        CHECK(closed->counts().events == 0);
        CHECK(closed->graph().states.empty());
      } else if constexpr (!std::is_same_v<Type, SignalWatch>) {
        closed->start();
        closed->stop();
        closed->set_rate(1_kHz);
        closed->set_processing({});
        CHECK(closed->counts().scheduled + closed->times().count == 0);
        CHECK_FALSE(closed->is_running());
        closed->on_error([](const ErrorReport&) {});
        CHECK(closed->status().name.empty());
        if constexpr (std::is_same_v<Type, Feed<Climate>>) closed->publish({});
        if constexpr (std::is_same_v<Type, Output>) {
          for (const Result<void>& done : {closed->set(1), closed->arm("test"), closed->disarm("test"),
                                           closed->change_pid({}), closed->change_setpoint(1)})
            CHECK(done.error().code == Errc::closed);
          const auto is_not_called = [] { FAIL_CHECK("it was called"); };
          closed->finish(is_not_called);
          closed->when_published(is_not_called);
          closed->when_taken([=](const Result<void>&) { is_not_called(); });
          CHECK_FALSE(closed->is_armed());
        }
      }
    }
    CHECK(other.is_open());
  }

  TEST_CASE_TEMPLATE("handle rule 6: closing twice is closing once", Of, HANDLES) {
    Quiet quiet;
    Of of;
    Probe probe;
    auto handle = of.make(quiet.loop, probe);
    handle.close();
    handle.close();
    CHECK_FALSE(handle);
    quiet.loop.run_for(1ms);
    handle.close();
    CHECK(probe.calls == 0);
  }

  TEST_CASE_TEMPLATE("handle rule 7: no kind of handle closes, stops or gives data to anything of its host's", Of,
                     HANDLES) {
    Of of;
    Probe probe;
    rtdata::test::Host host;
    uv_idle_start(&host.idle, [](uv_idle_t*) {});  // it has work: uv_run polls
    const auto before = host.walk();
    const auto is_as_before = [&] {
      const auto now = host.walk();
      for (const auto& [handle, seen] : before)
        if (!now.contains(handle) || !(now.at(handle) == seen)) return false;
      return host.loop.data == &host.marks[0];
    };
    {
      Loop loop(&host.loop);
      loop.on_error([](const ErrorReport&) {});
      be_quiet(loop);
      auto handle = of.make(loop, probe);
      of.provoke(loop, handle);
      for (int turns = 0; turns < 20'000 && probe.calls == 0; ++turns) {
        uv_run(&host.loop, UV_RUN_NOWAIT);
        ::usleep(200);
      }
      CHECK(probe.calls > 0);
      CHECK(is_as_before());
      handle.close();
      uv_run(&host.loop, UV_RUN_NOWAIT);
      CHECK(is_as_before());
    }
    for (int turns = 0; turns < 10; ++turns) uv_run(&host.loop, UV_RUN_NOWAIT);
    CHECK(host.walk() == before);
    uv_idle_stop(&host.idle);
    CHECK(uv_run(&host.loop, UV_RUN_DEFAULT) == 0);
  }

  TEST_CASE_TEMPLATE("handle rule 8: a callback may use its own and other handles, move and assign them, and throw", Of,
                     HANDLES) {
    using Type = typename Of::Type;
    Quiet quiet;
    Of of;
    Probe probe;
    int of_other = 0;
    Timer other(quiet.loop, [&] { ++of_other; });
    Type handle = of.make(quiet.loop, probe);
    probe.action = [&] {
      use_verbs(handle);
      Type moved = std::move(handle);
      CHECK_FALSE(handle.is_open());
      handle = std::move(moved);
      CHECK(handle.is_open());
      other.start(0ns);
      throw std::runtime_error("of the callback");
    };
    of.provoke(quiet.loop, handle);
    REQUIRE(turn(quiet.loop, [&] { return probe.calls > 0 && of_other > 0; }));
    CHECK(handle.is_open());
    probe.action = nullptr;
    if constexpr (requires { Of::is_called_once; }) return;
    const int calls = probe.calls;
    of.provoke(quiet.loop, handle);
    CHECK(turn(quiet.loop, [&] { return probe.calls > calls; }));  // what it threw has not ended it
  }

  TEST_CASE_TEMPLATE("handle rule 8: assigning in a callback closes the old object after the new one is there", Of,
                     HANDLES) {
    using Type = typename Of::Type;
    Quiet quiet;
    Quiet another;  // a second object of the same name would be refused on the first one
    Of of_old;
    Of of_new;
    Probe of_first;
    Probe of_second;
    Type handle = of_old.make(quiet.loop, of_first);
    Type second;
    of_first.action = [&] {
      if (second.is_open()) handle = std::move(second);
    };
    of_old.provoke(quiet.loop, handle);
    second = of_new.make(another.loop, of_second);
    REQUIRE(turn(quiet.loop, [&] { return of_first.calls > 0; }));
    CHECK(turn(quiet.loop, [&] { return of_first.captures_are_gone(); }));
    CHECK(handle.is_open());
    of_new.provoke(another.loop, handle);
    CHECK(turn(another.loop, [&] { return of_second.calls > 0; }));
  }

  TEST_CASE_TEMPLATE("handle rule 8: a callback that runs, polls or closes its loop gets busy", Of, HANDLES) {
    Quiet quiet;
    Of of;
    Probe probe;
    int refused = 0;
    auto handle = of.make(quiet.loop, probe);
    const auto refuses = [&](auto verb) {
      try {
        verb();
      } catch (const SetupError& e) {
        refused += e.error().code == Errc::busy ? 1 : 0;
      }
    };
    probe.action = [&] {
      if (probe.calls > 1) return;
      refuses([&] { quiet.loop.run(); });
      refuses([&] { quiet.loop.run_for(1ms); });
      refuses([&] { quiet.loop.poll(); });
      refuses([&] { quiet.loop.close(0ns); });
    };
    of.provoke(quiet.loop, handle);
    REQUIRE(turn(quiet.loop, [&] { return probe.calls > 0; }));
    CHECK(refused == 4);
    CHECK(handle.is_open());
  }
  TEST_CASE_TEMPLATE("handle rule 8: a callback may finish its own handle, which is closed afterwards", Of, FINISHED) {
    Quiet quiet;
    Of of;
    Probe probe;
    auto handle = of.make(quiet.loop, probe);
    int finished = 0;
    probe.action = [&] {
      if (probe.calls == 1) handle.finish([&](auto...) { ++finished; });
    };
    of.provoke(quiet.loop, handle);
    CHECK(turn(quiet.loop, [&] { return finished > 0; }));
    CHECK(handle.is_open());
    handle.close();
    CHECK(probe.captures_are_gone());
    quiet.loop.run_for(3ms);
    CHECK(finished == 1);
  }

  TEST_CASE_TEMPLATE("handle rule 2: after close nothing is called that a verb was given, and its captures are gone",
                     Of, FINISHED) {
    Quiet quiet;
    Of of;
    Probe probe;
    auto handle = of.make(quiet.loop, probe);
    of.provoke(quiet.loop, handle);
    int calls = 0;
    std::vector<std::weak_ptr<int>> captures;
    const auto given = [&] {
      auto token = std::make_shared<int>(0);
      captures.emplace_back(token);
      return [&calls, token](auto...) { ++calls; };
    };
    if constexpr (std::is_same_v<typename Of::Type, Output>) {
      handle.when_published(given());
      handle.when_taken(given());
    } else {
      handle.sync(given());
    }
    SUBCASE("at once") {}
    SUBCASE("when it is called to finish") { handle.finish(given()); }
    SUBCASE("when it has finished") {
      handle.finish(given());
      quiet.loop.run_for(1ms);
    }
    handle.close();
    for (const auto& seen : captures) CHECK(seen.expired());
    const int then = calls;
    quiet.loop.run_for(3ms);
    CHECK(calls == then);
  }
}
