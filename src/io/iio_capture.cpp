#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <utility>

#include "data/nearest.hpp"
#include "io/kernel_file.hpp"
#include "rtdata/io/iio.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_capture = "cannot use the IIO buffer";

struct Trigger {
  std::string folder, name;
};

std::vector<Trigger> triggers_below(const std::string& folder) {
  std::vector<Trigger> found;
  for (const std::string& name : detail::names_in_folder(folder)) {
    if (!name.starts_with("trigger")) continue;
    const auto called = detail::read_kernel_file(folder + "/" + name + "/name", cannot_capture);
    if (called) found.push_back({folder + "/" + name, *called});
  }
  return found;
}

std::string hertz(double value) {
  std::string text = std::to_string(value);
  while (text.ends_with('0')) text.pop_back();
  if (text.ends_with('.')) text.pop_back();
  return text + " Hz";
}

}  // namespace

IioCapture::IioCapture(IioCapture&& other) noexcept { *this = std::move(other); }

IioCapture& IioCapture::operator=(IioCapture&& other) noexcept {
  if (this == &other) return *this;
  close();
  device_ = std::move(other.device_);
  fd_ = std::exchange(other.fd_, -1);
  is_on_ = std::exchange(other.is_on_, false);
  layout_ = std::move(other.layout_);
  frequency_ = other.frequency_;
  trigger_folder_ = std::move(other.trigger_folder_);
  trigger_ = std::move(other.trigger_);
  clock_ = std::move(other.clock_);
  notes_ = std::move(other.notes_);
  return *this;
}

IioCapture::~IioCapture() { close(); }

void IioCapture::close() noexcept {
  // Off first: closing the descriptor leaves the buffer on.
  if (std::exchange(is_on_, false)) (void)device_->set_attribute("buffer/enable", "0");
  if (const int fd = std::exchange(fd_, -1); fd >= 0) ::close(fd);
}

void IioCapture::abandon() noexcept {
  is_on_ = false;
  close();
}

Result<IioCapture> IioCapture::open(const IioDevice& device, const IioCaptureConfig& config) {
  IioCapture capture;
  capture.device_ = device;
  if (auto done = capture.set_up(config); !done) return std::move(done).error();
  return capture;
}

Result<void> IioCapture::set_up(const IioCaptureConfig& config) {
  const IioDevice& device = *device_;
  if (!device.has_buffer()) {
    return Error{Errc::not_found, cannot_capture, device.text(), "its driver has no buffer",
                 "read its channels one by one, with the type \"iio\""};
  }
  fd_ = ::open(device.node().c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
  if (fd_ < 0) {
    const int number = errno;
    if (number == EBUSY) {  // the kernel allows one user
      const std::string holder = device.holder();
      return Error{Errc::busy, cannot_capture, device.text(),
                   holder.empty() ? "another program has it" : holder + " has it",
                   holder.empty()                   ? "`sudo fuser -v " + device.node() + "` names it"
                   : holder == detail::this_program ? "list the channels of both sensors in one"
                                                    : "end that program, or use its data"};
    }
    return system_error(number, cannot_capture, device.node(),
                        number == EACCES ? "add a udev rule that lets the user read it (docs/iio.md)" : "");
  }
  const auto is_on = device.attribute("buffer/enable");
  if (!is_on) return is_on.error();
  if (*is_on == "1") {
    // No program has the device open, otherwise opening would have failed: the program that enabled it was killed, or
    // is a script.
    if (auto off = device.set_attribute("buffer/enable", "0"); !off) return off;
    notes_.push_back("the buffer was on, but no program had it open: it was turned off, and is now used");
  }
  if (auto done = set_trigger(config.trigger); !done) return done;
  if (device.has_attribute("current_timestamp_clock")) {
    (void)device.set_attribute("current_timestamp_clock", "monotonic");  // refused while it waits for events
    if (const auto clock = device.attribute("current_timestamp_clock")) clock_ = *clock;
  }
  if (auto done = set_channels(config); !done) return done;
  if (auto done = set_rate(config.rate); !done) return done;
  return enable(config);
}

Result<void> IioCapture::set_trigger(const std::string& wanted) {
  const IioDevice& device = *device_;
  const std::string folder = device.folder().substr(0, device.folder().rfind('/'));
  const std::vector<Trigger> all = triggers_below(folder);
  std::vector<std::string_view> names;
  for (const Trigger& one : all) names.push_back(one.name);
  if (!device.has_attribute("trigger/current_trigger")) {
    if (wanted.empty()) return {};
    return Error{Errc::bad_argument, cannot_capture, device.text(), "it measures by itself and needs no trigger",
                 "remove `trigger`"};
  }
  const auto current = device.attribute("trigger/current_trigger");
  if (!current) return current.error();
  std::string name = wanted.empty() ? *current : wanted;
  if (name.empty()) {
    const std::string own = device.name() + "-dev" + std::to_string(device.number());
    if (std::find(names.begin(), names.end(), own) != names.end()) name = own;
  }
  if (name.empty()) return {};  // enabling the buffer shows the error
  const auto found = std::find_if(all.begin(), all.end(), [&](const Trigger& one) { return one.name == name; });
  if (found == all.end()) {
    return Error{Errc::not_found, cannot_capture, device.text(), "there is no trigger " + name,
                 names.empty() ? "make one: docs/iio.md" : detail::suggestion(name, names)};
  }
  if (name != *current) {
    if (auto done = device.set_attribute("trigger/current_trigger", name); !done) {
      Error error = std::move(done).error();
      error.advice = "choose another `trigger`: this device does not accept " + name;
      return error;
    }
  }
  trigger_ = name;
  trigger_folder_ = found->folder;
  return {};
}

Result<void> IioCapture::set_channels(const IioCaptureConfig& config) {
  const IioDevice& device = *device_;
  std::vector<IioLayout::Channel> on;
  std::size_t position = 0;
  for (const std::string& name : config.channels) {
    const auto channel = device.channel_or_error(name);
    if (!channel) return channel.error();
    if (!channel->storage) {
      return Error{Errc::not_found, cannot_capture, device.text(), "channel " + name + " is not in its buffer",
                   "read it with the type \"iio\""};
    }
    if (channel->storage->repeat != iio_values(name)) {
      return Error{Errc::bad_argument, cannot_capture, device.text(),
                   "channel " + name + " has " + std::to_string(channel->storage->repeat) + " values",
                   "remove this channel"};
    }
    const auto conversion = device.scan_conversion(*channel);
    if (!conversion) return conversion.error();
    on.push_back({channel->index, *channel->storage, *conversion, position, false});
    position += iio_values(name);
  }
  const auto is_wanted = [&](const std::string& name) {
    return std::find(config.channels.begin(), config.channels.end(), name) != config.channels.end();
  };
  if (on.empty()) return Error{Errc::bad_argument, cannot_capture, device.text(), "no channels are given", ""};
  if (const IioChannel* timestamp = device.channel("timestamp"); timestamp != nullptr && timestamp->storage)
    on.push_back({timestamp->index, *timestamp->storage, {}, 0, true});
  const auto switched = [&device](const std::string& file, const char* to) -> Result<void> {
    const auto is = device.attribute(file);
    if (is && *is == to) return {};
    if (auto done = device.set_attribute(file, to); !done) return done;
    return {};
  };
  const bool has_timestamp = on.back().is_timestamp;
  std::vector<std::string> files;
  for (const std::string& file : detail::names_in_folder(device.folder() + "/scan_elements")) {
    if (file.starts_with("in_") && file.ends_with("_en")) files.push_back(file);
  }
  // Disables first, because some devices allow few channels at a time; then enables, and checks the result.
  for (const char* const to : {"0", "1"}) {
    for (const std::string& file : files) {
      const std::string name = file.substr(3, file.size() - 6);
      const bool is_on = is_wanted(name) || (has_timestamp && name == "timestamp");
      if (is_on != (*to == '1')) continue;
      if (auto done = switched("scan_elements/" + file, to); !done) {
        Error error = std::move(done).error();
        if (is_on) error.advice = "choose fewer `channels`: the chip may not be able to measure these together";
        return error;
      }
    }
  }
  for (const std::string& file : files) {
    const std::string name = file.substr(3, file.size() - 6);
    const bool is_on = is_wanted(name) || (has_timestamp && name == "timestamp");
    const auto is = device.attribute("scan_elements/" + file);
    if (!is) return is.error();
    if (*is != (is_on ? "1" : "0")) {
      return Error{Errc::bad_argument, cannot_capture, device.text(),
                   "channel " + name + " stays " + (is_on ? "off" : "on") + ": the chip cannot measure these together",
                   "choose fewer or other `channels`"};
    }
  }
  auto layout = IioLayout::make(std::move(on));
  if (!layout) return layout.error();
  layout_ = std::move(*layout);
  return {};
}

Result<void> IioCapture::set_rate(Rate rate) {
  const IioDevice& device = *device_;
  // A trigger with a rate has its own file; the device's own trigger uses the device's rate.
  std::string file;
  const std::string of_trigger = trigger_folder_ + "/sampling_frequency";
  const bool is_triggers = !trigger_folder_.empty() && ::access(of_trigger.c_str(), F_OK) == 0;
  if (is_triggers) {
    file = of_trigger;
  } else if (trigger_.empty() || trigger_.starts_with(device.name() + "-") || rate) {
    for (const char* name : {"sampling_frequency", "in_sampling_frequency", "buffer/sampling_frequency"}) {
      if (!device.has_attribute(name)) continue;
      file = device.folder() + "/" + name;
      break;
    }
    if (file.empty()) {  // some have one for each type
      for (const IioChannel& channel : device.channels()) {
        const IioQuantity* quantity = iio_quantity(channel.name);
        if (quantity == nullptr || channel.index < 0) continue;
        const std::string name = "in_" + std::string(quantity->type) + "_sampling_frequency";
        if (!device.has_attribute(name)) continue;
        file = device.folder() + "/" + name;
        break;
      }
    }
  }
  if (file.empty()) {
    if (!rate) return {};
    return Error{Errc::bad_argument, cannot_capture, device.text(),
                 "neither the device nor its trigger has a rate to set",
                 trigger_.empty() ? "give it a `trigger` that has one"
                                  : "remove `rate`: trigger " + trigger_ + " has no rate to set"};
  }
  const auto number = [&]() -> double {
    const auto text = detail::read_kernel_file(file, cannot_capture);
    if (!text) return 0;
    const double value = std::strtod(text->c_str(), nullptr);
    return std::isfinite(value) && value > 0 ? value : 0;
  };
  if (rate) {
    std::string wanted = std::to_string(rate.hertz());
    const auto is_set = [&] { return std::abs(number() / rate.hertz() - 1) < 0.01; };
    Result<void> done = detail::write_kernel_file(file, wanted, cannot_capture);
    if (!done && rate.hertz() == std::floor(rate.hertz()))  // some take whole numbers only
      done = detail::write_kernel_file(file, wanted.substr(0, wanted.find('.')), cannot_capture);
    if (!done || !is_set()) {
      const auto available = device.attribute("sampling_frequency_available");
      const double now = number();
      return Error{
          Errc::out_of_range, cannot_capture, file,
          hertz(rate.hertz()) + " was refused" +
              (now > 0 && done ? ": the rate is " + hertz(now) : std::string(done ? "" : ": " + done.error().why)),
          available ? "choose one of its rates: " + *available : "change `rate`"};
    }
  }
  frequency_ = number();
  return {};
}

Result<void> IioCapture::enable(const IioCaptureConfig& config) {
  const IioDevice& device = *device_;
  if (device.has_attribute("buffer/length")) {
    if (auto done = device.set_attribute("buffer/length", std::to_string(config.length)); !done) return done;
  }
  if (device.has_attribute("buffer/watermark")) {  // kernels before 4.2 have none: each scan wakes
    if (auto done = device.set_attribute("buffer/watermark", std::to_string(config.watermark)); !done) return done;
  }
  const auto on = device.set_attribute("buffer/enable", "1");
  if (on) {
    is_on_ = true;
    return {};
  }
  Error error = on.error();
  error.what = cannot_capture;
  if (error.code == Errc::busy) {
    error.why = "another program or kernel driver uses the device";
    error.advice = "`sudo fuser -v " + device.node() + "` names a program";
  } else if (device.has_attribute("trigger/current_trigger") && trigger_.empty()) {
    error.why = "it has no trigger (" + error.why + ")";
    error.advice = "set `trigger`: docs/iio.md";
  } else {
    error.advice = "`dmesg` may say why";
  }
  return error;
}

Result<std::size_t> IioCapture::read(std::span<std::byte> to) {
  const std::size_t size = layout_.size();
  const ssize_t got = ::read(fd_, to.data(), to.size() / size * size);
  if (got > 0) return static_cast<std::size_t>(got);
  const int number = got < 0 ? errno : ENODEV;
  if (number == EAGAIN || number == EINTR) return std::size_t{0};
  if (number == ENODEV) {
    return Error{Errc::disconnected, "lost the IIO device", device_->text(), "the device is gone",
                 "check its wires; it is opened again when it is back"};
  }
  return system_error(number, "lost the IIO device", device_->text(), "it is opened again");
}

}  // namespace rtdata
