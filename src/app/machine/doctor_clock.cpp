#include <ctime>

#include "app/machine/doctor.hpp"
#include "rtdata/loop/clock.hpp"

namespace rtdata::app {

std::vector<Finding> examine_clock(const MachineFiles& files) {
  std::vector<Finding> found;
  const std::string folder = "/sys/devices/system/clocksource/clocksource0/";
  const std::string source = files.text(folder + "current_clocksource").value_or("");
  const bool is_slow = source == "hpet" || source == "acpi_pm" || source == "jiffies" || source == "refined-jiffies" ||
                       source == "pit";
  if (is_slow) {
    found.push_back({Severity::warning, "clock source", source, "reading the time takes a microsecond and more",
                     "there are: " + files.text(folder + "available_clocksource").value_or("unknown") +
                         "; the boot option clocksource= chooses"});
  } else if (!source.empty()) {
    found.push_back({Severity::good, "clock source", source});
  }
  if (files.is_this_machine()) {
    if (const std::optional<Duration> accuracy = SystemClock().accuracy()) {
      found.push_back({Severity::good, "clock", "synchronised, within " + to_string(*accuracy)});
    } else {
      found.push_back({Severity::warning, "clock", "nothing synchronises it, as far as the kernel knows",
                       "UTC of a recording is as wrong as the clock; times between events are right all the same",
                       "sudo apt install chrony; without a network, a GPS receiver gives the time (docs/gps.md)"});
    }
    if constexpr (sizeof(std::time_t) < 8) {
      found.push_back({Severity::warning, "time", "this program counts seconds in 32 bits",
                       "times of files and logs go wrong in January 2038; those of recordings do not",
                       "compile it with -D_TIME_BITS=64, or use a system of 64 bits"});
    } else if constexpr (sizeof(long) < 8) {
      found.push_back({Severity::note, "time", "this system has 32 bits, this program counts seconds in 64",
                       "other programs may go wrong in January 2038", "a system of 64 bits"});
    } else {
      found.push_back({Severity::good, "time", "seconds are counted in 64 bits"});
    }
  } else if (files.exists("/run/systemd/timesync/synchronized")) {
    found.push_back({Severity::good, "clock", "synchronised by systemd-timesyncd"});
  }
  if (files.names("/sys/class/rtc").empty())
    found.push_back({Severity::note, "hardware clock", "there is none",
                     "the machine starts with a time in the past until something synchronises it",
                     "a clock chip with a battery (DS3231), or a network or GPS at the start"});
  return found;
}

}  // namespace rtdata::app
