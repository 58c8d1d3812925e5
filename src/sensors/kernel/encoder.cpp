#include "rtdata/sensors/encoder.hpp"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <sstream>
#include <utility>
#include <vector>

#include "data/number_text.hpp"
#include "io/kernel_file.hpp"
#include "sensors/core/per_time.hpp"
#include "sensors/core/source_node.hpp"
#include "sensors/core/sysfs_file.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_read_counter = "cannot read the counter";
constexpr const char* counter_advice = "`rtdata scan` lists the counters; a driver makes them: `dmesg`, docs/iio.md";
constexpr std::string_view counter_folder = "/sys/bus/counter/devices";

/// The number after the prefix: 3 for "counter3". Empty for anything else.
std::optional<unsigned> number_behind(std::string_view prefix, std::string_view name) {
  unsigned number = 0;
  if (!name.starts_with(prefix) || detail::read_number(name.substr(prefix.size()), number) != std::errc{}) return {};
  return number;
}

/// Folders "counter0", "counter1" ... in the order of their numbers.
std::vector<std::string> numbered(const std::string& in, std::string_view prefix) {
  std::vector<std::string> names = detail::names_in_folder(in);
  std::erase_if(names, [&](const std::string& name) { return !number_behind(prefix, name); });
  std::sort(names.begin(), names.end(), [&](const std::string& a, const std::string& b) {
    return *number_behind(prefix, a) < *number_behind(prefix, b);
  });
  return names;
}

/// Empty: it does not exist or cannot be read.
std::string text_of(const std::string& path) {
  auto text = detail::read_kernel_file(path, cannot_read_counter);
  return text ? std::move(*text) : "";
}

/// The one below `in` that is called `which`: by its name, its folder or its number. Empty: the only one there is.
Result<std::string> find_one(const std::string& in, std::string_view prefix, const std::string& which,
                             const char* parameter) {
  std::vector<std::string> found;
  std::string all;
  for (const std::string& one : numbered(in, prefix)) {
    const std::string name = text_of(in + "/" + one + "/name");
    all += (all.empty() ? "" : ", ") + one + (name.empty() ? "" : " (" + name + ")");
    if (which.empty() || which == one || which == name || std::string(prefix) + which == one) found.push_back(one);
  }
  if (found.size() == 1) return in + "/" + found.front();
  const std::string where = which.empty() ? in : in + ": " + which;
  if (all.empty())
    return Error{Errc::not_found, cannot_read_counter, where, "this machine has no counter", counter_advice};
  if (found.empty()) return Error{Errc::not_found, cannot_read_counter, where, "available: " + all, counter_advice};
  return Error{Errc::bad_argument, cannot_read_counter, where, "there are several: " + all,
               std::string("set `") + parameter + "` to the number of one"};
}

/// The result of opening.
struct FoundCounter {
  std::string folder = {};  ///< where the count is
  bool has_direction = false;
  CountTracker tracker = {};
  std::optional<std::uint64_t> ceiling = {};
};

/// Switches it on when it is off.
Result<void> enable(const std::string& file) {
  if (::access(file.c_str(), F_OK) != 0) return {};
  const auto is_on = detail::read_kernel_file(file, cannot_read_counter);
  if (!is_on) return is_on.error();
  if (*is_on != "0") return {};
  auto written = detail::write_kernel_file(file, "1", "cannot switch the counter on");
  if (written) return {};
  Error error = std::move(written).error();
  error.advice = "`echo 1 | sudo tee " + file + "`, or run as a user that may, or add a udev rule (docs/iio.md)";
  return error;
}

/// Sets the counter's function from the configuration. A driver may not support it, or list other functions.
Result<void> choose_function(const std::string& in, const std::string& function) {
  const std::string file = in + "/function";
  if (function.empty() || text_of(file) == function) return {};
  std::istringstream lines(text_of(in + "/function_available"));
  std::string available;
  bool found = false;
  for (std::string line; std::getline(lines, line);) {
    found = found || line == function;
    available += (available.empty() ? "" : ", ") + line;
  }
  if (!found) {
    return Error{Errc::bad_argument, "cannot set the signals to count", file,
                 "the driver has no function \"" + function + "\"" + (available.empty() ? "" : "; it has " + available),
                 "set `function` to one of these"};
  }
  auto written = detail::write_kernel_file(file, function, "cannot set the signals to count");
  if (written) return {};
  Error error = std::move(written).error();
  error.advice = "run as a user that may write the file, or add a udev rule (docs/iio.md)";
  return error;
}

Result<FoundCounter> find(const EncoderConfig& config) {
  std::string device;
  if (config.device.starts_with('/')) {
    device = config.root + config.device;
  } else {
    auto one = find_one(config.root + std::string(counter_folder), "counter", config.device, "device");
    if (!one) return one.error();
    device = std::move(*one);
  }
  auto count = find_one(device, "count", config.channel, "channel");
  if (!count) return count.error();
  FoundCounter found{std::move(*count)};
  if (auto readable = detail::check_readable(found.folder + "/count", cannot_read_counter, counter_advice); !readable)
    return readable.error();
  if (auto chosen = choose_function(found.folder, config.function); !chosen) return chosen.error();
  if (auto enabled = enable(found.folder + "/enable"); !enabled) return enabled.error();
  found.has_direction = ::access((found.folder + "/direction").c_str(), F_OK) == 0;
  const std::string function = text_of(found.folder + "/function");
  const auto way = function == "increase"   ? CountTracker::Way::up
                   : function == "decrease" ? CountTracker::Way::down
                                            : CountTracker::Way::both;
  std::uint64_t range = config.bits == 0 ? 0 : std::uint64_t{1} << config.bits;
  std::uint64_t ceiling = 0;
  if (range == 0 && detail::read_number(std::string_view(text_of(found.folder + "/ceiling")), ceiling) == std::errc{} &&
      ceiling > 0) {
    found.ceiling = ceiling;
    range = ceiling + 1;  // 0 (not known) for a counter of 64 bits, which never wraps around
  }
  found.tracker = CountTracker(way, range);
  return found;
}

class FindCounter final : public detail::Transaction {
 public:
  explicit FindCounter(EncoderConfig config) : config_(std::move(config)) {}
  void transact() noexcept override try {
    found = find(config_);
  } catch (...) {  // the text is short enough to need no memory
    found = Error{Errc::io_failed, "no memory", "", "", ""};
  }
  Result<FoundCounter> found = FoundCounter{};

 private:
  const EncoderConfig config_;
};

class ReadCounter final : public detail::Transaction {
 public:
  explicit ReadCounter(const FoundCounter& found) : count(found.folder + "/count") {
    if (found.has_direction) direction = std::make_unique<detail::SysfsFile>(found.folder + "/direction");
  }
  void transact() noexcept override {
    count.read();
    if (direction != nullptr && count.error_number() == 0) direction->read();
  }
  void close() noexcept override {
    count.close();
    if (direction != nullptr) direction->close();
  }
  detail::SysfsFile count;
  std::unique_ptr<detail::SysfsFile> direction;
};

class EncoderDevice final : public detail::LaneDevice {
 public:
  explicit EncoderDevice(EncoderConfig config) : config_(std::move(config)) {}

  std::shared_ptr<detail::Transaction> make_opening() override { return std::make_shared<FindCounter>(config_); }
  Result<void> take_opening(detail::Transaction& opening) override {
    auto& found = static_cast<FindCounter&>(opening).found;
    if (!found) return found.error();
    found_ = std::move(*found);
    return {};
  }
  std::shared_ptr<detail::Transaction> make_transaction() override { return std::make_shared<ReadCounter>(found_); }
  std::string lane_key() const override { return read_time().lane; }
  Duration give_up_after() const override { return config_.timeout; }
  ReadTime read_time() const override { return rtdata::read_time(config_); }
  Error given_up_error() const override {
    return {Errc::timed_out, cannot_read_counter, found_.folder, "no answer within " + to_string(config_.timeout),
            "check the counter; `timeout` sets how long to wait"};
  }

  detail::Sampled decode(detail::Transaction& transaction, detail::SamplePort& port) override {
    const auto& read = static_cast<ReadCounter&>(transaction);
    for (const detail::SysfsFile* file : {&read.count, static_cast<const detail::SysfsFile*>(read.direction.get())}) {
      if (file == nullptr || file->error_number() == 0) continue;
      if (file->error_number() == ENODEV)
        return port.fail({Errc::disconnected, cannot_read_counter, found_.folder, "the device has disappeared",
                          "the program searches for it again"});
      return port.fail(system_error(file->error_number(), cannot_read_counter, file->path(), counter_advice));
    }
    EncoderReading reading;
    std::uint64_t raw = 0;
    const std::string_view text = detail::trimmed(read.count.text());
    if (detail::read_number(text, raw) != std::errc{}) return port.unreadable(no_text_of(read.count, "no number"));
    if (read.direction != nullptr) {
      const std::string_view direction = detail::trimmed(read.direction->text());
      if (direction != "forward" && direction != "backward")
        return port.unreadable(no_text_of(*read.direction, "no direction"));
      reading.direction = direction == "forward" ? EncoderDirection::forward : EncoderDirection::backward;
    }
    if (found_.ceiling && raw > *found_.ceiling) {
      return port.fail({Errc::out_of_range, cannot_read_counter, found_.folder,
                        "its count " + std::to_string(raw) + " is above the ceiling at its opening, " +
                            std::to_string(*found_.ceiling),
                        "find the program that changed the ceiling; the counter is opened again"});
    }
    const std::int64_t before = found_.tracker.count();
    if (!found_.tracker.take(raw)) {
      return port.fail({Errc::bad_data, cannot_read_counter, found_.folder,
                        "its count has gone back from " + std::to_string(before) + " to " + std::to_string(raw),
                        "set `bits` if it wraps around; otherwise find the program that set it"});
    }
    reading.count = found_.tracker.count();
    reading.position = static_cast<double>(reading.count) * config_.per_count;
    if (const auto change = found_.tracker.change()) {
      const double took = std::chrono::duration<double>(transaction.began() - last_).count();
      if (took > 0)
        reading.speed = static_cast<double>(*change) * config_.per_count / took * detail::seconds_of(config_.per);
    }
    last_ = transaction.began();
    port.publish(&reading);
    return detail::Sampled::value;
  }

 private:
  static Error no_text_of(const detail::SysfsFile& file, const char* what) {
    return {Errc::bad_data, cannot_read_counter, file.path(),
            "\"" + std::string(file.text().substr(0, 40)) + "\" is " + what, ""};
  }

  const EncoderConfig config_;
  FoundCounter found_;
  MonotonicTime last_{};  // of the reading before
};

}  // namespace

void CountTracker::begin(std::uint64_t raw) noexcept {
  last_ = raw;
  count_ = static_cast<std::int64_t>(raw);
  change_.reset();
}

bool CountTracker::take(std::uint64_t raw) noexcept {
  // A signed number of 32 bits, which the kernel turns into an unsigned number of 64 bits.
  constexpr std::uint64_t signs = 0xffff'ffff'8000'0000;
  const bool has_signs = (raw & signs) == signs;
  if (range_ == 0 && has_signs && way_ != Way::both) range_ = std::uint64_t{1} << 32;
  if (range_ != 0) raw %= range_;
  if (!last_) {
    begin(raw);
    return true;
  }
  std::uint64_t up = raw >= *last_ ? raw - *last_ : raw + range_ - *last_;
  if (range_ == 0) {
    // A counter of both directions: the difference has a sign. A counter of one direction did not count the other sign.
    const auto change = static_cast<std::int64_t>(up);
    if ((way_ == Way::up && change < 0) || (way_ == Way::down && change > 0)) {
      begin(raw);
      return false;
    }
    change_ = change;
  } else {
    const std::uint64_t down = up == 0 ? 0 : range_ - up;
    const bool is_up = way_ == Way::up || (way_ == Way::both && up <= range_ / 2);
    change_ = is_up ? static_cast<std::int64_t>(up) : -static_cast<std::int64_t>(down);
  }
  last_ = raw;
  count_ += *change_;
  return true;
}

Result<std::shared_ptr<const Description>> encoder_description(const EncoderConfig& config) {
  const std::string unit = config.unit.empty() ? "{count}" : config.unit;
  using Presence = DescriptionBuilder::Presence;
  return DescriptionBuilder("encoder")
      .field("count", Kind::i64)
      .field("position", Kind::f64, unit)
      .field("speed", Kind::f64, detail::unit_of_speed(unit, config.per), Presence::optional)
      .enumeration("direction", {{"backward", -1}, {"forward", 1}}, Kind::i8, Presence::optional)
      .build();
}

ReadTime read_time(const EncoderConfig& config) {
  return {.on_loop = detail::lane_read_on_loop, .on_lane = {}, .lane = "counter " + config.root + config.device};
}

EncoderSensor::EncoderSensor(Loop& loop, SensorConfig sensor, EncoderConfig config) {
  const auto refuse = [&](const char* why, const char* advice) {
    throw SetupError({Errc::bad_argument, "cannot use this counter", "sensor " + sensor.name, why, advice});
  };
  if (!std::isfinite(config.per_count) || config.per_count == 0) refuse("per_count is 0 or not a number", "such as 1");
  if (config.per != "s" && config.per != "min" && config.per != "h")
    refuse("`per` is not a unit of time", "use s, min or h");
  if (config.bits > 63) refuse("`bits` is larger than 63", "such as 16");
  auto type = detail::described_type(encoder_description(config).or_throw());
  *this = EncoderSensor(detail::make_sensor(loop, std::move(sensor), std::move(type),
                                            std::make_unique<EncoderDevice>(std::move(config))));
}

}  // namespace rtdata
