// IIO devices in a folder that looks like /sys and /dev: the buffer is a FIFO.
#include "rtdata/sensors/iio.hpp"

#include <doctest/doctest.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmath>
#include <cstring>
#include <functional>
#include <optional>

#include "rtdata/io/iio.hpp"
#include "rtdata/loop/timer.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE_BEGIN("sensors");

namespace {

std::string content_of(const std::string& path) {
  std::ifstream file(path);
  std::string text;
  std::getline(file, text);
  return text;
}

class FakeIio {
 public:
  FakeIio() {
    attribute("name", "mpu6050\n");
    attribute("sampling_frequency", "100\n");
    attribute("current_timestamp_clock", std::string("realtime\n\0", 10));  // as the kernel writes it
    attribute("in_accel_scale", "0.5\n");
    attribute("in_temp_scale", "2\n");
    attribute("in_temp_offset", "-10\n");
    attribute("in_pressure_input", "101.3\n");
    channel("accel_x", 0, "be:s16/16>>0");
    channel("temp", 1, "le:u12/16>>4");
    channel("timestamp", 5, "le:s64/64>>0");
    attribute("buffer/enable", "0\n");
    attribute("buffer/length", "2\n");
    attribute("buffer/watermark", "1\n");
    attribute("trigger/current_trigger", "\n");
    directory.file("sys/bus/iio/devices/trigger3/name", "mpu6050-dev0\n");
    node = directory.file("dev/iio:device0");
    plug_in();
  }
  ~FakeIio() { unplug(); }

  void attribute(const std::string& name, const std::string& content) {
    directory.file("sys/bus/iio/devices/iio:device0/" + name, content);
  }
  std::string attribute(const std::string& name) const {
    return content_of(directory.path() + "/sys/bus/iio/devices/iio:device0/" + name);
  }
  void channel(const std::string& name, int index, const std::string& type) {
    if (name != "timestamp") attribute("in_" + name + "_raw", "20\n");
    attribute("scan_elements/in_" + name + "_en", "0\n");
    attribute("scan_elements/in_" + name + "_index", std::to_string(index) + "\n");
    attribute("scan_elements/in_" + name + "_type", type + "\n");
  }
  void plug_in() {
    ::mkfifo(node.c_str(), 0600);
    writer = ::open(node.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
  }
  void unplug() {
    if (writer >= 0) ::close(writer);
    writer = -1;
    ::unlink(node.c_str());
  }
  /// accel_x big-endian, temp in the upper twelve bits, padding, the time.
  void scan(std::int16_t accel, unsigned temp, MonotonicTime time) const {
    unsigned char bytes[16] = {};
    bytes[0] = static_cast<unsigned char>(static_cast<unsigned>(accel) >> 8);
    bytes[1] = static_cast<unsigned char>(accel);
    const auto word = static_cast<std::uint16_t>(temp << 4 | 0xf);
    bytes[2] = static_cast<unsigned char>(word);
    bytes[3] = static_cast<unsigned char>(word >> 8);
    const std::int64_t stamp = time.time_since_epoch().count();
    for (unsigned i = 0; i < 8; ++i)
      bytes[8 + i] = static_cast<unsigned char>(static_cast<std::uint64_t>(stamp) >> 8 * i);
    CHECK(::write(writer, bytes, sizeof bytes) == static_cast<ssize_t>(sizeof bytes));
  }

  ScratchDirectory directory;
  std::string node;
  int writer = -1;
};

struct Values {
  double accel, temp;
};

struct Stage {
  Stage() {
    loop.runtime().on_log([this](const LogRecord& record) { log += std::string(record.text) + "\n"; });
    loop.on_error([this](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error);
    });
    heard = loop.subscribe("imu", [this](const EventView& event) {
      Values value{};
      REQUIRE(event.payload().size() == sizeof value);
      std::memcpy(&value, event.payload().data(), sizeof value);
      values.push_back(value);
      times.push_back(event.time());
    });
  }
  IioBufferConfig config(FakeIio& fake) const {
    return {.device = "mpu6050",
            .channels = {"accel_x", "temp"},
            .length = 8,
            .root = fake.directory.path(),
            .retry_first = 2ms,
            .retry_longest = 4ms};
  }
  void until(const std::function<bool()>& is_so) {
    Timer limit(loop, 60s, [&] { loop.stop(); });
    bool done = false;
    Ticker look(loop, 1ms, [&](const Tick&) {
      done = is_so();
      if (done) loop.stop();
    });
    if (!is_so()) loop.run();
    CHECK((done || is_so()));
  }
  bool has_error(Errc code, const std::string& part) const {
    for (const Error& error : errors) {
      if (error.code == code && error.text().find(part) != std::string::npos) return true;
    }
    return false;
  }
  MonotonicTime now() const { return SystemClock().monotonic(); }

  Loop loop;
  std::string log;
  std::vector<Error> errors;
  std::vector<Values> values;
  std::vector<Time> times;
  Subscription heard;
};

}  // namespace

TEST_CASE("FW-2 the type of a channel in a scan is read, and nothing that is none") {
  const auto storage = parse_iio_storage("le:s12/16X2>>4").or_throw();
  CHECK(storage == IioStorage{false, true, 12, 16, 2, 4});
  CHECK(storage.size() == 4);
  CHECK(parse_iio_storage("be:u24/32>>8").or_throw() == IioStorage{true, false, 24, 32, 1, 8});
  CHECK(parse_iio_storage("le:s64/64").or_throw() == IioStorage{false, true, 64, 64, 1, 0});
  for (const char* bad :
       {"", "le", "le:", "xe:s12/16>>4", "le:x12/16>>4", "le:s/16>>4", "le:s12/", "le:s12/16>>", "le:s0/16>>0",
        "le:s17/16>>0", "le:s12/16>>5", "le:s12/24>>0", "le:s12/16X0>>0", "le:s12/16X65>>0", "le:s12/16X>>0",
        "le:s12/16>>4 ", "le:s12/16>>-1", "le:s4294967308/16>>0", "le:f32/32>>0"}) {
    CAPTURE(bad);
    CHECK(parse_iio_storage(bad).error().code == Errc::bad_data);
  }
}

TEST_CASE("FW-2 every place, byte order, sign, shift and size of a value in a scan is decoded") {
  const auto storage = [](const char* text) { return parse_iio_storage(text).or_throw(); };
  // In the order of their indices: a byte, 2 bytes aligned to 2, 4 to 4, 8 to 8, then four of 2 bytes to 8.
  const auto layout = IioLayout::make(
                          {{.index = 9, .storage = storage("le:s64/64>>0"), .is_timestamp = true},
                           {.index = 4, .storage = storage("le:s16/16X4>>0"), .position = 4},
                           {.index = 3, .storage = storage("be:u64/64>>0"), .position = 3},
                           {.index = 0, .storage = storage("le:s7/8>>1"), .position = 0},
                           {.index = 1, .storage = storage("be:s12/16>>4"), .conversion = {10, 0.5}, .position = 1},
                           {.index = 2, .storage = storage("le:u24/32>>8"), .position = 2}})
                          .or_throw();
  CHECK(layout.size() == 32);
  CHECK(layout.values() == 8);
  const unsigned char bytes[32] = {0xfd, 0xee,                                      // -2 in seven bits, padding
                                   0xff, 0xe5,                                      // -2 in twelve bits above four
                                   0x11, 0x56, 0x34, 0x92,                          // 0x923456 above eight bits
                                   0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xf0, 0x00,  // 2^64 - 4096
                                   0x01, 0x00, 0xff, 0xff, 0xff, 0x7f, 0x00, 0x80,  // 1, -1, 32767, -32768
                                   0x15, 0xcd, 0x5b, 0x07, 0,    0,    0,    0};    // 123456789
  double values[8] = {};
  layout.decode(reinterpret_cast<const std::byte*>(bytes), values);
  CHECK(values[0] == -2);
  CHECK(values[1] == (-2 + 10) * 0.5);
  CHECK(values[2] == 0x923456);
  CHECK(values[3] == 18446744073709547520.0);
  CHECK(values[4] == 1);
  CHECK(values[5] == -1);
  CHECK(values[6] == 32767);
  CHECK(values[7] == -32768);
  REQUIRE(layout.has_timestamp());
  CHECK(layout.timestamp(reinterpret_cast<const std::byte*>(bytes)) == 123456789);
  // Without the larger ones, the whole is no larger than its largest needs.
  CHECK(IioLayout::make({{.index = 0, .storage = storage("le:s16/16>>0")},
                         {.index = 1, .storage = storage("le:s8/8>>0"), .position = 1}})
            .or_throw()
            .size() == 4);
  CHECK(!IioLayout::make(
      {{.index = 1, .storage = storage("le:s16/16>>0")}, {.index = 1, .storage = storage("le:s16/16>>0")}}));
  CHECK(!IioLayout::make({{.index = 1, .storage = storage("le:s16/16X3>>0")}}));
  CHECK(!IioLayout::make({{.index = 1, .storage = storage("le:s32/32>>0"), .is_timestamp = true}}));
}

TEST_CASE("FW-2 what a channel measures, and its SI unit, is known by its name") {
  const auto unit = [](const char* name) {
    const IioQuantity* quantity = iio_quantity(name);
    return quantity == nullptr ? "none" : std::string(quantity->unit);
  };
  CHECK(unit("voltage0") == "V");
  CHECK(unit("voltage0-voltage1") == "V");
  CHECK(unit("accel_x") == "m/s2");
  CHECK(unit("anglvel_z") == "rad/s");
  CHECK(unit("angl0") == "rad");
  CHECK(unit("temp_ambient") == "Cel");
  CHECK(unit("pressure") == "Pa");
  CHECK(unit("humidityrelative") == "%");
  CHECK(unit("magn_x") == "T");
  for (const char* bad :
       {"", "volt0", "voltagex", "voltage_", "accel-x", "timestamp", "voltage0/../x", "temp ambient"}) {
    CAPTURE(bad);
    CHECK(iio_quantity(bad) == nullptr);
  }
  const auto description = iio_description({"voltage0-voltage1", "rot_quaternion"}).or_throw();
  CHECK(description->find("voltage0_voltage1")->unit == "V");
  CHECK(description->find("rot_quaternion[3]") != nullptr);
  CHECK(!iio_description({}));
  CHECK(!iio_description({"temp", "temp"}));
  CHECK(!iio_description({"volt0"}));
}

TEST_CASE("FW-2 an IIO device is found by name, label, number and path, and says what it has") {
  FakeIio fake;
  const std::string& root = fake.directory.path();
  fake.directory.file("sys/bus/iio/devices/iio:device12/name", "bmp280\n");
  fake.directory.file("sys/bus/iio/devices/iio:device12/label", "cabin\n");
  fake.directory.file("sys/bus/iio/devices/iio:device2/name", "bmp280\n");
  for (const char* which : {"mpu6050", "0", "iio:device0", "/sys/bus/iio/devices/iio:device0", "/dev/iio:device0"}) {
    CAPTURE(which);
    CHECK(IioDevice::find(which, root).or_throw().number() == 0);
  }
  CHECK(IioDevice::find("cabin", root).or_throw().number() == 12);
  CHECK(IioDevice::find("12", root).or_throw().text() == "bmp280 cabin (iio:device12)");
  const Error several = IioDevice::find("bmp280", root).error();
  CHECK(several.code == Errc::bad_argument);
  CHECK(several.why == "there are several: bmp280 (iio:device2), bmp280 cabin (iio:device12)");
  const Error none = IioDevice::find("bmp281", root).error();
  CHECK(none.code == Errc::not_found);
  CHECK(none.why.find("mpu6050 (iio:device0)") != std::string::npos);
  CHECK(IioDevice::find("x", root + "/empty").error().why == "this machine has no IIO device");

  const IioDevice device = IioDevice::find("0", root).or_throw();
  std::string names;
  for (const IioChannel& channel : device.channels()) names += channel.name + " ";
  CHECK(names == "accel_x temp timestamp pressure ");
  CHECK(device.channel("accel_x")->unit == "m/s2");
  CHECK(device.channel("accel_x")->index == 0);
  CHECK(device.channel("pressure")->is_processed);
  CHECK(device.channel("pressure")->index == -1);
  CHECK(device.read(*device.channel("accel_x")).or_throw() == 10);
  CHECK(device.read(*device.channel("temp")).or_throw() == doctest::Approx(0.02));          // (20 - 10) * 2 m°C
  CHECK(device.read(*device.channel("pressure")).or_throw() == doctest::Approx(101300.0));  // kPa
  CHECK(device.channel_or_error("acel_x").error().advice == "did you mean accel_x?");
  CHECK(device.holder() == "this program");  // its other end
  fake.unplug();
  CHECK(device.holder().empty());
}

TEST_CASE(
    "FW-2 an IIO device polled: channels in SI units at the sensor's rate, in virtual time; a device that goes and "
    "comes back") {
  FakeIio fake;
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  std::vector<Error> errors;
  loop.on_error([&](const ErrorReport& report) {
    if (report.error.code != Errc::held_too_long) errors.push_back(report.error);
  });
  std::vector<double> pressures;
  const auto heard = loop.subscribe("weather", [&](const EventView& event) {
    double values[2];
    std::memcpy(values, event.payload().data(), sizeof values);
    pressures.push_back(values[1]);
  });
  IioSensor sensor(loop, {.name = "weather", .rate = 10_Hz, .retry_first = 100ms},
                   {.device = "mpu6050", .channels = {"temp", "pressure"}, .root = fake.directory.path()});
  loop.advance(1s);
  CHECK(pressures.size() >= 9);
  CHECK(pressures.back() == doctest::Approx(101300.0));
  CHECK(errors.empty());
  SUBCASE("what is no number is unreadable") {
    fake.attribute("in_pressure_input", "garbage\n");
    loop.advance(1s);
    CHECK(sensor.counts().unreadable > 0);
    CHECK(errors.back().code == Errc::not_a_number);
  }
  SUBCASE("a device that has gone") {
    ::unlink((fake.directory.path() + "/sys/bus/iio/devices/iio:device0/in_pressure_input").c_str());
    loop.advance(1s);
    CHECK(sensor.health() == Health::faulted);
    CHECK(sensor.counts().failed > 0);
  }
  fake.attribute("in_pressure_input", "100\n");
  loop.advance(2s);
  CHECK(sensor.health() == Health::ok);
  CHECK(pressures.back() == doctest::Approx(100000.0));
  CHECK(sensor.counts().balances());
}

TEST_CASE(
    "FW-2 US-15 an IIO device buffered: scans with the kernel's times; the buffer is turned on by the start and off by "
    "the end") {
  FakeIio fake;
  fake.attribute("buffer/enable", "1\n");  // left on by a program that was killed
  fake.attribute("scan_elements/in_accel_x_en", "1\n");
  Stage stage;
  IioBufferConfig config = stage.config(fake);
  config.channels = {"temp"};
  config.rate = 50_Hz;
  config.watermark = 2;
  {
    IioBufferSensor one(stage.loop, {.name = "one"}, config);
    stage.until([&] { return fake.attribute("buffer/enable") == "1"; });
    CHECK(one.health() == Health::ok);
    CHECK(stage.log.find("was on, but no program had it open") != std::string::npos);
    CHECK(fake.attribute("scan_elements/in_temp_en") == "1");
    CHECK(fake.attribute("scan_elements/in_timestamp_en") == "1");
    CHECK(fake.attribute("scan_elements/in_accel_x_en") == "0");
    CHECK(fake.attribute("buffer/length") == "8");
    CHECK(fake.attribute("buffer/watermark") == "2");
    CHECK(fake.attribute("current_timestamp_clock") == "monotonic");
    CHECK(fake.attribute("trigger/current_trigger") == "mpu6050-dev0");
    CHECK(std::stod(fake.attribute("sampling_frequency")) == 50);
  }
  stage.until([&] { return fake.attribute("buffer/enable") == "0"; });

  fake.attribute("sampling_frequency", "100\n");
  IioBufferSensor imu(stage.loop, {.name = "imu"}, stage.config(fake));
  stage.until([&] { return fake.attribute("buffer/enable") == "1"; });
  const MonotonicTime first = stage.now() - 30ms;
  fake.scan(-2, 4095, first);
  fake.scan(300, 10, first + 10ms);
  fake.scan(0, 0, first + 20ms);
  stage.until([&] { return stage.values.size() == 3; });
  CHECK(stage.values[0].accel == -1);
  CHECK(stage.values[0].temp == doctest::Approx(8.170));  // (4095 - 10) * 2 m°C
  CHECK(stage.values[1].accel == 150);
  CHECK(stage.values[1].temp == 0);
  CHECK(stage.times[1] - stage.times[0] == 10ms);
  CHECK(stage.times[2] - stage.times[1] == 10ms);
  CHECK(imu.counts().published == 3);
  CHECK(!imu.counts().lost_is_known);
  CHECK(stage.errors.empty());
  imu.close();
  stage.until([&] { return fake.attribute("buffer/enable") == "0"; });
}

TEST_CASE(
    "FW-2 US-15 an IIO device buffered: scans that are missing, by their times or since the buffer was full, are told, "
    "and are a gap") {
  FakeIio fake;
  Stage stage;
  IioBufferSensor imu(stage.loop, {.name = "imu"}, stage.config(fake));
  stage.until([&] { return fake.attribute("buffer/enable") == "1"; });
  const MonotonicTime first = stage.now() - 500ms;
  SUBCASE("the times jump") {
    fake.scan(1, 0, first);
    fake.scan(2, 0, first + 10ms);
    fake.scan(3, 0, first + 50ms);
    stage.until([&] { return stage.values.size() == 3; });
    CHECK(stage.has_error(Errc::backlog, "about 3 by their times: the trigger or the driver skipped them"));
    CHECK(imu.health() == Health::degraded);
    fake.scan(4, 0, first + 60ms);
    stage.until([&] { return stage.values.size() == 4; });
    CHECK(imu.health() == Health::ok);
    CHECK(imu.status().outages.number == 1);
    CHECK(imu.status().outages.time == 40ms);
  }
  SUBCASE("an irregular trigger is none") {
    fake.scan(1, 0, first);
    fake.scan(2, 0, first + 16ms);
    fake.scan(3, 0, first + 20ms);
    stage.until([&] { return stage.values.size() == 3; });
    CHECK(stage.errors.empty());
    CHECK(imu.status().outages.number == 0);
  }
  SUBCASE("the buffer was full") {
    for (int i = 0; i < 8; ++i) fake.scan(1, 0, first + i * 10ms);
    stage.until([&] { return stage.values.size() == 8; });
    CHECK(stage.errors.empty());  // nobody knows yet whether more came
    fake.scan(2, 0, first + 140ms);
    stage.until([&] { return stage.values.size() == 9; });
    CHECK(stage.has_error(Errc::backlog, "the buffer was full: about 6 by their times"));
    CHECK(imu.status().outages.time == 70ms);
  }
  CHECK(imu.counts().balances());
}

TEST_CASE("FW-2 US-15 an IIO device buffered: times that cannot be are replaced by those of the reads, which is told") {
  FakeIio fake;
  Stage stage;
  IioBufferSensor imu(stage.loop, {.name = "imu"}, stage.config(fake));
  stage.until([&] { return fake.attribute("buffer/enable") == "1"; });
  const MonotonicTime before = stage.now();
  fake.scan(1, 0, MonotonicTime{});
  fake.scan(2, 0, before + 1h);
  stage.until([&] { return stage.values.size() == 2; });
  CHECK(stage.has_error(Errc::bad_data, "the times of scans are not used"));
  CHECK(stage.times[1] > stage.times[0]);
  CHECK(imu.health() == Health::degraded);
  fake.scan(3, 0, stage.now());
  stage.until([&] { return imu.health() == Health::ok; });
}

TEST_CASE(
    "FW-2 US-15 an IIO device buffered: a kernel that cannot be told its clock gives the time of day, which is put on "
    "our line") {
  FakeIio fake;
  ::unlink((fake.directory.path() + "/sys/bus/iio/devices/iio:device0/current_timestamp_clock").c_str());
  Stage stage;
  IioBufferSensor imu(stage.loop, {.name = "imu"}, stage.config(fake));
  stage.until([&] { return fake.attribute("buffer/enable") == "1"; });
  SystemClock clock;
  const Time wall = clock.realtime() - 20ms;
  fake.scan(1, 0, MonotonicTime{wall.time_since_epoch()});
  stage.until([&] { return stage.values.size() == 1; });
  CHECK(stage.errors.empty());
  const Duration apart = stage.times[0] - wall;
  CHECK(apart < 1ms);
  CHECK(apart > -1ms);
}

TEST_CASE(
    "FW-2 US-9 an IIO device buffered: a device that goes away is a fault and a gap, and is opened again when it is "
    "back") {
  FakeIio fake;
  Stage stage;
  IioBufferSensor imu(stage.loop, {.name = "imu"}, stage.config(fake));
  for (int round = 0; round < 3; ++round) {
    const std::size_t before = stage.values.size();
    stage.until([&] {
      if (stage.values.size() == before) fake.scan(1, 0, stage.now());
      return stage.values.size() > before && imu.health() == Health::ok;
    });
    fake.unplug();
    stage.until([&] { return imu.health() == Health::faulted; });
    CHECK(imu.status().outages.number == static_cast<std::uint64_t>(round) + 1);
    fake.plug_in();
  }
  CHECK(imu.counts().balances());
}

TEST_CASE("FW-2 US-15 an IIO device buffered: what cannot be set up says what, why and what to do") {
  FakeIio fake;
  Stage stage;
  IioBufferConfig config = stage.config(fake);
  config.required = true;
  int topics = 0;
  const auto refusal = [&]() -> std::string {
    try {
      IioBufferSensor imu(stage.loop, {.name = "imu" + std::to_string(++topics)}, config);
    } catch (const SetupError& error) {
      return error.error().text();
    }
    return "";
  };
  const auto says = [](const std::string& text, const char* part) {
    if (text.find(part) == std::string::npos) MESSAGE(text);
    return text.find(part) != std::string::npos;
  };
  config.device = "bmp280";
  CHECK(says(refusal(), "available: mpu6050 (iio:device0)"));
  config.device = "mpu6050";
  config.trigger = "timer";
  CHECK(says(refusal(), "there is no trigger timer"));
  config.trigger = "";
  config.channels = {"accel_y"};
  CHECK(says(refusal(), "did you mean accel_x?"));
  config.channels = {"pressure"};
  CHECK(says(refusal(), "channel pressure is not in its buffer"));
  config.channels = {"volt0"};
  CHECK(says(refusal(), "\"volt0\" is not a channel"));
  config.channels = {"temp"};
  config.watermark = 9;
  CHECK(says(refusal(), "watermark"));
  config.watermark = 1;
  fake.attribute("scan_elements/in_temp_type", "le:q12/16>>4\n");
  CHECK(says(refusal(), "channel temp is not in its buffer"));
  fake.unplug();
  fake.attribute("scan_elements/in_temp_type", "le:u12/16>>4\n");
  CHECK(says(refusal(), "iio:device0"));
  ::unlink((fake.directory.path() + "/sys/bus/iio/devices/iio:device0/buffer/enable").c_str());
  CHECK(says(refusal(), "its driver has no buffer"));
}

TEST_CASE("FW-2 US-15 an IIO device buffered: stopped while it is being opened, it turns nothing on that stays on") {
  FakeIio fake;
  {
    Stage stage;
    stage.until([] { return true; });  // the system runs: opening is not waited for
    Timer once(stage.loop, Duration{0}, [&] {
      for (int i = 0; i < 20; ++i) {
        IioBufferSensor imu(stage.loop, {.name = "imu"}, stage.config(fake));
        imu.stop();
      }
      stage.loop.stop();
    });
    stage.loop.run();
    CHECK(stage.loop.close() == 0);
  }
  CHECK(fake.attribute("buffer/enable") == "0");
}

TEST_SUITE_END();
