// iio_scans: what a scan of an IIO buffer costs, 8 channels of 16 bits and the time, from reading the descriptor to
// numbers in SI units, sixteen scans a read. iio_events: the same up to the handler of an event, through the sensor and
// its loop. Instead of the kernel's buffer there is a pipe, which is full to begin with.
#include <fcntl.h>
#include <poll.h>
#include <sys/epoll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include "harness.hpp"
#include "payloads.hpp"
#include "rtdata/io/iio.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/sensors/iio.hpp"

namespace bench {
namespace {

constexpr std::size_t channels = 8;
constexpr std::size_t scans_a_read = 16;
constexpr std::size_t scans_at_most = 512;  // as the sensor reads, where so many have come
constexpr std::size_t scans_a_fill = 2048;
constexpr int fills = 40;
constexpr double scale = 0.0025;

struct Scan {
  std::int16_t codes[channels];
  std::int64_t time;
};

/// A folder that looks like an IIO device, and the writing end of its buffer.
class FakeDevice {
 public:
  FakeDevice(const std::string& memory, const char* name)
      : root_(memory + "/rtdata_iio_bench." + std::to_string(::getpid()) + "." + name) {
    std::filesystem::create_directories(folder() + "/scan_elements");
    std::filesystem::create_directories(folder() + "/buffer");
    std::filesystem::create_directories(root_ + "/dev");
    write("name", "bench");
    write("sampling_frequency", "1000000");
    write("current_timestamp_clock", "realtime");
    write("in_voltage_scale", "2.5");
    for (std::size_t i = 0; i < channels; ++i) channel("voltage" + std::to_string(i), i, "le:s16/16>>0");
    channel("timestamp", channels, "le:s64/64>>0");
    write("buffer/enable", "0");
    const std::string node = root_ + "/dev/iio:device0";
    ::mkfifo(node.c_str(), 0600);
    fd_ = ::open(node.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
  }
  FakeDevice(const FakeDevice&) = delete;
  FakeDevice& operator=(const FakeDevice&) = delete;
  ~FakeDevice() {
    ::close(fd_);
    std::error_code ignored;
    std::filesystem::remove_all(root_, ignored);
  }
  const std::string& root() const { return root_; }
  static std::vector<std::string> names() {
    std::vector<std::string> all;
    for (std::size_t i = 0; i < channels; ++i) all.push_back("voltage" + std::to_string(i));
    return all;
  }
  /// Times a microsecond apart, up to now.
  void fill() {
    std::vector<Scan> scans(scans_a_fill);
    std::int64_t time = monotonic_ns() - 1000 * static_cast<std::int64_t>(scans_a_fill);
    time = std::max(time, last_ + 1000);
    for (Scan& scan : scans) {
      for (std::size_t i = 0; i < channels; ++i) scan.codes[i] = static_cast<std::int16_t>(1000 * i + time % 100);
      scan.time = time;
      last_ = time;
      time += 1000;
    }
    keep(::write(fd_, scans.data(), scans.size() * sizeof(Scan)));
  }

 private:
  std::string folder() const { return root_ + "/sys/bus/iio/devices/iio:device0"; }
  void write(const std::string& file, const std::string& text) const {
    std::ofstream(folder() + "/" + file) << text << "\n";
  }
  void channel(const std::string& name, std::size_t index, const std::string& type) const {
    write("scan_elements/in_" + name + "_en", "0");
    write("scan_elements/in_" + name + "_index", std::to_string(index));
    write("scan_elements/in_" + name + "_type", type);
    if (name != "timestamp") write("in_" + name + "_raw", "0");
  }
  std::string root_;
  int fd_ = -1;
  std::int64_t last_ = 0;
};

/// `take` takes all that is there and says how many scans that were.
double ns_per_scan(FakeDevice& device, const std::function<std::size_t()>& take) {
  std::int64_t spent = 0;
  std::size_t count = 0;
  for (int i = 0; i < fills; ++i) {
    device.fill();
    const std::int64_t begin = thread_cpu_ns();
    count += take();
    spent += thread_cpu_ns() - begin;
  }
  return count == fills * scans_a_fill ? static_cast<double>(spent) / static_cast<double>(count) : 1e9;
}

struct Sum {
  double value = 0;
  std::int64_t time = 0;
};

/// Of what a read has brought.
template <class Take>
void by_hand(const Scan* scans, std::size_t count, Take&& take) {
  for (std::size_t n = 0; n < count; ++n) {
    double values[channels];
    for (std::size_t i = 0; i < channels; ++i) values[i] = scans[n].codes[i] * scale;
    keep(values);
    take(values, scans[n].time);
  }
}

Figure measure_scans(Figure figure, FakeDevice& device) {
  auto capture = rtdata::IioCapture::open(rtdata::IioDevice::find("bench", device.root()).or_throw(),
                                          {.channels = FakeDevice::names()})
                     .or_throw();
  std::vector<std::byte> bytes(scans_a_read * capture.layout().size());
  Sum sum;
  const auto ours = [&] {
    std::size_t count = 0;
    const rtdata::IioLayout& layout = capture.layout();
    while (const std::size_t got = *capture.read(bytes)) {
      for (std::size_t at = 0; at < got; at += layout.size(), ++count) {
        double values[channels];
        layout.decode(&bytes[at], values);
        keep(values);
        sum.time += layout.timestamp(&bytes[at]);
      }
    }
    return count;
  };
  Scan scans[scans_a_read];
  const auto limit = [&] {
    std::size_t count = 0;
    ssize_t got = 0;
    while ((got = ::read(capture.fd(), scans, sizeof scans)) > 0) {
      by_hand(scans, static_cast<std::size_t>(got) / sizeof(Scan),
              [&](const double*, std::int64_t time) { sum.time += time; });
      count += static_cast<std::size_t>(got) / sizeof(Scan);
    }
    return count;
  };
  const Figure measured = measure_pair(
      std::move(figure), [&] { return ns_per_scan(device, ours); }, [&] { return ns_per_scan(device, limit); }, 15);
  keep(sum);
  return measured;
}

Figure measure_events(Figure figure, FakeDevice& of_ours, FakeDevice& of_limit) {
  rtdata::Runtime runtime({.ring_events = 2 * scans_a_fill});
  runtime.on_log([](const rtdata::LogRecord&) {});
  rtdata::Loop loop(runtime, {.name = "main"});
  Sum sum;
  std::size_t events = 0;
  const auto heard = loop.subscribe("adc", [&](const rtdata::EventView& event) {
    double first = 0;
    std::memcpy(&first, event.payload().data(), sizeof first);
    sum.value += first;
    ++events;
  });
  rtdata::IioBufferSensor sensor(
      loop, {.name = "adc"},
      {.device = "bench", .channels = FakeDevice::names(), .length = scans_at_most, .root = of_ours.root()});
  const auto ours = [&] {
    events = 0;
    for (std::size_t turns = 0; events < scans_a_fill && turns < 4 * scans_a_fill; ++turns) loop.poll();
    return events;
  };
  const int fd = ::open((of_limit.root() + "/dev/iio:device0").c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
  const int epoll = ::epoll_create1(EPOLL_CLOEXEC);
  epoll_event wanted{};
  wanted.events = EPOLLIN;
  ::epoll_ctl(epoll, EPOLL_CTL_ADD, fd, &wanted);
  const std::function<void(const rtdata::Event<Eight>&)> handler = [&](const rtdata::Event<Eight>& event) {
    sum.value += event->a;
    ++events;
  };
  std::uint64_t sequence = 0;
  const auto take = [&](const double* values, std::int64_t time) {
    rtdata::Event<Eight> event;
    event.time = rtdata::from_nanoseconds(time);
    event.sequence = ++sequence;
    event.origin = "adc";
    std::memcpy(static_cast<void*>(&event.data), values, sizeof event.data);
    keep(event);
    handler(event);
  };
  const auto limit = [&] {
    events = 0;
    Scan scans[scans_at_most];
    epoll_event ready{};
    while (::epoll_wait(epoll, &ready, 1, 0) == 1) {
      const ssize_t got = ::read(fd, scans, sizeof scans);
      if (got > 0) by_hand(scans, static_cast<std::size_t>(got) / sizeof(Scan), take);
    }
    return events;
  };
  const Figure measured = measure_pair(
      std::move(figure), [&] { return ns_per_scan(of_ours, ours); }, [&] { return ns_per_scan(of_limit, limit); }, 15);
  keep(sum);
  ::close(epoll);
  ::close(fd);
  return measured;
}

}  // namespace

void bench_iio(Report& report) {
  if (report.wants("iio_scans")) {
    FakeDevice device(report.options().memory, "scans");
    report.add(measure_scans({.name = "iio_scans", .unit = "ns/scan", .reach = 1.3}, device));
  }
  if (report.wants("iio_events")) {
    FakeDevice ours(report.options().memory, "ours"), limit(report.options().memory, "limit");
    report.add(measure_events({.name = "iio_events", .unit = "ns/scan", .reach = 2}, ours, limit));
  }
}

}  // namespace bench
