#include "rtdata/sensors/host.hpp"

#include <dirent.h>
#include <fcntl.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <functional>
#include <iterator>
#include <optional>
#include <type_traits>
#include <utility>

#include "data/first_line.hpp"
#include "data/setting_mistake.hpp"
#include "rtdata/detail/io/descriptor.hpp"
#include "sensors/core/sysfs_file.hpp"
#include "sensors/host/host_text.hpp"
#include "sensors/host/hwmon.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_read = "cannot read this computer's counters";
constexpr const char* not_here =
    "choose another `quantity` (`rtdata types host` lists those of this computer): its kernel does not have this one";
constexpr const char* not_now = "see `dmesg`: the kernel cannot read the value now";

/// A file of /proc that stays open; its buffer grows until the text fits.
class ProcFile {
 public:
  explicit ProcFile(std::string path) : path_(std::move(path)), buffer_(4096) {}

  Result<void> open() {
    fd_.set(::open(path_.c_str(), O_RDONLY | O_CLOEXEC | O_NOCTTY | O_NONBLOCK));  // below `root` there may be a pipe
    if (fd_.fd() < 0) return system_error(errno, cannot_read, path_, not_here);
    return {};
  }
  void close() noexcept { fd_.set(-1); }
  /// Valid until the next read. A text longer than a megabyte is an error.
  Result<std::string_view> read() {
    constexpr std::size_t most = 1 << 20;
    std::size_t size = 0;
    for (;;) {
      const ssize_t got = ::pread(fd_.fd(), buffer_.data() + size, buffer_.size() - size, static_cast<off_t>(size));
      if (got < 0 && errno == EINTR) continue;
      if (got < 0) return system_error(errno, cannot_read, path_, not_now);
      size += static_cast<std::size_t>(got);
      // A short text comes whole; a long one in pieces, until nothing more comes.
      if (got == 0 || size < 1024) return std::string_view(buffer_.data(), size);
      if (size < buffer_.size()) continue;
      if (size == most) return Error{Errc::does_not_fit, cannot_read, path_, "it is longer than a megabyte", ""};
      buffer_.resize(2 * size);
    }
  }

 private:
  std::string path_;
  detail::Descriptor fd_;
  std::vector<char> buffer_;
};

/// An unexpected text is unreadable; a missing counter is a failure.
template <class T>
Reading<T> sorted_out(Reading<T> reading) {
  if (Error* error = reading.error(); error != nullptr && error->code == Errc::bad_data)
    return Unreadable{std::move(*error)};
  return reading;
}

/// Reads inline and parses.
template <class T>
struct ProcDevice {
  ProcFile file;
  std::function<Reading<T>(std::string_view)> parse;
  Duration held;

  Duration read_time() const noexcept { return held; }
  Result<void> open() { return file.open(); }
  void close() noexcept { file.close(); }
  Reading<T> read() {
    const Result<std::string_view> text = file.read();
    return text ? sorted_out(parse(*text)) : Reading<T>(text.error());
  }
};

struct CpuDevice {
  ProcFile file;
  std::string device;
  Duration held;
  std::optional<detail::CpuTicks> before = {};

  Duration read_time() const noexcept { return held; }
  Result<void> open() {
    before.reset();
    return file.open();
  }
  void close() noexcept { file.close(); }
  Reading<HostCpu> read() {
    const Result<std::string_view> text = file.read();
    if (!text) return text.error();
    const Result<detail::CpuTicks> now = detail::parse_cpu(*text, device);
    if (!now) return sorted_out(Reading<HostCpu>(now.error()));
    const auto last = std::exchange(before, *now);
    return last ? detail::cpu_shares(*last, *now) : Reading<HostCpu>(nothing_new);
  }
};

/// The files of /sys for one value.
struct SysFiles {
  std::string value;
  std::string fault = {};  ///< says whether the value is valid; empty: no such file
  std::vector<std::string> alarms = {};
};

class FindFiles final : public detail::Transaction {
 public:
  using Find = std::function<Result<SysFiles>()>;
  explicit FindFiles(Find find) : find_(std::move(find)) {}
  void transact() noexcept override try {
    files = find_();
    if (!files) return;
    if (auto readable = detail::check_readable(files->value, cannot_read, not_here); !readable)
      files = std::move(readable).error();
  } catch (...) {  // so short that it needs no memory
    files = Error{Errc::io_failed, "no memory", "", "", ""};
  }
  Result<SysFiles> files = SysFiles{};

 private:
  const Find find_;
};

class ReadFiles final : public detail::Transaction {
 public:
  explicit ReadFiles(const SysFiles& files) : value(files.value) {
    if (!files.fault.empty()) fault = std::make_unique<detail::SysfsFile>(files.fault);
    for (const std::string& alarm : files.alarms) alarms.push_back(std::make_unique<detail::SysfsFile>(alarm));
  }
  void transact() noexcept override {
    value.read();
    if (fault != nullptr) fault->read();
    for (const auto& alarm : alarms) alarm->read();
  }
  void close() noexcept override {
    value.close();
    if (fault != nullptr) fault->close();
    for (const auto& alarm : alarms) alarm->close();
  }
  detail::SysfsFile value;
  std::unique_ptr<detail::SysfsFile> fault;
  std::vector<std::unique_ptr<detail::SysfsFile>> alarms;
};

/// Empty: the chip does not report it.
std::optional<bool> flag_in(const detail::SysfsFile& file) {
  if (file.error_number() != 0) return {};
  const Result<std::int64_t> number = detail::parse_number(file.text());
  return number ? std::optional(*number != 0) : std::nullopt;
}

/// One number of /sys, on the device's lane. `T` has one double, and where it has more, `alarm`.
template <class T>
class SysDevice final : public detail::LaneDevice {
 public:
  SysDevice(FindFiles::Find find, double factor, HostConfig config)
      : find_(std::move(find)), factor_(factor), config_(std::move(config)) {}

  std::shared_ptr<detail::Transaction> make_opening() override { return std::make_shared<FindFiles>(find_); }
  Result<void> take_opening(detail::Transaction& opening) override {
    auto& files = static_cast<FindFiles&>(opening).files;
    if (!files) return files.error();
    files_ = std::move(*files);
    return {};
  }
  std::shared_ptr<detail::Transaction> make_transaction() override { return std::make_shared<ReadFiles>(files_); }
  std::string lane_key() const override { return read_time().lane; }
  Duration give_up_after() const override { return config_.timeout; }
  ReadTime read_time() const override { return rtdata::read_time(config_); }
  Error given_up_error() const override {
    return {Errc::timed_out, cannot_read, files_.value, "no answer within " + to_string(config_.timeout),
            "check the chip; `timeout` sets how long to wait"};
  }
  detail::Sampled decode(detail::Transaction& transaction, detail::SamplePort& port) override {
    const auto& read = static_cast<ReadFiles&>(transaction);
    // A broken sensor may nevertheless have a value, or give an error for it.
    if (read.fault != nullptr && flag_in(*read.fault).value_or(false)) {
      return port.fail({Errc::bad_data, cannot_read, read.fault->path(), "the chip reports a fault of its sensor",
                        "check the sensor and its wires"});
    }
    const detail::SysfsFile& file = read.value;
    if (file.error_number() != 0)
      return port.fail(system_error(file.error_number(), cannot_read, file.path(), not_now));
    Result<std::int64_t> number = detail::parse_number(file.text());
    if (!number) {
      Error error = std::move(number).error();
      error.where = file.path();
      return port.unreadable(std::move(error));
    }
    T payload{static_cast<double>(*number) * factor_};
    if constexpr (requires { payload.alarm; }) payload.alarm = alarm_in(read);
    port.publish(&payload);
    return detail::Sampled::value;
  }

 private:
  static std::optional<bool> alarm_in(const ReadFiles& read) {
    bool is_reported = !read.alarms.empty();
    for (const auto& alarm : read.alarms) {
      const std::optional<bool> flag = flag_in(*alarm);
      if (flag.value_or(false)) return true;
      is_reported = is_reported && flag;
    }
    return is_reported ? std::optional(false) : std::nullopt;
  }

  FindFiles::Find find_;
  double factor_;
  HostConfig config_;
  SysFiles files_;
};

/// The names in a directory, in the order of their numbers; none when it is not there.
std::vector<std::string> names_in(const std::string& directory) {
  std::vector<std::string> names;
  if (DIR* open = ::opendir(directory.c_str())) {
    while (const dirent* entry = ::readdir(open)) {
      if (entry->d_name[0] != '.') names.emplace_back(entry->d_name);
    }
    ::closedir(open);
  }
  std::sort(names.begin(), names.end(), [](const std::string& a, const std::string& b) {
    return a.size() != b.size() ? a.size() < b.size() : a < b;
  });
  return names;
}

std::vector<HostSensorInfo> thermal_zones(const std::string& root) {
  std::vector<HostSensorInfo> found;
  const std::string zones = root + "/sys/class/thermal/";
  for (const std::string& zone : names_in(zones)) {
    if (zone.starts_with("thermal_zone"))
      found.push_back({HostQuantity::temperature, zone, detail::first_line((zones + zone + "/type").c_str()),
                       zones + zone + "/temp"});
  }
  return found;
}

/// hwmon's names and units of a quantity's inputs (Documentation/hwmon/sysfs-interface.rst).
struct HwmonKind {
  HostQuantity quantity;
  const char* prefix;
  double factor;
};
constexpr HwmonKind hwmon_kinds[] = {
    {HostQuantity::temperature, "temp", 1e-3},
    {HostQuantity::voltage, "in", 1e-3},
    {HostQuantity::current, "curr", 1e-3},
    {HostQuantity::power, "power", 1e-6},
    {HostQuantity::fan, "fan", 1},
    {HostQuantity::humidity, "humidity", 1e-3},
    {HostQuantity::energy, "energy", 1e-6},
};
const HwmonKind& hwmon_kind(HostQuantity quantity) {
  return *std::find_if(std::begin(hwmon_kinds), std::end(hwmon_kinds),
                       [quantity](const HwmonKind& kind) { return kind.quantity == quantity; });
}

Result<SysFiles> find_input(const HostConfig& config) {
  const bool is_temperature = config.quantity == HostQuantity::temperature;
  std::string device = config.device;
  if (is_temperature && device.empty()) {
    const auto zones = thermal_zones(config.root);
    const auto inputs = zones.empty() ? detail::hwmon_inputs(config.root, "temp") : std::vector<detail::HwmonInput>{};
    if (zones.empty() && inputs.empty()) {
      return Error{Errc::not_found, "cannot read a temperature",
                   config.root + "/sys/class/thermal, " + config.root + "/sys/class/hwmon",
                   "this computer has no thermometer",
                   "load the driver of the chip (`sensors-detect` finds it); virtual machines have no thermometer"};
    }
    device = zones.empty() ? inputs.front().device : zones.front().device;
  }
  if (is_temperature && device.starts_with("thermal_zone"))
    return SysFiles{config.root + "/sys/class/thermal/" + device + "/temp"};
  auto input = detail::find_hwmon(config.root, hwmon_kind(config.quantity).prefix, device);
  if (!input) return input.error();
  return SysFiles{std::move(input->value), std::move(input->fault), std::move(input->alarms)};
}

std::string frequency_file(const std::string& root, const std::string& device) {
  return root + "/sys/devices/system/cpu/" + (device.empty() ? "cpu0" : device) + "/cpufreq/scaling_cur_freq";
}

template <class T, class Device>
detail::Node* inline_sensor(Loop& loop, SensorConfig sensor, Device device) {
  return detail::make_sensor(loop, std::move(sensor), detail::payload_type<T>(),
                             std::make_unique<detail::DeviceOf<T, Device>>(std::move(device)));
}

Reading<HostProcess> process_times(std::string_view schedstat) {
  Result<HostProcess> process = detail::parse_process(schedstat);
  struct timespec now {};
  if (process && ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now) == 0) {
    process->cpu_time = static_cast<std::uint64_t>(now.tv_sec) * 1000000000u + static_cast<std::uint64_t>(now.tv_nsec);
  }
  return process;
}

constexpr const char* no_device = "`device` is missing";

/// The properties of a quantity.
struct Quantity {
  HostQuantity what;
  const std::shared_ptr<const Description>& (*description)();
  detail::Node* (*make)(const Quantity& self, Loop& loop, SensorConfig sensor, const HostConfig& config);
  const char* proc_file;  // read inline; null: it is a file of /sys, and read on a lane
  Duration on_loop;       // for how long a read of the former may hold the loop
  /// The file of /sys, or the folder in which to search it.
  std::string (*sys_file)(const HostConfig& config) = nullptr;
  const char* device_advice = nullptr;  // null: it needs no device
};

/// `parse` gets the text of the file and, if it has this parameter, the device.
template <class T, auto parse>
detail::Node* make_proc(const Quantity& self, Loop& loop, SensorConfig sensor, const HostConfig& config) {
  const auto read = [device = config.device](std::string_view text) -> Reading<T> {
    if constexpr (std::is_invocable_v<decltype(parse), std::string_view, std::string_view>) {
      return parse(text, device);
    } else {
      return parse(text);
    }
  };
  return inline_sensor<T>(loop, std::move(sensor),
                          ProcDevice<T>{ProcFile(config.root + "/proc/" + self.proc_file), read, self.on_loop});
}

detail::Node* make_cpu(const Quantity& self, Loop& loop, SensorConfig sensor, const HostConfig& config) {
  return inline_sensor<HostCpu>(
      loop, std::move(sensor),
      CpuDevice{ProcFile(config.root + "/proc/" + self.proc_file), config.device, self.on_loop});
}

template <class T>
detail::Node* make_sys(Loop& loop, SensorConfig sensor, const HostConfig& config, FindFiles::Find find, double factor) {
  return detail::make_sensor(loop, std::move(sensor), detail::payload_type<T>(),
                             std::make_unique<SysDevice<T>>(std::move(find), factor, config));
}

template <class T>
detail::Node* make_hwmon(const Quantity& self, Loop& loop, SensorConfig sensor, const HostConfig& config) {
  return make_sys<T>(
      loop, std::move(sensor), config, [config] { return find_input(config); }, hwmon_kind(self.what).factor);
}

/// The folder of its chip, as far as the configuration names it: the lane is chosen before the search.
std::string place_of_input(const HostConfig& config) {
  const std::string of_class = config.root + "/sys/class/";
  if (config.device.starts_with("thermal_zone")) return of_class + "thermal/" + config.device + "/temp";
  if (config.device.empty() && config.quantity == HostQuantity::temperature) return of_class + "thermal/";
  return of_class + "hwmon/" + config.device.substr(0, config.device.find('/')) + "/";
}

detail::Node* make_frequency(const Quantity& self, Loop& loop, SensorConfig sensor, const HostConfig& config) {
  return make_sys<HostFrequency>(
      loop, std::move(sensor), config, [path = self.sys_file(config)] { return Result(SysFiles{path}); }, 1e3);
}

std::string frequency_file_of(const HostConfig& config) { return frequency_file(config.root, config.device); }

const Quantity& quantity(HostQuantity what) {
  using namespace std::chrono_literals;
  using enum HostQuantity;
  static constexpr Quantity all[] = {
      {cpu, description_of<HostCpu>, make_cpu, "stat", 200us},
      {load, description_of<HostLoad>, make_proc<HostLoad, detail::parse_load>, "loadavg", 50us},
      {memory, description_of<HostMemory>, make_proc<HostMemory, detail::parse_memory>, "meminfo", 100us},
      {disk, description_of<HostDisk>, make_proc<HostDisk, detail::parse_disk>, "diskstats", 100us, nullptr,
       "set `device`, such as sda; /proc/diskstats lists them"},
      {network, description_of<HostNetwork>, make_proc<HostNetwork, detail::parse_network>, "net/dev", 100us, nullptr,
       "set `device`, such as eth0; /proc/net/dev lists them"},
      {scheduler, description_of<HostScheduler>, make_proc<HostScheduler, detail::parse_scheduler>, "stat", 200us},
      {process, description_of<HostProcess>, make_proc<HostProcess, process_times>, "thread-self/schedstat", 50us},
      {temperature, description_of<HostTemperature>, make_hwmon<HostTemperature>, nullptr, 0us, place_of_input},
      {frequency, description_of<HostFrequency>, make_frequency, nullptr, 0us, frequency_file_of},
      {voltage, description_of<HostVoltage>, make_hwmon<HostVoltage>, nullptr, 0us, place_of_input},
      {current, description_of<HostCurrent>, make_hwmon<HostCurrent>, nullptr, 0us, place_of_input},
      {power, description_of<HostPower>, make_hwmon<HostPower>, nullptr, 0us, place_of_input},
      {fan, description_of<HostFan>, make_hwmon<HostFan>, nullptr, 0us, place_of_input},
      {humidity, description_of<HostHumidity>, make_hwmon<HostHumidity>, nullptr, 0us, place_of_input},
      {energy, description_of<HostEnergy>, make_hwmon<HostEnergy>, nullptr, 0us, place_of_input},
  };
  return *std::find_if(std::begin(all), std::end(all), [what](const Quantity& one) { return one.what == what; });
}

/// Advice for a missing device; null: it is not missing.
const char* advice_on_missing_device(const HostConfig& config) {
  return config.device.empty() ? quantity(config.quantity).device_advice : nullptr;
}

}  // namespace

void check_config(const HostConfig& config, const ConfigItem& item, Problems& problems) {
  const char* const advice = advice_on_missing_device(config);
  if (advice == nullptr) return;
  detail::add_mistake({"device", std::string(no_device), advice}, item, problems);
}

ReadTime read_time(const HostConfig& config) {
  const Quantity& one = quantity(config.quantity);
  if (one.proc_file != nullptr) return {.on_loop = one.on_loop};
  // Reading the frequency of a sleeping processor, or a chip behind a slow bus, may take time.
  return {.on_loop = detail::lane_read_on_loop,
          .on_lane = std::chrono::milliseconds{10},
          .lane = detail::physical_device_of(one.sys_file(config))};
}

std::string_view name_of(HostQuantity quantity) noexcept {
  static constexpr auto all = describe(type_tag<HostQuantity>{});
  for (const auto& one : all.values) {
    if (one.value == quantity) return one.name;
  }
  return {};
}

std::shared_ptr<const Description> host_description(HostQuantity what) { return quantity(what).description(); }

HostSensor::HostSensor(Loop& loop, SensorConfig sensor, HostConfig config) {
  if (const char* const advice = advice_on_missing_device(config); advice != nullptr) {
    throw SetupError({Errc::bad_argument, "cannot use this host sensor", "sensor " + sensor.name, no_device, advice});
  }
  const Quantity& one = quantity(config.quantity);
  *this = HostSensor(one.make(one, loop, std::move(sensor), config));
}

std::vector<HostSensorInfo> available_host_sensors(const std::string& root) {
  std::vector<HostSensorInfo> found;
  const auto has = [&](const char* file) { return ::access((root + "/proc/" + file).c_str(), R_OK) == 0; };
  if (has("stat")) found.push_back({HostQuantity::cpu, "", ""});
  if (has("loadavg")) found.push_back({HostQuantity::load, "", ""});
  if (has("meminfo")) found.push_back({HostQuantity::memory, "", ""});
  if (has("stat")) found.push_back({HostQuantity::scheduler, "", ""});
  if (has("thread-self/schedstat")) found.push_back({HostQuantity::process, "", ""});
  for (const std::string& disk : names_in(root + "/sys/block")) {
    if (!disk.starts_with("loop") && !disk.starts_with("ram")) found.push_back({HostQuantity::disk, disk, ""});
  }
  for (const std::string& interface : names_in(root + "/sys/class/net"))
    found.push_back({HostQuantity::network, interface, ""});
  for (HostSensorInfo& info : thermal_zones(root)) found.push_back(std::move(info));
  for (const HwmonKind& kind : hwmon_kinds) {
    for (detail::HwmonInput& input : detail::hwmon_inputs(root, kind.prefix))
      found.push_back({kind.quantity, std::move(input.device), std::move(input.name), std::move(input.value)});
  }
  if (::access(frequency_file(root, "").c_str(), R_OK) == 0)
    found.push_back({HostQuantity::frequency, "cpu0", "", frequency_file(root, "")});
  return found;
}

}  // namespace rtdata
