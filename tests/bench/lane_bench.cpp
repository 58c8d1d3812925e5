// lane_overhead, lane_overhead_100, many_files, four_adcs, gps_report: what reading devices on lanes, and gpsd, costs
// beside the same by hand.
#include <fcntl.h>
#include <glob.h>
#include <semaphore.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#ifdef RTDATA_BENCH_LIBGPS
#include <gps.h>
#else
#include <nlohmann/json.hpp>
#endif

#include "bare.hpp"
#include "harness.hpp"
#include "payloads.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/sensors/analog.hpp"
#include "rtdata/sensors/driver.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "sensors/gps/gps_report.hpp"

namespace bench {
namespace {

constexpr std::int64_t period = 10 * millisecond;

/// Files of converters, as the kernel shows them: files below /sys that hold a small number. A machine that shows fewer
/// has files of its own for the rest, each of which is looked up by its path before it is read, since it can be
/// replaced.
class AdcFiles {
 public:
  AdcFiles(const std::string& folder, std::size_t count) : scratch_(folder, "adc") {
    ::mkdir(scratch_.path().c_str(), 0700);
    for (const char* pattern : {"/sys/class/block/*/queue/*", "/sys/module/*/parameters/*", "/sys/class/net/*/*",
                                "/sys/devices/virtual/*/*/*", "/sys/devices/virtual/*/*/*/*", "/sys/kernel/mm/*/*"})
      add_matching(pattern, count);
    of_the_kernel_ = paths_.size();
    for (std::size_t i = of_the_kernel_; i < count; ++i) {
      paths_.push_back(scratch_.path() + "/" + std::to_string(i));
      std::ofstream(paths_.back()) << i % 4096 << "\n";
    }
  }
  AdcFiles(const AdcFiles&) = delete;
  AdcFiles& operator=(const AdcFiles&) = delete;
  ~AdcFiles() {
    for (std::size_t i = of_the_kernel_; i < paths_.size(); ++i) ::unlink(paths_[i].c_str());
    ::rmdir(scratch_.path().c_str());
  }
  const std::vector<std::string>& paths() const { return paths_; }
  std::size_t of_the_kernel() const { return of_the_kernel_; }

 private:
  void add_matching(const char* pattern, std::size_t count) {
    glob_t found{};
    if (::glob(pattern, 0, nullptr, &found) == 0)
      for (std::size_t i = 0; i < found.gl_pathc && paths_.size() < count; ++i)
        if (has_small_number(found.gl_pathv[i])) paths_.emplace_back(found.gl_pathv[i]);
    ::globfree(&found);
  }
  static bool has_small_number(const char* path) {
    struct stat status {};
    if (::stat(path, &status) != 0 || !S_ISREG(status.st_mode)) return false;
    std::string text;
    if (!std::getline(std::ifstream(path), text) || text.empty() || text.size() > 4) return false;
    return text.find_first_not_of("0123456789") == std::string::npos && std::atoi(text.c_str()) < 4096;
  }

  Scratch scratch_;
  std::vector<std::string> paths_;
  std::size_t of_the_kernel_ = 0;
};

class Sensors {
 public:
  explicit Sensors(const AdcFiles& files) {
    for (const std::string& path : files.paths()) {
      sensors_.emplace_back(
          loop_,
          rtdata::SensorConfig{
              .name = path, .topic = "adc", .rate = rtdata::Rate::from_period(rtdata::Duration{period})},
          rtdata::AnalogConfig{.file = path});
    }
    loop_.run_for(rtdata::Duration{2 * period});  // they are known, and open
  }
  /// CPU ns for a sample.
  double measure(std::int64_t time) {
    const std::uint64_t before = published();
    const std::int64_t begin = process_cpu_ns();
    loop_.run_for(rtdata::Duration{time});
    const std::int64_t end = process_cpu_ns();
    return static_cast<double>(end - begin) / static_cast<double>(published() - before);
  }

 private:
  std::uint64_t published() const {
    std::uint64_t sum = 0;
    for (const auto& sensor : sensors_) sum += sensor.counts().published;
    return sum;
  }
  rtdata::Loop loop_;
  std::vector<rtdata::AnalogSensor> sensors_;
};

class OpenFiles {
 public:
  explicit OpenFiles(const AdcFiles& files) {
    for (const std::string& path : files.paths()) fds_.push_back(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  }
  OpenFiles(const OpenFiles&) = delete;
  OpenFiles& operator=(const OpenFiles&) = delete;
  ~OpenFiles() {
    for (const int fd : fds_) ::close(fd);
  }
  std::size_t read_all() const {
    std::array<char, 128> text;
    for (const int fd : fds_) {
      const ssize_t got = ::pread(fd, text.data(), text.size(), 0);
      keep(got);
      keep(text);
    }
    return fds_.size();
  }

 private:
  std::vector<int> fds_;
};

/// All files in the thread of the timer.
template <class ReadAll>
double read_in_order(const ReadAll& read_all, std::int64_t time) {
  const BareTimer timer;
  std::size_t samples = 0;
  const std::int64_t begin = process_cpu_ns();
  std::int64_t due = on_grid(monotonic_ns());
  for (const std::int64_t end = due + time; due < end; due += period) {
    timer.arm(due);
    timer.wait();
    samples += read_all();
  }
  return static_cast<double>(process_cpu_ns() - begin) / static_cast<double>(samples);
}

/// All files by another thread, which is woken once for them, and wakes the first once.
double read_by_thread(const OpenFiles& files, std::int64_t time) {
  sem_t asked;
  ::sem_init(&asked, 0, 0);
  const int done = ::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
  const int timer = ::timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
  const int epoll = ::epoll_create1(EPOLL_CLOEXEC);
  for (const int fd : {done, timer}) {
    epoll_event event{};
    event.events = EPOLLIN;
    event.data.fd = fd;
    ::epoll_ctl(epoll, EPOLL_CTL_ADD, fd, &event);
  }
  std::atomic<bool> is_over{false};
  std::size_t samples = 0;
  std::thread reader([&] {
    for (;;) {
      while (::sem_wait(&asked) != 0) {
      }
      if (is_over) return;
      samples += files.read_all();
      constexpr std::uint64_t one = 1;
      if (::write(done, &one, sizeof one) != sizeof one) std::abort();
    }
  });
  const auto arm = [&](std::int64_t due) {
    itimerspec spec{};
    spec.it_value.tv_sec = due / 1'000'000'000;
    spec.it_value.tv_nsec = static_cast<decltype(spec.it_value.tv_nsec)>(due % 1'000'000'000);
    ::timerfd_settime(timer, TFD_TIMER_ABSTIME, &spec, nullptr);
  };
  const std::int64_t begin = process_cpu_ns();
  std::int64_t due = on_grid(monotonic_ns());
  const std::int64_t end = due + time;
  arm(due);
  for (bool is_reading = false; due < end || is_reading;) {
    epoll_event event{};
    if (::epoll_wait(epoll, &event, 1, -1) < 1) continue;
    if (event.data.fd == timer) {
      due += period;
      arm(due);
      if (is_reading || due > end) continue;
      is_reading = true;
      ::sem_post(&asked);
    } else {
      std::uint64_t count = 0;
      if (::read(done, &count, sizeof count) != sizeof count) std::abort();
      is_reading = false;
    }
  }
  const std::int64_t spent = process_cpu_ns() - begin;
  is_over = true;
  ::sem_post(&asked);
  reader.join();
  ::close(epoll);
  ::close(timer);
  ::close(done);
  ::sem_destroy(&asked);
  return static_cast<double>(spent) / static_cast<double>(samples);
}

Figure in_us(Figure figure) {
  figure.value /= 1e3;
  figure.limit /= 1e3;
  return figure;
}

void bench_handover(Report& report, const char* name, std::size_t count, double reach, std::int64_t time) {
  if (!report.wants(name)) return;
  const AdcFiles files(report.options().memory, count);
  Sensors sensors(files);
  const OpenFiles open(files);
  report.add(in_us(measure_pair(
      {.name = name, .unit = "us CPU/read", .reach = reach}, [&] { return sensors.measure(time); },
      [&] { return read_by_thread(open, time); })));
}

void bench_many_files(Report& report) {
  if (!report.wants("many_files")) return;
  const AdcFiles files(report.options().memory, 1000);
  Sensors sensors(files);
  const OpenFiles open(files);
  constexpr std::int64_t time = 300 * millisecond;
  report.add(in_us(measure_pair(
      {.name = "many_files", .unit = "us CPU/sample", .reach = 1.5}, [&] { return sensors.measure(time); },
      [&] { return read_in_order([&] { return open.read_all(); }, time); })));
  report.remark("many_files: " + std::to_string(files.of_the_kernel()) + " of the files are below /sys");
}

// ---- converters on one bus

constexpr rtdata::Duration conversion = std::chrono::milliseconds{8};

/// Begins a conversion by a register, which has its result later.
class Adc {
 public:
  struct Config {};
  using Value = Single;
  using Device = rtdata::I2cDevice;
  explicit Adc(const Config&) {}
  rtdata::Result<void> start(Device& chip) { return chip.write_register(1, 1); }
  rtdata::Duration conversion_time() const { return conversion; }
  rtdata::Result<Single> read(Device& chip) {
    const auto code = chip.read_word(0);
    if (!code) return code.error();
    return Single{static_cast<double>(*code)};
  }
};

/// In virtual time, in which the bus takes as long as at 400 kHz, and all else no time.
void bench_adcs(Report& report) {
  if (!report.wants("four_adcs")) return;
  constexpr unsigned count = 4;
  constexpr auto time = std::chrono::seconds{10};
  rtdata::Loop loop{rtdata::Loop::Manual{}};
  auto wires = std::make_shared<rtdata::FakeI2c>();
  rtdata::I2cBus bus("i2c1", wires);
  std::vector<rtdata::DriverSensor<Adc>> sensors;
  for (unsigned i = 0; i < count; ++i) {
    wires->chip(0x48 + i).set_duration(std::chrono::microseconds{75});
    sensors.emplace_back(
        loop, rtdata::SensorConfig{.name = "adc" + std::to_string(i), .rate = rtdata::Rate::from_period(conversion)},
        bus, rtdata::I2cDevice::Place{0x48 + i});
  }
  loop.advance(time);
  std::uint64_t samples = 0;
  for (const auto& sensor : sensors) samples += sensor.counts().published;
  Figure figure{.name = "four_adcs", .unit = "samples/s", .reach = 1.05};
  figure.limit = count * (std::chrono::seconds{1} / conversion);
  figure.value = static_cast<double>(samples) / static_cast<double>(time.count());
  figure.ratio = figure.limit / figure.value;
  report.add(figure);
}

// ---- gpsd

constexpr const char*
    gps_line = R"({"class":"TPV","device":"/dev/ttyACM0","status":2,"mode":3,"time":"2024-05-01T12:00:%02d.000Z","leapseconds":18,)"
               R"("ept":0.005,"lat":52.520008123,"lon":13.404954321,"altHAE":78.1234,"altMSL":34.5678,"alt":34.5678,"epx":2.1,)"
               R"("epy":2.9,"epv":5.2,"track":123.4567,"magtrack":127.1,"magvar":3.7,"speed":1.234,"climb":-0.012,"eps":5.8,)"
               R"("epc":10.4,"geoidSep":43.556,"eph":3.8,"sep":7.1})";

std::vector<std::string> gps_lines() {
  std::vector<std::string> lines;
  for (int i = 0; i < 60; ++i) {
    std::array<char, 1024> text;
    std::snprintf(text.data(), text.size(), gps_line, i);
    lines.emplace_back(text.data());
  }
  return lines;
}

constexpr int gps_rounds = 300;

double reports_to_events() {
  rtdata::Loop loop;
  rtdata::Feed<rtdata::GpsFix> feed(loop, {.name = "gps"});
  const std::vector<std::string> lines = gps_lines();
  rtdata::detail::GpsReport report;
  const std::int64_t begin = thread_cpu_ns();
  for (int round = 0; round < gps_rounds; ++round) {
    for (const std::string& line : lines) {
      report = {};
      if (!rtdata::detail::read_report(line, report)) std::abort();
      feed.publish(report.fix);
    }
  }
  return static_cast<double>(thread_cpu_ns() - begin) / static_cast<double>(gps_rounds * lines.size());
}

double reports_unpacked() {
  std::vector<std::string> lines = gps_lines();
#ifdef RTDATA_BENCH_LIBGPS
  const auto data = std::make_unique<gps_data_t>();
  std::memset(data.get(), 0, sizeof *data);
#endif
  const std::int64_t begin = thread_cpu_ns();
  for (int round = 0; round < gps_rounds; ++round) {
    for (std::string& line : lines) {
#ifdef RTDATA_BENCH_LIBGPS
      if (::gps_unpack(line.data(), data.get()) < 0) std::abort();
      keep(data->fix.latitude);
#else
      const auto parsed = nlohmann::json::parse(line);
      keep(parsed.size());
#endif
    }
  }
  return static_cast<double>(thread_cpu_ns() - begin) / static_cast<double>(gps_rounds * lines.size());
}

void bench_gps(Report& report) {
  if (!report.wants("gps_report")) return;
  Figure figure = in_us(
      measure_pair({.name = "gps_report", .unit = "us CPU", .reach = 1.3}, reports_to_events, reports_unpacked));
#ifndef RTDATA_BENCH_LIBGPS
  figure.note = "beside a JSON parser, since libgps-dev is not installed";
#endif
  report.add(figure);
}

}  // namespace

void bench_lanes(Report& report) {
  bench_handover(report, "lane_overhead", 1, 1.2, 1000 * millisecond);
  bench_handover(report, "lane_overhead_100", 100, 1.3, 400 * millisecond);
  bench_many_files(report);
  bench_adcs(report);
  bench_gps(report);
}

}  // namespace bench
