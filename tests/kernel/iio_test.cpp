// IIO, 1-Wire and PPS on the kernel's own drivers: the dummy device with a timer, inv_mpu6050, bmp280, mcp320x,
// w1_therm.
#include <doctest/doctest.h>
#include <signal.h>
#include <sys/timex.h>
#include <sys/wait.h>

#include <cmath>
#include <cstring>
#include <functional>
#include <thread>
#include <vector>

#include "kernel/bench.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/io/iio.hpp"
#include "rtdata/sensors/analog.hpp"
#include "rtdata/sensors/iio.hpp"
#include "rtdata/sensors/pps.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sensors/w1.hpp"

using namespace bench;

namespace {

bool run(const std::string& command) { return std::system(command.c_str()) == 0; }

std::string text_in(const std::string& path) {
  std::ifstream file(path);
  std::string text;
  std::getline(file, text);
  return text;
}

/// The kernel's driver of the MPU-6050, on its simulated chip at 100 kHz and more.
struct Mpu {
  Mpu() {
    CHECK(run("modprobe inv-mpu6050-i2c"));
    bus = device("I2C").substr(device("I2C").rfind('-') + 1);
    if (!IioDevice::find("mpu6050")) bind();
    set_ramp(false);
  }
  void bind() const { put("/sys/bus/i2c/drivers/inv-mpu6050-i2c/bind", bus + "-0068"); }
  void unbind() const { put("/sys/bus/i2c/drivers/inv-mpu6050-i2c/unbind", bus + "-0068"); }
  static void set_ramp(bool on) { put(device("SIM") + "/i2c-68/ramp", on ? "1" : "0"); }
  std::string bus;
};

double value_of(const EventView& event, std::size_t index) {
  double value = 0;
  REQUIRE(event.payload().size() >= (index + 1) * sizeof value);
  std::memcpy(&value, event.payload().data() + index * sizeof value, sizeof value);
  return value;
}

/// What another sensor reads meanwhile.
struct Count {
  std::int32_t count = 0;
  RTDATA_FIELDS(Count, (count))
};

/// What a sensor says, until something is so.
struct Stage {
  explicit Stage(const char* topic) {
    loop.runtime().on_log([this](const LogRecord& record) { log += std::string(record.text) + "\n"; });
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error); });
    heard = loop.subscribe(topic, [this](const EventView& event) {
      ++events;
      if (on_event) on_event(event);
    });
  }
  void until(const std::function<bool()>& is_so, Duration patience = 30s) {
    const Timer end = limit(loop, patience);
    bool done = false;
    const Ticker look(loop, 5ms, [&](const Tick&) {
      done = done || is_so();
      if (done) loop.stop();
    });
    loop.run();
    std::string all;
    for (const Error& error : errors) all += error.text() + "\n";
    CAPTURE(all);
    CHECK(done);
  }
  bool has_error(Errc code, const std::string& part) const {
    for (const Error& error : errors) {
      if (error.code == code && error.text().find(part) != std::string::npos) return true;
    }
    return false;
  }
  Loop loop;
  std::string log;
  std::vector<Error> errors;
  std::uint64_t events = 0;
  std::function<void(const EventView&)> on_event;
  Subscription heard;
};

/// Another program that has the device open.
class Holder {
 public:
  explicit Holder(const std::string& node) {
    int ready[2];
    CHECK(::pipe(ready) == 0);
    pid_ = ::fork();
    if (pid_ == 0) {
      const int fd = ::open(node.c_str(), O_RDONLY | O_CLOEXEC);
      const char answer = fd >= 0 ? 'y' : 'n';
      [[maybe_unused]] const auto said = ::write(ready[1], &answer, 1);
      for (;;) ::pause();
    }
    char answer = 0;
    CHECK(::read(ready[0], &answer, 1) == 1);
    CHECK(answer == 'y');
    ::close(ready[0]);
    ::close(ready[1]);
  }
  ~Holder() { end(); }
  void end() {
    if (pid_ <= 0) return;
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
    pid_ = -1;
  }
  std::string pid() const { return std::to_string(pid_); }

 private:
  pid_t pid_ = -1;
};

}  // namespace

TEST_SUITE_BEGIN("iio");

TEST_CASE("FW-2 NFR-3 the dummy device's scans, at the rate of a timer, in SI units with the kernel's times") {
  const IioDevice dummy = IioDevice::find(device("IIO")).or_throw();
  const std::vector<std::string> channels{"accel_x", "voltage0", "voltage1-voltage2"};
  std::vector<double> wanted;
  const double codes[] = {344, 7, -33};  // of the driver's table
  for (std::size_t i = 0; i < channels.size(); ++i) {
    const auto conversion = dummy.scan_conversion(*dummy.channel(channels[i])).or_throw();
    wanted.push_back((codes[i] + conversion.offset) * conversion.scale);
  }
  recordings::Folder folder;
  const std::string path = folder / "run.db";
  {
    Stage stage("dummy");
    SqliteSink sink(stage.loop, {.path = path});
    std::uint64_t wrong = 0, steady = 0;
    Time last{};
    stage.on_event = [&](const EventView& event) {
      for (std::size_t i = 0; i < wanted.size(); ++i) {
        if (value_of(event, i) != wanted[i]) ++wrong;
      }
      const Duration apart = event.time() - last;
      last = event.time();
      if (apart > 4ms && apart < 6ms) ++steady;
    };
    IioBufferSensor sensor(stage.loop, {.name = "dummy"},
                           {.device = device("IIO"),
                            .channels = channels,
                            .trigger = device("IIO_TRIGGER"),
                            .rate = 200_Hz,
                            .watermark = 4,
                            .required = true});
    CHECK(text_in("/sys/bus/iio/devices/trigger0/sampling_frequency").substr(0, 3) == "200");
    CHECK(text_in(dummy.folder() + "/current_timestamp_clock") == "monotonic");
    stage.until([&] { return stage.events >= 200; });
    CHECK(wrong == 0);
    CHECK(steady > 100);
    CHECK(sensor.counts().published >= 200);
    sensor.close();
    close_balanced(stage.loop);
  }
  CHECK(text_in(dummy.folder() + "/buffer/enable") == "0");
  check_verifies(path);
}

TEST_CASE(
    "FW-2 NFR-3 an IIO device that another program has is an error that names it, until it is free; a kill is no "
    "harm") {
  const IioDevice dummy = IioDevice::find(device("IIO")).or_throw();
  Stage stage("dummy");
  put(dummy.folder() + "/trigger/current_trigger", device("IIO_TRIGGER"));
  Holder holder(dummy.node());
  const IioBufferConfig config{.device = device("IIO"),
                               .channels = {"accel_x"},
                               .trigger = device("IIO_TRIGGER"),
                               .retry_first = 50ms,
                               .retry_longest = 100ms};
  IioBufferSensor sensor(stage.loop, {.name = "dummy"}, config);
  CHECK(sensor.health() == Health::faulted);
  CHECK(stage.has_error(Errc::busy, "process " + holder.pid()));
  // That program has turned the buffer on, and is killed: the kernel leaves it on.
  put(dummy.folder() + "/scan_elements/in_accel_x_en", "1");
  put(dummy.folder() + "/buffer/enable", "1");
  holder.end();
  stage.until([&] { return stage.events >= 5; });
  CHECK(sensor.health() == Health::ok);
  CHECK(stage.log.find("no program had it open") != std::string::npos);
  sensor.close();
  CHECK(stage.loop.close() == 0);
}

TEST_CASE(
    "FW-2 NFR-3 an IIO device without a trigger, a rate that it cannot do, a channel that it lacks: each is told") {
  const auto refusal = [](IioBufferConfig config) {
    Loop loop;
    be_quiet(loop);
    config.required = true;
    try {
      IioBufferSensor sensor(loop, {.name = "s"}, config);
    } catch (const SetupError& error) {
      return error.error().text();
    }
    return std::string();
  };
  const Mpu mpu;
  put(IioDevice::find(device("IIO")).or_throw().folder() + "/trigger/current_trigger", "\n");
  const std::string without = refusal({.device = device("IIO"), .channels = {"accel_x"}});
  CHECK_MESSAGE(without.find("it has no trigger") != std::string::npos, without);
  const std::string rate = refusal({.device = "mpu6050", .channels = {"accel_x"}, .rate = Rate::hertz(3)});
  CHECK_MESSAGE(rate.find("3 Hz was refused") != std::string::npos, rate);
  CHECK_MESSAGE(rate.find("choose one of its rates: 10 20 50") != std::string::npos, rate);
  CHECK(refusal({.device = "mpu6050", .channels = {"accel_w"}}).find("no channel accel_w") != std::string::npos);
  CHECK(refusal({.device = "mcp3208", .channels = {"voltage0"}}).find("its driver has no buffer") != std::string::npos);
  CHECK(refusal({.device = "mpu6050", .channels = {"accel_x"}, .trigger = "nobody"}).find("no trigger nobody") !=
        std::string::npos);
}

TEST_CASE("US-15 NFR-3 an IMU of the kernel's: no sample is lost unseen, by the chip's own counter") {
  const Mpu mpu;
  const IioDevice imu = IioDevice::find("mpu6050").or_throw();
  const double scale = imu.scan_conversion(*imu.channel("anglvel_z")).or_throw().scale;
  Mpu::set_ramp(true);
  recordings::Folder folder;
  const std::string path = folder / "run.db";
  {
    Stage stage("imu");
    SqliteSink sink(stage.loop, {.path = path});
    std::uint64_t missing = 0, jumps = 0;
    std::optional<std::uint16_t> last;
    stage.on_event = [&](const EventView& event) {
      const auto code = static_cast<std::uint16_t>(static_cast<std::int32_t>(std::lround(value_of(event, 1) / scale)));
      if (last && code != static_cast<std::uint16_t>(*last + 1)) {
        ++jumps;
        missing += static_cast<std::uint16_t>(code - *last - 1);
      }
      last = code;
    };
    IioBufferSensor sensor(
        stage.loop, {.name = "imu"},
        {.device = "mpu6050", .channels = {"accel_z", "anglvel_z"}, .rate = 100_Hz, .length = 16, .required = true});
    stage.until([&] { return stage.events >= 300; });
    CHECK(missing == 0);
    CHECK_FALSE(stage.has_error(Errc::backlog, ""));
    const std::size_t before = stage.errors.size();
    // Something holds the loop for longer than the buffer lasts.
    Timer hold(stage.loop, 10ms, [] { std::this_thread::sleep_for(1s); });
    const std::uint64_t events = stage.events;
    stage.until([&] { return stage.events >= events + 100; });
    CHECK(missing > 20);
    CHECK(jumps > 0);
    CHECK(stage.errors.size() > before);
    CHECK(stage.has_error(Errc::backlog, "scans are missing"));
    CHECK(sensor.status().outages.number >= 1);
    const double seconds = std::chrono::duration<double>(sensor.status().outages.time).count();
    CHECK(seconds == doctest::Approx(static_cast<double>(missing) / 100).epsilon(0.25));
    CHECK(!sensor.counts().lost_is_known);
    sensor.close();
    close_balanced(stage.loop);
  }
  Mpu::set_ramp(false);
  check_verifies(path);
}

TEST_CASE("US-9 NFR-1 NFR-3 an IIO device is unplugged and plugged in again; no other sensor misses a tick") {
  const Mpu mpu;
  Stage stage("imu");
  IioBufferSensor buffered(stage.loop, {.name = "imu"},
                           {.device = "mpu6050",
                            .channels = {"accel_z"},
                            .rate = 50_Hz,
                            .retry_first = 50ms,
                            .retry_longest = 200ms,
                            .required = true});
  Sensor<Count> other(stage.loop, {.name = "other", .rate = 10_Hz}, [count = 0]() mutable { return Count{++count}; });
  for (int round = 0; round < 2; ++round) {
    const std::uint64_t before = stage.events;
    stage.until([&] { return stage.events > before + 10 && buffered.health() == Health::ok; });
    std::thread unplug([&] { mpu.unbind(); });
    stage.until([&] { return buffered.health() == Health::faulted; });
    unplug.join();
    stage.until([&, looks = 0]() mutable { return ++looks > 50; });
    std::thread plug([&] { mpu.bind(); });
    stage.until([&] { return buffered.health() == Health::ok; });
    plug.join();
  }
  CHECK(buffered.status().outages.number >= 2);
  CHECK(other.counts().taken > 10);
  if (is_time_simulated()) CHECK(other.counts().missed == 0);  // else a busy machine may hold the bench itself
  CHECK(other.counts().failed == 0);
  buffered.close();
  close_balanced(stage.loop);
}

TEST_CASE("FW-2 NFR-3 polled: a barometer of the kernel's in SI units, unplugged and plugged in again") {
  CHECK(run("modprobe bmp280-i2c"));
  const std::string bus = "/sys/bus/i2c/devices/" + device("I2C").substr(5);
  const auto plug_in = [&] { put(bus + "/new_device", "bmp280 0x76"); };
  const auto unplug = [&] { put(bus + "/delete_device", "0x76"); };
  plug_in();
  Stage stage("weather");
  double degrees = 0, pascals = 0;
  stage.on_event = [&](const EventView& event) {
    degrees = value_of(event, 0);
    pascals = value_of(event, 1);
  };
  IioSensor sensor(stage.loop, {.name = "weather", .rate = 10_Hz, .retry_first = 50ms, .retry_longest = 200ms},
                   {.device = "bmp280", .channels = {"temp", "pressure"}});
  stage.until([&] { return stage.events >= 3; });
  CHECK(degrees == doctest::Approx(25.08).epsilon(0.001));  // the data sheet's worked example
  CHECK(pascals == doctest::Approx(100653).epsilon(0.0002));
  Chip("i2c-76").fail(1000, EIO);
  stage.until([&] { return sensor.health() == Health::faulted; });
  Chip("i2c-76").fail(0, EIO);
  stage.until([&] { return sensor.health() == Health::ok; });
  unplug();
  stage.until([&] { return sensor.health() == Health::faulted; });
  plug_in();
  stage.until([&] { return sensor.health() == Health::ok; });
  sensor.close();
  unplug();
  close_balanced(stage.loop);
}

TEST_CASE("US-10 NFR-3 an analog sensor names its converter by device and channel") {
  const Chip chip("spi");
  chip.set_input(3, 1234);
  Stage stage("chamber");
  std::int64_t code = 0;
  stage.on_event = [&](const EventView& event) { code = analog_reading(event).value().raw; };
  AnalogSensor sensor(stage.loop, {.name = "chamber", .rate = 50_Hz}, {.device = "mcp3208", .channel = "voltage3"});
  stage.until([&] { return stage.events >= 3; });
  CHECK(code == 1234);
  sensor.close();
  close_balanced(stage.loop);
}

TEST_CASE(
    "FW-2 NFR-3 a DS18B20 through w1_therm: degrees, what is none, absent and back; no other sensor misses a tick") {
  const std::string sim = device("SIM");
  put(sim + "/w1_temp16", std::to_string(25 * 16 + 1));
  Stage stage("boiler");
  double degrees = 0;
  stage.on_event = [&](const EventView& event) { degrees = value_of(event, 0); };
  W1Sensor sensor(stage.loop,
                  {.name = "boiler", .rate = 1_Hz, .faulted_after = 2, .retry_first = 50ms, .retry_longest = 200ms},
                  {.device = "28-000000c0ffee"});
  Sensor<Count> other(stage.loop, {.name = "other", .rate = 10_Hz}, [count = 0]() mutable { return Count{++count}; });
  stage.until([&] { return stage.events >= 2; });
  CHECK(degrees == doctest::Approx(25.062));
  put(sim + "/w1_temp16", std::to_string(85 * 16));
  stage.until([&] { return sensor.counts().unreadable >= 2; });
  CHECK(stage.has_error(Errc::bad_data, "before the first measurement"));
  put(sim + "/w1_temp16", std::to_string(0x10000 - 10 * 16));
  stage.until([&] { return sensor.health() == Health::ok; });
  stage.until([&] { return degrees < 0; });
  CHECK(degrees == doctest::Approx(-10));
  put(sim + "/w1_absent", "1");
  stage.until([&] { return sensor.health() == Health::faulted; });
  put(sim + "/w1_absent", "0");
  stage.until([&] { return sensor.health() == Health::ok; }, 60s);
  if (is_time_simulated()) CHECK(other.counts().missed == 0);  // else a busy machine may hold the bench itself
  sensor.close();
  close_balanced(stage.loop);
}

TEST_CASE(
    "FW-2 NFR-3 pulses of the kernel are events of which none is lost, and tell the time of day once they begin "
    "seconds") {
  Stage stage("pps");
  std::vector<Time> times;
  PpsPulse last;
  stage.on_event = [&](const EventView& event) {
    times.push_back(event.time());
    std::memcpy(&last, event.payload().data(), sizeof last);
  };
  PpsSensor sensor(stage.loop, {.name = "pps"}, {.device = device("PPS"), .accuracy = 40ms});
  stage.until([&] { return times.size() >= 3; });
  for (std::size_t i = 1; i < times.size(); ++i)
    CHECK(static_cast<double>((times[i] - times[i - 1]).count()) == doctest::Approx(1e9).epsilon(0.1));
  CHECK(sensor.counts().lost == 0);
  CHECK(sensor.counts().lost_is_known);
  const auto noted = [&] {
    std::vector<ClockPair> of_pps;
    for (const ClockPair& pair : stage.loop.core().runtime.clock_log.pairs()) {
      if (pair.source.starts_with("pps")) of_pps.push_back(pair);
    }
    return of_pps;
  };
  CHECK(noted().empty());  // nobody keeps the clock

  // It is set so that pulses come 0.1 s before seconds, and says that it is kept to 0.2 s. (The pulses of pps-ktimer
  // are some per cent of a second further apart.)
  const Time before = SystemClock().realtime();
  const Duration off = std::chrono::duration_cast<Duration>(std::chrono::duration<double>(last.clock_error)) + 100ms;
  const std::int64_t right = (before - off).time_since_epoch().count();
  const timespec set{right / 1'000'000'000, static_cast<long>(right % 1'000'000'000)};
  CHECK(::clock_settime(CLOCK_REALTIME, &set) == 0);
  timex kept{};
  kept.modes = ADJ_STATUS | ADJ_ESTERROR | ADJ_MAXERROR;
  kept.status = STA_PLL;
  kept.esterror = kept.maxerror = 200'000;
  CHECK(::adjtimex(&kept) >= 0);
  REQUIRE(SystemClock().accuracy().has_value());
  stage.until([&] { return !noted().empty(); });
  REQUIRE(!noted().empty());
  const ClockPair pair = noted().back();
  CHECK(pair.realtime.time_since_epoch() % 1s == 0s);
  CHECK(*pair.accuracy == 40ms);
  CHECK(sensor.counts().lost == 0);
  kept.modes = ADJ_STATUS;
  kept.status = STA_UNSYNC;
  ::adjtimex(&kept);
  sensor.close();
  close_balanced(stage.loop);
}

TEST_SUITE_END();
