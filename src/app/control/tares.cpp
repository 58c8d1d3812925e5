#include "app/control/tares.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <variant>

#include "app/core/calibration_text.hpp"
#include "app/core/replaced_file.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/config/read.hpp"
#include "rtdata/data/value.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::app {
namespace {

constexpr Duration of_a_tare = std::chrono::seconds{1};
constexpr Duration longest_wait = std::chrono::milliseconds{2500};  // for a first value
constexpr Duration writing_limit = std::chrono::seconds{1};
constexpr int digits_of_a_tare = 10;

/// The numbers of a calibration, without tare and version.
std::string numbers_of(Calibration calibration) {
  calibration.tare = 0;
  calibration.version.clear();
  return write_config(calibration).to_json(ConfigItem::Layout::one_line);
}

ConfigItem* child_of(ConfigItem& item, std::string_view key) {
  for (const ConfigChild& child : item.children())
    if (child.key == key) return const_cast<ConfigItem*>(&child.item);
  return nullptr;
}

/// The calibration of a sensor's item, which has no mistakes.
Processing processing_of(const ConfigItem& sensor) {
  Processing processing;
  const ConfigItem* const all = sensor.find("process");
  if (all == nullptr) return processing;
  for (const auto& [field, item] : all->children()) processing.emplace(field, read_config<FieldProcessing>(item));
  return processing;
}

[[noreturn]] void refuse(const std::string& where, std::string why, std::string advice) {
  throw SetupError({Errc::bad_argument, "cannot take a tare", where, std::move(why), std::move(advice)});
}

}  // namespace

Tares::Tares(std::string file, const std::string& configuration) : file_(std::move(file)) {
  std::error_code none;
  configuration_ = std::filesystem::weakly_canonical(configuration, none).string();
  if (configuration_.empty()) configuration_ = configuration;
  if (!std::filesystem::exists(file_, none)) return;
  try {
    if (!std::filesystem::is_regular_file(file_, none)) throw std::runtime_error("it is not a regular file");
    std::ifstream in(file_);
    std::ostringstream text;
    text << in.rdbuf();
    const ConfigItem root = parse_config(text.str()).or_throw();
    const auto of = root.at("configuration").get<std::string>();
    if (of != configuration_) {
      unreadable_ = "they are those of " + of;
      return;
    }
    for (const auto& [sensor, fields] : root.at("tares").children())
      for (const auto& [field, tare] : fields.children())
        all_[{sensor, field}] = {tare.at("of").get<std::string>(), tare.at("tare").get<double>()};
  } catch (const std::exception& error) {
    unreadable_ = detail::reason_of(error);
    all_.clear();
  }
}

std::string Tares::put_into(ConfigItem& root, Problems& warnings) const {
  std::string taken;
  if (!unreadable_.empty())
    warnings.add("cannot-read", {file_, 0, 0}, "", "the tares in " + file_ + " are not used: " + unreadable_);
  ConfigItem* const sensors = child_of(root, "sensors");
  if (sensors == nullptr) return taken;
  for (const ConfigChild& child : sensors->children()) {
    const std::string of_sensor = put_into_sensor(const_cast<ConfigItem&>(child.item), warnings);
    if (!of_sensor.empty()) taken += (taken.empty() ? "" : ", ") + of_sensor;
  }
  return taken;
}

std::string Tares::put_into_sensor(ConfigItem& sensor, Problems& warnings) const {
  std::string taken;
  const ConfigItem* const name = child_of(sensor, "name");
  if (name == nullptr || name->as_string() == nullptr) return taken;
  ConfigItem* const process = child_of(sensor, "process");
  const std::lock_guard lock(mutex_);
  for (const auto& [key, tare] : all_) {
    if (key.first != *name->as_string()) continue;
    ConfigItem* const field = process == nullptr ? nullptr : child_of(*process, key.second);
    ConfigItem* const item = field == nullptr ? nullptr : child_of(*field, "calibration");
    if (!tare.value) {
      if (item != nullptr) item->remove("tare");
      continue;
    }
    Calibration calibration;
    Problems mistakes;
    if (item != nullptr && read_config(*item, calibration, mistakes) && numbers_of(calibration) == tare.of) {
      item->set("tare", *tare.value);
      taken += (taken.empty() ? "" : ", ") + key.first + "." + key.second + " " + number_text(*tare.value);
      continue;
    }
    if (!mistakes.empty()) continue;  // they are reported
    warnings.add(sensor.problem(
        "no-effect", "its tare, " + number_text(*tare.value) + " of " + key.second +
                         ", is not used, because that calibration has changed; take another with `rtdata ctl "
                         "tare`"));
  }
  return taken;
}

std::string Tares::set(const std::string& sensor, const std::string& field, const Calibration& of,
                       std::optional<double> tare) {
  const std::lock_guard lock(mutex_);
  all_[{sensor, field}] = {numbers_of(of), tare};
  ConfigItem tares = ConfigItem::object();
  for (const auto& [key, one] : all_) {
    if (!one.value) continue;
    if (child_of(tares, key.first) == nullptr) tares.set(key.first, ConfigItem::object());
    ConfigItem item = ConfigItem::object();
    item.set("tare", *one.value);
    item.set("of", one.of);
    child_of(tares, key.first)->set(key.second, item);
  }
  ConfigItem root = ConfigItem::object();
  root.set("configuration", configuration_);
  root.set("tares", tares);
  return root.to_json() + "\n";
}

struct TareDesk::Taking {
  std::string sensor, field;
  Processing processing = {};
  Calibration calibration = {};  // without a tare
  Told told = {};
  Duration waited{0};
  std::size_t count = 0;
  double sum = 0;
  Subscription heard = {};
  Timer timer = {};
};

/// Writes the file on the lane.
struct TareDesk::Writing final : detail::LaneJob {
  Writing(std::string file, std::string text, std::weak_ptr<Told> told)
      : file_(std::move(file)), text_(std::move(text)), told_(std::move(told)) {}
  void run() noexcept override try {
    if (const Result<void> written = replace_file(file_, text_); !written) failed_ = written.error().text();
  } catch (...) {
    failed_ = "no memory";
  }
  void done(Outcome outcome) override {
    const auto told = told_.lock();
    if (told == nullptr) return;
    if (outcome != Outcome::finished) return (*told)(false, file_ + " was not written in " + to_string(writing_limit));
    (*told)(failed_.empty(), failed_);
  }

 private:
  const std::string file_, text_;
  const std::weak_ptr<Told> told_;
  std::string failed_;
};

TareDesk::TareDesk(Loop& loop, System& system, Tares& tares)
    : loop_(loop), system_(system), tares_(tares), lane_(loop.core(), "tares", writing_limit) {}

TareDesk::~TareDesk() = default;

void TareDesk::run(const std::vector<std::string>& words, Told told) {
  const std::string& word = words[1];
  if (words.size() > 2 && words[2] != "--clear")
    refuse(word, "\"" + words[2] + "\" is not known", "write `tare SENSOR[.FIELD] --clear` to remove the tare");
  const PartPlan* plan = nullptr;
  for (const PartPlan* one : system_.parts().plans()) {
    const bool is_meant = one->kind == "sensor" && (word == one->name || word.starts_with(one->name + "."));
    if (is_meant && (plan == nullptr || plan->name.size() < one->name.size())) plan = one;
  }
  if (plan == nullptr) (void)system_.sensor(word);  // throws with the nearest name
  ConfigItem item = plan->item;
  Problems ignored;
  tares_.put_into_sensor(item, ignored);
  const auto taking = std::make_shared<Taking>(Taking{plan->name, {}, processing_of(item)});
  std::string& field = taking->field;
  if (word.size() > plan->name.size()) field = word.substr(plan->name.size() + 1);
  std::string calibrated_fields;
  std::size_t number = 0;
  for (const auto& [path, what] : taking->processing) {
    if (!what.calibration) continue;
    calibrated_fields += (number++ == 0 ? "" : ", ") + path;
    if (word.size() == plan->name.size()) field = path;
  }
  const auto what = taking->processing.find(field);
  if (number > 1 && word.size() == plan->name.size())
    refuse(plan->object(), "several of its fields have a calibration: " + calibrated_fields,
           "name one, such as " + plan->name + "." + field);
  if (what == taking->processing.end() || !what->second.calibration)
    refuse(plan->object(), field.empty() ? "none of its fields has a calibration" : field + " has no calibration",
           "give it one in the configuration, at least `\"process\": {\"" + (field.empty() ? "value" : field) +
               "\": {\"calibration\": {}}}`");
  if (plan->publishes->description != nullptr && plan->publishes->description->find(field + ".raw") == nullptr)
    refuse(plan->object(), field + " stands for several numbers", "give each element its own calibration");
  taking->calibration = *what->second.calibration;
  taking->calibration.tare = 0;
  taking->told = std::move(told);
  if (words.size() > 2) return apply(*taking, std::nullopt, "the tare of " + plan->name + "." + field + " is removed");
  AnySensor& sensor = system_.sensor(plan->name);
  if (!sensor.is_running()) refuse(plan->object(), "it is stopped", "start it: rtdata ctl start " + plan->name);
  const bool may_hold_back = std::any_of(taking->processing.begin(), taking->processing.end(), [](const auto& one) {
    return std::any_of(one.second.filters.begin(), one.second.filters.end(), [](const Filter& filter) {
      return filter.type == FilterType::throttle || filter.type == FilterType::delta;
    });
  });
  if (may_hold_back) sensor.set_processing(taking->processing);  // filters begin anew: the next sample passes
  const std::weak_ptr weak = taking;
  taking->heard = loop_.subscribe(plan->publishes->topic, [weak](const EventView& event) {
    const auto still = weak.lock();
    if (still == nullptr || event.origin() != still->sensor) return;
    const Leaf* const leaf = event.description().find(still->field + ".raw");
    if (leaf == nullptr) return;
    const Value value = event.value(*leaf);
    double raw = std::nan("");
    if (const auto* const whole = std::get_if<std::int64_t>(&value)) raw = static_cast<double>(*whole);
    if (const auto* const natural = std::get_if<std::uint64_t>(&value)) raw = static_cast<double>(*natural);
    if (const auto* const real = std::get_if<double>(&value)) raw = *real;
    const double number_now = calibrated(still->calibration, raw);
    if (!std::isfinite(number_now)) return;
    ++still->count;
    still->sum += number_now;
  });
  taking->timer = Timer(loop_, of_a_tare, [this, weak] {
    if (const auto still = weak.lock()) look(still);
  });
  taking_.push_back(taking);
}

void TareDesk::look(const std::shared_ptr<Taking>& taking) {
  taking->waited += taking->waited == Duration{0} ? of_a_tare : of_a_tare / 4;
  if (taking->count == 0 && taking->waited < longest_wait) {
    taking->timer = Timer(loop_, of_a_tare / 4, [this, weak = std::weak_ptr(taking)] {
      if (const auto still = weak.lock()) look(still);
    });
    return;
  }
  finish(taking);
}

void TareDesk::finish(const std::shared_ptr<Taking>& taking) {
  if (std::erase(taking_, taking) == 0) return;
  if (taking->count == 0)
    return taking->told(
        false, "sensor " + taking->sensor + " gave no value in " + to_string(longest_wait) + ": no tare was taken");
  const double tare = rounded(taking->sum / static_cast<double>(taking->count), digits_of_a_tare);
  try {
    apply(*taking, tare,
          taking->sensor + "." + taking->field + " reads 0 now: its tare is " + number_text(tare, digits_of_a_tare) +
              ", the mean of " + std::to_string(taking->count) + (taking->count == 1 ? " value" : " values"));
  } catch (const std::exception& error) {
    taking->told(false, std::string(detail::reason_of(error)));
  }
}

void TareDesk::apply(Taking& taking, std::optional<double> tare, const std::string& text) {
  // As it is now: a reload, or another tare, may have come meanwhile.
  const auto plans = system_.parts().plans();
  const auto plan = std::find_if(plans.begin(), plans.end(), [&](const PartPlan* one) {
    return one->kind == "sensor" && one->name == taking.sensor;
  });
  if (plan == plans.end()) refuse("sensor " + taking.sensor, "it is gone", "");
  ConfigItem item = (*plan)->item;
  Problems ignored;
  tares_.put_into_sensor(item, ignored);
  Processing processing = processing_of(item);
  const auto what = processing.find(taking.field);
  Calibration now = what == processing.end() ? Calibration{} : what->second.calibration.value_or(Calibration{});
  now.tare = 0;
  if (what == processing.end() || numbers_of(now) != numbers_of(taking.calibration))
    refuse("sensor " + taking.sensor, "its calibration has changed meanwhile", "take the tare again");
  what->second.calibration->tare = tare.value_or(0);
  system_.sensor(taking.sensor).set_processing(processing);
  const std::string file = tares_.set(taking.sensor, taking.field, taking.calibration, tare);
  const auto told = std::make_shared<Told>();
  *told = [this, text, own = std::weak_ptr(told), answer = std::move(taking.told)](bool done, const std::string& why) {
    const auto kept = own.lock();  // erasing it ends this function's life
    std::erase(writing_, kept);
    answer(true, done ? text : text + "; but it ends with this run: " + why);
  };
  writing_.push_back(told);
  if (!lane_.submit(std::make_shared<Writing>(tares_.file(), file, told), writing_limit))
    (*told)(false, tares_.file() + " cannot be written: the disk does not answer");
}

void TareDesk::end() {
  for (const auto& taking : std::exchange(taking_, {})) taking->told(false, "the program ends already");
  for (const auto& told : std::vector(writing_)) (*told)(false, "the program ends already");
}

}  // namespace rtdata::app
