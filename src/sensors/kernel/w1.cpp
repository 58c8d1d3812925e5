#include "rtdata/sensors/w1.hpp"

#include <algorithm>
#include <filesystem>

#include "data/setting_mistake.hpp"
#include "io/enabling.hpp"
#include "io/kernel_file.hpp"
#include "rtdata/data/problem.hpp"
#include "sensors/core/sysfs_file.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_read_w1 = "cannot read the thermometer";
constexpr const char*
    w1_advice = "check the bus with `ls /sys/bus/w1/devices`; the kernel finds new thermometers within 10 s";
constexpr std::string_view w1_folder = "/sys/bus/w1/devices";
constexpr std::string_view no_path = "`device` must be a name such as 28-000000c0ffee, not a path";

bool is_name(const std::string& device) {
  return device.find('/') == std::string::npos && device != ".." && device != ".";
}

/// A bus, with or without thermometers.
bool is_there(const std::string& root) {
  std::error_code none;
  return !std::filesystem::is_empty(root + std::string(w1_folder), none) && !none;
}

Result<std::string> file_of(const W1Config& config) {
  std::string device = config.device;
  if (device.empty()) {
    const auto all = available_w1(config.root);
    if (all.size() != 1) {
      std::string names;
      for (const std::string& one : all) names += (names.empty() ? "available: " : ", ") + one;
      return Error{all.empty() ? Errc::not_found : Errc::bad_argument, cannot_read_w1,
                   config.root + std::string(w1_folder), all.empty() ? "there is no thermometer" : names,
                   !all.empty()            ? "set `device`"
                   : is_there(config.root) ? w1_advice
                                           : detail::how_to_enable(w1_folder)};
    }
    device = all.front();
  }
  return config.root + std::string(w1_folder) + "/" + device + "/w1_slave";
}

class W1Device final : public detail::LaneDevice {
 public:
  explicit W1Device(W1Config config) : config_(std::move(config)) {}

  std::shared_ptr<detail::Transaction> make_opening() override {
    return std::make_shared<detail::FindFile>([config = config_] { return file_of(config); }, cannot_read_w1,
                                              w1_advice);
  }
  Result<void> take_opening(detail::Transaction& opening) override {
    const auto& path = static_cast<detail::FindFile&>(opening).path();
    if (!path) return path.error();
    path_ = *path;
    return {};
  }
  std::shared_ptr<detail::Transaction> make_transaction() override { return std::make_shared<detail::ReadFile>(path_); }
  std::string lane_key() const override { return read_time().lane; }
  Duration give_up_after() const override { return config_.timeout; }
  ReadTime read_time() const override { return rtdata::read_time(config_); }
  Error given_up_error() const override {
    return {Errc::timed_out, cannot_read_w1, path_, "no answer within " + to_string(config_.timeout),
            "set a longer `timeout` if there are many on one bus with parasitic power; otherwise check the bus"};
  }
  detail::Sampled decode(detail::Transaction& transaction, detail::SamplePort& port) override {
    const detail::SysfsFile& file = static_cast<detail::ReadFile&>(transaction).file;
    if (file.error_number() != 0) return port.fail(system_error(file.error_number(), cannot_read_w1, path_, w1_advice));
    const Result<double> degrees = parse_w1(file.text());
    if (!degrees) {
      Error error = degrees.error();
      error.where = path_;
      return error.code == Errc::disconnected ? port.fail(std::move(error)) : port.unreadable(std::move(error));
    }
    W1Temperature payload{*degrees};
    port.publish(&payload);
    return detail::Sampled::value;
  }

 private:
  const W1Config config_;
  std::string path_;
};

}  // namespace

std::vector<std::string> available_w1(const std::string& root) {
  std::vector<std::string> found;
  for (std::string& name : detail::names_in_folder(root + std::string(w1_folder))) {
    // The families that w1_therm serves.
    for (const std::string_view family : {"10-", "22-", "28-", "3b-", "42-"}) {
      if (!name.starts_with(family)) continue;
      found.push_back(std::move(name));
      break;
    }
  }
  std::sort(found.begin(), found.end());
  return found;
}

void check_config(const W1Config& config, const ConfigItem& item, Problems& problems) {
  if (is_name(config.device)) return;
  detail::add_mistake({"device", std::string(no_path)}, item, problems);
}

ReadTime read_time(const W1Config& config) {
  return {.on_loop = detail::lane_read_on_loop,
          .on_lane = std::chrono::milliseconds{800},
          .lane = "w1 " + config.root + config.device};
}

W1Sensor::W1Sensor(Loop& loop, SensorConfig sensor, W1Config config) {
  if (!is_name(config.device)) {
    throw SetupError(
        {Errc::bad_argument, "cannot use this thermometer", "sensor " + sensor.name, std::string(no_path), ""});
  }
  *this = W1Sensor(detail::make_sensor(loop, std::move(sensor), detail::payload_type<W1Temperature>(),
                                       std::make_unique<W1Device>(std::move(config))));
}

}  // namespace rtdata
