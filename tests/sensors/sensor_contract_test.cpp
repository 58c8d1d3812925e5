// What every shipped sensor keeps, run over each of them on a real loop. Events bring each step about; nothing sleeps.
#include <doctest/doctest.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <functional>
#include <memory>
#include <optional>

#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/analog.hpp"
#include "rtdata/sensors/counter.hpp"
#include "rtdata/sensors/edge.hpp"
#include "rtdata/sensors/encoder.hpp"
#include "rtdata/sensors/gps.hpp"
#include "rtdata/sensors/host.hpp"
#include "rtdata/sensors/iio.hpp"
#include "rtdata/sensors/levels.hpp"
#include "rtdata/testing/fake_gpio.hpp"
#ifdef RTDATA_WITH_HTTP
#include "rtdata/sensors/http.hpp"
#endif
#ifdef RTDATA_WITH_MQTT
#include "rtdata/sensors/mqtt.hpp"
#endif
#include "rtdata/sensors/pps.hpp"
#include "rtdata/sensors/serial_line.hpp"
#include "rtdata/sensors/w1.hpp"
#include "sensors/fake_gpsd.hpp"
#include "sensors/fixture.hpp"
#include "sensors/pty.hpp"
#include "sensors/sample_chip.hpp"
#include "sensors/termios2.hpp"

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE_BEGIN("sensors");

namespace {

/// A device as the contract needs it: there or not, good or corrupt.
class Fake {
 public:
  virtual ~Fake() = default;
  virtual const char* kind() const = 0;
  virtual void plug_in() = 0;
  virtual void unplug() = 0;
  enum class Content { good, corrupt };
  virtual void set(Content content) = 0;
  /// Called each millisecond: a device that speaks by itself does so.
  virtual void speak() {}
  virtual AnySensor make(Loop& loop, bool is_required) = 0;
  virtual bool has_rate() const { return true; }
  virtual bool can_be_corrupt() const { return true; }
  virtual bool can_be_required() const { return true; }
  /// Whether it is absent, a sensor knows only when connecting, on its lane, has failed.
  virtual bool is_known_later() const { return false; }
  /// Before the loop that it has made sensors on is destroyed.
  virtual void loop_ends() {}
  ScratchDirectory directory;
};

SensorConfig common(bool is_required) {
  return {.name = "s", .topic = "t", .rate = 500_Hz, .retry_first = 2ms, .retry_longest = 4ms, .required = is_required};
}

class FakeFile : public Fake {
 public:
  FakeFile(std::string path, std::string good) : path_(directory.file(path)), good_(std::move(good)) {}
  // By another name first: a reader finds it whole or not at all.
  void plug_in() override { set(Content::good); }
  void unplug() override { ::unlink(path_.c_str()); }
  void set(Content content) override {
    ScratchDirectory::write(directory.path() + "/new", content == Content::good ? good_ : "garbage\n");
    ::rename((directory.path() + "/new").c_str(), path_.c_str());
  }

 protected:
  std::string path_;
  std::string good_;
};

class FakeAdc final : public FakeFile {
 public:
  FakeAdc() : FakeFile("adc0", "12\n") {}
  const char* kind() const override { return "analog"; }
  AnySensor make(Loop& loop, bool is_required) override {
    return AnalogSensor(loop, common(is_required), {.file = path_});
  }
};

class FakeThermometer final : public FakeFile {
 public:
  FakeThermometer() : FakeFile("sys/class/thermal/thermal_zone0/temp", "41000\n") {}
  const char* kind() const override { return "host temperature"; }
  AnySensor make(Loop& loop, bool is_required) override {
    return HostSensor(loop, common(is_required), {.quantity = HostQuantity::temperature, .root = directory.path()});
  }
};

class FakeVoltage final : public FakeFile {
 public:
  FakeVoltage() : FakeFile("sys/class/hwmon/hwmon0/in1_input", "3300\n") {
    directory.file("sys/class/hwmon/hwmon0/name", "board\n");
    directory.file("sys/class/hwmon/hwmon0/in1_alarm", "0\n");
  }
  const char* kind() const override { return "host voltage"; }
  AnySensor make(Loop& loop, bool is_required) override {
    return HostSensor(loop, common(is_required),
                      {.quantity = HostQuantity::voltage, .device = "board/in1", .root = directory.path()});
  }
};

class FakeProc final : public FakeFile {
 public:
  FakeProc() : FakeFile("proc/loadavg", "1.0 2.0 3.0 1/2 3\n") {}
  const char* kind() const override { return "host load"; }
  // What /proc has stays the same file, and never goes away while it is open.
  void set(Content content) override { ScratchDirectory::write(path_, content == Content::good ? good_ : "garbage\n"); }
  void unplug() override {
    ScratchDirectory::write(path_, "");
    ::unlink(path_.c_str());
  }
  AnySensor make(Loop& loop, bool is_required) override {
    return HostSensor(loop, common(is_required), {.quantity = HostQuantity::load, .root = directory.path()});
  }
};

class FakeLine final : public Fake {
 public:
  FakeLine() : pty_(directory.file("tty")) {}
  const char* kind() const override { return "serial line"; }
  void plug_in() override { pty_.plug_in(); }
  void unplug() override { pty_.unplug(); }
  void set(Content content) override { content_ = content; }
  void speak() override {
    if (pty_.master() >= 0) pty_.send(content_ == Content::good ? "1.5\n" : "garbage\n");
  }
  bool has_rate() const override { return false; }
  AnySensor make(Loop& loop, bool is_required) override {
    return SerialLineSensor(loop, {.name = "s", .topic = "t"},
                            {.device = pty_.path(),
                             .lines = {.fields = {{.name = "v"}}, .retry_first = 2ms, .retry_longest = 4ms},
                             .required = is_required});
  }

 private:
  Pty pty_;
  Content content_ = Content::good;
};

/// A receiver that sends NMEA: an instant a sentence.
class FakeNmea final : public Fake {
 public:
  FakeNmea() : pty_(directory.file("tty")) {}
  const char* kind() const override { return "serial line with NMEA"; }
  void plug_in() override { pty_.plug_in(); }
  void unplug() override { pty_.unplug(); }
  void set(Content content) override { content_ = content; }
  void speak() override {
    if (pty_.master() < 0) return;
    char time[16];
    ++count_;
    std::snprintf(time, sizeof time, "%02u%02u%02u", count_ / 3600 % 24, count_ / 60 % 60, count_ % 60);
    const std::string body = "GPGGA," + std::string(time) + ",4804.1,N,01621.5,E,1,10,0.9,205.3,M,42.0,M,,";
    unsigned sum = content_ == Content::good ? 0 : 1;
    for (const char c : body) sum ^= static_cast<unsigned char>(c);
    char end[8];
    std::snprintf(end, sizeof end, "*%02X\r\n", sum & 0xff);
    pty_.send("$" + body + end);
  }
  bool has_rate() const override { return false; }
  AnySensor make(Loop& loop, bool is_required) override {
    return SerialLineSensor(loop, {.name = "s", .topic = "t"},
                            {.device = pty_.path(),
                             .lines = {.format = LineFormat::nmea, .retry_first = 2ms, .retry_longest = 4ms},
                             .required = is_required});
  }

 private:
  Pty pty_;
  Content content_ = Content::good;
  unsigned count_ = 0;
};

/// A device that answers requests on a serial line, by the sample of its driver (chip.hpp).
class FakeAnswerer final : public Fake {
 public:
  FakeAnswerer(const Registry& registry, const TypeInfo& type)
      : registry_(registry),
        type_(type.name),
        members_(type.page.samples[0].members),
        request_(text_of(type.page.samples[0].bytes[0].at)),
        answer_(text_of(type.page.samples[0].bytes[0].bytes)),
        pty_(directory.file("tty")) {}
  const char* kind() const override { return type_.c_str(); }
  void plug_in() override { pty_.plug_in(); }
  void unplug() override {
    pty_.unplug();
    asked_.clear();
  }
  void set(Content content) override { content_ = content; }
  void speak() override {
    char bytes[64];
    const ssize_t count = pty_.master() < 0 ? 0 : ::read(pty_.master(), bytes, sizeof bytes);
    if (count > 0) asked_.append(bytes, static_cast<std::size_t>(count));
    if (!asked_.ends_with(request_)) return;
    asked_.clear();
    std::string answer = answer_;
    if (content_ == Content::corrupt) answer[0] = '?';
    pty_.send(answer);
  }
  AnySensor make(Loop& loop, bool is_required) override {
    system_.emplace(loop, registry_,
                    parse_config(R"({"buses": {"line": {"type": "serial", "answer_timeout": "100 ms", "timeout": "1 s",
            "device": ")" + pty_.path() +
                                 R"("}}, "sensors": [{"name": "s", "topic": "t", "bus": "line", "rate": "500 Hz",
            "retry_first": "2 ms", "retry_longest": "4 ms", "type": ")" +
                                 type_ + R"(", "required": )" + (is_required ? "true" : "false") +
                                 (members_.empty() ? "" : ", ") + members_ + "}]}"));
    return std::move(system_->sensor("s"));
  }
  void loop_ends() override { system_.reset(); }

 private:
  static std::string text_of(std::string_view hexadecimal) {
    const std::vector<std::uint8_t> bytes = bytes_of(hexadecimal);
    return {bytes.begin(), bytes.end()};
  }
  const Registry& registry_;
  const std::string type_, members_, request_, answer_;
  Pty pty_;
  std::string asked_;
  Content content_ = Content::good;
  std::optional<System> system_;
};

class FakeBarometer final : public FakeFile {
 public:
  FakeBarometer() : FakeFile("sys/bus/iio/devices/iio:device0/in_pressure_input", "101.3\n") {
    directory.file("sys/bus/iio/devices/iio:device0/name", "bmp280\n");
  }
  const char* kind() const override { return "iio"; }
  AnySensor make(Loop& loop, bool is_required) override {
    return IioSensor(loop, common(is_required),
                     {.device = "bmp280", .channels = {"pressure"}, .root = directory.path()});
  }
};

class FakeEncoder final : public FakeFile {
 public:
  FakeEncoder() : FakeFile("sys/bus/counter/devices/counter0/count0/count", "12\n") {
    directory.file("sys/bus/counter/devices/counter0/name", "qep\n");
  }
  const char* kind() const override { return "encoder"; }
  AnySensor make(Loop& loop, bool is_required) override {
    return EncoderSensor(loop, common(is_required), {.device = "qep", .root = directory.path()});
  }
};

class FakeOneWire final : public FakeFile {
 public:
  FakeOneWire()
      : FakeFile("sys/bus/w1/devices/28-1/w1_slave",
                 "91 01 4b 46 7f ff 0c 10 5e : crc=5e YES\n91 01 4b 46 7f ff 0c 10 5e t=25062\n") {}
  const char* kind() const override { return "w1"; }
  AnySensor make(Loop& loop, bool is_required) override {
    return W1Sensor(loop, common(is_required), {.device = "28-1", .root = directory.path()});
  }
};

class FakePulse final : public FakeFile {
 public:
  FakePulse() : FakeFile("sys/class/pps/pps0/assert", "0.000000000#0\n") {}
  const char* kind() const override { return "pps"; }
  void plug_in() override {
    is_there_ = true;
    FakeFile::plug_in();
  }
  void unplug() override {
    is_there_ = false;
    FakeFile::unplug();
  }
  void set(Content content) override {
    content_ = content;
    FakeFile::set(content);
  }
  void speak() override {
    if (!is_there_ || content_ == Content::corrupt) return;
    const std::string ns = std::to_string(SystemClock().realtime().time_since_epoch().count());
    good_ = ns.substr(0, 10) + "." + ns.substr(10) + "#" + std::to_string(++count_) + "\n";
    FakeFile::set(Content::good);
  }
  bool has_rate() const override { return false; }
  AnySensor make(Loop& loop, bool is_required) override {
    return PpsSensor(loop, {.name = "s", .topic = "t"},
                     {.root = directory.path(), .retry_first = 2ms, .retry_longest = 4ms, .required = is_required});
  }

 private:
  bool is_there_ = false;
  Content content_ = Content::good;
  int count_ = 0;
};

/// A FIFO stands for the kernel's buffer of scans of two bytes.
class FakeBuffer final : public Fake {
 public:
  FakeBuffer() : node_(directory.file("dev/iio:device0")) {
    const std::string folder = "sys/bus/iio/devices/iio:device0/";
    for (const auto& [name, content] : {std::pair{"name", "adc"},
                                        {"in_voltage0_raw", "0"},
                                        {"scan_elements/in_voltage0_en", "0"},
                                        {"scan_elements/in_voltage0_index", "0"},
                                        {"scan_elements/in_voltage0_type", "le:s16/16>>0"},
                                        {"buffer/enable", "0"}})
      directory.file(folder + name, content);
  }
  ~FakeBuffer() override { unplug(); }
  const char* kind() const override { return "iio_buffer"; }
  void plug_in() override {
    ::mkfifo(node_.c_str(), 0600);
    fd_ = ::open(node_.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
  }
  void unplug() override {
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
    ::unlink(node_.c_str());
  }
  void set(Content content) override { content_ = content; }
  void speak() override {
    const char scan[3] = {1, 2, 3};
    if (fd_ < 0) return;
    [[maybe_unused]] const auto put = ::write(fd_, scan, content_ == Content::good ? 2 : 3);
  }
  bool has_rate() const override { return false; }
  AnySensor make(Loop& loop, bool is_required) override {
    return IioBufferSensor(loop, {.name = "s", .topic = "t"},
                           {.device = "adc",
                            .channels = {"voltage0"},
                            .length = 65536,
                            .root = directory.path(),
                            .retry_first = 2ms,
                            .retry_longest = 4ms,
                            .required = is_required});
  }

 private:
  std::string node_;
  int fd_ = -1;
  Content content_ = Content::good;
};

class FakeReceiver final : public Fake {
 public:
  FakeReceiver() { gpsd_.vanish(); }
  const char* kind() const override { return "gps"; }
  void plug_in() override { gpsd_.listen(); }
  void unplug() override { gpsd_.vanish(); }
  void set(Content content) override { content_ = content; }
  void speak() override {
    gpsd_.accept();
    const std::string number = std::to_string(++count_);
    if (gpsd_.has_peer())
      gpsd_.send(content_ == Content::good ? "{\"class\":\"TPV\",\"mode\":1,\"n\":" + number + "}\n" : "garbage\n");
  }
  bool has_rate() const override { return false; }
  AnySensor make(Loop& loop, bool is_required) override {
    return GpsSensor(
        loop, {.name = "s", .topic = "t"},
        {.host = "127.0.0.1", .port = gpsd_.port(), .retry_first = 2ms, .retry_longest = 4ms, .required = is_required});
  }

 private:
  FakeGpsd gpsd_;
  Content content_ = Content::good;
  int count_ = 0;
};

#ifdef RTDATA_WITH_HTTP
/// As much of a server of HTTP as one request at a time needs.
class FakeHttpServer final : public Fake {
 public:
  FakeHttpServer() { server_.vanish(); }
  const char* kind() const override { return "http"; }
  void plug_in() override {
    if (!server_.listens()) server_.listen();
  }
  void unplug() override { server_.vanish(); }
  void set(Content content) override { content_ = content; }
  void speak() override {
    if (server_.accept()) asked_.clear();
    if (!server_.has_peer()) return;
    asked_ += server_.received();
    if (!asked_.ends_with("\r\n\r\n")) return;
    asked_.clear();
    server_.send("HTTP/1.1 200 OK\r\nContent-Length: 8\r\n\r\n" +
                 std::string(content_ == Content::good ? "{\"v\": 1}" : "<html>  "));
  }
  bool can_be_required() const override { return false; }  // making it waits for the answer; http_sensor_test.cpp
  bool is_known_later() const override { return true; }
  AnySensor make(Loop& loop, bool is_required) override {
    return HttpSensor(
        loop, common(is_required),
        {.server = {.url = "http://127.0.0.1:" + std::to_string(server_.port()) + "/"}, .fields = {{.name = "v"}}});
  }

 private:
  FakeGpsd server_;
  std::string asked_;
  Content content_ = Content::good;
};
#endif

#ifdef RTDATA_WITH_MQTT
/// As much of a broker of MQTT 5 as one subscription with QoS 0 needs.
class FakeBroker final : public Fake {
 public:
  FakeBroker() { server_.vanish(); }
  const char* kind() const override { return "mqtt"; }
  void plug_in() override {
    if (!server_.listens()) server_.listen();
  }
  void unplug() override { server_.vanish(); }
  void set(Content content) override { content_ = content; }
  void speak() override {
    if (server_.accept()) {
      in_.clear();
      is_subscribed_ = false;
    }
    if (!server_.has_peer()) return;
    for (in_ += server_.received(); in_.size() >= 2 && in_.size() >= 2U + static_cast<unsigned char>(in_[1]);) {
      const std::string packet = in_.substr(0, 2U + static_cast<unsigned char>(in_[1]));
      in_.erase(0, packet.size());
      switch (static_cast<unsigned char>(packet[0]) >> 4) {
        case 1:
          server_.send({"\x20\x03\0\0\0", 5});
          break;
        case 8:
          server_.send(std::string("\x90\x04") + packet.substr(2, 2) + std::string(2, '\0'));
          is_subscribed_ = true;
          break;
        case 12:
          server_.send({"\xd0\0", 2});
          break;
        default:
          break;
      }
    }
    const std::string payload = content_ == Content::good ? R"({"v":1.5})" : "garbage";
    const std::string rest = std::string(
                                 "\0\x01"
                                 "a\0",
                                 4) +
                             payload;
    if (is_subscribed_) server_.send("0" + std::string(1, static_cast<char>(rest.size())) + rest);
  }
  bool has_rate() const override { return false; }
  bool can_be_required() const override { return false; }
  bool is_known_later() const override { return true; }
  AnySensor make(Loop& loop, bool) override {
    MqttSensorConfig config;
    config.broker.host = "127.0.0.1";
    config.broker.port = server_.port();
    config.topics = {"a"};
    config.fields = {{.name = "v"}};
    config.retry_first = 2ms;
    config.retry_longest = 4ms;
    return MqttSensor(loop, {.name = "s", .topic = "t"}, config);
  }

 private:
  FakeGpsd server_;
  std::string in_;
  bool is_subscribed_ = false;
  Content content_ = Content::good;
};
#endif

/// A line that is driven each millisecond.
class FakeLineOfChip : public Fake {
 public:
  void plug_in() override {
    if (!std::exchange(is_there_, true)) pins_->plug_in("gpiochip0");
  }
  void unplug() override {
    is_there_ = false;
    pins_->unplug("gpiochip0", true);
  }
  void set(Content) override {}
  bool can_be_corrupt() const override { return false; }
  void speak() override {
    level_ = !level_;
    pins_->drive("gpiochip0", 3, level_, std::chrono::steady_clock::now());
  }

 protected:
  FakeLineOfChip() {
    pins_->add_chip("gpiochip0", 8);
    pins_->unplug("gpiochip0");
  }
  std::shared_ptr<FakeGpio> pins_ = std::make_shared<FakeGpio>();

 private:
  bool is_there_ = false;
  bool level_ = false;
};
class FakeEdges final : public FakeLineOfChip {
 public:
  const char* kind() const override { return "edge"; }
  bool has_rate() const override { return false; }
  AnySensor make(Loop& loop, bool is_required) override {
    return EdgeSensor(loop, {.name = "s", .topic = "t"},
                      {.input = {.line = 3}, .retry_first = 2ms, .retry_longest = 4ms, .required = is_required}, pins_);
  }
};
class FakePulses final : public FakeLineOfChip {
 public:
  const char* kind() const override { return "counter"; }
  AnySensor make(Loop& loop, bool is_required) override {
    return CounterSensor(loop, common(is_required), {.input = {.line = 3}}, pins_);
  }
};

class FakeLevels final : public FakeLineOfChip {
 public:
  const char* kind() const override { return "gpio"; }
  void speak() override {}  // it is asked
  AnySensor make(Loop& loop, bool is_required) override {
    return LevelsSensor(loop, common(is_required), {.lines = {{.name = "x", .line = 3}, {.name = "y", .line = 4}}},
                        pins_);
  }
};

std::vector<std::unique_ptr<Fake>> every_kind() {
  std::vector<std::unique_ptr<Fake>> kinds;
  kinds.push_back(std::make_unique<FakeAdc>());
  kinds.push_back(std::make_unique<FakeThermometer>());
  kinds.push_back(std::make_unique<FakeVoltage>());
  kinds.push_back(std::make_unique<FakeProc>());
  kinds.push_back(std::make_unique<FakeBarometer>());
  kinds.push_back(std::make_unique<FakeBuffer>());
  kinds.push_back(std::make_unique<FakeEncoder>());
  kinds.push_back(std::make_unique<FakeOneWire>());
  kinds.push_back(std::make_unique<FakePulse>());
  kinds.push_back(std::make_unique<FakeReceiver>());
#ifdef RTDATA_WITH_HTTP
  kinds.push_back(std::make_unique<FakeHttpServer>());
#endif
#ifdef RTDATA_WITH_MQTT
  kinds.push_back(std::make_unique<FakeBroker>());
#endif
  if (terminals_can_be_set_up()) {
    kinds.push_back(std::make_unique<FakeLine>());
    kinds.push_back(std::make_unique<FakeNmea>());
    static const Registry registry = standard_registry();
    for (const TypeInfo& type : registry.sensors().types())
      if (type.page.bus == "serial") kinds.push_back(std::make_unique<FakeAnswerer>(registry, type));
  }
  kinds.push_back(std::make_unique<FakeEdges>());
  kinds.push_back(std::make_unique<FakePulses>());
  kinds.push_back(std::make_unique<FakeLevels>());
  return kinds;
}

struct Stage {
  explicit Stage(Fake& fake_) : fake(fake_) {
    be_quiet(loop);
    loop.on_error([](const ErrorReport&) {});
    heard = loop.subscribe("#", [this](const EventView&) { ++events; });
  }
  ~Stage() { fake.loop_ends(); }
  /// Runs until it is so; a failed check after 10 s.
  void until(const std::function<bool()>& is_so) {
    Timer limit(loop, 60s, [&] { loop.stop(); });
    bool done = false;
    Ticker look(loop, 1ms, [&](const Tick&) {
      fake.speak();
      done = is_so();
      if (done) loop.stop();
    });
    loop.run();
    CHECK(done);
  }
  void until_events(std::uint64_t more) {
    const std::uint64_t wanted = events + more;
    until([&, wanted] { return events >= wanted; });
  }
  /// Lets the loop turn a number of times.
  void turns(int count) {
    until([&] { return --count < 0; });
  }
  Fake& fake;
  Loop loop;
  std::uint64_t events = 0;
  Subscription heard;
};

}  // namespace

TEST_CASE(
    "US-7 US-9 US-8 every kind of sensor starts at once, stops for good, starts again, and is silent once closed") {
  for (const auto& fake : every_kind()) {
    CAPTURE(fake->kind());
    Stage stage(*fake);
    fake->plug_in();
    stage.turns(1);  // the system runs already
    AnySensor sensor = fake->make(stage.loop, false);
    CHECK(sensor.is_running());
    for (int round = 0; round < 3; ++round) {
      stage.until_events(3);
      sensor.stop();
      CHECK(!sensor.is_running());
      CHECK(sensor.counts().in_flight == 0);
      CHECK(sensor.counts().balances());
      const std::uint64_t before = stage.events;
      stage.turns(10);
      CHECK(stage.events == before);
      sensor.stop();
      sensor.start();
      sensor.start();
      CHECK(sensor.is_running());
    }
    stage.until_events(1);
    sensor.close();
    const std::uint64_t before = stage.events;
    stage.turns(10);
    CHECK(stage.events == before);
    CHECK(stage.loop.runtime().balances());
    sensor = fake->make(stage.loop, false);  // its name is free again
    stage.until_events(2);
    CHECK(sensor.counts().balances());
  }
}

TEST_CASE("US-27 every kind of sensor is degraded or faulted by a corrupt or missing device, and comes back") {
  for (const auto& fake : every_kind()) {
    CAPTURE(fake->kind());
    Stage stage(*fake);
    AnySensor sensor = fake->make(stage.loop, false);  // absent at the start
    if (fake->is_known_later()) stage.until([&] { return sensor.health() == Health::faulted; });
    CHECK(sensor.health() == Health::faulted);
    CHECK(!sensor.status().reason.empty());
    fake->plug_in();
    for (int round = 0; round < 2; ++round) {
      stage.until_events(2);
      stage.until([&] { return sensor.health() == Health::ok; });
      if (fake->can_be_corrupt()) {
        fake->set(Fake::Content::corrupt);
        stage.until([&] { return sensor.health() != Health::ok; });
        CHECK(sensor.counts().unreadable > 0);
        CHECK((sensor.counts().failed > 0) == sensor.counts().has_schedule);
        fake->set(Fake::Content::good);
        stage.until([&] { return sensor.health() == Health::ok; });
      }
      fake->unplug();
      stage.until([&] { return sensor.health() == Health::faulted; });
      fake->plug_in();
    }
    stage.until_events(2);
    sensor.stop();
    CHECK(sensor.counts().balances());
    CHECK(stage.loop.runtime().balances());
  }
}

TEST_CASE("US-27 every kind of sensor throws when its device is required and not there") {
  for (const auto& fake : every_kind()) {
    CAPTURE(fake->kind());
    if (!fake->can_be_required()) continue;
    Stage stage(*fake);
    CHECK_THROWS_AS(fake->make(stage.loop, true), SetupError);
    fake->plug_in();
    AnySensor sensor = fake->make(stage.loop, true);
    stage.until_events(2);
    CHECK(sensor.counts().balances());
  }
}

TEST_CASE("US-5 every kind of sensor changes its rate while it runs, or says why it cannot") {
  for (const auto& fake : every_kind()) {
    CAPTURE(fake->kind());
    Stage stage(*fake);
    fake->plug_in();
    AnySensor sensor = fake->make(stage.loop, false);
    stage.until_events(2);
    if (fake->has_rate()) {
      sensor.set_rate(1_kHz);
      CHECK(sensor.rate() == 1_kHz);
      CHECK_THROWS_AS(sensor.set_rate(Rate{}), SetupError);
    } else {
      CHECK_THROWS_AS(sensor.set_rate(1_kHz), SetupError);
    }
    stage.until_events(5);
    sensor.stop();
    CHECK(sensor.counts().balances());
  }
}

TEST_SUITE_END();
