#include "rtdata/sensors/host.hpp"

#include <doctest/doctest.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <map>
#include <optional>

#include "rtdata/config/format.hpp"
#include "rtdata/config/read.hpp"
#include "sensors/fixture.hpp"
#include "sensors/host/host_text.hpp"

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE_BEGIN("sensors");

namespace {

constexpr const char* stat =
    "cpu  248629 0 22743 459084 794 0 84 694 0 0\n"
    "cpu0 119538 0 10763 235099 88 0 16 340 0 0\n"
    "intr 940634 0 0 5\nctxt 1234567\nbtime 1763740000\nprocesses 10906\nprocs_running 6\nprocs_blocked 1\n"
    "softirq 333 1 2 3\n";
constexpr const char* net =
    "Inter-|   Receive                                                |  Transmit\n"
    " face |bytes    packets errs drop fifo frame compressed multicast|bytes    packets errs drop fifo colls carrier "
    "compressed\n"
    "    lo:    3267      29    0    0    0     0          0         0     3267      29    0    0    0     0       0   "
    "       0\n"
    "  eth0:18685000     442    1    2    0     0          0         0    28163     345    3    4    0     0       0   "
    "       0\n";
constexpr const char*
    disks = "   7       0 loop0 0 0 0 0 0 0 0 0 0 0 0\n   8       0 sda 10 1 20 5 30 2 40 6 3 77 88 0 0 0 0\n";
constexpr const char* meminfo =
    "MemTotal:       24684084 kB\nMemFree:        23430916 kB\nMemAvailable:   23794084 kB\nBuffers:            1868 "
    "kB\n"
    "Cached:           546652 kB\nSwapCached:            0 kB\nSwapTotal:             4 kB\nSwapFree:              3 "
    "kB\n";

}  // namespace

TEST_CASE("FW-2 recorded texts of the kernel are parsed") {
  const auto all = detail::parse_cpu(stat, "").value();
  CHECK(all[0] == 248629);
  CHECK(all[7] == 694);
  CHECK(detail::parse_cpu(stat, "cpu0").value()[3] == 235099);
  const auto scheduler = detail::parse_scheduler(stat).value();
  CHECK(scheduler.context_switches == 1234567);
  CHECK(scheduler.interrupts == 940634);
  CHECK(scheduler.soft_interrupts == 333);
  CHECK(scheduler.forks == 10906);
  CHECK(scheduler.running == 6);
  CHECK(scheduler.blocked == 1);
  const auto load = detail::parse_load("2.37 3.14 2.77 6/115 10906\n").value();
  CHECK(load.minutes_1 == 2.37);
  CHECK(load.minutes_15 == 2.77);
  CHECK(load.running == 6);
  CHECK(load.tasks == 115);
  const auto memory = detail::parse_memory(meminfo).value();
  CHECK(memory.total == 24684084ull * 1024);
  CHECK(memory.cached == 546652ull * 1024);
  CHECK(memory.swap_free == 3 * 1024);
  const auto disk = detail::parse_disk(disks, "sda").value();
  CHECK(disk.reads == 10);
  CHECK(disk.read_bytes == 20 * 512);
  CHECK(disk.writes == 30);
  CHECK(disk.written_bytes == 40 * 512);
  CHECK(disk.in_flight == 3);
  CHECK(disk.busy_time == 77);
  const auto eth = detail::parse_network(net, "eth0").value();
  CHECK(eth.received_bytes == 18685000);
  CHECK(eth.receive_drops == 2);
  CHECK(eth.sent_packets == 345);
  CHECK(eth.send_drops == 4);
  CHECK(detail::parse_process("5057 1821343 2\n").value().wait_time == 1821343);
  CHECK(detail::parse_number("-12500\n").value() == -12500);
}

TEST_CASE("FW-2 garbage in place of the kernel's texts is an error, whatever it is cut to") {
  const auto looks_at = [](std::string_view text) {
    (void)detail::parse_cpu(text, "");
    (void)detail::parse_scheduler(text);
    (void)detail::parse_load(text);
    (void)detail::parse_memory(text);
    (void)detail::parse_disk(text, "sda");
    (void)detail::parse_network(text, "eth0");
    (void)detail::parse_process(text);
    (void)detail::parse_number(text);
  };
  for (const std::string_view text :
       {std::string_view(stat), std::string_view(net), std::string_view(disks), std::string_view(meminfo)}) {
    for (std::size_t i = 0; i <= text.size(); ++i) looks_at(text.substr(0, i));
  }
  CHECK(detail::parse_cpu("cpu 1 2 x", "").error().code == Errc::bad_data);
  CHECK(detail::parse_cpu(stat, "cpu7").error().code == Errc::not_found);
  CHECK(detail::parse_cpu(stat, "intr").error().code == Errc::not_found);
  CHECK(detail::parse_scheduler("").error().code == Errc::bad_data);
  CHECK(detail::parse_load("1 2").error().code == Errc::bad_data);
  CHECK(detail::parse_load("1 2 3 4").error().code == Errc::bad_data);
  CHECK(detail::parse_memory("MemTotal: x kB\n").error().code == Errc::bad_data);
  CHECK(detail::parse_disk(disks, "sdb").error().code == Errc::not_found);
  CHECK(detail::parse_network(net, "eth1").error().code == Errc::not_found);
  CHECK(detail::parse_process("1 2").error().code == Errc::bad_data);
  CHECK(detail::parse_number("1.5").error().code == Errc::not_a_number);
}

TEST_CASE("FW-2 shares of CPU time add up to 100 %, and are made of two reads") {
  ScratchDirectory root;
  const std::string file = root.file("proc/stat", "cpu 100 0 50 800 50 0 0 0 0 0\n");
  Loop loop{Loop::Manual{}};
  std::vector<HostCpu> events;
  auto s = loop.topic<HostCpu>("cpu").subscribe(loop, [&](const Event<HostCpu>& e) { events.push_back(*e); });
  HostSensor sensor(loop, {.name = "cpu", .rate = 1_Hz}, {.quantity = HostQuantity::cpu, .root = root.path()});
  loop.advance(10ms);
  CHECK(events.empty());
  CHECK(sensor.counts().repeated == 1);
  ScratchDirectory::write(file, "cpu 110 10 60 860 60 0 0 0 0 0\n");
  loop.advance(1s);
  REQUIRE(events.size() == 1);
  CHECK(events[0].busy == doctest::Approx(30));
  CHECK(events[0].user == doctest::Approx(10));
  CHECK(events[0].idle == doctest::Approx(60));
  loop.advance(1s);  // no time has passed
  CHECK(events.size() == 1);
  CHECK(sensor.counts().repeated == 2);
  CHECK(sensor.counts().balances());
}

TEST_CASE("FW-2 a quantity that the machine does not have is faulted until it has, or throws when required") {
  ScratchDirectory root;
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  for (const HostQuantity what :
       {HostQuantity::cpu, HostQuantity::process, HostQuantity::temperature, HostQuantity::frequency}) {
    CHECK_THROWS_AS(
        HostSensor(loop, {.name = "x", .rate = 1_Hz, .required = true}, {.quantity = what, .root = root.path()}),
        SetupError);
  }
  CHECK_THROWS_AS(HostSensor(loop, {.name = "x", .rate = 1_Hz}, {.quantity = HostQuantity::disk}), SetupError);
  CHECK_THROWS_AS(HostSensor(loop, {.name = "x", .rate = 1_Hz}, {.quantity = HostQuantity::network}), SetupError);
  std::vector<double> values;
  auto s = loop.topic<HostTemperature>("t").subscribe(
      loop, [&](const Event<HostTemperature>& e) { values.push_back(e->temperature); });
  HostSensor sensor(loop, {.name = "t", .rate = 10_Hz, .retry_longest = 100ms},
                    {.quantity = HostQuantity::temperature, .root = root.path()});
  loop.advance(1s);
  CHECK(sensor.health() == Health::faulted);
  root.file("sys/class/hwmon/hwmon0/name", "coretemp\n");
  root.file("sys/class/hwmon/hwmon0/temp2_label", "Core 0\n");
  const std::string input = root.file("sys/class/hwmon/hwmon0/temp2_input", "41500\n");
  loop.advance(1s);
  CHECK(sensor.health() == Health::ok);
  REQUIRE(!values.empty());
  CHECK(values.back() == doctest::Approx(41.5));
  ScratchDirectory::write(input, "hot");
  loop.advance(100ms);
  CHECK(sensor.health() == Health::degraded);
  CHECK(sensor.counts().balances());
  const auto found = available_host_sensors(root.path());
  REQUIRE(found.size() == 1);
  CHECK(found[0].device == "coretemp/temp2");
  CHECK(found[0].name == "coretemp Core 0");
}

TEST_CASE("FW-2 what chips of hwmon measure is in SI units, with the alarm where the chip has one") {
  ScratchDirectory root;
  const std::string chip = "sys/class/hwmon/hwmon3/";
  root.file(chip + "name", "board\n");
  root.file(chip + "in1_input", "3300\n");
  root.file(chip + "in1_label", "+3.3V\n");
  root.file(chip + "in1_min_alarm", "0\n");
  const std::string alarm = root.file(chip + "in1_max_alarm", "0\n");
  root.file(chip + "intrusion0_alarm", "1\n");  // is no input
  root.file(chip + "curr1_input", "-1500\n");
  root.file(chip + "power1_average", "2500000\n");
  root.file(chip + "fan2_input", "1450\n");
  const std::string fault = root.file(chip + "fan2_fault", "0\n");
  root.file(chip + "humidity1_input", "45500\n");
  root.file(chip + "energy1_input", "7200000000001\n");  // microjoules: more than 32 bits
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  std::vector<Error> errors;
  loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error); });
  std::map<std::string, double> values;
  std::optional<HostVoltage> voltage;
  std::optional<HostCurrent> current;
  const auto v = loop.topic<HostVoltage>("voltage").subscribe(loop, [&](const auto& e) { voltage = *e; });
  const auto c = loop.topic<HostCurrent>("current").subscribe(loop, [&](const auto& e) { current = *e; });
  const auto p = loop.topic<HostPower>("power").subscribe(loop, [&](const auto& e) { values["power"] = e->power; });
  const auto f = loop.topic<HostFan>("fan").subscribe(loop, [&](const auto& e) { values["fan"] = e->speed; });
  const auto h = loop.topic<HostHumidity>("humidity").subscribe(loop, [&](const auto& e) {
    values["humidity"] = e->humidity;
  });
  const auto j = loop.topic<HostEnergy>("energy").subscribe(loop, [&](const auto& e) { values["energy"] = e->energy; });
  std::vector<HostSensor> sensors;
  const auto add = [&](HostQuantity quantity, const char* device) {
    sensors.emplace_back(loop, SensorConfig{.name = std::string(name_of(quantity)), .rate = 1_Hz, .retry_first = 100ms},
                         HostConfig{.quantity = quantity, .device = device, .root = root.path()});
  };
  add(HostQuantity::voltage, "board/+3.3V");
  add(HostQuantity::current, "hwmon3/curr1");
  add(HostQuantity::power, "");
  add(HostQuantity::fan, "board");
  add(HostQuantity::humidity, "board/humidity1");
  add(HostQuantity::energy, "board/energy1");
  loop.advance(500ms);
  REQUIRE(voltage);
  CHECK(voltage->voltage == doctest::Approx(3.3));
  CHECK(voltage->alarm == false);
  REQUIRE(current);
  CHECK(current->current == doctest::Approx(-1.5));
  CHECK(!current->alarm);
  CHECK(values["power"] == doctest::Approx(2.5));
  CHECK(values["fan"] == doctest::Approx(1450));
  CHECK(values["humidity"] == doctest::Approx(45.5));
  CHECK(values["energy"] == doctest::Approx(7200000.000001).epsilon(1e-13));
  CHECK(errors.empty());

  // A limit is passed: the value is good all the same. One of two that cannot be read leaves it open.
  ScratchDirectory::write(alarm, "1\n");
  loop.advance(1s);
  CHECK(voltage->alarm == true);
  ScratchDirectory::write(alarm, "?\n");
  loop.advance(1s);
  CHECK(!voltage->alarm);

  // A fault is no value.
  ScratchDirectory::write(fault, "1\n");
  values.clear();
  loop.advance(1s);
  CHECK(values.count("fan") == 0);
  CHECK(values.count("power") == 1);
  CHECK(sensors[3].health() == Health::degraded);
  CHECK(sensors[3].counts().failed == 1);
  REQUIRE(!errors.empty());
  CHECK(errors.back().why == "the chip reports a fault of its sensor");
  ScratchDirectory::write(fault, "0\n");
  loop.advance(1s);
  CHECK(values.count("fan") == 1);
  CHECK(sensors[3].health() == Health::ok);

  // After the next start it has another number, and the same name.
  const std::string all = root.path() + "/sys/class/hwmon/";
  REQUIRE(std::rename((all + "hwmon3").c_str(), (all + "hwmon5").c_str()) == 0);
  loop.advance(20s);
  CHECK(sensors[0].health() == Health::ok);
  CHECK(sensors[1].health() == Health::faulted);  // it was named by the number
  for (const HostSensor& sensor : sensors) CHECK(sensor.counts().balances());
}

TEST_CASE("FW-2 an input of hwmon that is not there, or is one of several, is not guessed") {
  ScratchDirectory root;
  const auto refusal = [&](HostQuantity quantity, const std::string& device) {
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    try {
      HostSensor(loop, {.name = "x", .rate = 1_Hz, .required = true},
                 {.quantity = quantity, .device = device, .root = root.path()});
    } catch (const SetupError& error) {
      return error.error().why;
    }
    return std::string();
  };
  CHECK(refusal(HostQuantity::voltage, "") == "this machine has no hwmon sensors");
  root.file("sys/class/hwmon/hwmon0/name", "nvme\n");
  root.file("sys/class/hwmon/hwmon0/in0_input", "1\n");
  CHECK(refusal(HostQuantity::voltage, "").empty());
  CHECK(refusal(HostQuantity::voltage, "nvme").empty());
  CHECK(refusal(HostQuantity::voltage, "nvme/in1") == "available: nvme/in0 (nvme)");
  CHECK(refusal(HostQuantity::fan, "nvme/in0") == "this machine has no hwmon sensors");
  root.file("sys/class/hwmon/hwmon0/in10_input", "1\n");
  root.file("sys/class/hwmon/hwmon0/in2_input", "1\n");
  CHECK(refusal(HostQuantity::voltage, "nvme") ==
        "there are several: nvme/in0 (nvme), nvme/in2 (nvme), nvme/in10 (nvme)");
  // Two chips of one name: by their devices, or if they have none by their numbers.
  root.file("sys/class/hwmon/hwmon1/name", "nvme\n");
  root.file("sys/class/hwmon/hwmon1/in0_input", "1\n");
  root.file("sys/devices/0000:01:00.0/x");
  REQUIRE(::symlink((root.path() + "/sys/devices/0000:01:00.0").c_str(),
                    (root.path() + "/sys/class/hwmon/hwmon1/device").c_str()) == 0);
  CHECK(refusal(HostQuantity::voltage, "nvme/in0") == "there are several: hwmon0/in0 (nvme), 0000:01:00.0/in0 (nvme)");
  CHECK(refusal(HostQuantity::voltage, "0000:01:00.0/in0").empty());
  CHECK(refusal(HostQuantity::voltage, "hwmon1/in0").empty());
}

TEST_CASE("FW-2 everything that this machine says it has can be read") {
  Loop loop{Loop::Manual{}};
  std::vector<HostSensor> sensors;
  std::vector<std::string> errors;
  loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
  const auto found = available_host_sensors();
  CHECK(!found.empty());
  for (const HostSensorInfo& info : found) {
    sensors.emplace_back(loop, SensorConfig{.name = "s" + std::to_string(sensors.size()), .rate = 10_Hz},
                         HostConfig{.quantity = info.quantity, .device = info.device});
  }
  loop.advance(450ms);
  for (std::size_t i = 0; i < sensors.size(); ++i) {
    CAPTURE(found[i].device);
    CHECK(sensors[i].counts().scheduled == 5);
    CHECK(sensors[i].counts().balances());
    if (found[i].quantity != HostQuantity::temperature)
      CHECK(sensors[i].counts().taken == 5);  // a chip may answer with an error
  }
  if (!errors.empty()) MESSAGE(errors[0]);
}

TEST_CASE("NFR-4 the program's own times change at every read of 1 kHz") {
  Loop loop;
  be_quiet(loop);
  std::vector<std::uint64_t> times;
  auto s = loop.topic<HostProcess>("self").subscribe(loop, [&](const Event<HostProcess>& e) {
    times.push_back(e->cpu_time);
    if (times.size() == 50) loop.stop();
  });
  HostSensor sensor(loop, {.name = "self", .rate = 1_kHz}, {.quantity = HostQuantity::process});
  if (sensor.health() != Health::ok) {
    MESSAGE("skipped: this kernel has no schedstat");
    return;
  }
  loop.run();
  CHECK(std::adjacent_find(times.begin(), times.end(), std::greater_equal<>()) == times.end());
}

TEST_CASE("US-17 every parameter of a host sensor can be set from a file") {
  const auto config = read_config<HostConfig>(
      parse_config(R"({"quantity": "temperature", "device": "thermal_zone0", "root": "/host", "timeout": "2 s"})").root);
  CHECK(config.quantity == HostQuantity::temperature);
  CHECK(config.device == "thermal_zone0");
  CHECK(config.root == "/host");
  CHECK(config.timeout == 2s);
  CHECK(parameters_of<HostConfig>().size() == 4);
}

TEST_SUITE_END();
