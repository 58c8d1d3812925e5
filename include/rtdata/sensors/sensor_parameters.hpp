/// What the parts that all sensors have in common are called in a configuration file.
///
///     {"name": "chamber", "topic": "pressure/chamber", "rate": "100 Hz", "retry_first": "100 ms", ...}
///
/// Read them with `read_config(item, config, problems, UnknownKeys::ignore)`; the rest is the sensor's own Config.
/// Values; any thread.
#pragma once

#include "rtdata/data/parameter.hpp"
#include "rtdata/process/processing_parameters.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace rtdata {

constexpr auto parameters(type_tag<SensorConfig>) {
  using namespace std::chrono_literals;
  return parameter_list(
      parameter("name", &SensorConfig::name, "the origin of its events, unique in the file", required, TextIs::name),
      parameter("topic", &SensorConfig::topic, "where it publishes; empty: as its name", TextIs::topic),
      parameter("rate", &SensorConfig::rate, "how often it is read", required, at_most(Rate::from_period(1us))),
      parameter("phase", &SensorConfig::phase, "added to the start of its schedule", range(Duration{0}, Duration{1h})),
      parameter(
          "late_after", &SensorConfig::late_after,
          "readings that begin later than this are counted as late; default the larger of 1 ms and 10 % of the period",
          at_least(Duration{0})),
      parameter("read_time", &SensorConfig::read_time,
                "how long a reading holds the loop at most, or its lane when read on one; default: as the driver says",
                range(Duration{1}, Duration{1h})),
      parameter("faulted_after", &SensorConfig::faulted_after, "failures in a row that make it faulted",
                range(1, 1000000)),
      parameter("retry_first", &SensorConfig::retry_first, "wait before a faulted device is opened again",
                range(Duration{1ms}, Duration{1h})),
      parameter("retry_longest", &SensorConfig::retry_longest, "the wait doubles up to this",
                range(Duration{1ms}, Duration{24h})),
      parameter("on_overrun", &SensorConfig::on_overrun, "when its read holds the loop longer than the limit",
                choices(value("warn", OnOverrun::warn), value("slow down", OnOverrun::slow_down),
                        value("stop", OnOverrun::stop))),
      parameter("required", &SensorConfig::required, "a device that cannot be opened at the start ends the program"),
      parameter("start", &SensorConfig::start, "start it with the system"),
      parameter("process", &SensorConfig::process, "calibration and filters, by field"));
}

constexpr auto parameters(type_tag<FeedConfig>) {
  return parameter_list(
      parameter("name", &FeedConfig::name, "the origin of its events, unique in the file", required, TextIs::name),
      parameter("topic", &FeedConfig::topic, "where it publishes; empty: as its name", TextIs::topic),
      parameter("process", &FeedConfig::process, "calibration and filters, by field"));
}

}  // namespace rtdata
