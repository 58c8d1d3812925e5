/// HostSensor: measurements of this computer: load, memory, disks, temperatures.
///
///     rtdata::HostSensor load(loop, {.name = "load", .topic = "host/cpu", .rate = 10_Hz},
///                             {.quantity = rtdata::HostQuantity::cpu});
///     auto s = loop.topic<rtdata::HostCpu>("host/cpu").subscribe(loop, [](const auto& e) { use(e->busy); });
///
/// Each quantity has a payload of its own, below; `available_host_sensors` lists what this machine has. A quantity that
/// it does not have is an error (not-found): the sensor is faulted and tried again, or throws when `required`. If a
/// disk, network or processor does not exist, the first read fails.
///
/// Files of /proc stay open and are read inline: a read costs microseconds (`process` the least: fit for 1 kHz and
/// more, and it always changes). Files of /sys may access a slow chip: they are read on a lane, with the limit
/// `timeout`. Shares of time need the difference of two reads: the first read gives no event (repeated), and neither
/// does a read before the kernel's clock (mostly 10 ms) has advanced.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/parameter.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace rtdata {

enum class HostQuantity {
  cpu,          ///< HostCpu; device: "cpu0" ..., empty: all together
  load,         ///< HostLoad
  memory,       ///< HostMemory
  disk,         ///< HostDisk; device: "sda", "mmcblk0p1"
  network,      ///< HostNetwork; device: "eth0"
  scheduler,    ///< HostScheduler
  process,      ///< HostProcess: this program
  temperature,  ///< HostTemperature; device: "thermal_zone0", or as of `voltage`; empty: the first there is
  frequency,    ///< HostFrequency; device: "cpu0" ..., empty: cpu0
  voltage,      ///< HostVoltage; device: "CHIP/INPUT" of hwmon, such as "ina226/in1"; empty: the only one
  current,      ///< HostCurrent; device: as of `voltage`
  power,        ///< HostPower; device: as of `voltage`
  fan,          ///< HostFan; device: as of `voltage`
  humidity,     ///< HostHumidity; device: as of `voltage`
  energy,       ///< HostEnergy; device: as of `voltage`
};
constexpr auto describe(type_tag<HostQuantity>) {
  using enum HostQuantity;
  return enumeration("quantity", value("cpu", cpu), value("load", load), value("memory", memory), value("disk", disk),
                     value("network", network), value("scheduler", scheduler), value("process", process),
                     value("temperature", temperature), value("frequency", frequency), value("voltage", voltage),
                     value("current", current), value("power", power), value("fan", fan), value("humidity", humidity),
                     value("energy", energy));
}

/// Shares of the time since the last read, "%"; they add up to 100.
struct HostCpu {
  double busy = 0;  ///< all except idle and iowait
  double user = 0;
  double nice = 0;
  double system = 0;
  double idle = 0;
  double iowait = 0;
  double irq = 0;
  double softirq = 0;
  double steal = 0;
  RTDATA_FIELDS(HostCpu, (busy, "%"), (user, "%"), (nice, "%"), (system, "%"), (idle, "%"), (iowait, "%"), (irq, "%"),
                (softirq, "%"), (steal, "%"))
};
/// Mean number of tasks that run or wait.
struct HostLoad {
  double minutes_1 = 0;
  double minutes_5 = 0;
  double minutes_15 = 0;
  std::uint32_t running = 0;  ///< tasks that run or could, now
  std::uint32_t tasks = 0;
  RTDATA_FIELDS(HostLoad, (minutes_1), (minutes_5), (minutes_15), (running), (tasks))
};
struct HostMemory {
  std::uint64_t total = 0;
  std::uint64_t free = 0;
  std::uint64_t available = 0;  ///< what programs could still get
  std::uint64_t buffers = 0;
  std::uint64_t cached = 0;
  std::uint64_t swap_total = 0;
  std::uint64_t swap_free = 0;
  RTDATA_FIELDS(HostMemory, (total, "By"), (free, "By"), (available, "By"), (buffers, "By"), (cached, "By"),
                (swap_total, "By"), (swap_free, "By"))
};
/// Since the machine's start.
struct HostDisk {
  std::uint64_t reads = 0;
  std::uint64_t read_bytes = 0;
  std::uint64_t writes = 0;
  std::uint64_t written_bytes = 0;
  std::uint64_t in_flight = 0;  ///< now
  std::uint64_t busy_time = 0;
  RTDATA_FIELDS(HostDisk, (reads), (read_bytes, "By"), (writes), (written_bytes, "By"), (in_flight), (busy_time, "ms"))
};
/// Since the interface's start.
struct HostNetwork {
  std::uint64_t received_bytes = 0;
  std::uint64_t received_packets = 0;
  std::uint64_t receive_errors = 0;
  std::uint64_t receive_drops = 0;
  std::uint64_t sent_bytes = 0;
  std::uint64_t sent_packets = 0;
  std::uint64_t send_errors = 0;
  std::uint64_t send_drops = 0;
  RTDATA_FIELDS(HostNetwork, (received_bytes, "By"), (received_packets), (receive_errors), (receive_drops),
                (sent_bytes, "By"), (sent_packets), (send_errors), (send_drops))
};
/// Since the machine's start, except the last two.
struct HostScheduler {
  std::uint64_t context_switches = 0;
  std::uint64_t interrupts = 0;
  std::uint64_t soft_interrupts = 0;
  std::uint64_t forks = 0;
  std::uint32_t running = 0;
  std::uint32_t blocked = 0;
  RTDATA_FIELDS(HostScheduler, (context_switches), (interrupts), (soft_interrupts), (forks), (running), (blocked))
};
/// Since the start of the program, of the thread that runs the loop.
struct HostProcess {
  std::uint64_t cpu_time = 0;     ///< of all threads of the program
  std::uint64_t run_time = 0;     ///< of the loop's thread
  std::uint64_t wait_time = 0;    ///< the loop's thread could have run, but another did
  std::uint64_t time_slices = 0;  ///< how often the loop's thread was put on a CPU
  RTDATA_FIELDS(HostProcess, (cpu_time, "ns"), (run_time, "ns"), (wait_time, "ns"), (time_slices))
};
/// `alarm`, here and below: true if the chip reports that a limit is passed; empty: no such limit, or not reported. The
/// value is valid in both cases. If the chip reports a fault of its sensor, the read is an error.
struct HostTemperature {
  double temperature = 0;
  std::optional<bool> alarm = {};
  RTDATA_FIELDS(HostTemperature, (temperature, "Cel"), (alarm))
};
struct HostVoltage {
  double voltage = 0;
  std::optional<bool> alarm = {};
  RTDATA_FIELDS(HostVoltage, (voltage, "V"), (alarm))
};
struct HostCurrent {
  double current = 0;
  std::optional<bool> alarm = {};
  RTDATA_FIELDS(HostCurrent, (current, "A"), (alarm))
};
struct HostPower {
  double power = 0;
  std::optional<bool> alarm = {};
  RTDATA_FIELDS(HostPower, (power, "W"), (alarm))
};
struct HostFan {
  double speed = 0;
  std::optional<bool> alarm = {};
  RTDATA_FIELDS(HostFan, (speed, "{rev}/min"), (alarm))
};
/// Relative.
struct HostHumidity {
  double humidity = 0;
  std::optional<bool> alarm = {};
  RTDATA_FIELDS(HostHumidity, (humidity, "%"), (alarm))
};
/// Counted by the chip since power-on, or according to its data sheet: it may restart at 0.
struct HostEnergy {
  double energy = 0;
  RTDATA_FIELDS(HostEnergy, (energy, "J"))
};
struct HostFrequency {
  double frequency = 0;
  RTDATA_FIELDS(HostFrequency, (frequency, "Hz"))
};

struct HostConfig {
  HostQuantity quantity = HostQuantity::cpu;
  std::string device = {};                     ///< which one, see HostQuantity
  std::string root = {};                       ///< prefix of /proc and /sys, such as a container's mount of the host
  Duration timeout = std::chrono::seconds{1};  ///< a read of /sys that takes longer is given up

  friend constexpr auto parameters(type_tag<HostConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("quantity", &HostConfig::quantity, "what to read", required),
        parameter("device", &HostConfig::device, "which CPU, disk, network interface, thermometer, or input of hwmon",
                  only_with("quantity", "cpu", "disk", "network", "temperature", "frequency", "voltage", "current",
                            "power", "fan", "humidity", "energy")),
        parameter("root", &HostConfig::root, "prefix of /proc and /sys, such as the host's root folder in a container",
                  TextIs::device),
        parameter("timeout", &HostConfig::timeout, "a read of /sys that takes longer is given up",
                  range(Duration{1ms}, Duration{1h}),
                  only_with("quantity", "temperature", "frequency", "voltage", "current", "power", "fan", "humidity",
                            "energy")));
  }
};

/// Checks that a disk or network is named.
void check_config(const HostConfig& config, const ConfigItem& item, Problems& problems);
/// About ten times the measured values (docs/tiers.md), for slower boards and machines with more processors.
ReadTime read_time(const HostConfig& config);

/// The description of the quantity's payload.
std::shared_ptr<const Description> host_description(HostQuantity what);

class HostSensor : public AnySensor {
 public:
  HostSensor() noexcept = default;
  /// SetupError: as `Sensor`; and bad-argument for a disk or network without a device.
  HostSensor(Loop& loop, SensorConfig sensor, HostConfig config);

 private:
  explicit HostSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

/// As configurations write it: "temperature".
std::string_view name_of(HostQuantity quantity) noexcept;

/// One sensor that this machine has.
struct HostSensorInfo {
  HostQuantity quantity = HostQuantity::cpu;
  std::string device;     ///< for HostConfig::device
  std::string name;       ///< as the kernel calls it ("x86_pkg_temp"), or empty
  std::string file = {};  ///< of /sys, below the root, that has the value; empty: it is in one of /proc
};
/// Searches /proc and /sys below `root`. Blocks while it lists directories; any thread.
std::vector<HostSensorInfo> available_host_sensors(const std::string& root = {});

}  // namespace rtdata
