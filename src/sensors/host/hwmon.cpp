#include "sensors/host/hwmon.hpp"

#include <algorithm>
#include <cstdlib>
#include <memory>
#include <tuple>
#include <utility>

#include "data/number_text.hpp"
#include "io/kernel_file.hpp"

namespace rtdata::detail {
namespace {

constexpr const char* cannot_read_hwmon = "cannot read a chip of hwmon";

struct Chip {
  std::string folder;  ///< below the root
  std::string number;  ///< "hwmon0"
  std::string name;    ///< as its driver calls it
  std::string parent;  ///< the device of the chip, "1-0048"; empty: none
};

std::string last_part(const std::string& path) { return path.substr(path.rfind('/') + 1); }

/// Empty: there is none.
std::string text_of(const std::string& path) {
  auto text = read_kernel_file(path, cannot_read_hwmon);
  return text ? std::move(*text) : "";
}

unsigned number_in(std::string_view name) {
  unsigned number = 0;
  const auto first = name.find_first_of("0123456789");
  if (first == std::string_view::npos) return 0;
  const auto rest = name.substr(first);
  (void)read_number(rest.substr(0, rest.find_first_not_of("0123456789")), number);
  return number;
}

std::vector<std::string> sorted_names(const std::string& folder) {
  std::vector<std::string> names = names_in_folder(folder);
  std::sort(names.begin(), names.end(), [](const std::string& a, const std::string& b) {
    return std::pair(number_in(a), std::string_view(a)) < std::pair(number_in(b), std::string_view(b));
  });
  return names;
}

std::vector<Chip> chips(const std::string& root) {
  std::vector<Chip> found;
  const std::string all = root + "/sys/class/hwmon/";
  for (const std::string& number : sorted_names(all)) {
    Chip chip{all + number, number, text_of(all + number + "/name"), {}};
    const std::unique_ptr<char, decltype(&std::free)> real(::realpath((chip.folder + "/device").c_str(), nullptr),
                                                           &std::free);
    if (real != nullptr) chip.parent = last_part(real.get());
    found.push_back(std::move(chip));
  }
  return found;
}

/// "temp1" of "temp1_input", when it begins with `prefix` and a number follows. A power may have only a mean.
std::string input_of(const std::string& file, std::string_view prefix, const std::vector<std::string>& files) {
  for (const std::string_view end : {std::string_view("_input"), std::string_view("_average")}) {
    if (!file.starts_with(prefix) || !file.ends_with(end)) continue;
    const std::string input = file.substr(0, file.size() - end.size());
    if (input.size() <= prefix.size() || input.find_first_not_of("0123456789", prefix.size()) != std::string::npos)
      continue;
    if (end == "_average" &&
        (prefix != "power" || std::find(files.begin(), files.end(), input + "_input") != files.end()))
      continue;
    return input;
  }
  return {};
}

/// An input, with all its possible names.
struct Candidate {
  HwmonInput input;
  std::vector<std::string> chip_names;
  std::vector<std::string> names;
};

std::vector<Candidate> candidates(const std::string& root, std::string_view prefix) {
  std::vector<Candidate> found;
  const std::vector<Chip> all = chips(root);
  for (const Chip& chip : all) {
    const auto is_alone = [&](std::string Chip::*name) {
      return !(chip.*name).empty() &&
             std::count_if(all.begin(), all.end(), [&](const Chip& other) { return other.*name == chip.*name; }) == 1;
    };
    // The number changes from start to start.
    const std::string& stable = is_alone(&Chip::name) ? chip.name : is_alone(&Chip::parent) ? chip.parent : chip.number;
    const std::vector<std::string> files = sorted_names(chip.folder);
    for (const std::string& file : files) {
      const std::string input = input_of(file, prefix, files);
      if (input.empty()) continue;
      const std::string label = text_of(chip.folder + "/" + input + "_label");
      HwmonInput one{stable + "/" + input, chip.name + (label.empty() ? "" : " " + label), chip.folder + "/" + file};
      for (const std::string& other : files) {
        if (other == input + "_fault") one.fault = chip.folder + "/" + other;
        if (other.starts_with(input + "_") && other.ends_with("_alarm"))
          one.alarms.push_back(chip.folder + "/" + other);
      }
      found.push_back({std::move(one), {chip.number, chip.name, chip.parent}, {input, label}});
    }
  }
  return found;
}

bool has(const std::vector<std::string>& names, const std::string& name) {
  return !name.empty() && std::find(names.begin(), names.end(), name) != names.end();
}

}  // namespace

std::vector<HwmonInput> hwmon_inputs(const std::string& root, std::string_view prefix) {
  std::vector<HwmonInput> found;
  for (Candidate& one : candidates(root, prefix)) found.push_back(std::move(one.input));
  return found;
}

Result<HwmonInput> find_hwmon(const std::string& root, std::string_view prefix, const std::string& device) {
  const std::size_t slash = device.find('/');
  const std::string chip = device.substr(0, slash);
  const std::string name = slash == std::string::npos ? "" : device.substr(slash + 1);
  std::vector<HwmonInput> found;
  std::string all, alike;
  const auto add = [](std::string& list, const HwmonInput& one) {
    list += (list.empty() ? "" : ", ") + one.device + (one.name.empty() ? "" : " (" + one.name + ")");
  };
  for (Candidate& one : candidates(root, prefix)) {
    add(all, one.input);
    const bool is_chip = device.empty() || has(one.chip_names, chip);
    if (!is_chip || (slash != std::string::npos && !has(one.names, name))) continue;
    add(alike, one.input);
    found.push_back(std::move(one.input));
  }
  if (found.size() == 1) return std::move(found.front());
  const std::string where = root + "/sys/class/hwmon" + (device.empty() ? "" : ": " + device);
  if (found.empty()) {
    return Error{Errc::not_found, cannot_read_hwmon, where,
                 all.empty() ? "this machine has no hwmon sensors" : "available: " + all,
                 "load the driver of the chip (`sensors-detect` finds it); `rtdata scan` lists the sensors"};
  }
  return Error{Errc::bad_argument, cannot_read_hwmon, where, "there are several: " + alike,
               "set `device` to one of them"};
}

}  // namespace rtdata::detail
