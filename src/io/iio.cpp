#include "rtdata/io/iio.hpp"

#include <dirent.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <utility>

#include "data/listed.hpp"
#include "data/nearest.hpp"
#include "data/number_text.hpp"
#include "io/kernel_file.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_find = "cannot find the IIO device";
constexpr const char* cannot_use_device = "cannot use the IIO device";
constexpr std::string_view devices = "/sys/bus/iio/devices";

// The units of Documentation/ABI/testing/sysfs-bus-iio; empty if it names none.
constexpr std::array<IioQuantity, 34> quantities{{
    {"accel", "m/s2", 1, "m/s2"},
    {"activity", "%", 1, "%"},
    {"altvoltage", "V", 1e-3, "mV"},
    {"angl", "rad", 1, "rad"},
    {"anglvel", "rad/s", 1, "rad/s"},
    {"capacitance", "F", 1e-9, "nF"},
    {"concentration", "%", 1, "%"},
    {"count", "", 1, ""},
    {"current", "A", 1e-3, "mA"},
    {"deltaangl", "rad", 1, "rad"},
    {"deltavelocity", "m/s", 1, "m/s"},
    {"distance", "m", 1, "m"},
    {"electricalconductivity", "S/m", 1, "S/m"},
    {"energy", "J", 1, "J"},
    {"gravity", "m/s2", 1, "m/s2"},
    {"humidityrelative", "%", 1e-3, "m%"},
    {"illuminance", "lx", 1, "lx"},
    {"incli", "deg", 1, "deg"},
    {"index", "", 1, ""},
    {"intensity", "", 1, ""},
    {"magn", "T", 1e-4, "Gs"},
    {"massconcentration", "ug/m3", 1, "ug/m3"},
    {"ph", "[pH]", 1, ""},
    {"phase", "rad", 1, "rad"},
    {"positionrelative", "%", 1e-3, "m%"},
    {"power", "W", 1e-3, "mW"},
    {"pressure", "Pa", 1e3, "kPa"},
    {"proximity", "", 1, ""},
    {"resistance", "Ohm", 1, "Ohm"},
    {"rot", "", 1, ""},
    {"steps", "", 1, ""},
    {"temp", "Cel", 1e-3, "mCel"},
    {"uvindex", "", 1, ""},
    {"voltage", "V", 1e-3, "mV"},
}};

bool is_digit(char c) noexcept { return c >= '0' && c <= '9'; }

/// The text after a type: "", "0", "_x", "0-voltage1", "1_vcc".
bool is_rest(std::string_view rest) noexcept {
  if (rest.empty()) return true;
  if (!is_digit(rest.front()) && rest.front() != '_') return false;
  return rest.size() < 64 && rest.back() != '_' && std::all_of(rest.begin(), rest.end(), [](char c) {
           return is_digit(c) || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_' || c == '-';
         });
}

std::optional<unsigned> number_of_folder(std::string_view name) {
  constexpr std::string_view prefix = "iio:device";
  unsigned number = 0;
  if (!name.starts_with(prefix) || detail::read_number(name.substr(prefix.size()), number) != std::errc{}) return {};
  return number;
}

std::string last_part(const std::string& path) { return path.substr(path.rfind('/') + 1); }

}  // namespace

const IioQuantity* iio_quantity(std::string_view channel) noexcept {
  for (auto one = quantities.rbegin(); one != quantities.rend(); ++one) {  // the longer of two comes first
    if (channel.starts_with(one->type) && is_rest(channel.substr(one->type.size()))) return &*one;
  }
  return nullptr;
}

std::span<const IioQuantity> iio_quantities() noexcept { return quantities; }

std::size_t iio_values(std::string_view channel) noexcept { return channel == "rot_quaternion" ? 4 : 1; }

// ---- finding

Result<IioDevice> IioDevice::find(const std::string& which, const std::string& root) {
  const std::string where = which.empty() ? root + std::string(devices) : which;
  std::vector<IioDevice> found;
  std::vector<std::string> known;
  unsigned number = 0;
  const bool is_path = which.starts_with('/');
  std::string last = last_part(which);
  if (is_path && !number_of_folder(last)) {
    const std::unique_ptr<char, decltype(&std::free)> real(::realpath((root + which).c_str(), nullptr), &std::free);
    if (real != nullptr) last = last_part(real.get());
  }
  const auto wanted = detail::read_number(which, number) == std::errc{} ? std::optional(number)
                                                                        : number_of_folder(last);
  for (IioDevice& device : all(root)) {
    known.push_back(device.text());
    const bool is_it = which.empty() || (wanted ? device.number() == *wanted
                                                : !is_path && (device.label() == which || device.name() == which));
    if (is_it) found.push_back(std::move(device));
  }
  if (found.empty()) {
    return Error{Errc::not_found, cannot_find, where,
                 known.empty() ? "this machine has no IIO device" : "available: " + detail::listed(known),
                 "`device` is a name, label, number or path; a driver makes it: `dmesg`, docs/iio.md"};
  }
  if (found.size() > 1) {
    const auto labelled = std::find_if(found.begin(), found.end(),
                                       [&](const IioDevice& one) { return !which.empty() && one.label() == which; });
    if (labelled == found.end()) {
      std::vector<std::string> alike;
      for (const IioDevice& one : found) alike.push_back(one.text());
      return Error{Errc::bad_argument, cannot_find, where, "there are several: " + detail::listed(alike),
                   "name it by its number or label"};
    }
    return std::move(*labelled);
  }
  return std::move(found.front());
}

std::vector<IioDevice> IioDevice::all(const std::string& root) {
  std::vector<IioDevice> found;
  const std::string folder = root + std::string(devices);
  for (const std::string& name : detail::names_in_folder(folder)) {
    const auto number = number_of_folder(name);
    if (!number) continue;
    IioDevice device;
    device.number_ = *number;
    device.root_ = root;
    device.folder_ = folder + "/" + name;
    device.node_ = root + "/dev/" + name;
    device.name_ = device.attribute("name").has_value() ? *device.attribute("name") : "";
    if (device.has_attribute("label")) {
      const auto label = device.attribute("label");
      if (label) device.label_ = *label;
    }
    device.list_channels();
    found.push_back(std::move(device));
  }
  std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.number_ < b.number_; });
  return found;
}

void IioDevice::list_channels() {
  const auto named = [this](const std::string& name) -> IioChannel& {
    for (IioChannel& one : channels_) {
      if (one.name == name) return one;
    }
    const IioQuantity* quantity = iio_quantity(name);
    channels_.push_back({name, quantity != nullptr ? std::string(quantity->unit) : ""});
    return channels_.back();
  };
  const auto middle = [](std::string_view file, std::string_view end) -> std::string {
    if (!file.starts_with("in_") || !file.ends_with(end) || file.size() <= 3 + end.size()) return {};
    return std::string(file.substr(3, file.size() - 3 - end.size()));
  };
  for (const std::string& file : detail::names_in_folder(folder_)) {
    if (const std::string name = middle(file, "_raw"); iio_quantity(name) != nullptr) {
      named(name).is_readable = true;
    } else if (const std::string finished = middle(file, "_input"); iio_quantity(finished) != nullptr) {
      IioChannel& channel = named(finished);
      channel.is_readable = channel.is_processed = true;
    }
  }
  for (const std::string& file : detail::names_in_folder(folder_ + "/scan_elements")) {
    const std::string name = middle(file, "_type");
    if (name != "timestamp" && iio_quantity(name) == nullptr) continue;
    const auto type = attribute("scan_elements/" + file);
    const auto index = number_of("scan_elements/in_" + name + "_index");
    if (!type || !index || !(*index >= 0 && *index < 4096)) continue;
    auto storage = parse_iio_storage(*type);
    if (!storage) continue;  // an unknown kind
    IioChannel& channel = named(name);
    channel.index = static_cast<int>(*index);
    channel.storage = *storage;
    if (name == "timestamp") channel.unit = "ns";
  }
  for (IioChannel& channel : channels_) {
    const std::string file = "in_" + channel.name + "_label";
    if (!has_attribute(file)) continue;
    if (const auto label = attribute(file)) channel.label = *label;
  }
  std::sort(channels_.begin(), channels_.end(), [](const IioChannel& a, const IioChannel& b) {
    const auto key = [](const IioChannel& one) { return one.index < 0 ? 4096 : one.index; };
    return key(a) != key(b) ? key(a) < key(b) : a.name < b.name;
  });
}

std::string IioDevice::text() const {
  std::string called = name_;
  if (!label_.empty() && label_ != name_) called += (called.empty() ? "" : " ") + label_;
  return called.empty() ? last_part(folder_) : called + " (" + last_part(folder_) + ")";
}

const IioChannel* IioDevice::channel(std::string_view name) const noexcept {
  for (const IioChannel& one : channels_) {
    if (one.name == name) return &one;
  }
  return nullptr;
}

Result<IioChannel> IioDevice::channel_or_error(std::string_view name) const {
  if (const IioChannel* one = channel(name)) return *one;
  std::vector<std::string_view> known;
  for (const IioChannel& one : channels_) {
    if (one.name != "timestamp") known.push_back(one.name);
  }
  return Error{Errc::not_found, cannot_use_device, text(), "it has no channel " + std::string(name),
               known.empty() ? "it has no inputs" : detail::suggestion(name, known)};
}

bool IioDevice::has_buffer() const { return has_attribute("buffer/enable") && has_attribute("scan_elements"); }

// ---- attributes

bool IioDevice::has_attribute(const std::string& file) const {
  return ::access((folder_ + "/" + file).c_str(), F_OK) == 0;
}

Result<std::string> IioDevice::attribute(const std::string& file) const {
  return detail::read_kernel_file(folder_ + "/" + file, cannot_use_device);
}

Result<double> IioDevice::number_of(const std::string& file) const {
  const auto text = attribute(file);
  if (!text) return text.error();
  double number = 0;
  if (detail::read_number(*text, number) != std::errc{} || !std::isfinite(number)) {
    return Error{Errc::not_a_number, cannot_use_device, folder_ + "/" + file,
                 "\"" + text->substr(0, 40) + "\" is not a number", ""};
  }
  return number;
}

Result<void> IioDevice::set_attribute(const std::string& file, std::string_view text) const {
  return detail::write_kernel_file(folder_ + "/" + file, text, cannot_use_device);
}

std::string IioDevice::file_of(const IioChannel& channel) const {
  return folder_ + "/in_" + channel.name + (channel.is_processed ? "_input" : "_raw");
}

/// The first existing attribute: of the channel, of its type, or of the device.
std::optional<std::string> IioDevice::first_attribute(const IioChannel& channel, const char* what) const {
  std::vector<std::string> files{"in_" + channel.name + "_" + what};
  if (const IioQuantity* quantity = iio_quantity(channel.name)) {
    const std::string type(quantity->type);
    // All of one modifier ("in_temp_ambient_scale" of "temp_ambient" is above), or with an index before it.
    if (channel.name.find('-') != std::string::npos) files.push_back("in_" + type + "-" + type + "_" + what);
    files.push_back("in_" + type + "_" + what);
  }
  files.push_back(std::string("in_") + what);
  files.emplace_back(what);
  for (const std::string& file : files) {
    if (has_attribute(file)) return file;
  }
  return {};
}

Result<IioConversion> IioDevice::conversion(const IioChannel& channel, bool is_finished) const {
  const IioQuantity* quantity = iio_quantity(channel.name);
  IioConversion conversion{0, quantity != nullptr ? quantity->factor : 1};
  if (is_finished) return conversion;
  if (const auto file = first_attribute(channel, "scale")) {
    const auto scale = number_of(*file);
    if (!scale) return scale.error();
    conversion.scale *= *scale;
  }
  if (const auto file = first_attribute(channel, "offset")) {
    const auto offset = number_of(*file);
    if (!offset) return offset.error();
    conversion.offset = *offset;
  }
  return conversion;
}

Result<IioConversion> IioDevice::conversion(const IioChannel& channel) const {
  return conversion(channel, channel.is_processed);
}
Result<IioConversion> IioDevice::scan_conversion(const IioChannel& channel) const { return conversion(channel, false); }

Result<double> IioDevice::read(const IioChannel& channel) const {
  if (!channel.is_readable) {
    return Error{Errc::not_found, cannot_use_device, text(), "channel " + channel.name + " is in its buffer only", ""};
  }
  const auto conversion = this->conversion(channel);
  if (!conversion) return conversion.error();
  const auto code = number_of(last_part(file_of(channel)));
  if (!code) return code.error();
  return (*code + conversion->offset) * conversion->scale;
}

std::string IioDevice::holder() const { return detail::holder_of(node_); }

}  // namespace rtdata
