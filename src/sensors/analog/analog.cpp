#include "rtdata/sensors/analog.hpp"

#include <charconv>
#include <cmath>
#include <cstring>

#include "data/setting_mistake.hpp"
#include "rtdata/io/iio.hpp"
#include "sensors/core/source_node.hpp"
#include "sensors/core/sysfs_file.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_read = "cannot read the ADC file";
constexpr const char* find_advice = "check `file`; `ls /sys/bus/iio/devices/*/in_voltage*_raw` lists the converters";

double codes(const AnalogConfig& config) noexcept {
  return std::ldexp(1.0, static_cast<int>(config.quantization_bits));
}

double span_voltage_of_value(const AnalogConfig& config) noexcept {
  return config.span_value_voltage.value_or(config.span_voltage);
}

std::string shown(std::string_view text) {
  std::string shown = "\"";
  for (const char c : text.substr(0, 40)) shown += c >= ' ' && c < 127 ? c : '?';
  return shown + (text.size() > 40 ? "...\"" : "\"");
}

/// The mistake in the converter's name; empty: none.
std::string_view mistake_in_place(const AnalogConfig& config) {
  if (config.file.empty() && config.device.empty()) return "it has neither `file` nor `device`";
  if (!config.file.empty() && !config.device.empty()) return "it has both `file` and `device`";
  if (config.device.empty() != config.channel.empty()) return "`device` and `channel` need each other: set both";
  if (!config.channel.empty() && iio_quantity(config.channel) == nullptr)
    return "`channel` is not the name of a channel; such as voltage0";
  return {};
}

Result<std::string> file_of(const AnalogConfig& config) {
  if (config.device.empty()) return config.file;
  const auto device = IioDevice::find(config.device);
  if (!device) return device.error();
  const auto channel = device->channel_or_error(config.channel);
  if (!channel) return channel.error();
  return device->folder() + "/in_" + channel->name + "_raw";
}

std::string lane_of(const AnalogConfig& config) {
  return config.device.empty() ? detail::physical_device_of(config.file) : "iio " + config.device;
}

class AnalogDevice final : public detail::LaneDevice {
 public:
  explicit AnalogDevice(AnalogConfig config) : config_(std::move(config)) {}

  std::shared_ptr<detail::Transaction> make_opening() override {
    return std::make_shared<detail::FindFile>([config = config_] { return file_of(config); }, cannot_read, find_advice);
  }
  Result<void> take_opening(detail::Transaction& opening) override {
    const auto& path = static_cast<detail::FindFile&>(opening).path();
    if (!path) return path.error();
    config_.file = *path;
    return {};
  }
  std::shared_ptr<detail::Transaction> make_transaction() override {
    return std::make_shared<detail::ReadFile>(config_.file);
  }
  std::string lane_key() const override { return lane_of(config_); }
  Duration give_up_after() const override { return config_.timeout; }
  ReadTime read_time() const override { return rtdata::read_time(config_); }
  Error given_up_error() const override {
    return {Errc::timed_out, cannot_read, config_.file.empty() ? config_.device : config_.file,
            "no answer within " + to_string(config_.timeout),
            "check the converter and its bus; `timeout` sets how long to wait"};
  }

  detail::Sampled decode(detail::Transaction& transaction, detail::SamplePort& port) override {
    const detail::SysfsFile& file = static_cast<detail::ReadFile&>(transaction).file;
    if (file.error_number() != 0)
      return port.fail(system_error(file.error_number(), cannot_read, config_.file, find_advice));
    Result<std::int64_t> adc = parse_adc(config_, file.text());
    if (!adc) return port.unreadable(std::move(adc).error());
    AnalogReading reading{convert(config_, *adc), *adc};
    if (!std::isfinite(reading.value)) {
      return port.unreadable({Errc::out_of_range, cannot_read, config_.file,
                              "after conversion, " + std::to_string(*adc) + " is not a finite number",
                              "check `scale` and the voltages"});
    }
    port.publish(&reading);
    return detail::Sampled::value;
  }

 private:
  AnalogConfig config_;
};

/// The mistake in the combination of parameters; empty: none.
const char* mistake_in_range(const AnalogConfig& config) {
  const double span = span_voltage_of_value(config);
  const bool has_width = config.conversion == AnalogConversion::standard ? span != 0
                                                                         : span != config.zero_value_voltage;
  return has_width ? "" : "the sensor's range has the width 0";
}
constexpr const char* range_advice = "set span_value_voltage to the voltage of the full value";

void check(const AnalogConfig& config, const std::string& name) {
  const auto refuse = [&](const char* why, const char* advice) {
    throw SetupError({Errc::bad_argument, "cannot use this analog sensor", "sensor " + name, why, advice});
  };
  const double span = span_voltage_of_value(config);
  if (const std::string_view mistake = mistake_in_place(config); !mistake.empty()) refuse(mistake.data(), find_advice);
  if (config.quantization_bits < 1 || config.quantization_bits > 62)
    refuse("quantization_bits is not 1 to 62", "such as 12");
  if (config.timeout <= Duration{0}) refuse("its timeout is not positive", "such as 1 s");
  for (const double volts : {config.zero_value_voltage, span, config.scale, config.zero_voltage, config.span_voltage}) {
    if (!std::isfinite(volts)) refuse("a voltage or the scale is not finite", "set it to a number");
  }
  if (config.scale == 0) refuse("its scale is 0", "set it to the full value, such as 10");
  if (config.span_voltage == 0) refuse("span_voltage is 0", "set it to the range of the converter, such as 3.3");
  if (const std::string_view mistake = mistake_in_range(config); !mistake.empty()) refuse(mistake.data(), range_advice);
}

}  // namespace

void check_config(const AnalogConfig& config, const ConfigItem& item, Problems& problems) {
  if (const std::string_view place = mistake_in_place(config); !place.empty()) {
    const ConfigItem* file = item.find("file");
    const ConfigItem* named = file != nullptr ? file : item.find("channel");
    problems.add(
        (named != nullptr ? *named : item)
            .problem("bad-value", file != nullptr && config.file.empty() ? "it is empty" : std::string(place)));
  }
  detail::add_mistake({"span_value_voltage", mistake_in_range(config), range_advice}, item, problems);
}

ReadTime read_time(const AnalogConfig& config) {
  return {.on_loop = detail::lane_read_on_loop, .on_lane = {}, .lane = lane_of(config)};
}

double convert(const AnalogConfig& config, std::int64_t adc) noexcept {
  const double span_value_voltage = span_voltage_of_value(config);
  const double width = config.conversion == AnalogConversion::standard ? span_value_voltage
                                                                       : span_value_voltage - config.zero_value_voltage;
  const double zero = codes(config) * (config.zero_value_voltage - config.zero_voltage) / config.span_voltage;
  const double span = codes(config) * width / config.span_voltage;
  return (static_cast<double>(adc) - zero) * config.scale / span;
}

Result<std::int64_t> parse_adc(const AnalogConfig& config, std::string_view text) {
  const std::string_view number = detail::trimmed(text);
  const auto failure = [&](Errc code, std::string why, const char* advice) {
    return Error{code, cannot_read, config.file, std::move(why), advice};
  };
  constexpr const char* no_adc = "check `file`: the file of a converter contains one whole number";
  if (text.size() >= detail::SysfsFile::most) return failure(Errc::bad_data, "it contains more than a number", no_adc);
  if (number.empty()) return failure(Errc::bad_data, "it is empty", no_adc);
  std::int64_t adc = 0;
  const auto [end, status] = std::from_chars(number.data(), number.data() + number.size(), adc);
  if (status == std::errc::invalid_argument || end != number.data() + number.size()) {
    return failure(Errc::not_a_number, shown(number) + " is not a whole number", no_adc);
  }
  const std::int64_t count = std::int64_t{1} << config.quantization_bits;
  const std::int64_t least = config.signed_adc ? -count / 2 : 0;
  const std::int64_t greatest = config.signed_adc ? count / 2 - 1 : count - 1;
  if (status == std::errc::result_out_of_range || adc < least || adc > greatest) {
    return failure(Errc::out_of_range,
                   shown(number) + " is outside " + std::to_string(least) + " to " + std::to_string(greatest),
                   "check `quantization_bits` and `signed_adc`");
  }
  return adc;
}

Result<std::shared_ptr<const Description>> analog_description(const std::string& unit) {
  return DescriptionBuilder("analog").field("value", Kind::f64, unit).field("raw", Kind::i64).build();
}

std::optional<AnalogReading> analog_reading(const EventView& event) noexcept {
  const Description& description = event.description();
  if (description.name() != "analog" || event.payload().size() != sizeof(AnalogReading)) return {};
  AnalogReading reading;
  std::memcpy(&reading, event.payload().data(), sizeof reading);
  return reading;
}

AnalogSensor::AnalogSensor(Loop& loop, SensorConfig sensor, AnalogConfig config) {
  check(config, sensor.name);
  auto type = detail::described_type(analog_description(config.unit).or_throw());
  *this = AnalogSensor(
      detail::make_sensor(loop, std::move(sensor), std::move(type), std::make_unique<AnalogDevice>(std::move(config))));
}

}  // namespace rtdata
