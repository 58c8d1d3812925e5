#include "rtdata/sensors/iio.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "data/number_text.hpp"
#include "data/setting_mistake.hpp"
#include "rtdata/data/problem.hpp"
#include "rtdata/io/iio.hpp"
#include "sensors/core/source_node.hpp"
#include "sensors/core/sysfs_file.hpp"
#include "sensors/kernel/iio_lane.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_read_iio = "cannot read the IIO device";
constexpr const char* cannot_use = "cannot use this IIO sensor";

std::string field_of(std::string channel) {
  std::replace(channel.begin(), channel.end(), '-', '_');
  return channel;
}

/// What is wrong with a channel. Empty: nothing.
std::string mistake_in(const std::string& channel, std::string& nearest) {
  if (iio_quantity(channel) != nullptr) return {};
  std::vector<std::string> known;
  for (const IioQuantity& one : iio_quantities()) known.emplace_back(one.type);
  const std::size_t end = std::min(channel.find_first_of("0123456789_-"), channel.size());
  nearest = nearest_name(channel.substr(0, end), known);
  if (!nearest.empty()) nearest += channel.substr(end);
  if (iio_quantity(nearest) == nullptr) nearest.clear();
  return "\"" + channel +
         "\" is not a channel: write a type of the kernel and an index or axis, such as voltage0 or accel_x";
}

void check_channels(const std::vector<std::string>& channels, const ConfigItem& item, Problems& problems) {
  const ConfigItem* list = item.find("channels");
  const ConfigItem& at = list != nullptr ? *list : item;
  bool is_good = !channels.empty();
  if (!is_good) problems.add(at.problem("bad-value", "it has no channels: list them, such as [\"voltage0\"]"));
  for (const std::string& channel : channels) {
    std::string nearest;
    const std::string mistake = mistake_in(channel, nearest);
    if (mistake.empty()) continue;
    is_good = false;
    problems.add(at.problem("unknown-choice", mistake, nearest));
  }
  if (!is_good) return;
  if (const auto description = iio_description(channels); !description)
    problems.add(at.problem("bad-value", description.error().why));
}

/// The result of opening.
struct Plan {
  std::string device;  ///< for messages
  std::string node;
  std::vector<std::string> files;
  std::vector<IioConversion> conversions;
};

Result<Plan> find(const IioConfig& config) {
  const auto device = IioDevice::find(config.device, config.root);
  if (!device) return device.error();
  Plan plan{device->text(), device->node(), {}, {}};
  for (const std::string& name : config.channels) {
    const auto channel = device->channel_or_error(name);
    if (!channel) return channel.error();
    if (!channel->is_readable) {
      return Error{Errc::not_found, cannot_read_iio, device->text(), "channel " + name + " is in its buffer only",
                   "use the type \"iio_buffer\""};
    }
    const auto conversion = device->conversion(*channel);
    if (!conversion) return conversion.error();
    plan.files.push_back(device->file_of(*channel));
    plan.conversions.push_back(*conversion);
  }
  return plan;
}

class FindDevice final : public detail::Transaction {
 public:
  explicit FindDevice(IioConfig config) : config_(std::move(config)) {}
  void transact() noexcept override try { plan = find(config_); } catch (...) {  // the text needs no memory
    plan = Error{Errc::io_failed, "no memory", "", "", ""};
  }
  Result<Plan> plan = Plan{};

 private:
  const IioConfig config_;
};

/// Reads all channels, one after the other, up to the first that cannot be read.
class ReadChannels final : public detail::Transaction {
 public:
  ReadChannels(const Plan& plan, std::string node) : node_(std::move(node)) {
    for (const std::string& file : plan.files) files.push_back(std::make_unique<detail::SysfsFile>(file));
  }
  void transact() noexcept override {
    holder.clear();
    for (failed = 0; failed < files.size(); ++failed) {
      files[failed]->read();
      if (files[failed]->error_number() == 0) continue;
      if (files[failed]->error_number() == EBUSY) name_holder();
      return;
    }
  }
  void close() noexcept override {
    for (const auto& file : files) file->close();
  }
  std::vector<std::unique_ptr<detail::SysfsFile>> files;
  std::size_t failed = 0;  ///< the index of that channel; the number of channels: every channel was read
  std::string holder;

 private:
  void name_holder() noexcept try { holder = detail::holder_of(node_); } catch (...) {  // then no name
  }
  const std::string node_;
};

class IioPolled final : public detail::LaneDevice {
 public:
  explicit IioPolled(IioConfig config) : config_(std::move(config)) {
    std::size_t count = 0;
    for (const std::string& channel : config_.channels) count += iio_values(channel);
    values_.resize(count);
  }

  std::shared_ptr<detail::Transaction> make_opening() override { return std::make_shared<FindDevice>(config_); }
  Result<void> take_opening(detail::Transaction& opening) override {
    auto& found = static_cast<FindDevice&>(opening).plan;
    if (!found) return found.error();
    plan_ = std::move(*found);
    return {};
  }
  std::shared_ptr<detail::Transaction> make_transaction() override {
    return std::make_shared<ReadChannels>(plan_, plan_.node);
  }
  std::string lane_key() const override { return detail::iio_lane(config_.device, config_.root); }
  Duration give_up_after() const override { return config_.timeout; }
  ReadTime read_time() const override { return rtdata::read_time(config_); }
  Error given_up_error() const override {
    return {Errc::timed_out, cannot_read_iio, plan_.device.empty() ? config_.device : plan_.device,
            "no answer within " + to_string(config_.timeout),
            "check the chip and its bus; `timeout` sets how long to wait"};
  }

  detail::Sampled decode(detail::Transaction& transaction, detail::SamplePort& port) override {
    const auto& read = static_cast<ReadChannels&>(transaction);
    if (read.failed < read.files.size()) return port.fail(failure(*read.files[read.failed], read.holder));
    std::size_t position = 0;
    for (std::size_t i = 0; i < read.files.size(); ++i) {
      std::string_view rest = detail::trimmed(read.files[i]->text());
      for (std::size_t left = iio_values(config_.channels[i]); left > 0; --left) {
        const std::size_t end = left == 1 ? rest.size() : std::min(rest.find(' '), rest.size());
        double code = 0;
        if (detail::read_number(rest.substr(0, end), code) != std::errc{} || !std::isfinite(code)) {
          return port.unreadable({Errc::not_a_number, cannot_read_iio, read.files[i]->path(),
                                  "\"" + std::string(rest.substr(0, 40)) + "\" is not a number", ""});
        }
        rest = detail::trimmed(rest.substr(end));
        values_[position++] = (code + plan_.conversions[i].offset) * plan_.conversions[i].scale;
      }
    }
    port.publish(values_.data());
    return detail::Sampled::value;
  }

 private:
  Error failure(const detail::SysfsFile& file, const std::string& holder) const {
    if (file.error_number() == EBUSY) {
      return {Errc::busy, cannot_read_iio, plan_.device,
              holder.empty() ? "another program uses its buffer" : holder + " uses its buffer",
              holder == detail::this_program ? "list these channels in the sensor that reads its buffer"
                                             : "end that program, or read the buffer with the type \"iio_buffer\""};
    }
    if (file.error_number() == ENODEV) {
      return {Errc::disconnected, cannot_read_iio, plan_.device, "the device has disappeared",
              "the program searches for it again"};
    }
    return system_error(file.error_number(), cannot_read_iio, file.path(),
                        "check the chip and its wires; `dmesg` may say more");
  }

  const IioConfig config_;
  Plan plan_;
  std::vector<double> values_;
};

}  // namespace

std::string detail::iio_lane(const std::string& device, const std::string& root) { return "iio " + root + device; }

void detail::check_iio(const std::string& device, const std::vector<std::string>& channels, const std::string& name) {
  const auto refuse = [&](std::string why, const char* advice) {
    throw SetupError({Errc::bad_argument, cannot_use, "sensor " + name, std::move(why), advice});
  };
  if (device.empty()) refuse("it has no device", "set it, such as bmp280; `rtdata scan` lists the devices");
  (void)iio_description(channels).or_throw();
}

Result<std::shared_ptr<const Description>> iio_description(const std::vector<std::string>& channels) {
  const auto refused = [](std::string why) {
    return Error{Errc::bad_argument, cannot_use, "channels", std::move(why),
                 "choose channels that `rtdata scan` lists for the device"};
  };
  if (channels.empty()) return refused("it has no channels");
  DescriptionBuilder builder("iio");
  for (const std::string& channel : channels) {
    std::string nearest;
    if (std::string mistake = mistake_in(channel, nearest); !mistake.empty()) return refused(std::move(mistake));
    const std::string unit(iio_quantity(channel)->unit);
    if (const std::size_t count = iio_values(channel); count > 1) {
      builder.array(field_of(channel), Kind::f64, count, unit);
    } else {
      builder.field(field_of(channel), Kind::f64, unit);
    }
  }
  return builder.build();
}

void check_config(const IioConfig& config, const ConfigItem& item, Problems& problems) {
  check_channels(config.channels, item, problems);
}

void check_config(const IioBufferConfig& config, const ConfigItem& item, Problems& problems) {
  check_channels(config.channels, item, problems);
  if (config.watermark <= config.length) return;
  detail::add_mistake(
      {"watermark", "the buffer holds " + std::to_string(config.length) + " scans, fewer than the watermark",
       "set a larger `length`"},
      item, problems);
}

ReadTime read_time(const IioConfig& config) {
  return {.on_loop = detail::lane_read_on_loop, .on_lane = {}, .lane = detail::iio_lane(config.device, config.root)};
}

IioSensor::IioSensor(Loop& loop, SensorConfig sensor, IioConfig config) {
  detail::check_iio(config.device, config.channels, sensor.name);
  auto type = detail::described_type(iio_description(config.channels).or_throw());
  *this = IioSensor(
      detail::make_sensor(loop, std::move(sensor), std::move(type), std::make_unique<IioPolled>(std::move(config))));
}

}  // namespace rtdata
