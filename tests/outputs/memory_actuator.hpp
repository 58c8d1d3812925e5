// A device of memory.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/data/parameter.hpp"
#include "rtdata/outputs/output.hpp"

namespace outputs_test {

/// What has been done to it, and how it behaves. Values are written as they are set: "open 0", "set 1", "gone".
struct Device {
  std::vector<std::string> did;
  std::optional<double> value;
  bool fails = false;
  double most = 1e9;               // it refuses what is above
  rtdata::OutputRange range = {};  // as it says of itself

  rtdata::MakeActuator make() {
    return [this] { return std::make_unique<Memory>(*this); };
  }

 private:
  struct Memory final : rtdata::Actuator {
    explicit Memory(Device& device_) : device(device_) {}
    ~Memory() override {
      if (is_open) device.did.push_back("gone");
    }
    rtdata::OutputRange range() const override { return device.range; }
    rtdata::Result<void> open(std::optional<double> wanted) override {
      if (auto done = put("open " + (wanted ? text_of(*wanted) : std::string("kept")), wanted); !done) return done;
      is_open = true;
      return {};
    }
    rtdata::Result<void> set(double wanted) override { return put("set " + text_of(wanted), wanted); }
    rtdata::Result<void> put(const std::string& what, std::optional<double> wanted) {
      if (wanted && *wanted > device.most) {
        device.did.push_back(what + " refused");
        return rtdata::Error{rtdata::Errc::out_of_range, "cannot", "", "it is too much", ""};
      }
      device.did.push_back(device.fails ? what + " failed" : what);
      if (device.fails) return rtdata::Error{rtdata::Errc::io_failed, "cannot", "", "it is broken", ""};
      if (wanted) device.value = wanted;
      return {};
    }
    static std::string text_of(double number) {
      std::string text = std::to_string(number);
      text.erase(text.find_last_not_of('0') + 1);
      if (text.back() == '.') text.pop_back();
      return text;
    }
    Device& device;
    bool is_open = false;
  };
};

/// Which one a configuration means.
struct DeviceConfig {
  std::string device;
  friend constexpr auto parameters(rtdata::type_tag<DeviceConfig>) {
    using namespace rtdata;
    return parameter_list(parameter("device", &DeviceConfig::device, "its name", required, TextIs::recorded));
  }
};

}  // namespace outputs_test
