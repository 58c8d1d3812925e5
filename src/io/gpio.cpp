// GPIO lines: finding a line by name, reading and setting it.
#include "rtdata/io/gpio.hpp"

#include <algorithm>
#include <cerrno>
#include <charconv>

#include "data/nearest.hpp"
#include "io/gpio_failure.hpp"
#include "io/gpio_lookup.hpp"
#include "rtdata/data/config_item.hpp"

namespace rtdata {

bool ConfigValue<GpioLineName>::read(const ConfigItem& item, GpioLineName& out, Problems& problems) {
  if (item.kind() == ConfigItem::Kind::string) {
    if (!ConfigValue<std::string>::read(item, out.text, problems)) return false;
    if (!out.text.empty()) return true;
    problems.add(item.problem("bad-value", R"(the line has no name: such as "GPIO17", 17 or "gpiochip0:17")"));
    return false;
  }
  unsigned number = 0;
  if (!ConfigValue<unsigned>::read(item, number, problems)) return false;
  out = GpioLineName(number);
  return true;
}

namespace {

constexpr const char* cannot_use_line = "cannot use the GPIO line";
constexpr const char* list_advice = "`rtdata scan` lists the chips and their lines";

struct Place {
  std::string path;  // path of the chip's device file
  unsigned number = 0;
  GpioLineInfo line;
  std::string text() const {
    const std::string name = line.name.empty() ? "" : " (" + line.name + ")";
    return path.substr(path.rfind('/') + 1) + ":" + std::to_string(number) + name;
  }
};

std::string base_of(std::string_view path) { return std::string(path.substr(path.rfind('/') + 1)); }

bool is_named(const GpioChipInfo& chip, std::string_view name) {
  return name == chip.path || name == base_of(chip.path) || (!chip.label.empty() && name == chip.label);
}

std::string chips_listed(const std::vector<GpioChipInfo>& chips) {
  std::string text;
  for (const GpioChipInfo& chip : chips) {
    text += (text.empty() ? "" : ", ") + base_of(chip.path) + " (";
    text += chip.error_number != 0 ? system_error(chip.error_number, "", "").why
                                   : chip.label + ", " + std::to_string(chip.lines.size()) + " lines";
    text += ")";
  }
  return text;
}

/// Empty: it is not a number.
std::optional<unsigned> number_of(std::string_view text) {
  unsigned number = 0;
  const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (status != std::errc{} || end != text.data() + text.size() || text.empty()) return {};
  return number;
}

class Finder {
 public:
  Finder(std::vector<GpioChipInfo> chips, const GpioLineName& line, const std::string& chip)
      : chips_(std::move(chips)), line_(line.text), chip_(chip) {
    // A name may contain a colon: the part before it is a chip only if a chip has that name.
    const std::size_t colon = line_.rfind(':');
    if (!chip_.empty() || colon == std::string::npos || colon == 0 || colon + 1 == line_.size()) return;
    const std::string_view before = std::string_view(line_).substr(0, colon);
    const bool is_chip = std::any_of(chips_.begin(), chips_.end(),
                                     [&](const GpioChipInfo& one) { return is_named(one, before); });
    if (!is_chip && !before.starts_with("gpiochip") && !before.starts_with("/dev/")) return;
    chip_ = before;
    line_.erase(0, colon + 1);
  }

  Result<Place> find() const {
    if (chips_.empty())
      return error(Errc::not_found, "this machine has no GPIO chip", "check with `ls /dev/gpiochip*`");
    std::vector<const GpioChipInfo*> among;
    for (const GpioChipInfo& one : chips_)
      if (chip_.empty() || is_named(one, chip_)) among.push_back(&one);
    if (among.empty())
      return error(Errc::not_found, "there is no chip " + chip_ + "; available: " + chips_listed(chips_),
                   "set `chip` to one of these");
    if (among.size() > 1 && !chip_.empty())
      return error(Errc::bad_argument, "several chips are called " + chip_ + ": " + chips_listed(chips_),
                   "set `chip` to the name of its file");
    for (const GpioChipInfo* one : among) {
      if (one->error_number == 0 || (among.size() > 1 && one->error_number != EACCES && one->error_number != EPERM))
        continue;
      Error refused = system_error(one->error_number, cannot_use_line, where() + ", " + one->path);
      if (refused.code == Errc::not_permitted)
        refused.advice = "join the group that may use the chip: `ls -l " + one->path +
                         "` shows it; `sudo usermod -aG gpio $USER`, then log in again";
      return refused;
    }
    if (const auto number = number_of(line_)) return by_number(*number, among);
    return by_name(among);
  }

 private:
  std::string where() const { return "line " + line_; }
  Error error(Errc code, std::string why, std::string advice) const {
    return {code, cannot_use_line, where(), std::move(why), std::move(advice)};
  }
  Result<Place> by_number(unsigned number, const std::vector<const GpioChipInfo*>& among) const {
    if (among.size() > 1)
      return error(Errc::bad_argument, "there are several chips, and each has its own numbers: " + chips_listed(chips_),
                   "set `chip` to one of these, or name the line");
    const GpioChipInfo& chip = *among.front();
    if (number >= chip.lines.size())
      return error(Errc::not_found, base_of(chip.path) + " has the lines 0 to " + std::to_string(chip.lines.size() - 1),
                   list_advice);
    return Place{chip.path, number, chip.lines[number]};
  }
  Result<Place> by_name(const std::vector<const GpioChipInfo*>& among) const {
    std::optional<Place> found;
    std::string places;
    bool is_ambiguous = false;
    std::vector<std::string_view> names;
    for (const GpioChipInfo* chip : among) {
      for (std::size_t i = 0; i < chip->lines.size(); ++i) {
        if (!chip->lines[i].name.empty()) names.push_back(chip->lines[i].name);
        if (chip->lines[i].name != line_) continue;
        places += (found ? ", " : "") + base_of(chip->path) + ":" + std::to_string(i);
        if (!found) {
          found = Place{chip->path, static_cast<unsigned>(i), chip->lines[i]};
        } else {
          is_ambiguous = true;
        }
      }
    }
    if (!found) {
      std::string hint = detail::suggestion(line_, names);
      return error(
          Errc::not_found,
          names.empty() ? "the lines of this machine have no names: " + chips_listed(chips_) : "no line has this name",
          names.empty() ? "give its number, such as \"gpiochip0:17\"" : hint + "; " + list_advice);
    }
    if (is_ambiguous)
      return error(Errc::bad_argument, "several lines have this name: " + places, "write one of these instead");
    return *std::move(found);
  }

  const std::vector<GpioChipInfo> chips_;
  std::string line_;
  std::string chip_;
};

}  // namespace

Result<detail::FoundLine> detail::find_gpio_line(std::vector<GpioChipInfo> chips, const GpioLineName& line,
                                                 const std::string& chip) {
  Result<Place> found = Finder(std::move(chips), line, chip).find();
  if (!found) return found.error();
  return FoundLine{found->text(), found->line};
}

namespace {

Error refusal_of(int error_number, GpioBackend& backend, const Place& place) {
  switch (error_number) {
    case EBUSY: {
      std::string who = place.line.consumer;
      for (const GpioChipInfo& chip : backend.chips())  // another program may have just taken it
        if (chip.path == place.path && place.number < chip.lines.size()) who = chip.lines[place.number].consumer;
      return {Errc::busy, cannot_use_line, place.text(),
              who.empty() ? "another program uses it, which gives no name" : "\"" + who + "\" has it",
              "end that program, or use another line; a driver of the kernel is named in the device tree"};
    }
    case EINVAL:
    case ENXIO:
    case EOPNOTSUPP:
    case 524:  // ENOTSUPP, the kernel's own
      return {Errc::bad_argument, cannot_use_line, place.text(), "the chip does not support this",
              "check the chip: some have no resistors (`bias`) or interrupts (edges), or cannot read outputs"};
    default:
      return detail::gpio_failure(error_number, cannot_use_line, place.text());
  }
}

template <class Settings, class Take>
std::unique_ptr<GpioRequest> taken(GpioBackend& backend, const Settings& settings, std::string& place, Error& error,
                                   const Take& take) {
  const Result<Place> found = Finder(backend.chips(), settings.line, settings.chip).find();
  if (!found) {
    error = found.error();
    return nullptr;
  }
  int error_number = 0;
  auto request = take(*found, error_number);
  place = found->text();
  if (request == nullptr) error = refusal_of(error_number, backend, *found);
  return request;
}

}  // namespace

std::unique_ptr<GpioRequest> detail::take_gpio_input(GpioBackend& backend, const GpioInput& settings, bool with_edges,
                                                     std::string& place, Error& error) {
  return taken(backend, settings, place, error, [&](const Place& at, int& error_number) {
    return backend.take_input(at.path, at.number, settings, with_edges, error_number);
  });
}

// ---- GpioLine

GpioLine::GpioLine(std::string place, std::unique_ptr<GpioRequest> request, std::optional<bool> safe, bool is_output)
    : place_(std::move(place)), request_(std::move(request)), safe_(safe), is_output_(is_output) {}

GpioLine GpioLine::input(GpioInput settings, const std::shared_ptr<GpioBackend>& backend) {
  std::string place;
  Error error;
  auto request = detail::take_gpio_input(*backend, settings, false, place, error);
  if (request == nullptr) throw SetupError(std::move(error));
  return {std::move(place), std::move(request), std::nullopt, false};
}

GpioLine GpioLine::output(GpioOutput settings, const std::shared_ptr<GpioBackend>& backend) {
  std::string place;
  Error error;
  auto request = taken(*backend, settings, place, error, [&](const Place& at, int& error_number) {
    return backend->take_output(at.path, at.number, settings, error_number);
  });
  if (request == nullptr) throw SetupError(std::move(error));
  return {std::move(place), std::move(request), settings.safe, true};
}

GpioLine::GpioLine(GpioLine&& other) noexcept
    : place_(std::move(other.place_)),
      request_(std::move(other.request_)),
      safe_(other.safe_),
      is_output_(other.is_output_) {}

GpioLine& GpioLine::operator=(GpioLine&& other) noexcept {
  if (this == &other) return *this;
  close();
  place_ = std::move(other.place_);
  request_ = std::move(other.request_);
  safe_ = other.safe_;
  is_output_ = other.is_output_;
  return *this;
}

Result<bool> GpioLine::read() const {
  if (request_ == nullptr) return Error{Errc::closed, "cannot read the GPIO line", place_, "it is closed", ""};
  const int value = request_->value();
  if (value < 0) return detail::gpio_failure(-value, "cannot read the GPIO line", place_);
  return value != 0;
}

Result<void> GpioLine::set(bool value) {
  constexpr const char* what = "cannot set the GPIO line";
  if (request_ == nullptr) return Error{Errc::closed, what, place_, "it is closed", ""};
  if (!is_output_) return Error{Errc::bad_argument, what, place_, "it is an input", "make it with GpioLine::output"};
  if (const int error_number = request_->set(value); error_number != 0)
    return detail::gpio_failure(error_number, what, place_);
  return {};
}

void GpioLine::close() noexcept {
  if (request_ == nullptr) return;
  if (safe_) request_->set(*safe_);
  request_.reset();
}

}  // namespace rtdata
