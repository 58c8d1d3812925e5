// A sensor of lines on a loop, what it publishes, and what it complains of.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "rtdata/data/event.hpp"
#include "sensors/fixture.hpp"

template <class Sensor, class Config>
struct LinesBench {
  explicit LinesBench(Config config) {
    using namespace std::chrono_literals;
    be_quiet(loop);
    config.lines.retry_first = config.lines.retry_longest = 10ms;
    heard = loop.subscribe("lines", [this](const rtdata::EventView& event) {
      std::string text;
      for (const rtdata::Leaf& leaf : event.description().leaves())
        text += (text.empty() ? "" : " ") + rtdata::to_string(event.value(leaf));
      events.push_back(text);
    });
    sensor = Sensor(loop, {.name = "lines"}, std::move(config));
    sensor.on_error([this](const rtdata::ErrorReport& report) { errors.push_back(report.error.why); });
  }
  template <class Done>
  bool until(Done done) {
    using namespace std::chrono_literals;
    for (int i = 0; i < 20000; ++i) {
      if (done()) return true;
      loop.run_for(1ms);
    }
    return false;
  }
  rtdata::Loop loop;
  std::vector<std::string> events, errors;
  rtdata::Subscription heard;
  Sensor sensor;
};
