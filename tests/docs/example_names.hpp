// What the examples at the heads of public headers (docs_test.py) use without saying what it is.
#pragma once

#include <array>
#include <csignal>
#include <cstddef>
#include <cstdio>
#include <iostream>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "rtdata/chips/imu.hpp"
#include "rtdata/chips/lm75.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/io/serial.hpp"
#include "rtdata/loop/clock.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/outputs/gpio.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sinks/sink.hpp"

enum class Colour { red, blue };

namespace example {

using namespace rtdata::literals;

struct Answer {  // of an example that returns something
  Answer() = default;
  template <class T>
  Answer(const T&) {}
};

struct Climate {
  double temperature = 0;
  double humidity = 0;
  RTDATA_FIELDS(Climate, (temperature, "Cel"), (humidity, "%RH"))
};
struct Pressure {
  double pressure = 0;
  RTDATA_FIELDS(Pressure, (pressure, "Pa"))
};
struct Altitude {
  double metres = 0;
  RTDATA_FIELDS(Altitude, (metres, "m"))
};
struct Value {
  double tilt = 0;
};
struct UartConfig {
  std::string device;
  friend constexpr auto parameters(rtdata::type_tag<UartConfig>) {
    return rtdata::parameter_list(rtdata::parameter("device", &UartConfig::device, "the serial device"));
  }
};
struct PathConfig {
  std::string path;
  rtdata::SinkConfig sink;
  friend constexpr auto parameters(rtdata::type_tag<PathConfig>) {
    return rtdata::parameter_list(rtdata::parameter("path", &PathConfig::path, "where"));
  }
};
using LinesConfig = PathConfig;
using WireConfig = PathConfig;
using GearPumpConfig = UartConfig;
struct ProbeConfig {
  std::string bus;
};
struct Lines : rtdata::Writer {
  explicit Lines(const LinesConfig&);
  rtdata::Result<void> open() override;
  rtdata::Result<void> write(rtdata::Batch& batch) override;
};
struct Wire {
  explicit Wire(const WireConfig&);
};
struct Probe {
  Probe(rtdata::Loop&, const rtdata::SensorConfig&, Wire&);
};
struct Pump {};
struct SteppedClock : rtdata::SystemClock {};
struct Table {
  void bind(const auto&...) {}
};
struct Beeper {
  void stop();
};
struct AnyBus {
  template <class T>
  operator T&() const;
};

void check(const auto&...) {}
void print(const auto&...) {}
void show(const auto&...) {}
void use(const auto&...) {}
std::unique_ptr<Pump> make_gear_pump(rtdata::Loop&, const GearPumpConfig&);
std::unique_ptr<rtdata::Actuator> make_fan();
Pressure read_tank();

extern AnyBus bus;
extern Beeper beeper;
extern Table table;
extern rtdata::AnySensor& sensor;
extern rtdata::ConfigItem item;
extern rtdata::Description& description;
extern rtdata::Event<Climate> event;
extern rtdata::Imu::Config config;
extern rtdata::InertialModel model;
extern std::span<const rtdata::InertialModel> models;
extern rtdata::InertialSettings settings;
extern rtdata::Loop& loop;
extern rtdata::Problems problems;
extern rtdata::Recording& recording;
extern rtdata::Registry registry;
extern rtdata::System& system;
extern rtdata::SystemPlan plan, next;
extern rtdata::Time launch, launched;
extern const std::byte* payload;
extern double pressure;
extern std::string line, secret, text, token;
extern rtdata::ConfigDocument document;
extern std::vector<std::byte> scans;
extern double values[];

}  // namespace example
