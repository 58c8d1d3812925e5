// What an output publishes, as lines.
#pragma once

#include <string>
#include <vector>

#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/outputs/output.hpp"

namespace outputs_test {

/// "set 1 done", "start 0 failed: Connection refused". Errors that are reported are expected here.
struct OutputLog {
  explicit OutputLog(rtdata::Loop& loop, const std::string& topic) {
    loop.on_error([](const rtdata::ErrorReport&) {});
    seen = loop.subscribe<rtdata::OutputChange>(topic, [this](const rtdata::Event<rtdata::OutputChange>& event) {
      constexpr const char* names[] = {"start", "set",    "input",    "stale",   "lease",
                                       "arm",   "disarm", "watchdog", "failure", "stop"};
      std::string asked = std::to_string(event->asked);
      asked.erase(asked.find_last_not_of('0') + 1);
      if (asked.back() == '.') asked.pop_back();
      lines.push_back(std::string(names[static_cast<int>(event->cause)]) + " " + asked +
                      (event->done ? " done" : " failed: " + std::string(event->why)));
    });
  }
  std::vector<std::string> lines;
  rtdata::Subscription seen;
};

}  // namespace outputs_test
