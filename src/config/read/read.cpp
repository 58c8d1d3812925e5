#include "rtdata/config/read.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "config/read/limits_text.hpp"
#include "config/read/mistakes.hpp"
#include "config/read/parameter_table.hpp"
#include "data/listed.hpp"
#include "data/name.hpp"
#include "data/permissions.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::config_detail {
namespace {

bool out_of_range(const ConfigItem& item, const std::string& value, const std::string& range, Problems& problems) {
  problems.add(item.problem("out-of-range", value + " is out of range: " + range));
  return false;
}

bool within(double value, const ParameterRules& rules) {
  return !(rules.has_least && value < rules.least) && !(rules.has_most && value > rules.most);
}

std::string range_of(const ParameterRules& rules, ParameterType::Kind kind) {
  return range_text(rules.has_least ? std::optional(rules.least) : std::nullopt,
                    rules.has_most ? std::optional(rules.most) : std::nullopt, kind, rules.unit);
}

/// Why the text breaks the rule of its kind; empty: it does not.
/// COM3, com12
bool is_windows_port(std::string_view text) {
  if (text.size() < 4 || text.size() > 6) return false;
  return (text[0] | 0x20) == 'c' && (text[1] | 0x20) == 'o' && (text[2] | 0x20) == 'm' &&
         text.find_first_not_of("0123456789", 3) == std::string_view::npos;
}

std::string mistake_in(std::string_view text, TextIs is) {
  switch (is) {
    case TextIs::permissions:
      return detail::permissions_of(text) ? "" : detail::permissions_rule;
    case TextIs::anything:
    case TextIs::recorded:
    case TextIs::unit:  // a unit that is not UCUM is a warning
      return "";
    case TextIs::name:
      return detail::is_name(text) ? "" : detail::name_rule;
    case TextIs::field: {
      const auto is_good = [](char c) {
        return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_';
      };
      const bool starts_well = !(text.front() >= '0' && text.front() <= '9');
      return starts_well && std::all_of(text.begin(), text.end(), is_good)
                 ? ""
                 : "a field name has letters, digits and underscores and does not start with a digit";
    }
    case TextIs::topic:
      if (!is_topic_name(text)) return topic_advice(text);
      return text.starts_with("$") ? "topics that begin with $ are reserved for the library" : "";
    case TextIs::topic_pattern:
      return is_topic_pattern(text) ? ""
                                    : "\"" + std::string(text) +
                                          "\" is not a topic or pattern: levels joined by /, + for one level, # at the "
                                          "end for all below";
    case TextIs::output_file:
      if (detail::has_control(text))
        return "the path of a written file must have no control characters: it is shown as a name";
      [[fallthrough]];
    case TextIs::device:
      if (text == "~" || text.starts_with("~/")) {
        const char* const home = std::getenv("HOME");
        return "only a shell expands ~, this program does not: write \"" +
               std::string(home != nullptr && *home == '/' ? home : "/home/pi") + std::string(text.substr(1)) + "\"";
      }
      if (is == TextIs::device && is_windows_port(text))
        return "\"" + std::string(text) +
               "\" is a Windows name; here a serial device has a name such as /dev/ttyUSB0 or /dev/ttyACM0: `rtdata "
               "scan` "
               "lists them";
      if (text.find('\0') != std::string_view::npos) return "a path cannot have a NUL byte";
      return text.size() < 4096 ? "" : "a path must have less than 4096 bytes";
  }
  return "";
}

bool is_recorded(TextIs is) {
  switch (is) {
    case TextIs::recorded:
    case TextIs::name:
    case TextIs::field:
    case TextIs::topic:
    case TextIs::topic_pattern:
    case TextIs::unit:
      return true;
    default:
      return false;
  }
}

bool is_name_of_something(TextIs is) {
  return is == TextIs::name || is == TextIs::field || is == TextIs::topic || is == TextIs::topic_pattern;
}

/// A key that is often written in the wrong place, or is another word for a known key; tried in this order. `known`: a
/// key of this item that is meant, or that shows the kind of item.
struct Elsewhere {
  std::string_view keys, known, advice;
};
constexpr std::string_view in_process =
    "it belongs in `process`, below the field's name: {\"process\": "
    "{\"temperature\": {\"calibration\": {\"offset\": 0.5}}}}";
constexpr std::string_view in_filters =
    "filters belong in `process`, below the field's name: {\"process\": "
    "{\"temperature\": {\"filters\": [{\"type\": \"median\", \"of\": 5}]}}}";
constexpr std::string_view on_bus =
    "a chip names its bus with `bus`, and the bus names its device: {\"buses\": "
    "{\"i2c1\": {\"type\": \"i2c\", \"device\": \"/dev/i2c-1\"}}}";
constexpr std::string_view as_rate = "set how often it is read with `rate`, such as \"10 Hz\" or \"1/min\"";
constexpr std::string_view as_path = "the file is named by `path`";
constexpr std::string_view as_line = "the GPIO line is named by `line`: its number, its name, or chip:line";
constexpr std::string_view of_sensor = "it belongs to the sensor that is on this bus";
constexpr Elsewhere elsewhere[] = {
    {"rate", "max_line", "a serial line takes every line that comes: it has no rate"},
    {"calibration scale offset polynomial calibrate tare", "process", in_process},
    {"filters filter median mean average throttle delta clamp window", "process", in_filters},
    {"pin gpio", "line", as_line},
    {"pin", "lines", "the GPIO lines are listed in `lines`"},
    {"device port", "bus", on_bus},
    {"port", "device", "the device is named by `device`"},
    {"bus", "device", "it is not on a bus: the kernel's device is named by `device`"},
    {"interval period frequency every sampling_rate", "rate", as_rate},
    {"file filename", "path", as_path},
    {"topic", "topics", "a sink has `topics`, a list of patterns such as [\"room/+\"]"},
    {"timeout speed", "bus", "it belongs to the bus, in `buses`"},
    {"address chip_select", "device", of_sensor},
};

/// Null: nothing is known of the key.
const Elsewhere* place_elsewhere(std::string_view key, const std::vector<std::string>& names) {
  const std::string word = " " + std::string(key) + " ";
  for (const Elsewhere& one : elsewhere)
    if ((" " + std::string(one.keys) + " ").find(word) != std::string::npos &&
        std::find(names.begin(), names.end(), one.known) != names.end())
      return &one;
  return nullptr;
}

}  // namespace

bool read_text(const ConfigItem& item, std::string& out, const RulesOf& parameter, Problems& problems) {
  if (const auto choices = parameter.choices(); !choices.empty()) {
    const int index = choose(item, names_among(choices), problems);
    if (index >= 0) out = choices[static_cast<std::size_t>(index)].text;
    return index >= 0;
  }
  const ParameterRules& rules = parameter.rules;
  if (is_secret_reference(item)) {
    if (rules.text == TextIs::permissions) {
      problems.add(item.problem("not-a-secret", "permissions are not secret: write them as they are"));
      return false;
    }
    if (is_recorded(rules.text)) {
      problems.add(item.problem("not-a-secret", "recordings hold this text: write it as it is"));
      return false;
    }
    if (!resolve_secret(item, out, problems)) return false;
  } else if (!ConfigValue<std::string>::read(item, out, problems)) {
    return false;
  }
  std::string mistake;
  if (!out.empty()) {
    mistake = mistake_in(out, rules.text);
  } else if (rules.text == TextIs::topic_pattern || rules.text == TextIs::permissions) {
    mistake = mistake_in(out, rules.text);
  } else if (rules.required) {
    mistake = rules.text == TextIs::output_file ? "the path is empty; name a file"
              : rules.text == TextIs::name      ? detail::name_rule
                                                : "it is empty, and must not be";
  }
  if (mistake.empty()) return true;
  problems.add(item.problem(is_name_of_something(rules.text) ? "bad-name" : "bad-value", std::move(mistake)));
  return false;
}

bool check_number(const ConfigItem& item, double value, const ParameterRules& rules, Problems& problems) {
  if (rules.not_zero && value == 0) {
    problems.add(item.problem("out-of-range", "it must not be 0"));
    return false;
  }
  if (within(value, rules)) return true;
  std::string text = item.number_text();
  if (!rules.unit.empty()) text.append(" ").append(rules.unit);
  return out_of_range(item, text, range_of(rules, ParameterType::Kind::number), problems);
}

bool check_duration(const ConfigItem& item, Duration value, const ParameterRules& rules, Problems& problems) {
  if (value < Duration::zero() && !rules.negative)
    return out_of_range(item, to_string(value), "it must not be negative", problems);
  if (within(static_cast<double>(value.count()), rules)) return true;
  return out_of_range(item, *item.as_string(), range_of(rules, ParameterType::Kind::duration), problems);
}

bool check_rate(const ConfigItem& item, Rate value, const ParameterRules& rules, Problems& problems) {
  // A rate is stored as its period in ns, so the limits are compared as periods; both ends belong to the range.
  ParameterRules rounded = rules;
  if (rules.has_least && rules.least > 0) rounded.least = Rate::hertz(rules.least).hertz();
  if (rules.has_most && rules.most > 0) rounded.most = Rate::hertz(rules.most).hertz();
  if (within(value.hertz(), rounded)) return true;
  return out_of_range(item, *item.as_string(), range_of(rules, ParameterType::Kind::rate), problems);
}

int choose(const ConfigItem& item, const std::vector<std::string>& names, Problems& problems) {
  const std::string* text = item.as_string();
  if (text == nullptr) {
    problems.add(item.problem("wrong-type", "expected one of " + detail::listed(names) + ", got " + item.describe()));
    return -1;
  }
  const auto found = std::find(names.begin(), names.end(), *text);
  if (found != names.end()) return static_cast<int>(found - names.begin());
  problems.add(item.problem("unknown-choice", "expected one of " + detail::listed(names) + ", got " + item.describe(),
                            nearest_name(*text, names)));
  return -1;
}

bool read_choice(const ConfigItem& item, std::span<const Word> choices, std::int64_t& out, Problems& problems) {
  const int index = choose(item, names_among(choices), problems);
  if (index >= 0) out = choices[static_cast<std::size_t>(index)].value;
  return index >= 0;
}

void write_choice(std::int64_t value, std::span<const Word> choices, ConfigItem& item) {
  for (const Word& choice : choices)
    if (choice.value == value) item.set(choice.text);
}

bool check_keys(const ConfigItem& item, const std::vector<KnownKey>& known, UnknownKeys unknown, Problems& problems) {
  const std::vector<std::string> present = item.keys();
  const auto is_present = [&](std::string_view key) {
    return std::find(present.begin(), present.end(), key) != present.end();
  };
  std::vector<std::string> names;
  std::vector<std::string> absent;
  for (const KnownKey& entry : known) {
    names.emplace_back(entry.key);
    if (!is_present(entry.key)) absent.emplace_back(entry.key);
  }
  std::sort(names.begin(), names.end());

  bool good = true;
  std::vector<std::string> meant;  // keys that are present but misspelt are not reported as missing too
  for (const ConfigChild& child : item.children()) {
    if (unknown == UnknownKeys::ignore || std::binary_search(names.begin(), names.end(), child.key)) continue;
    if (const Elsewhere* place = place_elsewhere(child.key, names)) {
      meant.emplace_back(place->known);
      Problem problem = child.item.problem("unknown-key", "unknown key here: " + std::string(place->advice));
      problem.place = child.item.key_place();
      problems.add(std::move(problem));
      good = false;
      continue;
    }
    std::string suggestion = nearest_name(child.key, absent);
    if (!suggestion.empty()) meant.push_back(suggestion);
    if (suggestion.empty()) suggestion = nearest_name(child.key, names);
    std::string message = "unknown key";
    if (suggestion.empty() && !names.empty()) message += "; known here are " + detail::listed(names);
    Problem problem = child.item.problem("unknown-key", std::move(message), std::move(suggestion));
    problem.place = child.item.key_place();
    problems.add(std::move(problem));
    good = false;
  }
  for (const KnownKey& entry : known) {
    if (!entry.required || is_present(entry.key) || std::find(meant.begin(), meant.end(), entry.key) != meant.end())
      continue;
    std::string message = "\"";
    message.append(entry.key).append("\" is missing");
    if (!entry.doc.empty()) message.append(": ").append(entry.doc);
    problems.add(item.problem("missing-key", std::move(message)));
    good = false;
  }
  return good;
}

}  // namespace rtdata::config_detail
